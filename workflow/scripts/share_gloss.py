from irodori.config.parts import typed_index
from irodori.core.run_rule import run_rule
from irodori.fitting.paint_stage import share_gloss
from irodori.fitting.solvers import FitOptions
from irodori.material.lobe_choices import chosen_model
from irodori.spectra.published import refractive_index

with run_rule(snakemake) as provenance:
    share_gloss(
        snakemake.input.observations,
        snakemake.input.tiles,
        snakemake.output.surface,
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
