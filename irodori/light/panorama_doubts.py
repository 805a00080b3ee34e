"""Doubts about the numbers of a panorama: steps of a picture made for a display, and more light from below than above.

Neither is a proof, so that both are reasons for a warning and not for a refusal. A file without steps may be encoded
for a display all the same, and a room may be lit from below.
"""

import numpy as np

#: Largest whole number of 8 bits, and the fewest different ones that look like a picture and not like a drawing.
_TOP, _FEWEST = 255, 64
#: Relative rounding of half precision.
_ROUNDING = 2.0**-11
#: Light from below over light from above, as irradiance of a level surface, from which on there is a warning. A ground
#: that is lit from above reflects less than it receives; one in the sun beside a shaded camera may seem to give more.
_MOST_FROM_BELOW = 2.0


class DisplaySteps:
    """Search for the steps of a picture of 8 bits among float numbers, made while a picture is read."""

    def __init__(self) -> None:
        # By the number that stands for 1: which of the whole numbers 0 to 255 occur; None once another number did.
        self._found: dict[int, np.ndarray | None] = {one: np.zeros(_TOP + 1, bool) for one in (1, _TOP)}

    def add(self, band: np.ndarray) -> None:
        """Look at the numbers of a band, (rows, width, n)."""
        for one, found in self._found.items():
            if found is None:
                continue
            steps = band.astype(np.float64) * one
            whole = np.rint(steps)
            if (np.abs(steps - whole) > _ROUNDING * whole).any() or whole.min() < 0.0 or whole.max() > _TOP:
                self._found[one] = None
            else:
                found[np.unique(whole).astype(int)] = True

    def warnings(self) -> list[str]:
        """Return a warning if all numbers are such steps."""
        return [
            f"all numbers are {'whole numbers up to 255' if one == 1 else 'multiples of 1/255'}, as in a picture of 8 "
            "bits for a display: its lamps are cut off, and unless it was made linear, its dark parts are too bright"
            for one, found in self._found.items()
            if found is not None and found.sum() >= _FEWEST
        ]


class LightFromBelow:
    """Sums of the light from above and from below, made while a picture is read.

    Parameters
    ----------
    height : int
        Rows of the whole picture, from the zenith down.
    """

    def __init__(self, height: int) -> None:
        angle = (np.arange(height) + 0.5) * np.pi / height
        self._weight = np.cos(angle) * np.sin(angle)
        self._sums = np.zeros(height)

    def add(self, band: np.ndarray, first: int) -> None:
        """Add a band, (rows, width, n) from 0; ``first`` is the index of its first row."""
        self._sums[first : first + len(band)] = band.sum(axis=(1, 2), dtype=np.float64)

    def warnings(self) -> list[str]:
        """Return a warning if much more light comes from below."""
        light = self._weight * self._sums
        above, below = light[light > 0.0].sum(), -light[light < 0.0].sum()
        if below <= _MOST_FROM_BELOW * above:
            return []
        ratio = f"{below / above:.1f} times the" if above > 0.0 else "all"
        return [f"a level surface gets {ratio} light from below that it gets from above: is the panorama upside down?"]
