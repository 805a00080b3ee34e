"""Statistical test of colour differences against a tolerance, from a sample of pixels."""

import numpy as np

#: Share of the pixels that have to keep the tolerance.
SHARE = 0.99
#: Certainty with which a bound from a sample holds for the whole.
_CERTAINTY = 0.999


def bound_of_share(values: np.ndarray) -> float:
    """Return an upper confidence bound for the quantile `SHARE` of a population, from a random sample of it.

    The bound is the order statistic that exceeds the quantile with a probability of 0.999 for any distribution
    (binomial), or the largest value if the sample is too small for that.
    """
    from scipy.stats import binom  # slow to import

    place = int(binom.ppf(_CERTAINTY, len(values), SHARE))
    return float(np.sort(values)[min(place, len(values) - 1)])
