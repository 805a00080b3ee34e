from irodori.config.parts import typed_index
from irodori.core.run_rule import run_rule
from irodori.fitting.lobe_stage import choose_lobes
from irodori.fitting.solvers import FitOptions
from irodori.spectra.published import refractive_index

with run_rule(snakemake) as provenance:
    choose_lobes(
        snakemake.input.observations,
        snakemake.output.choice,
        FitOptions(**snakemake.params.fit, lamp_radius_deg=snakemake.params.lamp_radius_deg),
        *refractive_index(typed_index(snakemake.params.refractive_index)),
        provenance=provenance,
        calibration=next(iter(snakemake.input.calibration), None),
        lobes=snakemake.params.lobes,
        coat=snakemake.params.coat,
    )
