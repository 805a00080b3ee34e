from irodori.config.models import Optics, RigPose
from irodori.config.parts import RigGeometry, TexturedObject
from irodori.core.run_rule import run_rule
from irodori.lens.lens_file import optics_in_use
from irodori.material.angle_errors import read_registered
from irodori.rectification.placement_correction import AS_TYPED, Correction
from irodori.rectification.stage import RigSetup, rectify_object

with run_rule(snakemake) as provenance:
    white = snakemake.params.white_pose
    registered = next(iter(snakemake.input.registration), None)
    rectify_object(
        snakemake.input.linear,
        TexturedObject.of({"shape": snakemake.params.shape, "texels": snakemake.params.texels}),
        RigSetup.from_definitions(
            optics_in_use(Optics.of(snakemake.params.optics), snakemake.input.lens),
            RigGeometry.of(snakemake.params.rig),
            RigPose.of(white) if white else None,
        ).corrected(Correction.load(registered) if registered else AS_TYPED),
        snakemake.params.rows,
        snakemake.params.max_angle_deg,
        angle_error_deg=read_registered(registered) if registered else None,
        output=snakemake.output.observations,
        provenance=provenance,
    )
