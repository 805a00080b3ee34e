"""What every rule's script shares: its log, its threads and the provenance of what it writes."""

import hashlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from irodori.progress import rule_log
from irodori.provenance import config_hash, file_sha256
from irodori.store import Provenance
from irodori.threads import use_threads


def _input_sha256(files) -> str:
    """Return one hash over the contents of the files, in their order."""
    total = hashlib.sha256()
    for path in files:
        total.update(file_sha256(Path(str(path))).encode())
    return total.hexdigest()


@contextmanager
def run_rule(snakemake) -> Iterator[Provenance]:
    """Open a rule's log, limit its threads, and yield the provenance of its outputs.

    Parameters
    ----------
    snakemake : the object that Snakemake gives to a script
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
