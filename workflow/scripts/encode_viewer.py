from irodori.config.models import Render, Scene
from irodori.config.parts import typed_shapes
from irodori.core.run_rule import run_rule
from irodori.viewer.stage import SceneSources, encode_viewer

with run_rule(snakemake):
    encode_viewer(
        SceneSources(
            snakemake.wildcards.scene,
            Scene.of({**snakemake.params.scene, **snakemake.params.words}),
            tuple(typed_shapes(snakemake.params.shapes)),
            tuple(snakemake.input.materials),
            tuple(snakemake.input.environments),
            Render.of(snakemake.params.render).min_throughput,
        ),
        output=snakemake.output.payload,
    )
