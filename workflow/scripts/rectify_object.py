from irodori.core.run_rule import run_rule
from irodori.rectification.stage import RigSetup, rectify_object

with run_rule(snakemake) as provenance:
    rectify_object(
        snakemake.input.linear,
        {"shape": snakemake.params.shape, "texels": snakemake.params.texels},
        RigSetup.from_definitions(
            {"optics": snakemake.params.optics}, snakemake.params.rig, snakemake.params.white_pose
        ),
        snakemake.params.rows,
        snakemake.params.max_angle_deg,
        snakemake.output.observations,
        provenance,
    )
