"""Random draws of the stages' stated errors in measured materials, for the predicted error budget.

Nothing here reads a truth: a prediction is the difference between two pictures that could both be what was measured.
"""

from dataclasses import replace

import numpy as np

from irodori.evaluation.known_errors import Known, colours, with_colours
from irodori.material.material_file import Material

#: Places that are tried for a hole at one distance to its data, before the distance is halved.
_TRIES = 48


def noisy(known: Known, estimate: Material, rng: np.random.Generator) -> Material:
    """Return the material with a draw of the camera's noise and of every photograph's own light and pose."""
    calibration = known.calibration
    finite = np.isfinite(known.variance).all(axis=-1) & np.isfinite(known.response).all(axis=-1)
    response, variance = known.response[finite], known.variance[finite]
    gain = known.photographs.gains(known.model_error, known.pose_error_rad, rng)[finite]
    drawn = response * (1.0 + gain[:, None]) + rng.standard_normal(response.shape) * np.sqrt(variance)
    change = np.zeros((*finite.shape, calibration.basis.shape[1]))
    change[finite] = calibration.weights(drawn, variance) - calibration.weights(response, variance)
    return with_colours(estimate, [colours(estimate), (change, calibration.basis)])


def other_gloss(known: Known, estimate: Material, rng: np.random.Generator) -> Material:
    """Return the material with β and μ of each component off by a draw of their standard errors, where stated."""
    pairs = []
    for component, (_, beta, mu) in enumerate(estimate.gloss):
        error = known.gloss_error[..., 2 * component : 2 * component + 2]
        stated = np.isfinite(error).all(axis=-1)
        moved = rng.standard_normal((*stated.shape, 2)) * np.where(stated[..., None], error, 0.0)
        lowest = 0.5 * mu  # a draw of many standard errors is no roughness
        pairs.append((np.maximum(beta + moved[..., 0], 0.0), np.maximum(mu + moved[..., 1], lowest)))
    return estimate.with_gloss(pairs)


def sharper(known: Known, estimate: Material) -> Material:
    """Return the material whose texture, blurred as photographs blur it, is the one that was measured."""
    own, basis = colours(estimate)
    seen = known.material.observed & known.covered
    return with_colours(estimate, [(known.spread.undone(own, seen), basis)])


def sources(known: Known) -> np.ndarray:
    """Return row and column of the texel whose colour each texel is rendered with, (height, width, 2) int."""
    height, width = known.material.alpha.shape
    place = np.stack(np.meshgrid(np.arange(height), np.arange(width), indexing="ij"), axis=-1).astype(np.float32)
    place[~known.material.observed] = np.nan
    located = replace(known.material, coefficients=place)
    return located.filled(known.covered)[0].coefficients.astype(np.int64)


def held_out(known: Known, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return for every texel without data a texel with data that stands for it and the one that would fill that.

    The two lie to each other as the texel lies to the one whose colour it takes. Whole patches are moved alike, to
    random places where both ends have data, so that neighbours keep to each other; what finds no such place in
    `_TRIES` tries is given half its distance, as often as it takes.

    Returns
    -------
    texel, filler : (height, width, 2) int
        Row and column; a texel with data stands for itself and fills itself.
    """
    observed, size = known.material.observed & known.covered, np.array(known.material.alpha.shape)
    texel = np.stack(list(np.indices(observed.shape)), axis=-1)
    filler = texel.copy()
    source, joined = sources(known), known.spread.border == "joined"
    hole = np.argwhere(known.covered & ~observed)
    data = np.argwhere(observed)
    if not len(hole) or not len(data):
        return texel, filler
    away = hole - source[tuple(hole.T)]
    if joined:
        away[:, 1] = (away[:, 1] + size[1] // 2) % size[1] - size[1] // 2
    left, tries = np.arange(len(hole)), 0
    while len(left):
        moved = data[rng.integers(len(data))] - hole[left[rng.integers(len(left))]]
        ends = np.stack([hole[left] + moved, hole[left] + moved - away[left]])
        if joined:
            ends[..., 1] %= size[1]
        fits = np.logical_and.reduce((ends >= 0) & (ends < size), axis=(0, 2))
        fits[fits] = observed[ends[0, fits, 0], ends[0, fits, 1]] & observed[ends[1, fits, 0], ends[1, fits, 1]]
        chosen = tuple(hole[left[fits]].T)
        texel[chosen], filler[chosen] = ends[0, fits], ends[1, fits]
        left, tries = left[~fits], tries + 1
        if tries % _TRIES == 0:
            away[left] = np.trunc(away[left] / 2).astype(np.int64)
            near = ~away[left].any(axis=1)  # a single texel with data says nothing of another
            lone = tuple(hole[left[near]].T)
            texel[lone] = filler[lone] = source[lone]
            left = left[~near]
    return texel, filler


def moved_texels(known: Known, estimate: Material, place: np.ndarray) -> Material:
    """Return the material whose texels without data have the colours of others, (height, width, 2) int."""
    own, basis = colours(estimate)
    hole = (known.covered & ~known.material.observed)[..., None]
    return with_colours(estimate, [(np.where(hole, own[place[..., 0], place[..., 1]], own), basis)])
