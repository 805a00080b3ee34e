"""Response model of a camera from its chart and, if given, a table of its filter and its sensitivities.

Given data are used only if the chart supports them: of all combinations of these sources, the one with the highest
marginal likelihood on the chart is used, and the sources that it leaves out are reported.
"""

from dataclasses import dataclass

import numpy as np

from irodori.calibration.filter_fit import FILTERED, FilterFit, fit_filter
from irodori.calibration.filter_table import FilterTable
from irodori.calibration.sensitivity_prior import BandPrior, Posteriors, prior_about, prior_of_chart, with_least_power
from irodori.spectra.grid import TRAPEZOID_NM

#: Smallest error of a patch's response, relative to the rms over the patches: no chart is closer to published spectra.
_LEAST_NOISE = 3e-4
CHART, FILTER, SENSITIVITIES = "chart", "filter table", "sensitivities"


@dataclass(frozen=True)
class CameraSensitivities:
    """Known relative sensitivities of red, green and blue, with their uncertainty.

    Parameters
    ----------
    values : (3, 61) float64
    error : float
        Standard deviation, relative to a sensitivity's local root mean square.
    """

    values: np.ndarray
    error: float


@dataclass(frozen=True)
class Given:
    """Knowledge of a camera before its chart is photographed; each part may be absent."""

    filter: FilterTable | None = None
    sensitivities: CameraSensitivities | None = None


#: No knowledge beside the chart, as for most cameras.
NOTHING = Given()


@dataclass(frozen=True)
class BestResponse:
    """Response model of a camera, and the sources that it is based on.

    Parameters
    ----------
    mean : (bands, 61) float64
    covariance : (bands, 61, bands, 61) float64
    sources : tuple of str
        Sources that were used, the chart first.
    evidence : dict of float
        {sources: logarithm of the marginal likelihood, less that with the chart alone}, for each combination.
    filter : FilterFit or None
        Fit of the filter; None if its table was not used.
    """

    mean: np.ndarray
    covariance: np.ndarray
    sources: tuple[str, ...]
    evidence: dict[tuple[str, ...], float]
    filter: FilterFit | None = None

    def ignored(self) -> tuple[str, ...]:
        """Return the sources that were given but not used, because the chart contradicts them."""
        tried = dict.fromkeys(source for sources in self.evidence for source in sources)
        return tuple(source for source in tried if source not in self.sources)

    def ignored_by(self, source: str) -> float:
        """Return the log likelihood ratio of the chosen combination to the best one that uses a source."""
        return self.evidence[self.sources] - max(value for way, value in self.evidence.items() if source in way)


def best_response(
    response: np.ndarray, spectra: np.ndarray, light: np.ndarray, variance: np.ndarray, given: Given
) -> BestResponse:
    """Return the response model with the highest marginal likelihood on the chart, among combinations of sources.

    Parameters
    ----------
    response : (m, bands) float64
    spectra : (m, 61) float64
    light : (61,) float64
    variance : (bands,) float64
        Variance of the responses; zeros if unknown.
    given : Given
        Further sources. Sensitivities apply to the first three bands: red, green and blue without the filter. A filter
        requires exactly six bands: these three without the filter, then with it.
    """
    # Responses are integrals by the trapezoidal rule [eq. 1]: the first and the last sample count half.
    light = with_least_power(light) * (TRAPEZOID_NM / TRAPEZOID_NM.max())
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
        if response.shape[1] == 2 * FILTERED:
            same = fit_filter(response, spectra, None, of_bands[:FILTERED], variance)
            ways[sources] = max(ways[sources], same, key=lambda way: way.log_evidence)
        if given.filter is not None:
            ways[CHART, FILTER, *sources[1:]] = fit_filter(
                response, spectra, given.filter, of_bands[:FILTERED], variance
            )
    likeliest = max(ways, key=lambda sources: ways[sources].log_evidence)
    best, alone = ways[likeliest], ways[CHART,].log_evidence
    return BestResponse(
        best.mean,
        best.covariance,
        likeliest,
        {sources: way.log_evidence - alone for sources, way in ways.items()},
        best if FILTER in likeliest and isinstance(best, FilterFit) else None,
    )
