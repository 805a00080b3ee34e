from irodori.config.models import Optics, ScenePhotograph
from irodori.config.parts import Staging, typed_shapes
from irodori.core.run_rule import run_rule
from irodori.evaluation.photograph_comparison import compare_photograph
from irodori.lens.lens_file import optics_in_use

with run_rule(snakemake) as provenance:
    compare_photograph(
        dict(snakemake.input.items()),
        Staging.of(snakemake.params.scene),
        ScenePhotograph.of(snakemake.params.placed),
        optics_in_use(Optics.of(snakemake.params.optics), snakemake.input.lens),
        typed_shapes(snakemake.params.shapes),
        outputs=dict(snakemake.output.items()),
        provenance=provenance,
    )
