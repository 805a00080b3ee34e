from irodori.capture.stage import Target, capture_environment
from irodori.config.models import EnvironmentDefinition, Rig
from irodori.config.parts import PhotographingCamera
from irodori.core.run_rule import run_rule

with run_rule(snakemake) as provenance:
    taken = capture_environment(
        EnvironmentDefinition.of(snakemake.params.definition),
        Target(
            snakemake.wildcards.environment,
            PhotographingCamera.of(snakemake.params.camera),
            Rig.of(snakemake.params.rig),
            table=snakemake.params.table,
        ),
        snakemake.output.session,
        provenance,
    )
    provenance.inputs.update(taken)
