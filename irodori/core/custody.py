"""Records of results: the hash of a result's content, the path under which it was written, and its inputs' hashes.

An HDF5 file holds its record in its head (HDF5's user block, which precedes the data and is free for the application),
so that copies of the file keep it. Formats of pictures, tables and pages have no such place in common: their record is
a file beside them, ``.NAME.sha256``, in the form that ``sha256sum --check`` reads. ``irodori verify`` compares all
records of a project.
"""

import argparse
import functools
import hashlib
import json
import os
import shutil
import sys
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from irodori.core.atomic_files import written_whole
from irodori.core.errors import InputError, counted

_MARK = b"irodori "
_HDF5 = b"\x89HDF\r\n\x1a\n"
#: The head's first line is the mark and a hash of all that follows it: the rest of the head, and the data.
_LINE = len(_MARK) + 64 + 1
#: HDF5 looks for its data at 0, 512, 1024, 2048 and so on.
_LEAST_HEAD = 512
_RESULTS = "results"
_DAMAGED = ".damaged"
#: Results that must have a record even where no other result names them; single frames have none.
_RECORDED = (".h5", ".exr", ".png", ".tif")
_FRAMES = ("frames", "frames.part")
#: Tables and descriptions, which rules read too; `irodori verify` does not look for their records.
_READ = (".csv", ".json")
#: Record of a session, which lies beside the photographs that a virtual rig took.
_SESSION = "session.json"
#: Folders with results of an object, a camera or a place that the workflow removes after their last use, if the
#: configuration says so.
_INTERMEDIATE = ("linear", "observations", "brdf")
_SETS = ("cameras", "environments")


@dataclass(frozen=True)
class Record:
    """Record of a result.

    Parameters
    ----------
    sha256 : str
        SHA-256 of the content: 64 hexadecimal digits.
    name : str
        Path under which its rule wrote it, relative to the project's folder.
    inputs : dict
        {path: hash} of the files that it was made from. The hash of an input that is itself a result is that of its
        record.
    accepted : bool
        Whether the user accepted the file after a change (``irodori verify --accept``).
    """

    sha256: str
    name: str = ""
    inputs: Mapping[str, str] = field(default_factory=dict)
    accepted: bool = False

    def text(self) -> bytes:
        """Return the record without its hash as one line of JSON."""
        return json.dumps({"name": self.name, "accepted": self.accepted, "inputs": dict(self.inputs)}).encode()

    @classmethod
    def parsed(cls, sha256: str, text: bytes) -> "Record | None":
        """Return the record with a hash and a line of JSON; None if the line is not that of a record."""
        try:
            values = json.loads(text)
            return cls(sha256, str(values["name"]), dict(values["inputs"]), bool(values["accepted"]))
        except (ValueError, TypeError, KeyError):
            return None


# ---- where records stand


def beside(path) -> Path:
    """Return the path of the record of a file other than HDF5."""
    path = Path(path)
    return path.with_name(f".{path.name}.sha256")


def head_size(name: str, inputs: Mapping[str, str]) -> int:
    """Return the number of bytes that an HDF5 file must reserve before its data for its record: a power of two."""
    needed = _LINE + len(Record("", name, inputs).text()) + 1
    return max(_LEAST_HEAD, 1 << (needed - 1).bit_length())


def write_head(path, name: str, inputs: Mapping[str, str], *, accepted: bool = False) -> None:
    """Write the record of a complete HDF5 file into its head, for which `head_size` bytes were reserved."""
    text = Record("", name, inputs, accepted).text().ljust(head_size(name, inputs) - _LINE, b"\0")
    with open(path, "r+b") as file:
        file.seek(_LINE)
        file.write(text)
        digest = _digest(file, _LINE)
        file.seek(0)
        file.write(_MARK + digest.encode() + b"\n")


def write_record(path, name: str, inputs: Mapping[str, str], *, accepted: bool = False) -> None:
    """Write the record of a complete result beside it; do nothing for an HDF5 file, which holds its own.

    Raises
    ------
    OSError
        If the file is missing or the disk is full.
    """
    path = Path(path)
    if not _has_head(path):
        record = Record(content_sha256(path), name, inputs, accepted)
        with written_whole(beside(path)) as temporary:
            temporary.write_bytes(f"{record.sha256}  {path.name}\n# ".encode() + record.text() + b"\n")


def read_record(path) -> Record | None:
    """Return the record of a file; None if it has no readable record."""
    path = Path(path)
    if _has_head(path):
        with open(path, "rb") as file:
            head = file.read(_LEAST_HEAD)
            while b"\0" not in head and (more := file.read(len(head))):
                head += more
        line, text = head[:_LINE], head[_LINE:].partition(b"\0")[0]
        return Record.parsed(line[len(_MARK) : -1].decode("ascii", "replace"), text)
    try:
        first, _, second = beside(path).read_bytes().partition(b"\n# ")
    except FileNotFoundError:
        return None
    return Record.parsed(first[:64].decode("ascii", "replace"), second)


def _has_head(path: Path) -> bool:
    try:
        with open(path, "rb") as file:
            return file.read(len(_MARK)) == _MARK
    except FileNotFoundError:
        return False


def _data_start(path: Path) -> int | None:
    """Return the offset of an HDF5 file's data in bytes; None for another type of file."""
    size, start = path.stat().st_size, 0
    with open(path, "rb") as file:
        while start < size:
            file.seek(start)
            if file.read(len(_HDF5)) == _HDF5:
                return start
            start = max(_LEAST_HEAD, 2 * start)
    return None


# ---- hashes


def _digest(file, start: int) -> str:
    file.seek(start)
    return hashlib.file_digest(file, "sha256").hexdigest()


def content_sha256(path) -> str:
    """Return the SHA-256 of a file's content: of all that follows the hash in its head, or of a whole file without one.

    Within a process, a file is read again only if its size, inode or one of its times has changed.

    Raises
    ------
    OSError
        If the file cannot be read.
    """
    path = Path(path).absolute()
    found = path.stat()
    return _remembered(path, found.st_size, found.st_mtime_ns, found.st_ctime_ns, found.st_ino)


@functools.lru_cache(maxsize=4096)
def _remembered(path: Path, *_stat: int) -> str:
    start = _LINE if _has_head(path) else 0
    with open(path, "rb") as file:
        return _digest(file, start)


# ---- reading what another rule wrote


def verified(path, *, set_aside: bool = False) -> Record:
    """Return the record of a result after a check that the content has the recorded hash.

    Parameters
    ----------
    path : path
    set_aside : bool
        Whether to rename a file that has changed, so that the next run makes it again.

    Raises
    ------
    InputError
        If it has no record, or another content: truncated, damaged on the disk, or edited.
    OSError
        If it cannot be read.
    """
    path = Path(path)
    record = read_record(path)
    if record is None:
        found = _empty_or_missing(path) or "no hash of its content"
        raise InputError(path, "", found, f"{_as_written(path)}; {_REMOVED}")
    if content_sha256(path) != record.sha256:
        found = _empty_or_missing(path) or "content that its rule did not write"
        accepted = _as_written(path)
        raise InputError(path, "", f"{found} ({_set_aside(path)})" if set_aside else found, accepted)
    return record


_REMOVED = "without the file, the next run makes it again"
_PRESENT = "a result of the files as they are now"
_EMPTY = "an empty file"


def _empty_or_missing(path: Path) -> str | None:
    """Return a phrase for a file that is empty or missing; None for one with content."""
    if not path.is_file():
        return "no such file"
    return None if path.stat().st_size else _EMPTY


def _as_written(path: Path) -> str:
    written = "the file as its rule wrote it"
    if _unacceptable(path) is not None:
        return written
    return f"{written}; to take it as it is: irodori verify --accept {path}"


def received(path, known: dict[str, Record | None]) -> str:
    """Return the hash of a result that a rule is about to read, after a check of the result and all that it depends on.

    A file that has changed since it was written is renamed, so that the next run makes it again.

    Parameters
    ----------
    path : path
    known : dict
        {path: record} of the results that the job has already checked, empty at first; extended here.

    Raises
    ------
    InputError
        As for `verified`; if it was written under another path; if it, or a result that it depends on, was made from
        another version of a file than the present one.
    OSError
        If it cannot be read.
    """
    path = Path(path)
    record = verified(path, set_aside=True)
    if Path(record.name).absolute() != path.absolute():
        raise InputError(path, "", f"a result that was written as {record.name}", f"{_as_written(path)}; {_REMOVED}")
    known[str(path)] = record
    _compare_behind(str(path), record, known)
    return record.sha256


def _compare_behind(path: str, record: Record, known: dict[str, Record | None]) -> None:
    """Compare the recorded hashes of direct and indirect inputs with the inputs' own records; skip missing records."""
    waiting = [(path, record)]
    while waiting:
        made, of = waiting.pop()
        for name, sha256 in of.inputs.items():
            if name not in known:
                known[name] = behind = read_record(name)
                if behind is not None:
                    waiting.append((name, behind))
            behind = known[name]
            if behind is not None and behind.sha256 != sha256:
                found = f"a result of another version of {name}"
                raise InputError(made, "", found, f"a result of the files as they are now; {_REMOVED}")


def _set_aside(path: Path) -> str:
    """Rename a damaged file, remove its record, and return a phrase that describes what was done."""
    aside = path.with_name(path.name + _DAMAGED)
    try:
        os.replace(path, aside)
        beside(path).unlink(missing_ok=True)
    except FileNotFoundError:
        return "another job has set it aside"
    except OSError as error:
        return f"cannot be set aside, remove it: {error.strerror}"
    return f"set aside as {aside.name}, so that the next run makes it again; renamed back, it can be accepted as it is"


def _unacceptable(path: Path) -> InputError | None:
    """Return the reason why a file cannot be taken as it is; None for a result with content."""
    if (found := _empty_or_missing(path)) is not None:
        return InputError(path, "", found, f"a complete file; {_REMOVED}" if found == _EMPTY else "a result")
    if _data_start(path) is None and (_has_head(path) or path.suffix == ".h5"):
        found = "nothing but the head of an HDF5 file" if _has_head(path) else "no data of an HDF5 file"
        return InputError(path, "", found, "a complete file")
    if read_record(path) is None and not _may_lack_record(path):
        return InputError(path, "", "no record of a result", "a result, which has a record")
    return None


def _may_lack_record(path: Path) -> bool:
    """Return whether a file without a record is of a kind that rules write and read: its record has been lost."""
    top = _results_folder(path.parent)
    return top is not None and (_needs_record(path) or (path.suffix in _READ and path.parent.absolute() != top))


def _needs_record(path: Path) -> bool:
    """Return whether a file in the folder ``results`` must have a record even where no other result names it."""
    return path.suffix in _RECORDED and path.parent.name not in _FRAMES


def accept(path) -> bool:
    """Accept a changed result: write a record of its present content, with the inputs of its earlier record.

    Its modification time becomes the present, so that Snakemake reruns what depends on it. A result that has not
    changed stays as it is.

    Returns
    -------
    bool
        Whether the result had changed.

    Raises
    ------
    InputError
        If there is no such file, if it is empty or no result, or if an HDF5 file has lost its data.
    OSError
        If it cannot be read or written.
    """
    path = Path(path)
    if (fault := _unacceptable(path)) is not None:
        raise fault
    known, start = read_record(path), _data_start(path)
    name, inputs = _name(path), known.inputs if known else {}
    in_place = _results_folder(path.parent) is None or (known is not None and known.name == name)
    if known is not None and in_place and content_sha256(path) == known.sha256:
        return False
    if start is None:
        write_record(path, name, inputs, accepted=True)
        os.utime(path)
        return True
    with written_whole(path) as temporary:
        with open(path, "rb") as file, open(temporary, "wb") as out:
            out.write(bytes(head_size(name, inputs)))
            file.seek(start)
            shutil.copyfileobj(file, out, 1 << 20)
        write_head(temporary, name, inputs, accepted=True)
    return True


# ---- all records of a project


def _results_folder(path: Path) -> Path | None:
    """Return the folder ``results`` that is a path or contains it; None if there is none."""
    path = path.absolute()
    return next((folder for folder in (path, *path.parents) if folder.name == _RESULTS), None)


def _name(path: Path) -> str:
    """Return a result's path relative to the project's folder."""
    folder = _results_folder(path.parent)
    return str(path if folder is None else path.absolute().relative_to(folder.parent))


def _is_intermediate(path: Path) -> bool:
    """Return whether a file is of a kind that the workflow removes without `keep_intermediate`."""
    in_folder = path.parent.name in _INTERMEDIATE and path.parent.parent.parent.name in (_RESULTS, *_SETS)
    return in_folder and path.suffix == ".h5"


def _may_be_removed(path: Path) -> bool:
    """Return whether a file is missing, and the workflow may have removed it."""
    return _is_intermediate(path) and not path.is_file()


class Chain:
    """Records of all results of a project.

    Parameters
    ----------
    folder : path
        The folder ``results``, or a folder in it, to check only the results there.

    Raises
    ------
    InputError
        If there is no such folder.
    """

    def __init__(self, folder) -> None:
        self.folder = Path(folder)
        if not self.folder.is_dir():
            raise InputError(self.folder, "", "no such folder", "a folder of results")
        self._top = _results_folder(self.folder) or self.folder.absolute()
        self.accepted: list[Path] = []
        self.removed: set[Path] = set()
        #: Intermediate files of other versions of their inputs, from which no present result was made.
        self.left_over: list[Path] = []
        self._seen: set[Path] = set()
        #: Files that are missing or damaged, or in another's place: what was made from them is not to blame.
        self._wrong: set[Path] = set()

    def __len__(self) -> int:
        return len(self._seen) - len(self.left_over)

    def _place(self, name: str) -> Path:
        """Return the path of a file that a record names, also if the folder ``results`` was moved."""
        parts = Path(name).parts
        return self._top.joinpath(*parts[1:]) if parts[:1] == (_RESULTS,) else self._top.parent / name

    def results(self) -> Iterator[Path]:
        """Yield the files that are results: those that have a record, and those that must have one."""
        return self._results_in(self.folder.absolute())

    @staticmethod
    def _results_in(folder: Path) -> Iterator[Path]:
        for path in sorted(folder.rglob("*")):
            if path.name.startswith("."):
                result = path.with_name(path.name[1:].removesuffix(".sha256"))
                if path.suffix == ".sha256" and result.is_file():
                    yield result
            elif _needs_record(path) and not path.is_dir():
                yield path

    def broken(self, paths: Iterable[Path] | None = None) -> Iterator[str]:
        """Yield a sentence on each result that does not match its record or its inputs, those of early stages first.

        Parameters
        ----------
        paths : iterable of path, optional
            Results to look at, with everything from which they were made. All results where absent.
        """
        for path in self.results() if paths is None else paths:
            yield from self._broken_before(path.absolute())

    def made_from(self, paths: Iterable[Path]) -> tuple[list[Path], list[Path]]:
        """Return everything from which some results were made.

        Parameters
        ----------
        paths : iterable of path
            Results.

        Returns
        -------
        results : list of path
            The given results and those from which they were made, sorted.
        given : list of path
            Files of the user from which they were made, sorted.

        Raises
        ------
        InputError
            If an intermediate result was removed (`keep_intermediate` of the configuration).
        """
        results: set[Path] = set()
        given: set[Path] = set()
        waiting = [path.absolute() for path in paths]
        while waiting:
            path = waiting.pop()
            if path in results or path in given:
                continue
            if _may_be_removed(path):
                raise InputError(path, "", "a result that was removed", "keep_intermediate: true, and snakemake again")
            record = read_record(path)
            (given if record is None else results).add(path)
            waiting += [self._place(name) for name in record.inputs] if record else []
        return sorted(results), sorted(given)

    @functools.cached_property
    def _used(self) -> set[Path]:
        """Intermediate files of the project from which other results were made, directly or not."""
        waiting = [path for path in self._results_in(self._top) if not _is_intermediate(path)]
        used: set[Path] = set()
        while waiting:
            record = _readable_record(waiting.pop())
            behind = {self._place(name) for name in record.inputs} if record else set()
            new = {file for file in behind - used if _is_intermediate(file)}
            used |= new
            waiting += new
        return used

    def _is_left_over(self, path: Path) -> bool:
        """Return whether no run makes an intermediate file again, although an input has changed since it was made.

        Such is the linear picture of a pose that has another name now, or was taken out of the table, or what was made
        from it. Present results were then made of other files of the set, from the inputs as they are now. A file is
        not left over if there are no such results: they may be still to come, or were removed. Nor is it if an input is
        gone.
        """
        if not _is_intermediate(path) or path in self._used:
            return False
        in_use = [_inputs_of(file) for file in self._used if file.parent.parent == path.parent.parent]
        changed = False
        for name, sha256 in _inputs_of(path).items():
            file = self._place(name)
            if _may_be_removed(file):
                continue
            present = _present_sha256(file)
            if present is None or any(inputs.get(name, present) != present for inputs in in_use):
                return False
            changed = changed or present != sha256 or self._is_left_over(file)
        return changed and bool(in_use)

    def _broken_before(self, path: Path) -> Iterator[str]:
        if path in self._seen:
            return
        self._seen.add(path)
        is_left_over = self._is_left_over(path)
        record = _readable_record(path)
        behind = {name: self._place(name) for name in record.inputs} if record else {}
        for file in behind.values():
            if _may_be_removed(file):
                if not is_left_over:
                    self.removed.add(file)
            elif _readable_record(file) is not None or (self._top in file.parents and _needs_record(file)):
                yield from self._broken_before(file)
        if is_left_over:
            self.left_over.append(path)
            return
        if (fault := self._fault(path, record)) is not None:
            self._wrong.add(path)
            yield str(fault)
            return
        assert record is not None  # `_fault` returns one for a file without
        if record.accepted:
            self.accepted.append(path)
        if self._place(record.name) != path:
            self._wrong.add(path)
            yield str(InputError(path, "", f"a result that was written as {record.name}", _as_written(path)))
        for name, file in behind.items():
            if file in self._wrong or file in self.removed:
                continue
            if _present_sha256(file) != record.inputs[name]:
                yield str(self._changed_behind(path, record, name))

    def _fault(self, path: Path, record: Record | None) -> InputError | None:
        """Return what is wrong with the content of a result; None if it is as its rule wrote it."""
        if not path.exists():
            accepted = f"{_PRESENT}: run snakemake {record.name if record else _name(path)}"
            return InputError(path, "", "no such file", accepted)
        try:
            verified(path)
        except InputError as error:
            return error
        except OSError as error:
            return InputError(path, "", f"no file that can be read ({error.strerror})", _as_written(path))
        return None

    def _changed_behind(self, path: Path, record: Record, name: str) -> InputError:
        """Return the sentence on a result's input that has changed or is gone: it names the one that is to blame."""
        behind = self._place(name)
        found = _empty_or_missing(behind)
        if path.name == _SESSION and behind.parent == path.parent:  # a photograph that the program took
            self._wrong.add(behind)
            accepted = f"the photograph as it was taken: a copy, or a new one by snakemake --forcerun {record.name}"
            return InputError(behind, "", found or f"content that does not match its hash in {record.name}", accepted)
        if found == _EMPTY:
            self._wrong.add(behind)
            return InputError(behind, "", found, f"the file that {record.name} was made from")
        what = "which has changed since" if found is None else "which is gone"
        return InputError(path, "", f"a result of {name}, {what}", f"{_PRESENT}: run snakemake")


def _readable_record(path: Path) -> Record | None:
    """Return the record of a file; None also if there is a folder, or a file that cannot be read."""
    try:
        return read_record(path)
    except OSError:
        return None


def _inputs_of(path: Path) -> Mapping[str, str]:
    """Return {path: hash} of the recorded inputs of a file; empty if it has no readable record."""
    record = _readable_record(path)
    return record.inputs if record else {}


def _present_sha256(path: Path) -> str | None:
    """Return the hash in a file's record, or that of the content of a file without; None if it cannot be read."""
    try:
        record = read_record(path)
        return content_sha256(path) if record is None else record.sha256
    except OSError:
        return None


def main(arguments: list[str] | None = None, prog: str = "irodori verify") -> int:
    """Compare every result with its recorded hash and with the files that it was made from, back to your own files.

    Everything that differs is printed, one line each, and the exit status is 1. Files that are left over from other
    photographs or poses, from which no present result was made, are listed too and change no status.
    """
    parser = argparse.ArgumentParser(prog=prog, description=main.__doc__)
    parser.add_argument("folder", nargs="?", help="the folder of results, or one in it")
    parser.add_argument("--accept", metavar="FILE", help="take a result as it is, from now on")
    asked = parser.parse_args(arguments)
    try:
        if asked.accept is not None:
            if not accept(asked.accept):
                print(f"{asked.accept}: unchanged, nothing to accept")
            if asked.folder is None:
                return 0
        chain = Chain(asked.folder or _RESULTS)
        differs = False
        for said in chain.broken():
            differs = True
            print(said)
        for path in chain.left_over:
            print(
                f"{path}: left over: its inputs have changed since, and no present result was made from it; remove it"
            )
    except BrokenPipeError:  # nobody reads the output: `irodori.command_line` ends
        raise
    except (InputError, OSError) as error:
        print(error)
        return 1
    if differs:
        return 1
    print("".join(f"{path}: taken as it is\n" for path in chain.accepted), end="")
    removed = f"; {len(chain.removed)} intermediate files are not kept" if chain.removed else ""
    print(f"every link holds ({counted(len(chain), 'result')}{removed})")
    return 0


if __name__ == "__main__":
    sys.exit(main())
