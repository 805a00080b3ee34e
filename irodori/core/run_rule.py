"""Context manager that every rule's script runs in: log, threads and provenance."""

import gc
import importlib.util
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from irodori.core.custody import Record, content_sha256, received, write_record
from irodori.core.progress import rule_log
from irodori.core.provenance import config_hash
from irodori.core.store import Provenance
from irodori.core.threads import use_threads

#: Parameters that make Snakemake see an edit of the package or of the user's files.
_NOT_SETTINGS = ("code", "user_files", "altered")

#: Parts of NumPy that no rule uses. SciPy copies all names of NumPy, which loads them: an eighth of its time.
_LEFT = ("f2py", "testing")


def _load_late(names: tuple[str, ...]) -> None:
    """Load these parts of NumPy only when something is taken from them."""
    for name in names:
        spec = importlib.util.find_spec(f"numpy.{name}")
        if spec is None or spec.loader is None or spec.name in sys.modules:
            continue
        spec.loader = importlib.util.LazyLoader(spec.loader)
        sys.modules[spec.name] = module = importlib.util.module_from_spec(spec)
        setattr(np, name, module)
        spec.loader.exec_module(module)


_load_late(_LEFT)


def _inputs(snakemake) -> dict[str, str]:
    """Return {path: hash} of a job's input files; every input except the user's own files must have a record."""
    own = {str(path) for path in snakemake.input.get("user_files", ())}
    known: dict[str, Record | None] = {}
    paths = [str(path) for path in snakemake.input]
    return {path: content_sha256(path) if path in own else received(path, known) for path in paths}


@contextmanager
def run_rule(snakemake) -> Iterator[Provenance]:
    """Open a rule's log, limit its threads, yield the provenance of its outputs, and write their records at the end.

    Parameters
    ----------
    snakemake : the object that Snakemake passes to a script

    Raises
    ------
    SystemExit
        After a `PlainError`, for example because an input has changed since its rule wrote it.
    """
    gc.freeze()  # modules stay until the process ends: the garbage collector need not look at them again and again
    with rule_log(snakemake.log[0]):
        use_threads(snakemake.threads)
        parameters = {key: value for key, value in snakemake.params.items() if key not in _NOT_SETTINGS}
        provenance = Provenance(
            rule=snakemake.rule,
            config_hash=config_hash(parameters),
            code_hash=snakemake.params.get("code", ""),
            inputs=_inputs(snakemake),
        )
        yield provenance
        for path in snakemake.output:
            if not Path(path).is_dir():  # a folder of frames: pictures that no rule reads
                write_record(path, str(path), provenance.inputs)
