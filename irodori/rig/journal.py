"""The table of a session as it grows: one line a photograph, on the disk before the next is taken."""

import csv
import io
import os
from collections.abc import Sequence
from pathlib import Path

from irodori.captures import COLUMNS, EXTRA_COLUMNS, Shot, read_captures, shot_cells, write_captures
from irodori.errors import InputError
from irodori.provenance import file_sha256

_HEADER = ",".join((*COLUMNS, *EXTRA_COLUMNS)) + "\n"
#: Photographs that a changed plan no longer asks for; their files stay.
RETIRED = "captures-retired.csv"


def _sync_folder(folder: Path) -> None:
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


class Journal:
    """A capture table to which lines are appended.

    Parameters
    ----------
    table : path
        ``captures.csv``. An existing table is continued: a line that a crash tore is removed, lines whose file is gone
        or has changed are dropped, so that the photograph is taken again.
    folder : path, optional
        Folder of the RAW files; that of the table where None.

    Raises
    ------
    InputError
        If the table exists and is no capture table.
    """

    def __init__(self, table, folder=None) -> None:
        self.table = Path(table)
        self.folder = self.table.parent if folder is None else Path(folder)
        for needed in (self.table.parent, self.folder):
            needed.mkdir(parents=True, exist_ok=True)
        self.shots: dict[str, Shot] = {}
        self.sha256: dict[str, str] = {}
        if self.table.exists():
            self._continue()
        else:
            self._rewrite()

    def _continue(self) -> None:
        content = self.table.read_bytes()
        whole = content[: content.rfind(b"\n") + 1]
        if not whole:
            self._rewrite()
            return
        if whole.decode("utf-8-sig", errors="replace").splitlines()[0] != _HEADER.strip():
            raise InputError(self.table, "line 1", "another header", f"the table of a session: {_HEADER.strip()}")
        if whole != content:
            os.truncate(self.table, len(whole))
        if whole.count(b"\n") == 1:
            return
        digests = {row["file"]: row["sha256"] for row in csv.DictReader(io.StringIO(whole.decode("utf-8-sig")))}
        for shot in read_captures(self.table):
            path = self.folder / shot.file
            if path.is_file() and file_sha256(path) == digests[shot.file]:
                self.shots[shot.file], self.sha256[shot.file] = shot, digests[shot.file]
        if len(self.shots) < len(digests):
            self._rewrite()

    def _rewrite(self) -> None:
        write_captures(self.table, self.shots.values(), self.sha256)
        _sync_folder(self.table.parent)

    def retire(self, planned: Sequence[Shot]) -> list[Shot]:
        """Take out the photographs that a plan does not ask for; they go to ``captures-retired.csv``, the files stay.

        Returns
        -------
        list of Shot
            Those taken out.
        """
        wanted = {shot.file: shot for shot in planned}
        retired = [shot for shot in self.shots.values() if wanted.get(shot.file) != shot]
        if retired:
            path = self.table.with_name(RETIRED)
            kept = {shot.file: shot for shot in read_captures(path)} if path.exists() else {}
            kept.update({shot.file: shot for shot in retired})
            write_captures(path, kept.values())
            for shot in retired:
                del self.shots[shot.file], self.sha256[shot.file]
            self._rewrite()
        return retired

    def append(self, shot: Shot, sha256: str) -> None:
        """Note a photograph whose file stands under its name; the line is on the disk when this returns."""
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerow(shot_cells(shot, sha256))
        _sync_folder(self.folder)
        with open(self.table, "ab") as out:
            out.write(text.getvalue().encode())
            out.flush()
            os.fsync(out.fileno())
        self.shots[shot.file], self.sha256[shot.file] = shot, sha256

    def missing(self, planned: Sequence[Shot]) -> list[Shot]:
        """Return the photographs of a plan that are not there, in its order."""
        return [shot for shot in planned if shot.file not in self.shots]

    def finish(self, planned: Sequence[Shot]) -> None:
        """Put the table into the order of the plan, as if nothing had ever broken it off."""
        self.shots = {shot.file: shot for shot in planned}
        self._rewrite()
