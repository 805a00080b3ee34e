"""Choice of the smallest number of basis vectors within a colour tolerance, and writing of the coefficients."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace

import numba
import numpy as np

from irodori.colour.colorimetry import delta_e_of_light, summary
from irodori.config.definition import check_choices
from irodori.config.models import Compress
from irodori.core import store
from irodori.jit.half_precision import half_from_single
from irodori.material.coefficients import (
    from_half,
    half_scale,
    reserve_coefficients,
)
from irodori.material.principal_components.decomposition import Decomposition, decompose
from irodori.material.principal_components.pixel_tiles import Tiles
from irodori.material.principal_components.second_moments import Moments, second_moments
from irodori.spectra.grid import SAMPLES

_FIRST_LOOK = 8192  # pixels of the sample, which come in no order
_PIECE = 4096  # pixels whose colours are compared together
_DEVIATIONS = 2.33  # standard deviations under which a sample's mean or percentile stays in 99 of 100 pictures


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class CompressOptions(Compress):
    """The ``compress`` block of the configuration.

    The limits of the errors include rounding in storage. If only a sample of the picture is compared, they apply to
    upper bounds at 99 % confidence.
    """

    def __post_init__(self) -> None:
        check_choices(self)
        if self.align < 1:
            raise ValueError(f"align {self.align}; accepted: 1 or more")


@dataclass(frozen=True)
class Compression:
    """A spectral basis for one picture, the matrix that computes coefficients on it, and the errors.

    Parameters
    ----------
    basis : (61, k) float64, orthonormal columns
    encoder : (k, r) float64
        ``coefficients = encoder @ pixel``.
    scale : (k,) float32
        Divisors of the coefficients in half precision; 1 in single precision.
    storage : str
        ``half`` or ``single``.
    errors : dict
        light -> mean, p95, p99, max of CIEDE2000 between the sample's spectra before and after compression, rounding in
        storage included; the count of pixels compared; and ``mean_bound`` and ``p99_bound``, upper bounds for the whole
        picture at 99 % confidence.
    rmse : float
        Root mean square error of the sample's spectra over pixels and wavelengths.
    budget_met : bool
        False if the errors exceed the target, even with all basis vectors.
    rank, pixels, masked : int
        Rank of the picture's second moments; number of all pixels; number of those that are not finite, which have no
        coefficients.
    negative : float
        Share of the decoded sample's values, of all pixels and wavelengths, that are below zero.
    sample : (n, r) float32
        Pixels from which the errors are computed.
    """

    basis: np.ndarray
    encoder: np.ndarray
    scale: np.ndarray
    storage: str
    errors: dict
    rmse: float
    budget_met: bool
    rank: int
    pixels: int
    masked: int
    negative: float
    sample: np.ndarray = field(repr=False)

    @property
    def bases(self) -> int:
        """Number of basis vectors."""
        return self.basis.shape[1]

    def encode(self, rows: np.ndarray) -> np.ndarray:
        """Return the coefficients (n, k) of pixels (n, r) in stored form, half or single; NaN for pixels not finite."""
        # Scales are powers of two: dividing the encoder instead of the coefficients gives the same bits.
        encoder = (self.encoder / self.scale[:, None]).T.astype(np.float32)
        with np.errstate(invalid="ignore", over="ignore"):
            out = np.asarray(rows, dtype=np.float32) @ encoder
        finite = np.isfinite(out)
        if not finite.all():
            out[~finite.all(axis=1)] = np.nan
        return half_from_single(out) if self.storage == "half" else out

    def decode(self, stored: np.ndarray) -> np.ndarray:
        """Return stored coefficients (n, k) as float32."""
        return from_half(stored, self.scale) if self.storage == "half" else stored

    def summary(self) -> dict:
        """Return counts and errors of the compression, to be stored as attributes of a file."""
        return {
            "bases": self.bases,
            "rank": self.rank,
            "delta_e": self.errors,
            "rmse": self.rmse,
            "budget_met": self.budget_met,
            "pixels": self.pixels,
            "masked_pixels": self.masked,
            "negative": self.negative,
        }

    def tiles(self, source) -> Iterator[np.ndarray]:
        """Yield the coefficients of a picture in stored form, tile by tile: the second pass over the picture."""
        tiles = source if isinstance(source, Tiles) else Tiles(source)
        yield from tiles.map(lambda rows, first, worker: self.encode(rows))

    def write(
        self,
        out: store.Writer,
        name: str,
        source,
        size: tuple[int, int],
        *,
        quantity: str,
        codec: str,
        decoded: np.ndarray | None = None,
    ) -> None:
        """Write a picture's coefficients, tile by tile, to a dataset (height, width, k).

        Parameters
        ----------
        out : store.Writer
        name : str
        source : Tiles, or what `Tiles` takes
            The picture that was analysed.
        size : (height, width)
        quantity, codec : str
        decoded : (height, width, k) float32, optional
            Filled with the coefficients after rounding to the stored precision.
        """
        height, width = size
        shape = (height, width, self.bases)
        scale = self.scale if self.storage == "half" else None
        dataset = reserve_coefficients(
            out, name, shape, quantity=quantity, storage=self.storage, codec=codec, scale=scale
        )
        row, rest = 0, np.empty((0, self.bases), dtype=dataset.dtype)
        for tile in self.tiles(source):
            rest = np.concatenate([rest, tile]) if len(rest) else tile
            rows = len(rest) // width
            whole = rest[: rows * width].reshape(rows, width, self.bases)
            dataset[row : row + rows] = whole
            if decoded is not None:
                decoded[row : row + rows] = self.decode(whole)
            row, rest = row + rows, rest[rows * width :]
        if row != height or len(rest):
            raise ValueError(f"a picture of {row * width + len(rest)} pixels; accepted: {height} rows of {width}")


def analyse(
    source,
    basis: np.ndarray | None,
    observers: dict,
    options: CompressOptions,
    *,
    bases: int | None = None,
) -> Compression:
    """Read a picture once and return its compression, with as few basis vectors as the colour tolerance allows.

    Parameters
    ----------
    source : Tiles, or what `Tiles` takes
        Pixels are spectra (61), or coefficients (r) on ``basis``; with coefficients, all matrices are of size r.
    basis : (61, r) float or None
        None if pixels are spectra.
    observers : dict
        light -> ((3, 61) matrix to XYZ, (3,) XYZ of white). Colours brighter than white are scaled down to its
        luminance before the comparison, because CIELAB is defined for surface colours.
    options : CompressOptions
    bases : int, optional
        Use this number of basis vectors, or the rank if that is less, whatever the target.

    Raises
    ------
    ValueError
        If no pixel is finite, or the pixels' bands are not those of the basis.
    """
    moments = second_moments(source)
    return choose(moments, basis, observers, options, bases=bases)


def choose(
    moments: Moments, basis: np.ndarray | None, observers: dict, options: CompressOptions, *, bases: int | None = None
) -> Compression:
    """Return the compression with the fewest basis vectors that meets the targets; see `analyse` for the arguments."""
    width = moments.root.shape[1]
    if width != (SAMPLES if basis is None else basis.shape[1]):
        expected = f"{SAMPLES} bands" if basis is None else f"{basis.shape[1]}, one for each vector of the basis"
        raise ValueError(f"pixels of {width} bands; accepted: {expected}")
    matrices = [matrix for matrix, _ in observers.values()] if options.weighting == "visual" else None
    found = decompose(moments.root, basis, matrices)
    spectra = moments.sample if basis is None else moments.sample @ np.asarray(basis, dtype=np.float64).T
    trial = _Trial(found, moments, spectra, observers, options)
    rank = found.rank
    counts = [*range(options.align, rank, options.align), rank] if bases is None else [max(1, min(bases, rank))]
    for count in counts:
        if count != counts[-1] and trial.cannot_reach_limits(count):
            continue
        made = trial.compression(count)
        if made.budget_met or count == counts[-1]:
            break
    if not (made.budget_met or bases is not None or rank == len(found.energies)):
        # In a picture with a very bright light, directions with no more energy than rounding may be visible colours.
        full = trial.compression(len(found.energies))
        made = full if full.budget_met else made
    return trial.finished(made)


class _Trial:
    """Trial of different numbers of basis vectors on one picture, by the colour errors of its sample."""

    def __init__(
        self, found: Decomposition, moments: Moments, spectra: np.ndarray, observers: dict, options: CompressOptions
    ) -> None:
        self._found, self._moments, self._spectra, self._options = found, moments, spectra, options
        self._observers = observers
        self._before = {light: spectra @ matrix.T for light, (matrix, _) in observers.items()}

    def cannot_reach_limits(self, count: int) -> bool:
        """Return whether ``count`` vectors exceed twice a limit on part of the sample, so that the rest is skipped."""
        errors = self._errors(self._made(count), slice(_FIRST_LOOK))
        mean, p99 = self._options.target_delta_e_mean, self._options.target_delta_e_p99
        return any(e["mean"] > 2 * mean or e["p99"] > 2 * p99 for e in errors.values())

    def compression(self, count: int) -> Compression:
        """Return the compression with ``count`` basis vectors and its colour errors."""
        made, options = self._made(count), self._options
        errors = self._errors(made, slice(None))
        mean, p99 = options.target_delta_e_mean, options.target_delta_e_p99
        met = all(e["mean_bound"] <= mean and e["p99_bound"] <= p99 for e in errors.values())
        return replace(made, errors=errors, budget_met=met)

    def finished(self, made: Compression) -> Compression:
        """Return a copy of a compression with its spectral error and its share of negative values filled in."""
        decoded = made.decode(made.encode(self._moments.sample)) @ made.basis.T
        rmse = float(np.sqrt(np.mean((self._spectra - decoded) ** 2)))
        return replace(made, rmse=rmse, negative=float((decoded < 0).mean()))

    def _made(self, count: int) -> Compression:
        moments, storage = self._moments, self._options.storage
        vectors, encoder = self._found.truncated(count)
        scale = np.ones(count, dtype=np.float32)
        if storage == "half":
            scale = half_scale(np.linalg.norm(encoder, axis=1) * moments.largest_norm)
        return Compression(vectors, encoder, scale, storage, {}, 0.0, False, self._found.rank, moments.pixels,
                           moments.masked, 0.0, moments.sample)  # fmt: skip

    def _errors(self, made: Compression, part: slice) -> dict:
        sample = self._moments.sample[part]
        before = {light: xyz[part] for light, xyz in self._before.items()}

        def of_piece(first: int) -> list[np.ndarray]:
            piece = slice(first, first + _PIECE)
            stored = made.decode(made.encode(sample[piece]))
            return [
                delta_e_of_light(before[light][piece], stored @ (matrix @ made.basis).T, white)
                for light, (matrix, white) in self._observers.items()
            ]

        # Pieces fit the processor's cache and are computed in parallel.
        with ThreadPoolExecutor(numba.get_num_threads()) as pool:
            pieces = list(pool.map(of_piece, range(0, len(sample), _PIECE)))
        errors = (np.concatenate(of_light) for of_light in zip(*pieces, strict=True))
        return {
            light: summary(values) | self._bounds(values) for light, values in zip(self._observers, errors, strict=True)
        }

    def _bounds(self, values: np.ndarray) -> dict[str, float]:
        """Return 99 % upper bounds for mean and 99th percentile over the whole picture, from errors of the sample."""
        moments, count = self._moments, len(values)
        deviations = _DEVIATIONS if len(moments.sample) < moments.pixels - moments.masked else 0.0
        share = min(0.99 + deviations * np.sqrt(0.99 * 0.01 / count), 1.0)
        mean = values.mean() + deviations * values.std() / np.sqrt(count)
        return {"mean_bound": float(mean), "p99_bound": float(np.percentile(values, 100 * share))}
