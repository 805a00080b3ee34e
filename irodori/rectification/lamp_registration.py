"""Estimation of the brightness and direction of lamps from the shading of an object of known shape.

Lamps of a dome are not equally bright, and a lamp that is moved by hand does not return to exactly the same place.
Brightness levels and directions are estimated together from all photographs of a fixed camera. The surface model has a
diffuse weight at every point and one gloss lobe for all points. The diffuse weights are eliminated in closed form; the
rest is a robust least-squares fit, with the directions that were known beforehand as a prior. Only ratios of levels can
be determined, so that their geometric mean is set to 1.
"""

from dataclasses import dataclass

import numpy as np

from irodori.core.errors import counted
from irodori.reflection.equation5 import angles_from_directions
from irodori.reflection.fresnel import fresnel_array
from irodori.reflection.lobe_arrays import LobeAtAngles
from irodori.reflection.registry import DEFAULT_LOBES

#: Expected misfit of a photograph to the model, relative to its mean; independent readings that a photograph counts as.
_MISFIT, _READINGS = 0.02, 100.0
#: Roughness from which the search begins, rad.
_STARTS = (0.1, 0.4)
_LOG_BETA = (-7.0, 5.0)
_STEP = 1e-4  # of numerical derivatives: standard deviations of a direction, or of the logarithm of the roughness


@dataclass(frozen=True)
class Lamps:
    """Directions and levels of the lamps of J photographs, one lamp each.

    Parameters
    ----------
    direction : (J, 3) float64
        Unit vectors to the lamps.
    level : (J,) float64
        Relative brightness; the geometric mean is 1.
    moved_deg : (J,) float64
        Angle between each direction and the one that was known beforehand.
    """

    direction: np.ndarray
    level: np.ndarray
    moved_deg: np.ndarray

    @property
    def light(self) -> np.ndarray:
        """Directions to the lamps times their levels, (J, 3)."""
        return self.level[:, None] * self.direction

    @classmethod
    def of_light(cls, light, known) -> "Lamps":
        """Return lamps from directions times levels, (J, 3), and the directions that were known beforehand, (J, 3)."""
        level = np.linalg.norm(light, axis=1)
        direction = light / level[:, None]
        moved = np.degrees(np.arccos(np.minimum((direction * known).sum(axis=1), 1.0)))
        return cls(direction, level / np.exp(np.log(level).mean()), moved)


def geometry_of(normal, view, direction) -> np.ndarray:
    """Return the angles θ_i, θ_r, θ_H, φ, (T, J, 4) rad, of T points with their normals under J lamps."""
    return angles_from_directions(normal[:, None, :], direction[None], view[:, None, :])


def cosine_to_half(view, direction) -> np.ndarray:
    """Return cosθ_H, (..., J), of J lamps in directions (J, 3) seen from directions (..., 3)."""
    return np.sqrt(np.maximum(0.5 * (1.0 + view @ direction.T), 0.0))


def register_lamps(response, normal, view, weight, direction, *, error_deg: float, n: float, k: float) -> Lamps:
    """Estimate levels and directions of the lamps of J photographs from the responses of T points.

    Parameters
    ----------
    response : (T, J) float
        Responses of points in photographs, proportional to the light.
    normal, view : (T, 3) float
        Unit vectors of the surface normals and towards the camera.
    weight : (T, J) float
        0 where a point is not seen, not lit, near the border of light and shadow, or clipped.
    direction : (J, 3) float
        Unit vectors to the lamps as known beforehand.
    error_deg : float
        Standard deviation of these directions, degrees; 0 if they are exact.
    n, k : float
        Complex refractive index of the surface.

    Raises
    ------
    ValueError
        If there are fewer than four photographs.
    """
    from scipy.optimize import least_squares  # slow to import

    count = len(direction)
    if count < 4:
        raise ValueError(
            f"{counted(count, 'photograph')}; accepted: four or more, of which three give one diffuse weight"
        )
    scale = (weight * response).sum() / weight.sum()
    part = weight * np.sqrt(_READINGS / weight.sum(axis=0)) / _MISFIT
    first, second = perpendiculars(direction)

    def parts(x: np.ndarray) -> tuple[np.ndarray, np.ndarray, float, float]:
        level = np.exp(np.append(x[: count - 1], -x[: count - 1].sum()))
        if not error_deg:
            return direction, level, *np.exp(x[count - 1 :])
        turned = x[count - 1 : -2].reshape(count, 2) * np.radians(error_deg)
        moved = direction + turned[:, :1] * first + turned[:, 1:] * second
        return moved / np.linalg.norm(moved, axis=1)[:, None], level, *np.exp(x[-2:])

    # Residuals beyond the expected misfit count by about their absolute value (soft L1), priors by their square.
    unit, used = np.sqrt(_READINGS / weight.sum(axis=0)), weight > 0.0

    def model(lamps: np.ndarray, beta: float, mu: float) -> tuple[np.ndarray, np.ndarray]:
        """Return cosines of incidence and gloss, (T, J) each, for lamps of level 1."""
        lobe = LobeAtAngles.under_lamps(DEFAULT_LOBES[0], normal, view, lamps)
        gloss = beta * lobe.value(mu) * fresnel_array(cosine_to_half(view, lamps), n, k)
        return np.maximum(normal @ lamps.T, 0.0), gloss

    def diffuse(cosine: np.ndarray, gloss: np.ndarray, level: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return what gloss leaves of the responses, the diffuse weights and the sums that these are divided by."""
        off, power = response / scale - level * gloss, np.sum(weight * (level * cosine) ** 2, axis=1)
        power = np.maximum(power, 1e-12)
        return off, (weight * off * level * cosine).sum(axis=1) / power, power

    def residuals(x: np.ndarray) -> np.ndarray:
        lamps, level, beta, mu = parts(x)
        cosine, gloss = model(lamps, beta, mu)
        off, alpha, _ = diffuse(cosine, gloss, level)
        left = part * (off - alpha[:, None] * level * cosine)
        z = (left / unit) ** 2
        robust = np.sign(left) * unit * np.sqrt(2.0 * (np.sqrt(1.0 + z) - 1.0))
        return np.concatenate([robust[used], x[count - 1 : -2]])

    def slopes(x: np.ndarray) -> np.ndarray:
        """Return the derivatives of the residuals: a lamp changes the model in its own photograph alone."""
        lamps, level, beta, mu = parts(x)
        cosine, gloss = model(lamps, beta, mu)
        off, alpha, power = diffuse(cosine, gloss, level)
        shade = level * cosine
        left = part * (off - alpha[:, None] * shade)
        root = np.sqrt(1.0 + (left / unit) ** 2)
        outer = part * np.sqrt(0.5 * (root + 1.0)) / root  # derivatives of the robust residuals, times the weights

        def column(off_change: np.ndarray, shade_change: np.ndarray, which: slice) -> np.ndarray:
            """Return a column from changes, (T, J), of what gloss leaves and of shade in some of the photographs."""
            told = weight[:, which] * (off_change * shade[:, which] + off[:, which] * shade_change)
            doubled = 2.0 * weight[:, which] * shade[:, which] * shade_change
            alpha_change = (told.sum(axis=1) - alpha * doubled.sum(axis=1)) / power
            change = -alpha_change[:, None] * shade
            change[:, which] += off_change - alpha[:, None] * shade_change
            return (outer * change)[used]

        each = [slice(number, number + 1) for number in range(count)]
        by_level = [column(-(level * gloss)[:, own], shade[:, own], own) for own in each]
        columns = [one - by_level[-1] for one in by_level[:-1]]
        if error_deg:
            ends = []
            for axis in (0, 1):
                moved = np.zeros((2, len(x)))
                moved[:, count - 1 + axis : -2 : 2] = [[_STEP], [-_STEP]]
                ahead, behind = (model(parts(x + one)[0], beta, mu) for one in moved)
                ends.append([(one - other) / (2.0 * _STEP) * level for one, other in zip(ahead, behind, strict=True)])
            for own in each:
                columns += [column(-by_gloss[:, own], by_cosine[:, own], own) for by_cosine, by_gloss in ends]
        nothing = np.zeros_like(shade)
        rough, smooth = (model(lamps, beta, mu * np.exp(sign * _STEP))[1] for sign in (1.0, -1.0))
        for by_gloss in (gloss, (rough - smooth) / (2.0 * _STEP)):
            columns.append(column(-level * by_gloss, nothing, slice(None)))
        priors = np.zeros((2 * count if error_deg else 0, len(x)))
        priors[:, count - 1 : -2] = np.eye(len(priors))
        return np.concatenate([np.stack(columns, axis=1), priors])

    size = (count - 1) + (2 * count if error_deg else 0)
    low, high = np.full(size + 2, -np.inf), np.full(size + 2, np.inf)
    low[-2:], high[-2:] = (_LOG_BETA[0], np.log(0.02)), (_LOG_BETA[1], np.log(1.2))
    found = min(
        (
            least_squares(residuals, [*np.zeros(size), 0.0, np.log(start)], slopes, bounds=(low, high), x_scale="jac")
            for start in _STARTS
        ),
        key=lambda one: one.cost,
    )
    lamps, level, _, _ = parts(found.x)
    moved = np.degrees(np.arccos(np.minimum((lamps * direction).sum(axis=1), 1.0)))
    return Lamps(lamps, level, moved)


def perpendiculars(direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return two unit vectors perpendicular to each direction and to each other, (J, 3) each."""
    axis = np.eye(3)[np.abs(direction).argmin(axis=1)]
    first = np.cross(direction, axis)
    first /= np.linalg.norm(first, axis=1)[:, None]
    return first, np.cross(direction, first)
