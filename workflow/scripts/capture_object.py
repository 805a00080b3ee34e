from irodori.capture.stage import Target, capture_object
from irodori.core.run_rule import run_rule

with run_rule(snakemake) as provenance:
    capture_object(
        snakemake.params.definition,
        Target(
            snakemake.wildcards.object,
            snakemake.params.camera,
            snakemake.params.rig,
            snakemake.params.rig_name,
            snakemake.params.table,
            snakemake.params.folder,
        ),
        snakemake.output.session,
        provenance,
    )
