"""Write a scene, an object, a material or a light for other programs, and print by how much its colours are off."""

import argparse
import shutil
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from irodori.colour.display import STANDARD, standard_display
from irodori.core.atomic_files import written_whole
from irodori.core.errors import InputError, PlainError
from irodori.export.envi import INTERLEAVES
from irodori.export.material_pictures import SUFFIXES, export_picture


class Target(NamedTuple):
    """A kind of export.

    Parameters
    ----------
    suffix : str
        Of its file; empty of a folder.
    write : callable
        (source, path, options) -> lines about the loss.
    about : str
    """

    suffix: str
    write: Callable
    about: str


def _illuminants(given, usual: Sequence[str]) -> Sequence[str]:
    return given.illuminant or usual


def _preview(source, path: Path, illuminant: str) -> None:
    """Write the picture beside an export: of a scene its first view as rendered, of an object its diffuse colours."""
    from irodori.export.diffuse_picture import colours_from_bands, diffuse_colours, preview_of, write_preview

    if source.kind == "scene":
        with written_whole(preview_of(path)) as temporary:
            shutil.copyfile(_view_picture(source, "png"), temporary)
    elif source.kind == "object":
        write_preview(preview_of(path), diffuse_colours(source.items[0].material, colours_from_bands(illuminant)))
    else:
        from irodori.export.material_pictures import light_preview

        write_preview(preview_of(path), light_preview(source.environment))


def _view_picture(source, kind: str) -> Path:
    from irodori.export.export_sources import result

    return result(Path(f"results/{source.name}/{next(iter(source.scene.views))}.{kind}"))


def _gltf(source, path: Path, given) -> list[str]:
    from irodori.export.gltf_file import ILLUMINANTS, write_gltf

    if not source.items:
        raise PlainError(f"--to gltf: found the {source.kind} {source.name!r}; accepted: a scene or an object.")
    illuminants = _illuminants(given, ILLUMINANTS)
    _preview(source, path, illuminants[0])
    return [f"{what}: {loss.text}" for what, loss in write_gltf(source, path, illuminants).items()]


def _mitsuba(source, path: Path, given) -> list[str]:
    from irodori.export.mitsuba_loss import measure
    from irodori.export.mitsuba_scene import add_to_about, write_mitsuba

    write_mitsuba(source, path)
    _preview(source, path, "D65")
    loss = measure(path, _view_picture(source, "exr"), next(iter(source.scene.views)))
    add_to_about(path, {"loss_ciede2000": loss})
    return [f"{name.replace('_', ' ')}: {value}" for name, value in loss.items()]


def _tiff(source, path: Path, given) -> list[str]:
    from irodori.export.diffuse_picture import write_diffuse_tiff
    from irodori.export.export_sources import only_object

    item, (illuminant, *more) = only_object(source, "tiff"), _illuminants(given, ["D65"])
    if more:
        raise PlainError(f"--illuminant: found {1 + len(more)} lights; accepted: one, for --to tiff.")
    _preview(source, path, illuminant)
    return [write_diffuse_tiff(item, path, illuminant, standard_display(given.display)).text]


def _picture(source, path: Path, given) -> list[str]:
    if source.kind == "scene":
        raise PlainError(f"--to {given.to}: found the scene {source.name!r}; accepted: an object or an environment.")
    file = source.environment if source.kind == "environment" else source.items[0].file
    export_picture(file, path, given.interleave)
    _preview(source, path, "D65")
    return ["the spectra as they are, as 32-bit floats"]


TARGETS = {
    "gltf": Target(".glb", _gltf, "glTF 2.0: shapes, textures, a variant a light; of a scene or an object"),
    "mitsuba": Target("", _mitsuba, "a folder for Mitsuba 3 with a plugin that reads our coefficients; of a scene"),
    "tiff": Target(".tif", _tiff, "diffuse colour under a light, 16 bits, with its ICC profile; of an object"),
    "spectral-exr": Target(".exr", _picture, "spectral EXR, of an object or an environment"),
    "envi": Target(".img", _picture, "ENVI, of an object or an environment"),
}


def export_named(name: str, output: Path | None, given: argparse.Namespace) -> list[str]:
    """Export a definition by its name; return what is to be said of it, the file first.

    Raises
    ------
    PlainError
        For an unknown target, a name without definition, a result that is not made yet, or a target that does not
        take what the name stands for.
    """
    if given.to not in TARGETS:
        raise PlainError(f"--to: found {given.to!r}; accepted: {', '.join(TARGETS)}.")
    from irodori.export.export_sources import find

    target, source = TARGETS[given.to], find(name)
    path = output or Path(f"exports/{source.name}{target.suffix or '-mitsuba'}")
    if target.suffix and path.suffix.lower() != target.suffix:
        raise InputError(path, "", f"the suffix {path.suffix!r}", f"{target.suffix}, of --to {given.to}")
    path.parent.mkdir(parents=True, exist_ok=True)
    return [str(path), *target.write(source, path, given)]


def main(arguments: list[str] | None = None, prog: str = "python -m irodori.export.export_command") -> int:
    """Run the command; return 0, or 2 after a fault said in one sentence."""
    targets = "\n".join(f"  {name:13} {target.about}" for name, target in TARGETS.items())
    parser = argparse.ArgumentParser(
        prog=prog, description=f"{__doc__}\n\ntargets of --to:\n{targets}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    parser.add_argument("source", help="with --to: name of a scene, an object or an environment (FOLDER/NAME where two "
                        "share one); without: a material's or a light's file")  # fmt: skip
    parser.add_argument("output", nargs="?", type=Path, help="file to write, exports/NAME with the target's suffix "
                        f"where absent; of a file {', '.join(SUFFIXES)}")  # fmt: skip
    parser.add_argument("--to", metavar="TARGET", help=f"one of: {', '.join(TARGETS)}")
    parser.add_argument(
        "--illuminant",
        nargs="+",
        metavar="LIGHT",
        help="lights of the variants of gltf (D65 A FL11 where absent), or the light of tiff (D65)",
    )
    parser.add_argument("--display", choices=STANDARD, default="sRGB", help="whose colours and profile a tiff has")
    parser.add_argument("--interleave", help=f"of ENVI (.img): {', '.join(INTERLEAVES)}; the first where absent")
    given = parser.parse_intermixed_args(arguments)
    try:
        if given.to is not None:
            print(*export_named(given.source, given.output, given), sep="\n")
        elif given.output is None:
            raise PlainError(f"{given.source}: found neither --to nor a file to write; accepted: one of them.")
        else:
            export_picture(given.source, given.output, given.interleave)
    except PlainError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
