from irodori.raw import IngestOptions, ingest_reference
from irodori.rules import run_rule

with run_rule(snakemake) as provenance:
    ingest_reference(
        snakemake.input.table,
        snakemake.params.folder,
        snakemake.output.reference,
        provenance,
        snakemake.params.white_reflectance,
        IngestOptions(**snakemake.params.options),
    )
