"""Input files and parameters of the rules about photographs of objects, cameras and places, for the Snakefile.

Quick to import. Every method with the argument `wildcards` serves as an input or parameter function of Snakemake; the
argument is any object with the wildcards as attributes.
"""

import dataclasses
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple, TypeVar

from irodori.config.capture_table import LENS, noted_hashes, placement_of, read_captures
from irodori.config.definition import Definition, as_plain
from irodori.config.loaded import Loaded
from irodori.config.models import CapturesSource, EnvironmentDefinition, Object
from irodori.config.parts import PhotographedObject, PhotographingCamera, RigGeometry, TrueObject
from irodori.geometry.mesh_sources import shape_files
from irodori.rectification.texture_tiles import tile_rows
from irodori.spectra.spectral_files import SUFFIXES

__all__ = [
    "IngestPart",
    "PhotographSets",
    "light_definition",
    "light_files",
    "material_definition",
    "material_files",
    "named_tables",
]

_Part = TypeVar("_Part", bound=Definition)

#: Parts of an object's definition on which its material depends.
_OF_MATERIAL = (
    *("shape", "texels", "refractive_index", "lobes", "coat", "mirror_weight", "sheet"),
    *("level_patch", "markers", "placements"),
)
#: Parts of a camera's definition on which only its calibration depends, and no photograph.
_OF_CALIBRATION = ("calibration", "comb_filter", "sensitivities")
#: Parts of an environment's definition on which its light depends, beside photographs.
_OF_LIGHT = ("camera", "image", "source", "room_charts", "lamps", "lamps_error_percent")
_FOLDERS = {"objects": "results", "cameras": "results/cameras", "environments": "results/environments"}
_ROLES = {
    "objects": ["object"],
    "cameras": ["chart", "white", "dark"],
    "environments": ["environment", "room-chart"],
    "photographs": ["scene"],
}
#: Kinds of sets by the wildcard with their name.
_SET_OF = {"photograph": "photographs", "object": "objects", "camera": "cameras", "environment": "environments"}


def named_tables(*values: Any) -> list[str]:
    """Return the paths of the user's spectral tables in definitions, so that rules can depend on them."""
    found: list[str] = []
    for value in values:
        if isinstance(value, Definition):
            found += named_tables(*vars(value).values())
        elif isinstance(value, Mapping):
            found += named_tables(*value.values())
        elif isinstance(value, list | tuple):
            found += named_tables(*value)
        elif isinstance(value, str) and value.lower().endswith(SUFFIXES):
            found.append(value)
    return found


def material_definition(definition: Object) -> dict[str, Any]:
    """Return the parts of an object's definition on which its material depends, as in the file; None where absent."""
    return {key: as_plain(getattr(definition, key)) for key in _OF_MATERIAL}


def material_files(definition: Object) -> list[str]:
    """Return the paths of the files that these parts name: meshes, and tables of index and transmittance."""
    return [*shape_files(definition.shape), *named_tables(definition.refractive_index, definition.sheet)]


def light_definition(place: EnvironmentDefinition) -> dict[str, Any]:
    """Return the parts of an environment's definition on which its light depends, beside photographs."""
    return {key: as_plain(getattr(place, key)) for key in _OF_LIGHT}


def light_files(place: EnvironmentDefinition) -> list[str]:
    """Return the paths of the picture and of the spectral tables that these parts name."""
    source = place.source
    picture = [] if place.camera is not None or not hasattr(source, "file") else [source.file]
    return [*picture, *named_tables(source, place.room_charts, place.lamps)]


def _part(kind: type[_Part], whole: Definition) -> _Part:
    """Return the part of a definition with the keys of a class of parts."""
    return kind(**{field.name: getattr(whole, field.name) for field in dataclasses.fields(kind)})


class IngestPart(NamedTuple):
    """Captures of an object that one job ingests, with the number of the job."""

    object_name: str
    number: str
    captures: list[str]

    @property
    def rule_name(self) -> str:
        """Name of the job's rule; such names have no hyphen."""
        return f"ingest_raw_{self.object_name}_{self.number}".replace("-", "_")


class PlacedUnit(NamedTuple):
    """One placement of an object, which is registered by itself: the object's name and the placement's number."""

    object_name: str
    number: int

    @property
    def label(self) -> str:
        """Name of the object, with the number of a further placement."""
        return self.object_name if self.number == 1 else f"{self.object_name} in placement {self.number}"

    def file(self, kind: str) -> str:
        """Return the path of a file about it, ``registration`` or ``placement``."""
        return f"results/{self.object_name}/{kind}{'' if self.number == 1 else f'-{self.number}'}.h5"


class PhotographSets:
    """Sets of photographs of a run: of an object, a camera's charts and white reference, an environment, or a scene.

    Parameters
    ----------
    loaded : Loaded

    Raises
    ------
    InputError
        If a table of photographs has a fault.
    """

    def __init__(self, loaded: Loaded) -> None:
        self.loaded = loaded
        self.captures = {
            kind: {name: loaded.captures_of(kind, name) for name in getattr(loaded, kind)} for kind in _FOLDERS
        }
        self._sheets: dict[str, list[str]] = {}

    # ---- which set a job is about

    def _set(self, wildcards) -> tuple[str, str]:
        """Return kind and name of the set of a job, from its wildcards."""
        return next((kind, getattr(wildcards, key)) for key, kind in _SET_OF.items() if hasattr(wildcards, key))

    def _definition(self, wildcards) -> Any:
        kind, name = self._set(wildcards)
        if kind == "photographs":
            return self.loaded.scenes[wildcards.scene].photographs[name]
        return self.loaded.photographed(kind, name)

    def _folder(self, wildcards) -> str:
        """Return the folder of a set's results."""
        kind, name = self._set(wildcards)
        return f"results/{wildcards.scene}/photographs/{name}" if kind == "photographs" else f"{_FOLDERS[kind]}/{name}"

    def _is_virtual(self, wildcards) -> bool:
        kind, name = self._set(wildcards)
        if kind == "photographs":
            return self.loaded.rigs[self.rig_of(wildcards)].kind == "virtual"
        return self.loaded.is_virtual(kind, name)

    def camera_of(self, wildcards) -> str:
        """Return the name of a set's camera."""
        kind, name = self._set(wildcards)
        return self._definition(wildcards).camera if kind == "photographs" else self.loaded.camera_of(kind, name)

    def rig_of(self, wildcards) -> str:
        """Return the name of a set's rig."""
        return self.loaded.cameras[self.camera_of(wildcards)].rig

    def camera(self, wildcards) -> dict:
        """Return the parts of the definition of a set's camera that the photographs of the set depend on."""
        camera = self.loaded.cameras[self.camera_of(wildcards)]
        if self._set(wildcards)[0] != "cameras":
            return _part(PhotographingCamera, camera).plain()
        return {key: part for key, part in camera.plain().items() if key not in _OF_CALIBRATION}

    def rig(self, wildcards) -> dict:
        """Return the definition of a set's rig, without the error of its lamp, on which no photograph depends."""
        found = self.loaded.rigs[self.rig_of(wildcards)].plain()
        found["light"].pop("error_percent", None)
        return found

    def photographed_place(self, wildcards) -> dict:
        """Return the definition of an environment, without its lamps, on which no photograph depends."""
        found = self.loaded.environments[wildcards.environment].plain()
        return {key: part for key, part in found.items() if key not in ("lamps", "lamps_error_percent")}

    def camera_file(self, pattern: str) -> Callable[[Any], str]:
        """Return a function that fills ``{camera}`` in a pattern with the camera of the set in the wildcards."""
        return lambda wildcards: pattern.format(camera=self.camera_of(wildcards))

    # ---- RAW files

    def table(self, wildcards) -> str:
        """Return the path of a set's capture table: that of the virtual rig, or the user's own."""
        if self._is_virtual(wildcards):
            return f"{self._folder(wildcards)}/captures/captures.csv"
        return self._definition(wildcards).captures.table

    def made(self, wildcards) -> list[str]:
        """Return, as a list, the record of the session that takes a set's photographs; empty for the user's own."""
        taken_here = self._definition(wildcards).exposure_s is not None
        return [f"{self._folder(wildcards)}/captures/session.json"] if taken_here else []

    def session_of(self, kind: str, name: str) -> list[str]:
        """Return, as a list, the record of the session that takes a set; empty for the user's own photographs."""
        return [f"{_FOLDERS[kind]}/{name}/captures/session.json"] if self.loaded.is_taken_here(kind, name) else []

    def folder(self, wildcards) -> str:
        """Return the folder of a set's RAW files."""
        own = None if self._is_virtual(wildcards) else self._definition(wildcards).captures.folder
        return own or str(Path(self.table(wildcards)).parent)

    def own_photographs(self, wildcards) -> list[str]:
        """Return the user's table and RAW files of a set; empty if a session takes them, which records their hashes."""
        if self.made(wildcards):
            return []
        table, folder, roles = self.table(wildcards), self.folder(wildcards), self.roles(wildcards)
        return [table, *(f"{folder}/{shot.file}" for shot in read_captures(table, folder) if shot.role in roles)]

    def photographs_of_session(self, wildcards) -> dict[str, str]:
        """Return {RAW file: hash} from the table of the session that took a set; empty for the user's own."""
        table = self.table(wildcards)
        if not self.made(wildcards) or not Path(table).is_file():
            return {}
        return {f"{self.folder(wildcards)}/{file}": sha256 for file, sha256 in noted_hashes(table).items()}

    def checked_table(self, wildcards) -> str:
        """Return the path of the table of a set that is written after a check of every file."""
        return f"{self._folder(wildcards)}/captures.csv"

    def roles(self, wildcards) -> list[str]:
        """Return the roles of the photographs in a set."""
        return _ROLES[self._set(wildcards)[0]]

    def size_px(self, wildcards) -> list[int] | None:
        """Return the required width and height of a set's RAW files, pixels; None if no definition states them."""
        kind, _ = self._set(wildcards)
        if kind == "environments":
            place = self._definition(wildcards)
            image = place.image if isinstance(place.source, CapturesSource) else None
            return [2 * image.width, 2 * image.height] if image else None
        optics = self.loaded.cameras[self.camera_of(wildcards)].optics
        return [optics.width_px, optics.height_px] if optics else None

    def lens_mm(self, wildcards) -> list[float] | None:
        """Return focal length and distance of the subject on the rig, mm; None for a place or an unknown lens."""
        if self._set(wildcards)[0] == "environments":
            return None
        optics = self.loaded.cameras[self.camera_of(wildcards)].optics
        if optics is None:
            return None
        return [optics.focal_length_mm, self.loaded.rigs[self.rig_of(wildcards)].camera_distance_mm]

    def sessions(self, wildcards) -> list[str]:
        """Return the records of all sessions of the run."""
        return [file for kind in _FOLDERS for name in self.captures[kind] for file in self.session_of(kind, name)]

    def rigs_taken(self, wildcards) -> int:
        """Return the number of real rigs that a session moves, a limited resource: 1, or 0 for a virtual rig."""
        return int(self.loaded.rigs[self.rig_of(wildcards)].kind == "driven")

    def virtual(self, kind: str) -> list[str]:
        """Return the names of all virtual definitions of a kind, for which the ground truth is known."""
        return [name for name in self.captures[kind] if self.loaded.is_virtual(kind, name)]

    # ---- tables and meshes that a job reads

    def files_of_session(self, wildcards) -> list[str]:
        """Return the tables of spectra and the mesh that a session of the virtual rig reads; empty for a real rig."""
        if not self._is_virtual(wildcards):
            return []
        subjects = {"objects": self.photographed, "environments": self.photographed_place}
        subject = subjects.get(self._set(wildcards)[0], self.camera)
        tables = named_tables(subject(wildcards), self.camera(wildcards), self.rig(wildcards))
        return list(dict.fromkeys(tables)) + (self.mesh(wildcards) if hasattr(wildcards, "object") else [])

    def tables_of_calibration(self, wildcards) -> list[str]:
        """Return the tables of spectra that a calibration reads."""
        camera = self.loaded.cameras[wildcards.camera]
        known = (camera.comb_filter, camera.sensitivities)
        return named_tables(camera.chart, camera.further_charts, self.loaded.rigs[camera.rig].light, *known)

    def tables_of_white(self, wildcards) -> list[str]:
        """Return, as a list, the table of the white reference's spectrum; empty if it has none."""
        return named_tables(self.loaded.cameras[wildcards.camera].white)

    def tables_of_index(self, wildcards) -> list[str]:
        """Return, as a list, the table of an object's refractive index; empty if it has none."""
        return named_tables(self.loaded.objects[wildcards.object].refractive_index)

    def mesh(self, wildcards) -> list[str]:
        """Return the mesh files of an object; empty for another shape."""
        return shape_files(self.loaded.objects[wildcards.object].shape)

    def mesh_and_tables_of_index(self, wildcards) -> list[str]:
        """Return the mesh files of an object and the table of its refractive index, as far as it has them."""
        return [*self.mesh(wildcards), *self.tables_of_index(wildcards)]

    # ---- cameras

    def white_reflectance(self, wildcards) -> float | str:
        """Return the reflectance factor of a camera's white reference, a number or a spectrum's name; 1 by default."""
        white = self.loaded.cameras[self.camera_of(wildcards)].white
        return white.reflectance_factor if white else 1.0

    def white_pose(self, wildcards) -> dict | None:
        """Return the pose of a camera's white reference, degrees; None if there is none or the light is far."""
        camera = self.loaded.cameras[self.camera_of(wildcards)]
        if self.loaded.rigs[camera.rig].light.distance_mm is None:
            return None
        if camera.poses is not None:
            return as_plain(camera.poses.white)
        assert camera.captures is not None  # a camera without a session has a table
        whites = [shot.pose for shot in read_captures(camera.captures.table) if shot.role == "white"]
        return whites[0].by_angle if whites else None

    def near_lamp(self, wildcards) -> dict | None:
        """Return the plain `NearLamp` that lit the white reference, for photographs that it does not light; or None.

        It lights objects and charts on the rig, but no place and no scene. A panorama that was stitched has its own
        pixels, and counts only the middle of the white reference.
        """
        kind, _ = self._set(wildcards)
        pose = self.white_pose(wildcards) if kind in ("environments", "photographs") else None
        if pose is None:
            return None
        return {"optics": self.optics(wildcards), "rig": self.rig_geometry(wildcards), "white_pose": pose}

    def optics(self, wildcards) -> dict:
        """Return the optics of a set's camera."""
        return as_plain(self.loaded.cameras[self.camera_of(wildcards)].optics)

    def rig_geometry(self, wildcards) -> dict:
        """Return the `RigGeometry` of a set's rig as plain values."""
        rig = self.loaded.rigs[self.rig_of(wildcards)]
        return RigGeometry.of_rig(rig).plain()

    def lamp_radius_deg(self, wildcards) -> float | None:
        """Return the angular radius of the lamp of a set's rig, degrees; None if it is not known."""
        rig = self.loaded.rigs[self.rig_of(wildcards)]
        return rig.light.angular_radius_deg or (rig.virtual.light_angular_radius_deg if rig.virtual else None)

    def light(self, wildcards) -> str:
        """Return the name or file of the spectrum of the light of a set's rig."""
        return self.loaded.rigs[self.rig_of(wildcards)].light.spectrum

    def light_error_percent(self, wildcards) -> float | None:
        """Return how far the light of a set's rig may differ from its spectrum, in percent; None where nobody says."""
        return self.loaded.rigs[self.rig_of(wildcards)].light.error_percent

    def charts(self, wildcards) -> list[str]:
        """Return the linear files of a camera's charts, the first chart's first."""
        charts = self.captures["cameras"][wildcards.camera]
        return [f"results/cameras/{wildcards.camera}/linear/{chart}.h5" for chart in charts]

    def calibrations(self, wildcards) -> list[str]:
        """Return the calibration files of all cameras."""
        return [f"results/cameras/{name}/calibration.h5" for name in self.loaded.cameras]

    def calibration_of_index(self, wildcards) -> list[str]:
        """Return, as a list, the calibration of an object's camera if its refractive index varies with wavelength."""
        if not self.tables_of_index(wildcards):
            return []
        return [f"results/cameras/{self.camera_of(wildcards)}/calibration.h5"]

    def sheet(self, wildcards) -> list[str]:
        """Return a camera's table and its photographs of the printed sheet; empty if there are none."""
        if (camera := wildcards.camera) not in self._sheets:
            shots = []
            # Sessions photograph no sheet, and write their tables themselves.
            if not self.loaded.is_taken_here("cameras", camera):
                shots = [shot for shot in read_captures(self.table(wildcards)) if shot.role == LENS]
            files = [f"{self.folder(wildcards)}/{shot.file}" for shot in shots]
            self._sheets[camera] = [self.table(wildcards), *files] if files else []
        return self._sheets[camera]

    def lens(self, wildcards) -> list[str]:
        """Return, as a list, the file of the measured lens of a set's camera; empty if its optics are as typed."""
        camera = self.camera_of(wildcards)
        return [f"results/cameras/{camera}/lens.yaml"] if self.sheet(SimpleNamespace(camera=camera)) else []

    def lenses(self, wildcards) -> list[str]:
        """Return the files of all measured lenses."""
        return [file for camera in self.loaded.cameras for file in self.lens(SimpleNamespace(camera=camera))]

    # ---- objects

    def photographed(self, wildcards) -> dict:
        """Return the parts of an object's definition that a photograph depends on."""
        return _part(PhotographedObject, self.loaded.objects[wildcards.object]).plain()

    def true_object(self, wildcards) -> dict:
        """Return the parts of a virtual object's definition that its true material depends on."""
        return _part(TrueObject, self.loaded.objects[wildcards.object]).plain()

    def ingest_parts(self) -> Iterator[IngestPart]:
        """Yield the captures of all objects in parts, one for each job of ingestion."""
        size = self.loaded.config.ingest.captures_per_job
        for name, captures in self.captures["objects"].items():
            for number, first in enumerate(range(0, len(captures), size)):
                yield IngestPart(name, f"{number:03d}", captures[first : first + size])

    def ingest_options(self, wildcards) -> dict:
        """Return the options of ingestion that affect its results."""
        return {key: value for key, value in self.loaded.config.ingest.plain().items() if key != "captures_per_job"}

    def linear_files(self, wildcards) -> list[str]:
        """Return the linear files of all captures of an object."""
        captures = self.captures["objects"][wildcards.object]
        return [f"results/{wildcards.object}/linear/{capture}.h5" for capture in captures]

    def linear_of_placement(self, wildcards) -> list[str]:
        """Return the linear files of an object in one placement, by the wildcard ``placement``; else in its first."""
        number = int(getattr(wildcards, "placement", 1))
        return [file for file in self.linear_files(wildcards) if placement_of(Path(file).stem) == number]

    def first_registration(self, wildcards) -> list[str]:
        """Return, as a list, the registration of an object's first placement; empty for a job that is about this."""
        first = PlacedUnit(wildcards.object, 1)
        return [first.file("registration")] if hasattr(wildcards, "placement") else []

    def first_linear(self, wildcards) -> list[str]:
        """Return the linear files of an object's first placement; empty for a job that is about this placement."""
        first = SimpleNamespace(object=wildcards.object)
        return self.linear_of_placement(first) if hasattr(wildcards, "placement") else []

    def registration(self, wildcards) -> list[str]:
        """Return the files that tell where an object stood in each placement; empty if objects are not registered.

        For an object photographed together with others, or in several placements, it is the ones that take in what the
        others tell.
        """
        if not self.loaded.config.place.register:
            return []
        units = self._registered(wildcards.object)
        shared = any(wildcards.object in names for names in self.loaded.config.photographed_together)
        return [unit.file("placement" if shared or len(units) > 1 else "registration") for unit in units]

    def _registered(self, name: str) -> list[PlacedUnit]:
        """Return what is registered of an object: each of its placements."""
        return [PlacedUnit(name, number + 1) for number in range(len(self.loaded.objects[name].placements) + 1)]

    def together(self) -> list[list[PlacedUnit]]:
        """Return the sets of placements whose registrations are combined: photographed together, or of one object."""
        config = self.loaded.config
        if not config.place.register:
            return []
        sets = [list(names) for names in config.photographed_together if names[0] in self.loaded.objects]
        grouped = {name for names in sets for name in names}
        sets += [[name] for name, one in self.loaded.objects.items() if one.placements and name not in grouped]
        return [[unit for name in names for unit in self._registered(name)] for names in sets]

    def tiles_of(self, name: str) -> list[tuple[int, int]]:
        """Return (first row, end row) of every texture tile of an object."""
        texels = self.loaded.objects[name].texels
        return tile_rows(texels.height, texels.width, self.loaded.config.rectify.tile_texels)

    def fitted_tiles(self, wildcards) -> list[str]:
        """Return the files of an object's fit: one if its texels share the gloss of paints, otherwise its tiles."""
        if self.loaded.config.fit.gloss_by_paint:
            return [f"results/{wildcards.object}/surface.h5"]
        return self.own_tiles(wildcards)

    def own_tiles(self, wildcards) -> list[str]:
        """Return the files with fits of an object's single texels, one for each tile."""
        return self._tiles(wildcards.object, "brdf")

    def observed_tiles(self, wildcards) -> list[str]:
        """Return the observation files of an object, one for each tile."""
        return self._tiles(wildcards.object, "observations")

    def _tiles(self, name: str, kind: str) -> list[str]:
        return [f"results/{name}/{kind}/tile-{number:03d}.h5" for number in range(len(self.tiles_of(name)))]

    def photograph_levels(self, wildcards) -> list[str]:
        """Return the file of the lamp's level in an object's photographs; none where nothing is to tell it."""
        if self.loaded.objects[wildcards.object].level_patch is not None:
            return [f"results/{wildcards.object}/patch_levels.h5"]
        return [f"results/{wildcards.object}/levels.h5"] if self.loaded.config.fit.level_by_photograph else []

    def observations_of_sheet(self, wildcards) -> list[str]:
        """Return the observation files of a thin sheet whose transmittance is measured; empty for other objects."""
        sheet = self.loaded.objects[wildcards.object].sheet
        return self.observed_tiles(wildcards) if sheet is not None and sheet.transmittance is None else []

    def levels_of_sheet(self, wildcards) -> list[str]:
        """Return the file of `photograph_levels` for such an object."""
        return self.photograph_levels(wildcards) if self.observations_of_sheet(wildcards) else []

    # ---- places

    def is_photographed(self, wildcards) -> bool:
        """Whether a camera photographed an environment, which otherwise is a picture file or placed lights."""
        return self.loaded.environments[wildcards.environment].camera is not None

    def photographed_light(self, wildcards) -> dict:
        """Return the named input files for the light of a photographed environment; empty for other environments."""
        if not self.is_photographed(wildcards):
            return {}
        folder = f"results/environments/{wildcards.environment}/linear"
        charts = self.captures["environments"][wildcards.environment][1:]
        return {
            "linear": f"{folder}/environment.h5",
            "room_charts": [f"{folder}/{chart}.h5" for chart in charts],
            "calibration": f"results/cameras/{self.camera_of(wildcards)}/calibration.h5",
        }

    def light_definition(self, wildcards) -> dict[str, Any]:
        """Return the parts of an environment's definition on which its light depends."""
        return light_definition(self.loaded.environments[wildcards.environment])

    def files_of_light(self, wildcards) -> list[str]:
        """Return the user's picture and spectral tables that an environment's light is made from."""
        return light_files(self.loaded.environments[wildcards.environment])
