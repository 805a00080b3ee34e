from irodori.rendering.stage import write_tiff
from irodori.rules import run_rule

with run_rule(snakemake):
    write_tiff(snakemake.params.scene, snakemake.input.exr, snakemake.input.environment, snakemake.output.picture)
