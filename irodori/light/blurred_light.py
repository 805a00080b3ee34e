"""Environment convolved with von Mises-Fisher lobes of increasing width.

A lobe of width s is κ / (2π (1 - exp(-2κ))) exp(κ (cosγ - 1)) with κ = 1 / s², the Gaussian of the sphere. Along a row
the convolution is a product of Fourier series, which closes at the seam; from row to row the lobe itself is evaluated
on the sphere. A pixel shines evenly over its area: where it is wide against the lobe its row is divided.
"""

from concurrent.futures import ThreadPoolExecutor

import numba
import numpy as np

from irodori.light.environment_file import directions

#: Widths of the ladder, rad: a factor √2 apart.
WIDTHS_RAD = 0.01 * 2.0 ** (0.5 * np.arange(-1, 13))
_SAMPLES_PER_WIDTH = 3.0
_FEWEST_ROWS = 12
_CUT = 4.5  # widths beyond which the lobe is nothing
_ROWS_PER_WIDTH = 5.0  # rows of the source over the width, at least, where it is thinned
_FINEST_OF_PITCH = 0.6  # a lobe narrower than this part of a pixel would show the pixels one by one
_PARTS_PER_WIDTH = 4.0  # rows of the source over the width, at least, into which coarse rows are divided
_ROWS_AT_A_TIME = 64
_NARROW = 300.0  # κ sinθ sinθ' from which a row's lobe is narrow enough for the asymptotic series


def level_height(width_rad: float) -> int:
    """Return the rows of the map of a width: three to the width; columns are twice as many."""
    return max(int(np.ceil(_SAMPLES_PER_WIDTH * np.pi / width_rad)), _FEWEST_ROWS)


def first_level(height: int, width: int) -> int:
    """Return the finest level of the ladder that a picture of a size fills."""
    pitch = max(np.pi / height, 2 * np.pi / width)
    return min(int(np.searchsorted(WIDTHS_RAD, _FINEST_OF_PITCH * pitch)), len(WIDTHS_RAD) - 1)


def _row_series(coefficients: np.ndarray, terms: int) -> np.ndarray:
    """Return the Fourier series along every row of the power of the pixels, (height, terms, k) complex64."""
    from scipy import fft  # slow to import, and whoever reads stored levels blurs nothing

    height, width, bases = coefficients.shape
    solid_angle = directions(1, height)[1][:, 0] / width
    order = np.arange(terms)
    # Powers at points have a series without end, which repeats with the number of columns.
    index = order % width
    # The place of column 0, and the series of a pixel's width.
    phase = (np.exp(-1j * np.pi * order / width) * np.sinc(order / width))[:, None]
    out = np.empty((height, terms, bases), dtype=np.complex64)
    for first in range(0, height, _ROWS_AT_A_TIME):
        rows = slice(first, min(first + _ROWS_AT_A_TIME, height))
        power = coefficients[rows].astype(np.float64) * solid_angle[rows, None, None]
        half = fft.rfft(power, axis=1, workers=numba.get_num_threads())
        mirrored = index > width // 2
        series = half[:, np.where(mirrored, width - index, index)]
        series[:, mirrored] = series[:, mirrored].conj()
        out[rows] = series * phase
    return out


def row_angles(height: int) -> np.ndarray:
    """Return the polar angle, rad, at which each row's power counts: the mean of the cosine over the row."""
    edges = np.cos(np.pi * np.arange(height + 1) / height)
    return np.arccos(0.5 * (edges[1:] + edges[:-1]))


def _divided(series: np.ndarray, parts: int) -> tuple[np.ndarray, np.ndarray]:
    """Return every row of light divided into parts by solid angle, and their angles."""
    cosine = np.cos(np.pi * np.arange(len(series) * parts + 1) / (len(series) * parts))
    share = (cosine[:-1] - cosine[1:]).reshape(-1, parts)
    share = (share / share.sum(axis=1, keepdims=True)).ravel().astype(np.float32)
    return np.repeat(series, parts, axis=0) * share[:, None, None], row_angles(len(series) * parts)


def _thinned(series: np.ndarray, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return half the rows and their angles; the power of each is shared by the two nearest: its place is kept."""
    from scipy import sparse  # slow to import

    height, terms, bases = series.shape
    rows = height // 2
    place = theta / np.pi * rows - 0.5
    lower = np.floor(place).astype(int)
    share = place - lower
    sign = np.where(np.arange(terms) % 2, -1.0, 1.0).astype(np.float32)[:, None]
    flat = series.reshape(height, -1)
    out = np.zeros((rows, terms * bases), dtype=np.complex64)
    for target, weight in ((lower, 1.0 - share), (lower + 1, share)):
        inside = (target >= 0) & (target < rows)
        # Beyond a pole lies the opposite meridian, half a turn away in azimuth.
        for chosen, turned in ((inside, False), (~inside, True)):
            where = np.flatnonzero(chosen)
            matrix = sparse.csr_array(
                (weight[where].astype(np.float32), (np.clip(target[where], 0, rows - 1), where)), shape=(rows, height)
            )
            part = matrix @ flat
            out += (part.reshape(rows, terms, bases) * sign).reshape(rows, -1) if turned else part
    return out.reshape(rows, terms, bases), np.pi * (np.arange(rows) + 0.5) / rows


def _concentration(width_rad: float, pitch_rad: float) -> float:
    """Return κ of the lobe that has a width after bilinear look-up at a pitch, which adds pitch²/6 to its square."""
    return 1.0 / (width_rad**2 - pitch_rad**2 / 6.0)


def _bessel_series(meridian: np.ndarray, parallel: np.ndarray, terms: int) -> np.ndarray:
    """Return the Fourier series of exp(meridian + z (cos φ - 1)), z = ``parallel`` (rows, 1), as (rows, terms).

    Its terms are exp(-z) I_m(z) by the uniform expansion [Abramowitz and Stegun 9.7.7], to the second order in 1 / z.
    """
    square = np.arange(terms) ** 2 / parallel
    # The second term of the exponent is held where it would outgrow the first: nothing is left of the series there.
    exponent = meridian + 0.125 / parallel
    exponent = exponent - square * (0.5 + 0.25 / parallel - np.minimum(square / (24.0 * parallel), 0.25))
    with np.errstate(under="ignore"):
        return np.exp(exponent) / np.sqrt(2.0 * np.pi * parallel)


def _level(series: np.ndarray, source: np.ndarray, width_rad: float, pool: ThreadPoolExecutor) -> np.ndarray:
    """Return the map of one width, (h, 2 h, k) float32, from rows at polar angles ``source`` (rad)."""
    from scipy import fft  # slow to import

    height = level_height(width_rad)
    kappa = _concentration(width_rad, np.pi / height)
    scale = kappa / (2 * np.pi * -np.expm1(-2 * kappa))
    terms = min(series.shape[1], height)
    samples = fft.next_fast_len(2 * terms, real=True)
    cosine = np.cos(2 * np.pi * np.arange(samples) / samples)
    target = np.pi * (np.arange(height) + 0.5) / height
    reach = _CUT / np.sqrt(kappa)
    # Real and imaginary parts are columns: the kernel is real.
    numbers = np.ascontiguousarray(series).view(np.float32)
    spectrum = np.empty((height, terms, numbers.shape[2]), dtype=np.float32)

    def fill(row: int) -> None:
        first, last = np.searchsorted(source, [target[row] - reach, target[row] + reach])
        if first == last:
            first, last = max(first - 1, 0), min(last + 1, len(source))
        theta = source[first:last, None]
        meridian = kappa * (np.cos(target[row] - theta) - 1.0)
        parallel = kappa * np.sin(target[row]) * np.sin(theta)
        if parallel.min() > _NARROW:
            kernel = scale * _bessel_series(meridian, parallel, terms)
        else:
            lobe = meridian + parallel * (cosine - 1.0)
            kernel = fft.rfft(np.exp(lobe), axis=1).real[:, :terms] * (scale / samples)
        spectrum[row] = np.einsum("rm,rmk->mk", kernel.astype(np.float32), numbers[first:last, :terms])

    list(pool.map(fill, range(height)))
    turn = np.exp(1j * np.pi * np.arange(terms) / (2 * height))[:, None]
    return (fft.irfft(spectrum.view(np.complex64) * turn, n=2 * height, axis=1) * (2 * height)).astype(np.float32)


def prefiltered(coefficients: np.ndarray, levels: tuple[int, int] | None = None) -> tuple[int, list[np.ndarray]]:
    """Return the blurred maps of an environment.

    Parameters
    ----------
    coefficients : (height, width, k) float
        Radiance, equirectangular.
    levels : (int, int), optional
        First and last-plus-one level of `WIDTHS_RAD` that is wanted; all that the picture fills where absent.

    Returns
    -------
    first : int
        The finest level returned: that which was wanted, or the finest that the picture fills.
    levels : list of (h, 2 h, k) float32
        From that level on; each is the mean radiance under a lobe of its width.
    """
    height, width = coefficients.shape[:2]
    first = first_level(height, width)
    last = len(WIDTHS_RAD)
    if levels is not None:
        first, last = max(first, levels[0]), max(first + 1, levels[1])
    finest = WIDTHS_RAD[first]
    series = _row_series(coefficients, min(int(np.ceil(6.0 / finest)) + 1, level_height(finest)))
    series, theta = _divided(series, int(np.ceil(_PARTS_PER_WIDTH * np.pi / height / finest)))
    blurred = []
    with ThreadPoolExecutor(numba.get_num_threads()) as pool:
        for width_rad in WIDTHS_RAD[first:last]:
            while np.pi / (len(series) // 2 or 1) <= width_rad / _ROWS_PER_WIDTH:
                series, theta = _thinned(series, theta)
            blurred.append(_level(series, theta, width_rad, pool))
    return first, blurred
