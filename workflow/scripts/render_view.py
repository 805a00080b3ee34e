from irodori.config.models import Render, Scene
from irodori.config.parts import typed_shapes
from irodori.core.run_rule import run_rule
from irodori.rendering.stage import render_view

with run_rule(snakemake):
    render_view(
        Scene.of(snakemake.params.scene),
        snakemake.wildcards.view,
        typed_shapes(snakemake.params.shapes),
        snakemake.input.materials,
        snakemake.input.environment,
        exr=snakemake.output.exr,
        png=snakemake.output.png,
        figures_file=snakemake.output.figures,
        options=Render.of(snakemake.params.render),
        plan_file=next(iter(snakemake.input.plan), None),
        maps_file=next(iter(snakemake.input.light_maps), None),
        check=snakemake.params.check,
    )
