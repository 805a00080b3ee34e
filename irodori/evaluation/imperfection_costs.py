"""What each imperfection of the virtual rig costs: the chain in small, with one fault at a time.

An object is photographed, ingested, calibrated, rectified, fitted and compressed by the stages themselves, in a folder
of its own, at half the camera's resolution and in some of its poses, once for every set of faults.
"""

import copy
import csv
import math
import tempfile
from collections.abc import Iterator
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np

from irodori.calibration.stage import calibrate_camera
from irodori.capture.shot_list import camera_shots, object_shots
from irodori.colour.colorimetry import delta_e_reflectance, summary
from irodori.config.capture_table import Shot, expand_poses, write_captures
from irodori.core.atomic_files import written_whole
from irodori.core.progress import LOGGER, track
from irodori.core.provenance import config_hash
from irodori.core.store import Provenance
from irodori.evaluation.truth_errors import comparable_gloss, interior
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
from irodori.simulation.virtual_rig.ground_truth import true_material
from irodori.simulation.virtual_rig.virtual_camera import VirtualCamera
from irodori.spectra.published import refractive_index

_MAX_TEXELS = 64
_MAX_POSES = 6
_MADE = Provenance("measure_imperfections")
#: Keys of an imperfection that count in pixels and shrink with the picture.
_LENGTHS = ("shift_px", "repeat_rms_px")


@dataclass(frozen=True)
class CostRow:
    """One line of ``imperfections.csv``: the errors of an object's reflectance with one set of faults.

    ``beta`` and ``mu``, of the first gloss component, are medians of the relative error where the fit states them, NaN
    where the truth has no such parameter; ``known`` is the share of observed texels on which it does. Texels at seams
    are left out of all.
    """

    faults: str
    light: str
    count: int
    mean: float
    p95: float
    max: float
    beta: float
    mu: float
    known: float


@dataclass(frozen=True)
class Chain:
    """What the small chain runs on.

    Parameters
    ----------
    name : str
        Of the object.
    definition, camera, rig : dict
        Validated definitions; the rig is virtual.
    settings : dict
        Blocks ``ingest``, ``rectify``, ``fit`` and ``compress`` of the configuration, and the list ``lights``.
    """

    name: str
    definition: dict
    camera: dict
    rig: dict
    settings: dict

    def halved(self) -> "Chain":
        """Return the same with half the camera's resolution, one chart, at most 64 texels a side and some 6 poses."""
        camera, rig, definition = (copy.deepcopy(block) for block in (self.camera, self.rig, self.definition))
        optics, chart = camera["optics"], camera["chart"]
        camera.pop("further_charts", None)
        # Superpixels are whole: sides stay even.
        optics.update({side: optics[side] // 4 * 2 for side in ("width_px", "height_px")})
        optics["pixel_pitch_um"] *= 2.0
        optics["principal_point_px"] = [p / 2.0 for p in optics["principal_point_px"]]
        if "centres_px" in chart:
            chart["centres_px"] = {k: [(p + 0.5) / 2.0 - 0.5 for p in xy] for k, xy in chart["centres_px"].items()}
        if "patch_px" in chart:
            chart["patch_px"] = max(1, chart["patch_px"] // 2)
        plate = rig["virtual"]["imperfections"]["filter_plate"]
        plate.update({key: (np.asarray(plate[key]) / 2.0).tolist() for key in _LENGTHS})
        definition["texels"] = {side: min(size, _MAX_TEXELS) for side, size in definition["texels"].items()}
        poses = expand_poses(definition["poses"])
        thinned = poses[:: math.ceil(len(poses) / _MAX_POSES)]
        definition["poses"] = [{name: [angle] for name, angle in vars(pose).items()} for pose in thinned]
        return Chain(self.name, definition, camera, rig, self.settings)

    def variants(self) -> Iterator[tuple[str, "Chain"]]:
        """Yield each set of faults with its name: none, each alone, all, and all on another kind of material."""
        faults = self.rig["virtual"]["imperfections"]
        enabled = [name for name, fault in faults.items() if fault["enabled"]]
        for label, wanted in (("none", []), *((f"{name} alone", [name]) for name in enabled), ("all", enabled)):
            rig = copy.deepcopy(self.rig)
            for name, fault in rig["virtual"]["imperfections"].items():
                fault["enabled"] = name in wanted
            yield label.replace("_", " "), Chain(self.name, self.definition, self.camera, rig, self.settings)
        if any(material["kind"] == "paper" for material in self.definition["virtual"]["materials"]):
            definition = copy.deepcopy(self.definition)
            for material in definition["virtual"]["materials"]:
                material["kind"] = {"paper": "ggx"}.get(material["kind"], material["kind"])
            yield (
                "all, and GGX in place of equation (5)",
                Chain(self.name, definition, self.camera, self.rig, self.settings),
            )


def _photograph(
    shots: list[Shot], chain: Chain, session: str, subject: dict | None, folder: Path, seen: dict | None = None
) -> Path:
    """Take all photographs of a session and return its table."""
    folder.mkdir()
    bench = Bench()
    camera = VirtualCamera(chain.camera, chain.rig, bench, session, shots, subject, seen)
    for shot in shots:
        bench.set({"subject": shot.subject, "filter": shot.filter, **vars(shot.pose)})
        camera.capture(shot, folder / shot.file)
    write_captures(folder / "captures.csv", shots)
    return folder / "captures.csv"


def _calibrate(chain: Chain, folder: Path) -> tuple[Path, Path]:
    """Return the camera's reference and its calibration."""
    table = _photograph(camera_shots(chain.camera, ".dng"), chain, "camera", None, folder / "camera")
    options, light = IngestOptions(**chain.settings["ingest"]), chain.rig["light"]["spectrum"]
    reference, chart, calibration = (folder / f"{name}.h5" for name in ("reference", "chart", "calibration"))
    white = chain.camera["white"]["reflectance_factor"]
    ingest_reference(table, table.parent, reference, _MADE, white, options)
    ingest_raw(table, table.parent, "chart", reference, chart, _MADE, options)
    camera = {key: chain.camera[key] for key in ("chart", "calibration")}
    calibrate_camera(chart, camera, light, calibration, folder / "chart.csv", _MADE)
    return reference, calibration


def run_chain(chain: Chain, folder: Path, seen: dict | None = None) -> Material:
    """Run all stages on one object and return what they found.

    Parameters
    ----------
    chain : Chain
    folder : path
        Empty; for the files between the stages.
    seen : dict, optional
        See `VirtualCamera`; of one definition of the object and one of the camera.
    """
    settings, texels = chain.settings, chain.definition["texels"]
    reference, calibration = _calibrate(chain, folder)
    shots = object_shots(chain.definition, chain.camera, ".dng")
    table = _photograph(shots, chain, chain.name, chain.definition, folder / "object", seen)
    linear = []
    for capture in sorted({shot.capture for shot in shots}):
        linear.append(folder / f"{capture}.h5")
        options = IngestOptions(**settings["ingest"])
        ingest_raw(table, table.parent, capture, reference, linear[-1], _MADE, options)
    tile, brdf, material = (folder / f"{name}.h5" for name in ("tile", "brdf", "material"))
    setup = RigSetup.from_definitions(chain.camera, chain.rig)
    limit = settings["rectify"]["max_angle_deg"]
    rectify_object(linear, chain.definition, setup, (0, texels["height"]), limit, tile, _MADE)
    index = refractive_index(chain.definition["refractive_index"])
    fit_brdf(tile, brdf, FitOptions(**settings["fit"]), *index, _MADE, calibration)
    options = CompressOptions(**settings["compress"])
    compress_reflectance([brdf], calibration, chain.definition, material, options, settings["lights"], _MADE)
    return Material.load(material)


def cost_rows(label: str, chain: Chain, seen: dict | None = None) -> list[CostRow]:
    """Run the chain and return its errors under every light; ``seen`` as of `run_chain`."""
    with tempfile.TemporaryDirectory(prefix="irodori-") as folder:
        found = run_chain(chain, Path(folder), seen)
    truth = true_material(chain.definition, chain.camera, chain.rig)
    chosen = found.observed & interior(truth)
    exact, estimate = (m.coefficients[chosen] @ m.basis.T for m in (truth, found))
    gloss = {}
    for name, exact_map in zip(("beta", "mu"), comparable_gloss(found, truth)[0], strict=True):
        off = np.abs(getattr(found, name) / exact_map - 1)[chosen]
        gloss[name] = float(np.nanmedian(off)) if np.isfinite(off).any() else float("nan")
    known = float(np.isfinite(found.mu)[chosen].mean()) if chosen.any() else float("nan")
    rows = []
    for light in chain.settings["lights"]:
        total = summary(delta_e_reflectance(exact, estimate, light))
        rows.append(
            CostRow(label, light, total["count"], total["mean"], total["p95"], total["max"], **gloss, known=known)
        )
    return rows


def measure_imperfections(chain: Chain | None, output) -> None:
    """Write ``imperfections.csv``; a header alone where there is no virtual object.

    Parameters
    ----------
    chain : Chain or None
    output : path
    """
    variants = list(chain.halved().variants()) if chain is not None else []
    seen: dict[str, dict] = {}  # of each definition: most faults leave alone what the object looks like
    with written_whole(output) as temporary, temporary.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, [f.name for f in fields(CostRow)])
        writer.writeheader()
        for label, variant in track(variants, "faults"):
            for row in cost_rows(label, variant, seen.setdefault(config_hash(variant.definition), {})):
                writer.writerow({k: f"{v:.6g}" if isinstance(v, float) else v for k, v in asdict(row).items()})
                LOGGER.info("%s: CIEDE2000 under %s mean %.3f p95 %.3f", row.faults, row.light, row.mean, row.p95)


def read_costs(path) -> list[CostRow]:
    """Return the rows of ``imperfections.csv``."""
    with open(path, newline="", encoding="utf-8") as stream:
        kinds = {f.name: f.type for f in fields(CostRow)}
        return [CostRow(**{key: kinds[key](text) for key, text in row.items()}) for row in csv.DictReader(stream)]
