"""Agreement with Mitsuba 3, an independent renderer, on scenes that both can express."""

import numpy as np
import pytest
from scenes import BALL, GOLD_K, GOLD_N, THIRDS, material, render, sky


def mitsuba_picture(bsdf: dict, coefficients: np.ndarray, samples: int, size=(64, 64), fov=16.0) -> np.ndarray:
    """A sphere of radius 20 at the origin seen from (0, -200, 0) under an equirectangular picture, (h, w, 3)."""
    mitsuba = pytest.importorskip("mitsuba")
    mitsuba.set_variant("scalar_rgb")
    # Mitsuba's picture has y up and its azimuth runs the other way round.
    turn = mitsuba.ScalarTransform4f([[0, 0, -1, 0], [-1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    bitmap = mitsuba.Bitmap(np.ascontiguousarray(coefficients[:, ::-1]))
    scene = mitsuba.load_dict({
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 3},
        "light": {"type": "envmap", "bitmap": bitmap, "to_world": turn},
        "ball": {"type": "sphere", "radius": 20.0, "bsdf": bsdf},
        "camera": {
            "type": "perspective", "fov": fov, "fov_axis": "y",
            "to_world": mitsuba.ScalarTransform4f().look_at(origin=[0, -200, 0], target=[0, 0, 0], up=[0, 0, 1]),
            "film": {"type": "hdrfilm", "width": size[0], "height": size[1], "rfilter": {"type": "box"},
                     "component_format": "float32"},
            "sampler": {"type": "multijitter", "sample_count": samples},
        },
    })  # fmt: skip
    return np.array(mitsuba.render(scene, seed=1))


def room(direction):
    """Three bands of smooth light with a broad bright side."""
    x, y, z = np.moveaxis(direction, -1, 0)
    bands = (1 + 0.5 * x + np.exp(4 * (z - 1)), 1 - 0.4 * y + 0.3 * x * z, 0.6 + 0.4 * z + 0.5 * y * y)
    return np.stack(bands, axis=-1)


def one_hot() -> np.ndarray:
    """A basis whose three vectors are the thirds of the grid."""
    return np.eye(3)[THIRDS]


def mean_difference(ours, theirs) -> float:
    return float(np.abs(ours[..., [10, 30, 50]] - theirs).mean() / theirs.mean())


@pytest.mark.default_cases(1)
@pytest.mark.parametrize("lighting", ["constant", "room"])
def test_mitsuba_agrees_on_a_diffuse_sphere(lighting):
    pytest.importorskip("mitsuba")
    light = sky(room if lighting == "room" else lambda d: np.ones_like(d) * [1.0, 2.0, 0.5], basis=one_hot())
    reflectance = (0.7, 0.4, 0.15)
    bsdf = {"type": "diffuse", "reflectance": {"type": "rgb", "value": list(reflectance)}}
    theirs = mitsuba_picture(bsdf, light.coefficients, samples=256)
    ours = render([BALL], [material(np.array(reflectance)[THIRDS])], light, size=(64, 64), fov=16.0, samples=256)
    assert mean_difference(ours, theirs) <= 0.01


def test_mitsuba_agrees_on_a_golden_sphere():
    pytest.importorskip("mitsuba")
    light = sky(room, basis=one_hot())
    bsdf = {"type": "conductor", "eta": {"type": "rgb", "value": list(GOLD_N)},
            "k": {"type": "rgb", "value": list(GOLD_K)}}  # fmt: skip
    theirs = mitsuba_picture(bsdf, light.coefficients, samples=64)
    gold = material(mirror=1.0, n=np.array(GOLD_N)[THIRDS], k=np.array(GOLD_K)[THIRDS])
    ours = render([BALL], [gold], light, size=(64, 64), fov=16.0, samples=256)
    assert mean_difference(ours, theirs) <= 0.01
