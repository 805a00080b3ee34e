from irodori.config.models import Compress, EnvironmentMaps, Fit, Render, Scene
from irodori.config.parts import Subject
from irodori.core.run_rule import run_rule
from irodori.evaluation.error_budget import BudgetOptions, measure_error_budget

with run_rule(snakemake):
    measure_error_budget(
        dict(snakemake.input.items()),
        Scene.of(snakemake.params.scene),
        snakemake.wildcards.view,
        [Subject.of(subject) for subject in snakemake.params.subjects],
        BudgetOptions(
            Render.of(snakemake.params.render),
            Fit.of(snakemake.params.fit),
            Compress.of(snakemake.params.compress),
            EnvironmentMaps.of(snakemake.params.environment),
        ),
        snakemake.output.budget,
    )
