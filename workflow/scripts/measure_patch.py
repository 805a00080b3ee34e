from irodori.config.models import LevelPatch, Optics, RigPose
from irodori.config.parts import RigGeometry, typed_shapes
from irodori.core.run_rule import run_rule
from irodori.rectification.level_patch import measure_patch
from irodori.rectification.placement_correction import AS_TYPED, Correction
from irodori.rectification.stage import RigSetup

with run_rule(snakemake) as provenance:
    white = snakemake.params.white_pose
    registered = [Correction.load(path) for path in snakemake.input.registration]
    measure_patch(
        snakemake.input.linear,
        typed_shapes([snakemake.params.shape])[0],
        RigSetup.from_definitions(
            Optics.of(snakemake.params.optics),
            RigGeometry.of(snakemake.params.rig),
            RigPose.of(white) if white else None,
        ).corrected(next(iter(registered), AS_TYPED)),
        LevelPatch.of(snakemake.params.patch),
        snakemake.params.model_error,
        snakemake.params.level_error,
        output=snakemake.output.levels,
        provenance=provenance,
    )
