"""Estimation of spectra of light from responses of a camera: posterior mean and covariance for a mixture prior.

The camera was calibrated on a chart under one lamp. Its response to a light L(λ) is Σ R_b L dλ; R_b and its uncertainty
are given by the response model of the calibration. For each family of the prior (`irodori.light.light_prior`) the
second moment is known. For light of unknown brightness from a family, the responses ρ have the angular central Gaussian
density |S|^(-1/2) (ρᵀ S⁻¹ ρ)^(-bands/2) [Tyler 1987], where S is the second moment of the responses, and the light with
the least expected squared error is linear in the responses. This density also gives the probabilities of the families
in each direction. Since a room has few kinds of lamps, the prior probabilities of families are re-estimated from all
directions by expectation maximisation.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np

from irodori.calibration.recovery.calibration_file import Calibration
from irodori.calibration.sensitivity_prior import with_least_power
from irodori.core.errors import InputError
from irodori.light.environment_file import PixelNoise, merged_variance
from irodori.light.light_prior import CommonErrors, LightPrior, differences_from, prior_of_any_lamp, seen_moment
from irodori.light.recovery_loops import mixture_weights
from irodori.spectra.grid import SAMPLES

#: Factor on the variance of the response model in densities. Its errors are common to all directions, but the densities
#: are multiplied as if they were independent. Chosen in simulated rooms with lamps of the CIE.
_COMMON = 1.5
_LEAST_NOISE = 3e-4  # smallest relative noise of a response that is assumed
#: Weight of each further distinct colour of the room, in observations, against one prior observation per family: for
#: recovery, and for the comparison of two priors. The second was chosen in simulated rooms with lamps of IES TM-30 that
#: resemble none of the CIE.
_EVIDENCE, _COMPARISON = 300.0, 150.0
#: Distance of colours that are distinct, and steps of the iteration. Repeated views of one colour share their errors.
_ALIKE, _STEPS = 0.1, 30
_FAMILIES = 16  # largest number of families kept for a picture
_BASES = 6  # largest number of basis vectors of the light
_UNSEEN = 1e-3  # weight of what no colour shows of a light, relative to the mean weight, in the choice of the basis
_DRAWS = 64  # directions drawn from each part of a picture
_COMPARED = 1000  # approximate number of directions that are compared in colour
#: Least share of the largest variance of errors that are kept. It is small because colours depend on errors that the
#: responses leave small, beside large ones that neither camera nor eye sees.
_LEAST_VARIANCE = 1e-10


@dataclass(frozen=True)
class ResponseModel:
    """Response of a camera per unit radiance, and its uncertainty.

    Parameters
    ----------
    mean : (bands, 61) float64
    covariance : (bands, 61, bands, 61) float64
    errors : (k, bands, 61) float64, optional
        Independent errors, each for one standard deviation, that make up the covariance; by default its principal
        components.
    rig_lamp_errors : (m, 61) float64, optional
        Independent relative errors, each for one standard deviation, of the light under which the camera was
        calibrated; by default none. All bands and all recovered light have them in common. They are part of the stated
        errors alone: with them in the covariance, lights were recovered no better.
    """

    mean: np.ndarray
    covariance: np.ndarray
    errors: np.ndarray = None  # type: ignore[assignment]  # set below
    rig_lamp_errors: np.ndarray = field(default_factory=lambda: np.zeros((0, SAMPLES)))

    def __post_init__(self) -> None:
        if self.errors is None:
            flat = self.covariance.reshape(self.mean.size, -1)
            object.__setattr__(self, "errors", principal_errors(flat).reshape(-1, *self.mean.shape))

    @classmethod
    def of(cls, calibration: Calibration, path="") -> "ResponseModel":
        """Return the response model of a calibration.

        Raises
        ------
        InputError
            If the calibration contains no response model or no covariance of it; the message names ``path``.
        """
        model, covariance = calibration.band_response, calibration.band_response_covariance
        if model is None or covariance is None:
            lacking = "band_response" if model is None else "band_response_covariance"
            raise InputError(path, lacking, "no such dataset", "a calibration that this version wrote")
        light = with_least_power(calibration.light)
        of_lamp = principal_errors(differences_from(light, calibration.light_error))
        return cls(model / light, covariance / (light[:, None, None] * light), rig_lamp_errors=of_lamp)

    def through(self, passed: np.ndarray) -> "ResponseModel":
        """Return the response per unit radiance before a mirror that reflects a share of it, (61,)."""
        both = passed[:, None, None] * passed
        return replace(self, mean=self.mean * passed, covariance=self.covariance * both, errors=self.errors * passed)


def principal_errors(covariance: np.ndarray) -> np.ndarray:
    """Return the principal components of a covariance, (n, n), each for one standard deviation, (k, n)."""
    values, vectors = np.linalg.eigh(covariance)
    kept = values > _LEAST_VARIANCE * values[-1]
    return (vectors[:, kept] * np.sqrt(values[kept])).T


@dataclass(frozen=True)
class Directions:
    """Responses in some directions of a picture, each representing a share of its light.

    Parameters
    ----------
    response : (n, bands) float64
    share : (n,) float64, sum 1
    lit : bool
        False for a black picture, which is represented by one direction of arbitrary colour.
    """

    response: np.ndarray
    share: np.ndarray
    lit: bool = True

    def before(self, mirror: np.ndarray, model: ResponseModel, prior: LightPrior) -> "Directions":
        """Return the directions, seen in a mirror of a reflectance, (61,), as the camera would see them without it."""
        recovery = LightRecovery.of_room(model.through(mirror), self, prior)
        light = recovery.weights(self.response).astype(np.float64) @ recovery.basis.T
        return replace(self, response=light @ model.mean.T)

    def different(self) -> float:
        """Return the effective number of directions with distinct colours; 1 if all have the same colour."""
        some = slice(None, None, -(-len(self.share) // _COMPARED))
        scaled = self.response[some] / np.abs(self.response[some]).mean(axis=0)
        colour = scaled / np.linalg.norm(scaled, axis=1, keepdims=True)
        share = self.share[some] / self.share[some].sum()
        return float(1.0 / (share @ np.exp((colour @ colour.T - 1.0) / _ALIKE**2) @ share))


def draw_directions(parts: Iterable[tuple[np.ndarray, np.ndarray | float]]) -> Directions:
    """Draw directions from each part of a picture, with probabilities proportional to their light.

    Parameters
    ----------
    parts : iterable of ((n, bands) float, (n,) float or one number for all)
        Responses and solid angles; pixels that are not finite are never drawn.
    """
    rng, responses, shares = np.random.default_rng(0), [], []
    for response, solid_angle in parts:
        bands = response.shape[-1]
        power = np.maximum(response @ np.ones(bands, response.dtype), 0.0) * solid_angle
        total = np.cumsum(np.where(np.isfinite(power), power, 0.0))
        if total[-1] > 0.0:
            chosen = np.searchsorted(total, rng.uniform(0.0, total[-1], _DRAWS), side="right")
            responses.append(response[chosen].astype(np.float64))
            shares.append(np.full(_DRAWS, total[-1] / _DRAWS))
    if not responses:  # black: any light will do
        return Directions(np.ones((1, bands)), np.ones(1), lit=False)
    share = np.concatenate(shares)
    return Directions(np.concatenate(responses), share / share.sum())


@dataclass(frozen=True)
class _Families:
    """Families of the prior, in terms of the responses of a camera.

    Parameters
    ----------
    share : (n,) float64
    factor : (n, bands, bands) float64
        Inverse of the Cholesky factor of the second moment of the responses, by which families are weighed.
    precision : (n, bands, bands) float64
        Inverse of the second moment of the responses.
    light_from_response : (n, 61, bands) float64
    """

    share: np.ndarray
    factor: np.ndarray
    precision: np.ndarray
    light_from_response: np.ndarray

    @classmethod
    def seen(cls, prior: LightPrior, model: ResponseModel) -> "_Families":
        """Compute the families of a prior for a camera.

        Light and response model are linearised about their means: the covariance of a lamp with the response model adds
        to the second moments.
        """
        moment, bands = prior.moment, len(model.mean)
        cross = model.mean @ moment
        second = cross @ model.mean.T
        if prior.common is not None:
            joint, own = _joint_moment(prior.common, model), slice(prior.common.weight.shape[1])
            cross[own] += joint
            both = joint @ model.mean.T
            second[own] += both + both.swapaxes(1, 2)
        second[:, np.arange(bands), np.arange(bands)] *= 1.0 + _LEAST_NOISE**2
        pairs = model.covariance.swapaxes(1, 2).reshape(bands * bands, -1)
        noise = (moment.reshape(len(moment), -1) @ pairs.T).reshape(second.shape)
        factor = np.linalg.inv(np.linalg.cholesky(second + _COMMON * noise))
        gain = np.linalg.solve(second + noise, cross).swapaxes(1, 2)
        return cls(prior.share, factor, np.linalg.inv(second + noise), gain)

    def chosen(self, index: np.ndarray, share: np.ndarray) -> "_Families":
        """Return a selection of the families, with new shares."""
        of_index = (getattr(self, name)[index] for name in ("factor", "precision", "light_from_response"))
        return _Families(share[index] / share[index].sum(), *of_index)

    def errors(self, index: np.ndarray, prior: LightPrior, model: ResponseModel) -> tuple[np.ndarray, np.ndarray]:
        """Compute the errors of the light of families with the given indices in the prior.

        Returns
        -------
        open : (n, 61, 61) float64
            Covariance of the light given the responses and the response model, per squared scale of the light.
        common : (n, k, 61, bands) float64
            Error of the light, as a function of the responses, due to each of the errors that all directions have in
            common: those of the response model, and of lamps that were estimated together with it.
        """
        gain, fixed = self.light_from_response, prior.moment[index]
        missed = np.eye(gain.shape[1]) - gain @ model.mean
        common = -np.einsum("nib,kbj,njc->nkic", gain, model.errors, gain, optimize=True)
        if prior.common is not None:
            lamps = prior.common
            own = index < lamps.weight.shape[1]
            weight, estimated = lamps.weight[:, index[own]], model.mean.T @ self.precision[own]
            fixed[own] = np.einsum("tfl,li,lj,tij->fij", weight, lamps.mean, lamps.mean, lamps.factor, optimize=True)
            surface = np.einsum("tij,lj,fjb->tlfib", lamps.factor, lamps.mean, estimated, optimize=True)
            of_lamps = np.einsum("tfl,lki,tlfib->fkib", weight, lamps.errors, surface, optimize=True)
            common[own] += missed[own][:, None] @ of_lamps
        return missed @ fixed @ missed.swapaxes(1, 2), common

    def weight(self) -> np.ndarray:
        """Return the shares divided by the square roots of the determinants, relative to the largest, (n,)."""
        logarithm = np.log(self.share) + np.log(np.einsum("nbb->nb", self.factor)).sum(axis=1)
        return np.exp(logarithm - logarithm.max())

    def squares(self, response: np.ndarray) -> np.ndarray:
        """Return ρᵀ S⁻¹ ρ, (m, n), for responses, (m, bands)."""
        turned = np.einsum("nij,mj->mni", self.factor, response, optimize=True)
        return np.maximum(np.einsum("mni,mni->mn", turned, turned), np.finfo(float).tiny)

    def log_likelihoods(self, response: np.ndarray) -> np.ndarray:
        """Return the log density of responses, (m, bands), in every family, up to a constant, (m, n)."""
        logarithm = np.log(np.einsum("nbb->nb", self.factor)).sum(axis=1)
        return logarithm - 0.5 * response.shape[1] * np.log(self.squares(response))

    def likelihoods(self, response: np.ndarray) -> np.ndarray:
        """Return densities, (m, n), of responses, (m, bands), in all families, relative to the largest of each."""
        logarithm = self.log_likelihoods(response)
        return np.exp(logarithm - logarithm.max(axis=1, keepdims=True))

    def shares(self, response: np.ndarray) -> np.ndarray:
        """Return the posterior shares of the families, (m, n), given responses, (m, bands)."""
        return _parted(self.share, self.likelihoods(response))

    def room_shares(self, directions: Directions, weight: float) -> tuple[np.ndarray, np.ndarray]:
        """Estimate the shares of the families in a room by expectation maximisation.

        Parameters
        ----------
        directions : Directions
        weight : float
            Weight of each further distinct colour, in observations.

        Returns
        -------
        shares : (n,) float64
            Shares, with the prior shares included as observations.
        seen : (n,) float64
            Mean posterior shares over directions, from the last step.
        """
        shares, count = self.share, len(self.share)
        evidence = weight * (directions.different() - 1.0)
        likelihoods = self.likelihoods(directions.response)
        for _ in range(_STEPS):
            seen = directions.share @ _parted(shares, likelihoods)
            shares = (count * self.share + evidence * seen) / (count + evidence)
        return shares, seen

    def of_room(self, directions: Directions, broad: int) -> tuple[np.ndarray, np.ndarray]:
        """Select the families that explain most of a room, and the ``broad`` ones that comprise any light.

        Returns
        -------
        index : (chosen,) int
        shares : (n,) float64
            Shares of all families in the room.
        """
        (shares, seen), count = self.room_shares(directions, _EVIDENCE), len(self.share)
        # The broad families are kept for directions lit by a lamp that is seen nowhere else.
        last = np.arange(count - broad, count)
        most = np.argsort(-seen[: last[0]], kind="stable")[: _FAMILIES - broad]
        return np.concatenate([most, last]), shares


def _joint_moment(lamps: CommonErrors, model: ResponseModel) -> np.ndarray:
    """Return the part of the moment of light and response that their common errors make up, (families, bands, 61)."""
    covariance = np.einsum("lki,kbj->lbij", lamps.errors, model.errors, optimize=True)
    of_same = np.einsum("lbjj->lbj", covariance)
    product = lamps.mean[:, None, :, None] * of_same[:, :, None] + lamps.mean[:, None, None] * covariance
    return np.einsum("tfl,tij,lbij->fbi", lamps.weight, lamps.factor, product, optimize=True)


def evidence(prior: LightPrior, model: ResponseModel, directions: Directions) -> float:
    """Return the log density of a room under a prior with shares estimated in the room, up to a constant.

    The number of directions counted is that of distinct colours. The constant is the same for all priors with one
    camera and room, so that differences can be used for comparison.
    """
    families = _Families.seen(prior, model)
    shares, _ = families.room_shares(directions, _COMPARISON)
    density = np.logaddexp.reduce(families.log_likelihoods(directions.response) + np.log(shares), axis=1)
    return float(directions.different() * (directions.share @ density))


def _basis_for_colours(lights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the basis that loses least of the colours of surfaces under some lights, (n, 61).

    Returns
    -------
    basis : (61, r) float64, orthonormal columns
    weights_from_light : (r, 61) float64
        The weights of a light are those whose colours on surfaces are closest to its own.
    """
    values, axes = np.linalg.eigh(seen_moment())
    root = np.sqrt(values + _UNSEEN * values.mean())
    kept = np.linalg.svd(lights @ (axes * root), full_matrices=False)[2][:_BASES]
    basis, triangle = np.linalg.qr(axes @ (kept / root).T)
    return basis, triangle @ (kept * root) @ axes.T


def _parted(shares: np.ndarray, likelihoods: np.ndarray) -> np.ndarray:
    """Return the posterior shares of families, (m, n), from prior shares, (n,), and likelihoods, (m, n)."""
    found = shares * likelihoods
    return found / found.sum(axis=1, keepdims=True)


@dataclass(frozen=True)
class LightRecovery:
    """Mapping from responses of a picture to spectra of its light, with errors.

    Parameters
    ----------
    basis : (61, r) float64, orthonormal columns
        L(λ) = basis @ weights.
    errors : (q, 61, r) float64
        Independent errors of the basis. Their sum, each multiplied by a standard normal number, is a random error that
        the responses allow. It is an error of the basis because the error of the spectrum of a lamp is the same
        wherever its light falls.
    weight, factor, maps : see `irodori.light.recovery_loops.mixture_weights`
    """

    basis: np.ndarray
    errors: np.ndarray
    weight: np.ndarray
    factor: np.ndarray
    maps: np.ndarray

    @classmethod
    def of_room(cls, model: ResponseModel, directions: Directions, prior: LightPrior | None = None) -> "LightRecovery":
        """Determine the mapping for a room.

        Parameters
        ----------
        model : ResponseModel
            Response model of the camera.
        directions : Directions
            Directions of the room.
        prior : LightPrior, optional
            By default that of `prior_of_any_lamp`.
        """
        prior = prior_of_any_lamp() if prior is None else prior
        known = _Families.seen(prior, model)
        index, shares = known.of_room(directions, prior.broad)
        families = known.chosen(index, shares)
        return cls._solved(families, families.errors(index, prior, model), model.rig_lamp_errors, directions)

    @classmethod
    def _solved(cls, families: _Families, errors, rig_lamp_errors, directions: Directions) -> "LightRecovery":
        """Determine the mapping from families, their errors as `_Families.errors` returns them, and the rig lamp's."""
        left_open, common = errors
        response, shares = directions.response, families.shares(directions.response)
        by_family = np.einsum("nlb,mb->mnl", families.light_from_response, response, optimize=True)
        mean = np.einsum("mn,mnl->ml", shares, by_family)
        # Directions are weighted by their shares of the light, independent of the magnitude of their responses.
        relative = np.sqrt(directions.share) / np.linalg.norm(response, axis=1)
        basis, weights_from_light = _basis_for_colours(relative[:, None] * mean)
        maps = weights_from_light @ families.light_from_response
        # Covariance within families, differences of their means from the total mean, and errors in common, as functions
        # of the weights.
        weights = relative[:, None] * (mean @ weights_from_light.T)

        def of_weights(values: np.ndarray) -> np.ndarray:
            """Return values of all directions, (directions, ...), as linear functions of the weights, (..., r)."""
            scaled = relative[:, None] * values.reshape(len(values), -1)
            return np.linalg.lstsq(weights, scaled, rcond=None)[0].T.reshape(*values.shape[1:], -1)

        of_scale = of_weights(np.sqrt(shares * families.squares(response) / response.shape[1]))
        of_apart = of_weights(np.sqrt(shares)[:, :, None] * (by_family - mean[:, None]))
        of_common = np.einsum("nkib,nbr->kir", common, of_weights(shares[..., None] * response[:, None]), optimize=True)
        spread, axes = np.linalg.eigh(left_open)
        roots = (axes * np.sqrt(np.maximum(spread, 0.0))[:, None]).swapaxes(1, 2)
        errors = np.concatenate(
            [
                (roots[:, :, :, None] * of_scale[:, None, None]).reshape(-1, *basis.shape),
                of_apart.reshape(-1, *basis.shape),
                of_common,
                rig_lamp_errors[:, :, None] * basis,
            ]
        )
        flat = errors.reshape(len(errors), -1)
        errors = principal_errors(flat.T @ flat).reshape(-1, *basis.shape)
        return cls(basis, errors, families.weight(), families.factor, maps)

    def weights(self, response: np.ndarray) -> np.ndarray:
        """Compute weights on the basis, (..., r) float32, from responses, (..., bands); NaN where not finite."""
        flat = np.ascontiguousarray(response.reshape(-1, response.shape[-1]), dtype=np.float32)
        out = np.empty((len(flat), self.maps.shape[1]), dtype=np.float32)
        mixture_weights(flat, self.weight, self.factor, self.maps, out)
        return out.reshape(*response.shape[:-1], -1)

    def noise(self, exposure_noise: np.ndarray, exposure_limit: np.ndarray, directions: Directions) -> PixelNoise:
        """Compute what the camera's noise changes of the light.

        Parameters
        ----------
        exposure_noise, exposure_limit : see `irodori.light.environment_file.merged_variance`
        directions : Directions
            Directions of the room.
        """
        response, share = directions.response, directions.share
        # The recovery is not linear: its slope is taken over the step of the noise, not at a point.
        deviation = np.sqrt(merged_variance(exposure_noise, exposure_limit, response))
        slope = np.zeros((response.shape[1], self.maps.shape[1]))
        for band, step in enumerate(deviation.T):
            moved = np.zeros_like(response)
            moved[:, band] = step
            change = self.weights(response + moved).astype(np.float64) - self.weights(response - moved)
            slope[band] = (share / (2.0 * step)) @ change
        seen = np.linalg.lstsq(self.weights(response).astype(np.float64), response, rcond=None)[0]
        return PixelNoise(exposure_noise, exposure_limit, seen.T @ self.basis.T, slope @ self.basis.T)
