"""Header and planes of a scene's page, from the files of the workflow."""

import math
from dataclasses import dataclass, replace
from datetime import date

import numpy as np

from irodori.colour.colorimetry import colour_matching_weights
from irodori.config.models import CollimatedLight, ObjectShape, OrthographicView, PerspectiveView, Scene
from irodori.config.pages import page_fault, page_illuminants, page_rooms, page_views
from irodori.config.placed_names import object_names
from irodori.core import store
from irodori.core.errors import InputError, PlainError
from irodori.core.provenance import config_hash
from irodori.geometry.rig_frame import look_at
from irodori.geometry.shapes.shape import Shape
from irodori.light.environment_file import Environment
from irodori.material.material_file import Material, Status
from irodori.reflection.lobes import Lobes
from irodori.rendering.energy_gain import refuse_energy_gain
from irodori.rendering.integrators import has_shadows, with_backs, with_bodies
from irodori.rendering.interactive.channels import is_grey
from irodori.rendering.interactive.frame_renderer import light_of
from irodori.rendering.interactive.quadrature import path_spectra, solve_quadrature
from irodori.rendering.scene_arrays import back_of, coats_of, make_objects, make_placements, placed_of_rows
from irodori.rendering.scene_lights import BANDS, make_lights
from irodori.spectra.grid import ERROR_NM, WAVELENGTH_NM
from irodori.spectra.published import light
from irodori.viewer import colours
from irodori.viewer.lesson import lesson_for_page
from irodori.viewer.measured import FrameParts
from irodori.viewer.payload import StoredPlanes, write_payload
from irodori.viewer.scene_data import (
    add_light,
    add_maps,
    add_materials,
    add_shapes,
    check_lobes,
    light_maps,
    lobe_entries,
)

#: Codes of a texel's origin: measured; gloss of its paint; colour of a neighbour; gloss unknown and shown as the
#: object's typical one.
MEASURED, PAINT, FILLED, UNKNOWN = 0, 1, 2, 3
#: Wavelengths that stand for a spectrum where mirrors have colours; the shader has room for 16.
_WAVELENGTHS = 14
_SINGLE_PLANE_BITS = 8
#: Bits of the standard error at a wavelength, on a logarithmic scale: what is decoded is within 8 % of it.
_SPECTRAL_BITS = 6
#: Names of maps of a material's file.
_STATUS, _ERROR, _SPECTRAL_ERROR = "status", "reflectance_error", "spectral_error"
_ERROR_NM = "error_wavelength"
#: Field of view in the page's state for a view with parallel rays, which do not use it.
_FOV_DEG = 34.0
#: Sine of the angle to the vertical below which a line of sight has no azimuth.
_VERTICAL = 1e-6


@dataclass(frozen=True)
class SceneSources:
    """A scene and the result files from which its page is made.

    Parameters
    ----------
    name : str
    scene : Scene
    shapes : tuple of ObjectShape
    materials : tuple of path
    environments : tuple of path
        Environment files of the rooms that `irodori.config.pages.page_rooms` names.
    least_throughput : float
        Throughput below which a path ends.
    """

    name: str
    scene: Scene
    shapes: tuple[ObjectShape, ...]
    materials: tuple
    environments: tuple
    least_throughput: float


@dataclass(frozen=True)
class PageData:
    """Header, planes and rooms from which a page is written.

    Parameters
    ----------
    header : dict
        JSON of the payload, see docs/viewer.md.
    planes : StoredPlanes
    rooms : tuple of FrameParts
        The same scene for the package's renderer, in each of the page's environments.
    """

    header: dict
    planes: StoredPlanes
    rooms: tuple[FrameParts, ...]

    @property
    def parts(self) -> FrameParts:
        """The scene in its own environment, the first of the rooms."""
        return self.rooms[0]

    def payload(self, stated_errors: dict) -> str:
        """Return the payload of the page, with the given measured errors in its header."""
        return write_payload({**self.header, "stated_errors": stated_errors}, self.planes)


def _status(material: Material) -> np.ndarray:
    """Return for each texel whether it was measured, filled, of a paint or of unknown gloss, (height, width) uint8."""
    found = np.full(material.alpha.shape, MEASURED, dtype=np.uint8)
    if _STATUS in material.extra:
        fit = material.extra[_STATUS][0]
        found[np.isin(fit, (Status.PAINT, Status.MIXTURE))] = PAINT
        found[fit == Status.MU_UNIDENTIFIABLE] = UNKNOWN
    found[~material.observed] = FILLED
    return found


def _with_maps(path) -> Material:
    """Return a material with the status map of its fit, and the standard errors of its reflectance if known."""
    material, extra = Material.load(path), {}
    with store.open_file(path) as file:
        if _SPECTRAL_ERROR in file and not np.array_equal(file.read(_ERROR_NM), ERROR_NM):
            raise InputError(path, _ERROR_NM, "other wavelengths", f"{len(ERROR_NM)} from 400 to 700 nm")
        for name in (_STATUS, _ERROR, _SPECTRAL_ERROR):
            if name in file:
                extra[name] = np.nan_to_num(file.read(name)), "1", name
    return replace(material, extra=extra)


def _uncertainty(material: Material) -> np.ndarray:
    """Return the standard error of the reflectance of each texel, (height, width); 0 where none is known."""
    return material.extra[_ERROR][0] if _ERROR in material.extra else np.zeros(material.alpha.shape)


def _spectral_error(material: Material) -> np.ndarray:
    """Return the standard error of each texel at `ERROR_NM`, (wavelengths, height, width); 0 where none is known."""
    if _SPECTRAL_ERROR not in material.extra:
        return np.zeros((len(ERROR_NM), *material.alpha.shape))
    return np.moveaxis(material.extra[_SPECTRAL_ERROR][0], -1, 0)


def _camera(view: PerspectiveView | OrthographicView) -> dict:
    """Return a view as an orbit around its target: azimuth, elevation, roll, distance, and field of view or height.

    For a view straight down or up, the azimuth gives the orientation of the picture, and the roll is 0.
    """
    right, _, forward = look_at(view.position_mm, view.target_mm, view.up).T
    slant = math.hypot(forward[0], forward[1])
    vertical = slant < _VERTICAL
    azimuth = math.atan2(-right[0], right[1]) if vertical else math.atan2(-forward[1], -forward[0])
    level = np.array([-math.sin(azimuth), math.cos(azimuth), 0.0])
    roll = 0.0 if vertical else math.atan2(right @ np.cross(level, forward), right @ level)
    return {
        "target_mm": [float(x) for x in view.target_mm],
        "azimuth_deg": math.degrees(azimuth),
        "elevation_deg": math.degrees(math.atan2(-forward[2], slant)),
        "distance_mm": float(np.linalg.norm(np.subtract(view.position_mm, view.target_mm))),
        "fov_deg": float(view.field_of_view_deg) if isinstance(view, PerspectiveView) else _FOV_DEG,
        "roll_deg": math.degrees(roll),
        "height_mm": float(view.height_mm) if isinstance(view, OrthographicView) else 0.0,
    }


def _views(scene: Scene) -> list[dict]:
    """Return names and cameras of the views that a page can show."""
    return [{"name": name, "camera": _camera(scene.views[name])} for name in page_views(scene)]


def _lamps(scene: Scene) -> list[dict]:
    """Return the scene's collimated lights in the form of the page's movable lamps."""
    found = []
    for item in scene.lights:
        assert isinstance(item, CollimatedLight)  # checked: a scene with a page has no other lights
        direction = make_lights([item], 0)[0].rotation[0, :, 2]
        found.append(
            {
                "position_mm": [float(1000.0 * x) for x in direction],
                "size_mm": 0.0,
                "far": True,
                "strength": float(item.irradiance),
                "illuminant": {"power": [float(x) for x in light(item.spectrum)], "label": item.spectrum},
                "on": True,
            }
        )
    return found


def _add_quadrature(planes: StoredPlanes, number: int, parts: FrameParts) -> dict:
    """Solve a room's spectral quadrature; store the second moments of path spectra, return the wavelengths' indices."""
    spectra = path_spectra(parts.objects, light_of(parts.environment), parts.lamps, parts.max_bounces)
    weights = colour_matching_weights()
    level = spectra @ weights[1]
    spectra = spectra[level > 1e-9 * level.max()]
    spectra = spectra / (spectra @ weights[1])[:, None]
    found = solve_quadrature(spectra, weights, spectra.mean(axis=0), counts=(_WAVELENGTHS,))
    planes.add_floats(f"quadrature/{number}/moments", spectra.T @ spectra)
    return {"samples": [int(s) for s in found.samples]}


def page_data(sources: SceneSources) -> PageData:
    """Return header, planes and rooms from which the page of a scene is written.

    Raises
    ------
    PlainError
        If the page cannot show the scene, or a material reflects more light than falls on it.
    """
    name, scene, material_files = sources.name, sources.scene, sources.materials
    shapes = [Shape.from_definition(s) for s in sources.shapes]
    loaded = [_with_maps(path) for path in material_files]
    fault = page_fault(scene)
    if fault is not None:
        field, found, accepted = fault
        raise PlainError(f"The scene {name}: {field}: found {found}; accepted: {accepted}.")
    loaded = with_backs(scene, loaded)
    refuse_energy_gain(scene, shapes, material_files, loaded)
    shapes, materials = with_bodies(scene, shapes, loaded)
    placements = make_placements(scene, shapes)
    objects, filled = make_objects(placements, materials)
    check_lobes(Lobes(objects.lobes.names))
    lights = make_lights(scene.lights, 0)[0]
    rooms = tuple(
        FrameParts(
            objects,
            placements,
            Environment.load(file),
            lights.spectrum[:, :BANDS].astype(np.float64),
            lights.rotation[:, :, 2],
            scene.max_bounces,
            sources.least_throughput,
            has_shadows(scene),
        )
        for file in sources.environments
    )
    planes = StoredPlanes()
    lit = [add_light(planes, i, light_maps(room.environment, objects)) for i, room in enumerate(rooms)]
    entries = [{"map": None, "behind": None, "through": None} | one for one in add_materials(planes, objects)]
    maps = add_maps(planes, placements, objects, len(scene.bodies)) if has_shadows(scene) else [None] * len(entries)
    sides = [back_of(m, shapes[i]) for i, m in enumerate(materials) if m.is_sheet]
    uncertainties = [_uncertainty(material) for material in (*materials, *sides)]
    for i, (material, error) in enumerate(zip((*materials, *sides), uncertainties, strict=True)):
        planes.add_integers(f"object/{i}/status", _status(material)[None])
        planes.add_log(f"object/{i}/uncertainty", error[None], _SINGLE_PLANE_BITS)
        planes.add_log(f"object/{i}/spectral_error", _spectral_error(material), _SPECTRAL_BITS)
        planes.add_linear(f"object/{i}/alpha", np.nan_to_num(material.filled()[0].alpha)[None])
        rows = {"behind": int(objects.behind[i]), "through": int(objects.through[i])}
        entries[i] |= {key: row for key, row in rows.items() if row >= 0} | {"map": maps[i]}
    turns = [item.rotation_deg for item in scene.objects] + [item.rotation_deg for item in scene.bodies]
    names = object_names(scene)
    for i, shape in enumerate(add_shapes(planes, placements)):
        entries[i] |= shape | {
            "name": names[i],
            "rotation_deg": [float(x) for x in turns[i]],
            "filled_fraction": float(filled[i]),
        }
    of_sides = zip(entries[len(placements) :], placed_of_rows(objects)[len(placements) :], strict=True)
    weights = colour_matching_weights()
    header = {
        "scene": name,
        "made": date.today().isoformat(),
        "title": scene.description,
        "units": {"length": "mm", "wavelength": "nm", "reflectance": "1", "radiance": "relative"},
        "hashes": {
            "scene": config_hash(scene.plain()),
            "materials": [store_hash(path) for path in material_files],
            "environments": [store_hash(path) for path in sources.environments],
        },
        "wavelength_nm": [float(x) for x in WAVELENGTH_NM],
        "error_nm": [float(x) for x in ERROR_NM],
        "objects": entries[: len(placements)],
        "sides": [entry | {"of": index} for entry, index in of_sides],
        "lobes": lobe_entries(objects),
        "coats": coats_of(objects).n_k.tolist(),
        "environments": page_rooms(scene),
        "light": lit,
        "lamps": _lamps(scene),
        "views": _views(scene),
        "image": [scene.image.width, scene.image.height],
        "max_bounces": scene.max_bounces,
        "least_throughput": sources.least_throughput,
        "ambient": has_shadows(scene),
        "quadrature": None if is_grey(objects) else [_add_quadrature(planes, i, room) for i, room in enumerate(rooms)],
        "illuminants": colours.illuminants(page_illuminants(scene)),
        "observers": colours.observers(),
        "daylight": colours.daylight(),
        "unit_luminance": float(weights[1] @ light("D65")),
        "displays": colours.displays(),
        "deficiencies": colours.deficiencies(),
        "most_uncertainty": float(max([np.percentile(error, 99) for error in uncertainties if error.any()], default=1)),
        "lesson": lesson_for_page(scene.lesson),
    }
    return PageData(header, planes, rooms)


def store_hash(path) -> str:
    """Return the hashes of the configuration and the code that produced a result file, joined by a hyphen."""
    with store.open_file(path) as file:
        return "-".join(str(file.attribute(name)) for name in ("config_hash", "code_hash"))
