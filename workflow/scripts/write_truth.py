from irodori.config.models import Camera, Object, Rig
from irodori.core.run_rule import run_rule
from irodori.simulation.virtual_rig.ground_truth import true_material

with run_rule(snakemake) as provenance:
    true_material(
        Object.of(snakemake.params.definition),
        Camera.of(snakemake.params.camera),
        Rig.of(snakemake.params.rig),
    ).save(snakemake.output.truth, provenance)
