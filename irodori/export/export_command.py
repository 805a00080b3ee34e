"""Write a scene, an object, a material or a light for other programs, and print the colour error of the export."""

import argparse
import shutil
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from irodori.colour.display import STANDARD, standard_display
from irodori.config.cross_checks.named_spectra import check_light
from irodori.config.project import add_configfile
from irodori.core.atomic_files import written_whole
from irodori.core.errors import InputError, PlainError
from irodori.export.diffuse_picture import (
    colours_from_bands,
    diffuse_colours,
    preview_of,
    write_diffuse_tiff,
    write_preview,
)
from irodori.export.envi import INTERLEAVES
from irodori.export.loss import Loss, Losses
from irodori.export.material_pictures import SUFFIXES, export_picture, stored_preview

if TYPE_CHECKING:
    from irodori.export.export_sources import Source


class Target(NamedTuple):
    """A kind of export, the value of the option ``--to``.

    Parameters
    ----------
    suffix : str
        Suffix of the file; empty for a folder.
    takes : tuple of str
        Kinds of sources that can be exported so: ``scene``, ``object``, ``environment``.
    write : callable
        (source, path, options) -> `Losses`.
    about : str
        Description for the help text.
    """

    suffix: str
    takes: tuple[str, ...]
    write: Callable[["Source", Path, argparse.Namespace], Losses]
    about: str


def _result(source: "Source", kind: str, configs: Sequence[str] = ()) -> Path:
    """Return the path of the picture of a scene's first view; ``kind`` is ``png`` or ``exr``."""
    from irodori.export.export_sources import result

    assert source.scene is not None
    return result(Path(f"results/{source.name}/{next(iter(source.scene.views))}.{kind}"), configs)


def _preview(source: "Source", path: Path, illuminant: str = "D65") -> None:
    """Write the preview beside an export: first view of a scene, diffuse colours of an object, or panorama."""
    if source.kind == "scene":
        with written_whole(preview_of(path)) as temporary:
            shutil.copyfile(_result(source, "png"), temporary)
    elif source.kind == "object":
        write_preview(preview_of(path), diffuse_colours(source.items[0].material, colours_from_bands(illuminant)))
    else:
        write_preview(preview_of(path), stored_preview(source.environment))


def _gltf(source: "Source", path: Path, given: argparse.Namespace) -> Losses:
    from irodori.export.gltf_file import ILLUMINANTS, write_gltf

    illuminants = given.illuminant or ILLUMINANTS
    losses = write_gltf(source, path, illuminants)
    _preview(source, path, illuminants[0])
    return dict(losses)


def _mitsuba(source: "Source", path: Path, given: argparse.Namespace) -> Losses:
    from irodori.export.mitsuba_loss import measure
    from irodori.export.mitsuba_scene import add_to_about, write_mitsuba

    assert source.scene is not None
    picture, view = _result(source, "exr", given.configfile), next(iter(source.scene.views))
    write_mitsuba(source, path)
    _preview(source, path)
    found = measure(path, picture, view)
    add_to_about(path, {"loss_ciede2000": found})
    if "not_measured" in found:
        return {f"view {view}": f"not measured: {found['not_measured']}"}
    return {f"view {view}": Loss.read(found), "of this Mitsuba's noise": Loss.read(found["of_mitsubas_noise_alone"])}


def _tiff(source: "Source", path: Path, given: argparse.Namespace) -> Losses:
    illuminant, *more = given.illuminant or ["D65"]
    if more:
        raise PlainError(f"--illuminant: found {1 + len(more)} lights; accepted: one, for --to tiff.")
    loss = write_diffuse_tiff(source.items[0], path, illuminant, standard_display(given.display))
    _preview(source, path, illuminant)
    return {f"under {illuminant}": loss}


def _picture(source: "Source", path: Path, given: argparse.Namespace) -> Losses:
    file = source.environment if source.kind == "environment" else source.items[0].file
    losses = export_picture(file, path, given.interleave)
    _preview(source, path)
    return losses


_SPECTRAL = ("object", "environment")
TARGETS = {
    "gltf": Target(".glb", ("scene", "object"), _gltf, "glTF 2.0: shapes, textures, a variant of them for each light"),
    "mitsuba": Target("", ("scene",), _mitsuba, "a folder for Mitsuba 3 with a plugin that reads our coefficients"),
    "tiff": Target(".tif", ("object",), _tiff, "diffuse colour under a light, 16 bits a channel, with an ICC profile"),
    "spectral-exr": Target(".exr", _SPECTRAL, _picture, "spectral EXR"),
    "envi": Target(".img", _SPECTRAL, _picture, "ENVI"),
}


def export_named(name: str, output: Path | None, given: argparse.Namespace) -> tuple[Path, Losses]:
    """Export a scene, an object or an environment by its name; return the file or folder written, and its losses.

    Parameters
    ----------
    name : str
        See `irodori.export.export_sources.find`.
    output : path, optional
        ``exports/NAME`` with the suffix of the target by default.
    given : Namespace
        The option ``to`` and the options of the target, see `command_parser`.

    Raises
    ------
    PlainError
        For an unknown target, a name without definition, a result that does not exist yet, a target that does not
        accept this kind of source, or an illuminant that is no light.
    """
    if given.to not in TARGETS:
        raise PlainError(f"--to: found {given.to!r}; accepted: {', '.join(TARGETS)}.")
    from irodori.export.export_sources import find  # loads the renderers

    target, source = TARGETS[given.to], find(name, given.configfile)
    if source.kind not in target.takes:
        accepted = " or ".join(target.takes)
        raise PlainError(f"--to {given.to}: found the {source.kind} {source.name!r}; accepted: {accepted}.")
    for light in given.illuminant or ():
        check_light(light, Path(), "--illuminant")
    path = output or Path(f"exports/{source.name}{target.suffix or '-mitsuba'}")
    if target.suffix and path.suffix.lower() != target.suffix:
        raise InputError(path, "", f"the suffix {path.suffix!r}", f"{target.suffix}, of --to {given.to}")
    if source.kind == "scene":
        _result(source, "png", given.configfile)  # raises now, not after the work, if it is missing
    path.parent.mkdir(parents=True, exist_ok=True)
    return path, target.write(source, path, given)


def command_parser(prog: str) -> argparse.ArgumentParser:
    """Return the parser of the command-line arguments."""
    about = "\n".join(f"  {name:13} {one.about} (of: {', '.join(one.takes)})" for name, one in TARGETS.items())
    parser = argparse.ArgumentParser(
        prog=prog,
        description=f"{__doc__}\n\ntargets of --to:\n{about}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "source",
        help="with --to: name of a scene, an object or an environment (FOLDER/NAME where two share one); without: a "
        "material's or a light's file",
    )
    parser.add_argument(
        "output",
        nargs="?",
        type=Path,
        help=f"file to write: exports/NAME with the target's suffix where absent; without --to {', '.join(SUFFIXES)}",
    )
    parser.add_argument("--to", metavar="TARGET", help=f"one of: {', '.join(TARGETS)}")
    parser.add_argument(
        "--illuminant",
        nargs="+",
        metavar="LIGHT",
        help="lights of the variants of gltf (D65 A FL11 where absent), or the light of tiff (D65)",
    )
    add_configfile(parser)
    parser.add_argument("--display", choices=STANDARD, default="sRGB", help="whose colours and profile a tiff has")
    parser.add_argument("--interleave", help=f"of ENVI (.img): {', '.join(INTERLEAVES)}; the first where absent")
    return parser


def main(arguments: list[str] | None = None, prog: str = "python -m irodori.export.export_command") -> int:
    """Run the command; return 0, or 2 after printing an error in one sentence."""
    given = command_parser(prog).parse_intermixed_args(arguments)
    try:
        if given.to is not None:
            path, losses = export_named(given.source, given.output, given)
        elif given.output is None:
            raise PlainError(f"{given.source}: found neither --to nor a file to write; accepted: one of them.")
        else:
            path, losses = given.output, export_picture(given.source, given.output, given.interleave)
            write_preview(preview_of(path), stored_preview(given.source))
        print(path, *(f"{what}: {getattr(loss, 'text', loss)}" for what, loss in losses.items()), sep="\n")
    except PlainError as error:
        print(error, file=sys.stderr)
        return 2
    except BrokenPipeError:  # nobody reads the output: `irodori.command_line` ends
        raise
    except OSError as error:
        print(f"{error.filename or given.output}: cannot be written: {error.strerror or error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
