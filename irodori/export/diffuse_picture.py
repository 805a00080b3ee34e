"""Pictures of the diffuse colour of a material over its texture, under a chosen light."""

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
    """Return the matrix from a reflectance factor under an illuminant to linear RGB of a display, (3, 61).

    A perfect diffuser becomes white, R = G = B = 1, by chromatic adaptation. The display is sRGB by default; others
    must be from `irodori.colour.display.STANDARD`, because a matrix cannot represent the black level of a measured
    display.
    """
    matrix = xyz_from_reflectance(illuminant)
    return (display or srgb()).linear_rgb(matrix.T, matrix.sum(axis=1)).T


def diffuse_colours(material: Material, matrix: np.ndarray) -> np.ndarray:
    """Return the diffuse reflectance α S / S_G multiplied by a matrix, (n, 61): colours (height, width, n) float64."""
    colours = material.coefficients.astype(np.float64) @ (material.basis.T @ matrix.T)
    return colours * material.spectrum_scale[..., None]


def write_diffuse_tiff(item: "Item", path, illuminant: str, display: Display) -> Loss:
    """Write the diffuse colour of an object under a light as a 16-bit TIFF with the ICC profile of the display.

    The description in the file states the light and the loss, which comes from the rounding of the code values and from
    colours outside the display's gamut. Texels without data have the colour of the nearest texel with data.


    Parameters
    ----------
    item : Item
    path : path
    illuminant : str
        Name of the light, see `irodori.spectra.published.light`.
    display : Display

    Returns
    -------
    Loss
        Over the texels with data on the surface of the object.
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
    """Return the path of the preview beside an exported file: its name with ``.png`` appended."""
    return Path(path).with_name(f"{Path(path).name}.png")
