from functools import partial

from irodori.config.models import Markers, Optics, Placing, RigPose
from irodori.config.parts import RigGeometry, TexturedObject, typed_index
from irodori.core.run_rule import run_rule
from irodori.fitting.light_angle import light_angle_in
from irodori.fitting.solvers import FitOptions
from irodori.lens.lens_file import optics_in_use
from irodori.material.lobe_choices import lobes_before_choice
from irodori.rectification.object_registration import register_object
from irodori.rectification.stage import RigSetup
from irodori.spectra.published import refractive_index

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
        light=partial(
            light_angle_in,
            snakemake.input.linear,
            definition,
            options=FitOptions(**snakemake.params.fit, lobes=lobes_before_choice(snakemake.params.lobes)),
            index=refractive_index(typed_index(snakemake.params.refractive_index)),
            max_angle_deg=snakemake.params.max_angle_deg,
        ),
        output=snakemake.output.registration,
        provenance=provenance,
    )
