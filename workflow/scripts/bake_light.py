from irodori.config.models import Render, Scene
from irodori.config.parts import typed_shapes
from irodori.core.run_rule import run_rule
from irodori.rendering.stage import bake_light

with run_rule(snakemake) as provenance:
    bake_light(
        Scene.of(snakemake.params.scene),
        typed_shapes(snakemake.params.shapes),
        snakemake.input.materials,
        snakemake.input.environment,
        options=Render.of(snakemake.params.render),
        output=snakemake.output.maps,
        provenance=provenance,
    )
