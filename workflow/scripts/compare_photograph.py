from irodori.report.photograph import compare_photograph
from irodori.rules import run_rule

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
