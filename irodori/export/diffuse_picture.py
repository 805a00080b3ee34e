"""Pictures of a material's diffuse colour over its texture, under a light that one chooses."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from irodori.colour.colorimetry import delta_e, lab_from_xyz, summary, xyz_from_reflectance
from irodori.colour.display import Display, srgb
from irodori.export.pictures import write_display_picture
from irodori.material.material_file import Material

if TYPE_CHECKING:
    from irodori.export.export_sources import Item

#: Longest side of a preview, px.
_PREVIEW_PX = 512


class Loss(NamedTuple):
    """Colour differences of an export against our own renderer, CIEDE2000."""

    compared: int
    mean: float
    p95: float
    largest: float

    @classmethod
    def of(cls, differences: np.ndarray) -> "Loss":
        """Return the figures of differences of any shape; NaN is left out."""
        found = summary(differences)
        return cls(int(found["count"]), found["mean"], found["p95"], found["max"])

    @classmethod
    def read(cls, figures: dict) -> "Loss":
        """Return what `figures` has made a file's JSON of."""
        values = (figures[name] for name in ("mean", "p95", "max"))
        return cls(figures["count"], *(np.nan if value is None else value for value in values))

    @property
    def text(self) -> str:
        """The figures in words, for a file's description."""
        return f"CIEDE2000 mean {self.mean:.3g}, p95 {self.p95:.3g}, max {self.largest:.3g}, of {self.compared}"

    def figures(self) -> dict:
        """Return the figures for a file in JSON."""
        return {"count": self.compared, "mean": _short(self.mean), "p95": _short(self.p95), "max": _short(self.largest)}


def _short(value: float) -> float | None:
    return float(f"{value:.4g}") if math.isfinite(value) else None


def colours_from_bands(illuminant: str, display: Display | None = None) -> np.ndarray:
    """Return the matrix from a reflectance factor under a light to linear RGB of a display, (3, 61).

    A perfect diffuser becomes white, R = G = B = 1, by the display's chromatic adaptation. The display is sRGB where
    none is given, and one of `irodori.colour.display.STANDARD`: a matrix cannot tell of a black that was measured.
    """
    matrix = xyz_from_reflectance(illuminant)
    return (display or srgb()).linear_rgb(matrix.T, matrix.sum(axis=1)).T


def diffuse_colours(material: Material, matrix: np.ndarray) -> np.ndarray:
    """Return α S / S_G in linear colours, (height, width, n) float64; ``matrix`` (n, 61) is that of the colours."""
    colours = material.coefficients.astype(np.float64) @ (material.basis.T @ matrix.T)
    return colours * material.spectrum_scale[..., None]


def differences(display: Display, ours: np.ndarray, theirs: np.ndarray) -> np.ndarray:
    """Return CIEDE2000 between linear RGB of one display, (..., 3) to (...), for an eye adapted to its white."""
    labs = [lab_from_xyz(rgb @ display.xyz_from_rgb.T, display.white_xyz) for rgb in (ours, theirs)]
    return delta_e(*labs)


def write_diffuse_tiff(item: "Item", path, illuminant: str, display: Display) -> Loss:
    """Write the diffuse colour of an object under a light as a TIFF of 16 bits with the display's profile.

    Its description gives the light and the loss, which is that of the codes: what they round, and colours that
    the display cannot show. Texels that no photograph shows have the colour of the nearest that one does.

    Parameters
    ----------
    item : Item
    path : path
    illuminant : str
        See `irodori.spectra.published.light`.
    display : Display

    Returns
    -------
    Loss
        Over the texels on the object's surface with data of their own.
    """
    linear = diffuse_colours(item.material, colours_from_bands(illuminant, display))
    codes, gamut = display.encode(linear, 16)
    shown = np.stack([curve.linear(codes[..., i] / 65535.0) for i, curve in enumerate(display.curves)], axis=-1)
    loss = Loss.of(differences(display, linear, shown)[item.observed])
    attributes = {
        "irodori:quantity": "diffuse colour",
        "irodori:illuminant": illuminant,
        "irodori:loss": loss.text,
        "irodori:outOfGamut": f"{gamut.outside} of {gamut.pixels} texels",
        "irodori:material": f"sha256 {item.sha256}",
    }
    white = xyz_from_reflectance(illuminant).sum(axis=1)
    write_display_picture(path, codes, display.profile, attributes | display.attributes(white))
    return loss


def write_preview(path, linear: np.ndarray) -> None:
    """Write linear sRGB, (height, width, 3), as a PNG of at most 512 pixels a side."""
    step = max(1, -(-max(linear.shape[:2]) // _PREVIEW_PX))
    height, width = (size // step for size in linear.shape[:2])
    small = linear[: height * step, : width * step].reshape(height, step, width, step, 3).mean(axis=(1, 3))
    codes, _ = srgb().encode(np.nan_to_num(small))
    write_display_picture(path, codes, srgb().profile, {"irodori:quantity": "preview"})


def preview_of(path) -> Path:
    """Return the name of the preview beside an export."""
    return Path(path).with_name(f"{Path(path).name}.png")
