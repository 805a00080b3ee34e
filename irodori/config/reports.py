"""Reports of a run, and the input files and parameters of the rules that write them, for the Snakefile.

Every scene has a report and a table of errors in its own folder, so that another configuration with other scenes
overwrites neither. Every camera under ``make.cameras`` has both in its folder.

Quick to import. Every method with the argument `wildcards`, and every function that a method returns, serves as an
input or parameter function of Snakemake. The wildcards have ``scene`` for the report of a scene, and ``camera`` for
that of a camera, which has neither objects nor views.
"""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

from irodori.config.models import Scene
from irodori.config.pages import page_fault, page_rooms
from irodori.config.placed_names import materials_of
from irodori.config.scene_files import SceneFiles

__all__ = ["Reports"]

_OfReport = Callable[[Any], list[str]]


def _has_scene(wildcards) -> bool:
    """Whether the wildcards are those of the report of a scene, and not of a camera."""
    return hasattr(wildcards, "scene")


class Reports:
    """Reports of a run.

    Parameters
    ----------
    scenes : SceneFiles
    """

    def __init__(self, scenes: SceneFiles) -> None:
        self._scenes, self._sets, self._loaded = scenes, scenes.sets, scenes.loaded

    # ---- all reports of a run

    def folders(self) -> list[str]:
        """Return the folder of every report: those of the scenes, then those of the cameras asked for by name."""
        cameras = self._loaded.config.make.cameras
        return [f"results/{scene}" for scene in self._loaded.scenes] + [f"results/cameras/{name}" for name in cameras]

    def targets(self, wildcards=None) -> list[str]:
        """Return the paths of all final results: pictures, pages, calibrations, tables of errors and reports."""
        made = [*self._scenes.pictures(), *self._scenes.pages(), *self._sets.calibrations(wildcards)]
        return made + [f"{folder}/{name}" for folder in self.folders() for name in ("errors.csv", "report.html")]

    # ---- what one report covers

    def _objects(self, wildcards, virtual_only: bool = False) -> list[str]:
        names = dict.fromkeys(materials_of(self._scene(wildcards))) if _has_scene(wildcards) else ()
        return [name for name in names if not virtual_only or self._loaded.is_virtual("objects", name)]

    def _environments(self, wildcards, virtual_only: bool = False) -> list[str]:
        names = page_rooms(self._scene(wildcards)) if _has_scene(wildcards) else ()
        return [name for name in names if not virtual_only or self._loaded.is_virtual("environments", name)]

    def _cameras(self, wildcards) -> list[str]:
        if not _has_scene(wildcards):
            return [wildcards.camera]
        found = [self._loaded.objects[name].camera for name in self._objects(wildcards)]
        places = [self._loaded.environments[name] for name in self._environments(wildcards)]
        found += [place.camera for place in places if place.camera is not None]
        found += [photograph.camera for photograph in self._scene(wildcards).photographs.values()]
        return list(dict.fromkeys(found))

    def _scene(self, wildcards) -> Scene:
        return self._loaded.scenes[wildcards.scene]

    def title(self, wildcards) -> str:
        """Return the name of the scene or the camera."""
        return wildcards.scene if _has_scene(wildcards) else wildcards.camera

    def errors(self, wildcards) -> str:
        """Return the table of errors beside the report."""
        folder = wildcards.scene if _has_scene(wildcards) else f"cameras/{wildcards.camera}"
        return f"results/{folder}/errors.csv"

    def objects(self, pattern: str, virtual_only: bool = False) -> _OfReport:
        """Return a function that fills a pattern with every object of a report, or with the virtual ones only."""
        return lambda wildcards: [pattern.format(object=name) for name in self._objects(wildcards, virtual_only)]

    def placements(self, wildcards) -> list[str]:
        """Return the files that tell where the objects of a report lay; empty if objects are not registered."""
        return [f for name in self._objects(wildcards) for f in self._sets.registration(SimpleNamespace(object=name))]

    def environments(self, pattern: str, virtual_only: bool = False) -> _OfReport:
        """Return a function that fills a pattern with every environment of a report, or with the virtual ones only.

        The lesson of a scene may name environments beside the scene's own.
        """
        return lambda wildcards: [
            pattern.format(environment=name) for name in self._environments(wildcards, virtual_only)
        ]

    def cameras(self, pattern: str) -> _OfReport:
        """Return a function that fills a pattern with every camera that took photographs for a report."""
        return lambda wildcards: [pattern.format(camera=name) for name in self._cameras(wildcards)]

    def lenses(self, wildcards) -> list[str]:
        """Return the files of the measured lenses of a report's cameras; other lenses are as typed."""
        return [file for name in self._cameras(wildcards) for file in self._sets.lens(SimpleNamespace(camera=name))]

    def lens_cameras(self, wildcards) -> list[str]:
        """Return the cameras of `lenses`."""
        return [name for name in self._cameras(wildcards) if self._sets.lens(SimpleNamespace(camera=name))]

    def views(self, pattern: str, virtual_only: bool = False) -> _OfReport:
        """Return a function that fills a pattern with every view of a report, if wanted only of virtual objects."""

        def found(wildcards) -> list[str]:
            if not _has_scene(wildcards) or (virtual_only and not self._scenes.truth_is_rendered(wildcards.scene)):
                return []
            return [pattern.format(scene=wildcards.scene, view=view) for view in self._scene(wildcards).views]

        return found

    def photographs(self, pattern: str) -> _OfReport:
        """Return a function that fills a pattern with every photograph with which a rendering is compared."""

        def found(wildcards) -> list[str]:
            photographs = self._scene(wildcards).photographs if _has_scene(wildcards) else ()
            return [pattern.format(scene=wildcards.scene, photograph=photograph) for photograph in photographs]

        return found

    def pages(self, wildcards) -> list[str]:
        """Return, as a list, the classroom page of a scene; empty if it has none."""
        shown = _has_scene(wildcards) and page_fault(self._scene(wildcards)) is None
        return [f"results/{wildcards.scene}/viewer.html"] if shown else []

    def light(self, wildcards) -> list[str]:
        """Return, as a list, the file of a scene's light; empty for a camera."""
        return [self._scenes.environment(wildcards)] if _has_scene(wildcards) else []

    def light_name(self, wildcards) -> str:
        """Return the name of a scene's environment, empty for a camera."""
        return self._scene(wildcards).environment if _has_scene(wildcards) else ""

    def scene(self, wildcards) -> dict:
        """Return the definition of a scene without its lesson, which affects no picture; empty for a camera."""
        return self._scenes.pictured(wildcards) if _has_scene(wildcards) else {}

    def shapes(self, wildcards) -> list[dict]:
        """Return the shapes of a scene's objects; none for a camera."""
        return self._scenes.shapes(wildcards) if _has_scene(wildcards) else []

    def sessions(self, wildcards) -> list[str]:
        """Return the records of the sessions that took the photographs of a report."""
        sets = {
            "objects": self._objects(wildcards),
            "cameras": self._cameras(wildcards),
            "environments": self._environments(wildcards),
        }
        return [file for kind, names in sets.items() for name in names for file in self._sets.session_of(kind, name)]

    def jobs(self, wildcards) -> list[str]:
        """Return the beginnings of the names of the jobs for a report; see `irodori.report.page.write_report`."""
        cameras, environments = self._cameras(wildcards), self._environments(wildcards)
        prefixed = [f"cameras-{name}" for name in cameras] + [f"environments-{name}" for name in environments]
        return [self.title(wildcards), *self._objects(wildcards), *environments, *cameras, *prefixed]
