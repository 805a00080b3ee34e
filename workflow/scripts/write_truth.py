from irodori.config.models import Rig
from irodori.config.parts import PhotographingCamera, TrueObject
from irodori.core.run_rule import run_rule
from irodori.simulation.virtual_rig.ground_truth import true_material

with run_rule(snakemake) as provenance:
    true_material(
        TrueObject.of(snakemake.params.definition),
        PhotographingCamera.of(snakemake.params.camera),
        Rig.of(snakemake.params.rig),
    ).save(snakemake.output.truth, provenance)
