"""Colour and gloss error caused by each imperfection of the virtual rig, from small runs with one fault at a time.

For every set of faults, the stages of the workflow photograph, ingest, calibrate, rectify, fit and compress an object
in a temporary folder, at half the camera's resolution and in some of its poses.
"""

import math
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple, TypeGuard

import numpy as np

from irodori.calibration.stage import calibrate_camera
from irodori.capture.shot_list import camera_shots, object_shots
from irodori.colour.colorimetry import delta_e_reflectance, summary
from irodori.config.capture_table import Shot, expand_poses, write_captures
from irodori.config.models import (
    Camera,
    ChartCorners,
    Imperfections,
    ModelledMaterial,
    Object,
    Placing,
    PoseGroup,
    Rectify,
    Rig,
    Size,
    TrueMaterial,
)
from irodori.config.parts import RigGeometry
from irodori.core.atomic_files import file_sha256
from irodori.core.progress import LOGGER, track
from irodori.core.provenance import config_hash
from irodori.core.store import Provenance
from irodori.evaluation.result_tables import CostRow, write_rows
from irodori.evaluation.truth_errors import comparable_gloss, interior
from irodori.fitting.solvers import FitOptions
from irodori.fitting.stage import fit_brdf
from irodori.ingest.camera_reference import ingest_reference
from irodori.ingest.ingest_options import IngestOptions
from irodori.ingest.stage import ingest_raw
from irodori.material.material_file import Material
from irodori.material.principal_components.basis_count import CompressOptions
from irodori.material.stage import compress_reflectance
from irodori.rectification.object_registration import register
from irodori.rectification.stage import RigSetup, rectify_object
from irodori.simulation.virtual_rig.bench import Bench
from irodori.simulation.virtual_rig.ground_truth import true_material
from irodori.simulation.virtual_rig.virtual_camera import VirtualCamera
from irodori.spectra.published import refractive_index

_MAX_TEXELS = 64
_MAX_POSES = 6
_MADE = Provenance("measure_imperfections")


class Settings(NamedTuple):
    """The blocks of the configuration on which a small run depends, and the illuminants for colour differences."""

    ingest: IngestOptions
    place: Placing
    rectify: Rectify
    fit: FitOptions
    compress: CompressOptions
    lights: list[str]


@dataclass(frozen=True)
class SmallChain:
    """Inputs of a small run of all stages from photographs to material.

    Parameters
    ----------
    name : str
        Name of the object.
    definition, camera, rig : Object, Camera, Rig
        The rig is virtual.
    settings : Settings
    """

    name: str
    definition: Object
    camera: Camera
    rig: Rig
    settings: Settings

    def halved(self) -> "SmallChain":
        """Return a copy with half the camera's resolution, one chart, at most 64 texels a side and at most 6 poses."""
        optics, chart, faults = self.camera.optics, self.camera.chart, self.faults
        assert optics is not None  # checked: a camera of objects has optics
        x, y = optics.principal_point_px
        smaller = replace(
            optics,
            # Superpixels are whole: sides stay even.
            width_px=optics.width_px // 4 * 2,
            height_px=optics.height_px // 4 * 2,
            pixel_pitch_um=2.0 * optics.pixel_pitch_um,
            principal_point_px=(x / 2.0, y / 2.0),
        )
        if chart.centres_px is not None:
            corners = {k: tuple((p + 0.5) / 2.0 - 0.5 for p in xy) for k, xy in vars(chart.centres_px).items()}
            chart = replace(chart, centres_px=ChartCorners(**corners))
        if chart.patch_px is not None:
            chart = replace(chart, patch_px=max(1, chart.patch_px // 2))
        (x, y), repeat = faults.filter_plate.shift_px, faults.filter_plate.repeat_rms_px
        plate = replace(faults.filter_plate, shift_px=(x / 2.0, y / 2.0), repeat_rms_px=repeat / 2.0)
        # Of several placements, the first; of a sheet, its front.
        texels, every = self.definition.texels, expand_poses(self.definition.poses or ())
        poses = [pose for pose in every if pose.placement == 1]
        thinned = poses[:: math.ceil(len(poses) / _MAX_POSES)]
        return replace(
            self,
            camera=replace(self.camera, optics=smaller, chart=chart, further_charts={}),
            definition=replace(
                self.definition,
                texels=Size(width=min(texels.width, _MAX_TEXELS), height=min(texels.height, _MAX_TEXELS)),
                poses=tuple(PoseGroup(**{name: (angle,) for name, angle in vars(pose).items()}) for pose in thinned),
                placements=(),
                sheet=None,
            ),
        ).with_faults(replace(faults, filter_plate=plate))

    @property
    def faults(self) -> Imperfections:
        """Imperfections of the virtual rig."""
        assert self.rig.virtual is not None  # the schema has it: the rig is virtual
        return self.rig.virtual.imperfections

    @property
    def sight(self) -> dict:
        """Plain values of what an ideal camera would see of the object in a pose of the rig."""
        return {
            "definition": self.definition.plain(),
            "lamp_spectrum": self.faults.lamp_spectrum.plain(),
            "laid_off": self.faults.laid_off.plain(),
            "focal_length": self.faults.focal_length.plain(),
        }

    def with_faults(self, faults: Imperfections) -> "SmallChain":
        """Return a copy on a rig with other faults."""
        assert self.rig.virtual is not None
        return replace(self, rig=replace(self.rig, virtual=replace(self.rig.virtual, imperfections=faults)))

    def variants(self) -> Iterator[tuple[str, "SmallChain"]]:
        """Yield name and inputs of each run: no fault, each fault alone, all, and all on an object with GGX gloss.

        The last run is left out unless a material of the object has gloss by equation (5), which GGX then replaces.
        """
        faults = vars(self.faults)
        enabled = [name for name, fault in faults.items() if fault.enabled]
        for label, wanted in (("none", []), *((f"{name} alone", [name]) for name in enabled), ("all", enabled)):
            switched = {name: replace(fault, enabled=name in wanted) for name, fault in faults.items()}
            yield label.replace("_", " "), self.with_faults(Imperfections(**switched))
        virtual = self.definition.virtual
        assert virtual is not None  # checked: an object of a virtual rig
        if any(_of_equation_5(material) for material in virtual.materials):
            others = tuple(
                replace(one, lobe="ggx", further_gloss=()) if _of_equation_5(one) else one for one in virtual.materials
            )
            definition = replace(self.definition, virtual=replace(virtual, materials=others))
            yield "all, and GGX in place of equation (5)", replace(self, definition=definition)


def _of_equation_5(material: TrueMaterial) -> TypeGuard[ModelledMaterial]:
    return isinstance(material, ModelledMaterial) and material.lobe == ModelledMaterial.lobe


def _photograph(
    shots: list[Shot], chain: SmallChain, session: str, subject: Object | None, folder: Path, seen: dict | None = None
) -> Path:
    """Take all photographs of a session with the virtual camera and return the path of their table."""
    folder.mkdir()
    bench = Bench()
    camera = VirtualCamera(chain.camera, chain.rig, bench, session, shots, subject, seen=seen)
    for shot in shots:
        bench.set({"subject": shot.subject, "filter": shot.filter, **vars(shot.pose)})
        camera.capture(shot, folder / shot.file)
    write_captures(folder / "captures.csv", shots)
    return folder / "captures.csv"


def _calibrate(chain: SmallChain, folder: Path, calibrated: dict[str, list[bytes]]) -> tuple[Path, Path]:
    """Photograph and calibrate the camera; return the paths of its reference and of its calibration.

    ``calibrated`` holds the contents of both files of earlier runs, by the hash of the photographs: a fault of the
    object's place, of a pose or of the stated focal length leaves the photographs of white and chart as they were.
    """
    table = _photograph(camera_shots(chain.camera, ".dng"), chain, "camera", None, folder / "camera")
    reference, chart, calibration = (folder / f"{name}.h5" for name in ("reference", "chart", "calibration"))
    photographs = config_hash([file_sha256(path) for path in sorted(table.parent.iterdir())])
    if photographs in calibrated:
        for path, content in zip((reference, calibration), calibrated[photographs], strict=True):
            path.write_bytes(content)
        return reference, calibration
    options, light = chain.settings.ingest, chain.rig.light
    white = chain.camera.white.reflectance_factor if chain.camera.white else 1.0
    ingest_reference(table, table.parent, reference, _MADE, white, options)
    ingest_raw(table, table.parent, "chart", reference, chart, _MADE, options=options)
    files, unsure = (calibration, folder / "chart.csv"), light.error_percent
    calibrate_camera(chart, chain.camera, light.spectrum, *files, _MADE, light_error_percent=unsure)
    calibrated[photographs] = [reference.read_bytes(), calibration.read_bytes()]
    return reference, calibration


def run_chain(chain: SmallChain, folder: Path, seen: dict | None = None, calibrated: dict | None = None) -> Material:
    """Run all stages on one object and return the measured material.

    Parameters
    ----------
    chain : SmallChain
    folder : path
        An empty folder for the files that the stages exchange.
    seen : dict, optional
        Cache of `VirtualCamera`; may be shared by runs with the same definitions of object and camera.
    calibrated : dict, optional
        Cache of calibrations, which this fills; may be shared by runs with the same camera and settings.
    """
    settings, texels = chain.settings, chain.definition.texels
    reference, calibration = _calibrate(chain, folder, {} if calibrated is None else calibrated)
    shots = object_shots(chain.definition, chain.camera, ".dng")
    table = _photograph(shots, chain, chain.name, chain.definition, folder / "object", seen)
    linear = []
    for capture in sorted({shot.capture for shot in shots}):
        linear.append(folder / f"{capture}.h5")
        ingest_raw(table, table.parent, capture, reference, linear[-1], _MADE, options=settings.ingest)
    tile, brdf, material = (folder / f"{name}.h5" for name in ("tile", "brdf", "material"))
    assert chain.camera.optics is not None  # checked: a camera of objects has optics
    white = chain.camera.poses.white if chain.camera.poses else None
    setup = RigSetup.from_definitions(chain.camera.optics, RigGeometry.of_rig(chain.rig), white)
    angle_error_deg = None
    if settings.place.register and (chain.faults.laid_off.enabled or chain.faults.focal_length.enabled):
        registered = register(linear, chain.definition, setup, settings.place)
        setup, angle_error_deg = setup.corrected(registered.correction), registered.angle_errors.stated
    limit, rows = settings.rectify.max_angle_deg, (0, texels.height)
    rectify_object(
        linear, chain.definition, setup, rows, limit, angle_error_deg=angle_error_deg, output=tile, provenance=_MADE
    )
    index = refractive_index(chain.definition.refractive_index)
    fit_brdf(tile, brdf, settings.fit, *index, provenance=_MADE, calibration=calibration)
    compress_reflectance(
        [brdf],
        calibration,
        chain.definition,
        material,
        options=settings.compress,
        lights=settings.lights,
        provenance=_MADE,
        observations=[tile],
    )
    return Material.load(material)


def cost_rows(label: str, chain: SmallChain, seen: dict | None = None, calibrated: dict | None = None) -> list[CostRow]:
    """Run all stages once and return the errors of the material under every light; for the caches see `run_chain`."""
    with tempfile.TemporaryDirectory(prefix="irodori-") as folder:
        found = run_chain(chain, Path(folder), seen, calibrated)
    truth = true_material(chain.definition, chain.camera, chain.rig)
    chosen = found.observed & interior(truth)
    exact, estimate = (m.coefficients[chosen] @ m.basis.T for m in (truth, found))
    gloss = {}
    for name, exact_map in zip(("beta", "mu"), comparable_gloss(found, truth)[0], strict=True):
        off = np.abs(getattr(found, name) / exact_map - 1)[chosen]
        gloss[name] = float(np.nanmedian(off)) if np.isfinite(off).any() else float("nan")
    known = float(np.isfinite(found.mu)[chosen].mean()) if chosen.any() else float("nan")
    rows = []
    for light in chain.settings.lights:
        total = summary(delta_e_reflectance(exact, estimate, light))
        rows.append(
            CostRow(label, light, int(total["count"]), total["mean"], total["p95"], total["max"], **gloss, known=known)
        )
    return rows


def measure_imperfections(chain: SmallChain, output) -> None:
    """Write ``imperfections.csv``, the errors of the measured material of a virtual object with each set of faults.

    Parameters
    ----------
    chain : SmallChain
    output : path
    """
    write_rows(output, CostRow, _all_costs(list(chain.halved().variants())))


def _all_costs(variants: list[tuple[str, SmallChain]]) -> Iterator[CostRow]:
    seen: dict[str, dict] = {}  # a cache for each sight: most faults do not change how the object looks
    calibrated: dict[str, list[bytes]] = {}
    for label, variant in track(variants, "faults"):
        for row in cost_rows(label, variant, seen.setdefault(config_hash(variant.sight), {}), calibrated):
            LOGGER.info("%s: CIEDE2000 under %s mean %.3f p95 %.3f", row.faults, row.light, row.mean, row.p95)
            yield row
