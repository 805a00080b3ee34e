from irodori.report.planning import measure_plan
from irodori.rules import run_rule

with run_rule(snakemake):
    measure_plan(
        snakemake.params.objects,
        snakemake.params.fit,
        snakemake.params.max_angle_deg,
        snakemake.params.planning,
        snakemake.output.planning,
    )
