"""Normals, diffuse weights and gloss of objects of unknown shape under one lamp after another."""

import numpy as np
import pytest
from dome_pictures import SIZE, lamps, relief, relief_normals

from irodori.fitting.one_gloss import MATT
from irodori.fitting.unknown_shape import fit_unknown_shape, register_unknown_shape
from irodori.rectification.lamp_registration import Lamps
from irodori.rectification.photometric_stereo import fit_facets

COUNT = 16
LAMPS = lamps(COUNT, seed=8)
LEVELS = np.exp(np.random.default_rng(4).normal(0.0, 0.04, COUNT))
LEVELS /= np.exp(np.log(LEVELS).mean())
TRUE = Lamps(LAMPS, LEVELS, np.zeros(COUNT))
PART = slice(1, None, 5)
_, NORMALS = relief_normals(*np.indices(SIZE)[::-1].astype(float))
NORMALS = NORMALS.reshape(-1, 3)[PART]


def responses(**gloss) -> np.ndarray:
    pictures = (relief(d, level, seed=at, **gloss) for at, (d, level) in enumerate(zip(LAMPS, LEVELS, strict=True)))
    return np.stack([picture[..., 1].ravel()[PART] for picture in pictures], axis=1)


@pytest.fixture(scope="module")
def matt():
    return responses(beta=0.0, mu=0.3)


def off_deg(normals, truth=NORMALS) -> np.ndarray:
    return np.degrees(np.arccos(np.clip((normals * truth).sum(axis=1), -1.0, 1.0)))


def test_normals_are_found_within_their_stated_errors_in_spite_of_shadows(matt):
    found = fit_facets(matt, matt < 0.98, TRUE.light)
    assert found.told.mean() > 0.97
    off, stated = off_deg(found.normal), found.normal_error_deg(TRUE.light)
    # Pixels at the rim of a cap show two surfaces at once.
    inner = found.told & (np.abs(found.alpha - np.nanmedian(found.alpha)) < 0.15)
    assert np.median(off[inner]) < 1.0
    # The stated error is the root mean square of an angle with two components: its median is 0.83 of it.
    ratio = off[inner] / stated[inner]
    assert 0.7 < np.median(ratio) < 1.0 and np.mean(ratio < 2.0) > 0.93


def test_shadows_count_nothing(matt):
    clean, dark = (matt.copy() for _ in range(2))
    flat = NORMALS[:, 2] > 0.999
    dark[flat, :4] *= 0.1  # a shadow of four lamps
    found, shaded = (fit_facets(y, y < 0.98, TRUE.light) for y in (clean, dark))
    assert np.median(shaded.weight[flat, :4]) < 0.01
    off = [np.nanmedian(off_deg(one.normal[flat], NORMALS[flat])) for one in (found, shaded)]
    assert off[1] < 1.5 * off[0] and shaded.told[flat].mean() > 0.97


def test_too_few_photographs_tell_no_normal(matt):
    usable = np.zeros(matt.shape, dtype=bool)
    usable[:, :3] = True
    found = fit_facets(matt, usable, TRUE.light)
    assert not found.told.any() and np.isnan(found.normal).all() and not found.weight.any()


def test_lamps_in_one_plane_with_the_object_are_refused():
    angle = np.linspace(-1.0, 1.0, 8)
    plane = np.stack([np.sin(angle), np.zeros(8), np.cos(angle)], axis=1)
    with pytest.raises(ValueError, match="lamps in one plane"):
        fit_facets(np.ones((4, 8)), np.ones((4, 8), dtype=bool), plane)


@pytest.mark.default_cases(1)
@pytest.mark.parametrize(("beta", "mu"), [(3.0, 0.1), (1.0, 0.3)])
def test_normals_and_gloss_are_found_together_under_known_lamps(beta, mu):
    response = responses(beta=beta, mu=mu)
    dull, glossy = (
        fit_unknown_shape(response, response < 0.98, TRUE, lobe=lobe, n=1.5, k=0.0) for lobe in (MATT, "gaussian")
    )
    assert glossy.beta == pytest.approx(beta, rel=0.3) and glossy.mu == pytest.approx(mu, rel=0.15)
    off = [np.nanmedian(off_deg(one.facets.normal)) for one in (dull, glossy)]
    assert off[1] < 0.9 * off[0] and off[1] < 1.0


def test_lamps_are_found_with_the_shape_up_to_what_no_photograph_tells(matt):
    way = np.cross(LAMPS, np.random.default_rng(9).normal(size=LAMPS.shape))
    way /= np.linalg.norm(way, axis=1)[:, None]
    known = np.cos(np.radians(3.0)) * LAMPS + np.sin(np.radians(3.0)) * way
    found = register_unknown_shape(matt, matt < 0.98, known, error_deg=3.0)
    # A matrix multiplies all lamps alike; with the best one they are the true ones.
    matrix = np.linalg.lstsq(found.light, TRUE.light, rcond=None)[0]
    fitted = Lamps.of_light(found.light @ matrix, LAMPS)
    assert fitted.moved_deg.max() < 0.4 and np.abs(fitted.level / LEVELS - 1.0).max() < 0.01
    before, after = (off_deg(one, LAMPS).mean() for one in (known, found.direction))
    assert after < 0.6 * before
    misfits = [fit_facets(matt, matt < 0.98, one).misfit for one in (known, found.light, TRUE.light)]
    assert misfits[1] < 1.1 * misfits[2] < 0.5 * misfits[0]


def test_exact_directions_stay_and_only_levels_are_found(matt):
    found = register_unknown_shape(matt, matt < 0.98, LAMPS, error_deg=0.0)
    off = np.abs(found.level / LEVELS - 1.0)
    assert np.allclose(found.direction, LAMPS) and np.median(off) < 0.015 and off.max() < 0.08
