from irodori.core.run_rule import run_rule
from irodori.report.speed_page import write_speed_report

with run_rule(snakemake):
    write_speed_report(
        snakemake.input.tables,
        snakemake.input.materials,
        snakemake.params.size,
        snakemake.output.table,
        snakemake.output.page,
    )
