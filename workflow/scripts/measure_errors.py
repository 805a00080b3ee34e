from irodori.report.errors import measure_errors
from irodori.rules import run_rule

with run_rule(snakemake):
    measure_errors(
        dict(snakemake.input.items()),
        dict(snakemake.params.items()),
        snakemake.params.lights,
        snakemake.output.errors,
    )
