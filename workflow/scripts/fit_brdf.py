from irodori.config.parts import typed_index
from irodori.core.run_rule import run_rule
from irodori.fitting.solvers import FitOptions
from irodori.fitting.stage import fit_brdf
from irodori.material.lobe_choices import chosen_model
from irodori.spectra.published import refractive_index

with run_rule(snakemake) as provenance:
    fit_brdf(
        snakemake.input.observations,
        snakemake.output.brdf,
        FitOptions(
            **snakemake.params.fit,
            **chosen_model(snakemake.input.lobes),
            lamp_radius_deg=snakemake.params.lamp_radius_deg,
        ),
        *refractive_index(typed_index(snakemake.params.refractive_index)),
        provenance=provenance,
        calibration=next(iter(snakemake.input.calibration), None),
        levels=snakemake.input.levels,
    )
