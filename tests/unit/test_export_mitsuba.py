"""Exports for Mitsuba 3, rendered there: within the errors of both of the path tracer's own pictures.

Mitsuba runs in a process of its own: an LLVM that does not suit it ends the process. Both sides render independent
pictures, whose spread is their error, as XYZ of Y = 100 for white.
"""

import json
import sys
from dataclasses import replace
from functools import cache

import numpy as np
import patience
import pytest
from exported import painted, scene_of
from lobe_scenes import MIXED
from scenes import GOLD_K, GOLD_N, THIRDS, constant_light, material, sky, smooth_light

from irodori.core import store
from irodori.core.errors import InputError, PlainError
from irodori.export.export_sources import Source
from irodori.export.mitsuba_loss import compared, measure
from irodori.export.mitsuba_scene import write_mitsuba
from irodori.light.environment_file import Environment
from irodori.material.material_file import Material
from irodori.rendering.reference.converging_picture import make_scene, render
from irodori.rendering.scene_arrays import make_objects, make_view

PICTURES = 12
_STOCK = """
import mitsuba
mitsuba.set_variant("llvm_ad_spectral")
film = {"type": "hdrfilm", "width": 2, "height": 2}
parts = {"light": {"type": "constant"}, "eye": {"type": "perspective", "film": film}}
mitsuba.render(mitsuba.load_dict({"type": "scene", "integrator": {"type": "path"}, **parts}), spp=4)
"""
_OURS = """
import sys
from pathlib import Path
import numpy
from irodori.export.mitsuba_loss import rendered
numpy.save(sys.argv[2], rendered(Path(sys.argv[1]), sys.argv[3], int(sys.argv[4]), int(sys.argv[5])))
"""


@cache
def why_mitsuba_fails() -> str:
    """Return why a scene of Mitsuba's own plugins cannot be rendered here; empty where it can."""
    run = patience.run([sys.executable, "-c", _STOCK])
    said = run.stderr.strip().splitlines() or [f"status {run.returncode}"]
    return f"Mitsuba's llvm_ad_spectral does not run here: {said[-1]}" if run.returncode else ""


@pytest.fixture
def mitsuba() -> None:
    """Skip the test before it computes our picture, where Mitsuba has none to compare it with."""
    if reason := why_mitsuba_fails():
        pytest.skip(reason)


NEEDS_MITSUBA = pytest.mark.usefixtures("mitsuba")


def theirs(folder, view: str, samples: int) -> np.ndarray:
    out = folder / "pictures.npy"
    arguments = [str(folder), str(out), view, str(PICTURES), str(samples)]
    run = patience.run([sys.executable, "-c", _OURS, *arguments])
    assert run.returncode == 0, run.stderr
    assert "WARN" not in run.stderr + run.stdout
    return np.load(out)


def ours(source: Source, folder, view: str, samples: int) -> np.ndarray:
    assert source.scene is not None
    placements = [item.placement for item in source.items]
    objects, _ = make_objects(placements, [item.material for item in source.items])
    scene = make_scene(placements, objects, Environment.load(source.environment), source.scene.lights)
    eye = make_view(source.scene.views[view], source.scene.image)
    matrix = np.array(json.loads((folder / "about.json").read_text())["xyz_from_radiance"])
    return np.stack([render(scene, eye, samples, seed).radiance @ matrix.T for seed in range(PICTURES)])


def assert_alike(one: np.ndarray, other: np.ndarray, precise: float) -> None:
    """Refuse a bias of a part of the standard error, and pixels beyond what means of twelve pictures scatter."""
    means = [pictures.mean(axis=0) for pictures in (one, other)]
    errors = [pictures.std(axis=0, ddof=1) / np.sqrt(PICTURES) for pictures in (one, other)]
    # The spectra between the 61 wavelengths are not the same to the last digit.
    combined = np.maximum(np.hypot(*errors), 1e-4 * means[0] + 1e-9)
    assert np.median(combined / np.maximum(means[0], 1.0)) < precise
    z = (means[0] - means[1]) / combined
    assert np.mean(np.minimum(z**2, 30)) < 1.7 and np.abs(z).max() < 9
    for channel in range(3):
        difference = (means[0] - means[1])[..., channel].sum()
        assert abs(difference) < 4 * np.sqrt((combined[..., channel] ** 2).sum())


def coloured(direction):
    x, y, z = np.moveaxis(direction, -1, 0)
    bands = smooth_light(direction), 1.0 + 0.6 * x * z - 0.3 * y, 0.2 + 6.0 * np.exp(40 * (x * 0.6 + z * 0.8 - 1.0))
    return np.stack(bands, axis=-1)


def light_file(folder):
    wave = np.linspace(-1.0, 1.0, 61)
    basis = np.stack([1.0 + 0.3 * wave, 0.6 - 0.4 * wave, np.exp(-((3 * wave) ** 2))], axis=1)
    path = folder / "light.h5"
    sky(coloured, 64, 32, basis).save(path, store.Provenance("test"))
    return path


VIEW = {"position_mm": [0.0, -200.0, 110.0], "target_mm": [0.0, 0.0, 8.0], "field_of_view_deg": 17.0}


@NEEDS_MITSUBA
def test_a_textured_ball_and_a_leaf_on_a_plate_look_as_ours_do(tmp_path):
    """The back of the leaf is seen, with the light that passes through; the ball has a coupled coat."""
    front, sent = painted(reflectance=0.4, beta=1.0, mu=0.3), painted(reflectance=0.4)
    sent = replace(sent, coefficients=sent.coefficients * np.linspace(0.2, 0.9, 16)[:, None])
    leaf = replace(front, back=painted(12, 16, reflectance=0.2), through=sent)
    things = [
        ("plate", leaf, (-24, -14, 13), (-110, 0, 20)),
        ("plate", painted(reflectance=0.4, beta=3.0, mu=0.12, mirror=0.5), (0, 0, 0), (0, 0, 25)),
        ("sphere", replace(painted(reflectance=0.4, beta=1.0, mu=0.3), coat="coupled"), (4, 2, 20.1), (60, 20, 0)),
    ]
    source = scene_of(things, {"v": VIEW}, light_file(tmp_path))
    folder = tmp_path / "out"
    write_mitsuba(source, folder)
    assert_alike(ours(source, folder, "v", 64), theirs(folder, "v", 64), 0.02)


@NEEDS_MITSUBA
@pytest.mark.heavy
@pytest.mark.parametrize("view", ["lens", "parallel"])
def test_all_shapes_lobes_lamps_and_cameras_look_as_ours_do(tmp_path, view):
    gold = material(0.1, beta=1 / (4 * 0.2**2), mu=0.2, n=np.array(GOLD_N)[::-1][THIRDS],
                    k=np.array(GOLD_K)[::-1][THIRDS])  # fmt: skip
    two = Material.uniform(0.2, beta=0.6, mu=0.25, lobes=("gaussian", "ggx"), further_gloss=((4.0, 0.06),))
    ggx = Material.uniform(0.3, beta=2.0, mu=0.3, lobes=("ggx",), mirror=0.6)
    things = [
        ("plane", painted(reflectance=0.4, beta=1.0, mu=0.3), (0, 0, 0), (0, 0, 0)),
        ("sphere", gold, (-24, 8, 20.0), (0, 0, 0)),
        ("disc", two, (18, -16, 6), (-20, 0, 0)),
        ("mesh", painted(12, 24, reflectance=0.4, beta=2.0, mu=0.15), (18, 26, 14.4), (0, 0, 40)),
        ("plate", ggx, (0, 60, 30), (75, 0, 0)),
    ]
    panel = {"width_mm": 60.0, "height_mm": 40.0, "rotation_deg": [155.0, 0.0, 0.0], "position_mm": [0.0, -90.0, 180.0]}
    lights = [
        {"kind": "rectangle", "spectrum": "A", "radiance": 3.0, **panel},
        {"kind": "sphere", "spectrum": "FL2", "radiance": 5.0, "position_mm": [80.0, 20.0, 90.0], "radius_mm": 12.0},
        {"kind": "collimated", "spectrum": "D65", "azimuth_deg": 20.0, "elevation_deg": 50.0, "irradiance": 0.5},
    ]
    views = {"lens": VIEW | {"field_of_view_deg": 28.0, "lens": {"diameter_mm": 20.0, "focus_mm": 215.0}},
             "parallel": {"kind": "orthographic", "position_mm": [60.0, -200.0, 150.0], "target_mm": [0, 0, 10],
                          "height_mm": 90.0}}  # fmt: skip
    source = scene_of(things, views, light_file(tmp_path), lights)
    folder = tmp_path / "out"
    write_mitsuba(source, folder)
    assert_alike(ours(source, folder, view, 256), theirs(folder, view, 256), 0.03)


@NEEDS_MITSUBA
@pytest.mark.heavy
def test_even_light_is_white_in_mitsuba_too(tmp_path):
    """The scale of Mitsuba's film, within 1e-4; a perfect diffuser under even light is as bright as the light."""
    constant_light().save(tmp_path / "light.h5", store.Provenance("test"))
    away = {"position_mm": [0.0, 0.0, 200.0], "target_mm": [0.0, 0.0, 400.0], "up": [0.0, 1.0, 0.0],
            "field_of_view_deg": 20.0}  # fmt: skip
    below = away | {"target_mm": [0.0, 0.0, 0.0], "field_of_view_deg": 5.0}
    things = [("plate", material(1.0), (0, 0, 0), (0, 0, 0))]
    source = scene_of(things, {"away": away, "below": below}, tmp_path / "light.h5")
    folder = tmp_path / "out"
    write_mitsuba(source, folder)
    white = np.array(json.loads((folder / "about.json").read_text())["white_xyz"])
    for view in ("away", "below"):
        seen = theirs(folder, view, 256).mean(axis=(0, 1, 2))
        assert seen[:2] == pytest.approx(white[:2], rel=1e-4) and seen[2] == pytest.approx(white[2], rel=2e-3)


@NEEDS_MITSUBA
@pytest.mark.heavy
@pytest.mark.parametrize(
    "own",
    [
        material(0.1, beta=1e4, mu=0.005),
        # Beside a component of no weight, because loops are compiled for these two lobes anyway.
        Material.uniform(0.1, beta=0.0, mu=0.1, lobes=("gaussian", "ggx"), further_gloss=((1e4, 0.005),)),
        material(0.2, beta=0.5, mu=1.2),
        material(0.0, mirror=1.0, n=0.2, k=3.0),
        material(0.3, beta=1.0, mu=0.1, n=1.0),
    ],
    ids=["sharp gaussian", "sharp ggx", "wide", "metal", "no index"],
)
def test_extreme_materials_look_as_ours_do(tmp_path, own):
    source = scene_of([("sphere", own, (0, 0, 0), (0, 0, 0))], {"v": VIEW}, light_file(tmp_path), size=(16, 12))
    folder = tmp_path / "out"
    write_mitsuba(source, folder)
    assert_alike(ours(source, folder, "v", 128), theirs(folder, "v", 256), 0.05)


def test_the_loss_tells_a_difference_from_noise():
    rng, white = np.random.default_rng(3), np.array([95.0, 100.0, 108.0])
    truth = white * rng.uniform(0.2, 0.6, (4, 6, 1)).repeat(8, axis=0).repeat(8, axis=1)
    noisy = truth * (1 + 0.05 * rng.standard_normal((8, 32, 48, 3)))
    same, darker = compared(truth, noisy, white), compared(1.1 * truth, noisy, white)
    assert same["mean"] == pytest.approx(same["of_mitsubas_noise_alone"]["mean"], rel=0.3)
    assert darker["mean"] > 2 * darker["of_mitsubas_noise_alone"]["mean"] and same["pixels_averaged"] == 64


def test_what_mitsuba_cannot_do_is_said_in_place_of_a_figure(tmp_path):
    found = measure(tmp_path, tmp_path / "picture.exr", "v")
    assert set(found) == {"not_measured"} and "about.json" in found["not_measured"]


def test_a_lobe_that_the_plugin_does_not_know_is_refused(tmp_path):
    things = [("plate", MIXED, (0, 0, 0), (0, 0, 0))]
    with pytest.raises(PlainError, match="found the lobe 'toy'; accepted: gaussian, ggx"):
        write_mitsuba(scene_of(things, {"v": VIEW}, tmp_path / "light.h5"), tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_an_object_and_a_scene_without_light_are_refused(tmp_path):
    with pytest.raises(PlainError, match="accepted: a scene"):
        write_mitsuba(Source("jar", "object", []), tmp_path)
    dark = tmp_path / "dark.h5"
    sky(lambda d: np.zeros_like(d), 16, 8, np.ones((61, 3))).save(dark, store.Provenance("test"))
    source = scene_of([("plate", material(0.4), (0, 0, 0), (0, 0, 0))], {"v": VIEW}, dark)
    with pytest.raises(InputError, match=r"dark\.h5: found no light"):
        write_mitsuba(source, tmp_path / "out")
