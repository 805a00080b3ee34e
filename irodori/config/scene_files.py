"""Input files and parameters of the rules that make pictures of scenes, for the Snakefile.

Quick to import. Every method with the argument `wildcards` serves as an input or parameter function of Snakemake; the
argument is any object with the wildcards as attributes.
"""

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from irodori.config.definition import as_plain
from irodori.config.models import (
    Frames,
    IlluminantChange,
    InteractiveIntegrator,
    MeasuredDisplay,
    ModelledMaterial,
    ProfileDisplay,
    Scene,
    Turntable,
)
from irodori.config.pages import page_fault, page_rooms, page_views
from irodori.config.parts import Subject
from irodori.config.photograph_sets import PhotographSets, named_tables
from irodori.config.placed_names import materials_of
from irodori.core.errors import InputError
from irodori.geometry.mesh_sources import shape_files

__all__ = ["SceneFiles", "keeps_light"]

#: Optional files of each view, in addition to the spectral EXR and the PNG.
_FURTHER_OUTPUTS = {"xyz-exr": "results/{scene}/{view}.xyz.exr", "tiff": "results/{scene}/{view}.tif"}
# Pixels from which a picture takes long enough to wait for a second core, which is idle until the other cores' jobs end
# and while the picture is written.
_LARGE_PICTURE_PX = 2_000_000


def keeps_light(frames: Frames) -> bool:
    """Whether objects and lights keep their places in all frames, because only the eye or the illuminant changes."""
    return isinstance(frames, IlluminantChange) or (isinstance(frames, Turntable) and frames.turned == "eye")


class SceneFiles:
    """Scenes of a run, with the files and parameters of their rules.

    Parameters
    ----------
    sets : PhotographSets
        Photographs from which the scenes' objects and environments are made.
    """

    def __init__(self, sets: PhotographSets) -> None:
        self.sets, self.loaded = sets, sets.loaded

    def _scene(self, wildcards) -> Scene:
        return self.loaded.scenes[wildcards.scene]

    def objects(self, wildcards) -> list[str]:
        """Return the names of the objects placed in a scene, in its order."""
        return [placed.object for placed in self._scene(wildcards).objects]

    def materials(self, pattern: str) -> Callable[[Any], list[str]]:
        """Return a function that fills a pattern with the objects of the scene in the wildcards, then the backs."""
        return lambda wildcards: [pattern.format(object=name) for name in materials_of(self._scene(wildcards))]

    def environment(self, wildcards) -> str:
        """Return the path of the environment file that lights a scene."""
        return f"results/environments/{self._scene(wildcards).environment}.h5"

    def rooms(self, wildcards) -> list[str]:
        """Return the environment files of a scene's page, that of the scene first."""
        return [f"results/environments/{name}.h5" for name in page_rooms(self._scene(wildcards))]

    def true_light(self, wildcards) -> str:
        """Return the file of the true light of a virtual environment, or of the given light of any other."""
        name = self._scene(wildcards).environment
        known = name in self.sets.virtual("environments")
        return f"results/environments/{name}/truth.h5" if known else f"results/environments/{name}.h5"

    def calibrations(self, wildcards) -> list[str]:
        """Return the calibration files of the cameras that photographed a scene's objects and backs."""
        cameras = [self.loaded.objects[name].camera for name in materials_of(self._scene(wildcards))]
        return [f"results/cameras/{camera}/calibration.h5" for camera in cameras]

    def tiles(self, wildcards) -> list[str]:
        """Return the files of the fits of a scene's objects and backs, for each object once."""
        names = dict.fromkeys(materials_of(self._scene(wildcards)))
        return [file for name in names for file in self.sets.fitted_tiles(SimpleNamespace(object=name))]

    def observations(self, wildcards) -> list[str]:
        """Return the observation files of a scene's objects and backs, in the order of their fits."""
        names = dict.fromkeys(materials_of(self._scene(wildcards)))
        return [file for name in names for file in self.sets.observed_tiles(SimpleNamespace(object=name))]

    def subjects(self, wildcards) -> list[dict]:
        """Return a plain `Subject`, shape and size of a superpixel on it, mm, of a scene's objects, then the backs."""
        found = []
        for name in materials_of(self._scene(wildcards)):
            definition = self.loaded.objects[name]
            optics, rig = self.loaded.cameras[definition.camera].optics, self.loaded.rig_of("objects", name)
            assert optics is not None  # checked: a camera of objects has optics
            pixel_mm = optics.pixel_pitch_um / 1000.0 * rig.camera_distance_mm / optics.focal_length_mm
            found.append(Subject(shape=definition.shape, sample_mm=2.0 * pixel_mm).plain())
        return found

    def shapes(self, wildcards) -> list[dict]:
        """Return the shapes of a scene's objects."""
        return [self.loaded.objects[name].shape.plain() for name in self.objects(wildcards)]

    def files(self, wildcards) -> list[str]:
        """Return the meshes of a scene's objects and backs, and the tables of its own lights, bodies and frames."""
        shapes = [self.loaded.objects[name].shape for name in dict.fromkeys(materials_of(self._scene(wildcards)))]
        return [file for shape in shapes for file in shape_files(shape)] + self.tables(wildcards)

    def page_files(self, wildcards) -> list[str]:
        """Return the files of a scene, see `files`, and the pictures of its lesson."""
        lesson = self._scene(wildcards).lesson
        return self.files(wildcards) + [step.picture for step in (lesson.steps if lesson else ()) if step.picture]

    def tables(self, wildcards) -> list[str]:
        """Return the spectral tables of a scene's own lights, bodies and frames."""
        scene = self._scene(wildcards)
        return named_tables(scene.lights, scene.bodies, scene.frames)

    def shown_files(self, wildcards) -> list[str]:
        """Return the files of a scene, see `files`, and that of its display."""
        return self.files(wildcards) + self.display_file(wildcards)

    def shown_tables(self, wildcards) -> list[str]:
        """Return the tables of a scene, see `tables`, and the file of its display."""
        return self.tables(wildcards) + self.display_file(wildcards)

    def plan(self, wildcards) -> list[str]:
        """Return, as a list, the rendering plan of a scene with an error tolerance; empty for others."""
        tolerant = self._scene(wildcards).tolerance_ciede2000 is not None
        return [f"results/{wildcards.scene}/plan.yaml"] if tolerant else []

    def baked_of(self, wildcards) -> dict:
        """Return the keys of a scene's definition that its light maps depend on, and all required keys."""
        keys = ("environment", "objects", "bodies", "lights", "integrator", "allow_energy_gain", "image", "views")
        return self.part(*keys)(wildcards)

    def light_maps(self, pattern: str) -> Callable[[Any], list[str]]:
        """Return a function that fills a pattern with the scene in the wildcards; an empty list without light maps."""

        def found(wildcards) -> list[str]:
            integrator = self._scene(wildcards).integrator
            has_maps = isinstance(integrator, InteractiveIntegrator) and integrator.light_maps
            return [pattern.format(scene=wildcards.scene)] if has_maps else []

        return found

    def frames_light_maps(self, wildcards) -> list[str]:
        """Return, as a list, the light maps for the frames of a scene; empty if its lights move, see `keeps_light`."""
        frames = self._scene(wildcards).frames
        found = self.light_maps("results/{scene}/light-maps.h5")(wildcards)
        return found if frames is not None and keeps_light(frames) else []

    def display_file(self, wildcards) -> list[str]:
        """Return, as a list, the file that describes a scene's display; empty for a display without a file."""
        device = self._scene(wildcards).display.device
        return [device.file] if isinstance(device, MeasuredDisplay | ProfileDisplay) else []

    def part(self, *keys: str) -> Callable[[Any], dict]:
        """Return a function that selects keys of a scene's definition, so that changes of others cause no rerun."""
        return lambda wildcards: as_plain({key: getattr(self._scene(wildcards), key) for key in keys})

    def pictured(self, wildcards) -> dict:
        """Return the definition of a scene without its lesson, which affects no picture."""
        return {key: value for key, value in self._scene(wildcards).plain().items() if key != "lesson"}

    # ---- frames

    def with_frames(self, wildcards) -> dict:
        """Return the definition of a scene with frames, without its lesson, which affects no picture.

        Raises
        ------
        InputError
            If the scene has no frames.
        """
        scene = self._scene(wildcards)
        if scene.frames is None:
            file = Path(self.loaded.config.definitions) / "scenes" / f"{wildcards.scene}.yaml"
            found = f"the scene {wildcards.scene} defines no frames, so there are none to render"
            raise InputError(file, "frames", found, "a turntable, a light_sweep or an illuminant_change")
        return self.pictured(wildcards)

    def threads_of_view(self, wildcards) -> int:
        """Return the threads for a picture: 2 if it is large enough to be worth the wait for a second core, else 1.

        The only picture of a large object does not wait: the jobs of the object end with it, as with those of
        `share_gloss` and `compress_reflectance`, which have two threads for the same reason.
        """
        scene = self._scene(wildcards)
        is_large = scene.image.width * scene.image.height >= _LARGE_PICTURE_PX
        is_alone = len(scene.views) == 1 and any(len(self.sets.tiles_of(name)) > 1 for name in materials_of(scene))
        return 2 if is_large or is_alone else 1

    def memory_of_frames_mb(self, wildcards) -> int:
        """Return the memory for the pictures of a sequence, MB: they are joined in memory."""
        self.with_frames(wildcards)
        scene = self._scene(wildcards)
        frames = scene.frames
        if isinstance(frames, IlluminantChange):
            count = len(frames.illuminants) * (1 + frames.count_between)
        else:
            count = frames.count if frames else 0
        return 8 * scene.image.width * scene.image.height * count // 1_000_000

    # ---- views

    def _follows_the_model(self, name: str) -> bool:
        """Whether a virtual object's true materials follow equation (5), the only model that is rendered."""
        virtual = self.loaded.objects[name].virtual
        return virtual is not None and all(
            isinstance(one, ModelledMaterial) and one.lobe == ModelledMaterial.lobe for one in virtual.materials
        )

    def truth_is_rendered(self, scene: str) -> bool:
        """Whether a scene can be rendered with the true materials of its objects, all of which are then virtual."""
        known = {name for name in self.sets.virtual("objects") if self._follows_the_model(name)}
        return known.issuperset(materials_of(self.loaded.scenes[scene]))

    def pictures(self) -> list[str]:
        """Return the paths of all pictures of the run."""
        found = []
        for scene, definition in self.loaded.scenes.items():
            kinds = ["results/{scene}/{view}.png", "results/{scene}/{view}.exr"]
            kinds += [_FURTHER_OUTPUTS[kind] for kind in definition.further_outputs]
            kinds += ["results/{scene}/{view}.frames.png"] if definition.frames is not None else []
            found += [kind.format(scene=scene, view=view) for view in definition.views for kind in kinds]
        return found

    # ---- pages

    def pages(self) -> list[str]:
        """Return the paths of the classroom pages, one for every scene that such a page can show."""
        shown = (name for name, scene in self.loaded.scenes.items() if page_fault(scene) is None)
        return [f"results/{name}/viewer.html" for name in shown]

    def page_view(self, pattern: str) -> Callable[[Any], str]:
        """Return a function that fills a pattern with the first view of the page of the scene in the wildcards.

        Raises
        ------
        InputError
            If a page cannot show the scene.
        """

        def found(wildcards) -> str:
            scene = self._scene(wildcards)
            fault = page_fault(scene)
            if fault is not None:
                raise InputError(Path(self.loaded.config.definitions) / "scenes" / f"{wildcards.scene}.yaml", *fault)
            return pattern.format(scene=wildcards.scene, view=page_views(scene)[0])

        return found

    # ---- photographs of scenes

    def photograph(self, wildcards) -> dict:
        """Return the definition of a photograph of a scene."""
        return self._scene(wildcards).photographs[wildcards.photograph].plain()

    def photograph_radiance(self, wildcards) -> list[str]:
        """Return, as a list, the file of the radiance in front of a virtual camera; empty for a real camera."""
        if not self.sets.made(wildcards):
            return []
        return [f"results/{wildcards.scene}/photographs/{wildcards.photograph}/radiance.h5"]
