from irodori.core.run_rule import run_rule
from irodori.simulation.virtual_rig.ground_truth import write_true_material

with run_rule(snakemake) as provenance:
    write_true_material(
        snakemake.params.definition,
        snakemake.params.camera,
        snakemake.params.rig,
        snakemake.output.truth,
        provenance,
    )
