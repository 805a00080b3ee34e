from irodori.core.run_rule import run_rule
from irodori.evaluation.truth_errors import measure_errors

with run_rule(snakemake):
    measure_errors(
        dict(snakemake.input.items()),
        dict(snakemake.params.items()),
        snakemake.params.lights,
        snakemake.output.errors,
    )
