from irodori.config.models import Render, Scene
from irodori.config.parts import typed_shapes
from irodori.core.run_rule import run_rule
from irodori.rendering.sequence import render_frames

with run_rule(snakemake):
    render_frames(
        Scene.of(snakemake.params.scene),
        snakemake.wildcards.view,
        typed_shapes(snakemake.params.shapes),
        snakemake.input.materials,
        snakemake.input.environment,
        inputs=list(snakemake.input),
        folder=snakemake.output.frames,
        animation=snakemake.output.animation,
        figures_file=snakemake.output.figures,
        options=Render.of(snakemake.params.render),
        maps_file=next(iter(snakemake.input.light_maps), None),
    )
