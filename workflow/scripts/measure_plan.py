from irodori.core.run_rule import run_rule
from irodori.evaluation.pose_planning import measure_plan

with run_rule(snakemake):
    measure_plan(
        snakemake.params.objects,
        snakemake.params.fit,
        snakemake.params.max_angle_deg,
        snakemake.params.planning,
        snakemake.output.planning,
    )
