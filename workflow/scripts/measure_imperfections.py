from irodori.report.imperfections import Chain, measure_imperfections
from irodori.rules import run_rule

with run_rule(snakemake):
    settings = {key: snakemake.params[key] for key in ("ingest", "rectify", "fit", "compress", "lights")}
    subject = snakemake.params.subject
    measure_imperfections(
        Chain(**subject, settings=settings) if subject else None,
        snakemake.output.costs,
    )
