from irodori.fitting import FitOptions, fit_brdf
from irodori.rules import run_rule
from irodori.spectra import refractive_index_at

with run_rule(snakemake) as provenance:
    fit_brdf(
        snakemake.input.observations,
        snakemake.output.brdf,
        FitOptions(**snakemake.params.fit),
        *refractive_index_at(snakemake.params.refractive_index),
        provenance,
    )
