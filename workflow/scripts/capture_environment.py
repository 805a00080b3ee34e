from pathlib import Path

from irodori.rig.virtual.session import capture_environment
from irodori.rules import run_rule

with run_rule(snakemake):
    capture_environment(
        snakemake.params.definition,
        snakemake.params.camera,
        snakemake.params.rig,
        snakemake.wildcards.environment,
        Path(snakemake.output.table),
    )
