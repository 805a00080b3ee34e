"""What no schema sees: that definitions agree with each other, and that the files they name are there."""

import math
from pathlib import Path

from irodori.captures import Shot, expand_poses, read_captures
from irodori.errors import InputError
from irodori.tables import column_table, index_table, wide_table
from irodori.validation import dotted

#: Keys whose value is either a published name or the path of a file.
_NAME_OR_PATH = ("spectrum", "spectra", "sensitivities", "ambient_light", "lights")
_FILE_SUFFIXES = (".csv", ".txt", ".ti3")
_ANGLE_TOLERANCE_DEG = 1e-6


def check_agreement(definitions: dict, root: Path, config_file, file) -> None:
    """Check a configuration and its definitions against each other.

    Parameters
    ----------
    definitions : dict
        Validated, of the layout that `irodori.config.load_definitions` returns.
    root : path
        Where relative paths start.
    config_file : path
        Where the configuration came from, for the error message.
    file : callable
        ``file(kind, name)`` is the path of a definition, for the error message.

    Raises
    ------
    InputError
        For the first fault.
    """
    _check_bounds(definitions, config_file)
    _check_named_files(definitions["report"], ("report",), root, config_file)
    checks = _Checks(definitions, root, file)
    order = {
        "rigs": checks.rig,
        "cameras": checks.camera,
        "environments": checks.environment,
        "objects": checks.object,
        "scenes": checks.scene,
    }
    for kind, check in order.items():
        for name in definitions[kind]:
            check(name)


def rig_of(definitions: dict, kind: str, name: str) -> str:
    """Return the name of the rig that photographs an object, an environment or a camera's chart."""
    definition = definitions[kind][name]
    camera = definition if kind == "cameras" else definitions["cameras"][definition["camera"]]
    return camera["rig"]


def table_and_folder(definition: dict, root: Path) -> tuple[Path, Path]:
    """Return the table of a set of photographs of a real rig and the folder of its RAW files."""
    table = root / definition["captures"]["table"]
    return table, root / definition["captures"].get("folder", table.parent)


class _Checks:
    """One check for each kind of definition."""

    def __init__(self, definitions: dict, root: Path, file) -> None:
        self.all, self.root, self.file = definitions, root, file

    def rig(self, name: str) -> None:
        file, rig = self.file("rigs", name), self.all["rigs"][name]
        for axis, limit in rig["limits"].items():
            if limit["min"] > limit["max"]:
                found = f"{limit['min']:g}, above max {limit['max']:g}"
                raise InputError(file, f"limits.{axis}.min", found, "a smallest angle below the largest")
        _check_named_files(rig, (), self.root, file)

    def camera(self, name: str) -> None:
        file, camera = self.file("cameras", name), self.all["cameras"][name]
        if self._is_virtual("cameras", name):
            for key in ("virtual", "optics", "white", "poses", "exposure_s"):
                self._require(camera, key, file, "virtual")
            self._require(camera["poses"], "white", file, "virtual", "poses.white")
            black, bits = camera["virtual"]["sensor"]["black_level"], camera["virtual"]["sensor"]["bits"]
            if black >= 2**bits - 1:
                raise InputError(file, "virtual.sensor.black_level", str(black), f"below {2**bits - 1} for {bits} bits")
        else:
            self._check_table(camera, file, "chart")
        for role, pose in camera.get("poses", {}).items():
            for axis, angle in pose.items():
                self._check_angle(camera["rig"], axis, angle, file, f"poses.{role}.{axis}")
        _check_named_files(camera, (), self.root, file)

    def environment(self, name: str) -> None:
        file, environment = self.file("environments", name), self.all["environments"][name]
        if self._is_virtual("environments", name):
            for key in ("virtual", "exposure_s"):
                self._require(environment, key, file, "virtual")
            self._check_filters(environment, file)
        else:
            self._check_table(environment, file, "environment")
        _check_named_files(environment, (), self.root, file)

    def object(self, name: str) -> None:
        file, definition = self.file("objects", name), self.all["objects"][name]
        camera = self.all["cameras"][definition["camera"]]
        if "optics" not in camera:
            found = f"the camera {definition['camera']!r} without optics"
            accepted = f"a camera whose file gives optics ({self.file('cameras', definition['camera'])})"
            raise InputError(file, "camera", found, accepted)
        if self._is_virtual("objects", name):
            for key in ("virtual", "poses", "exposure_s"):
                self._require(definition, key, file, "virtual")
            self._check_filters(definition, file)
        else:
            shots = self._check_table(definition, file, "object")
            self._check_object_shots(shots, camera["rig"], definition["captures"]["table"])
        self._check_poses(definition.get("poses", []), camera["rig"], file)
        if index := definition["refractive_index"].get("file"):
            if not (self.root / index).is_file():
                raise InputError(
                    file, "refractive_index.file", f"no such file: {index}", "a CSV of wavelength_nm, n, k"
                )
            index_table(self.root / index)
        _check_named_files(definition, (), self.root, file)

    def scene(self, name: str) -> None:
        file, scene = self.file("scenes", name), self.all["scenes"][name]
        for label, view in scene["views"].items():
            forward = [b - a for a, b in zip(view["position_mm"], view["target_mm"], strict=True)]
            if not any(forward):
                raise InputError(file, f"views.{label}.target_mm", "the eye's own position", "another point")
            (a, b, c), (d, e, f) = forward, view["up"]
            across = math.hypot(b * f - c * e, c * d - a * f, a * e - b * d)
            if across <= 1e-9 * math.hypot(a, b, c) * max(1.0, math.hypot(d, e, f)):
                found = f"{view['up']}, along the line of sight or of no length"
                raise InputError(file, f"views.{label}.up", found, "a direction that points up in the picture")

    def _is_virtual(self, kind: str, name: str) -> bool:
        return self.all["rigs"][rig_of(self.all, kind, name)]["kind"] == "virtual"

    def _require(self, block: dict, key: str, file, kind: str, field: str = "") -> None:
        if key not in block:
            raise InputError(file, field or key, "no such key", f"this key, because the rig is of kind {kind}")

    def _check_filters(self, definition: dict, file) -> None:
        """Refuse other filter states than those of the chart, for which alone the calibration holds."""
        camera = definition["camera"]
        given, wanted = set(definition["exposure_s"]), set(self.all["cameras"][camera]["exposure_s"])
        if given != wanted:
            found, accepted = ", ".join(sorted(given)), ", ".join(sorted(wanted))
            accepted += f", as in {self.file('cameras', camera)}"
            raise InputError(file, "exposure_s", f"the filter states {found}", accepted)

    def _check_table(self, definition: dict, file, role: str) -> list[Shot]:
        """Return the shots of a role, the table and all files that it names being there."""
        self._require(definition, "captures", file, "files")
        table, folder = table_and_folder(definition, self.root)
        if not table.is_file():
            raise InputError(
                file,
                "captures.table",
                f"no such file: {definition['captures']['table']}",
                "a CSV that lists the photographs",
            )
        shots = read_captures(table, folder)
        wanted = [shot for shot in shots if shot.role == role]
        if not wanted:
            roles = ", ".join(sorted({shot.role for shot in shots}))
            raise InputError(table, "role", f"only {roles}", f"one photograph or more of the role {role}")
        without = {shot.capture: True for shot in wanted}
        without.update((shot.capture, False) for shot in wanted if shot.filter == "out")
        for capture, lacking in without.items():
            if lacking:
                raise InputError(
                    table,
                    "filter",
                    f"the capture {capture} only with the filter in",
                    "each capture with the filter out as well",
                )
        return wanted

    def _check_object_shots(self, shots: list[Shot], rig: str, table: str) -> None:
        for shot in shots:
            for axis in ("light_deg", "camera_deg", "tilt_deg", "turn_deg"):
                # Angles of a real rig are read, not set: they need not stand on its steps.
                self._check_angle(rig, axis, getattr(shot.pose, axis), table, f"{axis} of {shot.file}", step=False)

    def _check_poses(self, groups: list[dict], rig: str, file) -> None:
        for index, group in enumerate(groups):
            for axis, angles in group.items():
                for item, angle in enumerate(angles):
                    self._check_angle(rig, axis, angle, file, f"poses[{index}].{axis}[{item}]")
        try:
            expand_poses(groups)
        except ValueError as error:
            raise InputError(file, "poses", str(error), "each pose once, at least 0.1 degrees apart") from None

    def _check_angle(self, rig: str, axis: str, angle: float, file, field: str, step: bool = True) -> None:
        limit = self.all["rigs"][rig]["limits"][axis]
        low, high, unit = limit["min"], limit["max"], limit["step"]
        off = abs((angle - low) - round((angle - low) / unit) * unit)
        inside = low - _ANGLE_TOLERANCE_DEG <= angle <= high + _ANGLE_TOLERANCE_DEG
        if not inside or (step and off > _ANGLE_TOLERANCE_DEG):
            steps = f" in steps of {unit:g}" if step else ""
            accepted = f"{low:g} to {high:g} degrees{steps} ({self.file('rigs', rig)}, limits.{axis})"
            raise InputError(file, field, f"{angle:.10g}", accepted)


def _check_bounds(config: dict, file) -> None:
    for name, (low, high) in config["fit"]["bounds"].items():
        if not low < high:
            raise InputError(file, f"fit.bounds.{name}", f"[{low:g}, {high:g}]", "the smaller value first")


def _check_named_files(value, path: tuple, root: Path, file) -> None:
    """Refuse a spectrum that looks like a path where no whole table of spectra stands there."""
    if isinstance(value, dict):
        for key, item in value.items():
            _check_named_files(item, (*path, key), root, file)
    elif isinstance(value, list):
        for index, item in enumerate(value):
            _check_named_files(item, (*path, index), root, file)
    # The last key, or that of the list which the value stands in.
    elif any(key in _NAME_OR_PATH for key in path[-2:]) and _is_path(value):
        if not (root / value).is_file():
            raise InputError(file, dotted(path), f"no such file: {value}", "the path of a file, or a published name")
        (column_table if "sensitivities" in path else wide_table)(root / value)


def _is_path(text) -> bool:
    return isinstance(text, str) and (text.lower().endswith(_FILE_SUFFIXES) or "/" in text or "\\" in text)
