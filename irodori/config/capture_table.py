"""Capture tables: CSV files that list the RAW files with role, pose, filter and exposure time.

Each line is one photograph. Angles are in degrees (see `Pose`), exposure times in seconds.
"""

import csv
import dataclasses
import functools
import itertools
import math
import posixpath
import re
from collections.abc import Callable, Iterable, Mapping
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from irodori.config.validation import suggest
from irodori.core.atomic_files import written_whole
from irodori.core.confined_paths import confined, require_inside
from irodori.core.custody import content_sha256
from irodori.core.errors import InputError, counted
from irodori.core.file_kinds import IF_LINEAR, is_picture, kind_instead_of_raw
from irodori.core.text_tables import table_rows

if TYPE_CHECKING:
    from irodori.config.models import PoseGroup, RigPose
    from irodori.core.store import Reader

SUBJECTS = ("object", "chart", "white", "dark", "environment", "room-chart", "scene")
#: Role of a drift frame: a repetition of an earlier photograph of the object in a session. Differences between the two
#: are due to the lamp or the rig; no fit uses it.
DRIFT = "drift"
#: Role of a photograph of the printed sheet, in any pose, for the measurement of the lens; no session takes it.
LENS = "lens"
ROLES = (*SUBJECTS, DRIFT, LENS)
#: In a table, the role of a chart in a room, or of a camera's further chart, is followed by its name (``chart-sg``).
_NAMED_CHART = re.compile(r"(room-chart|chart)-([a-z0-9-]+)")
FILTERS = ("out", "in")
#: Longest exposure time, s.
LONGEST_S = 3600
COLUMNS = ("file", "role", "light_deg", "camera_deg", "tilt_deg", "turn_deg", "filter", "exposure_s")

_ANGLES = ("light_deg", "camera_deg", "tilt_deg", "turn_deg")
#: Azimuth of a light outside the rig's plane of incidence, as in a dome or with a lamp in the hand.
_AZIMUTH = "light_azimuth_deg"
#: Number of the placement in which a photograph shows its object: 1, or an empty cell, is how the object lay first.
_PLACEMENT = "placement"
#: In place of both angles of the light: from the rig's origin to the lamp, in any one unit.
_DIRECTION = ("light_x", "light_y", "light_z")
#: Angles that the controller reported at the exposure.
_READ = tuple(f"{angle.removesuffix('_deg')}_read_deg" for angle in _ANGLES)
#: Optional columns: the camera's own settings, which are checked, and details of each capture in a session.
EXTRA_COLUMNS = (
    _AZIMUTH,
    _PLACEMENT,
    "iso",
    "f_number",
    "taken_at",
    "camera_time",
    "camera",
    *_READ,
    "accepted",
    "sha256",
)
#: Whether a file is a TIFF or PNG picture that the user knows to be linear; no session takes such pictures.
_LINEAR = "linear"
#: Irradiance that the lamp of a photograph gives, relative to the lamp of the rig's file: under a dome, lamps differ.
_LIGHT_LEVEL = "light_level"
_OPTIONAL = ("tilt_deg", "turn_deg", *EXTRA_COLUMNS)
#: Roles with frames of equal exposure times, which are averaged or, of the sheet, show other poses.
_REPEATED = ("dark", "white", DRIFT, LENS)


@dataclasses.dataclass(frozen=True)
class Pose:
    """Angles of light, camera and table, degrees, and the placement of the object on the table.

    Parameters
    ----------
    light_deg, camera_deg : float
        Angles of light and camera from +z.
    tilt_deg, turn_deg : float
        Tilt and turn of the table.
    light_azimuth_deg : float
        Azimuth of the light from +x towards +y, about z; 0 is the rig's plane of incidence, which always contains the
        camera.
    placement : int
        Number of the placement in which the object lies: 1 is how it lay first, see the key ``placements`` of objects.
    """

    light_deg: float
    camera_deg: float
    tilt_deg: float = 0.0
    turn_deg: float = 0.0
    light_azimuth_deg: float = 0.0
    placement: int = dataclasses.field(default=1, kw_only=True)

    @classmethod
    def of_file(cls, file: "Reader") -> "Pose":
        """Return the pose of an open file of linear responses."""
        placement = file.attribute(_PLACEMENT) if _PLACEMENT in file.attributes() else 1
        return cls(*file.attribute("pose_deg"), placement=placement)

    @property
    def by_angle(self) -> dict[str, float]:
        """Angles by the names of the parameters, in their order."""
        return {angle: getattr(self, angle) for angle in (*_ANGLES, _AZIMUTH)}

    @property
    def angles_deg(self) -> tuple[float, ...]:
        """Angles in the order of the parameters."""
        return tuple(self.by_angle.values())

    @property
    @functools.cache  # noqa: B019 - poses are few, and a large set asks for their names all the time
    def name(self) -> str:
        """Name with angles in tenths of a degree: ``l0450-c0200-t000-r0000``.

        Added are ``-a0900`` for an azimuth and ``-p2`` for a further placement.
        """
        light, camera, tilt, turn = (round(10 * getattr(self, angle)) for angle in _ANGLES)
        azimuth = round(10 * self.light_azimuth_deg) % 3600
        further = (f"-a{azimuth:04d}" if azimuth else "") + (f"-p{self.placement}" if self.placement > 1 else "")
        return f"l{light:04d}-c{camera:04d}-t{tilt:03d}-r{turn:04d}{further}"


@dataclasses.dataclass(frozen=True)
class Taken:
    """Details of a photograph's capture in a session; empty if unknown, as for a computed photograph.

    Parameters
    ----------
    at : str
        The computer's time at the exposure, ISO 8601 with the UTC offset.
    camera_time : str
        The camera's own clock, ISO 8601; it has no zone and may be wrong, but runs evenly.
    camera : str
        Model and serial number of the body.
    read_deg : dict
        {motorised angle (``camera_deg``): its value according to the controller, degrees}.
    accepted : str
        Reason why a person kept the photograph although it looked doubtful.
    """

    at: str = ""
    camera_time: str = ""
    camera: str = ""
    read_deg: Mapping[str, float] = dataclasses.field(default_factory=dict)
    accepted: str = ""

    def cells(self) -> list:
        """Return the cells of a table's columns from ``taken_at`` to ``accepted``."""
        return [self.at, self.camera_time, self.camera, *(self.read_deg.get(a, "") for a in _ANGLES), self.accepted]


@dataclasses.dataclass(frozen=True)
class Shot:
    """Photograph in a capture table: ``file`` as in the table, ``role`` from ROLES, ``filter`` from FILTERS.

    ``iso`` (sensitivity, ISO 12232) and ``f_number`` (relative aperture) are 0 if the table does not state them.
    ``linear`` is True if the file is not RAW but a TIFF or PNG picture with values proportional to the light.
    ``light_level`` is the irradiance of its lamp at the object, relative to the lamp that counts as 1.
    ``chart`` is the name of a further chart or of one in a room, empty for the camera's first and for all other roles.
    ``taken`` has details of the capture; it is ignored when shots are compared.
    """

    file: str
    role: str
    pose: Pose
    filter: str
    exposure_s: float
    iso: float = 0.0
    f_number: float = 0.0
    chart: str = ""
    linear: bool = False
    light_level: float = 1.0
    taken: Taken = dataclasses.field(default_factory=Taken, compare=False)

    @property
    def subject(self) -> str:
        """Subject of the photograph: one of SUBJECTS, followed by the chart's name if it has one (``chart-sg``)."""
        if self.role == DRIFT:
            return "object"
        return f"{self.role}-{self.chart}" if self.chart else self.role

    @property
    def capture(self) -> str:
        """Name of the capture that this photograph belongs to: its pose for an object, otherwise its subject."""
        return self.pose.name if self.subject == "object" else self.subject


def placement_of(capture: str) -> int:
    """Return the number of the placement that a capture of an object shows, from the capture's name."""
    found = re.search(r"-p(\d+)$", capture)
    return int(found[1]) if found else 1


def chart_capture(name: str) -> str:
    """Return the name of a chart's capture: ``chart`` for the camera's first (empty name), else ``chart-NAME``."""
    return f"chart-{name}" if name else "chart"


def room_chart_capture(name: str) -> str:
    """Return the name of the capture of a chart in a room."""
    return f"room-chart-{name}"


def flat_incidence_rad(pose: "Pose | RigPose") -> float:
    """Return the angle of incidence θ_i of a flat sample on the table, rad.

    In the rig's plane it is the light's angle minus the tilt, negative if the table is tilted beyond the light; with an
    azimuth it is never negative.
    """
    if pose.light_azimuth_deg == 0.0:
        return math.radians(pose.light_deg - pose.tilt_deg)
    light, azimuth, tilt = map(math.radians, (pose.light_deg, pose.light_azimuth_deg, pose.tilt_deg))
    cosine = math.sin(light) * math.cos(azimuth) * math.sin(tilt) + math.cos(light) * math.cos(tilt)
    return math.acos(max(-1.0, min(1.0, cosine)))


def light_angles_deg(direction) -> tuple[float, float]:
    """Return the light angle and azimuth, degrees, of a direction or position (x, y, z) from the rig's origin."""
    x, y, z = direction
    aside = math.hypot(x, y)
    # Straight above, and in the rig's plane on the light's side, the azimuth is 0.
    return math.degrees(math.atan2(aside, z)), math.degrees(math.atan2(y, x)) if aside else 0.0


def expand_poses(groups: "Iterable[PoseGroup]") -> list[Pose]:
    """Return every combination of the lists of each group, in order.

    Parameters
    ----------
    groups : iterable of PoseGroup

    Raises
    ------
    ValueError
        If a pose occurs twice; poses that agree to a tenth of a degree have the same name and count as one.
    """
    poses, seen = [], set()
    for group in groups:
        lists = [
            group.light_deg,
            group.camera_deg,
            group.tilt_deg,
            group.turn_deg,
            group.light_azimuth_deg,
            group.placement,
        ]
        for *angles, placement in itertools.product(*lists):
            pose = Pose(*map(float, angles), placement=int(placement))
            if pose.name in seen:
                raise ValueError(f"the pose {pose.name} twice")
            seen.add(pose.name)
            poses.append(pose)
    return poses


def shot_path(shot: Shot, table, folder=None) -> Path:
    """Return the path of a photograph: in `folder`, or in the folder of the table if `folder` is None.

    Raises
    ------
    InputError
        If the path leads out of that folder, see `irodori.core.confined_paths.confined`.
    """
    return confined(Path(table).parent if folder is None else folder, shot.file, table, "file")


def table_faults(path, folder) -> list[InputError]:
    """Return the faults of a table for `read_captures`: the fault of its form, or the first fault of each line."""
    faults: list[InputError] = []
    try:
        _read_captures(path, folder, faults.append)
    except InputError as error:
        faults.append(error)
    return faults


def read_captures(path, folder=None) -> list[Shot]:
    """Read a table of photographs.

    Parameters
    ----------
    path : path
        CSV with a header, see `irodori.core.text_tables`; columns in any order, angles in degrees, times in seconds.
    folder : path, optional
        Folder of the RAW files. If it is given, each file must exist in it, not through a link out of it, and must not
        be empty.

    Returns
    -------
    list of Shot
        In the order of the table.

    Raises
    ------
    InputError
        For the first fault; the message has its line and column.
    """

    def refuse(error: InputError) -> None:
        raise error

    return _read_captures(path, folder, refuse)


def _read_captures(path, folder, refuse: Callable[[InputError], None]) -> list[Shot]:
    rows = table_rows(path, "a CSV that lists the photographs")
    if not rows:
        raise InputError(path, "", "an empty file", "a header and one line for each photograph")
    (line, cells), *body = rows
    header = _check_header([cell.strip() for cell in cells], path, line)
    shots = _Shots(path, folder)
    for line, cells in body:
        if len(cells) != len(header):
            raise InputError(path, f"line {line}", counted(len(cells), "cell"), f"{len(header)}, as in the header")
        try:
            shots.add(line, dict(zip(header, cells, strict=True)))
        except InputError as error:
            refuse(error)
    if not body:
        raise InputError(path, "", "a table without photographs", "one line for each photograph")
    return shots.all


def check_unchanged(path, folder, shots) -> None:
    """Compare photographs with the hashes in their table; photographs with an empty cell are not checked.

    Parameters
    ----------
    path, folder : path
        Table and the folder of its RAW files.
    shots : iterable of Shot
        Photographs to check.

    Raises
    ------
    InputError
        For the first photograph that does not match its hash.
    """
    noted = noted_hashes(path)
    for shot in shots:
        raw = shot_path(shot, path, folder)
        if noted[shot.file] and noted[shot.file] != content_sha256(raw):
            accepted = (
                "the photograph as it was taken: a copy, or a new one by --forcerun capture_object (or _camera); "
                f"to take this one as it is, empty its cell sha256 in {path}"
            )
            raise InputError(raw, "", f"content that does not match the hash in {path}", accepted)


def noted_hashes(path) -> dict[str, str]:
    """Return {file: hash} of the photographs in a table; a hash is empty if its cell is. Skip incomplete lines."""
    header, *body = (cells for _, cells in table_rows(path, "a CSV that lists the photographs"))
    names = [cell.strip() for cell in header]
    rows = (dict(zip(names, cells, strict=True)) for cells in body if len(cells) == len(names))
    return {row["file"]: row.get("sha256", "").strip().lower() for row in rows if "file" in row}


def _check_header(header: list[str], path, line: int) -> list[str]:
    known = (*COLUMNS, *EXTRA_COLUMNS, *_DIRECTION, _LINEAR, _LIGHT_LEVEL)
    by_direction = any(name in header for name in _DIRECTION)
    for name in header:
        if name not in known:
            raise InputError(path, f"line {line}, {name}", f"the unknown column {name!r}", suggest(name, known))
        if header.count(name) > 1:
            raise InputError(path, f"line {line}, {name}", "the column twice", "each column once")
        if by_direction and name in ("light_deg", _AZIMUTH):
            found = f"{name} beside {', '.join(_DIRECTION)}"
            raise InputError(path, f"line {line}, {name}", found, "one way to say where the light stands")
    needed = [name for name in COLUMNS if name not in _OPTIONAL and not (by_direction and name == "light_deg")]
    for name in (*needed, *(_DIRECTION if by_direction else ())):
        if name not in header:
            wanted = [name for name in COLUMNS if not (by_direction and name == "light_deg")]
            wanted += _DIRECTION if by_direction else ()
            raise InputError(path, f"line {line}, {name}", "no such column", f"the columns {', '.join(wanted)}")
    return header


class _Shots:
    """Photographs read from a table so far, with the data for checks of later lines against them."""

    def __init__(self, path, folder) -> None:
        self.path, self.folder = path, folder
        self.all: list[Shot] = []
        self._lines: dict[str, int] = {}
        self._poses: dict[str, Pose] = {}
        self._brackets: dict[tuple, int] = {}

    def add(self, line: int, row: dict[str, str]) -> None:
        file = row["file"]
        if not file.strip() or any(ord(letter) < 32 or ord(letter) == 127 for letter in file):
            raise self._error(line, "file", repr(file), "the name of a RAW file")
        require_inside(file, self.path, f"line {line}, file")
        role, chart = self._role(line, row)
        state = self._choice(line, row, "filter", FILTERS)
        pose = self._pose(line, row)
        exposure = self._number(line, "exposure_s", row["exposure_s"])
        if not 0 < exposure <= LONGEST_S:
            raise self._error(line, "exposure_s", row["exposure_s"].strip(), f"above 0 and up to {LONGEST_S} s")
        iso, f_number = (self._optional(line, column, row.get(column, "")) for column in ("iso", "f_number"))
        linear = self._choice(line, {_LINEAR: row.get(_LINEAR, "").strip() or "no"}, _LINEAR, ("yes", "no")) == "yes"
        light_level = self._optional(line, _LIGHT_LEVEL, row.get(_LIGHT_LEVEL, "")) or 1.0
        if not 0.1 <= light_level <= 10.0:
            found = row[_LIGHT_LEVEL].strip()
            raise self._error(line, _LIGHT_LEVEL, found, "a ratio from 0.1 to 10 (1.05 for 5 % more light)")
        shot = Shot(
            file, role, pose, state, exposure, iso, f_number, chart, linear, light_level, self._taken(line, row)
        )  # fmt: skip
        self._check_against_others(line, shot)
        self._check_file(line, shot)
        self.all.append(shot)

    def _pose(self, line: int, row: dict[str, str]) -> Pose:
        if _DIRECTION[0] in row:
            light_deg, azimuth_deg = self._direction(line, row)
            row = {**row, "light_deg": repr(light_deg), _AZIMUTH: repr(azimuth_deg)}
        angles = [self._number(line, angle, row.get(angle, "0")) for angle in _ANGLES]
        azimuth = row.get(_AZIMUTH, "")
        angles.append(self._number(line, _AZIMUTH, azimuth) if azimuth.strip() else 0.0)
        for name, angle in zip((*_ANGLES, _AZIMUTH), angles, strict=True):
            if abs(angle) > 360:
                raise self._error(line, name, row[name].strip(), "an angle from -360 to 360 degrees")
        return Pose(*angles, placement=self._placement(line, row))

    def _placement(self, line: int, row: dict[str, str]) -> int:
        """Return the number of an object's placement; 1 for an empty cell."""
        text = row.get(_PLACEMENT, "").strip() or "1"
        if not (text.isascii() and text.isdigit() and int(text) > 0):
            raise self._error(
                line, _PLACEMENT, repr(text), "a whole number: 1 or an empty cell for the first placement"
            )
        if int(text) > 1 and row["role"].strip() not in ("object", DRIFT):
            found = f"{text} for a photograph of the role {row['role'].strip()}"
            raise self._error(line, _PLACEMENT, found, "an empty cell: only objects are laid down again")
        return int(text)

    def _direction(self, line: int, row: dict[str, str]) -> tuple[float, float]:
        """Return light angle and azimuth of a lamp's position, degrees; (0, 0, 0) is for dark frames and the sheet."""
        x, y, z = (self._number(line, column, row[column]) for column in _DIRECTION)
        if x == y == z == 0.0 and row["role"].strip() not in ("dark", LENS):
            raise self._error(line, ", ".join(_DIRECTION), "0, 0, 0", "where the lamp stands, from the rig's origin")
        return light_angles_deg((x, y, z))

    def _taken(self, line: int, row: dict[str, str]) -> Taken:
        texts = {name: row.get(name, "").strip() for name in ("taken_at", "camera_time", "camera", "accepted")}
        for name in ("taken_at", "camera_time"):
            try:
                if texts[name]:
                    datetime.fromisoformat(texts[name])
            except ValueError:
                accepted = "a time such as 2026-05-04T10:15:30.250+09:00, or an empty cell"
                raise self._error(line, name, repr(texts[name]), accepted) from None
        read = {
            angle: self._number(line, column, row[column])
            for angle, column in zip(_ANGLES, _READ, strict=True)
            if row.get(column, "").strip()
        }
        return Taken(texts["taken_at"], texts["camera_time"], texts["camera"], read, texts["accepted"])

    def _check_against_others(self, line: int, shot: Shot) -> None:
        first = self._lines.setdefault(posixpath.normpath(shot.file), line)
        if first != line:
            raise self._error(line, "file", f"{shot.file!r} again, as in line {first}", "each file once")
        if shot.role == "object" and self._poses.setdefault(shot.pose.name, shot.pose) != shot.pose:
            raise self._error(
                line,
                "light_deg",
                "a pose less than 0.1 degrees from another",
                "the same angles, or angles further apart",
            )
        bracket = (shot.role, shot.capture, shot.filter, shot.exposure_s)
        first = self._brackets.setdefault(bracket, line)
        if first != line and shot.role not in _REPEATED:
            raise self._error(
                line,
                "exposure_s",
                f"the capture {shot.capture}, filter {shot.filter}, with the exposure time of line {first}",
                "another exposure time for each photograph of a bracket",
            )

    def _check_file(self, line: int, shot: Shot) -> None:
        if self.folder is None:
            return
        raw = confined(self.folder, shot.file, self.path, f"line {line}, file")
        try:
            empty = not raw.is_file() or raw.stat().st_size == 0
        except OSError:
            empty = True
        if empty:
            found = "an empty file" if raw.is_file() else "no such file"
            raise self._error(line, "file", f"{found}: {raw}", "a RAW file of the camera")
        if shot.linear:
            if not is_picture(raw):
                found = f"{kind_instead_of_raw(raw) or 'no TIFF or PNG picture'}: {raw}"
                raise self._error(line, _LINEAR, found, "a TIFF or PNG picture, or an empty cell for a RAW file")
        elif kind := kind_instead_of_raw(raw):
            said = f", or yes in the column linear {IF_LINEAR}" if is_picture(raw) else ""
            raise self._error(line, "file", f"{kind}: {raw}", f"a RAW file of the camera{said}")

    def _role(self, line: int, row: dict[str, str]) -> tuple[str, str]:
        """Return the role and the name of the chart, which is empty for other roles."""
        named = _NAMED_CHART.fullmatch(row["role"].strip())
        if named:
            return named[1], named[2]
        role = self._choice(line, row, "role", ROLES)
        if role == "room-chart":
            raise self._error(line, "role", "'room-chart' without a name", "room-chart-NAME, such as room-chart-desk")
        return role, ""

    def _choice(self, line: int, row: dict[str, str], column: str, valid: tuple) -> str:
        value = row[column].strip()
        if value not in valid:
            raise self._error(line, column, repr(value), suggest(value, valid))
        return value

    def _number(self, line: int, column: str, text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        # float() also takes 1_000, which no spreadsheet writes.
        if not math.isfinite(value) or "_" in text:
            raise self._error(line, column, repr(text.strip()), "a finite number")
        return value

    def _optional(self, line: int, column: str, text: str) -> float:
        """Return a positive number, 0 for an empty cell."""
        if not text.strip():
            return 0.0
        value = self._number(line, column, text)
        if value <= 0:
            raise self._error(line, column, text.strip(), "a number above 0, or an empty cell")
        return value

    def _error(self, line: int, column: str, found: str, accepted: str) -> InputError:
        return InputError(self.path, f"line {line}, {column}", found, accepted)


def shot_cells(shot: Shot, sha256: str) -> list:
    """Return a photograph's line of a table, in the order of COLUMNS and EXTRA_COLUMNS; unknown values are empty."""
    angles = [getattr(shot.pose, angle) for angle in _ANGLES]
    row = [shot.file, shot.role if shot.role == DRIFT else shot.subject, *angles, shot.filter, shot.exposure_s]
    row += [shot.pose.light_azimuth_deg or "", shot.pose.placement if shot.pose.placement > 1 else ""]
    return [*row, shot.iso or "", shot.f_number or "", *shot.taken.cells(), sha256]


def write_captures(path, shots, sha256=None) -> None:
    """Write a table of photographs under a temporary name, and rename it when it is complete.

    Parameters
    ----------
    path : path
        CSV to write; its folder must exist.
    shots : iterable of Shot
    sha256 : dict, optional
        {``Shot.file``: hexadecimal SHA-256}; without it the cells are empty.

    Raises
    ------
    KeyError
        If `sha256` lacks a file.
    """
    with written_whole(path) as temporary, open(temporary, "w", encoding="utf-8", newline="") as out:
        writer = csv.writer(out, lineterminator="\n")
        shots = list(shots)
        linear, levels = any(shot.linear for shot in shots), any(shot.light_level != 1.0 for shot in shots)
        writer.writerow((*COLUMNS, *EXTRA_COLUMNS, *([_LINEAR] if linear else []), *([_LIGHT_LEVEL] if levels else [])))
        for shot in shots:
            cells = shot_cells(shot, "" if sha256 is None else sha256[shot.file])
            cells += ["yes" if shot.linear else "no"] if linear else []
            writer.writerow([*cells, shot.light_level] if levels else cells)
