"""Parts of definitions: parameters of rules that do not rerun when other keys of a definition change.

The Snakefile passes them as plain values, see `irodori.config.photograph_sets` and `irodori.config.scene_files`; a
script converts these back with ``of``.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from irodori.config.definition import Definition, typed
from irodori.config.models import (
    Body,
    CalibrationOptions,
    Camera,
    CameraDriver,
    CameraPoses,
    Chart,
    DisplayOptions,
    EnvironmentSource,
    Exposures,
    FurtherPlacement,
    GivenFilter,
    GivenSensitivities,
    LevelPatch,
    Markers,
    Object,
    ObjectShape,
    Optics,
    PlacedObject,
    PoseGroup,
    PosePlan,
    RefractiveIndex,
    Rig,
    RigPose,
    SceneLight,
    Sheet,
    Size,
    VirtualCameraOptions,
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
    markers: Markers | None = None
    placements: tuple[FurtherPlacement, ...] = ()


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class PhotographingCamera(Definition):
    """Parts of a camera's definition that photographs of objects, places and scenes depend on."""

    rig: str
    optics: Optics | None = None
    poses: CameraPoses | None = None
    driver: CameraDriver | None = None
    virtual: VirtualCameraOptions | None = None


#: A camera that takes photographs; those of charts and of the white reference need the whole definition.
AnyCamera = Camera | PhotographingCamera


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class TrueObject(Definition):
    """Parts of a virtual object's definition that its true material depends on."""

    shape: ObjectShape
    texels: Size
    refractive_index: RefractiveIndex
    mirror_weight: float
    virtual: VirtualObject | None = None
    sheet: Sheet | None = None


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class TexturedObject(Definition):
    """Parts of an object's definition that the observations of its texels depend on."""

    shape: ObjectShape
    texels: Size
    placements: tuple[FurtherPlacement, ...] = ()
    sheet: Sheet | None = None


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class Surface(Definition):
    """Parts of an object's definition that its material maps need in addition to the fitted parameters."""

    texels: Size
    refractive_index: RefractiveIndex
    mirror_weight: float
    sheet: Sheet | None = None


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class PlannedObject(Definition):
    """Parts of an object's definition that the planning of poses depends on."""

    shape: ObjectShape
    refractive_index: RefractiveIndex
    plan: PosePlan
    lobes: tuple[str, ...] = Object.lobes
    placements: tuple[FurtherPlacement, ...] = ()


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class Subject(Definition):
    """Object of a scene: its shape, and the side of a photograph's sample projected on it, mm."""

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
    """Lengths of a rig, mm: distance of the camera's entrance pupil and of the lamp (None if far), half table side."""

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
class NearLamp(Definition):
    """Near lamp of a rig, with the pose of the white reference that it lit and the optics of the camera."""

    optics: Optics
    rig: RigGeometry
    white_pose: RigPose


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class SceneRadiance(Definition):
    """File of the radiance that a virtual camera receives from a scene."""

    radiance: str


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class Staging(Definition):
    """Contents of a scene and its display: all of its definition but views and environment."""

    objects: tuple[PlacedObject, ...] = ()
    bodies: tuple[Body, ...] = ()
    lights: tuple[SceneLight, ...] = ()
    display: DisplayOptions = field(default_factory=DisplayOptions)


def typed_shapes(shapes: Sequence[Mapping[str, Any]]) -> list[ObjectShape]:
    """Return the shapes of a scene's objects from their plain forms."""
    return [typed(ObjectShape, shape) for shape in shapes]


def typed_index(index: Mapping[str, Any]) -> RefractiveIndex:
    """Return a refractive index from its plain form."""
    return typed(RefractiveIndex, index)


def typed_source(source: Mapping[str, Any]) -> EnvironmentSource:
    """Return the source of an environment's light from its plain form."""
    return typed(EnvironmentSource, source)
