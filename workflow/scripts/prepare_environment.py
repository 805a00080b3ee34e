from irodori.environment import prepare_environment
from irodori.rules import run_rule

with run_rule(snakemake) as provenance:
    prepare_environment(
        snakemake.input.linear,
        snakemake.input.calibration,
        snakemake.output.environment,
        snakemake.params.compress["target_delta_e_mean"],
        snakemake.params.compress["align"],
        snakemake.params.compress["irradiance"],
        provenance,
    )
