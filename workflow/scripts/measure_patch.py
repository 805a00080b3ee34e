from irodori.config.models import LevelPatch, Optics, RigPose
from irodori.config.parts import RigGeometry, TexturedObject
from irodori.core.run_rule import run_rule
from irodori.geometry.shapes.shape import Shape
from irodori.rectification.level_patch import measure_patch
from irodori.rectification.stage import RigSetup

with run_rule(snakemake) as provenance:
    white, params = snakemake.params.white_pose, snakemake.params
    whole = {"shape": params.shape, "texels": params.texels, "placements": params.placements}
    definition = TexturedObject.of(whole)
    measure_patch(
        snakemake.input.linear,
        definition.shape,
        RigSetup.from_definitions(
            Optics.of(params.optics),
            RigGeometry.of(params.rig),
            RigPose.of(white) if white else None,
        ).registered(Shape.from_definition(definition.shape), definition.placements, snakemake.input.registration),
        LevelPatch.of(params.patch),
        params.model_error,
        params.level_error,
        output=snakemake.output.levels,
        provenance=provenance,
    )
