from irodori.rendering.stage import write_xyz
from irodori.rules import run_rule

with run_rule(snakemake):
    write_xyz(snakemake.params.scene, snakemake.input.exr, snakemake.input.environment, snakemake.output.picture)
