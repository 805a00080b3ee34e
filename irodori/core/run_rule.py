"""Common frame of every rule's script: log, threads and provenance."""

import hashlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from irodori.core.atomic_files import verified_sha256, write_digest
from irodori.core.progress import rule_log
from irodori.core.provenance import config_hash
from irodori.core.store import Provenance
from irodori.core.threads import use_threads


def _input_sha256(files) -> str:
    """Return one hash over the contents of the files, in their order; each must be as its rule left it."""
    total = hashlib.sha256()
    for path in files:
        total.update(verified_sha256(str(path)).encode())
    return total.hexdigest()


@contextmanager
def run_rule(snakemake) -> Iterator[Provenance]:
    """Open a rule's log, limit its threads, yield the provenance of its outputs, and note their hashes at the end.

    Parameters
    ----------
    snakemake : the object that Snakemake gives to a script

    Raises
    ------
    SystemExit
        After a plain fault, such as an input that has changed since its rule wrote it.
    """
    with rule_log(snakemake.log[0]):
        use_threads(snakemake.threads)
        parameters = {key: value for key, value in snakemake.params.items() if key != "code"}
        yield Provenance(
            rule=snakemake.rule,
            config_hash=config_hash(parameters),
            code_hash=snakemake.params.get("code", ""),
            input_sha256=_input_sha256(snakemake.input),
        )
        for path in snakemake.output:
            if not Path(path).is_dir():  # a folder of frames: pictures that no rule reads
                write_digest(str(path))
