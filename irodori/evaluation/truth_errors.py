"""Errors against ground truth: mean, 95th percentile and maximum [design, §5]."""

import numpy as np

from irodori.colour.colorimetry import (
    delta_e_of_light,
    delta_e_reflectance,
    goodness_of_fit,
    spectral_rmse,
    summary,
    xyz_from_radiance,
)
from irodori.config.models import Scene
from irodori.core import store
from irodori.core.progress import LOGGER
from irodori.evaluation.result_tables import ErrorRow, write_rows
from irodori.export.pictures import read_xyz
from irodori.geometry.shapes.shape import Shape
from irodori.light.environment_file import Environment, directions
from irodori.light.irradiance import irradiance_at
from irodori.material.material_file import Material, Status, gloss_names
from irodori.rendering.reference.distance import body_pixels
from irodori.rendering.scene_arrays import make_view
from irodori.rendering.scene_white import scene_white


def _row(subject: str, quantity: str, values, light: str = "") -> ErrorRow:
    figures = summary(values)
    count = int(figures.pop("count"))
    return ErrorRow(subject, quantity, light, count, **figures)


def interior(truth: Material) -> np.ndarray:
    """Return the texels whose 5 x 5 neighbourhood has one true material, (height, width) bool.

    At a seam between two paints a photograph shows their mixture, which is not an error of colour recovery.
    """
    from scipy import ndimage  # slow to import

    index = truth.coefficients.argmax(axis=-1)
    # The border of the texture does not count as a seam: the last texels are repeated beyond it.
    return ndimage.maximum_filter(index, 5, mode="nearest") == ndimage.minimum_filter(index, 5, mode="nearest")


def material_errors(name: str, material: Material, truth: Material, lights: list[str]) -> list[ErrorRow]:
    """Return the errors of one object: reflectance, over all observed texels and away from seams, and parameters."""
    rows = []
    inside = interior(truth)
    for label, chosen in (("", material.observed), (" away from seams", material.observed & inside)):
        estimate, exact = material.coefficients[chosen] @ material.basis.T, truth.coefficients[chosen] @ truth.basis.T
        rows += [
            _row(name, f"reflectance CIEDE2000{label}", delta_e_reflectance(exact, estimate, light), light)
            for light in lights
        ]
        rows.append(_row(name, f"reflectance spectral RMSE{label}", spectral_rmse(exact, estimate)))
        rows.append(_row(name, f"reflectance 1 - GFC{label}", 1.0 - goodness_of_fit(exact, estimate)))
    off = np.abs(material.alpha - truth.alpha)[material.observed & inside]
    rows.append(_row(name, "alpha absolute away from seams", off))
    for component, pair in enumerate(comparable_gloss(material, truth)):
        known = np.isfinite(material.gloss[component][2]) & inside
        for parameter, own, exact in zip(gloss_names(component), material.gloss[component][1:], pair, strict=True):
            off = np.abs(own / exact - 1)[known]
            rows.append(_row(name, f"{parameter} relative away from seams, where known", off))
    rows.append(_row(name, "alpha / S_G - 1", np.abs(material.spectrum_scale - 1)[material.observed]))
    return rows


def alpha_coverage(name: str, path, material: Material, truth: Material) -> list[ErrorRow]:
    """Return how often the error of α, away from seams, lies within what the fit states; none of an older file.

    The part that all texels share, such as the lamp's level, is one error and not one of each texel. It is told apart:
    the factor by which the median texel is off over its standard error, and the rest over what is stated for each.

    Parameters
    ----------
    name : str
    path : path
        Of the material's file.
    material, truth : Material
    """
    with store.open_file(path) as file:
        common = file.attribute("errors", dict).get("common_error")
        if common is None:
            return []
        stated = file.read("alpha_error")
    chosen = material.observed & interior(truth) & np.isfinite(stated) & (truth.alpha > 0.0)
    if not chosen.any():
        return []
    alpha, exact, stated = material.alpha[chosen], truth.alpha[chosen], stated[chosen]
    factor = float(np.median(alpha / exact))
    own = np.sqrt(np.maximum(stated**2 - (common * alpha) ** 2, 0.0))
    rows = []
    for label, off, error in (
        ("", alpha - exact, stated),
        (", without the common factor", alpha / factor - exact, own),
    ):
        for count in (1, 2):
            quantity = f"alpha within {count} standard error{'s' * (count > 1)}{label}"
            rows.append(_row(name, quantity, np.abs(off) <= count * error))
    if common > 0.0:
        rows.append(_row(name, "common factor of alpha over its standard error", [abs(factor - 1.0) / common]))
    return rows


def comparable_gloss(material: Material, truth: Material) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return the true β and μ of each gloss component of a material; NaN where there is no comparable true value.

    The first component with a lobe is compared with the first true component with that lobe, the second with the
    second. A texel has no comparable value if its true gloss lacks that component, or has a component that the
    material lacks.
    """

    def keyed(one: Material) -> dict[tuple[str, int], tuple[np.ndarray, np.ndarray]]:
        return {(n, one.lobes[:c].count(n)): (beta, mu) for c, (n, beta, mu) in enumerate(one.gloss)}

    own, true = keyed(material), keyed(truth)
    other = np.zeros(truth.alpha.shape, dtype=bool)
    for key, (beta, _) in true.items():
        if key not in own:
            other |= ~(beta == 0.0)
    nothing = np.full(truth.alpha.shape, np.nan)
    pairs = []
    for key in own:
        beta, mu = true.get(key, (nothing, nothing))
        has = (beta > 0.0) & ~other
        pairs.append((np.where(has, beta, np.nan), np.where(has, mu, np.nan)))
    return pairs


def radiance_delta_e(truth: np.ndarray, estimate: np.ndarray, white: np.ndarray) -> np.ndarray:
    """Return CIEDE2000, (...), between two radiance images, (..., 61).

    Parameters
    ----------
    truth, estimate : (..., 61) float
    white : (61,) float
        Radiance of white. For brighter pixels see `irodori.colour.colorimetry.delta_e_of_light`.
    """
    matrix = xyz_from_radiance(white)
    return delta_e_of_light(truth @ matrix.T, estimate @ matrix.T, matrix @ white)


def environment_errors(name: str, environment: Environment, truth: Environment) -> list[ErrorRow]:
    """Return the colour errors of recovered light: those of the panorama and those of its irradiance map."""
    white = truth.upward_white()
    step = 4
    exact, found = (e.coefficients[::step, ::step] @ e.basis.T for e in (truth, environment))
    # The two maps may have different resolutions: both are looked up at the same normals.
    normals = directions(128, 64)[0]
    exact_map, found_map = (irradiance_at(e.irradiance, normals) @ e.basis.T / np.pi for e in (truth, environment))
    return [
        _row(name, "light CIEDE2000", radiance_delta_e(exact, found, white)),
        _row(name, "irradiance CIEDE2000", radiance_delta_e(exact_map, found_map, white)),
    ]


def outcome(name: str, path) -> list[ErrorRow]:
    """Return the relative residual of the fit of an object, and the share of its texels with each fit status."""
    with store.open_file(path) as file:
        residual, status = file.read("relative_residual"), file.read("status")
    rows = [_row(name, "residual over response", residual)]
    return rows + [_row(name, f"share of texels: {s.name.lower().replace('_', ' ')}", status == s) for s in Status]


def calibration_errors(name: str, path, lights: list[str]) -> list[ErrorRow]:
    """Read the leave-one-patch-out errors from a calibration file."""
    with store.open_file(path) as file:
        rows = [_row(name, "leave-one-patch-out spectral RMSE", file.read("leave_one_out/rmse"))]
        for light in lights:
            key = f"leave_one_out/delta_e_{light.lower()}"
            if key in file:
                rows.append(_row(name, "leave-one-patch-out CIEDE2000", file.read(key), light))
    return rows


def measure_errors(
    inputs: dict, names: dict, scene: Scene | None, shapes: list[Shape], lights: list[str], output
) -> None:
    """Write ``errors.csv``, the errors of the materials, environments, calibrations and views of one report.

    Parameters
    ----------
    inputs : dict
        Lists of files: ``materials``, ``true_materials``, ``environments``, ``true_environments``, ``calibrations``,
        ``views``, ``true_views``, and ``light`` with the one file of the environment of the views.
    names : dict
        Lists of names: ``objects``, ``environments``, ``cameras``, ``views``; and ``light``, the name of the
        environment of the views.
    scene : Scene or None
        The scene of the views; None without views.
    shapes : list of Shape
        One for each object of the scene.
    lights : list of str
        Illuminants for the errors of reflectance.
    output : path
    """
    rows: list[ErrorRow] = []
    for name, path in zip(names["cameras"], inputs["calibrations"], strict=True):
        rows += calibration_errors(name, path, lights)
    for name, path, truth in zip(names["objects"], inputs["materials"], inputs["true_materials"], strict=True):
        own, exact = Material.load(path), Material.load(truth)
        rows += material_errors(name, own, exact, lights) + alpha_coverage(name, path, own, exact) + outcome(name, path)
    for name, path, truth in zip(
        names["environments"], inputs["environments"], inputs["true_environments"], strict=True
    ):
        rows += environment_errors(name, Environment.load(path), Environment.load(truth))
    if scene is not None and names["views"]:
        (light_file,) = inputs["light"]
        white, _ = scene_white(scene, Environment.load(light_file))
        matrix = xyz_from_radiance(white)
        for name, path, truth in zip(names["views"], inputs["views"], inputs["true_views"], strict=True):
            pair = read_xyz(truth, matrix), read_xyz(path, matrix)
            difference = delta_e_of_light(*pair, matrix @ white)
            # Both pictures have the same light, samples and random numbers: pixels without an object are identical, but
            # for bodies, which reflect the light of objects.
            view = make_view(scene.views[name.rpartition("/")[2]], scene.image)
            objects = (pair[0] != pair[1]).any(axis=-1) & ~body_pixels(scene, view, shapes)
            of_objects = "picture CIEDE2000 to true materials, objects only"
            rows.append(_row(name, "picture CIEDE2000 to true materials", difference, names["light"]))
            rows.append(_row(name, of_objects, difference[objects], names["light"]))
    for row in rows:
        LOGGER.info(
            "%s, %s %s: mean %.4g p95 %.4g max %.4g",
            row.subject,
            row.quantity,
            row.light,
            row.mean,
            row.p95,
            row.max,
        )
    write_rows(output, ErrorRow, rows)
