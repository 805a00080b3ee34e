from irodori.capture.stage import Target, capture_photograph
from irodori.config.models import Rig, ScenePhotograph
from irodori.config.parts import PhotographingCamera
from irodori.core.run_rule import run_rule

with run_rule(snakemake) as provenance:
    taken = capture_photograph(
        ScenePhotograph.of(snakemake.params.placed),
        snakemake.input.radiance,
        Target(
            f"{snakemake.wildcards.scene}-{snakemake.wildcards.photograph}",
            PhotographingCamera.of(snakemake.params.camera),
            Rig.of(snakemake.params.rig),
            table=snakemake.params.table,
        ),
        snakemake.output.session,
        provenance,
    )
    provenance.inputs.update(taken)
