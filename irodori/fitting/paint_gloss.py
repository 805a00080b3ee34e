"""Gloss of a paint, fitted to all its texels together, and the gloss of each texel with that of its paint as prior.

A texel that sees a highlight once cannot separate β from μ; thousands of texels of one paint can. log β and log μ of
the texels are assumed to be normally distributed about those of the paint. Their covariance is estimated from the
gradients and normal equations of the texels. It determines how strongly the gloss of a texel is drawn towards that of
its paint (empirical Bayes; Efron and Morris, JASA 70, 1975).
"""

from dataclasses import dataclass, fields, replace

import numpy as np

from irodori.fitting import gloss_sums as sums
from irodori.fitting.gloss_sums import SearchedTexels
from irodori.fitting.judge import SEEN as LEAST_SEEN

_STEPS = 12
_SETTLED = 1e-6
_CLOSE = 1e-4  # step of a texel's log β or log μ below which the iteration ends: its square is negligible
_LONGEST = 0.5  # longest step of log β or log μ
_FOREIGN = 4.0  # multiple of the median misfit beyond which a texel is left out of the fit of its paint's gloss
_ROUNDS = 300  # largest number of rounds of expectation maximisation
_FIRST, _ANY = 0.1**2, 0.5**2  # initial variance of log β and log μ, and a variance that hardly constrains them
_LEAST_FREE = 0.5  # fewest degrees of freedom of a texel to compare its misfit
LEAST_VARYING = 1e-8  # smallest variance of log β and log μ: a standard deviation of 0.01 %
_DIVISIONS = 8  # ways in which photographs are divided into halves
_FEWEST = 50  # texels from which halves of photographs are compared: of fewer, chance decides
_UNTOLD = 1e-6  # size of what halves tell of a direction, relative to the whole, below which it does not count
_SHARES = np.linspace(0.0, 0.95, 20)  # shares of a variation that texels may have in common with their neighbours
_UNDESCRIBED = 2.0  # excess from which on the lobe has another form, so that its differences are not weighed
_MISSED = 3.0  # standard errors by which halves must show less than the whole of a variation to contradict it


@dataclass(frozen=True)
class SeparateGloss:
    """Gloss fitted to the texels of one paint as if no photograph had errors, and how the joint fit treats them.

    Parameters
    ----------
    surface : SearchedTexels
        Texels in the fit.
    log_gloss, excess
        As in `PaintGloss`.
    varying : (2, 2) float64
        Covariance of the texels' log β and log μ about the common ones: whatever it comes from, or, after
        `with_variation`, as far as halves of the photographs confirm it.
    scatter : (2, 2) float64
        As in `PaintGloss`; zero unless the variation has been divided by `confirmed_variation`.
    differences : Differences
        How the texels differ from the paint in the joint fit of all paints.
    weighed : bool
        Whether the joint fit knows of the variation. It must not where angles are unknown or the lobe has another form,
        because the variation comes from these.
    """

    surface: SearchedTexels
    log_gloss: np.ndarray
    varying: np.ndarray
    excess: float
    scatter: np.ndarray
    differences: sums.Differences
    weighed: bool

    @property
    def varies(self) -> bool:
        """Whether the texels differ significantly."""
        return bool(np.trace(self.varying) > 2.0 * LEAST_VARYING)

    @property
    def unweighed(self) -> np.ndarray:
        """Part of the variation that the joint fit of all paints leaves out, (2, 2)."""
        return self.varying - self.differences.own - self.differences.common


@dataclass(frozen=True)
class PaintGloss:
    """Gloss of a paint, with errors.

    Parameters
    ----------
    log_gloss : (2,) float64
        log β and log μ.
    error : (2, 2) float64
        Covariance of the errors of log β and log μ.
    varying : (2, 2) float64
        Covariance of the texels' log β and log μ about those of the paint.
    excess : float
        Factor on the variances of observations that explains the residuals of the paint's texels.
    texels : int
        Number of texels in the fit.
    scatter : (2, 2) float64
        Covariance of the errors in what a texel's photographs tell about its log β and log μ, beyond those by noise: a
        lobe of another form makes them differ from texel to texel, though the gloss does not.
    """

    log_gloss: np.ndarray
    error: np.ndarray
    varying: np.ndarray
    excess: float
    texels: int
    scatter: np.ndarray


@dataclass(frozen=True)
class TexelGloss:
    """Parameters of texels fitted with the gloss of their paints as prior; NaN where unknown.

    Parameters
    ----------
    alpha, alpha_error, residual_rms, relative_residual : (texels,) float64
    gloss, gloss_error : (texels, 2 or 4) float64
        β and μ of each component, and their standard errors.
    own : (texels,) float64
        Share of the information on the gloss that comes from the texel, 0 to 1; the rest comes from its paint.
    agrees : (texels,) bool
        Whether χ² of the texel is compatible with this gloss.
    """

    alpha: np.ndarray
    alpha_error: np.ndarray
    gloss: np.ndarray
    gloss_error: np.ndarray
    residual_rms: np.ndarray
    relative_residual: np.ndarray
    own: np.ndarray
    agrees: np.ndarray

    @property
    def beta(self) -> np.ndarray:
        """β of the first component, (texels,)."""
        return self.gloss[:, 0]

    @property
    def mu(self) -> np.ndarray:
        """μ of the first component, (texels,)."""
        return self.gloss[:, 1]

    @property
    def beta_error(self) -> np.ndarray:
        """Standard error of `beta`, (texels,)."""
        return self.gloss_error[:, 0]

    @property
    def mu_error(self) -> np.ndarray:
        """Standard error of `mu`, (texels,)."""
        return self.gloss_error[:, 1]

    def __getitem__(self, chosen) -> "TexelGloss":
        """Return the parameters of selected texels; ``chosen`` is any NumPy index."""
        return TexelGloss(**{one.name: getattr(self, one.name)[chosen] for one in fields(self)})

    @classmethod
    def joined(cls, several: list["TexelGloss"], components: int) -> "TexelGloss":
        """Concatenate the texels of several instances, which have as many components of gloss."""
        if not several:
            nothing, of_gloss = {one.name: np.empty(0) for one in fields(cls)}, np.empty((0, 2 * components))
            return cls(**nothing | {"gloss": of_gloss, "gloss_error": of_gloss})
        names = [one.name for one in fields(cls)]
        return cls(**{name: np.concatenate([getattr(one, name) for one in several]) for name in names})


def matrices(part: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return negative gradients, (texels, 2), and normal matrices, (texels, 2, 2), from contributions of texels."""
    entries = part[:, [sums.BETA_BETA, sums.BETA_MU, sums.BETA_MU, sums.MU_MU]]
    return part[:, [sums.DOWN_BETA, sums.DOWN_MU]], entries.reshape(-1, 2, 2)


def _inverse(matrix: np.ndarray) -> np.ndarray:
    """Return the inverses of matrices (..., 2, 2)."""
    a, b, c, d = matrix[..., 0, 0], matrix[..., 0, 1], matrix[..., 1, 0], matrix[..., 1, 1]
    return np.stack([d, -b, -c, a], axis=-1).reshape(matrix.shape) / (a * d - b * c)[..., None, None]


def _start(surface: SearchedTexels, nodes: np.ndarray) -> tuple[np.ndarray, float] | None:
    """Find log β and log μ with the least joint sum of squares over the nodes.

    Returns
    -------
    ((2,) float64, float) or None
        log β and log μ, and the decrease of the sum of squares compared with no gloss; None if there is no decrease.
    """
    _, b, c = sums.parabolas(surface, nodes).sum(axis=0).T
    gain = np.where((b > 0.0) & (c > 0.0), b * b / np.where(c > 0.0, c, 1.0), 0.0)
    best = int(gain.argmax())
    if not gain[best] > 0.0:
        return None
    beta = min(b[best] / c[best], surface.rules.high_beta)
    return np.array([np.log(beta), nodes[best]]), float(gain[best])


def _minimum(surface: SearchedTexels, start: np.ndarray) -> np.ndarray | None:
    """Return log β and log μ at the minimum of the joint sum of squares.

    None if the minimum lies outside the bounds, or if β and μ cannot be separated.
    """
    rules, place, damping = surface.rules, start, 0.0
    part = sums.parts(surface, np.tile(place, (len(surface.blocks), 1)))
    for _ in range(_STEPS):
        slope, normal = (one.sum(axis=0) for one in matrices(part))
        if not np.linalg.det(normal) > 1e-10 * normal[0, 0] * normal[1, 1]:
            return None
        step = np.linalg.solve(normal + damping * np.diag(np.diag(normal)), slope)
        step *= min(1.0, _LONGEST / max(np.abs(step).max(), 1e-300))
        other = sums.parts(surface, np.tile(place + step, (len(surface.blocks), 1)))
        if other[:, sums.SQUARES].sum() > part[:, sums.SQUARES].sum() * (1.0 + 1e-9):
            damping = max(4.0 * damping, 0.5)
            continue
        damping *= 0.25
        place, part = place + step, other
        if np.abs(step).max() < _SETTLED:
            break
    inside = rules.low_log_mu < place[1] < rules.high_log_mu and place[0] < np.log(rules.high_beta)
    return place if inside else None


def _variation(surface: SearchedTexels, place: np.ndarray) -> tuple[np.ndarray, float]:
    """Estimate how far the texels of a paint differ in gloss from the paint, beyond noise.

    Parameters
    ----------
    surface : SearchedTexels
        Texels of the paint.
    place : (2,) float64
        log β and log μ of the paint.

    Returns
    -------
    varying : (2, 2) float64
        As in `SeparateGloss`; negligible if it is not significant by Schwarz's criterion for 3 parameters.
    excess : float
        As in `PaintGloss`.
    """
    part = sums.parts(surface, np.tile(place, (len(surface.blocks), 1)))
    part = part[(part[:, sums.BETA_BETA] > 0.0) & (part[:, sums.MU_MU] > 0.0)]
    varying, excess = sums.varying(part, _FIRST, LEAST_VARYING, _ROUNDS)
    slope, normal = (one / excess for one in matrices(part))
    gain = np.einsum("ti,tij,tj->", slope, _inverse(normal + np.linalg.inv(varying)), slope)
    cost = np.log(np.linalg.det(np.eye(2) + varying @ normal)).sum()
    return varying if gain - cost > 3.0 * np.log(len(part)) else LEAST_VARYING * np.eye(2), float(excess)


def _without(surface: SearchedTexels, place: np.ndarray, photographs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return gradients, (texels, 2), and normal matrices without photographs, about the best gloss for the others.

    ``place`` is log β and log μ, (2,); ``photographs`` is a mask, (P,).
    """
    rest = sums.without_photographs(surface, photographs)
    slope, normal = matrices(sums.parts(rest, np.tile(place, (len(rest.blocks), 1))))
    return slope - normal @ np.linalg.lstsq(normal.sum(axis=0), slope.sum(axis=0), rcond=None)[0], normal


def _shares_in_halves(
    surface: SearchedTexels, place: np.ndarray, root: np.ndarray, excess: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return which part of a variation of gloss among texels both halves of the photographs show.

    What the halves tell about a texel's difference from its paint is compared, for several divisions into halves. The
    covariance of the two is that of the real differences, as far as each half determines them.

    Parameters
    ----------
    surface, place, excess
        As in `confirmed_variation`.
    root : (2, 2) float64
        Root of the variation, which is a unit matrix in the space of the result.

    Returns
    -------
    shares : (2,) float64
        0 to 1; 1 unless less is significant.
    axes : (2, 2) float64
        Their directions, in columns.
    """
    count, draws, products, linear = surface.blocks.shape[2], np.random.default_rng(0), [], []
    for _ in range(_DIVISIONS):
        half = draws.permutation(count) < count // 2
        told = []
        for slope, normal in (_without(surface, place, half), _without(surface, place, ~half)):
            slope, normal = slope @ root / excess, root.T @ normal @ root / excess
            after = _inverse(normal + np.eye(2))
            own = np.einsum("tij,tj->ti", after, slope)
            told.append((own - own.mean(axis=0), after @ normal))
        (one, first), (other, second) = told
        products.append(np.einsum("ti,tj->tij", one, other).reshape(-1, 4))
        linear.append(np.einsum("tik,tjl->tijkl", first, second).reshape(-1, 4, 4))
    product, each = np.mean(products, axis=0), np.mean(linear, axis=0)
    # A direction that the halves do not tell keeps its share of 1.
    total = each.sum(axis=0)
    least = _UNTOLD * np.linalg.norm(total)
    if not least > 0.0:
        return np.ones(2), np.eye(2)
    inverse = np.linalg.inv(total + least * np.eye(4))
    covariance = inverse @ (product.sum(axis=0) + least * np.eye(2).ravel())
    off = ((product - each @ covariance) @ inverse.T).reshape(-1, 2, 2)
    covariance = covariance.reshape(2, 2)
    shares, axes = np.linalg.eigh(0.5 * (covariance + covariance.T))
    error = np.sqrt(np.sum(np.einsum("ik,tij,jk->tk", axes, off, axes) ** 2, axis=0))
    return np.where(shares + _MISSED * error < 1.0, np.maximum(shares, 0.0), 1.0), axes


def confirmed_variation(
    surface: SearchedTexels, place: np.ndarray, varying: np.ndarray, excess: float
) -> tuple[np.ndarray, np.ndarray]:
    """Divide a variation of gloss within a paint into what both halves of the photographs show, and the rest.

    A texel that differs from its paint does so in all photographs. What comes from a lobe of another form, or from
    errors of single photographs, differs between them.

    Parameters
    ----------
    surface : SearchedTexels
        Texels of the paint, without the errors of their photographs.
    place : (2,) float64
        log β and log μ of the paint.
    varying, excess
        As in `SeparateGloss`.

    Returns
    -------
    varying, scatter : (2, 2) float64
        As in `PaintGloss`.
    """
    nothing = LEAST_VARYING * np.eye(2)
    if len(surface.blocks) < _FEWEST or np.trace(varying) <= 2.0 * np.trace(nothing):
        return varying, np.zeros((2, 2))
    root = np.linalg.cholesky(varying)
    shares, axes = _shares_in_halves(surface, place, root, excess)
    if (shares == 1.0).all():
        return varying, np.zeros((2, 2))
    along = root @ axes
    return along * shares @ along.T + nothing, along * (1.0 - shares) @ along.T


def _likelihood(area, slope, normal, varying, share: float) -> float:
    """Return twice the logarithm of the likelihood that a share of a variation is common to the texels of an area.

    Gradients and normal matrices are in units of the variance of observations; the result has an unknown constant.
    """
    least = LEAST_VARYING * np.eye(2)
    own, common = (1.0 - share) * varying + least, share * varying + least
    after = _inverse(np.eye(2) + normal @ own)
    gain = np.einsum("ti,ij,tjk,tk->", slope, own, after, slope) + np.log(np.linalg.det(after)).sum()
    slopes, normals = np.zeros((area.max() + 1, 2)), np.zeros((area.max() + 1, 2, 2))
    np.add.at(slopes, area, np.einsum("tij,tj->ti", after, slope))
    np.add.at(normals, area, after @ normal)
    gain += np.einsum("ti,tij,tj->", slopes, _inverse(normals + np.linalg.inv(common)), slopes)
    return float(gain - np.log(np.linalg.det(np.eye(2) + common @ normals)).sum())


def _differences(surface: SearchedTexels, place, varying, excess) -> sums.Differences:
    """Divide a variation of gloss within a paint into what texels have to themselves and in common with neighbours.

    Wear makes gloss vary from place to place, not from texel to texel. Many texels that differ together tell less about
    their paint, and about the photograph in which they shine, than as many independent ones. Parameters as in
    `confirmed_variation`.
    """
    area, varying = sums.areas(surface, place), varying - LEAST_VARYING * np.eye(2)
    slope, normal = (one / excess for one in matrices(sums.parts(surface, np.tile(place, (len(surface.blocks), 1)))))
    share = max(_SHARES, key=lambda one: _likelihood(area, slope, normal, varying, one))
    return sums.Differences((1.0 - share) * varying, share * varying, area)


def with_variation(paint: SeparateGloss, blocks: np.ndarray, place: np.ndarray) -> SeparateGloss:
    """Return a paint with the variation of gloss among its texels that halves of the photographs confirm.

    Parameters
    ----------
    paint : SeparateGloss
    blocks : (texels, PACKED, P) float64
        Its packed texels without the errors of their photographs.
    place : (2,) float64
        log β and log μ from the joint fit of all paints.
    """
    surface = paint.surface._replace(blocks=blocks)
    if not paint.weighed:
        # A paint may come here again, if fewer readings did not determine its gloss.
        varying, scatter = confirmed_variation(surface, place, paint.varying + paint.scatter, paint.excess)
        return replace(paint, varying=varying, scatter=scatter)
    varying, excess = _variation(surface, place)
    varying, scatter = confirmed_variation(surface, place, varying, excess)
    return replace(paint, varying=varying, scatter=scatter, differences=_differences(surface, place, varying, excess))


def separate_gloss(surface: SearchedTexels, nodes: np.ndarray, *, weighed: bool = True) -> SeparateGloss | None:
    """Fit the common gloss of the texels of one paint by itself.

    Parameters
    ----------
    surface : SearchedTexels
        Texels of the paint.
    nodes : (nodes,) float
        Values of log μ for the initial scan.
    weighed : bool
        As in `SeparateGloss`, if the lobe has the right form.

    Returns
    -------
    SeparateGloss or None
        None if the texels show no gloss, or do not determine it.
    """
    found = _start(surface, nodes)
    place = None if found is None else _minimum(surface, found[0])
    if place is None:
        return None
    part = sums.parts(surface, np.tile(place, (len(surface.blocks), 1)))
    each = np.empty((len(part), 2))
    sums.own_shares(part, np.eye(2) / _ANY, 1.0, each)
    squares, free = each.T
    misfit = squares / np.maximum(free, _LEAST_FREE)
    told = free > _LEAST_FREE
    if not told.any():
        return None
    fits = told & (misfit <= _FOREIGN * np.median(misfit[told]))
    surface = surface._replace(blocks=surface.blocks[fits])
    found = _start(surface, nodes)
    place = None if found is None else _minimum(surface, found[0])
    if found is None or place is None:
        return None
    part = sums.parts(surface, np.tile(place, (len(surface.blocks), 1)))
    varying, excess = _variation(surface, place)
    observations = part[:, sums.USED].sum()
    if not found[1] / max(excess, 1.0) > 2.0 * np.log(observations) or not part[:, sums.SEEN].max() >= LEAST_SEEN:
        return None  # gloss is not significant by Schwarz's criterion, or no texel sees the lobe near its peak
    nothing, area = np.zeros((2, 2)), np.zeros(len(surface.blocks), dtype=np.int64)
    weighed = weighed and excess < _UNDESCRIBED
    own = varying - LEAST_VARYING * np.eye(2) if weighed else nothing
    return SeparateGloss(surface, place, varying, excess, nothing, sums.Differences(own, nothing, area), weighed)


def _weighed(part: np.ndarray, gloss: PaintGloss) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return gradients and normal matrices divided by the variance of what they come from, noise and scatter.

    The third array is the part of each texel's sum of squares that the scatter explains, (texels,).
    """
    slope, normal = matrices(part)
    excess = np.reshape(gloss.excess, (-1, 1, 1))
    if not gloss.scatter.any():
        return slope / excess[..., 0], normal / excess, np.zeros(len(part))
    weight = _inverse(excess * np.eye(2) + normal @ gloss.scatter)
    weighed = np.einsum("tij,tj->ti", weight, slope)
    return weighed, weight @ normal, ((slope[:, None] @ gloss.scatter)[:, 0] * weighed).sum(axis=1)


def share(surface: SearchedTexels, gloss: PaintGloss) -> TexelGloss:
    """Fit the texels of a paint with the gloss of the paint as prior, or each with one of its own.

    ``gloss`` then has a first axis of texels, see `irodori.fitting.mixtures.gloss_between`.
    """
    place = np.broadcast_to(gloss.log_gloss, (len(surface.blocks), 2))
    precision = np.linalg.inv(gloss.varying)
    own = place.copy()
    for _ in range(3):
        part = sums.parts(surface, own)
        slope, normal, _ = _weighed(part, gloss)
        step = np.einsum("tij,tj->ti", _inverse(normal + precision), slope - ((own - place)[:, None] @ precision)[:, 0])
        own = own + np.clip(step, -_LONGEST, _LONGEST)
        if np.abs(step).max(initial=0.0) < _CLOSE:
            break
    part = sums.parts(surface, own)
    _, normal, explained = _weighed(part, gloss)
    after = _inverse(normal + precision)
    kept = after @ precision  # share of an error of the paint's gloss that remains in the texel's gloss
    covariance = after + kept @ gloss.error @ np.swapaxes(kept, 1, 2)
    rules = surface.rules
    with np.errstate(invalid="ignore", divide="ignore"):
        by = part[:, [sums.ALPHA_BY_BETA, sums.ALPHA_BY_MU]]
        alpha, used = part[:, sums.ALPHA], part[:, sums.USED]
        free = np.maximum(used - 1.0, 1.0)
        squares = part[:, sums.SQUARES] - explained
        misfit = squares / np.maximum(gloss.excess, 1.0)
        agrees = (used > 0.0) & np.isfinite(alpha) & (misfit <= free + 5.0 * np.sqrt(2.0 * free))
        # Where a little of another paint is seen, residuals tell how far the parameters may be off. The error of the
        # gloss of a mixture contains that already.
        larger = np.where(agrees, 1.0, np.maximum(squares / free / gloss.excess, 1.0))
        if gloss.log_gloss.ndim == 1:
            covariance = larger[:, None, None] * covariance
        variance = larger * gloss.excess / part[:, sums.ALPHA_WEIGHT]
        variance += np.einsum("ti,tij,tj->t", by, covariance + gloss.scatter, by)
        values = np.exp(own)
        return TexelGloss(
            alpha=alpha,
            alpha_error=np.sqrt(variance + (rules.level_error * alpha) ** 2),
            gloss=values,
            gloss_error=values * np.sqrt(np.einsum("tii->ti", covariance)),
            residual_rms=np.sqrt(part[:, sums.SQUARES] / part[:, sums.TOTAL]),
            relative_residual=np.sqrt(part[:, sums.SQUARES] / part[:, sums.POWER]),
            own=1.0 - 0.5 * np.trace(kept, axis1=1, axis2=2),
            agrees=agrees,
        )
