"""Gloss maps: light blurred by lobes of several widths, for rough reflection [eq. 5, 9]."""

from dataclasses import dataclass

import numpy as np

from irodori.core import store
from irodori.core.errors import InputError
from irodori.light.blurred_light import WIDTHS_RAD, prefiltered
from irodori.light.environment_file import Environment
from irodori.material.coefficients import read_coefficients, write_coefficients


@dataclass(frozen=True)
class GlossMaps:
    """Blurred light of an environment, on its basis.

    Parameters
    ----------
    first : int
        Level of the finest map in `irodori.light.blurred_light.WIDTHS_RAD`.
    levels : tuple of (h, 2 h, k) float32
        Mean radiance weighted by lobes of increasing width.
    """

    first: int
    levels: tuple[np.ndarray, ...]

    @classmethod
    def of(cls, coefficients: np.ndarray) -> "GlossMaps":
        """Compute the maps of an equirectangular picture, (height, width, k)."""
        first, levels = prefiltered(coefficients)
        return cls(first, tuple(levels))

    def write(self, out, storage: str = "single") -> None:
        """Write ``/gloss`` into an open file of `irodori.core.store`, as `irodori.material.coefficients` describes."""
        widths = WIDTHS_RAD[self.first :]
        out.write("gloss/width", widths, units="rad", dims="level", quantity="width 1/√κ of the blurring lobe")
        for number, level in enumerate(self.levels, start=self.first):
            write_coefficients(
                out,
                f"gloss/level-{number:02d}",
                level,
                quantity="coefficients of the radiance blurred by a von Mises-Fisher lobe",
                storage=storage,
                codec="lzf",
                dims=f"theta_{number:02d},azimuth_{number:02d},component",
            )

    @classmethod
    def stored(cls, environment: Environment, levels: tuple[int, int] | None = None) -> "GlossMaps | None":
        """Read the maps from the file of an environment; None if there is no file, or it has no maps.

        Other parameters and errors are those of `load`.
        """
        if environment.file is None:
            return None
        with store.open_file(environment.file) as file:
            if "gloss/width" not in file:
                return None
        return cls.load(environment.file, levels)

    @classmethod
    def load(cls, path, levels: tuple[int, int] | None = None) -> "GlossMaps":
        """Read ``/gloss`` from the file of an environment.

        Parameters
        ----------
        path : path
        levels : (int, int), optional
            First level of `irodori.light.blurred_light.WIDTHS_RAD`, and one after the last, as in
            `irodori.light.blurred_light.prefiltered`.

        Raises
        ------
        InputError
            If the file has no maps, or maps with the widths of another version.
        """
        with store.open_file(path) as file:
            widths = file.read("gloss/width")
            first = len(WIDTHS_RAD) - len(widths)
            if first < 0 or not np.allclose(widths, WIDTHS_RAD[first:]):
                accepted = f"{WIDTHS_RAD[0]:.4g} rad and every factor of √2 to {WIDTHS_RAD[-1]:.4g}"
                raise InputError(path, "gloss/width", "other widths", accepted)
            wanted = levels or (first, len(WIDTHS_RAD))
            first = max(first, wanted[0])
            last = max(first + 1, wanted[1])
            maps = tuple(read_coefficients(file, f"gloss/level-{n:02d}") for n in range(first, last))
            return cls(first, maps)
