from irodori.config.models import Render, Scene
from irodori.config.parts import typed_shapes
from irodori.core.run_rule import run_rule
from irodori.rendering.planning.stage import plan_scene

with run_rule(snakemake):
    plan_scene(
        snakemake.wildcards.scene,
        Scene.of(snakemake.params.scene),
        typed_shapes(snakemake.params.shapes),
        snakemake.input.materials,
        snakemake.input.environment,
        options=Render.of(snakemake.params.render),
        output=snakemake.output.plan,
        maps_file=next(iter(snakemake.input.light_maps), None),
    )
