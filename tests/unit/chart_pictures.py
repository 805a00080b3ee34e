"""Photographs of a ColorChecker Classic rendered for the tests, with everything that goes wrong with them."""

import numpy as np
from scipy import ndimage

from irodori.calibration.training import mix_paints
from irodori.spectra.published import chart_spectra, spectrum

ROWS, COLUMNS = 4, 6
NAME = "BabelColor Average"
SPECTRA = chart_spectra(NAME)[1]
HALF = 0.435  # of the pitch: half a patch's side
FRAME, PAPER = 0.045, 0.85
_CENTRES_NM, _WIDTHS_NM = (600.0, 540.0, 460.0, 640.0, 570.0, 490.0), (38.0, 36.0, 30.0, 20.0, 18.0, 18.0)


def sensitivities(bands: int = 3, light: str = "A") -> np.ndarray:
    """Sensitivities times light, (bands, 61), scaled to answer 0.9 to white."""
    wavelength_nm = np.arange(400.0, 701.0, 5.0)
    rows = [np.exp(-(((wavelength_nm - c) / w) ** 2)) for c, w in zip(_CENTRES_NM, _WIDTHS_NM, strict=True)][:bands]
    rows = np.array(rows) * spectrum(light)
    return 0.9 * rows / rows.sum(axis=1, keepdims=True)


def large_chart() -> np.ndarray:
    """Spectra of a chart like the Digital SG, letter by letter, (140, 61): paints within white, grey and black."""
    spectra = np.zeros((14, 10, SPECTRA.shape[1]))
    rim = np.ones((14, 10), dtype=bool)
    rim[1:-1, 1:-1] = False
    spectra[rim] = SPECTRA[[18, 21, 23]][np.arange(rim.sum()) % 3]
    spectra[~rim] = mix_paints(SPECTRA)[np.random.default_rng(5).permutation(276)[: (~rim).sum()]]
    return spectra.reshape(140, -1)


def view(
    width: int,
    height: int,
    pitch: float,
    turn_deg: float = 0.0,
    tilt: float = 0.0,
    centre=None,
    *,
    layout=(ROWS, COLUMNS),
) -> np.ndarray:
    """The map from grid to picture of a chart about `centre`, turned and, by `tilt`, seen in perspective."""
    middle = np.array([[1.0, 0.0, -(layout[1] - 1) / 2], [0.0, 1.0, -(layout[0] - 1) / 2], [0.0, 0.0, 1.0]])
    angle = np.radians(turn_deg)
    turn = np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])
    # Tilted about the vertical: one side nearer than the other, and the columns closer together.
    lean = np.array([[np.sqrt(1 - tilt**2), 0.0, 0.0], [0.0, 1.0, 0.0], [tilt / 12.0, 0.0, 1.0]])
    x, y = centre or ((width - 1) / 2, (height - 1) / 2)
    place = np.array([[pitch, 0.0, x], [0.0, pitch, y], [0.0, 0.0, 1.0]])
    return place @ turn @ lean @ middle


def truth(image_from_grid: np.ndarray, distortion: float = 0.0, size=(2, 2), layout=(ROWS, COLUMNS)) -> np.ndarray:
    """True centres of the patches, (n, 2), through a lens with distortion in a picture of that size."""
    row, column = np.meshgrid(np.arange(layout[0]), np.arange(layout[1]), indexing="ij")
    mapped = np.stack([column.ravel(), row.ravel(), np.ones(row.size)], axis=1) @ image_from_grid.T
    points = mapped[:, :2] / mapped[:, 2:]
    away = points - (np.array(size) - 1) / 2
    return points + distortion * ((away / (np.hypot(*size) / 2)) ** 2).sum(axis=1, keepdims=True) * away


def shot(
    maps, width: int = 720, height: int = 520, responses=None, distortion: float = 0.0, layout=(ROWS, COLUMNS)
) -> np.ndarray:
    """A picture of charts on paper, (height, width, bands): edges are smoothed by three samples a side."""
    responses = SPECTRA @ sensitivities().T if responses is None else responses
    white = responses.max(axis=0) / SPECTRA.mean(axis=1).max()

    def part(x, y) -> np.ndarray:
        """Return the colours at places of the picture, (n, bands)."""
        x, y = _unbent(x, y, width, height, distortion)
        out = np.full((len(x), responses.shape[1]), PAPER) * white
        for image_from_grid in maps:
            _draw(out, (x, y), np.linalg.inv(image_from_grid), responses, FRAME * white, layout)
        return out

    y, x = np.indices((height, width)).reshape(2, -1).astype(float)
    picture = part(x, y)
    # Where all neighbours have one colour, so has the whole sample, if nothing is as small as a sample.
    whole = picture.reshape(height, width, -1)
    spread = ndimage.maximum_filter(whole, (3, 3, 1)) - ndimage.minimum_filter(whole, (3, 3, 1))
    edge = np.flatnonzero(spread.max(axis=2))
    fine = (np.arange(3) - 1.0) / 3.0
    picture[edge] = sum(part(x[edge] + dx, y[edge] + dy) for dx in fine for dy in fine) / fine.size**2
    return whole


def _unbent(x, y, width, height, distortion: float):
    """Where straight light would have fallen; third order, good to a thousandth of a sample for a few percent."""
    if not distortion:
        return x, y
    centre_x, centre_y, radius = (width - 1) / 2, (height - 1) / 2, np.hypot(width, height) / 2
    straight_x, straight_y = x, y
    for _ in range(6):
        factor = 1 + distortion * ((straight_x - centre_x) ** 2 + (straight_y - centre_y) ** 2) / radius**2
        straight_x, straight_y = centre_x + (x - centre_x) / factor, centre_y + (y - centre_y) / factor
    return straight_x, straight_y


def _draw(part, xy, grid_from_image, responses, frame, layout) -> None:
    (x, y), (rows, columns) = xy, layout
    u, v, w = np.tensordot(grid_from_image, np.stack([x, y, np.ones_like(x)]), axes=1)
    u, v = np.where(w > 0, u / w, -9.0), np.where(w > 0, v / w, -9.0)
    part[(u > -0.8) & (u < columns - 0.2) & (v > -0.9) & (v < rows - 0.1)] = frame
    column, row = np.rint(u).astype(int), np.rint(v).astype(int)
    inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
    inside &= (np.abs(u - column) < HALF) & (np.abs(v - row) < HALF)
    part[inside] = responses[row[inside] * columns + column[inside]]


def light_field(width: int, height: int, fall: float, lean: float = 0.0) -> np.ndarray:
    """Vignetting by `fall` at the picture's corners, and light that leans by `lean` across, (height, width, 1)."""
    y, x = np.mgrid[0:height, 0:width].astype(float)
    x, y = (x - (width - 1) / 2) / (width / 2), (y - (height - 1) / 2) / (width / 2)
    corner = 1 + (height / width) ** 2
    return (np.exp(np.log1p(-fall) * (x**2 + y**2) / corner + lean * x / 2))[..., None]


def noisy(picture: np.ndarray, rng, share: float, blur_px: float = 0.0) -> np.ndarray:
    """A picture out of focus, with noise of a share of full scale."""
    if blur_px:
        picture = ndimage.gaussian_filter(picture, (blur_px, blur_px, 0))
    return picture + share * rng.normal(size=picture.shape)
