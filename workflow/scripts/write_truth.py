from irodori.config.models import Camera, Object, Rig
from irodori.core.run_rule import run_rule
from irodori.simulation.virtual_rig.ground_truth import write_true_material

with run_rule(snakemake) as provenance:
    write_true_material(
        Object.of(snakemake.params.definition),
        Camera.of(snakemake.params.camera),
        Rig.of(snakemake.params.rig),
        snakemake.output.truth,
        provenance,
    )
