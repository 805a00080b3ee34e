"""Header and planes of a scene's page, from the files of the workflow."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import date

import numpy as np

from irodori.colour.colorimetry import colour_matching_weights
from irodori.config.models import CollimatedLight, ObjectShape, PerspectiveView, Scene
from irodori.config.pages import has_page, page_views
from irodori.core import store
from irodori.core.errors import PlainError
from irodori.core.provenance import config_hash
from irodori.geometry.shapes.shape import Shape
from irodori.light.environment_file import Environment
from irodori.material.material_file import Material, Status
from irodori.reflection.lobes import Lobes
from irodori.rendering.integrators import has_ambient, with_bodies
from irodori.rendering.interactive.channels import is_grey
from irodori.rendering.interactive.frame_renderer import light_of
from irodori.rendering.interactive.quadrature import path_spectra, solve_quadrature
from irodori.rendering.scene_arrays import make_objects, make_placements
from irodori.rendering.scene_lights import BANDS, make_lights
from irodori.spectra.grid import WAVELENGTH_NM
from irodori.spectra.published import light
from irodori.viewer import colours
from irodori.viewer.lesson import lesson_for_page
from irodori.viewer.measured import Parts
from irodori.viewer.payload import Planes, write_payload
from irodori.viewer.scene_data import (
    add_light,
    add_materials,
    add_shapes,
    check_lobes,
    light_maps,
    lobe_entries,
)

#: What a page says of a texel: measured; its gloss that of its paint; its colour that of a neighbour; its gloss
#: unknown, and shown as the object's typical one.
MEASURED, PAINT, FILLED, UNKNOWN = 0, 1, 2, 3
#: Wavelengths that stand for a spectrum where mirrors have colours; the shader has room for 16.
_WAVELENGTHS = 14
_SINGLE_PLANE_BITS = 8


@dataclass(frozen=True)
class PageData:
    """What a page is written from.

    Parameters
    ----------
    header : dict
        JSON of the payload, see docs/viewer.md.
    planes : Planes
    parts : Parts
        The same scene for the product's own renderer.
    """

    header: dict
    planes: Planes
    parts: Parts

    def payload(self, stated_errors: dict) -> str:
        """Return the payload with the errors that were measured."""
        return write_payload({**self.header, "stated_errors": stated_errors}, self.planes)


def _status(material: Material) -> np.ndarray:
    """Return what is known of each texel, (height, width) uint8."""
    found = np.full(material.alpha.shape, MEASURED, dtype=np.uint8)
    if "status" in material.extra:
        fit = material.extra["status"]
        found[fit == Status.PAINT] = PAINT
        found[fit == Status.MU_UNIDENTIFIABLE] = UNKNOWN
    found[~material.observed] = FILLED
    return found


def _with_maps(path) -> tuple[Material, np.ndarray]:
    """Return a material with the outcome of its fit, and the standard error of its reflectance."""
    material = Material.load(path)
    with store.open_file(path) as file:
        status = file.read("status") if "status" in file else np.zeros(material.alpha.shape, np.int8)
        error = file.read("reflectance_error") if "reflectance_error" in file else np.zeros(material.alpha.shape)
    extra = {**material.extra, "status": status}
    return replace(material, extra=extra), np.nan_to_num(error)


def _camera(view: PerspectiveView) -> dict:
    away = np.subtract(view.position_mm, view.target_mm)
    distance = float(np.linalg.norm(away))
    return {
        "target_mm": [float(x) for x in view.target_mm],
        "azimuth_deg": math.degrees(math.atan2(away[1], away[0])),
        "elevation_deg": math.degrees(math.asin(away[2] / distance)),
        "distance_mm": distance,
        "fov_deg": float(view.field_of_view_deg),
    }


def _views(scene: Scene) -> list[dict]:
    """Return the views that a page can show."""
    views = {name: scene.views[name] for name in page_views(scene)}
    return [{"name": n, "camera": _camera(view)} for n, view in views.items() if isinstance(view, PerspectiveView)]


def _lamps(scene: Scene) -> list[dict]:
    """Return the scene's own lamps as the page moves them."""
    found = []
    for item in scene.lights:
        assert isinstance(item, CollimatedLight)  # what a scene with a page has
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


def _add_quadrature(planes: Planes, parts: Parts) -> dict | None:
    """Add the moments of what paths carry where mirrors or gloss have colours; return the wavelengths' places."""
    if is_grey(parts.objects):
        return None
    spectra = path_spectra(parts.objects, light_of(parts.environment), parts.lamps, parts.max_bounces)
    weights = colour_matching_weights()
    level = spectra @ weights[1]
    spectra = spectra[level > 1e-9 * level.max()]
    spectra = spectra / (spectra @ weights[1])[:, None]
    found = solve_quadrature(spectra, weights, spectra.mean(axis=0), counts=(_WAVELENGTHS,))
    planes.add_floats("quadrature/moments", spectra.T @ spectra)
    return {"samples": [int(s) for s in found.samples]}


def _names(scene: Scene) -> list[str]:
    """Return a name of each object and body, each its own."""
    given = [item.object for item in scene.objects] + [f"body-{i + 1}" for i in range(len(scene.bodies))]
    return [f"{name}#{given[: i + 1].count(name)}" if name in given[:i] else name for i, name in enumerate(given)]


def page_data(
    name: str,
    scene: Scene,
    shapes: Sequence[ObjectShape],
    material_files: Sequence,
    environment_file,
    least_throughput: float,
) -> PageData:
    """Return what the page of a scene is written from.

    Parameters
    ----------
    name : str
    scene : Scene
    shapes : sequence of ObjectShape
    material_files : sequence of path
    environment_file : path
    least_throughput : float
        Under which a path ends.

    Raises
    ------
    PlainError
        If the page cannot show what the scene holds.
    """
    if not has_page(scene):
        raise PlainError(
            f"The scene {name}: found no upright perspective view through a pinhole, or a light that is not "
            "collimated; accepted: such a view, and collimated lights."
        )
    loaded = [_with_maps(path) for path in material_files]
    whole = with_bodies(scene, [Shape.from_definition(s) for s in shapes], [material for material, _ in loaded])
    placements = make_placements(scene, whole[0])
    objects, filled = make_objects(placements, whole[1])
    check_lobes(Lobes(objects.lobes.names))
    environment = Environment.load(environment_file)
    lights = make_lights(scene.lights, 0)[0]
    parts = Parts(
        objects,
        placements,
        environment,
        lights.spectrum[:, :BANDS].astype(np.float64),
        lights.rotation[:, :, 2],
        scene.max_bounces,
        least_throughput,
        has_ambient(scene),
    )
    planes = Planes()
    lit = [add_light(planes, 0, light_maps(environment, objects))]
    entries = [{**a, **b} for a, b in zip(add_materials(planes, objects), add_shapes(planes, placements), strict=True)]
    uncertainties = [error for _, error in loaded] + [np.zeros(m.alpha.shape) for m in whole[1][len(loaded) :]]
    turns = [item.rotation_deg for item in scene.objects] + [item.rotation_deg for item in scene.bodies]
    for i, (material, error) in enumerate(zip(whole[1], uncertainties, strict=True)):
        planes.add_integers(f"object/{i}/status", _status(material)[None])
        planes.add_log(f"object/{i}/uncertainty", error[None], _SINGLE_PLANE_BITS)
        planes.add_linear(f"object/{i}/alpha", np.nan_to_num(material.filled()[0].alpha)[None])
        entries[i] |= {
            "name": _names(scene)[i],
            "rotation_deg": [float(x) for x in turns[i]],
            "filled_fraction": float(filled[i]),
        }
    weights = colour_matching_weights()
    header = {
        "scene": name,
        "made": date.today().isoformat(),
        "title": scene.description,
        "units": {"length": "mm", "wavelength": "nm", "reflectance": "1", "radiance": "relative"},
        "hashes": {
            "scene": config_hash(scene.plain()),
            "materials": [store_hash(path) for path in material_files],
            "environment": store_hash(environment_file),
        },
        "wavelength_nm": [float(x) for x in WAVELENGTH_NM],
        "objects": entries,
        "lobes": lobe_entries(objects),
        "environments": [scene.environment],
        "light": lit,
        "lamps": _lamps(scene),
        "views": _views(scene),
        "image": [scene.image.width, scene.image.height],
        "max_bounces": scene.max_bounces,
        "least_throughput": least_throughput,
        "ambient": parts.ambient,
        "quadrature": _add_quadrature(planes, parts),
        "illuminants": colours.illuminants(),
        "observers": colours.observers(),
        "daylight": colours.daylight(),
        "unit_luminance": float(weights[1] @ light("D65")),
        "displays": colours.displays(),
        "deficiencies": colours.deficiencies(),
        "most_uncertainty": float(max([np.percentile(error, 99) for error in uncertainties if error.any()], default=1)),
        "lesson": lesson_for_page(scene.lesson),
    }
    return PageData(header, planes, parts)


def store_hash(path) -> str:
    """Return the hash of the code and the configuration that a file was made by."""
    with store.open_file(path) as file:
        return "-".join(str(file.attribute(name)) for name in ("config_hash", "code_hash"))
