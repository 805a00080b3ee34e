"""A small run of all stages in one process: an object that the virtual rig photographs with few pixels."""

from collections.abc import Container
from dataclasses import replace
from pathlib import Path

from definitions import ROOT

from irodori.calibration.stage import calibrate_camera
from irodori.capture.shot_list import camera_shots, object_shots
from irodori.config.capture_table import Shot, write_captures
from irodori.config.definitions import read_yaml
from irodori.config.models import Camera, ChartCorners, Imperfections, Object, Rig
from irodori.config.parts import RigGeometry
from irodori.core.store import Provenance
from irodori.fitting.solvers import FitOptions
from irodori.fitting.stage import fit_brdf
from irodori.ingest.camera_reference import ingest_reference
from irodori.ingest.ingest_options import IngestOptions
from irodori.ingest.stage import ingest_raw
from irodori.material.material_file import Material
from irodori.material.principal_components.basis_count import CompressOptions
from irodori.material.stage import compress_reflectance
from irodori.rectification.stage import RigSetup, rectify_object
from irodori.simulation.virtual_rig.bench import Bench
from irodori.simulation.virtual_rig.virtual_camera import VirtualCamera
from irodori.spectra.published import refractive_index

MADE = Provenance("test")
_SMALLER = 4


def small_camera() -> Camera:
    """Return the default camera with a quarter of its sides, and one chart."""
    # Read as it stands: to check all definitions takes longer than a small run.
    camera = Camera.of(read_yaml(ROOT / "config/cameras/d5100-comb.yaml"))
    optics, chart = camera.optics, camera.chart
    smaller = replace(
        optics,
        width_px=optics.width_px // _SMALLER,
        height_px=optics.height_px // _SMALLER,
        pixel_pitch_um=optics.pixel_pitch_um * _SMALLER,
        principal_point_px=tuple(at / _SMALLER for at in optics.principal_point_px),
    )
    corners = {n: tuple((at + 0.5) / _SMALLER - 0.5 for at in xy) for n, xy in vars(chart.centres_px).items()}
    chart = replace(chart, centres_px=ChartCorners(**corners), patch_px=chart.patch_px // _SMALLER)
    return replace(camera, optics=smaller, chart=chart, further_charts={})


def small_rig(without: Container[str] = (), **changes) -> Rig:
    """Return the default rig for `small_camera`, with some faults switched off and other values of its definition."""
    rig = Rig.of(read_yaml(ROOT / "config/rigs/virtual.yaml") | changes)
    faults = vars(rig.virtual.imperfections)
    switched = {name: replace(fault, enabled=name not in without) for name, fault in faults.items()}
    plate = switched["filter_plate"]
    shift_px = tuple(at / _SMALLER for at in plate.shift_px)
    plate = replace(plate, shift_px=shift_px, repeat_rms_px=plate.repeat_rms_px / _SMALLER)
    return replace(
        rig, virtual=replace(rig.virtual, imperfections=Imperfections(**(switched | {"filter_plate": plate})))
    )


def run_chain(definition: Object, camera: Camera, rig: Rig, folder: Path) -> Material:
    """Photograph an object that lies where it should, and return its material; files are left in an empty folder."""
    files = {name: folder / f"{name}.h5" for name in ("reference", "chart", "calibration", "tile", "brdf", "material")}

    def photographed(shots: list[Shot], session: str, subject: Object | None) -> tuple[Path, Path]:
        """Take all photographs of a session; return their table and their folder."""
        place, bench = folder / session, Bench()
        place.mkdir()
        virtual = VirtualCamera(camera, rig, bench, session, shots, subject)
        for shot in shots:
            bench.set({"subject": shot.subject, "filter": shot.filter, **vars(shot.pose)})
            virtual.capture(shot, place / shot.file)
        write_captures(place / "captures.csv", shots)
        return place / "captures.csv", place

    options = IngestOptions()
    of_camera = photographed(camera_shots(camera, ".dng"), "camera", None)
    ingest_reference(*of_camera, files["reference"], MADE, camera.white.reflectance_factor, options)
    ingest_raw(*of_camera, "chart", files["reference"], files["chart"], MADE, options=options)
    table = folder / "chart.csv"
    calibrate_camera(files["chart"], camera, rig.light.spectrum, files["calibration"], table, MADE)
    shots = object_shots(definition, camera, ".dng")
    of_object, linear = photographed(shots, "object", definition), []
    for capture in sorted({shot.capture for shot in shots}):
        linear.append(folder / f"{capture}.h5")
        ingest_raw(*of_object, capture, files["reference"], linear[-1], MADE, options=options)
    setup = RigSetup.from_definitions(camera.optics, RigGeometry.of_rig(rig), camera.poses.white)
    rows = (0, definition.texels.height)
    rectify_object(linear, definition, setup, rows, 80.0, output=files["tile"], provenance=MADE)
    index, calibration = refractive_index(definition.refractive_index), files["calibration"]
    fit_brdf(files["tile"], files["brdf"], FitOptions(), *index, provenance=MADE, calibration=calibration)
    compress_reflectance(
        [files["brdf"]],
        calibration,
        definition,
        files["material"],
        options=CompressOptions(),
        lights=["D65"],
        provenance=MADE,
        observations=[files["tile"]],
    )
    return Material.load(files["material"])
