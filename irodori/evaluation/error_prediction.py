"""Measured materials varied at random within the error estimates of the stages, for the predicted error budget.

No function here reads the truth: a prediction is the difference between two pictures, both of materials that are
compatible with the measurements.
"""

from dataclasses import replace

import numpy as np

from irodori.evaluation.known_errors import Known, colours, with_colours
from irodori.material.material_file import Material

#: Random places that are tried for texels without data before their distance to the source of their colour is halved.
_TRIES = 48


def noisy(known: Known, estimate: Material, rng: np.random.Generator) -> Material:
    """Return the material with random errors of its diffuse reflectance.

    The calibration computes them from random errors of the responses: camera noise, and errors of the light level and
    the pose of each photograph.
    """
    calibration = known.calibration
    finite = np.isfinite(known.variance).all(axis=-1) & np.isfinite(known.response).all(axis=-1)
    response, variance = known.response[finite], known.variance[finite]
    gain = known.photographs.gains(known.model_error, known.pose_error_rad, rng)[finite]
    drawn = response * (1.0 + gain[:, None]) + rng.standard_normal(response.shape) * np.sqrt(variance)
    change = np.zeros((*finite.shape, calibration.basis.shape[1]))
    change[finite] = calibration.weights(drawn, variance) - calibration.weights(response, variance)
    return with_colours(estimate, [colours(estimate), (change, calibration.basis)])


def other_gloss(known: Known, estimate: Material, rng: np.random.Generator) -> Material:
    """Return the material with normal errors added to β and μ of each gloss component.

    Their standard deviations are the standard errors of the fit; parameters without a stated error stay as they are.
    """
    pairs = []
    for component, (_, beta, mu) in enumerate(estimate.gloss):
        error = known.gloss_error[..., 2 * component : 2 * component + 2]
        stated = np.isfinite(error).all(axis=-1)
        moved = rng.standard_normal((*stated.shape, 2)) * np.where(stated[..., None], error, 0.0)
        lowest = 0.5 * mu  # a large negative draw must not make the roughness zero or negative
        pairs.append((np.maximum(beta + moved[..., 0], 0.0), np.maximum(mu + moved[..., 1], lowest)))
    return estimate.with_gloss(pairs)


def sharper(known: Known, estimate: Material) -> Material:
    """Return the material with its texture deblurred: blurred as photographs blur it, it is the measured texture."""
    own, basis = colours(estimate)
    seen = known.material.observed & known.covered
    return with_colours(estimate, [(known.spread.undone(own, seen), basis)])


def sources(known: Known) -> np.ndarray:
    """Return row and column of the texel that the rendered colour of each texel comes from, (height, width, 2) int."""
    height, width = known.material.alpha.shape
    place = np.stack(np.meshgrid(np.arange(height), np.arange(width), indexing="ij"), axis=-1).astype(np.float32)
    place[~known.material.observed] = np.nan
    located = replace(known.material, coefficients=place)
    return located.filled(known.covered)[0].coefficients.astype(np.int64)


def held_out(known: Known, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Choose, for every texel without data, two texels with data that show how wrong its filled colour may be.

    A texel without data takes its colour from a source texel. The pair has the same offset between them as these two,
    but lies at a random place where both have data, so the difference of their colours is an example of the
    error. Neighbouring texels are moved by the same vector where possible, so that patches stay together. For texels
    that fit nowhere after `_TRIES` tries, the offset to the source is halved, repeatedly if necessary.

    Returns
    -------
    texel : (height, width, 2) int
        Row and column of the texel that takes the place of the one without data. A texel with data has its own.
    filler : (height, width, 2) int
        Row and column of the texel from which the first would be filled. A texel with data has its own.
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
            near = ~away[left].any(axis=1)  # the offset has shrunk to nothing: there is no pair to compare
            lone = tuple(hole[left[near]].T)
            texel[lone] = filler[lone] = source[lone]
            left = left[~near]
    return texel, filler


def moved_texels(known: Known, estimate: Material, place: np.ndarray) -> Material:
    """Return the material with texels without data coloured like the texels at ``place``, (height, width, 2) int."""
    own, basis = colours(estimate)
    hole = (known.covered & ~known.material.observed)[..., None]
    return with_colours(estimate, [(np.where(hole, own[place[..., 0], place[..., 1]], own), basis)])
