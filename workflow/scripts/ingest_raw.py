from irodori.raw import ingest_raw
from irodori.rules import run_rule

with run_rule(snakemake) as provenance:
    ingest_raw(
        snakemake.input.table,
        snakemake.params.folder,
        snakemake.wildcards.capture,
        snakemake.input.reference,
        snakemake.params.saturation,
        snakemake.output.linear,
        provenance,
    )
