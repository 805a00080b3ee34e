"""Animation state of a frame: rotations of objects, eye, lights and environment, and the light's colour.

All four are rotated about one vertical axis, so that only the differences of their angles matter: adding the same angle
to all leaves the picture unchanged. An integrator that cannot rotate one of them uses the equivalent moment in which
that part is not rotated, see `Moment.seen_from`.
"""

from dataclasses import replace
from typing import NamedTuple, TypeVar

import numpy as np

from irodori.config.models import Body, CollimatedLight, PlacedObject, RectangleLight, Scene, SceneLight, View
from irodori.geometry.rig_frame import rotation_z
from irodori.light.environment_file import Environment
from irodori.rendering.scene_lights import Lights


class Moment(NamedTuple):
    """State of a scene in one frame: rotations relative to its definition, degrees from +x towards +y, and a filter."""

    objects_deg: float = 0.0
    eye_deg: float = 0.0
    lights_deg: float = 0.0
    environment_deg: float = 0.0
    pivot_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    filter: tuple[float, ...] | None = None  # (61,) factor on all light

    def seen_from(self, part: str) -> "Moment":
        """Return the equivalent moment in which a part, such as ``objects``, is not rotated."""
        angle = getattr(self, f"{part}_deg")
        parts = ("objects_deg", "eye_deg", "lights_deg", "environment_deg")
        return self._replace(**{name: getattr(self, name) - angle for name in parts})

    def rotation(self, part: str) -> np.ndarray:
        """Return the rotation matrix of a part, such as ``objects``, (3, 3)."""
        return rotation_z(np.radians(getattr(self, f"{part}_deg")))

    def environment(self, environment: Environment) -> Environment:
        """Return an environment with this moment's filter applied, but not rotated; coefficients are not copied."""
        if self.filter is None:
            return environment
        basis = environment.basis * np.asarray(self.filter)[:, None]
        return replace(environment, basis=basis)

    def lights(self, lights: Lights) -> Lights:
        """Return lights with this moment's filter applied, but not rotated."""
        if self.filter is None:
            return lights
        spectrum = lights.spectrum.copy()
        spectrum[:, : len(self.filter)] *= np.asarray(self.filter, dtype=np.float32)
        return lights._replace(spectrum=spectrum, power=spectrum.sum(axis=1, dtype=np.float64))


#: Parts of a scene that have a position and a rotation.
Standing = TypeVar("Standing", PlacedObject, Body, RectangleLight)

#: The scene as it is defined.
STILL = Moment()


def turned_scene(scene: Scene, moment: Moment) -> Scene:
    """Return a scene's definition with rotated objects, bodies, views and lights; the environment is not rotated."""
    return replace(
        scene,
        objects=tuple(_turned_body(item, moment, "objects") for item in scene.objects),
        bodies=tuple(_turned_body(item, moment, "objects") for item in scene.bodies),
        views={name: _turned_view(view, moment) for name, view in scene.views.items()},
        lights=tuple(_turned_light(light, moment) for light in scene.lights),
    )


def _place(position_mm, moment: Moment, part: str) -> tuple[float, float, float]:
    pivot = np.asarray(moment.pivot_mm, dtype=np.float64)
    x, y, z = (moment.rotation(part) @ (np.asarray(position_mm, dtype=np.float64) - pivot) + pivot).tolist()
    return x, y, z


def _turned_body(item: Standing, moment: Moment, part: str) -> Standing:
    x_deg, y_deg, z_deg = item.rotation_deg
    # The last of the three rotations is the one about the scene's z.
    turn = (x_deg, y_deg, z_deg + getattr(moment, f"{part}_deg"))
    return replace(item, position_mm=_place(item.position_mm, moment, part), rotation_deg=turn)


def _turned_view(view: View, moment: Moment) -> View:
    x, y, z = (moment.rotation("eye") @ np.asarray(view.up, dtype=np.float64)).tolist()
    position, target = (_place(place, moment, "eye") for place in (view.position_mm, view.target_mm))
    return replace(view, position_mm=position, target_mm=target, up=(x, y, z))


def _turned_light(light: SceneLight, moment: Moment) -> SceneLight:
    if isinstance(light, CollimatedLight):
        return replace(light, azimuth_deg=light.azimuth_deg + moment.lights_deg)
    if isinstance(light, RectangleLight):
        return _turned_body(light, moment, "lights")
    return replace(light, position_mm=_place(light.position_mm, moment, "lights"))
