from irodori.report.page import write_report
from irodori.rules import run_rule

with run_rule(snakemake):
    write_report(
        dict(snakemake.input.items()),
        dict(snakemake.params.items()),
        snakemake.params.benchmarks,
        snakemake.output.page,
    )
