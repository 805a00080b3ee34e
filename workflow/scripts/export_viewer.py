from irodori.config.models import Render, Scene
from irodori.config.parts import typed_shapes
from irodori.core.run_rule import run_rule
from irodori.viewer.stage import SceneSources, export_viewer

with run_rule(snakemake):
    export_viewer(
        SceneSources(
            snakemake.wildcards.scene,
            Scene.of({**snakemake.params.scene, "lesson": snakemake.params.lesson}),
            tuple(typed_shapes(snakemake.params.shapes)),
            tuple(snakemake.input.materials),
            tuple(snakemake.input.environments),
            Render.of(snakemake.params.render).min_throughput,
        ),
        poster=snakemake.input.poster,
        picture=snakemake.input.picture,
        output=snakemake.output.page,
    )
