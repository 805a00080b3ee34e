"""Animation state of a frame: rotations of objects, eye, lights and environment, and the light's colour.

All turn about one vertical axis, so that only the angles between them are seen: a picture is the same if every angle
grows by as much. An integrator that cannot turn one of the four takes the moment as seen from it.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from irodori.geometry.rig_frame import rotation_z
from irodori.light.environment_file import Environment
from irodori.rendering.scene_lights import Lights


class Moment(NamedTuple):
    """A moment of a scene; angles in degrees from +x towards +y, against the scene's definition."""

    objects_deg: float = 0.0
    eye_deg: float = 0.0
    lights_deg: float = 0.0
    environment_deg: float = 0.0
    pivot_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    filter: tuple[float, ...] | None = None  # (61,) factor on all light

    def seen_from(self, part: str) -> "Moment":
        """Return the moment that looks the same and in which a part, such as ``objects``, is not turned."""
        angle = getattr(self, f"{part}_deg")
        parts = ("objects_deg", "eye_deg", "lights_deg", "environment_deg")
        return self._replace(**{name: getattr(self, name) - angle for name in parts})

    def rotation(self, part: str) -> np.ndarray:
        """Return the rotation of a part, (3, 3)."""
        return rotation_z(np.radians(getattr(self, f"{part}_deg")))

    def environment(self, environment: Environment) -> Environment:
        """Return the environment in this moment's colour, not turned; its coefficients are those of the other."""
        if self.filter is None:
            return environment
        basis = environment.basis * np.asarray(self.filter)[:, None]
        return replace(environment, basis=basis)

    def lights(self, lights: Lights) -> Lights:
        """Return lights in this moment's colour, not turned."""
        if self.filter is None:
            return lights
        spectrum = lights.spectrum.copy()
        spectrum[:, : len(self.filter)] *= np.asarray(self.filter, dtype=np.float32)
        return lights._replace(spectrum=spectrum, power=spectrum.sum(axis=1, dtype=np.float64))


#: The scene as it is defined.
STILL = Moment()


def turned_scene(scene: dict, moment: Moment) -> dict:
    """Return a scene's definition with its objects, bodies, views and lights turned; the environment is not read."""
    return scene | {
        "objects": [_turned_body(item, moment, "objects") for item in scene["objects"]],
        "views": {name: _turned_view(view, moment) for name, view in scene["views"].items()},
        "lights": [_turned_light(light, moment) for light in scene.get("lights", [])],
    }


def _place(position_mm, moment: Moment, part: str) -> list[float]:
    pivot = np.asarray(moment.pivot_mm, dtype=np.float64)
    return (moment.rotation(part) @ (np.asarray(position_mm, dtype=np.float64) - pivot) + pivot).tolist()


def _turned_body(item: dict, moment: Moment, part: str) -> dict:
    x_deg, y_deg, z_deg = item["rotation_deg"]
    # The last of the three rotations is the one about the scene's z.
    turn = [x_deg, y_deg, z_deg + getattr(moment, f"{part}_deg")]
    return item | {"position_mm": _place(item["position_mm"], moment, part), "rotation_deg": turn}


def _turned_view(view: dict, moment: Moment) -> dict:
    places = {key: _place(view[key], moment, "eye") for key in ("position_mm", "target_mm")}
    return view | places | {"up": (moment.rotation("eye") @ np.asarray(view["up"], dtype=np.float64)).tolist()}


def _turned_light(light: dict, moment: Moment) -> dict:
    if light["kind"] == "collimated":
        return light | {"azimuth_deg": light["azimuth_deg"] + moment.lights_deg}
    if light["kind"] == "rectangle":
        return _turned_body(light, moment, "lights")
    return light | {"position_mm": _place(light["position_mm"], moment, "lights")}
