"""Fresnel reflectance of a surface n + ik in air, for unpolarised light."""

import numpy as np

from irodori.jit.compilation import njit
from irodori.jit.functions import lower_of, magnitude, root, select, upper_of

#: Avoids 0 / 0 in a division; a normal number in single precision.
_TINY = 1e-18


@njit(cache=True, error_model="numpy", forceinline=True, fastmath={"contract"})
def fresnel(cosine, n, k):
    """Return the unpolarised Fresnel reflectance; a kernel without branches for numbers or `irodori.jit.vectors`.

    Parameters
    ----------
    cosine : float
        Cosine of the angle of incidence, clipped to 0..1; NaN counts as 0.
    n, k : float
        Complex refractive index, n > 0 and k >= 0; below 1e4 in single precision.

    Returns
    -------
    float
        Between 0 and 1; 0 for n + ik = 1 at any angle, 1 at grazing incidence on anything else.

    Notes
    -----
    Born and Wolf, *Principles of Optics*, §14.2. With a + ib = sqrt((n + ik)² - sin²) and c, s cosine and sine,
    R_s = ((a - c)² + b²) / ((a + c)² + b²) and R_p / R_s = (A - 2acs²) / (A + 2acs²), A = (a² + b²) c² + s⁴, so that
    the mean of both is R_s A / (A + 2acs²): these are sums of positive numbers, without cancellation. Only a - c can
    cancel. It is computed as (n² - 1 - k² + b²) / (a + c), which is accurate, where b < c; elsewhere b² dominates the
    sum and the loss of digits in a - c does not matter.
    """
    c = lower_of(upper_of(cosine, 0.0), 1.0)
    c2, nk = c * c, n * k
    s2 = (1.0 - c) * (1.0 + c)
    contrast = (n - 1.0) * (n + 1.0) - k * k
    # Of two forms of n² - k² - s², the one that does not cancel is chosen: they fail near index 1 and far below it.
    real = select(c2 < 0.5, contrast + c2, n * n - s2 - k * k)
    modulus = root(real * real + 4.0 * (nk * nk))
    large = root(0.5 * (modulus + magnitude(real)))
    small = nk / upper_of(large, _TINY)
    a, b = select(real >= 0.0, large, small), select(real >= 0.0, small, large)
    b2, total = b * b, a + c
    difference = select(b2 < c2, contrast + b2, (a - c) * total)  # times a + c
    square, even = total * total, modulus * c2 + s2 * s2
    over = (difference * difference + b2 * square) * even
    under = square * (square + b2) * (even + 2.0 * (a * c * s2))
    # Both are 0 at grazing incidence if light is totally reflected (b > 0: result 1), and without a surface (result 0).
    return lower_of(1.0, select(under > 0.0, over / under, select(b2 > 0.0, 1.0, b2)))


@njit(cache=True, error_model="numpy")
def _fill(cosine, n, k, out):
    for j in range(cosine.size):
        out[j] = fresnel(cosine[j], n, k)


def fresnel_array(cosine, n: float, k: float) -> np.ndarray:
    """Return the unpolarised Fresnel reflectance of `fresnel` over an array of cosines, (...) float64.

    Examples
    --------
    Glass reflects 4 % of the light at normal incidence, and all of it at grazing incidence:

    >>> fresnel_array([1.0, 0.5, 0.0], 1.5, 0.0).round(3).tolist()
    [0.04, 0.089, 1.0]
    """
    cosine = np.asarray(cosine, dtype=np.float64, order="C")
    out = np.empty(cosine.size)
    _fill(cosine.reshape(-1), float(n), float(k), out)
    return out.reshape(cosine.shape)
