from irodori.config.models import Optics, ScenePhotograph
from irodori.config.parts import Staging, typed_shapes
from irodori.core.run_rule import run_rule
from irodori.evaluation.photograph_comparison import compare_photograph

with run_rule(snakemake) as provenance:
    compare_photograph(
        dict(snakemake.input.items()),
        Staging.of(snakemake.params.scene),
        ScenePhotograph.of(snakemake.params.placed),
        Optics.of(snakemake.params.optics),
        typed_shapes(snakemake.params.shapes),
        outputs=dict(snakemake.output.items()),
        provenance=provenance,
    )
