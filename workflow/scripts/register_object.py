from irodori.config.models import Markers, Optics, Placing, RigPose
from irodori.config.parts import RigGeometry, TexturedObject
from irodori.core.run_rule import run_rule
from irodori.fitting.light_angle import LightSearch
from irodori.lens.lens_file import optics_in_use
from irodori.rectification.object_registration import FirstPlacement, register_object
from irodori.rectification.stage import RigSetup

with run_rule(snakemake) as provenance:
    params, first = snakemake.params, list(snakemake.input.first)
    definition = TexturedObject.of({"shape": params.shape, "texels": params.texels, "placements": params.placements})
    setup = RigSetup.from_definitions(
        optics_in_use(Optics.of(params.optics), snakemake.input.lens),
        RigGeometry.of(params.rig),
        RigPose.of(params.white_pose) if params.white_pose else None,
    )
    register_object(
        snakemake.input.linear,
        definition,
        setup,
        Placing.of(params.place),
        Markers.of(params.markers) if params.markers else None,
        light=LightSearch.of(snakemake.input.linear, definition, params),
        first=FirstPlacement.load(snakemake.input.first_linear, first[0]) if first else None,
        output=snakemake.output.registration,
        provenance=provenance,
    )
