"""Parts of definitions: what a rule hands on where a change of another key is to rerun nothing.

The Snakefile gives them as plain parameters, see `irodori.config.photograph_sets` and `irodori.config.scene_files`; a
script makes them with ``of``.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from irodori.config.definition import Definition, typed
from irodori.config.models import (
    Body,
    CalibrationOptions,
    Camera,
    Chart,
    DisplayOptions,
    EnvironmentSource,
    Exposures,
    GivenFilter,
    GivenSensitivities,
    LevelPatch,
    Object,
    ObjectShape,
    PlacedObject,
    PoseGroup,
    PosePlan,
    RefractiveIndex,
    Rig,
    SceneLight,
    SensorOptions,
    Size,
    VirtualObject,
)


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class PhotographedObject(Definition):
    """Parts of an object's definition that its photographs depend on."""

    shape: ObjectShape
    refractive_index: RefractiveIndex
    mirror_weight: float
    poses: tuple[PoseGroup, ...] | None = None
    exposure_s: Exposures | None = None
    virtual: VirtualObject | None = None
    level_patch: LevelPatch | None = None


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class TexturedObject(Definition):
    """Parts of an object's definition that the observations of its texels depend on."""

    shape: ObjectShape
    texels: Size


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class Surface(Definition):
    """Parts of an object's definition that its maps need beside the fitted parameters."""

    texels: Size
    refractive_index: RefractiveIndex
    mirror_weight: float


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class PlannedObject(Definition):
    """Parts of an object's definition that the planning of poses depends on."""

    shape: ObjectShape
    refractive_index: RefractiveIndex
    plan: PosePlan
    lobes: tuple[str, ...] = Object.lobes


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class PlannedPlate(Definition):
    """A plate, its rig and its camera's sensor (None of a real one), for the simulation of poses.

    Exposure times are those without the filter, in seconds; ``shots_per_pose`` counts both filter states.
    """

    definition: PlannedObject
    rig: Rig
    sensor: SensorOptions | None = None
    exposures_s: tuple[float, ...] = ()
    shots_per_pose: int = 1


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class ImperfectObject(Definition):
    """A virtual object with its camera and its rig, on which the rig's faults are measured."""

    name: str
    definition: Object
    camera: Camera
    rig: Rig


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class Subject(Definition):
    """An object of a scene: its shape, and the side of a sample of its photographs on it, mm."""

    shape: ObjectShape
    sample_mm: float


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class CalibratedCamera(Definition):
    """Parts of a camera's definition that its calibration depends on."""

    chart: Chart
    further_charts: Mapping[str, Chart] = field(default_factory=dict, hash=False)
    calibration: CalibrationOptions = field(default_factory=CalibrationOptions)
    comb_filter: GivenFilter | None = None
    sensitivities: GivenSensitivities | None = None


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class RigGeometry(Definition):
    """Distances of a rig, mm: to the camera's entrance pupil, of the lamp (None if far), half the table's side."""

    camera_distance_mm: float
    table_radius_mm: float = 0.0
    lamp_distance_mm: float | None = None

    @classmethod
    def of_rig(cls, rig: Rig) -> "RigGeometry":
        """Return the distances of a rig."""
        return cls(
            camera_distance_mm=rig.camera_distance_mm,
            table_radius_mm=rig.table_radius_mm,
            lamp_distance_mm=rig.light.distance_mm,
        )


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class SceneRadiance(Definition):
    """The file of what a virtual camera sees of a scene."""

    radiance: str


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class Staging(Definition):
    """Contents of a scene and its display: all of its definition but views and environment."""

    objects: tuple[PlacedObject, ...] = ()
    bodies: tuple[Body, ...] = ()
    lights: tuple[SceneLight, ...] = ()
    display: DisplayOptions = field(default_factory=DisplayOptions)


def typed_shapes(shapes: Sequence[Mapping[str, Any]]) -> list[ObjectShape]:
    """Return the shapes of a scene's objects."""
    return [typed(ObjectShape, shape) for shape in shapes]


def typed_index(index: Mapping[str, Any]) -> RefractiveIndex:
    """Return a refractive index."""
    return typed(RefractiveIndex, index)


def typed_source(source: Mapping[str, Any]) -> EnvironmentSource:
    """Return where an environment's light comes from."""
    return typed(EnvironmentSource, source)
