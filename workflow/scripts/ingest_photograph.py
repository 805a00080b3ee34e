from irodori.config.parts import NearLamp
from irodori.core.run_rule import run_rule
from irodori.ingest.ingest_options import IngestOptions
from irodori.ingest.stage import ingest_raw

with run_rule(snakemake) as provenance:
    near = snakemake.params.near_lamp
    ingest_raw(
        snakemake.params.table,
        snakemake.params.folder,
        "scene",
        snakemake.input.reference,
        snakemake.output.linear,
        provenance,
        options=IngestOptions(**snakemake.params.options),
        near_lamp=NearLamp.of(near) if near else None,
    )
