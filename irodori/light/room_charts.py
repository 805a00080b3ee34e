"""Light on colour charts that stand in a room, and what it tells of the room's lamps.

A chart of known reflectances r_p(λ) under a light L(λ) answers with Σ R_b r_p L dλ: 24 patches in six bands are far
more than the six numbers of a wall. Light of the prior's families is seen here as everywhere else
(`irodori.light.light_recovery`), but through the patches, and the response model's errors are common to them all.

Where charts stand in several places their lamps light them in several proportions. The light of one from which as much
of another is taken as leaves nothing negative is nearer to a single lamp than either.
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from irodori.calibration.chart_reading import ChartPhotograph
from irodori.calibration.recovery.calibration_file import Calibration
from irodori.colour.colorimetry import colour_matching_weights
from irodori.config.models import Chart
from irodori.core.errors import InputError
from irodori.light.light_prior import LightPrior, families_of
from irodori.light.light_recovery import Directions, LightRecovery, ResponseModel
from irodori.spectra.published import chart_spectra

_NOISE = 2e-3  # of a patch's response, relative: shadows, gloss and noise
#: Shares of a room's prior: its own lamps, each published one, any mixture of these, for what the charts do not see.
_OWN, _PUBLISHED, _ANY = 0.5, 0.02, 0.48
_OF_OWN_LAMPS = 0.005  # standard deviation of what differs from the room's lamps beside what the charts leave open
_LEAST_LEFT = 0.1  # of a light's luminance that remains where another is taken from it
_FLOOR = 0.02  # of a light's mean, below which what is taken from it is noise
_MAX_INVALID = 0.05  # of a patch's samples, beyond which it is left out
_LEAST_WHOLE = 0.75  # of a chart's patches
_VECTORS = 8  # principal vectors of a chart's reflectances: any of the CIE's lamps on it is held by them to 1.1 %
_MAX_MISFIT = 0.08  # rms of the patches' responses, relative; a chart turned or mirrored is beyond 0.4
_MAX_OUTSIDE = 0.05  # rms of a chart's bands that light from the room's directions cannot make, relative


@dataclass(frozen=True)
class ChartResponses:
    """Responses of the camera to a chart in a room.

    Parameters
    ----------
    name : str
        Of its place.
    file : path
    response : (patches, bands) float64
        Of even light, in any unit.
    reflectance : (patches, 61) float64
    """

    name: str
    file: object
    response: np.ndarray
    reflectance: np.ndarray


def read_room_charts(files: Mapping[str, tuple[object, Chart]], calibration: Calibration) -> list[ChartResponses]:
    """Return what charts in a room answered, from the linear file and the definition of each, by its name.

    Raises
    ------
    InputError
        If a chart is not found, more than a few of its patches are saturated or masked, or it was photographed in other
        filter states than the camera's own chart.
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
        charts.append(ChartResponses(name, file, reading.mean[whole].astype(float), spectra[whole]))
    return charts


@dataclass(frozen=True)
class RoomLight:
    """The light on a chart, brought to luminance 1.

    Parameters
    ----------
    mean : (61,) float64
    covariance : (61, 61) float64
    """

    mean: np.ndarray
    covariance: np.ndarray

    @classmethod
    def of(cls, mean: np.ndarray, covariance: np.ndarray) -> "RoomLight":
        """Return a light of any luminance with its error, brought to luminance 1."""
        luminance = colour_matching_weights()[1] @ mean
        return cls(mean / luminance, covariance / luminance**2)

    def without(self, other: "RoomLight") -> "RoomLight":
        """Return the light less as much of another as leaves nothing negative."""
        floor = _FLOOR * other.mean.mean()
        share = np.min((np.maximum(self.mean, 0.0) + _FLOOR * self.mean.mean()) / np.maximum(other.mean, floor))
        share = min(share, 1.0 - _LEAST_LEFT)
        return self.of(self.mean - share * other.mean, self.covariance + share**2 * other.covariance)


def require_own_patches(chart: ChartResponses) -> None:
    """Refuse a chart whose patches answer as no light on their reflectances makes them: another, or read otherwise.

    Whatever the light and the camera, a band answers with a weighted sum of the reflectance over the wavelengths; of
    paints a few principal vectors hold all of it.

    Raises
    ------
    InputError
        Which names the chart.
    """
    principal = np.linalg.svd(chart.reflectance, full_matrices=False)[0][:, :_VECTORS]
    missed = chart.response - principal @ (principal.T @ chart.response)
    misfit = np.linalg.norm(missed) / np.linalg.norm(chart.response)
    if misfit > _MAX_MISFIT:
        found = f"patches that answer as no light on them makes them, {misfit:.0%} off"
        accepted = f"the chart of the definition, the right way up and evenly lit, at most {_MAX_MISFIT:.0%} off"
        raise InputError(chart.file, f"room_charts.{chart.name}", found, accepted)


def light_on(chart: ChartResponses, model: ResponseModel, prior: LightPrior) -> RoomLight:
    """Return the light on a chart: the posterior mean of a prior's families, and what the patches leave open."""
    from scipy.linalg import solve_triangular  # slow to import

    bands, patches = len(model.mean), len(chart.reflectance)
    # Band by band, so that the errors of a band's model, common to its patches, are blocks of the diagonal.
    seen = (model.mean[:, None] * chart.reflectance).reshape(bands * patches, -1)
    answer = chart.response.T.ravel()
    of_all = np.arange(len(answer))
    logarithm, means, left = [], [], []
    for moment, share in zip(prior.moment, prior.share, strict=True):
        cross = seen @ moment
        second = cross @ seen.T
        for band in range(bands):
            own = slice(band * patches, (band + 1) * patches)
            of_model = chart.reflectance @ (model.covariance[band] * moment) @ chart.reflectance.T
            second[own, own] += of_model
        second[of_all, of_all] *= 1.0 + _NOISE**2
        factor = np.linalg.cholesky(second)
        turned = solve_triangular(factor, np.column_stack([answer, cross]), lower=True)
        square = turned[:, 0] @ turned[:, 0] / len(answer)
        logarithm.append(np.log(share) - np.log(np.diag(factor)).sum() - 0.5 * len(answer) * np.log(square))
        means.append(turned[:, 0] @ turned[:, 1:])
        left.append(square * (moment - turned[:, 1:].T @ turned[:, 1:]))
    shares = np.exp(np.array(logarithm) - np.max(logarithm))
    shares /= shares.sum()
    mean = shares @ np.array(means)
    apart = np.array(means) - mean
    return RoomLight.of(mean, np.tensordot(shares, np.array(left), axes=1) + (shares * apart.T) @ apart)


def require_in_room(charts: Sequence[ChartResponses], directions: Directions) -> None:
    """Refuse a chart under light that the room's directions do not hold.

    What falls on a chart is a sum of the room's light: the answers of its greyest light patch, which shows that light
    as it is, are a sum of the directions' answers with positive weights.

    Raises
    ------
    InputError
        Which names the chart.
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
    """Return the prior of a room whose charts are lit so: their lamps, and with less weight the published ones."""
    parted = [first.without(second) for first, second in itertools.permutations(lights, 2)]
    lamps = [*lights, *parted]
    moments = np.stack([lamp.mean[:, None] * lamp.mean + lamp.covariance for lamp in lamps])
    own, known = families_of(moments, len(lamps), _OF_OWN_LAMPS), len(published.share) - published.broad
    shares = (_OWN, own.share), (_PUBLISHED, published.share[:known]), (_ANY, published.share[known:])
    return LightPrior(
        np.concatenate([own.moment, published.moment]),
        np.concatenate([part * share / share.sum() for part, share in shares]),
        published.broad,
    )


def refined_model(model: ResponseModel, charts: Sequence[ChartResponses], lights: Sequence[RoomLight]) -> ResponseModel:
    """Return what a camera answers as charts tell it whose light is known: of that light more than before."""
    for chart, light in zip(charts, lights, strict=True):
        light_on_patches = chart.reflectance * light.mean
        expected = light_on_patches @ model.mean.T
        # Only the light's colour was found; its amount is what the answers are as a whole.
        response = chart.response * (np.sum(expected**2) / np.sum(expected * chart.response))
        noise = np.stack(
            [
                chart.reflectance @ (np.outer(own, own) * light.covariance) @ chart.reflectance.T
                + np.diag((_NOISE * answer) ** 2)
                for own, answer in zip(model.mean, response.T, strict=True)
            ]
        )
        model = model.given(light_on_patches, response, noise)
    return model


def recovery_with(
    charts: Sequence[ChartResponses], model: ResponseModel, directions: Directions, prior: LightPrior
) -> LightRecovery:
    """Return the recovery of a room's light with what its charts tell, of any number, none as well.

    Raises
    ------
    InputError
        If a chart disagrees with the room or with its reflectances; it names the chart.
    """
    for chart in charts:
        require_own_patches(chart)
    require_in_room(charts, directions)
    lights = [light_on(chart, model, prior) for chart in charts]
    if charts:
        model, prior = refined_model(model, charts, lights), room_prior(lights, prior)
    return LightRecovery.of_room(model, directions, prior)
