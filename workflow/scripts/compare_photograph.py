from irodori.core.run_rule import run_rule
from irodori.evaluation.photograph_comparison import compare_photograph

with run_rule(snakemake) as provenance:
    compare_photograph(
        dict(snakemake.input.items()),
        snakemake.params.scene,
        snakemake.params.placed,
        snakemake.params.optics,
        snakemake.params.shapes,
        dict(snakemake.output.items()),
        provenance,
    )
