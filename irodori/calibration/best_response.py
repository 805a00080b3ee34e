"""The response model of a camera from all that is given: its chart, a table of its filter, its sensitivities.

Nothing is believed because it was given. Each way to combine what is given has a marginal likelihood on the chart; the
likeliest is taken, and what it leaves out is named.
"""

from dataclasses import dataclass

import numpy as np

from irodori.calibration.filter_fit import FilterFit, fit_filter
from irodori.calibration.filter_table import FilterTable
from irodori.calibration.sensitivity_prior import BandPrior, Posteriors, prior_about, prior_of_chart

#: Error of a patch's response, of the root mean square over the patches: no chart is closer to its published spectra.
_LEAST_NOISE = 1e-4
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
    """Knowledge of a camera before its chart is photographed; each part may be absent."""

    filter: FilterTable | None = None
    sensitivities: CameraSensitivities | None = None


#: What is known of most cameras.
NOTHING = Given()


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
        Red, green and blue without the filter come first; a filter needs the same three with it, and no others.
    """
    variance = np.maximum(variance, _LEAST_NOISE**2 * np.mean(response**2, axis=0))
    chart = [prior_of_chart(own, spectra, light, v) for own, v in zip(response.T, variance, strict=True)]
    priors: dict[tuple[str, ...], list[BandPrior]] = {(CHART,): chart}
    if given.sensitivities is not None:
        known = given.sensitivities
        about = [
            prior_about(sensitivity, known.error, own, spectra, light, v)
            for sensitivity, own, v in zip(known.values, response.T, variance, strict=False)
        ]
        priors[CHART, SENSITIVITIES] = about + chart[len(about) :]
    ways: dict[tuple[str, ...], FilterFit | Posteriors] = {}
    for sources, of_bands in priors.items():
        ways[sources] = Posteriors.of(of_bands, response, spectra)
        if given.filter is not None:
            ways[CHART, FILTER, *sources[1:]] = fit_filter(response, spectra, given.filter, of_bands[:3], variance)
    likeliest = max(ways, key=lambda sources: ways[sources].log_evidence)
    best, alone = ways[likeliest], ways[CHART,].log_evidence
    return BestResponse(
        best.mean,
        best.covariance,
        likeliest,
        {sources: way.log_evidence - alone for sources, way in ways.items()},
        best if isinstance(best, FilterFit) else None,
    )
