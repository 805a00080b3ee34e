from irodori.config.models import Optics, RigPose
from irodori.config.parts import RigGeometry, TexturedObject
from irodori.core.run_rule import run_rule
from irodori.lens.lens_file import optics_in_use
from irodori.rectification.placement_correction import AS_TYPED, Correction
from irodori.rectification.stage import RigSetup, rectify_object

with run_rule(snakemake) as provenance:
    white = snakemake.params.white_pose
    registered = [Correction.load(path) for path in snakemake.input.registration]
    rectify_object(
        snakemake.input.linear,
        TexturedObject.of({"shape": snakemake.params.shape, "texels": snakemake.params.texels}),
        RigSetup.from_definitions(
            optics_in_use(Optics.of(snakemake.params.optics), snakemake.input.lens),
            RigGeometry.of(snakemake.params.rig),
            RigPose.of(white) if white else None,
        ).corrected(next(iter(registered), AS_TYPED)),
        snakemake.params.rows,
        snakemake.params.max_angle_deg,
        output=snakemake.output.observations,
        provenance=provenance,
    )
