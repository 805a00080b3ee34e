from irodori.fitting import FitOptions, fit_brdf
from irodori.rules import run_rule
from irodori.spectra import refractive_index

with run_rule(snakemake) as provenance:
    fit_brdf(
        snakemake.input.observations,
        snakemake.output.brdf,
        FitOptions(**snakemake.params.fit),
        *refractive_index(snakemake.params.refractive_index),
        provenance,
        next(iter(snakemake.input.calibration), None),
    )
