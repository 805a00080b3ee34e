from irodori.config.models import Scene
from irodori.config.parts import typed_shapes
from irodori.core.run_rule import run_rule
from irodori.evaluation.truth_errors import measure_errors
from irodori.geometry.shapes.shape import Shape

with run_rule(snakemake):
    measure_errors(
        dict(snakemake.input.items()),
        dict(snakemake.params.items()),
        Scene.of(snakemake.params.scene) if snakemake.params.scene else None,
        [Shape.from_definition(shape) for shape in typed_shapes(snakemake.params.shapes)],
        snakemake.params.lights,
        snakemake.output.errors,
    )
