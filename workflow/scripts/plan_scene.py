from irodori.rendering.scene_plan.stage import plan_scene
from irodori.rules import run_rule

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
