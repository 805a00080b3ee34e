from irodori.rig.virtual.truth import write_true_environment
from irodori.rules import run_rule

with run_rule(snakemake) as provenance:
    write_true_environment(
        snakemake.params.definition,
        snakemake.params.rig,
        snakemake.params.irradiance,
        snakemake.output.truth,
        provenance,
    )
