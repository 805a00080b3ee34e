from benchmarks.stability import try_hard_cases
from irodori.core.run_rule import run_rule
from irodori.report.stability_page import write_stability_page

with run_rule(snakemake):
    try_hard_cases(snakemake.output.table, snakemake.threads)
    write_stability_page(snakemake.output.table, snakemake.output.page)
