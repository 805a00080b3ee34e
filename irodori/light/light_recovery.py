"""Recovery of light from a camera's responses: the posterior mean under a mixture, and what it leaves open.

A camera that was calibrated on a chart under one lamp answers to a light L(λ) with Σ R_b L dλ, where the calibration's
response model tells R_b and how well it knows it. Of each family of the prior (`irodori.light.light_prior`) the second
moment is known. A light of unknown brightness from it makes responses of the angular central Gaussian density
|S|^(-1/2) (ρᵀ S⁻¹ ρ)^(-bands/2) [Tyler 1987], with S the second moment of its responses, and the light of least
expected squared error is linear in them. Families share a direction by that density. A room has few kinds of lamps:
the families' own shares follow from all directions by expectation and maximisation.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from irodori.calibration.recovery.calibration_file import Calibration
from irodori.core.errors import InputError
from irodori.light.light_prior import LightPrior, prior_of_any_lamp
from irodori.light.recovery_loops import mixture_weights

#: So many times the variance of the response model counts: its errors are common to all directions, whose densities are
#: multiplied as if each had its own. Chosen on lamps of the CIE in made-up rooms.
_COMMON = 1.5
_LEAST_NOISE = 3e-4  # of a response, relative, whatever the response model says
#: So many observations, beside one of every family, each direction counts as that differs from the first by `_ALIKE`:
#: all share the errors of the response model, and what a room shows a million times tells little more than once.
_EVIDENCE, _ALIKE, _STEPS = 300.0, 0.1, 30
_FAMILIES = 16  # that are kept for a picture at most
_BASES = 8  # of the light at most: one row of vectors
_DRAWS = 64  # directions drawn from each part of a picture
_COMPARED = 1000  # of them that are compared in colour
_ERRORS = 24  # independent errors that are kept at most


@dataclass(frozen=True)
class ResponseModel:
    """Response of a camera per unit radiance, and its uncertainty.

    Parameters
    ----------
    mean : (bands, 61) float64
    covariance : (bands, 61, 61) float64
    """

    mean: np.ndarray
    covariance: np.ndarray

    @classmethod
    def of(cls, calibration: Calibration, path="") -> "ResponseModel":
        """Return the response model of a calibration.

        Raises
        ------
        InputError
            If the calibration states none or not how well it knows it; it names the calibration's path.
        """
        model, covariance = calibration.band_response, calibration.band_response_covariance
        if model is None or covariance is None:
            lacking = "band_response" if model is None else "band_response_covariance"
            raise InputError(path, lacking, "no such dataset", "a calibration that this version wrote")
        light = calibration.light
        return cls(model / light, covariance / (light[:, None] * light))

    def given(self, light: np.ndarray, response: np.ndarray, noise: np.ndarray) -> "ResponseModel":
        """Return the model as answers to known light leave it.

        Parameters
        ----------
        light : (n, 61) float64
        response : (n, bands) float64
        noise : (bands, n, n) float64
            Covariance of the answers, what is unknown of the light included.
        """
        cross = light @ self.covariance
        gain = np.linalg.solve(cross @ light.T + noise, cross).swapaxes(1, 2)
        missed = response.T - self.mean @ light.T
        mean = self.mean + np.einsum("bln,bn->bl", gain, missed)
        return ResponseModel(mean, self.covariance - gain @ cross)


@dataclass(frozen=True)
class Directions:
    """Responses in some directions of a picture, and what share of its light each stands for.

    Parameters
    ----------
    response : (n, bands) float64
    share : (n,) float64, sum 1
    lit : bool
        False of a black picture, whose one direction could be of any colour.
    """

    response: np.ndarray
    share: np.ndarray
    lit: bool = True

    def different(self) -> float:
        """Return how many directions differ in colour; one where all are alike."""
        some = slice(None, None, -(-len(self.share) // _COMPARED))
        scaled = self.response[some] / np.abs(self.response[some]).mean(axis=0)
        colour = scaled / np.linalg.norm(scaled, axis=1, keepdims=True)
        share = self.share[some] / self.share[some].sum()
        return float(1.0 / (share @ np.exp((colour @ colour.T - 1.0) / _ALIKE**2) @ share))


def draw_directions(parts: Iterable[tuple[np.ndarray, np.ndarray | float]], seed: int = 0) -> Directions:
    """Return directions drawn from every part of a picture in proportion to their light.

    Parameters
    ----------
    parts : iterable of ((n, bands) float, (n,) float or one number for all)
        Responses and solid angles; what is not finite is never drawn.
    seed : int
    """
    rng, responses, shares = np.random.default_rng(seed), [], []
    for response, solid_angle in parts:
        bands = response.shape[-1]
        power = np.maximum(response.sum(axis=-1, dtype=np.float64), 0.0) * solid_angle
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
    """Families of the prior as a camera sees them.

    Parameters
    ----------
    share : (n,) float64
    factor : (n, bands, bands) float64
        Inverse of the Cholesky factor of the responses' second moment.
    light_from_response : (n, 61, bands) float64
    open : (n, 61, 61) float64
        Covariance that the responses leave, per squared scale of the light.
    """

    share: np.ndarray
    factor: np.ndarray
    light_from_response: np.ndarray
    open: np.ndarray

    @classmethod
    def seen(cls, prior: LightPrior, model: ResponseModel) -> "_Families":
        """Return the families of a prior as a camera sees them."""
        cross = model.mean @ prior.moment
        moment = cross @ model.mean.T
        of_band = np.arange(len(model.mean))
        noise = _COMMON * prior.moment.reshape(len(prior.moment), -1) @ model.covariance.reshape(len(of_band), -1).T
        moment[:, of_band, of_band] += noise + _LEAST_NOISE**2 * moment[:, of_band, of_band]
        factor = np.linalg.inv(np.linalg.cholesky(moment))
        gain = (np.linalg.solve(moment, cross)).swapaxes(1, 2)
        return cls(prior.share, factor, gain, prior.moment - gain @ cross)

    def chosen(self, index: np.ndarray, share: np.ndarray) -> "_Families":
        """Return some of the families with other shares."""
        of_index = (getattr(self, name)[index] for name in ("factor", "light_from_response", "open"))
        return _Families(share[index] / share[index].sum(), *of_index)

    def weight(self) -> np.ndarray:
        """Return the shares over the square roots of the determinants, relative to the largest, (n,)."""
        logarithm = np.log(self.share) + np.log(np.einsum("nbb->nb", self.factor)).sum(axis=1)
        return np.exp(logarithm - logarithm.max())

    def squares(self, response: np.ndarray) -> np.ndarray:
        """Return ρᵀ S⁻¹ ρ of responses (m, bands), (m, n)."""
        turned = np.einsum("nij,mj->mni", self.factor, response, optimize=True)
        return np.maximum(np.einsum("mni,mni->mn", turned, turned), np.finfo(float).tiny)

    def log_likelihoods(self, response: np.ndarray) -> np.ndarray:
        """Return the logarithm of the density of responses (m, bands) in every family, up to a constant, (m, n)."""
        logarithm = np.log(np.einsum("nbb->nb", self.factor)).sum(axis=1)
        return logarithm - 0.5 * response.shape[1] * np.log(self.squares(response))

    def likelihoods(self, response: np.ndarray) -> np.ndarray:
        """Return the density of responses (m, bands) in every family, relative to the largest of each, (m, n)."""
        logarithm = self.log_likelihoods(response)
        return np.exp(logarithm - logarithm.max(axis=1, keepdims=True))

    def shares(self, response: np.ndarray) -> np.ndarray:
        """Return the families' shares in directions of responses (m, bands), (m, n)."""
        return _parted(self.share, self.likelihoods(response))

    def room_shares(self, directions: Directions) -> tuple[np.ndarray, np.ndarray]:
        """Return the families' shares in a room, by expectation and maximisation, and those last seen, each (n,)."""
        shares, count = self.share, len(self.share)
        evidence = _EVIDENCE * (directions.different() - 1.0)
        likelihoods = self.likelihoods(directions.response)
        for _ in range(_STEPS):
            seen = directions.share @ _parted(shares, likelihoods)
            shares = (count * self.share + evidence * seen) / (count + evidence)
        return shares, seen

    def of_room(self, directions: Directions, broad: int) -> "_Families":
        """Return the families of a room that explain most of it, and those of any light."""
        (shares, seen), count = self.room_shares(directions), len(self.share)
        # What a lamp seen nowhere else shines like is found among the families that hold any light.
        last = np.arange(count - broad, count)
        most = np.argsort(-seen[: last[0]], kind="stable")[: _FAMILIES - broad]
        return self.chosen(np.concatenate([most, last]), shares)


def evidence(prior: LightPrior, model: ResponseModel, directions: Directions) -> float:
    """Return the logarithm of the density that a prior gives a room, its shares found in it, up to a constant.

    Directions count by how many differ in colour. The constant is common to all priors seen by one camera in one room,
    so that differences compare them.
    """
    families = _Families.seen(prior, model)
    shares, _ = families.room_shares(directions)
    density = np.logaddexp.reduce(families.log_likelihoods(directions.response) + np.log(shares), axis=1)
    return float(directions.different() * (directions.share @ density))


def _parted(shares: np.ndarray, likelihoods: np.ndarray) -> np.ndarray:
    """Return the shares of families (n,) in directions, where a direction has been seen, (m, n)."""
    found = shares * likelihoods
    return found / found.sum(axis=1, keepdims=True)


@dataclass(frozen=True)
class LightRecovery:
    """Map from the responses of a picture to its light, with its error.

    Parameters
    ----------
    basis : (61, r) float64, orthonormal columns
        L(λ) = basis @ weights.
    errors : (q, 61, r) float64
        Independent errors of the basis: times a standard normal number each, they sum to a draw of what the responses
        leave open. They are of the basis because what is open of a lamp is the same wherever its light falls.
    weight, factor, maps : see `irodori.light.recovery_loops.mixture_weights`
    """

    basis: np.ndarray
    errors: np.ndarray
    weight: np.ndarray
    factor: np.ndarray
    maps: np.ndarray

    @classmethod
    def of_room(cls, model: ResponseModel, directions: Directions, prior: LightPrior | None = None) -> "LightRecovery":
        """Return the recovery of a room's light.

        Parameters
        ----------
        model : ResponseModel
            Of the camera.
        directions : Directions
            Of the room.
        prior : LightPrior, optional
            That of any lamp where absent.
        """
        prior = prior_of_any_lamp() if prior is None else prior
        known = _Families.seen(prior, model)
        return cls._solved(known.of_room(directions, prior.broad), directions)

    @classmethod
    def _solved(cls, families: _Families, directions: Directions) -> "LightRecovery":
        response, shares = directions.response, families.shares(directions.response)
        by_family = np.einsum("nlb,mb->mnl", families.light_from_response, response, optimize=True)
        mean = np.einsum("mn,mnl->ml", shares, by_family)
        # All directions count by their share of the light, whatever their brightness.
        relative = np.sqrt(directions.share) / np.linalg.norm(response, axis=1)
        basis = np.linalg.svd(relative[:, None] * mean, full_matrices=False)[2][:_BASES].T
        maps = basis.T @ families.light_from_response
        # What a family leaves open, and what its mean is off the mean of all, as functions of the weights.
        weights = relative[:, None] * (mean @ basis)
        scale = np.sqrt(shares * families.squares(response) / response.shape[1])
        of_scale = np.linalg.lstsq(weights, relative[:, None] * scale, rcond=None)[0].T
        apart = np.sqrt(shares)[:, :, None] * (by_family - mean[:, None])
        of_apart = np.linalg.lstsq(weights, (relative[:, None, None] * apart).reshape(len(mean), -1), rcond=None)[0]
        spread, axes = np.linalg.eigh(families.open)
        roots = (axes * np.sqrt(np.maximum(spread, 0.0))[:, None]).swapaxes(1, 2)
        errors = np.concatenate(
            [
                (roots[:, :, :, None] * of_scale[:, None, None]).reshape(-1, *basis.shape),
                of_apart.T.reshape(-1, *basis.shape),
            ]
        )
        return cls(basis, _strongest(errors), families.weight(), families.factor, maps)

    def weights(self, response: np.ndarray) -> np.ndarray:
        """Return the weights of the light on the basis, (..., bands) to (..., r) float32; NaN where not finite."""
        flat = np.ascontiguousarray(response.reshape(-1, response.shape[-1]), dtype=np.float32)
        out = np.empty((len(flat), self.maps.shape[1]), dtype=np.float32)
        mixture_weights(flat, self.weight, self.factor, self.maps, out)
        return out.reshape(*response.shape[:-1], -1)


def _strongest(errors: np.ndarray) -> np.ndarray:
    """Return independent errors (q, 61, r) of the same covariance, the weakest left out."""
    flat = errors.reshape(len(errors), -1)
    values, vectors = np.linalg.eigh(flat.T @ flat)
    kept = slice(-_ERRORS, None)
    return (vectors[:, kept] * np.sqrt(np.maximum(values[kept], 0.0))).T.reshape(-1, *errors.shape[1:])
