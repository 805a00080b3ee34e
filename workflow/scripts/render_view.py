from irodori.core.run_rule import run_rule
from irodori.rendering.stage import render_view

with run_rule(snakemake):
    render_view(
        snakemake.params.scene,
        snakemake.wildcards.view,
        snakemake.params.shapes,
        snakemake.input.materials,
        snakemake.input.environment,
        snakemake.output.exr,
        snakemake.output.png,
        snakemake.output.figures,
        {**snakemake.params.render, "max_bounces": snakemake.params.scene["max_bounces"]},
        snakemake.params.render["tile_rows"],
        next(iter(snakemake.input.plan), None),
        snakemake.params.check,
    )
