"""The command ``irodori crate``: describe a finished run as a Workflow Run RO-Crate."""

import argparse
import json
import shutil
import zipfile
from pathlib import Path

from irodori.config.project import DEFAULT_FILE, inside
from irodori.core.atomic_files import written_whole
from irodori.core.errors import InputError, PlainError
from irodori.export.run_crate import METADATA, WORKFLOW, RunFiles, run_crate

#: Files that are compressed already are stored as they are.
_PACKED = (".h5", ".exr", ".png", ".dng", ".zip")


def write_crate(configuration: list[str], output: Path | None, snakefile: Path | None = None) -> Path:
    """Write the RO-Crate of a configuration's finished run in the working directory, and return its path.

    Parameters
    ----------
    configuration : list of str
        Configuration files that override the default one.
    output : path, optional
        A new folder, or a file that ends in ``.zip``, into which all files are copied. By default only the description
        is written, into the project's folder, and the files stay where they are; the workflow must be among them.
    snakefile : path, optional
        The workflow's Snakefile, see `irodori.export.run_crate.find_snakefile`.

    Raises
    ------
    InputError
        See `irodori.export.run_crate.run_crate`; if `output` exists already; or if there is none, and the workflow lies
        outside the project's folder.
    OSError
        If the disk is full or cannot be written to.
    """
    if output is not None and (output.exists() or output.is_symlink()):
        raise InputError(output, "", "something that is there already", "a name that is free")
    metadata, files = run_crate(configuration, snakefile)
    if output is None and files.snakefile.resolve() != (files.project / WORKFLOW).resolve():
        accepted = "--output, which copies it with all other files, because a crate is one folder"
        raise InputError(files.snakefile, "", "a workflow that lies outside the project's folder", accepted)
    text = json.dumps(metadata, indent=1, ensure_ascii=False) + "\n"
    if output is None:
        output = files.project / METADATA
        with written_whole(output) as temporary:
            temporary.write_text(text, encoding="utf-8")
    elif output.suffix == ".zip":
        _write_zip(output, text, files)
    else:
        output.mkdir(parents=True)
        for name in files.all:
            (output / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(files.path(name), output / name)
        # Written last, so that a folder with a description is complete.
        (output / METADATA).write_text(text, encoding="utf-8")
    return output


def _write_zip(output: Path, text: str, files: RunFiles) -> None:
    with written_whole(output) as temporary, zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(METADATA, text)
        for name in files.all:
            packed = zipfile.ZIP_STORED if name.endswith(_PACKED) else zipfile.ZIP_DEFLATED
            archive.write(files.path(name), name, packed)


def main(arguments: list[str] | None = None, prog: str = "irodori crate") -> int:
    """Describe a finished run as a Workflow Run RO-Crate: its files with their hashes, its jobs, software and licence.

    The files are the results that the configuration asks for, and everything that they were made from. Without
    --output the description is written into the project's folder, as ro-crate-metadata.json.
    """
    parser = argparse.ArgumentParser(prog=prog, description=main.__doc__)
    parser.add_argument(
        "--directory", default=".", help="where all paths of the run start, those of configurations too"
    )
    parser.add_argument(
        "--configfile", nargs="+", default=[], help=f"configurations on top of {DEFAULT_FILE}, as snakemake has them"
    )
    parser.add_argument(
        "--snakefile", type=Path, metavar="FILE",
        help=f"the workflow's Snakefile, if it is neither {WORKFLOW} of the project nor of this program's clone",
    )  # fmt: skip
    parser.add_argument(
        "--output", type=Path, metavar="PATH", help="a new folder, or a file ending in .zip, that takes copies of all"
    )
    asked = parser.parse_args(arguments)
    output, snakefile = (path and path.absolute() for path in (asked.output, asked.snakefile))
    try:
        with inside(asked.directory):
            print(write_crate(asked.configfile, output, snakefile))
    except BrokenPipeError:  # nobody reads the output: `irodori.command_line` ends
        raise
    except (PlainError, OSError) as error:
        print(error)
        return 1
    return 0
