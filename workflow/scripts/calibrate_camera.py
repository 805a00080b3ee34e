from irodori.calibration.stage import calibrate_camera
from irodori.config.parts import CalibratedCamera
from irodori.core.run_rule import run_rule

PARTS = ("chart", "further_charts", "calibration", "comb_filter", "sensitivities")

with run_rule(snakemake) as provenance:
    calibrate_camera(
        snakemake.input.linear,
        CalibratedCamera.of({key: part for key in PARTS if (part := snakemake.params[key]) is not None}),
        snakemake.params.light,
        snakemake.output.calibration,
        snakemake.output.errors,
        provenance,
        light_error_percent=snakemake.params.light_error_percent,
        lights=snakemake.params.lights,
        selection=snakemake.output.selection,
    )
