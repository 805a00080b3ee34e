from irodori.environment import prepare_environment
from irodori.principal import CompressOptions
from irodori.rules import run_rule

with run_rule(snakemake) as provenance:
    irradiance = snakemake.params.compress["irradiance"]
    options = {key: value for key, value in snakemake.params.compress.items() if key != "irradiance"}
    prepare_environment(
        snakemake.input.linear,
        snakemake.input.calibration,
        snakemake.output.environment,
        CompressOptions(**options),
        irradiance,
        provenance,
    )
