from pathlib import Path

from irodori.rig.virtual.session import capture_camera
from irodori.rules import run_rule

with run_rule(snakemake):
    capture_camera(
        snakemake.params.camera, snakemake.params.rig, snakemake.wildcards.camera, Path(snakemake.output.table)
    )
