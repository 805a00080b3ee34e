"""Pictures for registration: the part that may show the object, binned to a limited size, at several levels of blur."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from irodori.core import store
from irodori.jit.compilation import njit

_BANDS = 3  # bands of the first filter state; those of the second were shifted onto it, which adds an error
GREEN = 1  # the only band whose samples lie symmetrically about the centre of a superpixel
_MOST = 1000  # samples along each side of a picture
#: Added to responses before taking logarithms, because darker values carry little information.
DARK = 0.01
_HALF = 0.5  # least share of a blurred sample's weight that comes from valid samples


@dataclass(frozen=True)
class Picture:
    """The responses of one photograph.

    Parameters
    ----------
    response : (height, width, 3) float32
        Responses of the first filter state, 0 where not valid.
    valid : (height, width) float32
        1 where all bands are measured, else 0.
    scale : float
        Samples per superpixel along one side.
    corner : (2,) float64
        Corner of the first sample, x then y, in samples of the binned whole picture.
    noise : (2,) float64
        c0 and c1 of the variance c0 + c1 ρ of a green sample, NaN if not known.
    """

    response: np.ndarray
    valid: np.ndarray
    scale: float
    corner: np.ndarray
    noise: np.ndarray

    @classmethod
    def load(cls, path, window: tuple[float, float, float, float] | None = None) -> "Picture":
        """Read the part of a file of linear responses that lies in a window.

        Parameters
        ----------
        path : path
        window : (4,) float, optional
            x0, y0, x1, y1, superpixels; the whole picture by default.

        Raises
        ------
        InputError
            If the file is damaged or its datasets do not fit together.
        """
        with store.open_file(path) as file:
            file.require_axes({"response": "row,column,band", "valid": "row,column"})
            height, width, _ = file.dataset("response").shape
            density = 2.0 / file.attribute("sample_px")
            first = np.array([0.0, 0.0]) if window is None else np.floor(np.array(window[:2]) * density)
            last = np.array([width, height]) if window is None else np.ceil((np.array(window[2:]) + 1.0) * density)
            (x0, y0), (x1, y1) = np.clip([first, last], 0, [width, height]).astype(int)
            part = slice(y0, max(y0, y1)), slice(x0, max(x0, x1))
            response = file.read("response", part)[..., :_BANDS].astype(np.float32)
            valid = file.read("valid", part).astype(np.float32)
            noise = file.read("noise_model")[GREEN].astype(np.float64)
        response *= valid[..., None]
        bins = max(1, -(-max(valid.shape, default=1) // _MOST))
        if bins > 1:
            weight, noise = _binned(valid, bins), noise / bins**2
            response = _binned(response, bins) / np.maximum(weight, 1e-9)[..., None]
            valid = (weight >= _HALF * bins**2).astype(np.float32)
        return cls(response, valid, density / bins, np.array([x0, y0]) / bins, noise)

    def place(self, xy) -> np.ndarray:
        """Convert superpixels (..., 2), x then y, to coordinates in samples, whose centres have integer coordinates."""
        return (np.asarray(xy) + 0.5) * self.scale - self.corner - 0.5

    def level(self, sigma: float) -> "Level":
        """Return the picture blurred by a Gaussian with a standard deviation of ``sigma`` samples."""
        if sigma <= 0.0:
            return self._sharp
        from scipy import ndimage  # slow to import

        response = np.moveaxis(self.response, -1, 0)
        weight = ndimage.gaussian_filter(self.valid, sigma, truncate=2.5)
        known = np.maximum(weight, 1e-6)
        bands = [ndimage.gaussian_filter(band, sigma, truncate=2.5) / known for band in response]
        return Level(np.stack(bands), (weight > _HALF).astype(np.float32), sigma)

    @cached_property
    def _sharp(self) -> "Level":
        """The picture without blur."""
        return Level(np.ascontiguousarray(np.moveaxis(self.response, -1, 0)), self.valid)


@njit(cache=True, error_model="numpy")
def _sample(pictures, valid, place, out):
    """Interpolate pictures at points, x then y; points beyond them, or beside samples that are not valid, get NaN."""
    height, width = valid.shape
    for p in range(place.shape[0]):
        x, y = place[p, 0], place[p, 1]
        sure = 0.0
        if 0.0 <= x <= width - 1.0 and 0.0 <= y <= height - 1.0:
            j, i = int(x), int(y)
            right, below = x - j, y - i
            after, under = min(j + 1, width - 1), min(i + 1, height - 1)
            a, b = (1.0 - below) * (1.0 - right), (1.0 - below) * right
            c, d = below * (1.0 - right), below * right
            sure = a * valid[i, j] + b * valid[i, after] + c * valid[under, j] + d * valid[under, after]
        if not sure > 0.999:
            for n in range(pictures.shape[0]):
                out[p, n] = np.nan
            continue
        for n in range(pictures.shape[0]):
            one = pictures[n]
            out[p, n] = a * one[i, j] + b * one[i, after] + c * one[under, j] + d * one[under, after]


@dataclass(frozen=True)
class Level:
    """A blurred picture: responses (bands, height, width) float32, a mask of valid samples, and the blur in samples."""

    bands: np.ndarray
    valid: np.ndarray  # (height, width)
    sigma: float = 0.0

    def sampled(self, pictures: np.ndarray, place: np.ndarray) -> np.ndarray:
        """Interpolate pictures (n, height, width) bilinearly at points (p, 2); (p, n) float32, NaN where not known."""
        out = np.empty((len(place), len(pictures)), dtype=np.float32)
        _sample(pictures, self.valid, np.ascontiguousarray(place, dtype=np.float64), out)
        return out


def _binned(values: np.ndarray, bins: int) -> np.ndarray:
    """Return sums over squares of ``bins`` x ``bins`` samples; incomplete squares at right and bottom are dropped."""
    height, width = (side // bins for side in values.shape[:2])
    cut = values[: height * bins, : width * bins]
    return cut.reshape(height, bins, width, bins, *values.shape[2:]).sum(axis=(1, 3))
