"""Similarity transform between two shots of one object, without and with a filter plate.

The plate shifts, rotates and scales the picture slightly but changes its colours strongly: an edge may weaken, vanish
or change its sign in a band. Therefore intensities are not compared. Instead, the gradients of the moving picture at
the transformed places are modelled as a linear colour map of the gradients of the fixed picture. For each trial
transform the colour map follows in closed form (variable projection: Golub, Pereyra, Inverse Problems 19, 2003), and
the residuals determine a Gauss-Newton step of the transform. Steps are taken in the frame of the fixed picture (inverse
composition: Baker, Matthews, Int. J. Computer Vision 56(3), 2004). So the derivatives come from one picture and the
noise of the residuals at the new places from the other, and noise does not bias the result towards half or whole
pixels.

* The colour map varies between cells of some dozen pixels, because edges between different paints do not follow the
  same matrix. In cells with little information it is drawn towards the map of the whole picture.
* It maps each band to the same band, unless the positions of the bands within a superpixel are given. Red, green and
  blue are sampled at different positions, successive bands half a mosaic pixel apart along each axis, so a map that
  mixed bands without knowing their positions would shift the result by some hundredths of a superpixel.
* Only the places with the largest gradients in each cell are compared; derivatives are those of a quintic B-spline
  (`irodori.ingest.registration.gradient_sums`).
* Residuals are weighted by their spread in each band, which increases with the gradient, and outliers (metamers,
  highlights, dust) by the square of Huber's weight.
* The initial shift comes from the masked normalised correlation of gradient magnitudes at a coarse level of a pyramid
  (Padfield, IEEE Trans. Image Processing 21(5), 2012); magnitudes do not depend on the sign of an edge.
* Because of aliasing, an edge exactly along rows or columns appears slightly displaced, depending on its position in
  the superpixel. If a few such edges are the only content (a plate of squares that is upright in the picture), the
  error is up to 0.03 superpixel, 0.05 without noise, and up to 0.09 on a sensor without an optical low-pass filter;
  ``sigma_px`` covers about half of it. A coarser level does not help, because the displacement scales with its pixels.
* Parameters that the content does not determine are constrained by weak priors, as wide as the effect of a plate
  (8 superpixels, 0.5 degrees, 1 %).
"""

import math
from dataclasses import dataclass

import numpy as np

from irodori.ingest.registration.gradient_sums import spline_power
from irodori.ingest.registration.pyramid import Pyramid
from irodori.ingest.registration.shifted_picture import marked_affine, resample_affine
from irodori.ingest.registration.similarity_fit import (
    Level,
    SimilarityFit,
    affine_of_level,
    align,
    information_of,
    make_level,
    search,
)

_COARSEST_PX = 160  # longest side of the level used for the search
_SHORTEST_PX = 24  # shortest side that a level may have
_FINEST_PIXELS = 800_000  # largest number of pixels of the finest level, unless the error requires a finer one
_PLACES = (30_000, 8_000, 4_000)  # places compared at the finest level, at other levels, and in the search
_GOOD_PX = 0.02  # predicted error with which no finer level is tried
_STEP, _LAST_STEP = 1e-2, 1e-3  # steps that end the iteration, pixels of the level; a fifth of a step remains as error
_UNDETERMINED_PX = 1.0
_SURE_COHERENCE = 0.25  # smallest coherence, and largest error, with which a fit from the start alone is accepted
_SURE_PX = 0.05
_NOISE_RATIO = 1.5  # smallest information, in its weakest direction, relative to that which noise alone simulates
_CLUSTERS = 6  # number of blocks along each side for the scatter between parts of the picture
_FLOOR_PX = 0.05  # blocks with a smaller error than this have equal weights in the residual
_LEAST_COHERENCE = 0.1


@dataclass(frozen=True)
class Registration:
    """Similarity transform from the fixed to the moving picture: p -> c + scale R(rotation) (p - c) + (dx, dy).

    Coordinates are superpixels, x right, y down, with integers at the centres of superpixels. A positive rotation turns
    x towards y.

    Parameters
    ----------
    dx_px, dy_px : float, superpixels
    rotation_rad : float, rad
    scale : float
    residual_px : float, superpixels
        RMS displacement of local blocks that the similarity does not explain, weighted by the information of each block
        and without noise. It is about 10 to 40 % too small, because it is estimated by a single linear step and corners
        contribute least. NaN if nothing could be measured.
    sigma_px : float, superpixels
        Predicted standard error of the alignment, RMS over the picture; infinite if the content does not determine it.
    centre_px : (2,) tuple of float, superpixels
        Centre c of the picture, x then y: ((W - 1) / 2, (H - 1) / 2).
    """

    dx_px: float
    dy_px: float
    rotation_rad: float
    scale: float
    residual_px: float
    sigma_px: float
    centre_px: tuple[float, float] = (0.0, 0.0)

    def affine(self, centre_px=None) -> np.ndarray:
        """Return the (2, 3) matrix moving_from_fixed, about ``centre_px`` if given, else about the picture's centre."""
        centre = complex(*(self.centre_px if centre_px is None else centre_px))
        return affine_of_level(*self.complex_parts(), centre, 1.0)

    def complex_parts(self) -> tuple[complex, complex]:
        """Return scale and rotation as one complex number, and the shift as another."""
        turn = complex(math.cos(self.rotation_rad), math.sin(self.rotation_rad))
        return self.scale * turn, complex(self.dx_px, self.dy_px)


def register(
    fixed, moving, fixed_valid, moving_valid, start: Registration | None = None, *, band_offsets_px=None
) -> Registration:
    """Estimate the similarity transform between two pictures of the same object with different colours.

    Parameters
    ----------
    fixed, moving : (H, W, 3) float32
        Responses without and with the filter, 1 = perfect diffuser.
    fixed_valid, moving_valid : (H, W) bool or uint8
        0 for saturated or hot samples. Non-finite samples count as invalid.
    start : Registration, optional
        Initial guess. If the fit that starts there is certain, the search (which reaches 12 superpixels) is skipped;
        otherwise the guess is tried in addition to the shifts from the search.
    band_offsets_px : (3, 2) float, optional
        Positions of the bands within a superpixel, see `bayer_offsets_px`; the colour map then mixes bands.

    Returns
    -------
    Registration
        If the pictures have nothing in common: the identity with an infinite ``sigma_px`` and a ``residual_px`` of NaN.
        If only ``sigma_px`` is infinite, the content does not determine the transform, which is held by a prior about
        the identity.

    Raises
    ------
    ValueError
        If the shapes differ, or the pictures do not have three bands.
    """
    shape = np.shape(fixed)[:2]
    if np.shape(fixed) != (*shape, 3) or np.shape(moving) != (*shape, 3):
        raise ValueError(f"pictures of shape {np.shape(fixed)} and {np.shape(moving)}; accepted: two of (H, W, 3)")
    if np.shape(fixed_valid) != shape or np.shape(moving_valid) != shape:
        raise ValueError(f"masks of shape {np.shape(fixed_valid)} and {np.shape(moving_valid)}; accepted: {shape}")
    nothing = Registration(0.0, 0.0, 0.0, 1.0, math.nan, math.inf, ((shape[1] - 1) / 2.0, (shape[0] - 1) / 2.0))
    if min(shape) < _SHORTEST_PX // 2:
        return nothing
    pair = _Pair(Pyramid(fixed, fixed_valid), Pyramid(moving, moving_valid), shape, band_offsets_px)
    if start is not None:
        # Start at the coarsest level, where periodic textures that would allow a wrong period are averaged out.
        found, coherence = pair.from_start(start, nothing)
        if coherence >= _SURE_COHERENCE and found.sigma_px <= _SURE_PX:
            return found
    fit = pair.first(start)
    return nothing if fit is None else pair.descend(pair.coarsest, fit.turn, fit.shift, nothing)[0]


@dataclass(frozen=True)
class _Pair:
    """Pyramids of the two pictures to register."""

    fixed: Pyramid
    moving: Pyramid
    shape: tuple[int, int]
    band_offsets_px: np.ndarray | None

    @property
    def coarsest(self) -> int:
        """Level of the search."""
        level = math.ceil(math.log2(max(max(self.shape) / _COARSEST_PX, 1.0)))
        return min(level, int(math.log2(max(min(self.shape) / _SHORTEST_PX, 1.0))))

    @property
    def finest(self) -> int:
        """Finest level that is used, unless the error requires a finer one."""
        pixels = self.shape[0] * self.shape[1]
        return min(self.coarsest, math.ceil(math.log(max(pixels / _FINEST_PIXELS, 1.0), 4.0)))

    def level(self, n: int, places: int, local: bool) -> Level:
        scale = float(2**n)
        return make_level(
            self.fixed[n],
            self.moving[n],
            scale,
            shape=self.shape,
            count=places,
            offsets_px=self.band_offsets_px,
            local=local,
        )

    def first(self, start: Registration | None) -> SimilarityFit | None:
        """Return the most coherent of the fits at the coarsest level from all starting points."""
        n = self.coarsest
        shifts, level = search(self.fixed[n], self.moving[n], float(2**n)), self.level(n, _PLACES[2], False)
        starts = [(complex(1.0), d) for d in shifts] + ([] if start is None else [start.complex_parts()])
        fits = [_settled(level, turn, shift) for turn, shift in starts]
        return max((fit for fit in fits if fit is not None), key=lambda fit: fit.coherence, default=None)

    def from_start(self, start: Registration, nothing: Registration) -> tuple[Registration, float]:
        """Register from ``start`` at the coarsest level; return the registration and its coherence."""
        fit = _settled(self.level(self.coarsest, _PLACES[2], False), *start.complex_parts())
        return (nothing, 0.0) if fit is None else self.descend(self.coarsest, fit.turn, fit.shift, nothing)

    def descend(self, top: int, turn: complex, shift: complex, nothing: Registration) -> tuple[Registration, float]:
        """Refine from level ``top`` to finer levels; return the best registration, and the coherence of its fit."""
        best, coherence = nothing, 0.0
        for n in range(top, -1, -1):
            if n < self.finest and best.sigma_px <= _GOOD_PX:
                break
            level = self.level(n, _PLACES[0 if n <= self.finest else 1], True)
            last = n <= self.finest
            fit = align(level, turn, shift, 8 if last else 3, _LAST_STEP if last else _STEP)
            if fit is None:
                break
            turn, shift = fit.turn, fit.shift
            if n <= self.finest and _has_content(fit):
                found = _report(level, fit)
                if found.sigma_px <= best.sigma_px:
                    best, coherence = found, fit.coherence
        return best, coherence


def _settled(level: Level, turn: complex, shift: complex) -> SimilarityFit | None:
    """Fit at the coarsest level from one starting point: first the shift alone, then all parameters."""
    fit = align(level, turn, shift, 3, _STEP, (0, 1))
    return fit and align(level, fit.turn, fit.shift, 5, _STEP)


def _has_content(fit: SimilarityFit) -> bool:
    return fit.coherence > _LEAST_COHERENCE + 4.0 / math.sqrt(fit.places)


def _report(level: Level, fit: SimilarityFit) -> Registration:
    return Registration(
        dx_px=fit.shift.real,
        dy_px=fit.shift.imag,
        rotation_rad=math.atan2(fit.turn.imag, fit.turn.real),
        scale=abs(fit.turn),
        residual_px=_residual_px(level, fit),
        sigma_px=_sigma_px(level, fit),
        centre_px=(float(level.places.geometry[1]), float(level.places.geometry[2])),
    )


def _noise_information(level: Level, fit: SimilarityFit) -> np.ndarray:
    """Return the Fisher information that noise alone would simulate with these weights, (4, 4).

    The variances of curvatures and gradients due to white noise follow from the kernel of the derivatives.
    """
    value, first, second = spline_power()
    share = fit.noise_share * (second / first + first / value) / level.scale**2
    scale, cx, cy, reach = level.places.geometry
    u, v = (((level.places.xy + 0.5) * scale - 0.5 - (cx, cy)) / reach).transpose(2, 0, 1)
    w = fit.weight.astype(np.float64)
    n, nu, nv, nr = w.sum(), (w * u).sum(), (w * v).sum(), (w * (u * u + v * v)).sum()
    return share * np.array([[n, 0, nu, -nv], [0, n, nv, nu], [nu, nv, nr, 0], [-nv, nu, 0, nr]])


def _sigma_px(level: Level, fit: SimilarityFit) -> float:
    """Return the predicted RMS error over the picture: the larger of model error and scatter between its parts."""
    information, noise = information_of(fit.sums), _noise_information(level, fit)
    root = np.linalg.cholesky(noise + 1e-12 * np.trace(noise) * np.eye(4))
    white = np.linalg.solve(root, np.linalg.solve(root, information).T)
    if np.linalg.eigvalsh(white)[0] < _NOISE_RATIO:
        return math.inf
    covariance = np.linalg.inv(information - noise)
    if np.linalg.eigvalsh(covariance)[-1] > _UNDETERMINED_PX**2:
        return math.inf
    # Errors of neighbouring cells are correlated if the same edge runs through both, so scores are summed over parts
    # before they are squared (the cluster-robust covariance: Liang, Zeger, Biometrika 73(1), 1986). Parts are blocks,
    # and strips along rows and columns, because all samples of an axis-parallel edge have the same aliasing error.
    row, column = np.divmod(np.arange(level.places.counts.size), level.columns)
    rows = level.places.counts.size // level.columns
    block = row * _CLUSTERS // rows * _CLUSTERS + column * _CLUSTERS // level.columns
    spreads = [_spread(covariance, fit.sums[:, :4], part) for part in (block, row, column // 2)]
    return math.sqrt(max(np.trace(covariance), *spreads))


def _spread(covariance, cell_scores, part) -> float:
    """Return the trace of the covariance implied by the scatter of the scores between parts of the picture."""
    scores = np.zeros((int(part.max()) + 1, 4))
    np.add.at(scores, part, cell_scores)
    parts = int(np.count_nonzero(np.abs(scores).sum(axis=1)))
    moved = scores @ covariance
    return float((moved**2).sum()) * parts / max(parts - 4, 1)


def _residual_px(level: Level, fit: SimilarityFit) -> float:
    """Estimate the RMS displacement of local blocks that the transform does not explain.

    The displacements of the two halves of a block are multiplied: a deformation is the same in both, but noise is
    independent, so its variance does not enter. The displacement of a half is information⁻¹ score; damping prevents a
    few strong blocks from dominating.
    """
    xx, xy, yy = fit.sums[:, 20:23].T
    information = np.stack([xx, xy, xy, yy], axis=-1).reshape(-1, 2, 2)
    damping = np.linalg.inv(np.eye(2) + _FLOOR_PX**2 * information)
    weight, found = damping @ information, (damping @ fit.sums[:, :2, None])[..., 0]
    bottom = (weight[0::2] * weight[1::2]).sum()
    return math.sqrt(max(0.0, 2.0 * (found[0::2] * found[1::2]).sum() / bottom)) if bottom > 0.0 else math.nan


def resample(image, valid, registration: Registration, out=None) -> tuple[np.ndarray, np.ndarray]:
    """Resample the moving picture to the grid of the fixed one.

    Parameters
    ----------
    image : (H, W, 3) float32
    valid : (H, W) bool or uint8
    registration : Registration
        Applied about the centre of this picture.
    out : (H, W, 3) float32, optional
        Array for the result, which must not overlap ``image``.

    Returns
    -------
    image : (H, W, 3) float32
        0 where invalid.
    valid : (H, W) bool

    Notes
    -----
    Keys' cubic with a = -1/2 (IEEE Trans. Acoustics, Speech, Signal Processing 29(6), 1981), the one of its family
    exact for parabolas. Half-way between two pixels its gain is 0.997 at 0.1, 0.949 at 0.2, 0.780 at 0.3, 0.449 at
    0.4 and 0 at 0.5 cycles per superpixel (`irodori.ingest.registration.shifted_picture`); a step overshoots by at most
    7 % of its height. A sample with an invalid pixel among its 16 is bilinear of 4, and invalid where one of these is.
    """
    image, valid = np.asarray(image, dtype=np.float32), np.ascontiguousarray(valid, dtype=bool)
    height, width = valid.shape
    if image.shape != (height, width, 3) or min(height, width) < 2:
        raise ValueError(
            f"picture {image.shape} with mask {valid.shape}; accepted: (H, W, 3) and (H, W), 2 x 2 or more"
        )
    return resample_affine(image, valid, registration.affine(((width - 1) / 2.0, (height - 1) / 2.0)), out)


def meets_marked(mask, valid, registration: Registration) -> np.ndarray:
    """Return the pixels of a resampled picture that are invalid and lie near a marked sample of the original.

    Parameters
    ----------
    mask : (H, W) bool
        Marked samples of the picture before resampling.
    valid : (H, W) bool
        Valid pixels of the resampled picture, from `resample`.
    registration : Registration

    Returns
    -------
    (H, W) bool
        Near means within two samples of the nearest one along rows and columns, which is the reach of the cubic
        interpolation, with rounding.
    """
    height, width = np.shape(mask)
    affine = registration.affine(((width - 1) / 2.0, (height - 1) / 2.0))
    return marked_affine(np.ascontiguousarray(mask, dtype=bool), np.ascontiguousarray(valid, dtype=bool), affine)
