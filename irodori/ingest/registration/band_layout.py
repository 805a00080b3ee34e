"""Views of single bands in interleaved pictures, without copies."""

import numpy as np
from numpy.lib.stride_tricks import as_strided


def flatten(image) -> tuple[np.ndarray, int]:
    """Return the samples of a picture as a contiguous row, and the distance of its pixels in this row.

    Parameters
    ----------
    image : (height, width, bands) float32
        A picture, or neighbouring bands of a picture with more bands; other arrays are copied.

    Returns
    -------
    values : (n,) float32
        Band b of pixel (y, x) is ``values[(y * width + x) * step + b]``. The same compiled loops work for every
        picture, and can load neighbouring bands together, because their distance is known at compile time.
    step : int
    """
    image = np.asarray(image, dtype=np.float32)
    height, width, bands = image.shape
    step = image.strides[1] // image.itemsize
    if image.strides != (width * step * image.itemsize, step * image.itemsize, image.itemsize) or step < bands:
        image, step = np.ascontiguousarray(image), bands
    return as_strided(image, ((height * width - 1) * step + bands,), (image.itemsize,)), step
