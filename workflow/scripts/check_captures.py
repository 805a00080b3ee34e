from irodori.core.run_rule import run_rule
from irodori.ingest.first_look import check_captures

with run_rule(snakemake):
    check_captures(
        snakemake.params.table,
        snakemake.params.folder,
        snakemake.output.table,
        snakemake.params.roles,
        snakemake.params.size_px,
        snakemake.params.lens_mm,
    )
