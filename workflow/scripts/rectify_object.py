from irodori.config.models import Optics, RigPose
from irodori.config.parts import RigGeometry, TexturedObject
from irodori.core.run_rule import run_rule
from irodori.geometry.shapes.shape import Shape
from irodori.lens.lens_file import optics_in_use
from irodori.material.angle_errors import read_registered
from irodori.rectification.stage import RigSetup, rectify_object

with run_rule(snakemake) as provenance:
    white, params = snakemake.params.white_pose, snakemake.params
    whole = {"shape": params.shape, "texels": params.texels, "placements": params.placements, "sheet": params.sheet}
    definition = TexturedObject.of(whole)
    rectify_object(
        snakemake.input.linear,
        definition,
        RigSetup.from_definitions(
            optics_in_use(Optics.of(params.optics), snakemake.input.lens),
            RigGeometry.of(params.rig),
            RigPose.of(white) if white else None,
        ).registered(Shape.from_definition(definition.shape), definition.placements, snakemake.input.registration),
        params.rows,
        params.max_angle_deg,
        angle_error_deg=read_registered(*snakemake.input.registration),
        output=snakemake.output.observations,
        provenance=provenance,
    )
