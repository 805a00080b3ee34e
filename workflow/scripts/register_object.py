from irodori.config.models import Markers, Optics, Placing, RigPose
from irodori.config.parts import RigGeometry, TexturedObject
from irodori.core.run_rule import run_rule
from irodori.fitting.light_angle import LightSearch
from irodori.lens.lens_file import optics_in_use
from irodori.rectification.object_registration import register_object
from irodori.rectification.stage import RigSetup

with run_rule(snakemake) as provenance:
    white, markers = snakemake.params.white_pose, snakemake.params.markers
    definition = TexturedObject.of({"shape": snakemake.params.shape, "texels": snakemake.params.texels})
    register_object(
        snakemake.input.linear,
        definition,
        RigSetup.from_definitions(
            optics_in_use(Optics.of(snakemake.params.optics), snakemake.input.lens),
            RigGeometry.of(snakemake.params.rig),
            RigPose.of(white) if white else None,
        ),
        Placing.of(snakemake.params.place),
        Markers.of(markers) if markers else None,
        light=LightSearch.of(snakemake.input.linear, definition, snakemake.params),
        output=snakemake.output.registration,
        provenance=provenance,
    )
