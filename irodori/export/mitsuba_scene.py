"""Scenes for Mitsuba 3: an XML file, the coefficients as NumPy archives, meshes, and a plugin that reads them.

The materials are not approximated: the plugin (`irodori.export.irodori_mitsuba`) evaluates the same lobes, Fresnel
reflectance and spectra from the same coefficients. One difference remains: Mitsuba interpolates each spectrum between
the 61 wavelengths before it multiplies spectra, whereas our renderers multiply at the 61 wavelengths.
"""

import json
import shutil
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from irodori import __version__
from irodori.colour.colorimetry import colour_matching_weights, xyz_from_radiance
from irodori.core.atomic_files import written_whole
from irodori.core.errors import InputError, PlainError
from irodori.export.export_sources import Item, Source
from irodori.geometry.mesh import Mesh
from irodori.geometry.shapes.placement import reaches
from irodori.geometry.shapes.shape import Shape
from irodori.light.environment_file import Environment
from irodori.material.material_file import Material
from irodori.reflection.coat import COUPLED
from irodori.rendering.scene_arrays import back_of
from irodori.rendering.scene_lights import BALL, BANDS, COLLIMATED, make_lights
from irodori.rendering.scene_white import shown_white
from irodori.spectra.grid import WAVELENGTH_NM

PLUGIN, SCENE, ABOUT = "irodori_mitsuba.py", "scene.xml", "about.json"
_SAMPLES = 64
#: Lobes that the plugin implements.
LOBES = ("gaussian", "ggx")
#: Factor by which endless shapes extend farther than in other exports.
_FARTHER = 100.0
#: Mitsuba's divisor of ∫ L x̄ dλ (its MI_CIE_Y_NORMALIZATION); the integral of its table of ȳ is 0.1 % larger.
_THEIR_Y_NM = 106.7502593994140625


def _element(parent, tag: str, kind: str | None = None, name: str | None = None, **attributes):
    given = {"type": kind, "name": name, **{key: str(value) for key, value in attributes.items()}}
    return ElementTree.SubElement(parent, tag, {key: value for key, value in given.items() if value is not None})


def _matrix(parent, matrix: np.ndarray) -> None:
    transform = _element(parent, "transform", name="to_world")
    _element(transform, "matrix", value=" ".join(f"{value:.9g}" for value in matrix.ravel()))


def _spectrum(parent, name: str, values: np.ndarray) -> None:
    """Add a spectrum to a parent element; outside 400 to 700 nm it keeps its end values, as in our colorimetry."""
    held = np.interp(np.arange(360.0, 831.0, 5.0), WAVELENGTH_NM, values)
    spectrum = _element(parent, "spectrum", "regular", name)
    _element(spectrum, "float", name="wavelength_min", value=360.0)
    _element(spectrum, "float", name="wavelength_max", value=830.0)
    _element(spectrum, "string", name="values", value=", ".join(f"{value:.9g}" for value in held))


def _write_ply(path: Path, mesh: Mesh) -> None:
    corners = np.concatenate([mesh.vertices_mm[mesh.faces], mesh.normals, mesh.uv], axis=-1).reshape(-1, 8)
    unique, index = np.unique(corners.astype("<f4"), axis=0, return_inverse=True)
    faces = np.empty(len(mesh.faces), dtype=[("count", "u1"), ("corner", "<i4", 3)])
    faces["count"], faces["corner"] = 3, index.reshape(-1, 3)
    names = "".join(f"property float {name}\n" for name in ("x", "y", "z", "nx", "ny", "nz", "u", "v"))
    head = (f"ply\nformat binary_little_endian 1.0\nelement vertex {len(unique)}\n{names}element face {len(faces)}\n"
            "property list uchar int vertex_indices\nend_header\n")  # fmt: skip
    with written_whole(path) as temporary:
        temporary.write_bytes(head.encode() + unique.tobytes() + faces.tobytes())


def _write_archive(path: Path, **arrays) -> None:
    with written_whole(path) as temporary:
        np.savez(temporary, **arrays)


def _side(material: Material, sent: Material | None, shape: Shape) -> dict:
    """Return the plugin's arrays for one side of a surface, without the gaps of its maps.

    These are texels (h, w, k + 2 c + m), with k coefficients, β and μ of c gloss components, and m coefficients of the
    transmittance ``sent``; the bases (k, 61) and, under the name ``passed``, (m, 61); refractive index (2, 61).
    """
    covered = shape.is_covered(*material.alpha.shape[::-1])
    material, _ = material.filled(covered)
    maps = [material.coefficients * material.spectrum_scale[..., None]]
    maps += [values[..., None] for _, *pair in material.gloss for values in pair]
    passed = np.zeros((0, len(WAVELENGTH_NM)), dtype=np.float32)
    if sent is not None:
        sent, _ = sent.resized(material.alpha.shape).filled(covered)
        maps.append(sent.coefficients * sent.spectrum_scale[..., None])
        passed = sent.basis.T.astype(np.float32)
    return {
        "texels": np.nan_to_num(np.concatenate(maps, axis=-1)).astype(np.float32),
        "basis": material.basis.T.astype(np.float32),
        "passed": passed,
        "index": np.stack([material.n, material.k]),
        "mirror": float(material.mirror),
        "coupled": material.coat == COUPLED,
        "lobes": np.array(material.lobes),
    }


def _write_surface(path: Path, item: Item) -> None:
    """Write the archive that the plugin's BSDF reads; the arrays of a sheet's back have the prefix ``back_``."""
    shape, material = item.placement.shape, item.material
    arrays = _side(material, material.through, shape)
    if material.is_sheet:
        back = _side(back_of(material, shape), material.through, shape)
        arrays |= {f"back_{name}": values for name, values in back.items()}
    _write_archive(
        path,
        **arrays,
        wraps=shape.wraps,
        rotation=item.placement.rotation,
        is_ball=shape.ball_mm is not None,
    )


def _add_item(root, folder: Path, item: Item, number: int, reach_mm: float) -> None:
    place, stem = item.placement, f"{number:02d}-{item.name}"
    radius = place.shape.ball_mm
    if radius is None:
        element = _element(root, "shape", "ply", id=stem)
        _element(element, "string", name="filename", value=f"{stem}.ply")
        _write_ply(folder / f"{stem}.ply", place.shape.facetted(_FARTHER * reach_mm / place.scale))
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = place.scale * place.rotation, place.translation_mm
        _matrix(element, matrix)
    else:
        # The plugin rotates the texture instead of the ball: Mitsuba warns of the rounding errors of a rotated ball.
        element = _element(root, "shape", "sphere", id=stem)
        x, y, z = map(float, place.translation_mm)
        _element(element, "point", name="center", x=x, y=y, z=z)
        _element(element, "float", name="radius", value=radius * place.scale)
    bsdf = _element(element, "bsdf", "irodori_surface")
    _element(bsdf, "string", name="file", value=f"{stem}.npz")
    _write_surface(folder / f"{stem}.npz", item)


def _add_lights(root, source: Source) -> None:
    assert source.scene is not None
    lights, _ = make_lights(source.scene.lights, 0)
    for i, kind in enumerate(lights.kind):
        spectrum = lights.spectrum[i, :BANDS].astype(np.float64)
        if kind == COLLIMATED:
            element = _element(root, "emitter", "directional")
            x, y, z = map(float, -lights.rotation[i, :, 2])
            _element(element, "vector", name="direction", x=x, y=y, z=z)
            _spectrum(element, "irradiance", spectrum)
            continue
        matrix, size = np.eye(4), lights.size_mm[i]
        half = np.full(3, size[0]) if kind == BALL else np.array([*size, 2.0]) / 2.0
        matrix[:3, :3], matrix[:3, 3] = lights.rotation[i] * half, lights.position_mm[i]
        element = _element(root, "shape", "sphere" if kind == BALL else "rectangle")
        _matrix(element, matrix)
        black = _element(element, "bsdf", "diffuse")
        _element(black, "spectrum", name="reflectance", value="0")
        _spectrum(_element(element, "emitter", "area"), "radiance", spectrum)


def _add_view(root, source: Source, name: str) -> None:
    assert source.scene is not None
    view, image = source.scene.views[name], source.scene.image
    position, target, up = (", ".join(f"{x:.9g}" for x in v) for v in (view.position_mm, view.target_mm, view.up))
    if view.kind == "orthographic":
        sensor = _element(root, "sensor", "orthographic", id=name)
        transform = _element(sensor, "transform", name="to_world")
        half = 0.5 * view.height_mm * image.width / image.height  # Mitsuba's picture is two units wide
        _element(transform, "scale", x=half, y=half, z=1.0)
    else:
        sensor = _element(root, "sensor", "perspective" if view.lens is None else "thinlens", id=name)
        transform = _element(sensor, "transform", name="to_world")
        _element(sensor, "string", name="fov_axis", value="y")
        _element(sensor, "float", name="fov", value=float(view.field_of_view_deg))
        if view.lens is not None:
            _element(sensor, "float", name="aperture_radius", value=0.5 * view.lens.diameter_mm)
            _element(sensor, "float", name="focus_distance", value=float(view.lens.focus_mm))
    _element(transform, "lookat", origin=position, target=target, up=up)
    far = float(np.linalg.norm(np.subtract(view.position_mm, view.target_mm)))
    _element(sensor, "float", name="near_clip", value=1e-3 * far)
    _element(sensor, "float", name="far_clip", value=1e5 * far)
    film = _element(sensor, "film", "hdrfilm")
    _element(film, "integer", name="width", value=image.width)
    _element(film, "integer", name="height", value=image.height)
    _element(film, "string", name="pixel_format", value="xyz")
    _element(film, "string", name="component_format", value="float32")
    _element(film, "rfilter", "box")
    sampler = _element(sensor, "sampler", "independent")
    _element(sampler, "integer", name="sample_count", value=_SAMPLES)


def scale_to_xyz(white: np.ndarray) -> float:
    """Return the factor from values of Mitsuba's XYZ film to XYZ with Y = 100 for white, a radiance (61,)."""
    return float(100.0 * _THEIR_Y_NM / (colour_matching_weights()[1] @ white))


def write_mitsuba(source: Source, folder) -> None:
    """Write a scene for Mitsuba into a folder, which is created if it does not exist.

    Parameters
    ----------
    source : Source
        A scene.
    folder : path

    Raises
    ------
    PlainError
        If the source is not a scene and so has no light, or if it has a lobe that the plugin does not implement.
    InputError
        If no light falls on the scene, or a file has the name of the folder.
    """
    if source.scene is None:
        raise PlainError(f"--to mitsuba: found the {source.kind} {source.name!r}; accepted: a scene, which has light.")
    sides = [one for item in source.items for one in (item.material, item.material.back) if one is not None]
    unknown = [name for side in sides for name in side.lobes if name not in LOBES]
    if unknown:
        raise PlainError(f"--to mitsuba: found the lobe {unknown[0]!r}; accepted: {', '.join(LOBES)}.")
    folder = Path(folder)
    if folder.exists() and not folder.is_dir():
        raise InputError(folder, "", "a file", "the name of a folder, which may be there already")
    folder.mkdir(parents=True, exist_ok=True)
    environment = Environment.load(source.environment)
    white, _ = shown_white(source.scene, environment, source.environment)
    reach = float(max(reaches([item.placement for item in source.items])))
    eyes: Sequence = [view.position_mm for view in source.scene.views.values()]
    places = [item.placement.translation_mm for item in source.items]
    radius = 4.0 * (reach + max(float(np.linalg.norm(place)) for place in [*eyes, *places]))
    if any(item.placement.shape.is_endless for item in source.items):
        radius *= 100.0 * _FARTHER
    root = ElementTree.Element("scene", {"version": "3.0.0"})
    integrator = _element(root, "integrator", "path")
    _element(integrator, "integer", name="max_depth", value=-1)
    for name in source.scene.views:
        _add_view(root, source, name)
    for number, item in enumerate(source.items):
        _add_item(root, folder, item, number, reach)
    _write_archive(folder / "sky.npz", coefficients=environment.coefficients, basis=environment.basis.T)
    sky = _element(root, "emitter", "irodori_sky")
    _element(sky, "string", name="file", value="sky.npz")
    _element(sky, "float", name="radius", value=radius)
    _add_lights(root, source)
    shutil.copyfile(Path(__file__).with_name(PLUGIN), folder / PLUGIN)
    ElementTree.indent(root)
    with written_whole(folder / SCENE) as temporary:
        ElementTree.ElementTree(root).write(temporary, encoding="utf-8", xml_declaration=True)
    matrix = xyz_from_radiance(white)
    (folder / ABOUT).unlink(missing_ok=True)
    add_to_about(folder, {
        "generator": f"irodori {__version__}",
        "scene": source.name,
        "scale_to_xyz": scale_to_xyz(white),
        "white_xyz": (matrix @ white).tolist(),
        "xyz_from_radiance": matrix.tolist(),
        "materials": {item.name: item.sha256 for item in source.items if item.sha256},
    })  # fmt: skip


def add_to_about(folder, content: dict) -> None:
    """Add entries to ``about.json`` in the folder of an export."""
    path = Path(folder) / ABOUT
    held = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    with written_whole(path) as temporary:
        temporary.write_text(json.dumps(held | content, indent=1), encoding="utf-8")
