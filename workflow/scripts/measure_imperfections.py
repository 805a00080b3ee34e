from irodori.core.run_rule import run_rule
from irodori.evaluation.imperfection_costs import Chain, measure_imperfections

with run_rule(snakemake):
    settings = {key: snakemake.params[key] for key in ("ingest", "rectify", "fit", "compress", "lights")}
    subject = snakemake.params.subject
    measure_imperfections(
        Chain(**subject, settings=settings) if subject else None,
        snakemake.output.costs,
    )
