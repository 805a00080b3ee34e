"""Linear pictures made of RAW files, for tests: what a program writes that develops RAW files without a tone curve."""

from pathlib import Path

import numpy as np

from irodori.export.pictures import specification, write_picture_file
from irodori.ingest.mosaic import decode


def write_samples(path, samples: np.ndarray) -> Path:
    """Write numbers (height, width, channels) of 8 or 16 bits as they are."""
    names = list("RGBA"[: samples.shape[2]])
    spec = specification(samples.shape[:2], names, {}, str(samples.dtype))
    write_picture_file(path, spec, [samples])
    return Path(path)


def develop_linearly(raw, path) -> Path:
    """Write the superpixels of a RAW file as 16-bit numbers of which the largest stands for saturation."""
    mosaic = decode(raw)
    share = mosaic.superpixels / (mosaic.white - mosaic.black).min()
    return write_samples(path, np.clip(np.rint(65535.0 * share), 0, 65535).astype(np.uint16))
