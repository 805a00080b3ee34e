from irodori.capture.stage import Target, capture_photograph
from irodori.core.run_rule import run_rule

with run_rule(snakemake) as provenance:
    capture_photograph(
        snakemake.params.placed,
        snakemake.input.radiance,
        Target(
            f"{snakemake.wildcards.scene}-{snakemake.wildcards.photograph}",
            snakemake.params.camera,
            snakemake.params.rig,
            table=snakemake.params.table,
        ),
        snakemake.output.session,
        provenance,
    )
