from irodori.rig.virtual.truth import write_true_material
from irodori.rules import run_rule

with run_rule(snakemake) as provenance:
    write_true_material(
        snakemake.params.definition,
        snakemake.params.camera,
        snakemake.params.rig,
        snakemake.output.truth,
        provenance,
    )
