from pathlib import Path

from irodori.config.parts import NearLamp
from irodori.core.progress import track
from irodori.core.run_rule import run_rule
from irodori.ingest.ingest_options import IngestOptions
from irodori.ingest.stage import ingest_raw

with run_rule(snakemake) as provenance:
    near = snakemake.params.near_lamp
    for linear in track(list(snakemake.output), "ingest"):
        ingest_raw(
            snakemake.input.table,
            snakemake.params.folder,
            Path(linear).stem,
            snakemake.input.reference,
            linear,
            provenance,
            options=IngestOptions(**snakemake.params.options),
            near_lamp=NearLamp.of(near) if near else None,
        )
