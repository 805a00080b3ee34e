"""Gloss of a paint under one lobe or two, fitted to all its texels together, without the errors of photographs.

A texel seldom sees both a narrow highlight and the broad gleam around it often enough to tell them apart; all texels of
a paint do. Their sum of squares, with the α of each texel eliminated, is that of a linear model in β_1 and β_2 at any
pair of μ_1 and μ_2. It is evaluated at all pairs of nodes from products of projected lobes, and the lowest is refined
with analytic derivatives (variable projection: Golub and Pereyra 1973; Kaufman 1975). Errors are by the jackknife over
photographs, which contains noise, errors of the photographs, and a lobe of another form.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from irodori.core.left_out import is_less
from irodori.fitting.judge import MAX_RELATIVE_ERROR, SEEN, TWICE
from irodori.fitting.paint_gloss import TexelGloss
from irodori.fitting.solvers import FitOptions
from irodori.fitting.texel_sample import Readings
from irodori.reflection.fresnel import fresnel_array
from irodori.reflection.lobe_arrays import LobeAtAngles

_ROUNDS = 3  # fits, each with the weights that the one before it gives
_STEPS = 30  # largest number of evaluations of a refinement
_OUTLYING = 4.0  # residual, in typical ones, from which a reading loses three quarters of its weight or more
_NORMAL_MEDIAN = 0.6744897501960817  # median absolute value of a standard normal variable
_LEAST_PHOTOGRAPHS = 6  # photographs from which the jackknife tells errors of four parameters
_SMALLEST = 1e-4  # β below which there is no component
_REGULAR = 1e-6  # smallest determinant of two normalised lobes that can be separated
_GROUPS = 8  # of photographs that are left out together in the search for a start
_SIGNIFICANT = 2.0  # standard errors by which photographs must prefer one order of two lobes to the other
_DETERMINED = 1e-9  # smallest eigenvalue of the normalised normal matrix of parameters that are determined
_FLATTEST = 0.1  # smallest curvature of the loss that is believed, relative to the normal matrix
_ANGLE = 1e-4  # rad, by which φ is changed to see how a response changes with it
_FIRST, _LEAST_VARYING = 0.1**2, 1e-8  # initial and smallest variance of the parameters of a paint's texels
_MAXIMISED, _SETTLED = 100, 1e-3  # rounds of expectation maximisation, and the relative change that ends them
_STEPS_OF_TEXEL, _LONGEST, _CLOSE = 3, 0.5, 1e-3  # steps of a texel's parameters, the longest, and one that ends them
_OFTEN = 5.0  # standard deviations of χ² by which a texel may differ from its paint
_PARAMETERS = 4  # log β_1, log μ_1, log β_2, log μ_2
_IS_BETA = np.array([True, False, True, False])
_LIMIT = np.where(_IS_BETA, MAX_RELATIVE_ERROR["beta"], MAX_RELATIVE_ERROR["mu"])


@dataclass(frozen=True)
class PairGloss:
    """Gloss of a paint under two lobes, with errors; parameters in the order log β_1, log μ_1, log β_2, log μ_2.

    Parameters
    ----------
    log_gloss : (4,) float64
    error : (4, 4) float64
        Covariance of their errors.
    varying : (4, 4) float64
        Covariance of the texels' parameters about those of the paint; diagonal.
    excess : float
        Factor on the variances of readings that explains the residuals of the paint's texels.
    texels : int
        Number of texels in the fit.
    """

    log_gloss: np.ndarray
    error: np.ndarray
    varying: np.ndarray
    excess: float
    texels: int


class _Model:
    """Terms of the reflection model for the readings of some texels, in double precision."""

    def __init__(self, readings: Readings, options: FitOptions) -> None:
        self.options, self.readings = options, readings
        self.angles = readings.geometry.astype(np.float64)
        self.response = readings.response.astype(np.float64)
        self.seen = (readings.weight > 0.0) & np.isfinite(self.response)
        self.given = np.where(self.seen, readings.weight, 0.0).astype(np.float64)
        self.response[~self.seen] = 0.0
        self.cosine, self.sine2 = readings.diffuse(self.angles), np.sin(self.angles[..., 0]) ** 2
        self.fresnel = fresnel_array(np.cos(self.angles[..., 2]), readings.n, readings.k)
        (_, high_beta), (low_mu, high_mu), count = options.limits("beta"), options.limits("mu_rad"), len(options.lobes)
        self.limits = np.log([_SMALLEST, low_mu] * count), np.log([high_beta, high_mu] * count)

    @cached_property
    def lobes(self) -> list[LobeAtAngles]:
        """The lobes of all components under the angles of the readings."""
        return self._lobes_at(self.angles[..., 3])

    @cached_property
    def lobes_turned(self) -> list[LobeAtAngles]:
        """The same where every φ is larger by `_ANGLE`."""
        return self._lobes_at(self.angles[..., 3] + _ANGLE)

    def _lobes_at(self, phi) -> list[LobeAtAngles]:
        angles = self.angles.copy()
        angles[..., 3] = phi
        return [LobeAtAngles(name, angles) for name in self.options.lobes]

    @cached_property
    def at_nodes(self) -> np.ndarray:
        """Gloss of every component for β = 1 at the nodes of the scan, (components, nodes, texels, J)."""
        nodes = np.exp(self.options.nodes())
        return np.stack([[self.fresnel * lobe.value(mu) for mu in nodes] for lobe in self.lobes])

    def gloss(self, log_gloss: np.ndarray, lobes: Sequence[LobeAtAngles] | None = None) -> np.ndarray:
        """Return the gloss of all components, (texels, J); ``log_gloss`` is (p,), or (texels, p) of each texel."""
        values = _pairs(np.exp(np.atleast_2d(log_gloss)).T[..., None])
        parts = zip(values, self.lobes if lobes is None else lobes, strict=True)
        return self.fresnel * sum(beta * lobe.value(mu) for (beta, mu), lobe in parts)

    def slopes(self, log_gloss: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the gloss, (texels, J), and its derivatives by the p parameters, (p, texels, J)."""
        parts = []
        for lobe, (beta, mu) in zip(self.lobes, _pairs(np.exp(np.atleast_2d(log_gloss)).T[..., None]), strict=True):
            value, slope, _ = lobe.derivatives(mu)
            parts += [beta * self.fresnel * value, beta * self.fresnel * slope]
        return sum(parts[::2]), np.stack(parts)

    def alpha(self, gloss: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the best α and its inverse variance, (texels,) each; the gloss is that of all readings."""
        power = (weight * self.cosine**2).sum(axis=1)
        rest = (weight * self.cosine * (self.response - gloss)).sum(axis=1)
        return np.clip(rest / np.where(power > 0.0, power, 1.0), *self.options.limits("alpha")), power

    def variance_of_turns(self, log_gloss: np.ndarray, gloss: np.ndarray) -> np.ndarray:
        """Return the variance of a gloss by errors of φ, (texels, J)."""
        fall = (self.gloss(log_gloss, self.lobes_turned) - gloss) / _ANGLE
        return self.options.angles.variances[1] * fall**2

    def variance(self, gloss: np.ndarray, of_turns: np.ndarray, alpha: np.ndarray) -> np.ndarray:
        """Return the variance of readings by noise, light and errors of angles, (texels, J)."""
        of_incidence, _ = self.options.angles.variances
        expected = alpha[:, None] * self.cosine + gloss
        own = self.readings.variance(expected, self.options.model_error)
        return own + of_turns + of_incidence * alpha[:, None] ** 2 * self.sine2

    def projection(self, weight: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        """Return a function of values, (..., texels, J): times the roots of the weights, without what an α explains."""
        root = np.sqrt(weight)
        axis = root * self.cosine
        power = (axis**2).sum(axis=1, keepdims=True)
        axis = axis / np.sqrt(np.where(power > 0.0, power, 1.0))

        def project(values: np.ndarray) -> np.ndarray:
            values = values * root
            return values - axis * np.einsum("...j,...j->...", values, axis)[..., None]

        return project

    def projected(self, weight: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Return the `projection` of values."""
        return self.projection(weight)(values)

    def starts(self, weight: np.ndarray) -> list[np.ndarray]:
        """Return the best nodes, (p,) each: of two lobes one with the first the broader one, and one with the narrower.

        Without those for which the components do not improve the fit.
        """
        log_mu = self.options.nodes()
        columns = self.projected(weight, self.at_nodes).reshape(len(self.at_nodes), len(log_mu), -1)
        right, power = columns @ self.projected(weight, self.response).ravel(), (columns**2).sum(axis=-1)
        if len(columns) == 1:
            beta = right[0] / np.where(power[0] > 0.0, power[0], 1.0)
            at = int(np.argmax(np.where(beta > _SMALLEST, beta * right[0], -np.inf)))
            return [np.array([np.log(beta[at]), log_mu[at]])] if beta[at] > _SMALLEST else []
        first, second, cross = power[0][:, None], power[1][None], columns[0] @ columns[1].T
        determinant = first * second - cross**2
        regular = determinant > _REGULAR * first * second
        safe = np.where(regular, determinant, 1.0)
        one = (second * right[0][:, None] - cross * right[1][None]) / safe
        two = (first * right[1][None] - cross * right[0][:, None]) / safe
        usable = regular & (one > _SMALLEST) & (two > _SMALLEST)
        gain, found = one * right[0][:, None] + two * right[1][None], []
        # Of equal lobes the broader one is the first, as in fits of single texels.
        orders = [log_mu[:, None] > log_mu[None], log_mu[:, None] < log_mu[None]]
        for order in orders[: len(set(self.options.lobes))]:
            best = np.where(usable & order, gain, -np.inf)
            i, j = np.unravel_index(best.argmax(), best.shape)
            if np.isfinite(best[i, j]):
                found.append(np.array([np.log(one[i, j]), log_mu[i], np.log(two[i, j]), log_mu[j]]))
        return found

    def minimum(self, start: np.ndarray, weight: np.ndarray) -> np.ndarray:
        """Return the parameters of the least sum of squares near a start, (p,), within their limits."""
        from scipy.optimize import least_squares  # slow to import

        project = self.projection(weight)

        def off(x):
            return project(self.gloss(x) - self.response).ravel()

        def slope(x):
            return project(self.slopes(x)[1]).reshape(len(x), -1).T

        inside = np.clip(start, self.limits[0] + 1e-6, self.limits[1] - 1e-6)
        return least_squares(
            off, inside, slope, bounds=self.limits, x_scale="jac", max_nfev=_STEPS, xtol=1e-4, ftol=1e-6
        ).x

    def weights(self, log_gloss: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return inverse variances of readings about a gloss, and the same without outliers, (texels, J) each."""
        gloss = self.gloss(log_gloss)
        of_turns, (alpha, _) = self.variance_of_turns(log_gloss, gloss), self.alpha(gloss, self.given)
        for _ in range(2):
            plain = self.given / self.variance(gloss, of_turns, alpha)
            alpha, _ = self.alpha(gloss, plain)
        deviation = np.abs(self.response - alpha[:, None] * self.cosine - gloss) * np.sqrt(plain)
        typical = np.median(deviation[self.seen]) / _NORMAL_MEDIAN if self.seen.any() else 1.0
        return plain, plain / (1.0 + (deviation / (_OUTLYING * max(typical, 1.0))) ** 2) ** 2

    def by_texel(self, log_gloss: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return negative gradients, (texels, p), and normal matrices, (texels, p, p), of half the sums of squares."""
        gloss, slopes = self.slopes(log_gloss)
        columns = self.projected(weight, slopes)
        slope = np.einsum("itj,tj->ti", columns, self.projected(weight, self.response - gloss))
        return slope, np.einsum("itj,ktj->tik", columns, columns)

    def without_each(self, log_gloss: np.ndarray, weight: np.ndarray) -> np.ndarray:
        """Return by how much the parameters change without each photograph, (photographs, p), in one step."""
        gloss, slopes = self.slopes(log_gloss)
        moved = []
        for photograph in np.flatnonzero(weight.any(axis=0)):
            kept = weight.copy()
            kept[:, photograph] = 0.0
            columns = self.projected(kept, slopes).reshape(len(log_gloss), -1)
            off = self.projected(kept, self.response - gloss).ravel()
            moved.append(np.linalg.lstsq(columns @ columns.T, columns @ off, rcond=1e-12)[0])
        return np.array(moved).reshape(-1, len(log_gloss))

    def stretch(self, log_gloss: np.ndarray, plain: np.ndarray, weight: np.ndarray) -> np.ndarray | None:
        """Return by how much a change of the parameters grows as outliers lose their weight, (p, p).

        None if the readings do not determine all parameters.

        A reading that moves the fit away from others takes their weight from them. So the curvature of the loss whose
        weights these are (Huber and Ronchetti 2009, section 7.6) is smaller than the normal matrix of the weights.
        """
        columns = self.projected(weight, self.slopes(log_gloss)[1])
        beyond = 1.0 - np.sqrt(weight / np.where(self.seen, plain, 1.0))  # z² / (1 + z²), z in `_OUTLYING` residuals
        slope = np.where(self.seen, 1.0 - 4.0 * beyond, 0.0)  # of the influence of a reading, relative to its weight
        normal, curvature = np.einsum("itj,ktj,ntj->nik", columns, columns, np.stack([np.ones_like(slope), slope]))
        size = np.sqrt(np.diag(normal))
        if not (size > 0.0).all() or np.linalg.eigvalsh(normal / np.outer(size, size))[0] < _DETERMINED:
            return None
        inverse = np.linalg.inv(np.linalg.cholesky(normal))
        size, along = np.linalg.eigh(inverse @ curvature @ inverse.T)
        axes = inverse.T @ along
        return axes / np.clip(size, _FLATTEST, 1.0) @ axes.T @ normal

    def is_seen(self, log_gloss: np.ndarray) -> bool:
        """Return whether at least two photographs show each component near its peak."""
        for lobe, peak, mu in zip(self.lobes, self._lobes_at(0.0), np.exp(log_gloss[1::2]), strict=True):
            here, top = (self.fresnel * one.value(mu) for one in (lobe, peak))
            near = self.seen & (top > 0.0) & (here >= SEEN * top)
            if near.any(axis=0).sum() < TWICE:
                return False
        return True


class GlossSearch:
    """Search for the common gloss of the texels of one paint under one lobe or two.

    Parameters
    ----------
    readings : Readings
        Of the green band.
    options : FitOptions

    Attributes
    ----------
    log_gloss : (2,) or (4,) float64, or None
        log β and log μ of each component; None if the texels do not show them.
    loss : float
        Mean of log(1 + z²) over the readings; infinite without a gloss.
    is_ordered : bool
        Whether photographs tell which of two different lobes is the narrower one.
    """

    def __init__(self, readings: Readings, options: FitOptions) -> None:
        self.model = model = _Model(readings, options)
        variance = readings.variance(model.response, options.model_error)
        self.weight = self.plain = model.given / variance
        minima = []
        for place in self._starts() if len(readings.response) else []:
            for _ in range(_ROUNDS):
                place = model.minimum(place, model.weights(place)[1])
            minima.append((place, self._losses(place)))
        minima.sort(key=lambda one: one[1].mean())
        self.log_gloss: np.ndarray | None = None
        self.loss = float(minima[0][1].mean()) if minima else np.inf
        self.is_ordered = len(minima) < 2 or is_less(minima[0][1], minima[1][1], _SIGNIFICANT)
        if minima:
            self.log_gloss = minima[0][0]
            self.plain, self.weight = model.weights(minima[0][0])

    def _starts(self) -> list[np.ndarray]:
        """Return nodes that describe most readings, as `_Model.starts`.

        They are looked for without every eighth photograph in turn, because a bad one may mislead the sum of squares.
        The logarithm of 1 + z², by which they are compared, is little impressed by it.
        """
        starts, used = self.model.starts(self.weight), np.flatnonzero(self.weight.any(axis=0))
        for first in range(min(_GROUPS, len(used))):
            kept = self.weight.copy()
            kept[:, used[first::_GROUPS]] = 0.0
            starts += self.model.starts(kept)
        # The last μ is the only one, or that of the second lobe.
        orders = [[one for one in starts if (one[1] > one[-1]) == broader] for broader in (True, False)]
        return [min(several, key=lambda one: self._losses(one).mean()) for several in orders if several]

    def _losses(self, log_gloss: np.ndarray) -> np.ndarray:
        """Return the mean of log(1 + z²) over the readings of each photograph that has any, (photographs,)."""
        model, gloss = self.model, self.model.gloss(log_gloss)
        plain, weight = model.weights(log_gloss)
        alpha, _ = model.alpha(gloss, weight)
        squares = plain * (model.response - alpha[:, None] * model.cosine - gloss) ** 2
        used = model.seen.any(axis=0)
        return np.log1p(squares).sum(axis=0)[used] / model.seen.sum(axis=0)[used]

    def without(self, photographs: np.ndarray) -> np.ndarray | None:
        """Return the parameters that the other photographs tell, (p,); None if they do not show all components.

        ``photographs`` is a mask, (J,).
        """
        weight = np.where(photographs, 0.0, self.weight)
        starts = [] if self.log_gloss is None else self.model.starts(weight)
        minima = [self.model.minimum(start, weight) for start in starts]
        return min(minima, key=lambda one: self._squares(one, weight), default=None)

    def _squares(self, log_gloss: np.ndarray, weight: np.ndarray) -> float:
        return float((self.model.projected(weight, self.model.response - self.model.gloss(log_gloss)) ** 2).sum())

    @cached_property
    def found(self) -> PairGloss | None:
        """Return the gloss of the paint under two lobes; None if its texels do not show both or determine them."""
        model, place = self.model, self.log_gloss
        if place is None or not self.is_ordered or not model.is_seen(place):
            return None
        moved = model.without_each(place, self.weight)
        stretch = model.stretch(place, self.plain, self.weight)
        if len(moved) < _LEAST_PHOTOGRAPHS or stretch is None:
            return None
        error = _jackknife(moved @ stretch.T) + np.diag(_IS_BETA * model.options.level_error**2)
        if not (np.sqrt(np.diag(error)) < _LIMIT).all():
            return None
        varying, excess = self._variation(place)
        return PairGloss(place, error, varying, excess, len(model.response))

    def _variation(self, place: np.ndarray) -> tuple[np.ndarray, float]:
        """Return the covariance of the texels' parameters about the common ones, (4, 4), and the excess of residuals.

        By expectation maximisation, with independent parameters; negligible if it is not significant by Schwarz's
        criterion.
        """
        model, gloss = self.model, self.model.gloss(place)
        # Without bad photographs, but with single readings that differ, as those of texels with another gloss do.
        kept, used = np.zeros(model.seen.shape[1]), model.seen.any(axis=0)
        share = np.where(model.seen, self.weight / np.where(model.seen, self.plain, 1.0), np.nan)
        kept[used] = np.nanmedian(share[:, used], axis=0)
        good = self.plain * kept
        slope, normal = model.by_texel(place, good)
        squares = (model.projected(good, model.response - gloss) ** 2).sum(axis=1)
        free = np.maximum(model.seen.sum(axis=1) - 1.0, 1.0)
        median = free * (1.0 - 2.0 / (9.0 * free)) ** 3  # of χ² (Wilson and Hilferty 1931)
        varying, excess = np.full(_PARAMETERS, _FIRST), 1.0

        def own_parts() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            after = np.linalg.inv(normal / excess + np.diag(1.0 / varying))
            own = np.einsum("tij,tj->ti", after, slope / excess)
            return after, own, np.einsum("ti,ti->t", own, slope / excess)

        for _ in range(_MAXIMISED):
            after, own, explained = own_parts()
            new = np.maximum((np.einsum("tii->ti", after) + own**2).mean(axis=0), _LEAST_VARYING)
            settled = np.abs(np.log(new / varying)).max() < _SETTLED
            # By the median, because texels of another paint may be among them.
            varying, excess = new, max(float(np.median((squares - excess * explained) / median)), 1.0)
            if settled:
                break
        gain = own_parts()[2].sum()
        cost = np.linalg.slogdet(np.eye(_PARAMETERS) + varying[:, None] * normal / excess)[1].sum()
        if not gain - cost > _PARAMETERS * np.log(max(len(slope), 2)):
            varying = np.full(_PARAMETERS, _LEAST_VARYING)
            excess = max(float(np.median(squares / median)), 1.0)
        return np.diag(varying), excess


def _pairs(values: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield β and μ of each component from parameters, (p, ...)."""
    return zip(values[::2], values[1::2], strict=True)


def _jackknife(moved: np.ndarray) -> np.ndarray:
    """Return the covariance of parameters by their changes without each photograph, (photographs, p).

    Few photographs show a peak, and a variance of few numbers is uncertain. Its degrees of freedom ν follow from the
    fourth powers (Satterthwaite 1946), and the variance is that of Student's t, ν / (ν - 2) times as large. As three
    fourth powers count as one, ν is at least 3.
    """
    squares = (moved - moved.mean(axis=0)) ** 2
    free = np.clip(3.0 * squares.sum(axis=0) ** 2 / np.maximum((squares**2).sum(axis=0), 1e-300), 3.0, len(moved) - 1.0)
    apart = (moved - moved.mean(axis=0)) * np.sqrt(free / (free - 2.0))
    return (len(moved) - 1) / len(moved) * apart.T @ apart


def share_pair(readings: Readings, gloss: PairGloss, options: FitOptions) -> TexelGloss:
    """Fit the texels of a paint with the gloss of the paint as prior, or each with one of its own.

    Parameters
    ----------
    readings : Readings
        Of the green band.
    gloss : PairGloss
        In the second case with a first axis of texels, see `irodori.fitting.mixtures.gloss_between`.
    options : FitOptions
        With two lobes.
    """
    model, count = _Model(readings, options), len(readings.response)
    place, precision = np.broadcast_to(gloss.log_gloss, (count, _PARAMETERS)), np.linalg.inv(gloss.varying)
    own, excess = place.copy(), np.reshape(gloss.excess, (-1, 1, 1))
    for _ in range(_STEPS_OF_TEXEL):
        plain, weight = model.weights(own)
        slope, normal = model.by_texel(own, weight)
        after = np.linalg.inv(normal / excess + precision)
        step = np.einsum("tij,tj->ti", after, slope / excess[..., 0] - ((own - place)[:, None] @ precision)[:, 0])
        own = np.clip(own + np.clip(step, -_LONGEST, _LONGEST), *model.limits)
        if np.abs(step).max(initial=0.0) < _CLOSE:
            break
    part, slopes = model.slopes(own)
    alpha, power = model.alpha(part, weight)
    kept = after @ precision  # share of an error of the paint's gloss that remains in the texel's
    covariance = after + kept @ gloss.error @ np.swapaxes(kept, 1, 2)
    told, used = power > 0.0, model.seen.sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        by = -(weight * model.cosine * slopes).sum(axis=-1) / power
        squares = (plain * (model.response - alpha[:, None] * model.cosine - part) ** 2).sum(axis=1)
        free = np.maximum(used - 1.0, 1.0)
        misfit = squares / gloss.excess
        agrees = told & (misfit <= free + _OFTEN * np.sqrt(2.0 * free))
        # As in `irodori.fitting.paint_gloss.share`.
        larger = np.where(agrees, 1.0, np.maximum(misfit / free, 1.0))
        if gloss.log_gloss.ndim == 1:
            covariance = larger[:, None, None] * covariance
        variance = larger * gloss.excess / power + np.einsum("it,tij,jt->t", by, covariance, by)
        values = np.exp(own)
        total, power_of = plain.sum(axis=1), (plain * model.response**2).sum(axis=1)
        return TexelGloss(
            alpha=np.where(told, alpha, np.nan),
            alpha_error=np.sqrt(variance + (options.level_error * alpha) ** 2),
            gloss=values,
            gloss_error=values * np.sqrt(np.einsum("tii->ti", covariance)),
            residual_rms=np.sqrt(squares / total),
            relative_residual=np.sqrt(squares / power_of),
            own=1.0 - np.trace(kept, axis1=1, axis2=2) / _PARAMETERS,
            agrees=agrees,
        )
