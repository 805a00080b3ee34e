"""Pictures of a material's diffuse colour over its texture, under a light that one chooses."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from irodori.colour.colorimetry import xyz_from_reflectance
from irodori.colour.display import Display, srgb
from irodori.export.loss import LOSS, Loss, differences
from irodori.export.pictures import write_display_picture
from irodori.material.material_file import Material

if TYPE_CHECKING:
    from irodori.export.export_sources import Item

#: Longest side of a preview, px.
_PREVIEW_PX = 512


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
    loss = Loss.of(differences(display, linear, display.decode(codes))[item.observed])
    attributes = {
        "irodori:quantity": "diffuse colour",
        "irodori:illuminant": illuminant,
        LOSS: loss.text,
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
