from irodori.core.run_rule import run_rule
from irodori.evaluation.error_budget import measure_error_budget

with run_rule(snakemake):
    scene = snakemake.params.scene
    measure_error_budget(
        dict(snakemake.input.items()),
        scene,
        snakemake.wildcards.view,
        snakemake.params.subjects,
        {
            "render": {**snakemake.params.render, "max_bounces": scene["max_bounces"]},
            "fit": snakemake.params.fit,
            "compress": snakemake.params.compress,
            "environment": snakemake.params.environment,
        },
        snakemake.output.budget,
    )
