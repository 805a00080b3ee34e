"""Size and decoding speed of stored coefficients, measured for the report."""

import time

from irodori.core import store
from irodori.material.coefficients import read_coefficients
from irodori.spectra.grid import SAMPLES

_READINGS = 5


def storage_sentence(file: store.Reader, name: str) -> str:
    """Return a sentence with the size on disk of a dataset of coefficients and its speed of reading and decoding."""
    dataset = file.dataset(name)
    seconds = []
    for _ in range(_READINGS):
        start = time.perf_counter()
        count = read_coefficients(file, name).size
        seconds.append(time.perf_counter() - start)
    packed = dataset.id.get_storage_size()
    spectra = dataset.size // dataset.shape[-1] * SAMPLES * 4
    times, million = spectra / packed, count / min(seconds) / 1e6
    return (
        f"Coefficients: {packed / 1e6:.3g} MB on disk, {times:.0f} times less than {SAMPLES} bands of 32-bit floats; "
        f"read and decoded at {million:.0f} million a second."
    )
