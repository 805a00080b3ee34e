from irodori.config.models import Scene
from irodori.core.run_rule import run_rule
from irodori.rendering.stage import write_xyz

with run_rule(snakemake):
    write_xyz(
        Scene.of(snakemake.params.scene), snakemake.input.exr, snakemake.input.environment, snakemake.output.picture
    )
