from irodori.core.run_rule import run_rule
from irodori.rectification.shared_camera import combine_registrations

with run_rule(snakemake) as provenance:
    combine_registrations(
        snakemake.params.labels,
        snakemake.input.registrations,
        snakemake.output.placements,
        provenance=provenance,
    )
