from pathlib import Path

from irodori.rig.virtual.session import capture_object
from irodori.rules import run_rule

with run_rule(snakemake):
    capture_object(
        snakemake.params.definition,
        snakemake.params.camera,
        snakemake.params.rig,
        snakemake.wildcards.object,
        Path(snakemake.output.table),
    )
