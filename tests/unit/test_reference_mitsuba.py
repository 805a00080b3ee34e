"""The path tracer beside Mitsuba 3: per pixel, within the standard errors of both.

Mitsuba renders three wavelengths in its RGB variant, where each channel is a transport of its own without spectral
sampling; its error is that of the mean over independent seeds. Equation (5) has no smooth coat over a diffuse body:
Mitsuba's `plastic` lets light through the coat twice and back, so the coat is compared over a black body.
"""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from lobe_scenes import beside
from path_scenes import DARK, ball, traced
from scenes import GOLD_K, GOLD_N, THIRDS, constant_light, material, plate

from irodori.geometry.rig_frame import rotation_x, rotation_xyz, rotation_y
from irodori.material.material_file import Material
from irodori.spectra.published import light as spectrum_of

mitsuba = pytest.importorskip("mitsuba", reason="Mitsuba 3 is not installed: nothing to compare with")

CHANNELS = [10, 30, 50]  # bands in the thirds of the grid
SKY = np.array([1.0, 2.0, 0.5])
RED, GREEN = np.array([0.7, 0.3, 0.1]), np.array([0.15, 0.6, 0.4])
SEEDS = 12
D65 = spectrum_of("D65")[CHANNELS]


def rgb(values) -> dict:
    return {"type": "rgb", "value": [float(v) for v in values]}


def diffuse(values) -> dict:
    return {"type": "diffuse", "reflectance": rgb(values)}


def transform(place=(0, 0, 0), turn=None, half=(1.0, 1.0)):
    matrix = np.eye(4)
    matrix[:3, :3] = (np.eye(3) if turn is None else turn) * np.array([*half, 1.0])
    matrix[:3, 3] = place
    return mitsuba.ScalarTransform4f(matrix)


def mitsuba_picture(parts, *, position, target, fov, size, samples, depth=-1) -> SimpleNamespace:
    """Mean and standard error of independent seeds, (height, width, 3)."""
    mitsuba.set_variant("scalar_rgb")
    parts = {name: part() for name, part in parts.items()}
    scene = mitsuba.load_dict({
        "type": "scene", "integrator": {"type": "path", "max_depth": depth, "rr_depth": 1000}, **parts,
        "camera": {
            "type": "perspective", "fov": fov, "fov_axis": "y",
            "to_world": mitsuba.ScalarTransform4f().look_at(origin=list(position), target=list(target), up=[0, 0, 1]),
            "film": {"type": "hdrfilm", "width": size[0], "height": size[1], "rfilter": {"type": "box"},
                     "component_format": "float32"},
            "sampler": {"type": "independent", "sample_count": samples},
        },
    })  # fmt: skip
    pictures = np.stack([np.array(mitsuba.render(scene, seed=seed), dtype=float) for seed in range(SEEDS)])
    return SimpleNamespace(mean=pictures.mean(axis=0), error=pictures.std(axis=0, ddof=1) / np.sqrt(SEEDS))


def agree(ours, theirs, precise=0.03):
    """Refuse a bias of a part of the standard error, and pixels beyond Student's law."""
    mean, error = ours.radiance[..., CHANNELS].astype(float), ours.standard_error[..., CHANNELS]
    combined = np.hypot(error, theirs.error)
    # Pixels of the plain sky have no error at all but rounding.
    combined = np.maximum(combined, 1e-5 * theirs.mean.max())
    noisy = combined > 2e-5 * theirs.mean.max()
    z = (mean - theirs.mean) / combined
    assert np.abs(z[~noisy]).max(initial=0.0) < 10  # 1e-4 of the brightest
    assert noisy.mean() > 0.1
    assert np.median(combined[noisy] / np.maximum(theirs.mean[noisy], 0.02 * theirs.mean.max())) < precise
    assert 0.7 < np.mean(np.minimum(z[noisy] ** 2, 30)) < 1.7
    assert np.abs(z).max() < 9
    for channel in range(3):
        chosen = noisy[..., channel]
        whole = (mean - theirs.mean)[..., channel][chosen].sum() / np.sqrt((combined[..., channel][chosen] ** 2).sum())
        assert abs(whole) < 4


VIEW = {"position": (0.0, -200.0, 90.0), "target": (0.0, 0.0, 15.0), "fov": 24.0, "size": (24, 18)}


def stage(bsdf):
    """A ball of radius 20 mm that touches a diffuse plate of 120 mm."""
    return {
        "plate": lambda: {"type": "rectangle", "to_world": transform(half=(60, 60)), "bsdf": diffuse(GREEN)},
        "ball": lambda: {"type": "sphere", "radius": 20.0, "center": [0, 0, 20], "bsdf": bsdf},
    }


def sky_light():
    return {"type": "constant", "radiance": rgb(SKY)}


def staged(body, light, samples, **options):
    return traced([plate(120.0), ball(20.0)], [material(GREEN[THIRDS]), body], light, samples,
                  places=[(0, 0, 0), (0, 0, 20)], **VIEW, **options)  # fmt: skip


def test_mitsuba_agrees_on_a_diffuse_ball_and_plate_under_constant_light():
    ours = staged(material(RED[THIRDS]), constant_light(SKY[THIRDS]), 512)
    agree(ours, mitsuba_picture(stage(diffuse(RED)) | {"sky": sky_light}, samples=32, **VIEW))


def test_mitsuba_agrees_on_a_diffuse_ball_and_plate_under_a_directional_light():
    sun = {"kind": "collimated", "spectrum": "D65", "azimuth_deg": 20.0, "elevation_deg": 50.0, "irradiance": 2.0}
    ours = staged(material(RED[THIRDS]), DARK, 512, lights=[sun])
    azimuth, elevation = np.radians([20.0, 50.0])
    towards = [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    parts = stage(diffuse(RED)) | {
        "sun": lambda: {"type": "directional", "direction": [-x for x in towards], "irradiance": rgb(2 * np.pi * D65)}
    }
    agree(ours, mitsuba_picture(parts, samples=32, **VIEW))


def test_mitsuba_agrees_on_a_smooth_golden_ball():
    """n and k of gold as Johnson and Christy (1972) measured them at three wavelengths."""
    gold = material(mirror=1.0, n=np.array(GOLD_N)[THIRDS], k=np.array(GOLD_K)[THIRDS])
    ours = staged(gold, constant_light(SKY[THIRDS]), 512)
    bsdf = {"type": "conductor", "eta": rgb(GOLD_N), "k": rgb(GOLD_K)}
    agree(ours, mitsuba_picture(stage(bsdf) | {"sky": sky_light}, samples=32, **VIEW))


def test_mitsuba_agrees_on_a_smooth_coat_over_a_black_body():
    ours = staged(material(mirror=1.0, n=1.5), constant_light(SKY[THIRDS]), 512)
    bsdf = {"type": "plastic", "int_ior": 1.5, "ext_ior": 1.0, "diffuse_reflectance": rgb([0, 0, 0])}
    agree(ours, mitsuba_picture(stage(bsdf) | {"sky": sky_light}, samples=32, **VIEW))


@pytest.mark.default_cases(1)
@pytest.mark.parametrize("mu", [0.08, 0.2])
def test_mitsuba_agrees_on_a_rough_golden_plate(mu):
    """GGX of `roughconductor`, whose masking and shadowing are independent: alike within 1e-4 at these steep angles."""
    gold = dataclasses.replace(
        material(beta=1 / (4 * mu**2), mu=mu, n=np.array(GOLD_N)[THIRDS], k=np.array(GOLD_K)[THIRDS]), lobes=("ggx",)
    )
    view = {"position": (0.0, -110.0, 220.0), "target": (0.0, 0.0, 0.0), "fov": 22.0, "size": (12, 10)}
    panel = {"width_mm": 60.0, "height_mm": 40.0, "rotation_deg": [155.0, 0.0, 0.0], "position_mm": [0.0, 90.0, 180.0]}
    lamp = {"kind": "rectangle", "spectrum": "D65", "radiance": 3.0, **panel}
    shapes, materials, places = beside(plate(120.0), gold)
    ours = traced(shapes, materials, constant_light(SKY[THIRDS]), 4096, places=places, lights=[lamp], **view)
    turn = rotation_xyz(panel["rotation_deg"])
    bsdf = {"type": "roughconductor", "distribution": "ggx", "alpha": mu, "eta": rgb(GOLD_N), "k": rgb(GOLD_K)}
    parts = {
        "plate": lambda: {"type": "rectangle", "to_world": transform(half=(60, 60)), "bsdf": bsdf},
        "lamp": lambda: {
            "type": "rectangle", "to_world": transform([0, 90, 180], turn, (30, 20)), "bsdf": diffuse([0] * 3),
            "emitter": {"type": "area", "radiance": rgb(3 * D65)},
        },
        "sky": sky_light,
    }  # fmt: skip
    agree(ours, mitsuba_picture(parts, samples=512, **view))


def walls():
    """A box of 100 mm that is open towards the eye: places, rotations and colours of the five walls, facing inward."""
    return [
        ((0, 0, 0), np.eye(3), GREEN), ((0, 0, 100), rotation_x(np.pi), RED),
        ((-50, 0, 50), rotation_y(np.pi / 2), RED), ((50, 0, 50), rotation_y(-np.pi / 2), GREEN),
        ((0, 50, 50), rotation_x(np.pi / 2), np.array([0.9, 0.8, 0.7])),
    ]  # fmt: skip


def mitsuba_wall(place, turn, colour):
    return {"type": "rectangle", "to_world": transform(place, turn, (50, 50)), "bsdf": diffuse(colour)}


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("lamp", "samples", "theirs"),
    [(None, 4096, 256), ("sphere", 512, 32), ("rectangle", 2048, 256)],
)
def test_mitsuba_agrees_on_light_between_the_walls_of_a_box(lamp, samples, theirs):
    box = walls()
    shapes, materials = [plate(100.0)] * 5 + [ball(15.0)], [material(c[THIRDS]) for _, _, c in box]
    materials.append(material(0.3, mirror=0.0))
    view = {"position": (0.0, -220.0, 50.0), "target": (0.0, 0.0, 50.0), "fov": 32.0, "size": (20, 20)}
    parts = {f"wall{i}": lambda wall=wall: mitsuba_wall(*wall) for i, wall in enumerate(box)}
    parts["ball"] = lambda: {"type": "sphere", "radius": 15.0, "center": [20, 10, 15], "bsdf": diffuse([0.3] * 3)}
    light, lights = DARK, []
    if lamp is None:
        light = constant_light(SKY[THIRDS])
        parts["sky"] = sky_light
    elif lamp == "rectangle":
        panel = {"width_mm": 30.0, "height_mm": 20.0, "rotation_deg": [180.0, 0.0, 25.0], "position_mm": [-10, 5, 95]}
        lights = [{"kind": "rectangle", "spectrum": "D65", "radiance": 3.0, **panel}]
        turn = rotation_xyz(panel["rotation_deg"])
        parts["lamp"] = lambda: {
            "type": "rectangle", "to_world": transform([-10, 5, 95], turn, (15, 10)), "bsdf": diffuse([0] * 3),
            "emitter": {"type": "area", "radiance": rgb(3 * D65)},
        }  # fmt: skip
    else:
        lights = [{"kind": "sphere", "spectrum": "D65", "radiance": 3.0, "position_mm": [-10, 5, 75], "radius_mm": 8.0}]
        parts["lamp"] = lambda: {"type": "sphere", "center": [-10, 5, 75], "radius": 8.0, "bsdf": diffuse([0] * 3),
                                 "emitter": {"type": "area", "radiance": rgb(3 * D65)}}  # fmt: skip
    ours = traced(shapes, materials, light, samples, places=[p for p, _, _ in box] + [(20, 10, 15)],
                  rotations=[r for _, r, _ in box] + [np.eye(3)], lights=lights, **view)  # fmt: skip
    agree(ours, mitsuba_picture(parts, samples=theirs, **view))


def test_mitsuba_agrees_on_a_leaf_over_a_plate_lit_from_behind():
    """A blend of Mitsuba's two-sided diffuse surface and of its thin one whose diffuse light all passes through."""
    through, share = np.array([0.2, 0.45, 0.1]), 0.5
    sheet = Material.uniform(RED[THIRDS] * (1.0 - share), transmittance=through[THIRDS] * share)
    view = {"position": (0.0, -170.0, 60.0), "target": (0.0, 0.0, 22.0), "fov": 20.0, "size": (20, 15)}
    turn = rotation_x(np.radians(50.0))
    ours = traced([plate(120.0), plate(50.0)], [material(GREEN[THIRDS]), sheet], constant_light(SKY[THIRDS]), 512,
                  places=[(0, 0, 0), (0, 0, 25)], rotations=[np.eye(3), turn], **view)  # fmt: skip
    thin = {"type": "principledthin", "base_color": rgb(through), "diff_trans": 2.0, "spec_trans": 0.0, "eta": 1.0001}
    bsdf = {"type": "blendbsdf", "weight": share, "matt": {"type": "twosided", "inner": diffuse(RED)}, "thin": thin}
    parts = {
        "plate": lambda: {"type": "rectangle", "to_world": transform(half=(60, 60)), "bsdf": diffuse(GREEN)},
        "leaf": lambda: {"type": "rectangle", "to_world": transform((0, 0, 25), turn, (25, 25)), "bsdf": bsdf},
        "sky": sky_light,
    }
    agree(ours, mitsuba_picture(parts, samples=32, **view))
