from irodori.config.models import Planning
from irodori.config.parts import PlannedPlate
from irodori.core.run_rule import run_rule
from irodori.evaluation.pose_planning import measure_plan
from irodori.fitting.solvers import FitOptions

with run_rule(snakemake):
    measure_plan(
        snakemake.wildcards.object,
        PlannedPlate.of(snakemake.params.planned),
        FitOptions(**snakemake.params.fit),
        snakemake.params.max_angle_deg,
        Planning.of(snakemake.params.planning),
        snakemake.output.planning,
    )
