from irodori.capture.stage import Target, capture_environment
from irodori.core.run_rule import run_rule

with run_rule(snakemake) as provenance:
    capture_environment(
        snakemake.params.definition,
        Target(
            snakemake.wildcards.environment,
            snakemake.params.camera,
            snakemake.params.rig,
            table=snakemake.params.table,
        ),
        snakemake.output.session,
        provenance,
    )
