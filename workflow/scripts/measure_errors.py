from irodori.config.parts import Staging
from irodori.core.run_rule import run_rule
from irodori.evaluation.truth_errors import measure_errors

with run_rule(snakemake):
    measure_errors(
        dict(snakemake.input.items()),
        dict(snakemake.params.items()),
        Staging.of(snakemake.params.scene),
        snakemake.params.lights,
        snakemake.output.errors,
    )
