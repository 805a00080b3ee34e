from irodori.config.models import EnvironmentDefinition, IrradianceMap, Rig
from irodori.core.run_rule import run_rule
from irodori.simulation.virtual_rig.ground_truth import true_environment

with run_rule(snakemake) as provenance:
    true_environment(
        EnvironmentDefinition.of(snakemake.params.definition),
        Rig.of(snakemake.params.rig),
        IrradianceMap.of(snakemake.params.irradiance),
    ).save(snakemake.output.truth, provenance)
