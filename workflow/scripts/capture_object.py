from irodori.capture.stage import Target, capture_object
from irodori.config.models import Rig
from irodori.config.parts import PhotographedObject, PhotographingCamera
from irodori.core.run_rule import run_rule

with run_rule(snakemake) as provenance:
    taken = capture_object(
        PhotographedObject.of(snakemake.params.definition),
        Target(
            snakemake.wildcards.object,
            PhotographingCamera.of(snakemake.params.camera),
            Rig.of(snakemake.params.rig),
            snakemake.params.rig_name,
            snakemake.params.table,
            snakemake.params.folder,
        ),
        snakemake.output.session,
        provenance,
    )
    provenance.inputs.update(taken)
