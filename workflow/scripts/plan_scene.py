from irodori.core.run_rule import run_rule
from irodori.rendering.planning.stage import plan_scene

with run_rule(snakemake):
    plan_scene(
        snakemake.wildcards.scene,
        snakemake.params.scene,
        snakemake.params.shapes,
        snakemake.input.materials,
        snakemake.input.environment,
        snakemake.params.render,
        snakemake.output.plan,
    )
