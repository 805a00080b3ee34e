from irodori.rendering.sequence import render_frames
from irodori.rules import run_rule

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
