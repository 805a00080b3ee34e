from irodori.environment import make_environment, prepare_environment
from irodori.rules import run_rule

with run_rule(snakemake) as provenance:
    options = snakemake.params.compress
    common = (
        snakemake.output.environment,
        options["target_delta_e_mean"],
        options["align"],
        options["irradiance"],
        provenance,
    )
    source, image = snakemake.params.source, snakemake.params.image
    if snakemake.params.photographed:
        prepare_environment(snakemake.input.linear, snakemake.input.calibration, *common, source, image)
    else:
        make_environment(source, image, *common)
