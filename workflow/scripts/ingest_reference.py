from irodori.core.run_rule import run_rule
from irodori.ingest.camera_reference import ingest_reference
from irodori.ingest.ingest_options import IngestOptions

with run_rule(snakemake) as provenance:
    ingest_reference(
        snakemake.input.table,
        snakemake.params.folder,
        snakemake.output.reference,
        provenance,
        snakemake.params.white_reflectance,
        IngestOptions(**snakemake.params.options),
    )
