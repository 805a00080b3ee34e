"""A result appears whole or not at all."""

import errno
import subprocess
import sys

import pytest

from irodori.core.atomic_files import DiskError, written_whole


def test_a_file_takes_its_name_only_when_it_is_complete(tmp_path):
    path = tmp_path / "errors.csv"
    path.write_text("old")
    with pytest.raises(RuntimeError), written_whole(path) as temporary:
        temporary.write_text("half")
        raise RuntimeError
    assert path.read_text() == "old"
    with written_whole(path) as temporary:
        temporary.write_text("new")
        assert path.read_text() == "old" and temporary.suffix == ".csv"
    assert path.read_text() == "new" and [p.name for p in tmp_path.iterdir()] == ["errors.csv"]


@pytest.mark.parametrize(
    "error",
    [
        OSError(errno.ENOSPC, "No space left on device"),
        OSError(errno.EROFS, "Read-only file system"),
        RuntimeError("unable to close file (file write failed: errno = 28, error message = 'No space left on device')"),
    ],
)
def test_a_disk_that_takes_no_more_is_told_in_one_sentence(tmp_path, error):
    told = pytest.raises(DiskError, match=r"table\.csv: cannot be stored: (No space left|Read-only)")
    with told, written_whole(tmp_path / "table.csv") as temporary:
        temporary.write_text("half")
        raise error
    assert not list(tmp_path.iterdir())


def test_what_another_file_lacks_is_not_blamed_on_the_disk(tmp_path):
    with pytest.raises(FileNotFoundError), written_whole(tmp_path / "table.csv"):
        (tmp_path / "absent").read_text()


_FILL = """
import resource, signal, sys
import numpy as np
from irodori.core import store
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 18, 1 << 18))
try:
    with store.create(sys.argv[1], store.Provenance("test")) as out:
        values = np.random.default_rng(0).random((256, 1024))
        out.write("a", values, units="1", dims="row,column", quantity="noise")
except OSError as error:
    print(type(error).__name__, error)
"""


def test_a_file_of_hdf5_that_finds_no_room_says_so(tmp_path):
    path = tmp_path / "map.h5"
    done = subprocess.run([sys.executable, "-c", _FILL, str(path)], capture_output=True, text=True)
    assert done.stdout.startswith(f"DiskError {path}: cannot be stored: File too large"), done.stdout + done.stderr
    assert not list(tmp_path.iterdir())


def test_a_writer_that_was_left_behind_cannot_replace_what_its_successor_wrote(tmp_path):
    path = tmp_path / "front.[1].exr"
    with pytest.raises(FileNotFoundError), written_whole(path) as orphan:
        orphan.write_text("the orphan's")
        with written_whole(path) as successor:
            successor.write_text("the successor's")
    assert path.read_text() == "the successor's" and len(list(tmp_path.iterdir())) == 1


def test_writers_of_other_files_are_left_alone(tmp_path):
    with written_whole(tmp_path / "front.png") as one, written_whole(tmp_path / "front.exr") as other:
        one.write_text("png")
        other.write_text("exr")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["front.exr", "front.png"]
