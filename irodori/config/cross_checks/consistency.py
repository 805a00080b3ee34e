"""Cross-file configuration checks: references between definitions, and files that they name."""

import os
from collections.abc import Mapping
from pathlib import Path

from irodori.config.capture_table import FILTERS, LENS, Shot
from irodori.config.cross_checks.captures_on_rig import (
    Reach,
    by_chart,
    check_incidence,
    check_one_pose,
    check_room_charts,
    check_sheet,
    check_states,
    of_role,
    read_table,
    states_of,
    table_and_folder,
)
from irodori.config.cross_checks.display_files import check_display
from irodori.config.cross_checks.environment_sources import check_placed_charts, check_source, is_photographed
from irodori.config.cross_checks.lessons import check_lesson
from irodori.config.cross_checks.named_spectra import check_chart, check_filter, check_index, check_spectra
from irodori.config.cross_checks.object_lobes import check_coat, check_lobes
from irodori.config.cross_checks.object_placements import check_all_placed, check_not_flat, check_placements
from irodori.config.cross_checks.plan_overrides import check_plan
from irodori.config.cross_checks.plausible_units import check_in_frame, check_lamp_outside
from irodori.config.cross_checks.rig_motion import check_motion
from irodori.config.cross_checks.scene_photographs import check_aim, check_photograph
from irodori.config.cross_checks.thin_sheets import check_thin_sheet, check_thin_sheets
from irodori.config.loaded import Loaded
from irodori.config.models import (
    Camera,
    Captures,
    Config,
    InteractiveIntegrator,
    LightSweep,
    MeasuredMaterial,
    MirrorBallSource,
    PerspectiveView,
    RigPose,
)
from irodori.config.orcid import orcid_fault
from irodori.core.errors import InputError, is_file
from irodori.geometry.mesh_sources import shape_files
from irodori.spectra.tables import brdf_table

#: Folders that stand in results/ beside those of objects and scenes.
_RESERVED = ("benchmark", "benchmarks", "cameras", "environments", "logs", "rig")
_BANDS_OF_A_STATE = 3
#: Keys that not every kind of rig uses, and below those that a definition must have for each kind of rig.
_TAKEN_HERE = ("poses", "exposure_s", "dark_frames", "white_frames", "linearity_exposure_s")
_ONLY_SOME = (*_TAKEN_HERE, "virtual", "driver", "captures")
_NEEDED: dict[str, dict[str, tuple[str, ...]]] = {
    "virtual": {
        "cameras": ("virtual", "optics", "white", "poses", "exposure_s"),
        "environments": ("virtual", "exposure_s"),
        "objects": ("virtual", "poses", "exposure_s"),
    },
    "driven": {
        "cameras": ("driver", "captures", "white", "poses", "exposure_s"),
        "environments": ("captures",),
        "objects": ("captures", "poses", "exposure_s"),
    },
    "files": dict.fromkeys(("cameras", "environments", "objects"), ("captures",)),
}


def _accepted_keys(rig_kind: str, kind: str) -> tuple[str, ...]:
    """Return the keys of ``_ONLY_SOME`` that a definition may have."""
    needed = _NEEDED[rig_kind][kind]
    return needed if "exposure_s" not in needed else (*needed, *_TAKEN_HERE)


def check_agreement(loaded: Loaded, root: Path, config_file, file, *, photographs: bool = True) -> None:
    """Check a configuration and its definitions against each other.

    Parameters
    ----------
    loaded : Loaded
    root : path
        Folder at which relative paths start.
    config_file : path
        File of the configuration, for the error message.
    file : callable
        ``file(kind, name)`` is the path of a definition, for the error message.
    photographs : bool
        Whether tables of photographs that a person takes must already exist.

    Raises
    ------
    InputError
        For the first fault.
    """
    _check_bounds(loaded.config, config_file)
    _check_orcid(loaded.config, config_file)
    _check_names(loaded, file)
    _check_together(loaded, config_file)
    check_spectra(loaded.config.report, ("report",), root, config_file)
    checks = _Checks(loaded, root, file, photographs)
    order = {
        "rigs": checks.rig,
        "cameras": checks.camera,
        "environments": checks.environment,
        "objects": checks.object,
        "scenes": checks.scene,
    }
    for kind, check in order.items():
        for name in getattr(loaded, kind):
            check(name)
    checks.folders()


class _Checks:
    """Checks of loaded definitions, with one method for each kind."""

    def __init__(self, loaded: Loaded, root: Path, file, photographs: bool) -> None:
        self.all, self.root, self.file, self.photographs = loaded, root, file, photographs
        #: Table and chart photographs of each camera of a real rig.
        self.charts: dict[str, tuple[Path, list[Shot]]] = {}

    def rig(self, name: str) -> None:
        file, rig = self.file("rigs", name), self.all.rigs[name]
        for axis, limit in rig.limits.given().items():
            if limit.min > limit.max:
                found = f"{limit.min:g}, above max {limit.max:g}"
                raise InputError(file, f"limits.{axis}.min", found, "a smallest angle below the largest")
        if rig.kind == "driven" and rig.limits.light_azimuth_deg is not None:
            found, accepted = "given for a driven rig", "to leave it out: its lamp stands in the rig's plane"
            raise InputError(file, "limits.light_azimuth_deg", found, accepted)
        check_motion(rig, file)
        if rig.operator == "auto" and rig.kind != "virtual":
            raise InputError(file, "operator", "auto, which only a virtual rig can follow", "prompt or file")
        check_spectra(rig, (), self.root, file)

    def camera(self, name: str) -> None:
        file, camera = self.file("cameras", name), self.all.cameras[name]
        self._check_keys("cameras", name)
        if self._is_taken_here("cameras", name):
            self._check_session(camera, file)
            states = states_of(camera.exposure_s)
        elif self._is_to_come(camera.captures):
            states = set(FILTERS)
        else:
            self._check_chart_and_white(name, camera, file)
            states = {shot.filter for shot in self.charts[name][1]}
        bands, calibration = _BANDS_OF_A_STATE * len(states), camera.calibration
        bases = calibration.bases
        # The other estimators use more than the responses: they may have more bases than there are bands.
        if calibration.estimator == "pinv" and isinstance(bases, int) and bases > bands:
            listed = ", ".join(sorted(states))
            accepted = f"1 to {bands}, {_BANDS_OF_A_STATE} for each filter state of the chart ({listed})"
            raise InputError(file, "calibration.bases", str(bases), accepted)
        check_spectra(camera, (), self.root, file)
        if camera.comb_filter is not None:
            check_filter(camera.comb_filter, self.root, file)
        check_chart(camera.chart, self.root, file)
        for chart, definition in camera.further_charts.items():
            check_chart(definition, self.root, file, f"further_charts.{chart}")

    def environment(self, name: str) -> None:
        file, environment = self.file("environments", name), self.all.environments[name]
        check_source(environment, self.root, file)
        if not is_photographed(environment):
            check_spectra(environment, (), self.root, file)
            return
        if isinstance(environment.source, MirrorBallSource) and self.all.is_virtual("environments", name):
            accepted = "captures: the virtual rig photographs its room from every direction itself"
            raise InputError(file, "source.kind", "mirror_ball on a rig of kind virtual", accepted)
        self._check_keys("environments", name)
        if self._is_taken_here("environments", name):
            self._check_exposures("environments", name)
        else:
            self._check_photographs("environments", name)
        self._check_white_of_place(environment.camera, file)
        for chart, definition in environment.room_charts.items():
            check_chart(definition, self.root, file, f"room_charts.{chart}")
        if environment.virtual is not None:
            check_placed_charts(environment, environment.virtual, file)
        check_spectra(environment, (), self.root, file)

    def _check_white_of_place(self, name: str | None, file: str) -> None:
        """Refuse a place whose white reference was lit by a near lamp, if no optics tell how much at each pixel."""
        assert name is not None  # of a place that is photographed
        camera = self.all.cameras[name]
        near = self.all.rigs[camera.rig].light.distance_mm is not None
        if near and camera.white is not None and camera.optics is None:
            found = f"the camera {name!r} without optics, whose white reference a near lamp (light.distance_mm) lit"
            accepted = f"a camera whose file gives optics ({self.file('cameras', name)})"
            raise InputError(file, "camera", found, accepted)

    def object(self, name: str) -> None:
        file, definition = self.file("objects", name), self.all.objects[name]
        camera = self.all.cameras[definition.camera]
        if camera.optics is None:
            found = f"the camera {definition.camera!r} without optics"
            accepted = f"a camera whose file gives optics ({self.file('cameras', definition.camera)})"
            raise InputError(file, "camera", found, accepted)
        distance_mm, rig_file = self.all.rigs[camera.rig].camera_distance_mm, self.file("rigs", camera.rig)
        check_in_frame(definition.shape, camera.optics, distance_mm, file, rig_file)
        lamp_distance_mm = self.all.rigs[camera.rig].light.distance_mm
        if lamp_distance_mm is not None:
            check_lamp_outside(definition.shape, lamp_distance_mm, rig_file)
        check_not_flat(definition, file)
        self._check_keys("objects", name)
        if self._is_taken_here("objects", name):
            self._check_exposures("objects", name)
            self._reach(camera).check_poses(definition.poses or (), file)
            for index, group in enumerate(definition.poses or ()):
                check_placements(definition, group.placement, file, f"poses[{index}].placement", file)
            check_all_placed(definition, {n for group in definition.poses or () for n in group.placement}, file)
            for material in definition.virtual.materials if definition.virtual else ():
                if isinstance(material, MeasuredMaterial):
                    brdf_table(self.root / material.file)
        elif not (self._is_to_come(definition.captures) or self._is_to_come(camera.captures)):
            table, shots = self._check_photographs("objects", name)
            self._reach(camera).check_shots(shots, table)
            numbers = {shot.pose.placement: shot for shot in shots if shot.role == "object"}
            for number, shot in numbers.items():
                check_placements(definition, [number], table, f"placement of {shot.file}", file)
            check_all_placed(definition, set(numbers), file)
        shape_files(definition.shape, self.root)
        check_index(definition.refractive_index, self.root, file, "refractive_index")
        check_lobes(definition, self.all.config.fit, file)
        check_thin_sheet(definition, file)
        check_coat(definition, file)
        if definition.markers is not None and not self.all.config.place.register:
            found = "given, though place.register is false and nothing reads it"
            raise InputError(file, "markers", found, "place.register: true in the configuration, or no markers")
        for key in ("alpha", "beta", "mu_rad"):
            low, high = getattr(definition.plan, key)
            if low > high:
                raise InputError(file, f"plan.{key}", f"[{low:g}, {high:g}]", "the smaller value first")
        check_spectra(definition, (), self.root, file)

    def scene(self, name: str) -> None:
        file, scene = self.file("scenes", name), self.all.scenes[name]
        interactive = isinstance(scene.integrator, InteractiveIntegrator)
        for label, view in scene.views.items():
            check_aim(view, file, f"views.{label}")
            if isinstance(view, PerspectiveView) and view.lens is not None and interactive:
                found = "a lens, which the integrator interactive cannot render"
                raise InputError(file, f"views.{label}.lens", found, "integrator: {kind: reference}, or no lens")
        frames = scene.frames
        if isinstance(frames, LightSweep) and frames.turned in ("lights", "both") and not scene.lights:
            found = f"{frames.turned}, but the scene has no lights beside its environment"
            raise InputError(file, "frames.turned", found, "environment, or lights in the scene")
        check_plan(scene, file)
        check_thin_sheets(self.all, scene, file)
        check_lesson(scene, self.root, file)
        for label, placed in scene.photographs.items():
            states = self._states(placed.camera)
            check_photograph(self.all, scene, label, states, self.root, lambda kind, which=name: self.file(kind, which))
        check_display(scene.display.device, self.root, file)
        check_spectra(scene, (), self.root, file)
        for index, body in enumerate(scene.bodies):
            for key, own in (("material", body.material), ("back", body.back)):
                if own is not None:
                    check_index(own.refractive_index, self.root, file, f"bodies[{index}].{key}.refractive_index")
        strange = [light.kind for light in scene.lights if light.kind != "collimated"]
        if strange and interactive:
            found = f"a {strange[0]} light, which the integrator interactive does not trace"
            raise InputError(file, "lights", found, "integrator: {kind: reference}, or collimated lights alone")

    def folders(self) -> None:
        """Refuse a table or a folder that two sessions would use: their photographs have the same names."""
        taken: dict[tuple[str, Path], Path] = {}
        for kind in ("cameras", "objects"):
            for name, definition in getattr(self.all, kind).items():
                captures: Captures | None = definition.captures
                if not self._is_taken_here(kind, name) or captures is None:
                    continue
                places = zip(("table", "folder"), table_and_folder(captures, self.root), strict=True)
                for key, path in places:
                    first = taken.setdefault((key, Path(os.path.normpath(path))), self.file(kind, name))
                    if first != self.file(kind, name):
                        field = f"captures.{key}" if key in captures.given() else "captures.table"
                        found = f"{path.relative_to(self.root) if path.is_relative_to(self.root) else path}"
                        accepted = f"a {key} of its own: {first} has this one"
                        raise InputError(self.file(kind, name), field, found, accepted)

    def _states(self, camera: str) -> set[str]:
        """Return the filter states of a camera's chart."""
        if camera in self.charts:
            return {shot.filter for shot in self.charts[camera][1]}
        return states_of(self.all.cameras[camera].exposure_s)

    def _is_taken_here(self, kind: str, name: str) -> bool:
        """Whether the workflow itself takes the photographs, rather than reading those of a person."""
        return "exposure_s" in _NEEDED[self.all.rig_of(kind, name).kind][kind]

    def _is_to_come(self, captures: Captures | None) -> bool:
        """Whether a table of photographs does not exist yet, and need not, because they are only planned."""
        assert captures is not None  # checked: photographs that others take have a table
        return not self.photographs and not is_file(table_and_folder(captures, self.root)[0])

    def _reach(self, camera: Camera) -> Reach:
        return Reach(self.all.rigs[camera.rig].limits, self.file("rigs", camera.rig))

    def _check_keys(self, kind: str, name: str) -> None:
        """Refuse a definition that lacks keys required for its kind of rig, or has keys that this kind does not use."""
        file, given = self.file(kind, name), self.all.photographed(kind, name).given()
        rig = self.all.rig_of(kind, name).kind
        for key in _NEEDED[rig][kind]:
            _require(given, key, file, rig)
        accepted = _accepted_keys(rig, kind)
        for key in _ONLY_SOME:
            if key in given and key not in accepted:
                rig_file = self.file("rigs", self.all.cameras[self.all.camera_of(kind, name)].rig)
                found = f"a key that a rig of kind {rig} does not use"
                raise InputError(file, key, found, f"to leave it out ({rig_file} is of kind {rig})")

    def _check_session(self, camera: Camera, file) -> None:
        """Check the session of the workflow that takes a camera's calibration photographs."""
        poses: dict[str, RigPose] = camera.poses.given() if camera.poses else {}
        _require(poses, "white", file, self.all.rigs[camera.rig].kind, "poses.white")
        if camera.virtual is not None:
            black, bits = camera.virtual.sensor.black_level, camera.virtual.sensor.bits
            if black >= 2**bits - 1:
                raise InputError(file, "virtual.sensor.black_level", str(black), f"below {2**bits - 1} for {bits} bits")
        reach = self._reach(camera)
        for role, pose in poses.items():
            for axis, angle in pose.given().items():
                reach.check_angle(axis, angle, file, f"poses.{role}.{axis}")
            check_incidence(pose, file, f"poses.{role}.light_deg")

    def _check_chart_and_white(self, name: str, camera: Camera, file) -> None:
        """Check the user's calibration photographs of a camera; a camera in use needs a white reference."""
        table, shots = read_table(camera.captures, self.root, file)
        photographed = of_role(shots, "chart", table)
        charts = by_chart(photographed, camera.further_charts, table, file)
        self.charts[name] = table, charts[0]
        states = self._states(name)
        check_states(photographed, table, states, table)
        check_sheet([shot for shot in shots if shot.role == LENS], camera, table, file)
        user = self._user_of(name)
        whites = [shot for shot in shots if shot.role == "white"]
        if user and not whites:
            found = f"no photograph of the role white, though {user} is photographed with this camera"
            raise InputError(table, "role", found, "the white reference in every filter state of the chart")
        if whites:
            check_states(whites, table, states, table)
            if camera.white is None:
                found = f"no such key, though {table} lists photographs of the role white"
                raise InputError(file, "white", found, "white: {reflectance_factor: ...} of the white reference")
        for group in filter(None, ([shot for chart in charts for shot in chart], whites)):
            self._reach(camera).check_shots(group, table)
            check_one_pose(group, table)

    def _user_of(self, camera: str) -> Path | None:
        """Return the file of an object, environment or scene that a camera photographs; None if there is none."""
        for kind in ("objects", "environments"):
            for name, definition in getattr(self.all, kind).items():
                if definition.camera == camera:
                    return self.file(kind, name)
        for name, scene in self.all.scenes.items():
            if any(placed.camera == camera for placed in scene.photographs.values()):
                return self.file("scenes", name)
        return None

    def _check_exposures(self, kind: str, name: str) -> None:
        """Refuse exposures in other filter states than those of the chart, for which the calibration is valid."""
        file, camera = self.file(kind, name), self.all.camera_of(kind, name)
        given, wanted = states_of(self.all.photographed(kind, name).exposure_s), self._states(camera)
        if given != wanted:
            found, accepted = ", ".join(sorted(given)), ", ".join(sorted(wanted))
            accepted += f", as in {self.file('cameras', camera)}"
            raise InputError(file, "exposure_s", f"the filter states {found}", accepted)

    def _check_photographs(self, kind: str, name: str) -> tuple[Path, list[Shot]]:
        """Check the user's photographs of an object or an environment; return their table and the photographs."""
        table, shots = read_table(self.all.photographed(kind, name).captures, self.root, self.file(kind, name))
        wanted, camera = of_role(shots, kind.removesuffix("s"), table), self.all.camera_of(kind, name)
        chart_file = self.charts[camera][0] if camera in self.charts else self.file("cameras", camera)
        if kind == "environments":
            file, charts = self.file(kind, name), self.all.environments[name].room_charts
            wanted = [*wanted, *check_room_charts(shots, charts, table, file)]
        check_states(wanted, table, self._states(camera), chart_file)
        return table, wanted


def _require(block: Mapping, key: str, file, kind: str, field: str = "") -> None:
    if key not in block:
        raise InputError(file, field or key, "no such key", f"this key, because the rig is of kind {kind}")


def _check_orcid(config: Config, file) -> None:
    orcid = config.publication.photographer_orcid
    if orcid is not None and (fault := orcid_fault(orcid)):
        raise InputError(file, "publication.photographer_orcid", f"{orcid}, {fault}", "an ORCID as orcid.org shows it")


def _check_bounds(config: Config, file) -> None:
    for name, (low, high) in config.fit.bounds.given().items():
        if not low < high:
            raise InputError(file, f"fit.bounds.{name}", f"[{low:g}, {high:g}]", "the smaller value first")


def _check_together(loaded: Loaded, file) -> None:
    """Refuse an object in two sets that were photographed together, and a set with two cameras."""
    seen: dict[str, int] = {}
    for number, names in enumerate(loaded.config.photographed_together):
        for index, name in enumerate(names):
            key = f"photographed_together[{number}][{index}]"
            if seen.setdefault(name, number) != number:
                found = f"{name}, which photographed_together[{seen[name]}] has as well"
                raise InputError(file, key, found, "each object in one set at most")
            if name not in loaded.objects or names[0] not in loaded.objects:
                continue
            first, own = (loaded.objects[one].camera for one in (names[0], name))
            if own != first:
                found = f"{name} by the camera {own}, where {names[0]} is by {first}"
                raise InputError(file, key, found, "objects that one camera photographed")


def _check_names(loaded: Loaded, file) -> None:
    """Refuse objects and scenes with a folder in results/ that something else uses."""
    for kind, names in (("objects", loaded.objects), ("scenes", loaded.scenes)):
        for name in names:
            if name in _RESERVED:
                accepted = f"another name of the file: results/{name} serves all (so do {', '.join(_RESERVED)})"
                raise InputError(file(kind, name), "", f"the reserved name {name!r}", accepted)
    for name in loaded.scenes:
        if name in loaded.objects:
            found = f"the name {name!r}, which {file('objects', name)} has as well"
            accepted = f"another name of one of the files: both write into results/{name}"
            raise InputError(file("scenes", name), "", found, accepted)
