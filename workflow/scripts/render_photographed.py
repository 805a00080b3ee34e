from irodori.core.run_rule import run_rule
from irodori.rendering.photographed_view import render_photographed

with run_rule(snakemake) as provenance:
    render_photographed(
        snakemake.params.scene,
        snakemake.params.placed,
        snakemake.params.optics,
        snakemake.params.shapes,
        snakemake.input.materials,
        snakemake.input.environment,
        snakemake.output.radiance,
        provenance,
    )
