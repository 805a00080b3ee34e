"""All definitions that a run has loaded, and the sets of photographs that they require."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from irodori.config.capture_table import chart_capture, expand_poses, read_captures, room_chart_capture
from irodori.config.cross_checks.captures_on_rig import table_and_folder
from irodori.config.definition import Definition
from irodori.config.models import Camera, Config, EnvironmentDefinition, Object, Rig, Scene
from irodori.config.validation import suggest

__all__ = ["Loaded"]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Loaded(Definition):
    """Configuration, and by name the definitions that it requires, directly or indirectly.

    A set of photographs is identified by its kind, ``objects``, ``cameras`` or ``environments``, and the name of the
    definition; methods raise a ValueError for another kind or name.
    """

    config: Config
    scenes: Mapping[str, Scene] = dataclasses.field(hash=False)
    objects: Mapping[str, Object] = dataclasses.field(hash=False)
    environments: Mapping[str, EnvironmentDefinition] = dataclasses.field(hash=False)
    cameras: Mapping[str, Camera] = dataclasses.field(hash=False)
    rigs: Mapping[str, Rig] = dataclasses.field(hash=False)

    def without_descriptions(self) -> "Loaded":
        """Return the same without descriptions, words for people on which no result but a page's title depends."""
        plain: dict[str, Any] = {
            kind: {name: dataclasses.replace(one, description=None) for name, one in getattr(self, kind).items()}
            for kind in ("scenes", "objects", "environments", "cameras", "rigs")
        }
        return dataclasses.replace(self, **plain)

    def photographed(self, kind: str, name: str) -> Object | Camera | EnvironmentDefinition:
        """Return the definition of the subject of a set of photographs."""
        kinds = ("objects", "cameras", "environments")
        if kind not in kinds:
            raise ValueError(f"no photographs of {kind!r}; {suggest(kind, kinds, 'kinds')}")
        definitions = getattr(self, kind)
        if name not in definitions:
            raise ValueError(f"no {name!r} in {kind}; {suggest(name, definitions, 'loaded')}")
        return definitions[name]

    def camera_of(self, kind: str, name: str) -> str:
        """Return the name of the camera that takes a set. Raises ValueError for an environment without a camera."""
        definition = self.photographed(kind, name)
        camera = name if isinstance(definition, Camera) else definition.camera
        if camera is None:
            raise ValueError(f"the environment {name!r}, which no camera photographed; accepted: one with a camera")
        return camera

    def rig_of(self, kind: str, name: str) -> Rig:
        """Return the rig on which a set is taken. Raises ValueError for an environment without a camera."""
        return self.rigs[self.cameras[self.camera_of(kind, name)].rig]

    def is_virtual(self, kind: str, name: str) -> bool:
        """Whether the virtual rig takes a set."""
        definition = self.photographed(kind, name)
        if isinstance(definition, EnvironmentDefinition) and definition.camera is None:
            return False
        return self.rig_of(kind, name).kind == "virtual"

    def is_taken_here(self, kind: str, name: str) -> bool:
        """Whether the workflow itself takes a set, on the virtual rig or on a rig that it drives."""
        return self.photographed(kind, name).exposure_s is not None

    def captures_of(self, kind: str, name: str, root: str | Path = ".") -> list[str]:
        """Return the names of the captures of a set.

        Parameters
        ----------
        kind, name : str
        root : path
            Working directory of the workflow, where the table's relative path starts.

        Returns
        -------
        list of str
            For an object its poses, sorted, each once; for a camera ``chart`` and ``chart-NAME`` of each further chart;
            for an environment ``environment`` and ``room-chart-NAME`` of each chart in it, and none if no camera
            photographed it.

        Raises
        ------
        InputError
            If the table of a real rig has a fault.
        """
        definition = self.photographed(kind, name)
        if isinstance(definition, EnvironmentDefinition):
            charts = [room_chart_capture(name) for name in definition.room_charts]
            return ["environment", *charts] if definition.camera is not None else []
        if isinstance(definition, Camera):
            return [chart_capture(chart) for chart in ["", *definition.further_charts]]
        if self.is_taken_here(kind, name):
            return sorted(pose.name for pose in expand_poses(definition.poses or ()))
        assert definition.captures is not None  # checked: photographs that others take have a table
        table, _ = table_and_folder(definition.captures, Path(root))
        return sorted({shot.capture for shot in read_captures(table) if shot.role == "object"})
