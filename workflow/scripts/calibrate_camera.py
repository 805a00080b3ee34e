from irodori.calibration.stage import calibrate_camera
from irodori.config.parts import CalibratedCamera
from irodori.core.run_rule import run_rule

with run_rule(snakemake) as provenance:
    calibrate_camera(
        snakemake.input.linear,
        CalibratedCamera.of({key: snakemake.params[key] for key in ("chart", "further_charts", "calibration")}),
        snakemake.params.light,
        snakemake.output.calibration,
        snakemake.output.errors,
        provenance,
        lights=snakemake.params.lights,
        selection=snakemake.output.selection,
    )
