from irodori.core.run_rule import run_rule
from irodori.simulation.virtual_rig.ground_truth import write_true_environment

with run_rule(snakemake) as provenance:
    write_true_environment(
        snakemake.params.definition,
        snakemake.params.rig,
        snakemake.params.irradiance,
        snakemake.output.truth,
        provenance,
    )
