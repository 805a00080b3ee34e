from irodori.core.run_rule import run_rule
from irodori.report.page import write_report

with run_rule(snakemake):
    write_report(
        dict(snakemake.input.items()),
        dict(snakemake.params.items()),
        snakemake.params.benchmarks,
        snakemake.output.page,
    )
