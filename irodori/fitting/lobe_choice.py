"""Choice of an object's lobes and coat by cross-validation over photographs.

The candidates are the lobe of equation (5), every other lobe, and sums of two, each beside the diffuse term of equation
(5) or under a coupled coat (`irodori.reflection.coat`). Each is fitted to a sample of texels
without some of the photographs, which are then predicted. The errors of a photograph are common to all its texels, so
photographs are left out as a whole, and only photographs count as independent. The choice is the simplest candidate
with predictions within one standard error of the best (Breiman et al., *Classification and Regression Trees*, 1984;
here the standard error of the difference between the two, which of two nearly equal candidates is almost nothing).

Each candidate is tried as it would be fitted, with the gloss of paints, where at least half of the sample has one.
A texel of a round object hardly sees a peak twice. If the photograph that shows it is left out, the texel alone says
nothing of the peak, and a lobe with long tails predicts it less badly, whatever the surface is.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations_with_replacement
from types import MappingProxyType

import numpy as np

from irodori.config.cross_checks.object_lobes import SETTINGS_WITH_TWO_LOBES
from irodori.fitting.gloss_search import GlossSearch
from irodori.fitting.solvers import MAX_LOBES, FitOptions, fit
from irodori.fitting.texel_sample import Readings
from irodori.material.lobe_choices import Candidate, LeftOut
from irodori.reflection.coat import SUM
from irodori.reflection.fresnel import fresnel_array
from irodori.reflection.lobe_arrays import evaluate
from irodori.reflection.registry import DEFAULT_LOBES, names

MOST_TEXELS = 256  # for which readings are predicted, which takes about a millisecond of processor time for each
_MOST_OF_PAINT = 64  # texels from which the gloss of a paint is found
ENOUGH_OBSERVATIONS = 8  # observations that a texel of the sample should have, to distinguish lobes
_FOLDS = 8
_NEGLIGIBLE = 0.01  # mean log(1 + z²) by which a candidate may be behind, though its standard error is smaller
_NORMAL_MEDIAN = 0.6744897501960817  # median absolute value of a standard normal variable


def candidates(
    options: FitOptions, lobes: tuple[str, ...] | None = None, coats: tuple[str, ...] = (SUM,)
) -> list[Candidate]:
    """List the candidates: all lobes, that of equation (5) first, then all sums of two if the options allow them.

    Parameters
    ----------
    options : FitOptions
    lobes : tuple of str, optional
        Those of all candidates, if they are given.
    coats : tuple of str
        Coats that are tried with each, the simplest first.
    """
    if lobes is not None:
        return [Candidate(lobes, coat) for coat in coats]
    single = sorted(names(), key=lambda name: (name,) != DEFAULT_LOBES)
    several = all(getattr(options, name) == value for name, value in SETTINGS_WITH_TWO_LOBES.items())
    most = MAX_LOBES if several else 1
    several_of = (combinations_with_replacement(single, count) for count in range(1, most + 1))
    return [Candidate(chosen, coat) for group in several_of for chosen in group for coat in coats]


@dataclass
class PaintedTexels:
    """Texels of one paint under one coat, and the search for their common gloss under any lobes.

    Parameters
    ----------
    texels : (texels,) int
        Indices of those in a sample.
    readings : Readings
        From which their common gloss is found.
    """

    texels: np.ndarray
    readings: Readings
    _searches: dict[tuple[str, ...], GlossSearch] = field(default_factory=dict)

    def _search(self, lobes: tuple[str, ...], options: FitOptions) -> GlossSearch:
        if lobes not in self._searches:
            own = replace(options, lobes=lobes)
            self._searches[lobes] = GlossSearch(replace(self.readings, coupled=options.is_coupled), own)
        return self._searches[lobes]

    def tells(self, options: FitOptions) -> bool:
        """Return whether the texels tell all components of the options' lobes together."""
        return len(options.lobes) == 1 or self._search(options.lobes, options).found is not None

    def gloss(self, left_out: np.ndarray, options: FitOptions) -> np.ndarray | None:
        """Return β and μ of each component that the other photographs tell, (2,) or (4,); None if they tell no gloss.

        Of two lobes, only one has a weight if the texels do not tell both. A veil of stray light over single
        photographs looks like a weak second lobe, too. ``left_out`` is a mask of photographs, (J,).
        """
        lobes = options.lobes
        if self.tells(options):
            found = self._search(lobes, options).without(left_out)
            return None if found is None else np.exp(found)
        one = min((self._search((name,), options) for name in lobes), key=lambda each: each.loss)
        found = one.without(left_out)
        if found is None:
            return None
        nothing, own = np.array([0.0, 1.0]), np.exp(found)
        return np.concatenate([own, nothing] if one.model.options.lobes[0] == lobes[0] else [nothing, own])


def painted(readings: Readings, paint: np.ndarray, sample: np.ndarray) -> list[PaintedTexels]:
    """Return the paints of a sample of texels.

    Parameters
    ----------
    readings : Readings
        Of the sample and of further texels.
    paint : (texels,) int
        Paint of each of them; -1 for none.
    sample : (sample,) int
        Indices of the sample.
    """
    found = []
    for number in range(paint.max(initial=-1) + 1):
        here = np.flatnonzero(paint == number)
        few = readings[here[:: max(1, -(-len(here) // _MOST_OF_PAINT))]]
        found.append(PaintedTexels(np.flatnonzero(paint[sample] == number), few))
    return found


def told_by(
    paints: Mapping[str, Sequence[PaintedTexels]], options: FitOptions, tried: Iterable[Candidate]
) -> list[Candidate]:
    """Return the candidates without sums of two lobes that no paint tells under any coat; all if none is left.

    Lobes that a paint tells under one coat are tried under each: which coat it is, left-out photographs decide.
    Without paints, a sum of two is a matter of single texels. Parameters as in `choose`.
    """
    tried = list(tried)

    def is_told(one: Candidate) -> bool:
        seen, own = paints.get(one.coat, ()), replace(options, **one._asdict())
        return not seen or any(paint.tells(own) for paint in seen)

    told = {one.lobes for one in tried if is_told(one)}
    return [one for one in tried if one.lobes in told] or tried


def choose(
    sample: Readings,
    options: FitOptions,
    tried: Iterable[Candidate],
    paints: Mapping[str, Sequence[PaintedTexels]] = MappingProxyType({}),
) -> tuple[Candidate, list[LeftOut]]:
    """Choose a candidate; return it, and for every candidate how well it predicts left-out photographs.

    Parameters
    ----------
    sample : Readings
    options : FitOptions
        Options of the fit; its lobes and coat are ignored.
    tried : iterable of Candidate
        The simplest first.
    paints : mapping of str to sequence of PaintedTexels
        As in `left_out_errors`, by the coat under which their colours were found.
    """
    tried = told_by(paints, options, tried)
    errors = [left_out_errors(sample, replace(options, **one._asdict()), paints.get(one.coat, ())) for one in tried]
    deviations = [_deviation(error) for error in errors]
    scale = max(1.0, min((one for one in deviations if one > 0.0), default=1.0))
    losses = np.array([_by_photograph(error / scale) for error in errors])
    mean = losses.mean(axis=1) if losses.shape[1] else np.zeros(len(tried))
    behind = losses - losses[int(mean.argmin())]
    count = behind.shape[1]
    spread = behind.std(axis=1, ddof=1) / math.sqrt(count) if count > 1 else np.zeros(len(tried))
    found = [
        LeftOut(one.lobes, deviation, float(gap), float(scatter), one.coat)
        for one, deviation, gap, scatter in zip(tried, deviations, mean - mean.min(), spread, strict=True)
    ]
    chosen = next(one for one in found if one.behind <= max(one.behind_error, _NEGLIGIBLE))
    return Candidate(chosen.lobes, chosen.coat), found


def _by_photograph(errors: np.ndarray) -> np.ndarray:
    """Return the mean of log(1 + z²) over each predicted photograph, a loss that no single observation dominates."""
    seen = np.isfinite(errors)
    total = np.where(seen, np.log1p(np.where(seen, errors, 0.0) ** 2), 0.0).sum(axis=0)
    return total[seen.any(axis=0)] / seen.sum(axis=0)[seen.any(axis=0)]


def _deviation(errors: np.ndarray) -> float:
    known = np.abs(errors[np.isfinite(errors)])
    return float(np.median(known)) / _NORMAL_MEDIAN if known.size else math.nan


def left_out_errors(sample: Readings, options: FitOptions, paints: Sequence[PaintedTexels] = ()) -> np.ndarray:
    """Return the error of each response predicted from other photographs, in expected standard deviations, (texels, J).

    NaN where an observation has no weight. Texels have the gloss that the other photographs tell of their paint, none
    if these tell none; without ``paints``, which have all texels of the sample, each has that of its own fit.
    """
    sample = replace(sample, coupled=options.is_coupled)
    weight, out = np.asarray(sample.weight), np.full(sample.response.shape, np.nan)
    fold = np.arange(weight.shape[1]) % min(_FOLDS, weight.shape[1])
    for number in range(fold.max(initial=-1) + 1):
        here = fold == number
        kept = replace(sample, weight=np.where(here, 0.0, weight).astype(weight.dtype))
        gloss = _of_paints(len(weight), paints, here, options) if paints else _of_texels(kept, options)
        expected = predicted(sample, gloss, kept, options)
        variance = sample.variance(np.fmax(expected, sample.response), options.model_error)
        errors = (sample.response - expected) / np.sqrt(variance)
        held = here & (weight > 0.0) & np.isfinite(errors)
        out[held] = errors[held]
    return out


def _of_paints(count: int, paints: Sequence[PaintedTexels], left_out: np.ndarray, options: FitOptions) -> np.ndarray:
    """Return β and μ of texels by their paints, (texels, 2 or 4)."""
    gloss = np.tile([0.0, 1.0], (count, len(options.lobes)))
    for paint in paints:
        found = paint.gloss(left_out, options)
        if found is not None:
            gloss[paint.texels] = found
    return gloss


def _of_texels(sample: Readings, options: FitOptions) -> np.ndarray:
    """Return β and μ of texels that explain their readings best, (texels, 2 or 4)."""
    return fit(sample.response, sample.geometry, sample.weight, sample.n, sample.k, options, noise=sample.noise).gloss


def predicted(sample: Readings, gloss: np.ndarray, fitted: Readings, options: FitOptions) -> np.ndarray:
    """Predict responses, (texels, J), from the gloss of texels and the α that fits best with it.

    Parameters
    ----------
    sample : Readings
        Geometry of the responses to predict.
    gloss : (texels, 2 or 4) float64
        β and μ of each component.
    fitted : Readings
        Observations that were fitted, of the same texels.
    options : FitOptions
        Options of the fit.
    """
    cosine, shine = _terms(fitted, gloss, options.lobes)
    seen = fitted.weight > 0.0
    weight = np.where(seen, fitted.weight, 0.0)
    if np.isfinite(fitted.noise).all():
        weight = weight / fitted.variance(fitted.response, options.model_error)
    power = (weight * cosine**2).sum(axis=1)
    rest = np.where(seen, weight * cosine * (fitted.response - shine), 0.0).sum(axis=1)
    alpha = rest / np.where(power > 0.0, power, 1.0)
    cosine, shine = _terms(sample, gloss, options.lobes)
    return np.clip(alpha, *options.limits("alpha"))[:, None] * cosine + shine


def _terms(sample: Readings, gloss: np.ndarray, lobes: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Return the diffuse term for α = 1 and the gloss, (texels, J) each."""
    angles = sample.geometry.astype(np.float64)
    shine = np.zeros(angles.shape[:2])
    for component, name in enumerate(lobes):
        beta, mu = gloss[:, 2 * component, None], gloss[:, 2 * component + 1, None]
        shine += beta * evaluate(name, mu, angles)
    return sample.diffuse(angles), shine * fresnel_array(np.cos(angles[..., 2]), sample.n, sample.k)
