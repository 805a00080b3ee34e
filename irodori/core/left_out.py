"""Comparison of models by their errors in predicting what was left out of their fits."""

from collections.abc import Hashable, Mapping
from typing import TypeVar

import numpy as np

_Model = TypeVar("_Model", bound=Hashable)


def is_less(errors: np.ndarray, others: np.ndarray, standard_errors: float) -> bool:
    """Return whether errors are clearly less than others, by more than some standard errors of the mean difference.

    Both are (n,) float and about the same left-out photographs or patches, of which a single one tells nothing.
    """
    behind = others - errors
    # Errors are infinite where a fit failed, and the comparison with their standard deviation, NaN, is then false.
    return len(behind) > 1 and not behind.mean() <= standard_errors * behind.std(ddof=1) / np.sqrt(len(behind))


def simplest(errors: Mapping[_Model, np.ndarray], standard_errors: float = 1.0) -> _Model:
    """Return the first model that is not clearly worse than the one with the smallest mean error; see `is_less`.

    Parameters
    ----------
    errors : mapping of (n,) float
        Error of each left-out photograph or patch, by model, the simplest model first.
    standard_errors : float
    """
    best = min(errors, key=lambda model: errors[model].mean())
    return next(
        model for model, own in errors.items() if model == best or not is_less(errors[best], own, standard_errors)
    )
