"""Views of single bands in interleaved pictures, without copies."""

import numpy as np
from numpy.lib.stride_tricks import as_strided


def flatten(image) -> tuple[np.ndarray, int]:
    """Return the samples of a picture as one contiguous row, and how far its pixels lie apart in it.

    Parameters
    ----------
    image : (height, width, bands) float32
        A picture, or some neighbouring bands of a picture with more; anything else is copied.

    Returns
    -------
    values : (n,) float32
        Band b of pixel (y, x) is ``values[(y * width + x) * step + b]``. Loops compiled for it fit every picture, and
        load neighbours together, which they cannot where the distance of two bands is known at run time only.
    step : int
    """
    image = np.asarray(image, dtype=np.float32)
    height, width, bands = image.shape
    step = image.strides[1] // image.itemsize
    if image.strides != (width * step * image.itemsize, step * image.itemsize, image.itemsize) or step < bands:
        image, step = np.ascontiguousarray(image), bands
    return as_strided(image, ((height * width - 1) * step + bands,), (image.itemsize,)), step
