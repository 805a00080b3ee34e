from benchmarks.stability import try_hard_cases
from irodori.report.stability import write_stability_page
from irodori.rules import run_rule

with run_rule(snakemake):
    try_hard_cases(snakemake.output.table, snakemake.threads)
    write_stability_page(snakemake.output.table, snakemake.output.page)
