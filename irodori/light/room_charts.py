"""Estimation of the lamps of a room from photographs of colour charts in it.

The responses to a chart with known reflectances r_p(λ) under a light L(λ) are Σ R_b r_p L dλ. With 24 patches and six
bands they contain much more information than the six numbers of a wall. The estimation is that of
`irodori.light.light_recovery`, with responses to the patches, to which the errors of the response model are common.
Charts in different places are lit by different mixtures of the lamps. If as much as possible of the light on one chart
is subtracted from that on another without negative values, the rest is closer to the light of a single lamp.
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from irodori.calibration.chart_reading import ChartPhotograph
from irodori.calibration.recovery.calibration_file import Calibration
from irodori.colour.colorimetry import colour_matching_weights
from irodori.config.models import Chart
from irodori.core.errors import InputError
from irodori.core.progress import LOGGER
from irodori.light.light_prior import LightPrior, families_with_errors
from irodori.light.light_recovery import Directions, LightRecovery, ResponseModel, principal_errors
from irodori.spectra.published import chart_spectra

_NOISE = 2e-3  # relative error of the response of a patch due to shadows and gloss, in addition to that by noise
#: Shares in the prior of a room: its own lamps; published lamps; any mixture of these, for light not on the charts.
_OWN, _PUBLISHED, _ANY = 0.5, 0.02, 0.48
_OF_OWN_LAMPS = 0.005  # relative standard deviation of lamps of the room, in addition to their posterior covariance
_LEAST_LEFT = 0.1  # smallest share of the luminance that remains after subtraction of another light
_FLOOR = 0.02  # values of a spectrum below this share of its mean count as noise in the subtraction
_MAX_INVALID = 0.05  # largest share of invalid samples of a patch; patches with more are not used
_LEAST_WHOLE = 0.75  # smallest share of the patches that must be usable
_VECTORS = 8  # principal vectors of reflectances; they represent a chart under any lamp of the CIE to 1.1 %
_SMALLEST = 1e-3  # relative singular value of reflectances, below which their vectors are lost in the error _NOISE
_LEAST_SHARE = 1e-15  # of a family, from which on its light is part of the mean
_STEPS = 3  # of the joint estimation of lights and response
_MAX_MISFIT = 0.08  # largest relative RMS misfit of responses; it is above 0.4 for a rotated or mirrored chart
_MAX_OUTSIDE = 0.05  # largest relative RMS of responses not explained by light from directions of the room


@dataclass(frozen=True)
class ChartResponses:
    """Responses of the camera to a chart in a room.

    Parameters
    ----------
    name : str
        Name of the chart, as in the definition.
    file : path
    response : (patches, bands) float64
        Responses under uniform light, in any unit.
    reflectance : (patches, 61) float64
    variance : (patches, bands) float64
        Variance of the responses due to noise and to what is not known of uneven light.
    """

    name: str
    file: object
    response: np.ndarray
    reflectance: np.ndarray
    variance: np.ndarray

    def relative_variance(self) -> np.ndarray:
        """Return the variance over the square of the largest response of each band, (patches, bands); 0 if that is."""
        largest = np.square(self.response).max(axis=0)
        return np.divide(self.variance, largest, out=np.zeros_like(self.variance), where=largest > 0.0)


def read_room_charts(files: Mapping[str, tuple[object, Chart]], calibration: Calibration) -> list[ChartResponses]:
    """Read the responses to charts in a room, from the linear file and definition of each, by name.

    A warning is logged if it cannot be told how uneven the light on a chart is.

    Raises
    ------
    InputError
        If a chart is not found, more than a quarter of its patches are saturated or masked, or it was photographed with
        other filter states than the chart of the calibration.
    """
    charts = []
    for name, (file, chart) in files.items():
        patches, spectra = chart_spectra(chart.spectra)
        photograph = ChartPhotograph.load(file, chart, len(patches), on_rig=False)
        calibration.require_filters(list(photograph.filters), file)
        reading = photograph.read()
        whole = reading.invalid_share <= _MAX_INVALID
        if whole.mean() < _LEAST_WHOLE:
            found = f"{np.count_nonzero(~whole)} of {len(whole)} patches saturated or masked"
            raise InputError(file, f"room_charts.{name}", found, f"{1 - _LEAST_WHOLE:.0%} at most: shorter exposures")
        variance, light = reading.mean_variance[whole].astype(float), photograph.light
        if light is not None and not light.correctable:
            LOGGER.warning("room chart %s: its light is taken as even: %s", name, light.reason)
        elif light is not None:
            variance += np.square(np.nan_to_num(light.standard_error) * reading.mean[whole])
        charts.append(ChartResponses(name, file, reading.mean[whole].astype(float), spectra[whole], variance))
    return charts


@dataclass(frozen=True)
class RoomLight:
    """The light on a chart, scaled to luminance 1.

    Parameters
    ----------
    mean : (61,) float64
    errors : (k, 61) float64
        Independent errors, each for one standard deviation.
    """

    mean: np.ndarray
    errors: np.ndarray

    @classmethod
    def of(cls, mean: np.ndarray, errors: np.ndarray) -> "RoomLight":
        """Scale a light of any luminance, and its errors, to luminance 1."""
        luminance = colour_matching_weights()[1] @ mean
        return cls(mean / luminance, errors / luminance)

    def without(self, other: "RoomLight") -> "RoomLight":
        """Subtract as much of another light as leaves no significantly negative values; scale to luminance 1."""
        floor = _FLOOR * other.mean.mean()
        share = np.min((np.maximum(self.mean, 0.0) + _FLOOR * self.mean.mean()) / np.maximum(other.mean, floor))
        share = min(share, 1.0 - _LEAST_LEFT)
        return self.of(self.mean - share * other.mean, self.errors - share * other.errors)


def require_own_patches(chart: ChartResponses) -> None:
    """Raise an error if no light can explain the responses to a chart: another chart, or one read incorrectly.

    For any light and camera, the response of a band is a weighted sum of the reflectance over wavelength. It is
    therefore a combination of few principal vectors of the reflectances.

    Raises
    ------
    InputError
        The message names the chart.
    """
    principal = np.linalg.svd(chart.reflectance, full_matrices=False)[0][:, :_VECTORS]
    missed = chart.response - principal @ (principal.T @ chart.response)
    misfit = np.linalg.norm(missed) / np.linalg.norm(chart.response)
    if misfit > _MAX_MISFIT:
        found = f"patches that answer as no light on them makes them, {misfit:.0%} off"
        accepted = f"the chart of the definition, the right way up and evenly lit, at most {_MAX_MISFIT:.0%} off"
        raise InputError(chart.file, f"room_charts.{chart.name}", found, accepted)


def with_misfit(chart: ChartResponses) -> ChartResponses:
    """Add to the variance what no light explains of the responses: veiling light, a shadow, gloss, a faded patch.

    In each band, the mean square of what the principal vectors of the reflectances leave is compared with its
    expectation; the excess is added for all patches. It is unknown if there are no more patches than vectors.
    """
    vectors, sizes, _ = np.linalg.svd(chart.reflectance, full_matrices=False)
    principal = vectors[:, sizes > _SMALLEST * sizes[0]]
    if principal.shape[0] == principal.shape[1]:
        return chart
    missed = chart.response - principal @ (principal.T @ chart.response)
    found = np.square(missed).sum(axis=0) / (principal.shape[0] - principal.shape[1])
    expected = (chart.variance + np.square(_NOISE * chart.response)).mean(axis=0)
    return replace(chart, variance=chart.variance + np.maximum(found - expected, 0.0))


def light_on(chart: ChartResponses, model: ResponseModel, prior: LightPrior) -> tuple[np.ndarray, np.ndarray]:
    """Estimate the light on a chart for the mixture prior: its mean, (61,), and the second moment of its families.

    The second moment, (61, 61), is that before the responses are taken into account, of the families in the shares that
    the responses give them.
    """
    from scipy.linalg import solve_triangular  # slow to import

    bands, (patches, count) = len(model.mean), chart.reflectance.shape
    # Responses are ordered by band, so that errors of the response model, common to all patches, are blocks.
    seen = (model.mean[:, None] * chart.reflectance).reshape(bands * patches, -1)
    answer, noise = chart.response.T.ravel(), chart.relative_variance().T
    of_all, (one, other) = np.arange(len(answer)), np.tril_indices(bands)
    # The scale of the light is unknown: noise is in units of the expected response to the brightest patch of its band.
    brightest = np.arange(bands) * patches + chart.response.argmax(axis=0)
    # Second moments of the response to a wavelength in one band, and to another in another, (61, pairs, 61).
    of_bands = model.mean[:, :, None, None] * model.mean + model.covariance
    of_pairs = np.ascontiguousarray(of_bands.transpose(1, 0, 2, 3)[:, one, other])
    second = np.zeros((bands, patches, bands, patches))

    def factor_of(moment: np.ndarray) -> np.ndarray:
        """Return the Cholesky factor of the second moment of the responses to the light of a family."""
        of_one = chart.reflectance @ (of_pairs * moment[:, None]).reshape(count, -1)
        of_both = of_one.reshape(-1, count) @ chart.reflectance.T
        # The lower triangle is all that the factor needs.
        second[one, :, other] = of_both.reshape(patches, -1, patches).swapaxes(0, 1)
        responses = second.reshape(len(answer), -1).copy()
        expected = responses[of_all, of_all]
        responses[of_all, of_all] += _NOISE**2 * expected + (noise * expected[brightest][:, None]).ravel()
        return np.linalg.cholesky(responses)

    logarithm, squares = np.empty((2, len(prior.share)))
    for number, (moment, share) in enumerate(zip(prior.moment, prior.share, strict=True)):
        factor = factor_of(moment)
        turned = solve_triangular(factor, answer, lower=True, check_finite=False)
        squares[number] = turned @ turned / len(answer)
        likelihood = -np.log(np.diag(factor)).sum() - 0.5 * len(answer) * np.log(squares[number])
        logarithm[number] = np.log(share) + likelihood
    shares = np.exp(logarithm - logarithm.max())
    shares /= shares.sum()
    mean = np.zeros(count)
    # Few of some hundred families are likely at all; what the others would add is lost in rounding.
    for likely in np.flatnonzero(shares > _LEAST_SHARE):
        moment = prior.moment[likely]
        turned = solve_triangular(factor_of(moment), np.column_stack([answer, seen @ moment]), lower=True)
        mean += shares[likely] * (turned[:, 0] @ turned[:, 1:])
    return mean, np.tensordot(shares * squares, prior.moment, axes=1)


def lights_on(
    charts: Sequence[ChartResponses], model: ResponseModel, prior: LightPrior
) -> tuple[ResponseModel, list[RoomLight]]:
    """Estimate the light on charts together with the response of the camera, from the responses to all patches.

    Responses are linearised about the light on each chart by itself and the response model. The errors that remain are
    common to lights and response: where a light is estimated as too strong, the response to it is estimated as too
    weak.
    """
    from scipy.linalg import block_diag  # slow to import

    (bands, count), states = model.mean.shape, model.mean.size
    alone = [light_on(chart, model, prior) for chart in charts]
    lights = np.stack([mean for mean, _ in alone])
    before = block_diag(model.covariance.reshape(states, states), *(moment for _, moment in alone))
    answer = np.concatenate([chart.response.T.ravel() for chart in charts])
    noise = np.diag((_NOISE * answer) ** 2 + np.concatenate([chart.variance.T.ravel() for chart in charts]))
    response = model.mean
    for _ in range(_STEPS):
        of_response = [
            np.kron(np.eye(bands), chart.reflectance * light) for chart, light in zip(charts, lights, strict=True)
        ]
        of_light = [(response[:, None] * chart.reflectance).reshape(-1, count) for chart in charts]
        seen = np.hstack([np.concatenate(of_response), block_diag(*of_light)])
        cross = seen @ before
        gain = np.linalg.solve(cross @ seen.T + noise, cross).T
        # Before the charts are seen, the light has mean 0.
        found = gain @ (answer - seen[:, :states] @ (model.mean - response).ravel())
        response, lights = model.mean + found[:states].reshape(bands, count), found[states:].reshape(-1, count)
    # Errors of responses and of lights have different units; the numerical rank depends on the ratio.
    unit = np.concatenate([np.full(states, np.linalg.norm(response)), np.linalg.norm(lights, axis=1).repeat(count)])
    errors = principal_errors((before - gain @ cross) / np.outer(unit, unit)) * unit
    response_errors = errors[:, :states].reshape(-1, bands, count)
    covariance = np.einsum("kbi,kcj->bicj", response_errors, response_errors, optimize=True)
    of_lights = errors[:, states:].reshape(len(errors), -1, count).swapaxes(0, 1)
    refined = ResponseModel(response, covariance, response_errors, model.rig_lamp_errors)
    return refined, [RoomLight.of(*each) for each in zip(lights, of_lights, strict=True)]


def require_in_room(charts: Sequence[ChartResponses], directions: Directions) -> None:
    """Raise an error if a chart is lit by light that does not occur in the room.

    The light on a chart is a sum of light from directions of the room. Therefore the responses to its most neutral
    light patch must be a sum of responses of directions with positive weights.

    Raises
    ------
    InputError
        The message names the chart.
    """
    from scipy.optimize import nnls  # slow to import

    scale = directions.share @ directions.response
    room = (directions.response / scale).T
    for chart in charts:
        grey = np.argmin(chart.reflectance.std(axis=1) / chart.reflectance.mean(axis=1) ** 2)
        white = chart.response[grey] / scale
        outside = nnls(room, white)[1] / np.linalg.norm(white)
        if outside > _MAX_OUTSIDE:
            found = f"a chart under light of which {outside:.0%} is nowhere in the panorama"
            accepted = f"a chart photographed under the panorama's lamps, at most {_MAX_OUTSIDE:.0%} off"
            raise InputError(chart.file, f"room_charts.{chart.name}", found, accepted)


def room_prior(lights: Sequence[RoomLight], published: LightPrior) -> LightPrior:
    """Return the prior of a room from the lights on its charts, combined with the published lamps."""
    parted = [first.without(second) for first, second in itertools.permutations(lights, 2)]
    mean = np.stack([lamp.mean for lamp in [*lights, *parted]])
    errors = np.stack([lamp.errors for lamp in [*lights, *parted]])
    own = families_with_errors(mean, errors, _OF_OWN_LAMPS)
    known = len(published.share) - published.broad
    shares = (_OWN, own.share), (_PUBLISHED, published.share[:known]), (_ANY, published.share[known:])
    return LightPrior(
        np.concatenate([own.moment, published.moment]),
        np.concatenate([part * share / share.sum() for part, share in shares]),
        published.broad,
        own.common,
    )


def recovery_with(
    charts: Sequence[ChartResponses],
    model: ResponseModel,
    directions: Directions,
    prior: LightPrior,
    mirror: np.ndarray | None = None,
) -> LightRecovery:
    """Determine the recovery of the light of a room, with the help of any number of charts, also none.

    ``mirror``, (61,), is the reflectance of the mirror in which the camera sees the directions; the charts it sees
    without it.

    Raises
    ------
    InputError
        If a chart is inconsistent with the room or with its reflectances; the message names the chart.
    """
    for chart in charts:
        require_own_patches(chart)
    if charts:
        require_in_room(charts, directions if mirror is None else directions.before(mirror, model, prior))
        model, lights = lights_on([with_misfit(chart) for chart in charts], model, prior)
        prior = room_prior(lights, prior)
    return LightRecovery.of_room(model if mirror is None else model.through(mirror), directions, prior)
