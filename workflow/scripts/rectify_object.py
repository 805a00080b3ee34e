from irodori.geometry.pinhole import Pinhole
from irodori.rectification import RigSetup, rectify_object
from irodori.rules import run_rule

with run_rule(snakemake) as provenance:
    rectify_object(
        snakemake.input.linear,
        {"shape": snakemake.params.shape, "texels": snakemake.params.texels},
        RigSetup(
            Pinhole.from_optics(snakemake.params.optics),
            snakemake.params.camera_distance_mm,
            snakemake.params.table_radius_mm,
        ),
        snakemake.params.rows,
        snakemake.params.max_angle_deg,
        snakemake.output.observations,
        provenance,
    )
