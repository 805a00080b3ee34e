"""All definitions that a run loaded, as dataclasses."""

import dataclasses
from collections.abc import Mapping
from typing import Any, Self

from irodori.config.definition import Definition
from irodori.config.models import Camera, Config, Environment, Object, Rig, Scene

__all__ = ["Loaded"]

_CLASSES: dict[str, type[Definition]] = {
    "scenes": Scene,
    "objects": Object,
    "environments": Environment,
    "cameras": Camera,
    "rigs": Rig,
}


@dataclasses.dataclass(frozen=True, kw_only=True)
class Loaded:
    """Configuration and definitions by name, those alone that the configuration asks for, directly or not."""

    config: Config
    scenes: Mapping[str, Scene]
    objects: Mapping[str, Object]
    environments: Mapping[str, Environment]
    cameras: Mapping[str, Camera]
    rigs: Mapping[str, Rig]

    @classmethod
    def of(cls, definitions: Mapping[str, Any]) -> Self:
        """Make the dataclasses of what `irodori.config.definitions.load_definitions` returned."""
        rest = {key: value for key, value in definitions.items() if key not in _CLASSES}
        kinds: dict[str, Any] = {
            kind: {name: made.of(given) for name, given in definitions[kind].items()} for kind, made in _CLASSES.items()
        }
        return cls(config=Config.of(rest), **kinds)

    def rig_of_camera(self, camera: str) -> Rig:
        """Return the rig that carries a camera."""
        return self.rigs[self.cameras[camera].rig]
