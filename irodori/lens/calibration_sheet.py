"""The printed sheet for calibration of a lens: a chessboard with markers in its white squares (ChArUco)."""

from functools import cache
from pathlib import Path

import cv2
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from irodori.core.atomic_files import written_whole
from irodori.core.errors import InputError

#: Squares along the long and the short side; the corners between them are measured.
COLUMNS, ROWS = 11, 7
#: Width and height of the paper, and side of a square on it, mm.
PAPERS_MM = {"A4": (297.0, 210.0, 25.0), "A3": (420.0, 297.0, 36.0), "letter": (279.4, 215.9, 23.0)}
#: Side of a marker relative to that of a square; no marker lies within a fifth of a square of a corner.
_MARKER = 0.6
_FREE = 0.5 * (1.0 - _MARKER)
_DOTS_PER_INCH = 600


@cache
def board() -> cv2.aruco.CharucoBoard:
    """Return the board with the side of a square as unit of length; corner (0, 0) is the upper left of the sheet."""
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    return cv2.aruco.CharucoBoard((COLUMNS, ROWS), 1.0, _MARKER, dictionary)


def board_picture(square_px: int) -> np.ndarray:
    """Draw the board in black on white, (ROWS * square_px, COLUMNS * square_px) uint8."""
    return board().generateImage((COLUMNS * square_px, ROWS * square_px))


def write_sheet(path, paper: str = "A4") -> None:
    """Write the sheet as a PDF of one page.

    Parameters
    ----------
    path : path
        File name that ends in ``.pdf``.
    paper : str
        One of PAPERS_MM.

    Raises
    ------
    InputError
        If the name has another ending, or its folder does not exist.
    """
    path = Path(path)
    if path.suffix.lower() != ".pdf":
        raise InputError(path, "", f"the ending {path.suffix!r}", "a name that ends in .pdf")
    if not path.parent.is_dir():
        raise InputError(path, "", "a folder that is not there", "a file in a folder that exists")
    width_mm, height_mm, square_mm = PAPERS_MM[paper]
    dots_per_mm = _DOTS_PER_INCH / 25.4
    page = Image.new("L", (round(width_mm * dots_per_mm), round(height_mm * dots_per_mm)), 255)
    drawn = Image.fromarray(board_picture(round(square_mm * dots_per_mm)))
    left, top = (page.width - drawn.width) // 2, (page.height - drawn.height) // 2
    page.paste(drawn, (left, top))
    words = f"Irodori, sheet for irodori lens, {paper}. Keep it flat: glue it to glass or a board."
    size = round(3.0 * dots_per_mm)
    ImageDraw.Draw(page).text((left, top + drawn.height + size), words, fill=0, font=ImageFont.load_default(size))
    with written_whole(path) as temporary:
        page.convert("1").save(temporary, format="PDF", resolution=_DOTS_PER_INCH)


def find_corners(green: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Find the sheet in a picture.

    Parameters
    ----------
    green : (height, width) float32
        Linear picture of one colour, any scale.

    Returns
    -------
    plane : (n, 2) float32
        Positions of the found corners on the sheet, in squares; n is 0 if the sheet was not found.
    seen : (n, 2) float32
        Positions of the same corners in the picture, samples; the centre of a sample has integer coordinates.
    """
    top = float(np.percentile(green, 99.5))
    if not top > 0.0:
        return np.zeros((0, 2), np.float32), np.zeros((0, 2), np.float32)
    # The square root approximates the gamma encoding of pictures for which the detector is made.
    shown = np.sqrt(np.clip(green / top, 0.0, 1.0)).astype(np.float32)
    picture = np.round(255.0 * shown).astype(np.uint8)
    # Search again for missed markers at the positions predicted from the found ones.
    parameters = cv2.aruco.CharucoParameters()
    parameters.tryRefineMarkers = True
    found, numbers, _, _ = cv2.aruco.CharucoDetector(board(), parameters).detectBoard(picture)
    if numbers is None or len(numbers) == 0:
        return np.zeros((0, 2), np.float32), np.zeros((0, 2), np.float32)
    plane = np.array(board().getChessboardCorners(), dtype=np.float32)[numbers.ravel(), :2]
    seen = found.reshape(-1, 1, 2).astype(np.float32)
    # Half the side of the window around a corner; the window must not contain a part of a marker.
    window = max(2, int(0.9 * _FREE * _smallest_square_px(plane, seen.reshape(-1, 2))))
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-4)
    refined = cv2.cornerSubPix(shown, seen, (window, window), (-1, -1), stop)
    return plane, refined.reshape(-1, 2)


def _smallest_square_px(plane: np.ndarray, seen: np.ndarray) -> float:
    """Return the smallest distance in the picture, in samples, between corners that are neighbours on the sheet."""
    apart = np.linalg.norm(plane[:, None] - plane[None], axis=-1)
    pairs = np.argwhere((apart > 0.5) & (apart < 1.2))
    if len(pairs) == 0:
        return 0.0
    return float(np.linalg.norm(seen[pairs[:, 0]] - seen[pairs[:, 1]], axis=1).min())
