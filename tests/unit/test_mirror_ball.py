"""Light from photographs of a mirror ball."""

from contextlib import nullcontext

import numpy as np
import pytest
from exact_light import as_it_is, prior_of
from made import made
from scenes import DATA, fresnel
from test_environment import write_inputs

from irodori.calibration.recovery.calibration_file import Calibration
from irodori.calibration.recovery.mappings import LinearMapping
from irodori.config.models import CapturesSource, IrradianceMap, MirrorBallSource, RefractiveIndex, Size
from irodori.core import store
from irodori.core.errors import InputError
from irodori.light.environment_file import Environment, directions
from irodori.light.mirror_ball import (
    RIM,
    ball_places,
    ball_reflectance,
    inverse_reflectance,
    mean_reflectance,
    outline_doubt,
    unwrapped,
)
from irodori.light.placed_lights import direction_of
from irodori.light.stage import _mirror_ball, prepare_environment
from irodori.material.principal_components.basis_count import CompressOptions
from irodori.spectra.published import refractive_index, spectrum

OPTIONS = (
    CompressOptions(target_delta_e_mean=0.0, target_delta_e_p99=np.inf, align=4, storage="single"),
    IrradianceMap(max_error=0.002, max_height=64),
    store.Provenance("test"),
)
BALL = {"kind": "mirror_ball", "centre_px": [100.5, 90.0], "radius_px": 85.0, "camera_azimuth_deg": 0.0,
        "camera_elevation_deg": 0.0, "roll_deg": 0.0, "reflectance_factor": 1.0}  # fmt: skip


def photograph(radiance, source, reflectance=None, size=(190, 205)):
    """A ball's photograph: each pixel shows the radiance in the mirror direction; radiance: (n, 3) -> (n, b)."""
    rows, columns = size
    x = (np.arange(columns) - source["centre_px"][0]) / source["radius_px"]
    y = -(np.arange(rows)[:, None] - source["centre_px"][1]) / source["radius_px"]
    a, b = np.broadcast_arrays(x, y)
    c = np.sqrt(np.maximum(1 - a**2 - b**2, 0.0))
    azimuth, elevation = np.radians([source["camera_azimuth_deg"], source["camera_elevation_deg"]])
    back = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    up = np.array([-np.sin(elevation) * np.cos(azimuth), -np.sin(elevation) * np.sin(azimuth), np.cos(elevation)])
    # The camera turns counter-clockwise as seen from behind it.
    cosine, sine = np.cos(np.radians(source["roll_deg"])), np.sin(np.radians(source["roll_deg"]))
    right, up = cosine * right + sine * up, cosine * up - sine * right
    normal = a[..., None] * right + b[..., None] * up + c[..., None] * back
    seen = radiance(2 * c[..., None] * normal - back)
    on_ball = (a**2 + b**2 <= 1)[..., None]
    return np.where(on_ball, seen * (1.0 if reflectance is None else reflectance(c)), 0.0)


def smooth(unit):
    return np.stack([2 + unit[..., 0], 1.5 + unit[..., 1] * unit[..., 2], 1 + unit[..., 2] ** 2], axis=-1)


@pytest.mark.parametrize("camera", [(0.0, 0.0, 0.0), (140.0, 0.0, 0.0), (-60.0, 35.0, 25.0)])
def test_a_mirror_ball_shows_the_light_where_it_comes_from(camera):
    source = {**BALL, "camera_azimuth_deg": camera[0], "camera_elevation_deg": camera[1], "roll_deg": camera[2]}
    weights = photograph(smooth, source)
    picture = unwrapped(
        made(MirrorBallSource, source),
        made(Size, {"width": 64, "height": 32}),
        weights,
        np.ones(weights.shape[:2], bool),
        as_it_is(np.eye(61)[:, :3]),
        "ball.h5",
    )
    unit = directions(64, 32)[0]
    seen = ball_places(made(MirrorBallSource, source), 64, 32)[2] < RIM
    found = (picture.weights @ picture.basis.T)[..., :3]
    assert np.abs(found - smooth(unit))[seen].max() <= 0.01
    assert picture.origin["blind_fraction"] == pytest.approx((1 - np.cos(np.pi - 2 * np.arcsin(RIM))) / 2, abs=0.01)
    # The blind cone lies behind the ball.
    towards = direction_of(*camera[:2])
    assert (unit[~seen] @ towards < -0.9).all()


def test_the_balls_own_fresnel_reflectance_is_divided_out():
    n, k = 3.2, 3.3  # chromium, about
    source = {key: value for key, value in BALL.items() if key != "reflectance_factor"}
    source["refractive_index"] = {"n": n, "k": k}
    seen = photograph(smooth, source, lambda cosine: fresnel(cosine, n, k)[..., None])
    # The recovery divides by the mean reflectance of what is used of the ball.
    mean = mean_reflectance(made(MirrorBallSource, source))
    sine = RIM * np.sqrt(np.linspace(0.0, 1.0, 1000))
    assert mean == pytest.approx(np.full(61, fresnel(np.sqrt(1.0 - sine**2), n, k).mean()), rel=1e-3)
    weights = seen / mean[0]
    picture = unwrapped(
        made(MirrorBallSource, source),
        made(Size, {"width": 64, "height": 32}),
        weights,
        np.ones(weights.shape[:2], bool),
        as_it_is(np.eye(61)[:, :3]),
        "ball.h5",
    )
    seen = ball_places(made(MirrorBallSource, source), 64, 32)[2] < RIM
    found = (picture.weights @ picture.basis.T)[..., :3]
    assert np.abs(found - smooth(directions(64, 32)[0]))[seen].max() <= 0.015


def test_the_reflectance_of_a_ball_is_a_number_a_spectrum_or_that_of_its_metal():
    cosine = np.array([1.0, 0.6, 0.2])
    bare = {key: value for key, value in BALL.items() if key != "reflectance_factor"}
    given = {
        "number": ({"reflectance_factor": 0.8}, np.full((3, 61), 0.8)),
        "spectrum": ({"reflectance_factor": "TCS7"}, np.tile(spectrum("TCS7"), (3, 1))),
        "metal": ({"refractive_index": {"n": 1.5, "k": 0.0}}, np.full((3, 61), 0.04)),
    }
    for name, (described, expected) in given.items():
        source = made(MirrorBallSource, bare | described)
        found = ball_reflectance(source, cosine)
        assert found[:1] == pytest.approx(expected[:1], rel=1e-6), name
        assert (found[2] > found[0]).all() if name == "metal" else found == pytest.approx(expected)
    with pytest.raises(ValueError, match="accepted: refractive_index or reflectance_factor"):
        ball_reflectance(made(MirrorBallSource, bare), cosine)


def test_a_coloured_metal_is_divided_out_at_every_wavelength(tmp_path):
    path = DATA / "refractive_index"
    tables = sorted(path.glob("*copper*.csv")) + sorted(path.glob("*brass*.csv")) if path.is_dir() else []
    if not tables:
        pytest.skip(f"no refractive indices in {path}")
    source = {**BALL, "refractive_index": {"file": str(tables[0])}}
    del source["reflectance_factor"]

    n, k = refractive_index(made(RefractiveIndex, source["refractive_index"]))
    cosine = np.linspace(0.21, 1.0, 50)
    factors, spectra = inverse_reflectance(made(MirrorBallSource, source), cosine)
    assert factors.shape[1] <= 6
    exact = np.array([fresnel(c, n, k) for c in cosine])
    assert np.abs((factors @ spectra.T) * exact - 1.0).max() <= 2e-3


@pytest.mark.parametrize("side", [18, 60])
def test_a_ball_that_fills_the_photograph_shows_at_its_rim_what_the_outermost_pixels_show(side):
    """Of a small ball the rim lies between the outermost pixels and the photograph's edge."""
    source = {**BALL, "centre_px": [side / 2 - 0.5] * 2, "radius_px": side / 2}
    weights = np.zeros((side, side, 4))
    weights[:, 0, 0] = weights[:, -1, 1] = weights[0, :, 2] = weights[-1, :, 3] = 1.0
    basis, size = as_it_is(np.eye(61)[:, :4]), made(Size, {"width": 256, "height": 128})
    picture = unwrapped(made(MirrorBallSource, source), size, weights, np.ones((side, side), bool), basis, "ball.h5")
    x, y, sine = ball_places(made(MirrorBallSource, source), 256, 128)
    found = (picture.weights @ picture.basis.T)[..., :4]
    assert np.isfinite(found).all() and ((sine >= RIM) | (found.max(axis=-1) < 1.0)).any()
    for band, beyond in enumerate((-x, x - (side - 1), -y, y - (side - 1))):
        # Between the last two pixels it falls linearly; beyond the last it is held.
        assert found[..., band] == pytest.approx(np.clip(1.0 + beyond, 0.0, 1.0), abs=2e-3)


@pytest.mark.parametrize("off", [(0.2, 0.0), (-0.2, 0.0), (0.0, 0.2), (0.0, -0.2)])
def test_a_ball_that_just_fills_the_photograph_is_unwrapped_and_one_beyond_its_edge_refused(off):
    valid, basis, size = np.ones((60, 60), bool), np.eye(61)[:, :3], made(Size, {"width": 16, "height": 8})
    filling = {**BALL, "centre_px": [29.5, 29.5], "radius_px": 30.0}
    picture = unwrapped(made(MirrorBallSource, filling), size, np.ones((60, 60, 3)), valid, as_it_is(basis), "ball.h5")
    assert np.isfinite(picture.weights).all()
    moved = {**filling, "centre_px": [29.5 + off[0], 29.5 + off[1]]}
    with pytest.raises(InputError, match=r"beyond the photograph.*60 x 60 pixels"):
        unwrapped(made(MirrorBallSource, moved), size, np.ones((60, 60, 3)), valid, as_it_is(basis), "ball.h5")


def test_a_ball_that_is_not_in_the_picture_or_masked_is_refused():
    weights, valid = np.ones((190, 205, 3)), np.ones((190, 205), bool)
    size, basis = {"width": 32, "height": 16}, np.eye(61)[:, :3]
    with pytest.raises(InputError, match="beyond the photograph"):
        unwrapped(
            made(MirrorBallSource, {**BALL, "radius_px": 120.0}),
            made(Size, size),
            weights,
            valid,
            as_it_is(basis),
            "ball.h5",
        )
    one = valid.copy()
    one[90, 100] = False
    picture = unwrapped(made(MirrorBallSource, BALL), made(Size, size), weights, one, as_it_is(basis), "ball.h5")
    assert np.allclose((picture.weights @ picture.basis.T)[..., :3], 1.0)
    # A direction whose place is the masked pixel's own centre.
    exact = {**BALL, "centre_px": [100.0, 90.0], "camera_azimuth_deg": 180.0}
    picture = unwrapped(
        made(MirrorBallSource, exact), made(Size, {"width": 1, "height": 1}), weights, one, as_it_is(basis), "ball.h5"
    )
    assert np.allclose((picture.weights @ picture.basis.T)[..., :3], 1.0)
    one[80:100, 90:110] = False
    with pytest.raises(InputError, match="all masked"):
        _ = unwrapped(made(MirrorBallSource, BALL), made(Size, size), weights, one, as_it_is(basis), "ball.h5").weights


def test_a_small_lamp_on_a_ball_is_among_the_directions_that_tell_what_lamps_there_are(tmp_path):
    """It has a hundredth of the light, in one band alone."""
    response, drawn = photograph(smooth, BALL).astype(np.float32), []
    response[60:64, 60:64] = 0.0
    response[60:64, 60:64, 2] = 0.01 * response.sum() / 16.0
    calibration = Calibration(np.eye(61)[:, [10, 30, 50]], LinearMapping(np.eye(3)), np.full(61, 2.0), ("out",))
    write_inputs(tmp_path, response, np.ones(response.shape[:2], np.uint8), calibration)

    def recovery_of(found):
        drawn.append(found)
        return as_it_is(np.eye(61)[:, :3])

    size = made(Size, {"width": 64, "height": 32})
    _mirror_ball(tmp_path / "linear.h5", calibration, made(MirrorBallSource, BALL), size, recovery_of)
    of_lamp = drawn[0].response[:, 0] == 0.0
    assert of_lamp.sum() > 5 and drawn[0].share[of_lamp].sum() == pytest.approx(0.01, rel=0.5)


def test_noise_of_a_photographed_ball_counts_by_what_the_ball_takes_of_the_light(tmp_path):
    response, found = photograph(smooth, BALL).astype(np.float32), []
    calibration = Calibration(np.eye(61)[:, [10, 30, 50]], LinearMapping(np.eye(3)), np.full(61, 2.0), ("out",))
    model = np.tile([1e-4, 1e-3], (3, 1))
    for share in (1.0, 0.5):
        write_inputs(tmp_path, share * response, np.ones(response.shape[:2], np.uint8), calibration, noise=model)
        source = made(CapturesSource | MirrorBallSource, BALL | {"reflectance_factor": share})
        prepare_environment(tmp_path / "linear.h5", tmp_path / "calibration.h5", tmp_path / "e.h5", *OPTIONS,
                            source=source, image=made(Size, {"width": 64, "height": 32}),
                            prior=prior_of(calibration))  # fmt: skip
        light = Environment.load(tmp_path / "e.h5")
        rng = np.random.default_rng(6)
        deviation = light.noise.deviation(light.coefficients, light.basis)
        noise = np.stack([light.noise.drawn(deviation, light.basis, rng) for _ in range(50)])
        found.append((noise @ light.basis.T)[..., [10, 30, 50]].var(axis=0))
        seen = share * 0.5 * (light.coefficients @ light.basis.T)[..., [10, 30, 50]]
        expected = np.square(2.0 / share) * (1e-4 + 1e-3 * seen)
        assert (found[-1] / expected).mean(axis=(0, 1)) == pytest.approx(np.ones(3), rel=0.03)
    assert found[1].mean() > 2.0 * found[0].mean()


def test_the_stage_unwraps_a_ball_and_minds_saturation_on_it_alone(tmp_path):
    response = photograph(smooth, BALL).astype(np.float32)
    calibration = Calibration(np.eye(61)[:, [10, 30, 50]], LinearMapping(np.eye(3)), np.full(61, 2.0), ("out",))
    valid = np.ones(response.shape[:2], np.uint8)
    valid[0, 0] = 0  # beside the ball: clipped, and of no importance
    write_inputs(tmp_path, response, valid, calibration)
    size = {"width": 64, "height": 32}
    prepare_environment(tmp_path / "linear.h5", tmp_path / "calibration.h5", tmp_path / "e.h5", *OPTIONS,
                        source=made(CapturesSource | MirrorBallSource, BALL), image=made(Size, size),
                        prior=prior_of(calibration))  # fmt: skip
    found = Environment.load(tmp_path / "e.h5")
    seen = ball_places(made(MirrorBallSource, BALL), 64, 32)[2] < RIM
    spectra = (found.coefficients @ found.basis.T)[..., [10, 30, 50]]
    assert np.abs(spectra - 2 * smooth(directions(64, 32)[0]))[seen].max() <= 0.03
    with store.open_file(tmp_path / "e.h5") as file:
        assert file.attribute("origin")["kind"] == "mirror_ball"
    other = Calibration(calibration.basis, calibration.mapping, calibration.light, ("in",))
    write_inputs(tmp_path, response, valid, other)
    with pytest.raises(InputError, match="as in the chart's photographs"):
        prepare_environment(tmp_path / "linear.h5", tmp_path / "calibration.h5", tmp_path / "f.h5", *OPTIONS,
                            source=made(CapturesSource | MirrorBallSource, BALL), image=made(Size, size),
                            prior=prior_of(calibration))  # fmt: skip
    # To a pixel beyond the rim that is used, at 83.3 from the middle, pixels have a say.
    for column, is_used in ((100 + 84, True), (100 + 86, False)):
        valid[90, column] = 0
        write_inputs(tmp_path, response, valid, calibration)
        with pytest.raises(InputError, match="1 pixel saturated") if is_used else nullcontext():
            prepare_environment(tmp_path / "linear.h5", tmp_path / "calibration.h5", tmp_path / "f.h5", *OPTIONS,
                                source=made(CapturesSource | MirrorBallSource, BALL), image=made(Size, size),
                                prior=prior_of(calibration))  # fmt: skip
        valid[90, column] = 1
    valid[90, 100] = 0
    write_inputs(tmp_path, response, valid, calibration)
    with pytest.raises(InputError, match="1 pixel saturated in every bracket"):
        prepare_environment(tmp_path / "linear.h5", tmp_path / "calibration.h5", tmp_path / "f.h5", *OPTIONS,
                            source=made(CapturesSource | MirrorBallSource, BALL), image=made(Size, size),
                            prior=prior_of(calibration))  # fmt: skip


# ---- the outline


def in_a_room(source=BALL, size=(190, 205)):
    """A ball that reflects 0.7 of a smooth light, and behind it that light."""
    columns, rows = np.meshgrid(np.arange(size[1]), np.arange(size[0]))
    behind = smooth(np.stack([-np.ones(size), (columns - size[1] / 2) / size[1], (size[0] / 2 - rows) / size[0]], -1))
    seen = photograph(smooth, source, lambda c: np.full((*c.shape, 1), 0.7), size)
    noise = np.random.default_rng(2).standard_normal(seen.shape)
    return np.where(seen > 0.0, seen, behind) * (1.0 + 0.01 * noise)


@pytest.mark.parametrize("step", [1, 5])
def test_a_ball_is_compared_with_its_outline_in_the_photograph(step):
    """In a photograph whose pixels are five times as fine the same is found."""

    def ball(x=101.0, y=90.0, radius=60.0):
        middle = 0.5 * (step - 1)
        return {**BALL, "centre_px": [step * x + middle, step * y + middle], "radius_px": step * radius}

    seen = in_a_room(ball(), (step * 190, step * 205))

    def doubt(**typed):
        return outline_doubt(made(MirrorBallSource, ball(**typed)), seen, "ball.h5")

    assert doubt() is None and doubt(x=102.5, radius=59.0) is None
    for wrong in ({"radius": 50.0}, {"radius": 70.0}, {"x": 110.0}, {"y": 78.0}):
        with pytest.raises(InputError, match="centre_px and radius_px of the outline, in superpixels") as caught:
            doubt(**wrong)
        assert caught.value.field == "radius_px" and "which was typed as about" in str(caught.value)
        x, y, radius = np.array([101.0, 90.0, 60.0]) * step + np.array([1.0, 1.0, 0.0]) * 0.5 * (step - 1)
        found = [float(word.rstrip(",")) for word in str(caught.value).split() if word.rstrip(",").isdigit()]
        assert found[:3] == pytest.approx([x, y, radius], abs=1.5 * step)


def test_a_ball_without_an_outline_is_warned_of_and_edges_of_the_typed_circle_speak_for_it():
    source = made(MirrorBallSource, BALL)
    assert "no outline of a ball shows" in outline_doubt(source, np.ones((190, 205, 3)), "ball.h5")
    seen = in_a_room({**BALL, "radius_px": 60.0})
    rows, columns = np.indices(seen.shape[:2])
    # A round plate around the ball is larger and shows more edges than the part of the ball that is left to see.
    plate = np.hypot(columns - BALL["centre_px"][0], rows - BALL["centre_px"][1])
    part = np.where(((plate > 60.0) & (plate < 85.0))[..., None], 0.2, seen)
    part[rows > 110] = np.where((plate < 85.0)[..., None], 0.2, seen)[rows > 110]
    typed = made(MirrorBallSource, {**BALL, "radius_px": 60.0})
    assert "are centre_px and radius_px right?" in outline_doubt(typed, part, "ball.h5")


def test_a_run_refuses_a_ball_that_is_elsewhere_and_warns_of_one_without_outline(tmp_path, caplog):
    calibration = Calibration(np.eye(61)[:, [10, 30, 50]], LinearMapping(np.eye(3)), np.full(61, 2.0), ("out",))
    size = made(Size, {"width": 16, "height": 8})

    def run(response, **typed):
        (tmp_path / "linear.h5").unlink(missing_ok=True)
        write_inputs(tmp_path, response.astype(np.float32), np.ones(response.shape[:2], np.uint8), calibration)
        source = made(MirrorBallSource, BALL | typed)
        return _mirror_ball(tmp_path / "linear.h5", calibration, source, size, lambda _: as_it_is(np.eye(61)[:, :3]))

    run(in_a_room())
    assert not [line for line in caplog.messages if "outline" in line]
    run(np.ones((190, 205, 3)))
    assert [line for line in caplog.messages if "no outline of a ball shows" in line]
    with pytest.raises(InputError, match=r"linear\.h5: radius_px: found edges like those of a ball about"):
        run(in_a_room(), radius_px=65.0)
