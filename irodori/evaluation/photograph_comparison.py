"""Comparison of a photograph of a scene with its rendering, pixel by pixel.

The photograph was not used to fit the materials. The camera's calibration converts its responses to spectra in the same
way as those of an environment. The rendering is path-traced with all reflections, from the fitted materials under the
recovered light. A random draw of the noise shows the difference that two pictures of the same scene would have.
"""

import json
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from irodori.calibration.recovery.calibration_file import Calibration
from irodori.colour.colorimetry import delta_e_of_light, summary, xyz_from_radiance
from irodori.colour.display import make_display
from irodori.config.models import ObjectShape, Optics, ScenePhotograph
from irodori.config.parts import Staging
from irodori.core import store
from irodori.core.atomic_files import written_whole
from irodori.core.errors import InputError
from irodori.core.progress import LOGGER
from irodori.geometry.embree import NO_HIT, Tracer
from irodori.geometry.ideal_camera import IdealView
from irodori.geometry.pinhole import Pinhole
from irodori.geometry.rig_frame import look_at
from irodori.geometry.shapes.shape import Shape
from irodori.light.environment_file import Environment
from irodori.material.coefficients import read_coefficients
from irodori.material.material_file import Material
from irodori.rendering.integrators import with_backs
from irodori.rendering.photographed_view import HALVES, render_halves
from irodori.rendering.scene_arrays import make_placements
from irodori.rendering.scene_white import scene_white
from irodori.rendering.stage import write_picture
from irodori.report.figures import comparison_figure

_NOISE_SEED = 20100401


class Photograph(NamedTuple):
    """A photograph, averaged to the pixels of the comparison."""

    response: np.ndarray  # (height, width, bands), mean of the valid samples; NaN where there were none
    whole: np.ndarray  # (height, width) bool, where all samples were valid
    variance: np.ndarray | None  # (height, width, bands), of the response; None if the noise was not measured


class Comparison(NamedTuple):
    """A photograph and the rendering of its view, in XYZ with Y = 100 for the scene's white, and their difference.

    The differences are NaN where any sample of the photograph was invalid, the photograph where all were.
    """

    photograph: np.ndarray  # (height, width, 3)
    rendering: np.ndarray  # (height, width, 3)
    delta_e: np.ndarray  # (height, width) CIEDE2000
    noise: np.ndarray  # (height, width) CIEDE2000 from noise alone, one random draw
    scale: float  # factor applied to the photograph
    luminance_ratio: float  # median over pixels of the scaled photograph's luminance divided by the rendering's


def read_photograph(linear, calibration: Calibration, ideal: IdealView) -> Photograph:
    """Read the linear responses of a photograph, resampled to the pixels of an ideal view.

    Raises
    ------
    InputError
        If the bands or the size of the photograph are not those of the camera, or if the photograph was not divided by
        a white reference.
    """
    with store.open_file(linear) as file:
        calibration.require_filters(file.attribute("filters"), linear)
        response, valid = file.read("response"), file.read("valid").astype(bool)
        unit, sample_px = file.dataset("response").attrs["units"], file.attribute("sample_px")
        noise = file.read("noise_model")
    if unit != "1":
        accepted = "responses divided by those of a white reference: the camera needs photographs of the role white"
        raise InputError(linear, "response", f"responses in {unit}", accepted)
    size = tuple(side * sample_px for side in valid.shape)
    wanted = (ideal.pinhole.height_px, ideal.pinhole.width_px)
    if any(not 0 <= b - a < 2 for a, b in zip(size, wanted, strict=True)):
        found = f"a photograph of {size[1]} x {size[0]} pixels"
        raise InputError(linear, "response", found, f"{wanted[1]} x {wanted[0]}, as the camera's optics")
    mean, whole = ideal.resample(response, valid, sample_px)
    if not np.isfinite(noise).all():
        return Photograph(mean, whole, None)
    samples = (ideal.block * 2 // sample_px) ** 2
    return Photograph(mean, whole, (noise[:, 0] + noise[:, 1] * np.maximum(mean, 0.0)) / samples)


def compare(
    photograph: Photograph,
    calibration: Calibration,
    rendered: np.ndarray,
    white: np.ndarray,
    scale: float | str = 1.0,
    paths_before: np.ndarray | None = None,
) -> Comparison:
    """Compare a photograph with the rendering of its view.

    Parameters
    ----------
    photograph : Photograph
    calibration : Calibration
        Calibration with the light of the rig: the radiance of a pixel is recovered as the spectrum of this light times
        the reflectance that the calibration finds for the responses.
    rendered : (2, height, width, 61) float
        Radiance from each half of the paths.
    white : (61,) float
        Radiance of the scene's white.
    scale : float or ``auto``
        Factor applied to the photograph; ``auto`` makes the median ratio of the two luminances 1.
    paths_before : (2, height, width, 61) float, optional
        For a virtual photograph: the radiance from which it was made, from each half of the paths. The noise of this
        radiance is part of the photograph.

    Raises
    ------
    ValueError
        If ``scale`` is ``auto`` and the photograph or the rendering is without light.
    """
    matrix = xyz_from_radiance(white)
    white_xyz = matrix @ white
    known = photograph.whole
    xyz_from_weights = matrix @ (calibration.basis * calibration.light[:, None])

    def recovered(response: np.ndarray) -> np.ndarray:
        return calibration.weights(response) @ xyz_from_weights.T

    shown = recovered(photograph.response)
    found, seen = photograph.response[known], shown[known]
    rendering = rendered @ matrix.T
    halves = rendering[:, known]
    made = halves.mean(axis=0)
    lit = made[:, 1] > 0.0
    ratio = float(np.median(seen[lit, 1] / made[lit, 1])) if lit.any() else np.nan
    if scale == "auto" and not ratio > 0.0:
        raise ValueError("a photograph or a rendering without light; accepted: both lit, or a scale that is a number")
    factor = 1.0 / ratio if scale == "auto" else float(scale)
    # Half the difference of two independent halves has the same variance as their mean.
    noise = (halves[0] - halves[1]) / HALVES
    if paths_before is not None:
        noise = noise + factor * (paths_before[0] - paths_before[1])[known] @ matrix.T / HALVES
    if photograph.variance is not None:
        draw = np.random.default_rng(_NOISE_SEED).normal(size=found.shape) * np.sqrt(photograph.variance[known])
        noise = noise + factor * (recovered(found + draw) - seen)
    apart = delta_e_of_light(made, made + noise, white_xyz)

    def spread(values: np.ndarray) -> np.ndarray:
        out = np.full(known.shape, np.nan)
        out[known] = values
        return out

    difference = delta_e_of_light(factor * seen, made, white_xyz)
    return Comparison(factor * shown, rendering.mean(axis=0), spread(difference), spread(apart), factor, factor * ratio)


def shows_an_object(ideal: IdealView, placed: ScenePhotograph, placements: list) -> np.ndarray:
    """Return the pixels whose centre shows one of the placed shapes, (height, width) bool."""
    axes = look_at(placed.position_mm, placed.target_mm, placed.up)
    rays = (ideal.rays() @ axes.T).reshape(-1, 3)
    origins = np.broadcast_to(np.asarray(placed.position_mm, dtype=np.float64), rays.shape)
    _, shape = Tracer(placements).intersect(origins, rays)
    return (shape != NO_HIT).reshape(ideal.height, ideal.width)


def compare_photograph(
    inputs: dict,
    scene: Staging,
    placed: ScenePhotograph,
    optics: Optics,
    shapes: Sequence[ObjectShape],
    *,
    outputs: dict,
    provenance: store.Provenance,
) -> None:
    """Compare a photograph of a scene with the rendering of its view, and write pictures, differences and figures.

    Parameters
    ----------
    inputs : dict
        The files ``linear``, ``calibration`` and ``environment``; the list ``materials``; and the list ``radiance``,
        with one file for a virtual photograph and none for a real one.
    scene : Staging
    placed : ScenePhotograph
    optics : Optics
        Optics of the camera.
    shapes : sequence of ObjectShape
    outputs : dict
        Files: comparison, photograph and rendering (PNG), difference (HDF5), figures (JSON).
    """
    display = make_display(scene.display.device)
    calibration = Calibration.load(inputs["calibration"])
    ideal = IdealView.covering(Pinhole.from_optics(optics), placed.block)
    photograph = read_photograph(inputs["linear"], calibration, ideal)
    before = None
    if inputs["radiance"]:
        with store.open_file(inputs["radiance"][0]) as file:
            before = np.stack([ideal.gathered(half) for half in read_coefficients(file, "radiance")])
    environment = Environment.load(inputs["environment"])
    materials = with_backs(scene, [Material.load(path) for path in inputs["materials"]])
    solids = [Shape.from_definition(shape) for shape in shapes]
    samples = placed.samples * placed.block**2
    # A seed of its own, so that the noise is independent of that in a virtual photograph.
    seed = placed.seed + HALVES
    rendered = render_halves(scene, placed, ideal, solids, materials, environment, samples=samples, seed=seed)
    white, _ = scene_white(scene, environment)
    found = compare(photograph, calibration, rendered, white, placed.scale, before)
    all_shapes = [*solids, *(Shape.from_definition(body.shape) for body in scene.bodies)]
    placements = make_placements(scene, all_shapes)
    objects = shows_an_object(ideal, placed, placements)
    figures = _figures(found, objects, photograph, before is not None)
    white_xyz = xyz_from_radiance(white) @ white
    # Pixels that no sample of the photograph shows are black.
    for key, picture in (("photograph", np.nan_to_num(found.photograph)), ("rendering", found.rendering)):
        figures[f"{key}_out_of_gamut"] = write_picture(outputs[key], picture, white_xyz, display)
    _write(found, objects, outputs, figures | {"samples": samples, "display": display.name}, provenance)


def _figures(found: Comparison, objects: np.ndarray, photograph: Photograph, is_virtual: bool) -> dict:
    known = np.isfinite(found.delta_e)
    parts = {"": known, "_objects": known & objects}
    figures = {
        "compared_fraction": float(known.mean()),
        "scale": found.scale,
        "luminance_ratio": found.luminance_ratio,
        "noise_counts": ["paths of the rendering"]
        + ["paths of the photograph"] * is_virtual
        + ["camera"] * (photograph.variance is not None),
    }
    for name, chosen in parts.items():
        figures[f"delta_e{name}"] = off = summary(found.delta_e[chosen])
        figures[f"noise_floor{name}"] = floor = summary(found.noise[chosen])
        LOGGER.info(
            "CIEDE2000 to the photograph%s: mean %.2f p95 %.2f p99 %.2f max %.2f; by noise alone %.2f, %.2f, %.2f",
            name.replace("_", ", "),
            *(off[key] for key in ("mean", "p95", "p99", "max")),
            *(floor[key] for key in ("mean", "p95", "p99")),
        )
    if photograph.variance is None:
        LOGGER.warning("the camera's noise was not measured: it is not in the noise floor")
    return figures


def _write(found: Comparison, objects: np.ndarray, outputs: dict, figures: dict, provenance: store.Provenance) -> None:
    with store.create(outputs["difference"], provenance) as out:
        pixels = "row,column"
        out.write("delta_e", found.delta_e, units="1", dims=pixels, quantity="CIEDE2000, rendering to photograph")
        out.write("noise", found.noise, units="1", dims=pixels, quantity="CIEDE2000 of noise alone, one draw")
        seen = "whether an object is seen"
        out.write("objects", objects.astype(np.uint8), units=store.Mask, dims=pixels, quantity=seen)
        out.coordinate("value", ["X", "Y", "Z"], units="1", quantity="tristimulus value")
        for name in ("photograph", "rendering"):
            quantity = "XYZ, Y = 100 for the scene's white"
            out.write(name, getattr(found, name), units="1", dims=f"{pixels},value", quantity=quantity)
        out.attribute("figures", figures)
    comparison_figure(outputs["comparison"], outputs["photograph"], outputs["rendering"], found.delta_e, figures)
    with written_whole(outputs["figures"]) as temporary:
        temporary.write_text(json.dumps(figures, indent=1), encoding="utf-8")
