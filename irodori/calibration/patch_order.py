"""Test that patches come in the order of their spectra, which refuses a chart photographed upside down."""

import numpy as np

_SPARE_PATCHES = 4  # beyond the bands, below which nothing can be told
_MAX_RATIO = 0.6  # of the error of another reading to that of the one configured


def rmse_of_unseen(response: np.ndarray, spectra: np.ndarray) -> np.ndarray:
    """Return each patch's spectral RMSE, predicted linearly from its response by all the others, in closed form.

    Parameters
    ----------
    response : (m, bands) float
    spectra : (m, 61) float

    Returns
    -------
    (m,) float64
    """
    response = response / np.maximum(np.abs(response).max(axis=0), np.finfo(float).tiny)
    left = np.linalg.svd(response, full_matrices=False)[0]
    leverage = (left**2).sum(axis=1)
    residual = (spectra - left @ (left.T @ spectra)) / np.maximum(1.0 - leverage, 1e-6)[:, None]
    return np.sqrt((residual**2).mean(axis=1))


def readings(rows: int, columns: int) -> dict[str, np.ndarray]:
    """Return the orders in which a chart could be read: as it is, turned by half, mirrored or flipped, each (m,)."""
    number = np.arange(rows * columns).reshape(rows, columns)
    orders = {"upright": number, "turned": number[::-1, ::-1], "mirrored": number[:, ::-1], "flipped": number[::-1]}
    return {name: order.ravel() for name, order in orders.items()}


def check_order(response: np.ndarray, spectra: np.ndarray, rows: int, columns: int) -> None:
    """Refuse responses that agree with the spectra much better in another order.

    Raises
    ------
    ValueError
        Naming the reading that fits. Charts of hardly more patches than bands pass: there nothing can be told.
    """
    if len(response) < response.shape[1] + _SPARE_PATCHES or not np.isfinite(response).all():
        return
    errors = {n: float(rmse_of_unseen(response[o], spectra).mean()) for n, o in readings(rows, columns).items()}
    best = min(errors, key=errors.__getitem__)
    if errors[best] < _MAX_RATIO * errors["upright"]:
        raise ValueError(
            f"patches that agree with the spectra when the chart is {best} (spectral RMSE {errors[best]:.3f}) and not "
            f"as its corners are named ({errors['upright']:.3f}): chart.centres_px begins with the first patch"
        )
