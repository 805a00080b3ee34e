"""Convolution of an environment with von Mises-Fisher lobes of increasing width.

A lobe of width s is κ / (2π (1 - exp(-2κ))) exp(κ (cosγ - 1)) with κ = 1 / s², the analogue of a Gaussian on the
sphere. Along rows, the convolution is a product of Fourier series, which is periodic across the seam; between rows, the
lobe is evaluated on the sphere. Each pixel has uniform radiance over its area: rows that are wide compared with the
lobe are divided.
"""

from concurrent.futures import ThreadPoolExecutor

import numba
import numpy as np

from irodori.light.environment_file import directions

#: Widths of the ladder, rad: a factor √2 apart.
WIDTHS_RAD = 0.01 * 2.0 ** (0.5 * np.arange(-1, 13))
_SAMPLES_PER_WIDTH = 3.0
_FEWEST_ROWS = 12
_CUT = 4.5  # distance, in widths, beyond which the lobe is negligible
_ROWS_PER_WIDTH = 5.0  # smallest number of source rows per width after thinning
_FINEST_OF_PITCH = 0.6  # smallest width of a lobe relative to a pixel: a narrower one would resolve single pixels
_PARTS_PER_WIDTH = 4.0  # smallest number of source rows per width after division
_ROWS_AT_A_TIME = 64
_NARROW = 300.0  # κ sinθ sinθ' above which a row's lobe is narrow enough for the asymptotic series
#: Beyond this many standard deviations of a row's series, and a few terms more, all are below 1e-7 of the first.
_SERIES_CUT, _MORE_TERMS = 5.7, 12


def level_height(width_rad: float) -> int:
    """Return the number of rows of the map for a width: three rows per width; there are twice as many columns."""
    return max(int(np.ceil(_SAMPLES_PER_WIDTH * np.pi / width_rad)), _FEWEST_ROWS)


def first_level(height: int, width: int) -> int:
    """Return the finest level of `WIDTHS_RAD` that a picture of this size can resolve."""
    pitch = max(np.pi / height, 2 * np.pi / width)
    return min(int(np.searchsorted(WIDTHS_RAD, _FINEST_OF_PITCH * pitch)), len(WIDTHS_RAD) - 1)


def _row_series(coefficients: np.ndarray, terms: int) -> np.ndarray:
    """Return the Fourier series along rows of radiance times solid angle, (height, terms, k) complex64."""
    from scipy import fft  # slow to import, and not needed to read stored levels

    height, width, bases = coefficients.shape
    solid_angle = directions(1, height)[1][:, 0] / width
    order = np.arange(terms)
    # The series of point powers is periodic in the number of columns.
    index = order % width
    # Position of column 0, and the series of a pixel's width.
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
    """Return an effective polar angle for each row, rad: its cosine is the mean cosine over the row."""
    edges = np.cos(np.pi * np.arange(height + 1) / height)
    return np.arccos(0.5 * (edges[1:] + edges[:-1]))


def _divided(series: np.ndarray, parts: int) -> tuple[np.ndarray, np.ndarray]:
    """Divide every row of light into parts in proportion to solid angle; return the parts and their polar angles."""
    cosine = np.cos(np.pi * np.arange(len(series) * parts + 1) / (len(series) * parts))
    share = (cosine[:-1] - cosine[1:]).reshape(-1, parts)
    share = (share / share.sum(axis=1, keepdims=True)).ravel().astype(np.float32)
    return np.repeat(series, parts, axis=0) * share[:, None, None], row_angles(len(series) * parts)


def _thinned(series: np.ndarray, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Halve the number of rows; return the new rows and their polar angles.

    The power of each old row is shared between the two nearest new rows so that its mean position is kept.
    """
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
        # Beyond a pole is the opposite meridian, half a turn away in azimuth.
        for chosen, turned in ((inside, False), (~inside, True)):
            where = np.flatnonzero(chosen)
            matrix = sparse.csr_array(
                (weight[where].astype(np.float32), (np.clip(target[where], 0, rows - 1), where)), shape=(rows, height)
            )
            part = matrix @ flat
            out += (part.reshape(rows, terms, bases) * sign).reshape(rows, -1) if turned else part
    return out.reshape(rows, terms, bases), np.pi * (np.arange(rows) + 0.5) / rows


def _concentration(width_rad: float, pitch_rad: float) -> float:
    """Return κ of a lobe that has the given width after bilinear look-up, which adds pitch²/6 to the squared width."""
    return 1.0 / (width_rad**2 - pitch_rad**2 / 6.0)


def _bessel_series(meridian: np.ndarray, parallel: np.ndarray, terms: int) -> np.ndarray:
    """Return the Fourier series of exp(meridian + z (cos φ - 1)), z = ``parallel`` (rows, 1), as (rows, terms).

    Its terms are exp(-z) I_m(z) by the uniform expansion [Abramowitz and Stegun 9.7.7], to the second order in 1 / z.
    """
    square = np.arange(terms) ** 2 / parallel
    # The second term of the exponent is limited where it would exceed the first; the series is negligible there.
    exponent = meridian + 0.125 / parallel
    exponent = exponent - square * (0.5 + 0.25 / parallel - np.minimum(square / (24.0 * parallel), 0.25))
    with np.errstate(under="ignore"):
        return np.exp(exponent) / np.sqrt(2.0 * np.pi * parallel)


def _level(series: np.ndarray, source: np.ndarray, width_rad: float, pool: ThreadPoolExecutor) -> np.ndarray:
    """Compute the map for one width, (h, 2 h, k) float32, from Fourier series of rows at polar angles ``source``."""
    from scipy import fft  # slow to import

    height = level_height(width_rad)
    kappa = _concentration(width_rad, np.pi / height)
    scale = kappa / (2 * np.pi * -np.expm1(-2 * kappa))
    terms = min(series.shape[1], height)
    target = np.pi * (np.arange(height) + 0.5) / height
    reach = _CUT / np.sqrt(kappa)
    # Real and imaginary parts are columns: the kernel is real.
    numbers = np.ascontiguousarray(series).view(np.float32)
    spectrum = np.zeros((height, terms, numbers.shape[2]), dtype=np.float32)

    def fill(row: int) -> None:
        first, last = np.searchsorted(source, [target[row] - reach, target[row] + reach])
        theta = source[first:last, None]
        meridian = kappa * (np.cos(target[row] - theta) - 1.0)
        parallel = kappa * np.sin(target[row]) * np.sin(theta)
        kept = min(terms, int(_SERIES_CUT * np.sqrt(parallel.max())) + _MORE_TERMS)
        if parallel.min() > _NARROW:
            kernel = scale * _bessel_series(meridian, parallel, kept)
        else:
            samples = fft.next_fast_len(2 * kept, real=True)
            cosine = np.cos(2 * np.pi * np.arange(samples) / samples)
            lobe = meridian + parallel * (cosine - 1.0)
            kernel = fft.rfft(np.exp(lobe), axis=1).real[:, :kept] * (scale / samples)
        spectrum[row, :kept] = np.einsum("rm,rmk->mk", kernel.astype(np.float32), numbers[first:last, :kept])

    list(pool.map(fill, range(height)))
    turn = (2 * height) * np.exp(1j * np.pi * np.arange(terms) / (2 * height))[:, None]
    # In double precision: beside a sun, single precision would round by more than the light of a shadow.
    blurred = fft.irfft(spectrum.view(np.complex64) * turn, n=2 * height, axis=1, workers=numba.get_num_threads())
    return blurred.astype(np.float32)


def prefiltered(coefficients: np.ndarray, levels: tuple[int, int] | None = None) -> tuple[int, list[np.ndarray]]:
    """Compute the blurred maps of an environment.

    Parameters
    ----------
    coefficients : (height, width, k) float
        Radiance, equirectangular.
    levels : (int, int), optional
        First level of `WIDTHS_RAD`, and one after the last; by default all that the picture can resolve.

    Returns
    -------
    first : int
        The finest level returned: the first wanted, or the finest that the picture can resolve.
    levels : list of (h, 2 h, k) float32
        Maps from this level on; each is the mean radiance weighted by a lobe of its width.
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
            while np.pi * _ROWS_PER_WIDTH <= width_rad * (len(series) // 2):
                series, theta = _thinned(series, theta)
            blurred.append(_level(series, theta, width_rad, pool))
    return first, blurred
