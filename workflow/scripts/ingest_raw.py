from pathlib import Path

from irodori.progress import track
from irodori.raw import IngestOptions, ingest_raw
from irodori.rules import run_rule

with run_rule(snakemake) as provenance:
    for linear in track(list(snakemake.output), "ingest"):
        ingest_raw(
            snakemake.input.table,
            snakemake.params.folder,
            Path(linear).stem,
            snakemake.input.reference,
            linear,
            provenance,
            IngestOptions(**snakemake.params.options),
        )
