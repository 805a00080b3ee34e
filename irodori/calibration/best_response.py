"""The response model of a camera from all that is given: its chart, a table of its filter, its sensitivities.

Nothing is believed because it was given. Each way to combine what is given has a marginal likelihood on the chart; the
likeliest is taken, and what it leaves out is named.
"""

from dataclasses import dataclass

import numpy as np

from irodori.calibration.filter_fit import FilterFit, fit_filter
from irodori.calibration.filter_table import FilterTable
from irodori.calibration.sensitivity_prior import prior_about, prior_of_chart

CHART, FILTER, SENSITIVITIES = "chart", "filter table", "sensitivities"


@dataclass(frozen=True)
class CameraSensitivities:
    """Sensitivities of red, green and blue, relative, as far as they are known.

    Parameters
    ----------
    values : (3, 61) float64
    error : float
        Standard deviation, relative to what a sensitivity is nearby.
    """

    values: np.ndarray
    error: float


@dataclass(frozen=True)
class Given:
    """What is known of a camera before its chart; each may be absent."""

    filter: FilterTable | None = None
    sensitivities: CameraSensitivities | None = None


@dataclass(frozen=True)
class BestResponse:
    """A response model and what it rests on.

    Parameters
    ----------
    mean : (bands, 61) float64
    covariance : (bands, 61, 61) float64
    sources : tuple of str
        What was used, the chart first.
    evidence : dict of float
        Logarithm of the marginal likelihood of each way, over that of the chart alone, by its sources.
    filter : FilterFit or None
        Where the table of the filter was used.
    """

    mean: np.ndarray
    covariance: np.ndarray
    sources: tuple[str, ...]
    evidence: dict[tuple[str, ...], float]
    filter: FilterFit | None = None

    def ignored(self) -> tuple[str, ...]:
        """Return what was given and not used, as the chart contradicts it."""
        tried = dict.fromkeys(source for sources in self.evidence for source in sources)
        return tuple(source for source in tried if source not in self.sources)

    def ignored_by(self, source: str) -> float:
        """Return by how much the way taken is likelier than the best that uses a source, as a logarithm."""
        return self.evidence[self.sources] - max(value for way, value in self.evidence.items() if source in way)


def best_response(
    response: np.ndarray, spectra: np.ndarray, light: np.ndarray, variance: np.ndarray, given: Given
) -> BestResponse:
    """Return the response model that the chart finds likeliest of those that what is given allows.

    Parameters
    ----------
    response : (m, bands) float64
    spectra : (m, 61) float64
    light : (61,) float64
    variance : (bands,) float64
        Of the responses; zeros where not known.
    given : Given
        A filter needs six bands, sensitivities at least three: red, green and blue without the filter come first.
    """
    chart = [prior_of_chart(own, spectra, light, v) for own, v in zip(response.T, variance, strict=True)]
    priors = {(CHART,): chart}
    if given.sensitivities is not None:
        known = given.sensitivities
        about = [
            prior_about(sensitivity, known.error, own, spectra, light, v)
            for sensitivity, own, v in zip(known.values, response.T, variance, strict=False)
        ]
        priors[CHART, SENSITIVITIES] = about + chart[len(about) :]
    found = {}
    for sources, of_bands in priors.items():
        each = [prior.given(own, spectra) for prior, own in zip(of_bands, response.T, strict=True)]
        mean, covariance = np.array([one.mean for one in each]), np.array([one.covariance for one in each])
        found[sources] = (sum(one.log_evidence for one in each), mean, covariance, None)
        if given.filter is not None:
            fit = fit_filter(response, spectra, given.filter, of_bands[:3], variance)
            found[(CHART, FILTER, *sources[1:])] = (fit.log_evidence, fit.mean, fit.covariance, fit)
    sources = max(found, key=lambda way: found[way][0])
    _, mean, covariance, fit = found[sources]
    evidence = {way: one[0] - found[CHART,][0] for way, one in found.items()}
    return BestResponse(mean, covariance, sources, evidence, fit)
