from irodori.raw import check_captures
from irodori.rules import run_rule

with run_rule(snakemake):
    check_captures(
        snakemake.params.table,
        snakemake.params.folder,
        snakemake.output.table,
        snakemake.params.roles,
        snakemake.params.size_px,
    )
