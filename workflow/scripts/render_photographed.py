from irodori.config.models import Optics, ScenePhotograph
from irodori.config.parts import Staging, typed_shapes
from irodori.core.run_rule import run_rule
from irodori.rendering.photographed_view import render_photographed

with run_rule(snakemake) as provenance:
    render_photographed(
        Staging.of(snakemake.params.scene),
        ScenePhotograph.of(snakemake.params.placed),
        Optics.of(snakemake.params.optics),
        typed_shapes(snakemake.params.shapes),
        snakemake.input.materials,
        snakemake.input.environment,
        output=snakemake.output.radiance,
        provenance=provenance,
    )
