from benchmarks.stability import try_hard_cases, write_stability_page
from irodori.core.run_rule import run_rule

with run_rule(snakemake):
    rows = try_hard_cases(snakemake.output.table, snakemake.threads)
    write_stability_page(rows, snakemake.output.page)
