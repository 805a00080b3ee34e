from irodori.config.models import Scene
from irodori.core.run_rule import run_rule
from irodori.viewer.stage import finish_viewer

with run_rule(snakemake):
    finish_viewer(
        snakemake.input.payload,
        Scene.of(snakemake.params.scene),
        snakemake.input.environment,
        output=snakemake.output.page,
        poster=snakemake.input.poster,
        picture=snakemake.input.picture,
    )
