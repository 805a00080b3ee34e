"""Append-only table of a session: one line per photograph, on disk before the next is taken."""

import contextlib
import csv
import fcntl
import io
import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from irodori.capture.rig.devices import DeviceError
from irodori.config.capture_table import COLUMNS, EXTRA_COLUMNS, Shot, read_captures, shot_cells
from irodori.core.atomic_files import append_line, file_sha256, sync_folder, written_whole
from irodori.core.confined_paths import confined
from irodori.core.errors import InputError
from irodori.core.progress import LOGGER, track

_NAMES = (*COLUMNS, *EXTRA_COLUMNS)
_HEADER = ",".join(_NAMES) + "\n"
#: Columns that identify a photograph; the others describe its capture. Tables of earlier versions have only these.
_FIRST_NAMES = (*COLUMNS, "iso", "f_number", "sha256")
_HEADERS = (_HEADER, ",".join(_FIRST_NAMES) + "\n")
_HASH_DIGITS = 64  # of a SHA-256 in hexadecimal
#: Table of photographs that a changed plan no longer requires; their files are kept.
RETIRED = "captures-retired.csv"
#: End of the name of a table's list of photographs after which the rig was not compared with its limit switches.
UNCHECKED = "-unchecked.txt"


class StorageError(DeviceError):
    """Error for a full disk, or a folder that cannot be written."""


@contextlib.contextmanager
def storing(path) -> Iterator[None]:
    """Turn an OSError in the block into a `StorageError` with a one-sentence message.

    Raises
    ------
    StorageError
    """
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error) or type(error).__name__
        raise StorageError(f"{path}: cannot be stored: {reason}; what was taken before stays") from None


@contextlib.contextmanager
def claimed(table, folder, owner: str) -> Iterator[None]:
    """Lock a table and a folder for one session, and reserve them permanently for the photographs of one subject.

    File names depend on pose and exposure only: in one folder, the photographs of two objects could be confused.

    Parameters
    ----------
    table, folder : path
    owner : str
        The subject, such as ``object jar``; it is written into a file ``.session`` in the folder.

    Raises
    ------
    DeviceError
        If another session has the lock.
    InputError
        If the folder or the table belongs to another subject, or the file ``.session`` is a link out of the folder.
    StorageError
    """
    table, folder = Path(table), Path(folder)
    marks = [confined(folder, ".session", folder, "")]
    if table.parent.absolute() != folder.absolute():
        marks.append(confined(table.parent, f".{table.name}.session", table, ""))
    with contextlib.ExitStack() as stack:
        for mark in marks:
            with storing(mark):
                mark.parent.mkdir(parents=True, exist_ok=True)
                file = stack.enter_context(open(mark, "a+b"))
                try:
                    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                except BlockingIOError:
                    raise DeviceError(f"{mark.parent}: another session is at work there; let it end first") from None
                file.seek(0)
                known = _subject(file.read(), mark, owner)
                if not known:
                    file.write(f"{owner}\n".encode())
                    file.flush()
            if known not in ("", owner):
                found = f"the photographs of the {known}"
                accepted = f"a folder and a table for the {owner} alone, or {mark} removed where it was renamed"
                raise InputError(mark.parent, "", found, accepted)
        yield


def _subject(content: bytes, mark: Path, owner: str) -> str:
    """Return the subject in a file ``.session``; an empty string for an empty file.

    Raises
    ------
    InputError
        If the content is no text, or has several lines.
    """
    known = content.decode("utf-8", "replace").strip()
    if "\N{REPLACEMENT CHARACTER}" in known or not known.isprintable():
        raise InputError(mark, "", "something else than the name of a subject", f"{owner}, or no such file")
    return known


def _lines(rows: Iterable[Sequence]) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()


def _cells(shot: Shot, sha256: str) -> list[str]:
    return [str(cell) for cell in shot_cells(shot, sha256)]


def _identity(cells: Sequence[str]) -> list[str]:
    return [cell for name, cell in zip(_NAMES, cells, strict=True) if name in _FIRST_NAMES]


def _temporary(path: Path) -> Path:
    return path.with_name(f".{path.name}.part")


def _write_table(path: Path, rows: Iterable[Sequence]) -> None:
    """Write a table under a temporary name, and rename it once it is on the disk."""
    temporary = _temporary(path)
    with storing(path):
        with open(temporary, "w", encoding="utf-8", newline="") as out:
            out.write(_HEADER + _lines(rows))
            out.flush()
            os.fsync(out.fileno())
        os.replace(temporary, path)
        sync_folder(path.parent)


class Journal:
    """Capture table to which lines are appended.

    Parameters
    ----------
    table : path
        ``captures.csv``. An existing table is continued: an incomplete last line left by a crash is removed, and so is
        the line of a file that is missing or has changed, so that the photograph is taken again; each is logged. A
        changed file is renamed and not deleted. Lines without a hash, written by a person, are kept until `retire`.
    folder : path, optional
        Folder of the RAW files; by default that of the table.

    Raises
    ------
    InputError
        If the table exists and is not a capture table, lists a file outside the folder, or if none of its photographs
        exists (a disk that is not mounted, a folder that was moved).
    StorageError
    """

    def __init__(self, table, folder=None) -> None:
        self.table = Path(table)
        self.folder = self.table.parent if folder is None else Path(folder)
        self.retired = self.table.with_name(RETIRED)
        self._unchecked = self.table.with_name(f"{self.table.stem}{UNCHECKED}")
        self.shots: dict[str, Shot] = {}
        self.sha256: dict[str, str] = {}
        self._unhashed: dict[str, Shot] = {}
        with storing(self.table):
            for needed in (self.table.parent, self.folder):
                needed.mkdir(parents=True, exist_ok=True)
            for table_file in (self.table, self.retired):
                _temporary(table_file).unlink(missing_ok=True)
            content = self.table.read_bytes() if self.table.exists() else b""
        self._continue(content)

    def _continue(self, content: bytes) -> None:
        whole = content[: content.rfind(b"\n") + 1]
        first = (whole or content).decode("utf-8-sig", errors="replace").splitlines()[:1]
        known = [h for h in _HEADERS if first and (first[0] == h.strip() or (not whole and h.startswith(first[0])))]
        if first and not known:
            raise InputError(self.table, "line 1", "another header", f"the table of a session: {_HEADER.strip()}")
        if not whole:
            self._rewrite()
            return
        if whole != content:
            whole = self._end_last_line(whole, content[len(whole) :], first[0])
        if not whole.partition(b"\n")[2].strip():
            if _HEADER not in known:
                self._rewrite()
            return
        shots = read_captures(self.table)
        listed = csv.DictReader(io.StringIO(whole.decode("utf-8-sig")))
        digests = {row["file"]: row["sha256"] for row in listed}
        # A sitting may have ended while it set all photographs aside.
        names = (one for file, sha256 in digests.items() for one in (file, _aside(file, "doubtful", sha256)))
        if len(digests) > 1 and not any(self._path(one).exists() for one in names):
            found = f"none of the {len(digests)} photographs of {self.table}"
            raise InputError(self.folder, "", found, "the folder of its RAW files; to begin anew, remove the table")
        for shot in track(shots, f"{self.table}: looking at the files"):
            if not self._path(shot.file).is_file():
                LOGGER.warning("%s is gone; it is taken again where it is asked for", self._path(shot.file))
            elif not digests[shot.file]:
                self._unhashed[shot.file] = shot
            elif self._is_unchanged(shot, digests[shot.file]):
                self.shots[shot.file], self.sha256[shot.file] = shot, digests[shot.file]
        if len(self.shots) + len(self._unhashed) < len(digests) or _HEADER not in known:
            self._rewrite()

    def _end_last_line(self, whole: bytes, last: bytes, header: str) -> bytes:
        """End a last line without a line break if it is complete, otherwise remove it; return the table's content."""
        is_kept = _is_complete(last, header)
        if not is_kept and last.strip():
            LOGGER.warning(
                "%s: its last line is incomplete and was removed: %s", self.table, last.decode(errors="replace")
            )
        with storing(self.table), open(self.table, "r+b") as out:
            out.truncate(len(whole) + (len(last) if is_kept else 0))
            out.seek(0, os.SEEK_END)
            out.write(b"\n" if is_kept else b"")
            out.flush()
            os.fsync(out.fileno())
        return whole + last + b"\n" if is_kept else whole

    def _path(self, file: str) -> Path:
        """Return the path of a photograph; raise an error if it is outside the session's folder."""
        return confined(self.folder, file, self.table, "file")

    def _is_unchanged(self, shot: Shot, digest: str) -> bool:
        path = self._path(shot.file)
        found = file_sha256(path)
        if found != digest:
            # Under its name it would be taken for a photograph that has lost its line in a crash.
            aside = self.set_aside(shot.file, "changed", found)
            LOGGER.warning("%s has changed on the disk; it is kept as %s and taken again", path, aside)
        return found == digest

    def set_aside(self, file: str, why: str, sha256: str) -> str:
        """Rename a file so that it is not taken for a photograph of a plan, and return its new name.

        Raises
        ------
        InputError
            If the file is not in the session's own folder.
        StorageError
        """
        path, aside = self._path(file), _aside(file, why, sha256)
        with storing(self.folder / aside):
            os.replace(path, self.folder / aside)
            sync_folder(self.folder)
        return aside

    def _rewrite(self) -> None:
        lines = {**self.shots, **self._unhashed}
        _write_table(self.table, (_cells(shot, self.sha256.get(file, "")) for file, shot in lines.items()))

    def _retired_rows(self) -> dict[str, list[str]]:
        """Return {file: line} of ``captures-retired.csv``, a log that may have lines of several plans."""
        if not self.retired.exists():
            return {}
        accepted = "the log as it was written, or no such file"
        try:
            with open(self.retired, encoding="utf-8", newline="") as file:
                rows = [[row.get(name) or "" for name in _NAMES] for row in csv.DictReader(file)]
                return {row[0]: row for row in rows}
        except (UnicodeDecodeError, csv.Error) as error:
            raise InputError(self.retired, "", f"unreadable text ({error})", accepted) from None
        except OSError as error:
            raise InputError(self.retired, "", f"no file that can be read ({error.strerror})", accepted) from None

    def retire(self, planned: Sequence[Shot]) -> list[Shot]:
        """Move the lines of photographs that a plan does not require to ``captures-retired.csv``; keep their files.

        If the plan needs a file's name for another photograph (another sensitivity, another pose of the chart), the
        file is renamed, and listed under its new name. A line without a hash that agrees with the plan is removed too,
        and its file is left to `stray`: the details in the line were typed and not measured.

        Returns
        -------
        list of Shot
            The retired photographs.
        """
        wanted = {shot.file: shot for shot in planned}
        retired = [shot for shot in self.shots.values() if wanted.get(shot.file) != shot]
        retired += [shot for shot in self._unhashed.values() if not _agrees(shot, wanted.get(shot.file))]
        if not retired and not self._unhashed:
            return []
        rows, renamed = self._retired_rows(), []
        for shot in retired:
            digest = self.sha256.get(shot.file) or self._hash(shot.file)
            name = _aside(shot.file, "retired", digest) if shot.file in wanted else shot.file
            rows[name] = _cells(replace(shot, file=name), digest)
            if name != shot.file:
                renamed.append((shot.file, digest))
        # Listed first: after a crash before the rename the table still has them; after one behind it, only the file
        # named in the table is missing.
        if retired:
            _write_table(self.retired, rows.values())
        for file, digest in renamed:
            self.set_aside(file, "retired", digest)
        for shot in retired:
            self.shots.pop(shot.file, None)
            self.sha256.pop(shot.file, None)
        self._unhashed.clear()
        self._rewrite()
        return retired

    def make_way(self, file: str) -> None:
        """Retire a photograph for a newer one: move its line to ``captures-retired.csv`` and rename its file."""
        digest = self.sha256[file]
        rows, name = self._retired_rows(), _aside(file, "retaken", digest)
        rows[name] = _cells(replace(self.shots[file], file=name), digest)
        _write_table(self.retired, rows.values())
        self.set_aside(file, "retaken", digest)
        del self.shots[file], self.sha256[file]
        self._rewrite()

    def _hash(self, file: str) -> str:
        path = self._path(file)
        with storing(path):
            return file_sha256(path)

    def stray(self, shot: Shot) -> Path | None:
        """Return the file with a photograph's name but without a line; None if there is none, or it is another's.

        A retired photograph is returned if it is exactly the required one; another one with that name is renamed.
        """
        path = self._path(shot.file)
        if not path.is_file():
            return None
        rows = self._retired_rows()
        if shot.file in rows:
            digest = file_sha256(path)
            if _identity(rows[shot.file]) != _identity(_cells(shot, digest)):
                name = _aside(shot.file, "retired", digest)
                rows[name] = [name, *rows[shot.file][1:]]
                _write_table(self.retired, rows.values())
                self.set_aside(shot.file, "retired", digest)
                return None
        return path

    def append(self, shot: Shot, sha256: str) -> None:
        """Append the line of a photograph with a complete file; the line is on the disk when this method returns."""
        with storing(self.table):
            sync_folder(self.folder)
            # Not "a", which would create a table without a header if somebody had removed it.
            with open(self.table, "r+b") as out:
                out.seek(0, os.SEEK_END)
                out.write(_lines([_cells(shot, sha256)]).encode())
                out.flush()
                os.fsync(out.fileno())
        self.shots[shot.file], self.sha256[shot.file] = shot, sha256

    @property
    def unchecked(self) -> dict[str, str]:
        """Photographs whose angles no search for lost steps has confirmed: {file: ID of the homing before it}.

        Raises
        ------
        StorageError
        """
        marks = self._marks()
        named = {file: (file, self.sha256.get(file, "")) for file in self.shots}
        return {file: marks[one] for file, one in named.items() if one in marks}

    def _marks(self) -> dict[tuple[str, str], str]:
        """Return {(file, hash of its content): ID of the homing before it}."""
        if not self._unchecked.exists():
            return {}
        with storing(self._unchecked):
            lines = self._unchecked.read_text(encoding="utf-8", errors="replace").split("\n")
        parts = [line.split(" ", 2) for line in lines]
        return {(part[2], part[1]): part[0] for part in parts if len(part) == 3}

    def leave_unchecked(self, file: str, sha256: str, homing: str) -> None:
        """Mark a photograph as `unchecked`, before it has its name; the mark outlasts the sitting."""
        with storing(self._unchecked):
            append_line(self._unchecked, f"{homing} {sha256} {file}")

    def checked(self, files: Iterable[str]) -> None:
        """Remove the marks of photographs: they are confirmed, a person has kept them, or they are set aside."""
        gone = set(files)
        left = [f"{homing} {sha256} {file}\n" for (file, sha256), homing in self._marks().items() if file not in gone]
        with storing(self._unchecked):
            if left:
                with written_whole(self._unchecked) as temporary, open(temporary, "w", encoding="utf-8") as out:
                    out.writelines(left)
                    out.flush()
                    os.fsync(out.fileno())
            else:
                self._unchecked.unlink(missing_ok=True)
            sync_folder(self.table.parent)

    def drop(self, files: Iterable[str], why: str) -> None:
        """Rename the files of photographs and remove their lines, so that they are taken again.

        Raises
        ------
        StorageError
        """
        # Renamed first: after a crash, a file without a line would be adopted, but a line without a file is dropped.
        for file in files:
            self.set_aside(file, why, self.sha256.pop(file))
            del self.shots[file]
        self._rewrite()

    def accept(self, files: Iterable[str], reason: str) -> None:
        """Record the reason to keep doubtful photographs.

        Raises
        ------
        StorageError
        """
        for file in files:
            shot = self.shots[file]
            self.shots[file] = replace(shot, taken=replace(shot.taken, accepted=reason))
        self._rewrite()

    def missing(self, planned: Sequence[Shot]) -> list[Shot]:
        """Return the photographs of a plan that the table lacks, in the order of the plan."""
        return [shot for shot in planned if shot.file not in self.shots]

    def finish(self, planned: Sequence[Shot]) -> None:
        """Put the table into the order of the plan, as if the session had never been interrupted.

        Raises
        ------
        ValueError
            If a photograph is missing.
        """
        if missing := self.missing(planned):
            raise ValueError(f"{len(missing)} photographs are missing, the first {missing[0].file}")
        if list(self.shots) != [shot.file for shot in planned]:
            self.shots = {shot.file: self.shots[shot.file] for shot in planned}
            self._rewrite()
        rows = self._retired_rows()
        if left := [row for file, row in rows.items() if file not in self.shots]:
            if len(left) < len(rows):
                _write_table(self.retired, left)
        else:
            self.retired.unlink(missing_ok=True)


def _is_complete(line: bytes, header: str) -> bool:
    """Return whether a line has a cell for every column of the header, with a whole hash or none."""
    try:
        cells = next(csv.reader([line.decode()], strict=True), [])
    except (UnicodeDecodeError, csv.Error):
        return False
    row = dict(zip(names := header.split(","), cells, strict=False))
    return len(cells) == len(names) and len(row["sha256"].strip()) in (0, _HASH_DIGITS)


def _agrees(line: Shot, wanted: Shot | None) -> bool:
    """Return whether a line written by a person describes a required photograph; empty settings agree with any."""
    if wanted is None:
        return False
    settings = {name: getattr(line, name) or getattr(wanted, name) for name in ("iso", "f_number")}
    return replace(line, **settings) == wanted


def _aside(file: str, why: str, sha256: str) -> str:
    path = Path(file)
    return f"{path.stem}-{why}-{sha256[:8]}{path.suffix}"
