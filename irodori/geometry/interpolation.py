"""Weights of the cubic interpolation between samples of a picture."""

import numpy as np

from irodori.jit.compilation import njit

#: Share of a sample's noise variance that remains after interpolation in two directions, on average over positions:
#: the square of the mean sum of squared weights.
KEYS_NOISE_SHARE = (57.0 / 70.0) ** 2


@njit(cache=True, forceinline=True)
def keys_weights(t):
    """Return the weights of Keys' cubic, a = -1/2, for the samples -1..2 around a fraction t between 0 and 1.

    It is the only one of its family that is exact for parabolas, so that it does not widen edges as linear
    interpolation does (R. G. Keys, IEEE Trans. Acoustics, Speech, Signal Processing 29(6), 1981).
    """
    return (
        np.float32(((-0.5 * t + 1.0) * t - 0.5) * t),
        np.float32((1.5 * t - 2.5) * t * t + 1.0),
        np.float32(((-1.5 * t + 2.0) * t + 0.5) * t),
        np.float32((0.5 * t - 0.5) * t * t),
    )
