from irodori.rendering.photographed import render_photographed
from irodori.rules import run_rule

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
