from irodori.raw import IngestOptions, ingest_raw
from irodori.rules import run_rule

with run_rule(snakemake) as provenance:
    ingest_raw(
        snakemake.params.table,
        snakemake.params.folder,
        "scene",
        snakemake.input.reference,
        snakemake.output.linear,
        provenance,
        IngestOptions(**snakemake.params.options),
    )
