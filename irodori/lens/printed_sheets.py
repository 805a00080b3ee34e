"""The printed sheets: chessboards with markers in their white squares (ChArUco), for a lens and for objects.

The two have different markers, so that neither is mistaken for the other.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from irodori.core.atomic_files import written_whole
from irodori.core.errors import InputError

_DOTS_PER_INCH = 600


@dataclass(frozen=True, eq=False)
class PrintedSheet:
    """A chessboard with markers, printed in the middle of a paper; corner (0, 0) is at the upper left.

    Parameters
    ----------
    columns, rows : int
        Squares along the long and the short side.
    marker : float
        Side of a marker relative to that of a square.
    first_marker : int
        Number of the first marker in OpenCV's dictionary of 4 x 4 fields.
    border : int
        Width of the chessboard around the middle of the sheet, which is black, in squares; 0 if squares fill the sheet.
    papers_mm : mapping of str to (float, float, float)
        Width and height of each paper, and side of a square on it, mm.
    words : str
        What is written under the chessboard; ``{paper}`` and ``{square_mm}`` are replaced.
    """

    columns: int
    rows: int
    marker: float
    first_marker: int
    border: int
    papers_mm: Mapping[str, tuple[float, float, float]]
    words: str

    @cached_property
    def board(self) -> cv2.aruco.CharucoBoard:
        """Return the board with the side of a square as unit of length."""
        dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_250)
        numbers = self.first_marker + np.arange(self.columns * self.rows // 2)
        return cv2.aruco.CharucoBoard((self.columns, self.rows), 1.0, self.marker, dictionary, numbers)

    def picture(self, square_px: int) -> np.ndarray:
        """Draw the board in black on white, (rows * square_px, columns * square_px) uint8."""
        drawn = self.board.generateImage((self.columns * square_px, self.rows * square_px))
        if self.border:
            edge = self.border * square_px
            drawn[edge:-edge, edge:-edge] = 0
        return drawn

    def write(self, path, paper: str = "A4") -> None:
        """Write the sheet as a PDF of one page.

        Parameters
        ----------
        path : path
            File name that ends in ``.pdf``.
        paper : str
            One of ``papers_mm``.

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
        width_mm, height_mm, square_mm = self.papers_mm[paper]
        dots_per_mm = _DOTS_PER_INCH / 25.4
        page = Image.new("L", (round(width_mm * dots_per_mm), round(height_mm * dots_per_mm)), 255)
        drawn = Image.fromarray(self.picture(round(square_mm * dots_per_mm)))
        left, top = (page.width - drawn.width) // 2, (page.height - drawn.height) // 2
        page.paste(drawn, (left, top))
        words = self.words.format(paper=paper, square_mm=f"{square_mm:g}")
        size = min(round(3.0 * dots_per_mm), top // 3)
        ImageDraw.Draw(page).text((left, top + drawn.height + size), words, fill=0, font=ImageFont.load_default(size))
        with written_whole(path) as temporary:
            page.convert("1").save(temporary, format="PDF", resolution=_DOTS_PER_INCH)

    def find(self, green: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Find the sheet in a picture; parts of it may be hidden or outside.

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
        nothing = np.zeros((0, 2), np.float32), np.zeros((0, 2), np.float32)
        top = float(np.percentile(green, 99.5))
        if not top > 0.0:
            return nothing
        # The square root approximates the gamma encoding of pictures for which the detector is made.
        shown = np.sqrt(np.clip(green / top, 0.0, 1.0)).astype(np.float32)
        picture = np.round(255.0 * shown).astype(np.uint8)
        # Search again for missed markers at the positions predicted from the found ones.
        parameters = cv2.aruco.CharucoParameters()
        parameters.tryRefineMarkers = True
        found, numbers, _, _ = cv2.aruco.CharucoDetector(self.board, parameters).detectBoard(picture)
        if numbers is None or len(numbers) == 0:
            return nothing
        plane = np.array(self.board.getChessboardCorners(), dtype=np.float32)[numbers.ravel(), :2]
        seen = found.reshape(-1, 1, 2).astype(np.float32)
        # Half the side of the window around a corner; the window must not contain a part of a marker.
        window = max(2, int(0.9 * 0.5 * (1.0 - self.marker) * _smallest_square_px(plane, seen.reshape(-1, 2))))
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


#: The sheet of `irodori lens`; markers 0 to 37.
LENS_SHEET = PrintedSheet(
    columns=11,
    rows=7,
    marker=0.6,
    first_marker=0,
    border=0,
    papers_mm={"A4": (297.0, 210.0, 25.0), "A3": (420.0, 297.0, 36.0), "letter": (279.4, 215.9, 23.0)},
    words="Irodori, sheet for irodori lens, {paper}. Keep it flat: glue it to glass or a board.",
)
#: The sheet of `irodori markers`, on which an object stands. Its middle is black, like the table of a rig: white paper
#: would light the object, and squares behind its outline would be mistaken for the outline. Markers 100 to 187.
OBJECT_SHEET = PrintedSheet(
    columns=16,
    rows=11,
    marker=0.7,
    first_marker=100,
    border=2,
    papers_mm={
        "A4": (297.0, 210.0, 17.0),
        "A3": (420.0, 297.0, 24.0),
        "A5": (210.0, 148.0, 12.0),
        "A6": (148.0, 105.0, 8.5),
        "letter": (279.4, 215.9, 16.0),
    },
    words="Irodori, sheet for an object, {paper}, squares of {square_mm} mm if printed at full size.",
)
