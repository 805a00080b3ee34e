"""Definitions and the capture table of a first project, with marked gaps for values that are not known yet."""

import csv
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from irodori.config.capture_table import COLUMNS, Pose
from irodori.config.models import MeshShape, PlateShape, SphereShape
from irodori.core.atomic_files import written_whole
from irodori.core.errors import InputError
from irodori.first_project.questions import GAP
from irodori.first_project.raw_folder import UNSTATED_S
from irodori.first_project.recognition import CHART, Recognised
from irodori.geometry.shapes.shape import Shape

_LIMITS = {
    "light_deg": {"min": 0.0, "max": 125.0, "step": 0.1},
    "camera_deg": {"min": 0.0, "max": 140.0, "step": 0.1},
    "tilt_deg": {"min": 0.0, "max": 45.0, "step": 0.1},
    "turn_deg": {"min": 0.0, "max": 360.0, "step": 0.1},
}
_ANGLES = tuple(_LIMITS)
_AZIMUTH = "light_azimuth_deg"
#: Of either sign and up to a whole turn, because people and light-position files count in both ways.
_AZIMUTHS = {_AZIMUTH: {"min": -360.0, "max": 360.0, "step": 0.1}}
#: Light of the first picture: a lamp with soft shadows, and an even sky.
_LAMP = {"spectrum": "D65", "azimuth_deg": -60.0, "elevation_deg": 45.0, "diameter_deg": 10.0, "irradiance": 1.0}
_SKY = {"spectrum": "D65", "azimuth_deg": 0.0, "elevation_deg": 90.0, "diameter_deg": 180.0, "radiance": 0.3}
_TABLE = "TCS71"  # a grey that reflects half of the light
_FIELD_OF_VIEW_DEG = 30.0
_REACH_MM = 50.0  # of an object of unknown size
_SHAPES: dict[str, Any] = {"plate": PlateShape, "sphere": SphereShape, "mesh": MeshShape}
_GLASS = {"n": 1.5, "k": 0.0}
_TEXELS = {"plate": (128, 128), "sphere": (256, 128), "mesh": (256, 256)}


@dataclass
class Answers:
    """Answers of the user; None marks a gap.

    Parameters
    ----------
    camera_distance_mm, focal_length_mm, pixel_pitch_um, white_reflectance : float
    lamp : str
        Name or file of the lamp's spectrum.
    reference_pose : Pose
        Pose of the chart and the white reference.
    shape : dict
        The block ``shape`` of the object's definition.
    angles : dict of list of float
        Angles by key (``light_deg``, ``camera_deg``, ``tilt_deg``, ``turn_deg``), one for each pose of the object; also
        ``light_azimuth_deg`` for lamps outside the plane of the rig.
    light_level : list of float
        Level of the lamp in each pose of the object; empty if the lamps are equal.
    assumed : dict of str
        Assumed values in place of missing answers, by the key of the question.
    """

    camera_distance_mm: float | None = None
    focal_length_mm: float | None = None
    pixel_pitch_um: float | None = None
    white_reflectance: float | None = None
    lamp: str | None = None
    reference_pose: Pose | None = None
    shape: dict[str, Any] | None = None
    angles: dict[str, list[float] | None] = field(default_factory=dict)
    light_level: list[float] = field(default_factory=list)
    assumed: dict[str, str] = field(default_factory=dict)


def refuse_existing_project(name: str, into) -> None:
    """Refuse the name of a project that exists, before its photographs are read.

    Only the files that every project has are looked for, because it is not known yet whether an object was
    photographed. `Scaffold.write` looks for all files.

    Parameters
    ----------
    name : str
    into : path
        Folder of definitions.

    Raises
    ------
    InputError
        If one of them exists; the message lists every existing file of a project of this name. Also if `into` cannot be
        a folder.
    """
    nearest = next(path for path in (Path(into), *Path(into).absolute().parents) if path.exists())
    if not nearest.is_dir():
        raise InputError(nearest, "", "a file", "a folder of definitions to write into (--into)")
    files = _Files(name, Path(into), has_object=True)
    with_chart_alone = _Files(name, Path(into), has_object=False)
    if any(path.exists() for path in (files.rig, files.configuration, files.table)):
        _refuse_existing((*files.all(), with_chart_alone.camera))


def _refuse_existing(files: Iterable[Path]) -> None:
    """Raise an InputError that names the files that exist, if any does."""
    there = [path for path in files if path.exists()]
    if there:
        removed = ", ".join(map(str, there))
        accepted = f"another --name, another --into, or, to begin anew, these files removed: {removed}"
        raise InputError(there[0], "", "a file that is there already", accepted)


@dataclass(frozen=True)
class _Files:
    """Paths of the files of a project.

    Parameters
    ----------
    name : str
    into : Path
        Folder of definitions.
    has_object : bool
        Whether an object was photographed; a project of a chart alone has only a rig, a camera, a configuration and
        the table of photographs.
    """

    name: str
    into: Path
    has_object: bool

    @property
    def rig(self) -> Path:
        return self.into / "rigs" / f"{self.name}-rig.yaml"

    @property
    def camera(self) -> Path:
        return self.into / "cameras" / f"{self.name}{'-camera' if self.has_object else ''}.yaml"

    @property
    def object(self) -> Path:
        return self.into / "objects" / f"{self.name}.yaml"

    @property
    def environment(self) -> Path:
        return self.into / "environments" / f"{self.name}-lamp.yaml"

    @property
    def scene(self) -> Path:
        return self.into / "scenes" / f"{self.name}-scene.yaml"

    @property
    def configuration(self) -> Path:
        return self.into / f"{self.name}.yaml"

    @property
    def table(self) -> Path:
        return self.into / "captures" / f"{self.name}.csv"

    def all(self) -> tuple[Path, ...]:
        """Return all paths, in the order in which the files are written."""
        of_object = (self.object, self.environment, self.scene) if self.has_object else ()
        return (self.rig, self.camera, *of_object, self.configuration, self.table)


class Scaffold:
    """Files of a first project.

    Parameters
    ----------
    name : str
        Name of the object, or of the camera if no object was photographed.
    into : path
        Folder of definitions.
    photographs : path
        Folder of the RAW files.
    recognised : list of Recognised
    answers : Answers
    """

    def __init__(self, name: str, into, photographs, recognised: list[Recognised], answers: Answers) -> None:
        self.name, self.into, self.photographs = name, Path(into), Path(photographs)
        self.recognised, self.answers = recognised, answers
        self.has_object = any(one.role == "object" for one in recognised)
        self._files = _Files(name, self.into, self.has_object)

    @property
    def _linear(self) -> bool:
        """Whether the photographs are linear pictures instead of RAW files."""
        return self.recognised[0].photograph.linear

    @property
    def configuration(self) -> Path:
        """Path of the configuration file, which lists the scenes and cameras to make."""
        return self._files.configuration

    def write(self) -> list[str]:
        """Write all files; return the gaps, each as a text with file and field.

        Raises
        ------
        InputError
            If one of the files exists already; then nothing is written.
        """
        _refuse_existing(self._files.all())
        files, table = dict(self._definitions()), self._files.table
        gaps = []
        for path, content in files.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            notes = [f"# {words}\n" for words in self.assumed().get(path, ())]
            told = ["# Assumed by irodori init; please correct what is wrong:\n", *notes] if notes else []
            body = yaml.safe_dump(content, sort_keys=False, allow_unicode=True)
            with written_whole(path) as temporary:
                temporary.write_text("".join(told) + body, encoding="utf-8")
            gaps += [f"{path}: {field}" for field in _gaps(content)]
        table.parent.mkdir(parents=True, exist_ok=True)
        rows = [self._row(one) for one in self.recognised]
        azimuth = [_AZIMUTH] if _AZIMUTH in self.answers.angles else []
        levels = ["light_level"] if self.answers.light_level else []
        columns = (*COLUMNS, "iso", "f_number", *azimuth, *levels, *(["linear"] if self._linear else []))
        with written_whole(table) as temporary, open(temporary, "w", encoding="utf-8", newline="") as out:
            writer = csv.writer(out, lineterminator="\n")
            writer.writerow(columns)
            writer.writerows(rows)
        for line, row in enumerate(rows, 2):
            gaps += [f"{table}: line {line}, {name}" for name, cell in zip(columns, row, strict=True) if cell == GAP]
        return gaps

    def assumed(self) -> dict[Path, list[str]]:
        """Return the values that were assumed, by file: texts with field, value and reason."""
        said = self.answers.assumed
        files, table = self._files, self._files.table
        rig, camera, subject, environment, scene = files.rig, files.camera, files.object, files.environment, files.scene
        notes: dict[Path, list[str]] = {rig: ["limits: wide ones, because no motor moves this rig"], camera: []}
        if "camera_distance_mm" in said:
            notes[rig].append(f"camera_distance_mm: {said['camera_distance_mm']}, which a chart alone does not need")
        notes[camera].append(
            f"chart.spectra: {CHART}, the mean of many ColorCheckers, because this one was not measured"
        )
        if "reference_pose" in said:
            notes[camera].append(
                f"light and camera angle of chart and white in {table}: {said['reference_pose']} degrees"
            )
        if "white_reflectance" in said:
            notes[camera].append(f"white.reflectance_factor: {said['white_reflectance']}, that of a new reference")
        if self._linear:
            if any(one.photograph.exposure_s == UNSTATED_S for one in self.recognised):
                notes[camera].append(f"exposure_s in {table}: {UNSTATED_S:g} where the file states none")
            if self.has_object:
                notes[camera].append("optics: in mosaic pixels; a pixel of a linear picture is 2 x 2 of them")
        if self.has_object:
            notes[camera].append("optics: the lens points at the middle of the picture and has no distortion")
            notes[subject] = [
                f"refractive_index: n {_GLASS['n']:g}, as most varnishes and plastics have",
                "mirror_weight: 0, no mirror images of other things",
                "texels: a number to start with",
                "place: the object's middle is where the axes of the rig meet",
            ]
            shape = self.answers.shape
            if shape and "unit" in shape:
                notes[subject].append(f"shape: the file's coordinates are in {shape['unit']}, and {shape['up']} is up")
            for axis in (_AZIMUTH, "camera_deg", "tilt_deg", "turn_deg"):
                if axis in said:
                    notes[subject].append(f"{axis} in {table}: {said[axis]}")
            notes[environment] = [
                "source: a lamp and an even sky of the spectrum D65 to show the object in, not your lamp"
            ]
            notes[scene] = ["views, image: one view from the front, to start with; bodies: a grey table"]
        return notes

    def _definitions(self) -> Iterator[tuple[Path, dict[str, Any]]]:
        said = self.answers
        files = self._files
        camera = files.camera.stem
        captures = {"table": str(files.table), "folder": str(self.photographs)}
        first = self.recognised[0].photograph
        lens: dict[str, Any] = {}
        if self.has_object:
            width, height = first.look.size
            lens["optics"] = {
                "focal_length_mm": _known(said.focal_length_mm),
                "pixel_pitch_um": _known(self._pitch_um()),
                "width_px": width,
                "height_px": height,
                "principal_point_px": [width / 2.0, height / 2.0],
            }
        if self.has_object or any(one.role == "white" for one in self.recognised):
            lens["white"] = {"reflectance_factor": _known(said.white_reflectance)}
        rig = {
            "kind": "files",
            "limits": _LIMITS | _AZIMUTHS,
            "camera_distance_mm": _known(said.camera_distance_mm),
            "light": {"spectrum": _known(said.lamp)},
        }
        yield files.rig, rig
        chart = {"spectra": CHART, "rows": 4, "columns": 6, "find": "chart"}
        described = {"description": first.look.camera} if first.look.camera else {}
        eye = {**described, "rig": f"{self.name}-rig", **lens, "captures": captures, "chart": chart}
        yield files.camera, eye
        make: dict[str, Any] = {"scenes": [], "cameras": [camera]}
        if self.has_object:
            kind = said.shape["kind"] if said.shape else "plate"
            texels = dict(zip(("width", "height"), _TEXELS[kind], strict=True))
            shape = {"shape": _known(said.shape), "texels": texels, "refractive_index": _GLASS}
            # Nobody knows yet how the object reflects: left-out photographs decide.
            yield files.object, {"camera": camera, **shape, "lobes": ["auto"], "coat": "auto", "captures": captures}
            lamp = {"image": {"width": 256, "height": 128}, "source": {"kind": "lights", "lights": [_LAMP, _SKY]}}
            yield files.environment, lamp
            yield files.scene, self._scene()
            make["scenes"] = [files.scene.stem]
        yield files.configuration, {"definitions": str(self.into), "make": make}

    def _pitch_um(self) -> float | None:
        """Return the distance of mosaic pixels, micrometres: for linear pictures half that of their pixels."""
        said = self.answers.pixel_pitch_um
        return said / 2.0 if said is not None and self._linear else said

    def _scene(self) -> dict[str, Any]:
        reach_mm, table_mm = self._extent_mm()
        # A ball about the object takes four fifths of the picture's height.
        far = reach_mm / math.sin(math.radians(0.4 * _FIELD_OF_VIEW_DEG))
        eye = [0.0, round(-0.6 * far, 1), round(0.8 * far, 1)]
        front = {"position_mm": eye, "target_mm": [0.0, 0.0, 0.0], "field_of_view_deg": _FIELD_OF_VIEW_DEG}
        # A little below, so that it does not coincide with a flat object.
        table = [0.0, 0.0, round(table_mm - 0.01 * reach_mm, 2)]
        return {
            "environment": f"{self.name}-lamp",
            "image": {"width": 640, "height": 480},
            "views": {"front": front},
            "objects": [{"object": self.name, "position_mm": [0.0, 0.0, 0.0]}],
            "bodies": [{"shape": {"kind": "plane"}, "position_mm": table, "material": {"spectrum": _TABLE}}],
        }

    def _extent_mm(self) -> tuple[float, float]:
        """Return the radius of a ball about the object, and the height of the table under it, mm.

        They are those of a hand-sized flat object if the shape is a gap or its mesh cannot be read, which
        `irodori check` reports.
        """
        block = self.answers.shape
        if block is None:
            return _REACH_MM, 0.0
        try:
            shape = Shape.from_definition(_SHAPES[block["kind"]].of(block))
        except InputError:
            return _REACH_MM, 0.0
        return shape.reach_mm, shape.table_height_mm

    def _row(self, one: Recognised) -> list[Any]:
        photograph = one.photograph
        if one.role == "object":
            said = [self.answers.angles.get(axis) for axis in _ANGLES]
            angles = [GAP if values is None else round(values[one.pose], 4) for values in said]
        elif one.role == "dark":
            angles = [0.0] * len(_ANGLES)
        else:
            pose = self.answers.reference_pose
            angles = [GAP, GAP, 0.0, 0.0] if pose is None else [getattr(pose, axis) for axis in _ANGLES]
        # Decoders return times in single precision: without rounding, 0.02 s would read 0.019999999552965164.
        settings = [f"{photograph.exposure_s:.6g}", photograph.iso or "", photograph.f_number or ""]
        if azimuths := self.answers.angles.get(_AZIMUTH):
            settings.append(round(azimuths[one.pose], 4) if one.role == "object" else 0.0)
        if levels := self.answers.light_level:
            settings.append(levels[one.pose] if one.role == "object" else "")
        if self._linear:
            settings.append("yes")
        return [photograph.path.name, one.role, *angles, one.filter or GAP, *settings]


def _known(value: Any) -> Any:
    return GAP if value is None else value


def _gaps(content: Any, path: str = "") -> Iterator[str]:
    """Yield the dotted key paths of the gaps in a definition."""
    if content == GAP:
        yield path
    elif isinstance(content, Mapping):
        for key, value in content.items():
            yield from _gaps(value, f"{path}.{key}" if path else str(key))
