"""Materials as labelled arrays of xarray; numbers are read from the file only when they are used."""

from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

import numpy as np

from irodori.core import store
from irodori.core.errors import InputError, PlainError
from irodori.material.material_file import BASIS, COEFFICIENTS
from irodori.spectra.grid import SAMPLES, WAVELENGTH_NM

if TYPE_CHECKING:
    import xarray

_INDEX = {"refractive_index_n": "refractive_index/n", "refractive_index_k": "refractive_index/k"}
_AXES = {2: ("row", "column"), 3: ("row", "column", "wavelength")}
_TOGETHER = 1 << 22  # decoded numbers that are held at once in addition to the result


class MissingPackageError(PlainError, ImportError):
    """Raised if a Python package that an optional feature needs is not installed."""


class _Spectra:
    """Array of a material's spectra, (rows, columns, 61), of which any part can be decoded from its coefficients.

    Parameters
    ----------
    file : store.Reader

    Raises
    ------
    InputError
        If coefficients and basis do not fit together.
    """

    def __init__(self, file: store.Reader) -> None:
        self.file = file
        layout, basis = file.layout(COEFFICIENTS), file.layout(BASIS)
        if len(layout.shape) != len(_AXES[3]) or basis.shape != (SAMPLES, layout.shape[-1]):
            found = f"coefficients of {layout.shape} for a basis of {basis.shape}"
            raise InputError(file.path, COEFFICIENTS, found, f"(rows, columns, k) for a basis of ({SAMPLES}, k)")
        self.shape, self.dtype = (*layout.shape[:2], SAMPLES), np.dtype(np.float32)
        self._basis: np.ndarray | None = None

    def read(self, key: tuple) -> np.ndarray:
        """Return the part of (rows, columns, 61) that three integers or slices select, decoded a few rows at a time."""
        rows, columns, wavelengths = key
        if self._basis is None:
            basis, scale = self.file.read(BASIS), f"{COEFFICIENTS}_scale"
            if self.file.layout(COEFFICIENTS).dtype == np.float16:
                basis = basis * self.file.read(scale)
            self._basis = basis.astype(np.float32)
        basis = self._basis[wavelengths].T
        if not isinstance(rows, slice):
            return self._coefficients((rows, columns)) @ basis
        numbers = range(*rows.indices(self.shape[0]))
        step = max(1, _TOGETHER // (self.shape[1] * SAMPLES))
        parts = [numbers[first : first + step] for first in range(0, len(numbers), step)] or [numbers]
        return np.concatenate([self._coefficients((_slice(part), columns)) @ basis for part in parts])

    def _coefficients(self, key: tuple) -> np.ndarray:
        return self.file.read(COEFFICIENTS, key).astype(np.float32)


def _slice(numbers: range) -> slice:
    """Return a range with a positive step as a slice."""
    return slice(numbers.start, numbers.stop, numbers.step) if len(numbers) else slice(0, 0)


class _Map:
    """A stored dataset, of which parts can be read."""

    def __init__(self, file: store.Reader, name: str) -> None:
        self.file, self.name = file, name
        layout = file.layout(name)
        self.shape, self.dtype = layout.shape, layout.dtype

    def read(self, key: tuple) -> np.ndarray:
        """Return the part that integers and slices select."""
        return self.file.read(self.name, key)


def open_material(path) -> "xarray.Dataset":
    """Open a material's file as an `xarray.Dataset` that reads numbers only when they are used.

    The maps have the axes ``row`` and ``column``; ``reflectance`` (row, column, wavelength) float32 is the absolute
    reflectance factor S(λ) of each texel, decoded from its coefficients when a part of it is used, and
    ``wavelength`` is in nm. The diffuse term of a rendering is ``alpha * reflectance / green_response``. Numbers are
    NaN where the data does not determine them, and ``status`` says why (its attribute ``flag_meanings``). The file
    stays open until ``close()``, or the end of a ``with`` block.

    Parameters
    ----------
    path : path
        A ``material.h5``.

    Raises
    ------
    InputError
        If the file is missing, was not written by this project, is of a newer version, or is no material. The checksum
        of its content is compared only when the first number is read, which may then raise this error.
    MissingPackageError
        If xarray is not installed.
    """
    try:
        import xarray
        from xarray.backends import BackendArray
        from xarray.core import indexing
    except ImportError:
        wanted = "irodori.open_material needs xarray; it comes with: pip install 'irodori[xarray]'"
        raise MissingPackageError(wanted) from None

    class Lazy(BackendArray):
        """Array from which xarray reads a part of a dataset when that part is used."""

        def __init__(self, source: _Map | _Spectra) -> None:
            self.shape, self.dtype, self._source = source.shape, source.dtype, source

        def __getitem__(self, key) -> np.ndarray:
            basic = indexing.IndexingSupport.BASIC
            return indexing.explicit_indexing_adapter(key, self.shape, basic, self._source.read)

    def variable(source: _Map | _Spectra, axes: tuple[str, ...], attributes: dict) -> "xarray.Variable":
        return xarray.Variable(axes, indexing.LazilyIndexedArray(Lazy(source)), attributes)

    with ExitStack() as opened:
        file = opened.enter_context(store.open_unread(path))
        spectra = _Spectra(file)
        described = {"units": "1", "quantity": "absolute reflectance factor"}
        variables: dict[str, Any] = {"reflectance": variable(spectra, _AXES[3], described)}
        for name in file.maps():
            if (layout := file.layout(name)).shape == spectra.shape[:2]:
                variables[name] = variable(_Map(file, name), _AXES[2], layout.attributes)
        for name, stored in _INDEX.items():
            variables[name] = variable(_Map(file, stored), ("wavelength",), file.layout(stored).attributes)
        coordinate = {"wavelength": ("wavelength", WAVELENGTH_NM, {"units": "nm", "quantity": "wavelength"})}
        attributes = {name: file.attribute(name) for name in file.attributes()}
        found = xarray.Dataset(variables, coordinate, attributes)
        found.set_close(opened.pop_all().close)
    return found
