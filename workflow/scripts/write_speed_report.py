from benchmarks.speed_page import write_speed_report
from irodori.core.run_rule import run_rule

with run_rule(snakemake):
    write_speed_report(
        snakemake.input.tables,
        snakemake.input.materials,
        snakemake.params.size,
        snakemake.output.table,
        snakemake.output.page,
    )
