"""The subcommand ``init``: a project from a folder of photographs."""

import argparse
import shlex
import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

from irodori.config.capture_table import light_angles_deg
from irodori.config.definitions import load_definitions
from irodori.core.errors import InputError, counted
from irodori.core.yaml_files import read_yaml
from irodori.first_project.light_places import lamp_of_poses, read_lamps
from irodori.first_project.photograph_order import ORDERS
from irodori.first_project.questions import (
    Question,
    answer,
    name_in_files,
    numbers,
    pose_of_references,
    positive,
    shape,
    word,
)
from irodori.first_project.raw_folder import Photograph, photographs
from irodori.first_project.recognition import Recognised, recognise
from irodori.first_project.scaffold import Answers, Scaffold, refuse_existing_project

_SHOWN_GAPS = 20
#: Example of a value for the key ``shape``.
_SHAPE = "a shape, such as {kind: plate, width_mm: 90, height_mm: 90} or {kind: sphere, radius_mm: 30}"


def main(arguments: list[str] | None = None, prog: str = "irodori init") -> int:
    """Write camera, rig, object, scene and the table of photographs of a folder of RAW files, or of one chart's.

    What cannot be found in the files and pictures is asked on the terminal, or read from a file of answers. An empty
    answer leaves a gap, marked ?, and irodori check lists these. Existing files are never overwritten. The exit status
    is 1 if gaps are left or a definition has to be corrected, 2 if nothing was written, and 130 after Ctrl-C.
    """
    parser = argparse.ArgumentParser(prog=prog, description=main.__doc__)
    parser.add_argument("photographs", help="folder of the RAW files, or one photograph of a colour chart")
    parser.add_argument("--into", default="config", help="folder of definitions to write into (config)")
    parser.add_argument("--name", help="name of the object, in a to z, 0 to 9 and -; that of the folder where absent")
    lights = "where the lamp of each photograph stood: a light-position file (.lp), or lamps.csv of irodori dome"
    parser.add_argument("--lights", help=lights)
    linear = "the photographs are TIFF or PNG pictures whose numbers go with the light, without a tone curve"
    parser.add_argument("--linear", action="store_true", help=linear)
    order = "what tells the order of the photographs, if clock and file names contradict each other or leave it open"
    parser.add_argument("--order", choices=ORDERS, default="", help=order)
    parser.add_argument("--answers", help="YAML file of answers by the names that the questions have")
    asked = parser.parse_args(arguments)
    try:
        return _write(asked)
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    except BrokenPipeError:  # nobody reads the output: `irodori.command_line` ends
        raise
    except OSError as error:
        print(f"{error.filename or asked.into}: {error.strerror or error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("\nstopped; typed answers are not kept, those in a file are (--answers)", file=sys.stderr)
        return 130


def _write(asked: argparse.Namespace) -> int:
    given = read_yaml(asked.answers) if asked.answers else {}
    place = Path(asked.photographs)
    ask = _typed if sys.stdin.isatty() and not asked.answers else None
    name = _name(asked.name, place, ask)
    # Before the photographs are read, which takes minutes.
    refuse_existing_project(name, asked.into)
    found, order = photographs(place, asked.linear, asked.order)
    recognised = recognise(found)
    if not any(one.role == "chart" for one in recognised):
        looked = f"no ColorChecker of 4 x 6 patches in {counted(len(found), 'photograph')}"
        raise InputError(place, "", looked, "one photograph or more of the whole chart, evenly lit")
    print(f"name: {name}", _told(recognised, order), sep="\n")
    answers = _answers(recognised, given, asked, ask)
    folder = place if place.is_dir() else place.parent
    scaffold = Scaffold(name, asked.into, folder, recognised, answers)
    gaps = scaffold.write()
    print("assumed; please correct what is wrong:")
    for path, notes in scaffold.assumed().items():
        for note in notes:
            print(f"  {path}: {note}")
    print(f"{scaffold.configuration}: {counted(len(gaps), 'gap')}")
    for gap in gaps[:_SHOWN_GAPS]:
        print(f"  {gap}: replace ? by {_SHAPE if gap.endswith('.yaml: shape') else 'the value'}")
    if len(gaps) > _SHOWN_GAPS:
        print(f"  and {len(gaps) - _SHOWN_GAPS} more")
    if gaps:
        return 1
    try:
        load_definitions(read_yaml(scaffold.configuration), Path(), scaffold.configuration)
    except InputError as error:
        print(f"written, and to be corrected: {error}", file=sys.stderr)
        return 1
    target = "" if scaffold.has_object else " calibrate"
    print(f"next: snakemake --cores 2 --configfile={shlex.quote(str(scaffold.configuration))}{target}")
    return 0


def _name(given: str | None, place: Path, ask: Callable[[str], str] | None) -> str:
    """Return the name of the project: as given, or that of the folder, or a typed one if this has other letters."""
    own = place.absolute().name if place.is_dir() else place.stem
    try:
        return name_in_files(own if given is None else given)
    except ValueError as error:
        question = Question("name", f"Name of the object, because {given or own} cannot be one: {error}", name_in_files)
        name = answer(question, {}, None, ask)
        if name is None:
            raise InputError(place, "--name", repr(own if given is None else given), str(error)) from None
        return name


def _told(recognised: list[Recognised], order: str) -> str:
    """Return a text that describes the recognised photographs, whose order is that of ``order``."""
    count = Counter((one.role, one.filter) for one in recognised)
    poses = 1 + max(one.pose for one in recognised)
    parts = [f"{number} {role}, filter {state or 'unknown'}" for (role, state), number in sorted(count.items())]
    sure = {
        "chart": "chart: found, and its colours fit the known spectra",
        "white": "white: one even grey surface fills the frame",
        "dark": "dark: no light at all",
        "object": "object: all others; successive photographs that look alike are one pose, "
        f"which gives {counted(poses, 'pose')}",
    }
    known = [words for role, words in sure.items() if any(one.role == role for one in recognised)]
    open_ones = [one.photograph.path.name for one in recognised if not one.filter]
    lines = [f"{counted(len(recognised), 'photograph')}, in the order of {order}", *parts, *known]
    if open_ones:
        lines.append(f"filter unknown; is a photograph missing or out of order? {', '.join(open_ones[:5])}")
    return "\n".join(lines)


def _typed(words: str) -> str:
    """Read a line from the terminal; return an empty string if the input was closed."""
    try:
        return input(words)
    except EOFError:
        return ""


def _answers(
    recognised: list[Recognised], given, asked: argparse.Namespace, ask: Callable[[str], str] | None
) -> Answers:
    """Collect the values of a project from written answers, the photographs' metadata, and questions on the terminal.

    Parameters
    ----------
    recognised : list of Recognised
    given : mapping
        Answers written beforehand, by key.
    asked : Namespace
        Command-line arguments.
    ask : callable or None
        Shows a question and returns the line that was typed; None if there is no terminal.
    """
    source = asked.answers
    first = recognised[0].photograph
    used: set[str] = set()
    assumed: dict[str, str] = {}
    roles = {one.role for one in recognised}

    def put(key: str, words: str, read: Callable[[str], Any], default: str = "") -> Any | None:
        used.add(key)
        value = answer(Question(key, words, read, default), given, source, ask)
        if value is None and default:
            assumed[key] = default
            return read(default)
        return value

    angles = "Light and camera angle at the chart, degrees"
    distance = "From the object's middle to the lens, mm"
    said = Answers(
        camera_distance_mm=put("camera_distance_mm", distance, positive, "" if "object" in roles else "1000"),
        lamp=put("lamp", "Spectrum of the lamp: A (incandescent), D65, LED-B3 or another name, or a file", word),
        reference_pose=put("reference_pose", angles, pose_of_references, "45 0"),
        assumed=assumed,
    )
    if roles & {"white", "object"}:
        words = "Reflectance factor of the white reference"
        said.white_reflectance = put("white_reflectance", words, positive, "0.99")
    if "object" in roles:
        focal_mm = _one_of(recognised, lambda p: p.look.focal_mm)
        said.focal_length_mm = _stated_or(put, focal_mm, "focal_length_mm", "Focal length of the lens, mm", given)
        pitch = _stated_or(put, first.pitch_um, "pixel_pitch_um", "Distance of the sensor's pixels, micrometres", given)
        said.pixel_pitch_um = pitch
        words = "Shape: plate WIDTH HEIGHT, plate SIDE, sphere RADIUS (mm), or mesh FILE"
        said.shape = put("shape", words, shape)
        poses = 1 + max(one.pose for one in recognised)
        if asked.lights:
            positions, levels = read_lamps(asked.lights)
            places = lamp_of_poses(positions, recognised, asked.lights)
            light_deg, azimuth_deg = zip(*map(light_angles_deg, places), strict=True)
            said.angles |= {"light_deg": list(light_deg), "light_azimuth_deg": list(azimuth_deg)}
            said.light_level = lamp_of_poses(levels, recognised, asked.lights) if levels else []
        else:
            words = f"Light angle, degrees: one number, or one for each of the {poses} poses"
            said.angles["light_deg"] = put("light_deg", words, numbers(poses))
            words = f"Azimuth of the lamp, degrees, 0 opposite the camera: one, or one for each of the {poses} poses"
            around_deg = put("light_azimuth_deg", words, numbers(poses), "0")
            if around_deg is not None and any(around_deg):
                said.angles["light_azimuth_deg"] = around_deg
        for axis, what, default in (
            ("camera_deg", "Camera angle", "0" if asked.lights else ""),
            ("tilt_deg", "Tilt of the table", "0"),
            ("turn_deg", "Turn of the table", "0"),
        ):
            words = f"{what}, degrees: one number, or one for each of the {poses} poses"
            said.angles[axis] = put(axis, words, numbers(poses), default)
    for key in given:
        if key not in used | {"focal_length_mm", "pixel_pitch_um"}:
            raise InputError(source, str(key), "an answer to no question", ", ".join(sorted(used)))
    return said


def _stated_or(put, stated: float, key: str, words: str, given) -> float | None:
    """Return a written answer or else the value stated in the files; ask if there is neither."""
    return put(key, words, positive) if not stated or key in given else stated


def _one_of(recognised: list[Recognised], value: Callable[[Photograph], float]) -> float:
    """Return the value that all photographs but dark frames have in common; 0 if they differ or state none."""
    found = {value(one.photograph) for one in recognised if one.role != "dark"}
    return found.pop() if len(found) == 1 else 0.0


if __name__ == "__main__":
    sys.exit(main())
