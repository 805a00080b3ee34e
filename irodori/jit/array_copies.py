"""Copies between arrays within compiled loops."""

from irodori.jit.compilation import njit


@njit(cache=True)
def copy_into(target, source):
    """Copy a two-dimensional array into the first rows and columns of another, which must have as many.

    It stands in for ``target[:] = source``, for which numba also compiles the text of an error message: a fourth of the
    compilation of a fit.
    """
    for i in range(source.shape[0]):
        for j in range(source.shape[1]):
            target[i, j] = source[i, j]
