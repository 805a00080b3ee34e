"""Predicted errors beside known ones, over families of random cases: noise, seams and holes."""

from dataclasses import replace

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made import made
from scipy.ndimage import gaussian_filter

from irodori.calibration.recovery.calibration_file import Calibration
from irodori.calibration.recovery.mappings import LinearMapping
from irodori.colour.colorimetry import delta_e_reflectance
from irodori.config.models import BodyShape, ObjectShape
from irodori.core import store
from irodori.core.custody import accept
from irodori.evaluation.error_budget import Measured, substitutes
from irodori.evaluation.error_prediction import held_out, moved_texels, noisy, sharper, sources
from irodori.evaluation.known_errors import Known, Photographs, Spread
from irodori.geometry.shapes.shape import Shape
from irodori.material.material_file import Material
from irodori.spectra.published import spectrum

SIDE = 32
TCS = np.stack([spectrum(f"TCS{i}") for i in range(99)])
BASIS = np.linalg.svd(TCS, full_matrices=False)[2][:6].T
#: A camera whose responses are the coefficients themselves.
PLAIN = Calibration(BASIS, LinearMapping(np.eye(6)), np.ones(61), ("out", "in"), band_response=BASIS.T)


def known(coefficients, observed=None, spread=None, photographs=None, variance=0.0, model_error=0.0) -> Known:
    """An object of some diffuse spectra on `BASIS`, with nothing wrong but what is given."""
    size = coefficients.shape[:2]
    green = np.where(np.ones(size, bool) if observed is None else observed, (coefficients @ BASIS.T)[..., 30], np.nan)
    own = Material(alpha=green, beta=np.zeros(size), mu=np.full(size, 0.1), green_response=green,
                   coefficients=coefficients.astype(np.float32), basis=BASIS, n=np.full(61, 1.5), k=np.zeros(61),
                   mirror=0.0, typical_gloss=(0.0, 0.1))  # fmt: skip
    one = np.ones((*size, 1))
    return Known(own, np.zeros((*size, 2)), coefficients, np.full(coefficients.shape, variance), PLAIN, 0.5,
                 photographs or Photographs(one, 0 * one, 1.0), spread or Spread(1e-3, 1e-3, "unknown"),
                 model_error, 0.0, np.ones(size, bool))  # fmt: skip


def spectra(material: Material) -> np.ndarray:
    return material.coefficients * material.spectrum_scale[..., None] @ material.basis.T


def patches(rng, side=SIDE) -> np.ndarray:
    """A texture of rectangles of one paint each, as coefficients, and the number of every texel's paint."""
    cuts = [np.sort(rng.choice(np.arange(3, side - 3), 3, replace=False)) for _ in range(2)]
    place = [np.searchsorted(cut, np.arange(side), side="right") for cut in cuts]
    index = rng.permutation(99)[:16].reshape(4, 4)[np.ix_(*place)]
    return TCS[index] @ BASIS, index


def is_predicted(predicted, measured, factor: float, share: float, mean: float) -> None:
    """Most cases within a factor, and their sums within another."""
    ratio = np.log(np.asarray(predicted) / measured)
    assert (np.abs(ratio) < np.log(factor)).mean() >= share, np.exp(np.sort(ratio))
    assert np.sum(predicted) == pytest.approx(np.sum(measured), rel=mean)


def test_scatter_from_photographs_light_and_noise_is_predicted_over_random_sessions():
    rng = np.random.default_rng(1)
    paint = np.broadcast_to(np.arange(SIDE) // 8, (SIDE, SIDE))
    found, expected = [], []
    for _ in range(120):
        model_error, deviation, count = rng.uniform(0.003, 0.03), rng.uniform(0.0, 0.004), int(rng.integers(3, 9))
        response = (TCS[rng.permutation(99)[:4]] @ BASIS)[paint]
        # From the top down one photograph after another loses sight of the object.
        share = rng.uniform(0.2, 1.0, count) * (np.arange(SIDE)[:, None] <= rng.integers(4, 2 * SIDE, count))
        share[:, 0] += 0.2
        share = np.broadcast_to((share / share.sum(axis=1, keepdims=True))[:, None], (SIDE, SIDE, count))
        gains = 1.0 + model_error * rng.standard_normal(count)
        seen = response * (share @ gains)[..., None] + deviation * rng.standard_normal(response.shape)
        truth = replace(known(response).material, coefficients=np.eye(4, dtype=np.float32)[paint],
                        basis=(response[0, ::8] @ BASIS.T).T)  # fmt: skip
        one = known(seen, photographs=Photographs(share, 0 * share, 1.0), variance=deviation**2,
                    model_error=model_error)  # fmt: skip
        off = substitutes(Measured(one, replace(truth, alpha=truth.green_response)))["noise"]
        difference = delta_e_reflectance(spectra(truth), spectra(off))
        found.append(difference[difference > 0.0].mean())
        estimate = one.estimate()
        drawn = noisy(one, estimate, rng)
        expected.append(delta_e_reflectance(spectra(estimate), spectra(drawn)).mean())
    is_predicted(expected, found, 3.0, 0.85, 0.2)


def test_what_all_photographs_share_is_no_scatter():
    every = np.full((SIDE, SIDE, 5), 0.2)
    change = Photographs(every, 0.5 * every, 1.0).gains(0.1, 0.1, np.random.default_rng(0))
    assert np.abs(change).max() < 1e-12


def test_lights_of_photographs_scatter_what_is_seen_straight_and_their_poses_only_what_is_not():
    rng, half = np.random.default_rng(3), (np.arange(SIDE) < SIDE // 2)[:, None]
    share = np.stack([np.broadcast_to(half, (SIDE, SIDE)), np.broadcast_to(~half, (SIDE, SIDE))], axis=-1).astype(float)
    texture = np.broadcast_to(TCS[40] @ BASIS, (SIDE, SIDE, 6))
    lit = known(texture, photographs=Photographs(share, 0.0 * share, 1.0), model_error=0.02)
    posed = replace(lit, model_error=0.0, pose_error_rad=0.02)
    slanted = replace(posed, photographs=Photographs(share, 1.5 + 0.0 * share, 1.0))
    for one, expected in ((lit, 0.02), (posed, 0.0), (slanted, 0.03)):
        whole = [spectra(noisy(one, one.estimate(), rng)).mean(axis=-1) / (texture[0, 0] @ BASIS.T).mean()
                 for _ in range(150)]  # fmt: skip
        # Each half is one photograph's: of their difference, half is what all have in common.
        apart = [one[0, 0] - one[-1, 0] for one in whole]
        assert np.std(apart) / np.sqrt(2.0) == pytest.approx(expected, rel=0.2, abs=1e-6)
        assert all(np.ptp(one[: SIDE // 2]) < 1e-5 for one in whole)
    assert not Photographs(0.0 * share, share, 1.0).gains(0.02, 0.02, rng).any(), "what no photograph saw"


def test_shares_are_those_of_inverse_variance(tmp_path):
    angle, size = np.radians([[20.0, 50.0, 70.0]]), (1, 3)
    geometry = np.zeros((4, 3, 4))
    geometry[..., 0], geometry[..., 1] = angle, np.radians(60.0)
    weight = np.array([[1.0, 1.0, 1.0], [1.0, 0.5, 0.0], [0.0, 0.0, 0.0], [1.0, 1.0, 1.0]])
    noise = np.zeros((3, 6, 2))
    noise[:, 1] = [[1e-6, 2e-6], [4e-6, 0.0], [1e-6, 1e-5]]
    path = tmp_path / "tile.h5"
    with store.create(path, store.Provenance("test")) as out:
        for name, value, dims in (("weight", weight, "texel,capture"), ("geometry", geometry, "texel,capture,angle"),
                                  ("noise_model", noise, "capture,band,coefficient")):  # fmt: skip
            out.write(name, value, units="1", dims=dims, quantity=name)
        out.attribute("rows", [0, 2])
    response = np.array([[0.5, 0.3], [0.4, np.nan]])
    found = Photographs.load([path], response, 0.01)
    cosine = np.cos(angle[0])
    variance = noise[:, 1, 0] + noise[:, 1, 1] * 0.5 * cosine + (0.01 * 0.5 * cosine) ** 2
    assert found.share[0, 0] == pytest.approx(cosine**2 / variance / (cosine**2 / variance).sum())
    assert found.share[0, 1, 2] == 0.0 and found.share[0, 1].sum() == pytest.approx(1.0)
    assert not found.share[1].any()  # no photograph, and no response
    assert found.tangent[0, 0] == pytest.approx(np.tan(angle[0]))
    assert found.stretch == pytest.approx(0.5 * (1 + 4.0)) and size == (1, 3)
    # Where a photograph's noise is not known, and the fit takes its light to be exact, its variance counts as one.
    with h5py.File(path, "a") as file:
        file["noise_model"][2, 1] = 0.0
    accept(path)
    part = Photographs.load([path], response, 0.0).share[0, 0]
    variance = np.append((noise[:, 1, 0] + noise[:, 1, 1] * 0.5 * cosine)[:2], 1.0)
    assert part == pytest.approx(cosine**2 / variance / (cosine**2 / variance).sum())


def test_tiles_are_put_in_the_order_of_their_rows(tmp_path):
    paths = []
    for first, slant in ((4, 60.0), (0, 0.0), (2, 30.0)):
        geometry = np.zeros((2, 1, 4))
        geometry[..., 0] = np.radians(slant)
        paths.append(tmp_path / f"tile-{first}.h5")
        with store.create(paths[-1], store.Provenance("test")) as out:
            out.write("weight", np.ones((2, 1)), units="1", dims="texel,capture", quantity="weight")
            out.write("geometry", geometry, units="rad", dims="texel,capture,angle", quantity="geometry")
            noise = np.full((1, 6, 2), 1e-6)
            out.write("noise_model", noise, units="1", dims="capture,band,coefficient", quantity="noise")
            out.attribute("rows", [first, first + 2])
    found = Photographs.load(paths, np.full((6, 1), 0.4), 0.01)
    np.testing.assert_allclose(found.tangent[:, 0, 0], np.tan(np.radians([0.0, 0.0, 30.0, 30.0, 60.0, 60.0])))
    assert (found.share == 1.0).all()


def photographed(texture, deviation: float, border: str, fine=9) -> np.ndarray:
    """A texture whose texels are even over their sides, through a Gaussian blur, at the centres of the texels."""
    large = np.repeat(np.repeat(texture, fine, axis=0), fine, axis=1)
    mode = {"black": ("constant", "constant"), "joined": ("nearest", "wrap")}[border]
    blurred = gaussian_filter(large, (deviation * fine, deviation * fine, 0), mode=(*mode, "nearest"), truncate=5.0)
    return blurred[fine // 2 :: fine, fine // 2 :: fine]


@pytest.mark.parametrize("border", ["black", "joined"])
def test_the_mixture_at_seams_and_edges_is_predicted_over_random_textures(border):
    rng = np.random.default_rng(2)
    found, expected = [], []
    for _ in range(25):
        texture, _ = patches(rng)
        deviation = rng.uniform(0.3, 0.8)
        one = known(photographed(texture, deviation, border), spread=Spread(deviation, deviation, border))
        found.append(delta_e_reflectance(texture @ BASIS.T, spectra(one.estimate())).mean())
        expected.append(delta_e_reflectance(spectra(one.estimate()), spectra(sharper(one, one.estimate()))).mean())
    is_predicted(expected, found, 1.5, 0.9, 0.2)


def test_a_blur_is_undone_and_a_gap_has_no_part_in_it():
    rng = np.random.default_rng(4)
    texture, _ = patches(rng)
    spread = Spread(0.45, 0.55, "unknown")
    seen = np.ones((SIDE, SIDE), bool)
    seen[10:20, 5:15] = False
    blurred = spread.blurred(texture, seen)
    assert (blurred[~seen] == 0.0).all()
    back = spread.undone(np.where(seen[..., None], blurred, 7.0), seen)
    assert np.abs(back - texture)[seen].max() < 0.02 * np.abs(texture).max()
    assert (back[~seen] == 7.0).all()
    # An even texture has no seams, wherever it ends.
    even = np.full((SIDE, SIDE, 2), 0.4)
    assert np.abs(spread.undone(even, seen) - even).max() < 1e-9


def test_the_spread_of_a_sample_is_that_of_its_even_side_and_wider_at_a_slant():
    flat = Shape.from_definition(
        made(
            ObjectShape | BodyShape,
            {"kind": "plate", "width_mm": 90.0, "height_mm": 60.0},
        )
    )
    one, slanted = (Spread.of(flat, (120, 180), 0.36, stretch) for stretch in (1.0, 4.0))
    assert one.border == "black" and one.rows == one.columns == pytest.approx(0.36 / np.sqrt(12.0) / 0.5)
    assert slanted.rows == pytest.approx(2 * one.rows)
    ball = Spread.of(
        Shape.from_definition(made(ObjectShape | BodyShape, {"kind": "sphere", "radius_mm": 30.0})),
        (128, 256),
        0.36,
        1.0,
    )
    assert ball.border == "joined" and ball.rows == pytest.approx(0.36 / np.sqrt(12.0) / (np.pi * 30 / 128), rel=1e-3)


def holes(rng) -> np.ndarray:
    """Texels with data: all but some rectangles, or all but a side."""
    observed = np.ones((SIDE, SIDE), bool)
    if rng.random() < 0.3:
        observed[int(rng.integers(14, 24)) :] = False
        return observed
    for _ in range(int(rng.integers(1, 5))):
        row, column = rng.integers(0, SIDE - 8, 2)
        observed[row : row + rng.integers(2, 10), column : column + rng.integers(2, 10)] = False
    return observed


def four_holes(rng, side: int) -> np.ndarray:
    """Texels with data: all but a square in each quarter."""
    observed = np.ones((SIDE, SIDE), bool)
    for corner in np.ndindex(2, 2):
        row, column = np.multiply(corner, SIDE // 2) + rng.integers(1, SIDE // 2 - side, 2)
        observed[row : row + side, column : column + side] = False
    return observed


@pytest.mark.parametrize("side", [2, 5, 10])
def test_the_error_of_filled_holes_is_predicted_over_random_textures(side):
    rng = np.random.default_rng(5)
    found, expected = [], []
    for _ in range(120):
        texture, _ = patches(rng)
        observed = four_holes(rng, side)
        one = known(texture, observed)
        estimate = one.estimate()
        there, filled = (spectra(moved_texels(one, estimate, place))[~observed] for place in held_out(one, rng))
        found.append(delta_e_reflectance((texture @ BASIS.T)[~observed], spectra(estimate)[~observed]).mean())
        expected.append(delta_e_reflectance(there, filled).mean())
    # One hole is a single draw of what may lie there: what is predicted is right in the mean over holes of a size.
    assert np.mean(expected) == pytest.approx(np.mean(found), rel=0.2)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from(["joined", "black"]))
def test_a_hole_is_tried_on_texels_with_data_at_its_own_distance(seed, border):
    rng = np.random.default_rng(seed)
    observed = holes(rng)
    one = known(patches(rng)[0], observed, Spread(0.4, 0.4, border))
    texel, filler = held_out(one, rng)
    assert observed[texel[..., 0], texel[..., 1]].all() and observed[filler[..., 0], filler[..., 1]].all()
    own = np.stack(np.indices(observed.shape), axis=-1)
    assert (texel[observed] == own[observed]).all() and (filler[observed] == own[observed]).all()
    wanted, got = (own - sources(one))[~observed], (texel - filler)[~observed]
    if border == "joined":
        wanted[:, 1], got[:, 1] = ((v[:, 1] + SIDE // 2) % SIDE - SIDE // 2 for v in (wanted, got))
    # Never farther than the hole reaches, in either direction, and at its own distance where data allows it.
    assert (np.abs(got) <= np.abs(wanted)).all()
    assert (got == wanted).all(axis=1).mean() > 0.3


@pytest.mark.parametrize("border", ["joined", "black"])
def test_a_wide_hole_is_tried_in_its_own_direction_and_over_the_seam_where_the_sides_are_joined(border):
    observed = np.zeros((SIDE, SIDE), bool)
    observed[:, :12] = True
    texel, filler = held_out(known(patches(np.random.default_rng(1))[0], observed, Spread(0.4, 0.4, border)),
                             np.random.default_rng(2))  # fmt: skip
    got = (texel - filler)[..., 1]
    right, left = got[:, 12:20], got[:, 25:]
    assert (right >= 0).all() and right.max() == 8 and (np.abs(left).max(axis=1) > 0).all()
    # Columns before the seam take their colours from the first ones beyond it.
    assert (left <= 0).all() if border == "joined" else (left >= 0).all()


@pytest.mark.parametrize("border", ["joined", "black"])
def test_the_ends_of_a_pair_lie_on_both_sides_of_a_seam_where_the_sides_are_joined(border):
    observed = np.ones((SIDE, SIDE), bool)
    observed[:, 12:22] = False
    one = known(patches(np.random.default_rng(3))[0], observed, Spread(0.4, 0.4, border))
    pairs = [held_out(one, np.random.default_rng(seed)) for seed in range(5)]
    apart = np.stack([(texel - filler)[~observed][:, 1] for texel, filler in pairs])
    # No source is farther than half of the hole: what is farther apart than that is so over the seam.
    assert (np.abs(apart) > 10).any() == (border == "joined")


def test_a_texel_without_data_takes_its_colour_from_one_with_data_on_a_texture_of_any_shape():
    texture = np.random.default_rng(5).uniform(0.1, 0.5, (12, 40, 6))
    observed = np.random.default_rng(6).uniform(size=(12, 40)) < 0.4
    source = sources(known(texture, observed))
    own = np.stack(np.indices(observed.shape), axis=-1)
    assert source.shape == (12, 40, 2) and (source[observed] == own[observed]).all()
    assert observed[source[..., 0], source[..., 1]].all()
    # In a texture of which two in five texels have data, one is near, perhaps beyond the seam.
    apart = np.abs(source - own)
    assert np.minimum(apart, [12, 40] - apart).max() < 8


def test_what_has_no_data_takes_the_colours_of_the_texels_that_are_named():
    rng, observed = np.random.default_rng(4), np.ones((SIDE, SIDE), bool)
    observed[5:12, 8:20] = False
    one = known(patches(rng)[0], observed)
    estimate, place = one.estimate(), rng.integers(12, SIDE, (SIDE, SIDE, 2))
    expected = np.where(observed[..., None], spectra(estimate), spectra(estimate)[place[..., 0], place[..., 1]])
    np.testing.assert_allclose(spectra(moved_texels(one, estimate, place)), expected, atol=1e-6)


def test_a_hole_beside_a_single_texel_says_nothing_and_ends():
    observed = np.zeros((SIDE, SIDE), bool)
    observed[3, 4] = True
    texel, filler = held_out(known(patches(np.random.default_rng(0))[0], observed), np.random.default_rng(0))
    assert (texel == [3, 4]).all() and (filler == [3, 4]).all()
