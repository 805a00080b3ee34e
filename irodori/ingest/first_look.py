"""First check of a set of RAW files: every file is decoded and checked once before any long computation."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from irodori.config.capture_table import Shot, check_unchanged, read_captures, shot_path, write_captures
from irodori.core.custody import content_sha256
from irodori.core.errors import InputError, PlainError
from irodori.core.progress import LOGGER, track
from irodori.ingest.exposure_settings import settle, settle_set
from irodori.ingest.mosaic import Mosaic, decode
from irodori.ingest.set_plausibility import FocalRange, SetLook

#: White level at or below which pictures have too few steps for dark colours, and the warning.
_COARSE = 255.0
_COARSE_WARNING = (
    "8 bits a band: a tenth of the range has 25 steps, so that dark colours are coarse; 16 bits are better"
)


def check_captures(table, folder, output, roles, size_px=None, lens_mm=None) -> None:
    """Decode and check every RAW file of a set once, and write the set's table with hashes, ISO and f-number.

    Parameters
    ----------
    table, folder : path
    output : path
        Table to write, with the shots of the set; ISO and f-number come from the files if `table` does not state them.
    roles : sequence of str
        Roles of the shots in the set; a table may contain several sets.
    size_px : (width, height), optional
        Size of the mosaic from the definition; by default that of the first file. The size of charts in a room is not
        checked here but compared with the camera's reference when they are ingested.
    lens_mm : (focal length, distance of the subject), optional
        Values from the definitions, mm; the focal length in the files must agree.

    Raises
    ------
    InputError
        If a file is missing, truncated, changed since its hash was recorded, or of the wrong size; if exposure time,
        ISO or f-number in the file differ from the table by more than 5 %; if ISO or f-number is unknown for some shots
        and differs among the others; or if a photograph cannot be what the table states, see
        `irodori.ingest.plausibility`. Unlikely photographs are logged only.
    """
    shots = [shot for shot in read_captures(table, folder) if shot.role in roles]
    settled, hashes, seen = {}, {}, SetLook(shots, FocalRange.of(*lens_mm) if lens_mm else None)
    for one in first_looks(seen, table, folder, "check", size_px=size_px):
        if one.refused is not None:
            raise one.refused
        settled[one.shot.file], hashes[one.shot.file] = one.shot, content_sha256(one.path)
        for words in one.warnings:
            LOGGER.warning(words)
    for unlikely in seen.refuse(table):
        LOGGER.warning("%s: %s: %s", unlikely.path, unlikely.doubt.kind, unlikely.doubt.words)
    write_captures(output, settle_set([settled[shot.file] for shot in shots], table), hashes)


class Looked(NamedTuple):
    """A photograph of a set after the first look at it: with ISO and f-number from its file, or why it is refused."""

    shot: Shot
    path: Path
    mosaic: Mosaic | None
    refused: PlainError | None = None
    warnings: Sequence[str] = ()


def first_looks(
    seen: SetLook,
    table,
    folder,
    label: str,
    *,
    size_px=None,
    decoded: Callable[[Shot, Path, Mosaic], None] | None = None,
) -> Iterator[Looked]:
    """Decode the photographs of a set, check each by itself and show it to the checks of the whole set.

    Parameters
    ----------
    seen : SetLook
        Checks of the whole set, with its shots.
    table, folder : path
    label : str
        Name of the photographs in reports of progress.
    size_px : (width, height), optional
        Size from a definition; by default that of the first file. A chart in a room may have any size.
    decoded : callable, optional
        Called with every photograph after it was decoded.
    """
    wanted = None if size_px is None else tuple(side // 2 * 2 for side in size_px)
    numbers = SetNumbers()
    for shot in track(seen.shots, label):
        path = shot_path(shot, table, folder)
        try:
            check_unchanged(table, folder, [shot])
            mosaic = decode(path, shot.linear)
            if decoded is not None:
                decoded(shot, path, mosaic)
            if shot.role != "room-chart":
                wanted = wanted or mosaic.size
                if mosaic.size != wanted:
                    found = f"a mosaic of {mosaic.size[0]} x {mosaic.size[1]} pixels"
                    raise InputError(path, "size", found, f"{wanted[0]} x {wanted[1]} pixels, as its set states")
            settled = settle(shot, mosaic, table)
        except PlainError as refused:
            yield Looked(shot, path, None, refused)
            continue
        seen.see(settled, path, mosaic)
        yield Looked(settled, path, mosaic, None, numbers.warnings(path, mosaic))


class SetNumbers:
    """Warnings about the digital numbers of a set, each for the first photograph that gives rise to it."""

    def __init__(self) -> None:
        self._coarse = self._early = False

    def warnings(self, path, mosaic: Mosaic) -> list[str]:
        """Return the warnings that the next photograph of the set is the first to give rise to."""
        found = []
        if mosaic.full_scale <= _COARSE and not self._coarse:
            self._coarse = True
            found.append(f"{path}: {_COARSE_WARNING}")
        if mosaic.early_clipping and not self._early:
            self._early = True
            found.append(f"{path}: {mosaic.early_clipping}, here and wherever else in its set")
        return found
