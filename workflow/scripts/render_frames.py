from irodori.core.run_rule import run_rule
from irodori.rendering.sequence import render_frames

with run_rule(snakemake):
    render_frames(
        snakemake.params.scene,
        snakemake.wildcards.view,
        snakemake.params.shapes,
        snakemake.input.materials,
        snakemake.input.environment,
        list(snakemake.input),
        snakemake.output.frames,
        snakemake.output.animation,
        snakemake.output.figures,
        {**snakemake.params.render, "max_bounces": snakemake.params.scene["max_bounces"]},
        snakemake.params.render["tile_rows"],
    )
