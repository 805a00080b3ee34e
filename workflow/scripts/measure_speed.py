from benchmarks.table import run_benchmark
from irodori.core.run_rule import run_rule

with run_rule(snakemake):
    run_benchmark(snakemake.wildcards.stage, snakemake.output.table, snakemake.threads, snakemake.params.size)
