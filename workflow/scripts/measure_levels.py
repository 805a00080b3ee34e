from irodori.config.parts import typed_index
from irodori.core.run_rule import run_rule
from irodori.fitting.level_stage import measure_levels
from irodori.fitting.solvers import FitOptions
from irodori.material.lobe_choices import chosen_model
from irodori.spectra.published import refractive_index

with run_rule(snakemake) as provenance:
    measure_levels(
        snakemake.input.observations,
        snakemake.output.levels,
        FitOptions(
            **snakemake.params.fit,
            **chosen_model(snakemake.input.lobes),
            lamp_radius_deg=snakemake.params.lamp_radius_deg,
        ),
        *refractive_index(typed_index(snakemake.params.refractive_index)),
        provenance=provenance,
        calibration=next(iter(snakemake.input.calibration), None),
    )
