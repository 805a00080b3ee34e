"""Lamps that the file of a panorama cuts off: many pixels with exactly the largest number, and hardly any near it.

A drawn lamp of one radiance looks the same, so that this is a reason for a warning and not for a refusal. RAW files are
judged by the same idea, see `irodori.ingest.mosaic`.
"""

import numpy as np

#: The fewest pixels with the largest number, their least ratio to those with any of so many next smaller numbers, and
#: how near these must be, as a share of the largest: darker ones say nothing of lamps.
_PLATEAU, _ABOVE_NEXT, _NEXT, _NEAR = 16, 8, 8, 0.8
#: Share of the picture from which on the largest number is its light as a whole, as of an even sky.
_WHOLE = 0.5


class LargestNumbers:
    """Count of the largest numbers of each channel, made while a picture is read.

    Parameters
    ----------
    channels : list of str, length n
    pixels : int
        Number of pixels of the whole picture.
    """

    def __init__(self, channels: list[str], pixels: int) -> None:
        self._channels, self._pixels = channels, pixels
        self._numbers = [np.empty(0)] * len(channels)
        self._counts = [np.empty(0, int)] * len(channels)

    def add(self, band: np.ndarray) -> None:
        """Count the numbers of a band, (rows, width, n)."""
        for channel, (numbers, counts) in enumerate(zip(self._numbers, self._counts, strict=True)):
            values = band[..., channel]
            # What is below the smallest of these now will never be among them.
            least = max(numbers[0] if len(numbers) > _NEXT else 0.0, _NEAR * float(values.max()))
            new, new_counts = np.unique(values[values >= least], return_counts=True)
            union, place = np.unique(np.concatenate([numbers, new]), return_inverse=True)
            total = np.bincount(place, np.concatenate([counts, new_counts]), len(union)).astype(int)
            self._numbers[channel], self._counts[channel] = union[-1 - _NEXT :], total[-1 - _NEXT :]

    def clipping(self) -> list[str]:
        """Return a warning if the largest number of a channel looks like clipped lamps: the one with most pixels."""
        found = [
            (int(counts[-1]), float(numbers[-1]), channel)
            for channel, numbers, counts in zip(self._channels, self._numbers, self._counts, strict=True)
            if self._ends_in_plateau(numbers, counts)
        ]
        if not found:
            return []
        count, number, channel = max(found)
        return [
            f"{count} pixels have exactly {number:g} in {channel}, its largest number, and hardly any come near it: if "
            "lamps were clipped there, the light is too dark"
        ]

    def _ends_in_plateau(self, numbers: np.ndarray, counts: np.ndarray) -> bool:
        near = counts[:-1][numbers[:-1] >= _NEAR * numbers[-1]]
        most = _WHOLE * self._pixels
        return bool(
            numbers[-1] > 0.0 and _PLATEAU <= counts[-1] < most and counts[-1] >= _ABOVE_NEXT * near.max(initial=0)
        )
