"""Damage files and read them, in a process of its own: a crash, a hang or a full memory must not end the tests.

``python reader_fuzzer.py GROUP FOLDER COUNT SEED`` gives every reader of a group COUNT damaged files and prints one
JSON object: for each reader the number of outcomes of each kind, the longest time and the growth of memory. FOLDER
keeps the file at hand, so that a crash leaves the one that caused it. An input is found again from its reader, its
number and SEED.
"""

import collections
import json
import random
import re
import resource
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from irodori.core.errors import InputError, PlainError

ROOT = Path(__file__).resolve().parents[2]
LONGEST_S = 5.0
_GROWTH_LIMIT_BYTES = 3 << 30  # the machine's guard; the tests ask for less
_NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][+-]?\d+)?")
_ODD_NUMBERS = (
    b"nan", b"inf", b"-inf", b"-1", b"0", b"1e308", b"-1e308", b"1e-320", b"99999999999999999999", b"2147483648",
    b"1000000000", b"", b"x", b"\xff\xfe", b"0x10", b"1_0", b"1e20", b"true", b"null", b"[]", b"{}", b'"', b"../../x",
)  # fmt: skip
_ODD_WORDS = (
    b"\0\0\0\0", b"\xff\xff\xff\xff", b"\xff\xff\xff\x7f", b"\x7f\xff\xff\xff", b"\0\0\0\x80", b"\0\0\xc0\x7f",
    b"\x7f\xc0\0\0", b"\0\0\x80\x7f", b"\xff\xff\x7f\x7f", b"\0\0\1\0", b"\x80\0\0\0",
)  # fmt: skip


class Reader(NamedTuple):
    """A kind of file: its name, what writes a whole one, and what reads it to the end."""

    file: str
    write: Callable[[Path], object]
    read: Callable[[Path], object]


def damaged(content: bytes, chance: random.Random) -> bytes:
    """Return a file damaged in one of the ways in which files are: by a disk, a cable, a program or a person."""
    out = bytearray(content)
    at = chance.randrange(len(out))
    for _ in range(chance.choice([1, 1, 1, 2, 4])):
        at = chance.randrange(max(len(out), 1))
        match chance.randrange(7):
            case 0:
                for _ in range(chance.choice([1, 1, 2, 8])):
                    place = chance.randrange(max(len(out), 1))
                    out[place : place + 1] = bytes([chance.randrange(256)])
            case 1:
                del out[at:]
            case 2:
                out[at : at + 4] = chance.choice(_ODD_WORDS)
            case 3:
                del out[at : at + chance.randrange(1, 40)]
            case 4:
                out[at:at] = out[at : at + chance.randrange(1, 200)] * chance.choice([1, 2, 50])
            case _:
                # Not all numbers are listed: of a large binary file, this takes longer than reading it.
                found = _NUMBER.search(out, at) or _NUMBER.search(out)
                if found:
                    out[found.start() : found.end()] = chance.choice(_ODD_NUMBERS)
    return bytes(out)


def text_readers() -> dict[str, Reader]:
    """Return the readers of text: configuration, tables of photographs, spectra."""
    from irodori.capture.journal import Journal
    from irodori.colour.measured_display import measured_display
    from irodori.config.capture_table import Pose, Shot, read_captures, write_captures
    from irodori.config.validation import validate
    from irodori.core.yaml_files import read_yaml
    from irodori.spectra.spectral_files import check_power, check_reflectance, spectral_table
    from irodori.spectra.tables import brdf_table, index_table

    wavelengths = range(400, 701, 10)

    def definition(kind: str) -> Reader:
        source = next((ROOT / f"config/{kind}s").glob("*.yaml"))
        return Reader(
            f"{kind}.yaml",
            lambda path: path.write_bytes(source.read_bytes()),
            lambda path: validate(read_yaml(path), kind, path),
        )

    def captures(path: Path) -> None:
        shots = [Shot(f"{i}.dng", "object", Pose(45.0, 10.0 * i), "out", 0.02) for i in range(4)]
        write_captures(path, shots, {shot.file: "0" * 64 for shot in shots})

    def session(path: Path) -> None:
        path.parent.mkdir(exist_ok=True)
        captures(path)

    def journal(path: Path) -> None:
        for i in range(4):
            (path.parent / f"{i}.dng").write_bytes(b"photograph")
        Journal(path)

    def lines(*text: str) -> Callable[[Path], object]:
        return lambda path: path.write_text("\n".join(text) + "\n", encoding="utf-8")

    def reflectance(path: Path) -> None:
        check_reflectance(spectral_table(path), path)

    def power(path: Path) -> None:
        check_power(spectral_table(path), path)

    grid = ",".join(map(str, wavelengths))
    cgats = [
        "CTI3", "NUMBER_OF_FIELDS 32", 'SPECTRAL_BANDS "31"', 'SPECTRAL_START_NM "400"', 'SPECTRAL_END_NM "700"',
        'SPECTRAL_NORM "100"', "BEGIN_DATA_FORMAT", "SAMPLE_ID " + " ".join(f"SPEC_{w}" for w in wavelengths),
        "END_DATA_FORMAT", "NUMBER_OF_SETS 2", "BEGIN_DATA", "1 " + "50.0 " * 31, "2 " + "20.5 " * 31, "END_DATA",
    ]  # fmt: skip
    data = "".join(f'<SpectralData wavelength="{w}">{1.0 + 0.01 * w}</SpectralData>' for w in wavelengths)
    ramps = [(channel, step / 4) for channel in range(3) for step in range(5)]
    colours = [[level * (channel == i) for i in range(3)] for channel, level in ramps] + [[1, 1, 1]]
    patches = [",".join(map(str, (r, g, b, r + g / 3 + 0.1, r / 2 + g + 0.1, b + g / 5 + 0.1))) for r, g, b in colours]
    return {
        **{kind: definition(kind) for kind in ("object", "scene", "camera", "environment", "rig")},
        "captures.csv": Reader("captures.csv", captures, read_captures),
        "journal": Reader("session/captures.csv", session, journal),
        "wide CSV": Reader("wide.csv", lines(f"name,{grid}", "a" + ",0.5" * 31, "b" + ",0.25" * 31), reflectance),
        "long CSV": Reader("long.csv", lines("name,wavelength_nm,value", *(f"a,{w},0.5" for w in wavelengths)), power),
        "CGATS": Reader("chart.ti3", lines(*cgats), reflectance),
        "SPD": Reader("lamp.spd", lines("# lamp", *(f"{w} {w / 500}" for w in wavelengths)), power),
        "TM-27": Reader("lamp.spdx", lines(f'<?xml version="1.0"?><IESTM27>{data}</IESTM27>'), power),
        "index": Reader("index.csv", lines("wavelength_nm,n,k", *(f"{w},1.5,0.1" for w in wavelengths)), index_table),
        "BRDF": Reader(
            "brdf.csv",
            lines(f"theta_i_rad,phi_i_rad,theta_r_rad,phi_r_rad,{grid}", "0.1,0,0.2,0" + ",0.3" * 31),
            brdf_table,
        ),
        "measured display": Reader("screen.csv", lines("red,green,blue,X,Y,Z", *patches), measured_display),
    }  # fmt: skip


def picture_readers() -> dict[str, Reader]:
    """Return the readers of displays' profiles and of pictures of light."""
    import OpenImageIO as oiio

    from irodori.colour.display import make_display, standard_display
    from irodori.colour.icc import Profile, write_profile
    from irodori.colour.tone_curves import SampledCurve
    from irodori.config.models import ProfileDisplay
    from irodori.export.pictures import layer_names
    from irodori.light.light_files import rgb_picture, spectral_picture

    def profile(curve) -> Callable[[Path], object]:
        known = standard_display("Display P3")
        return lambda path: path.write_bytes(write_profile(Profile("screen", known.xyz_from_rgb, (curve,) * 3)))

    def display(path: Path) -> None:
        shown = make_display(ProfileDisplay(file=str(path)))
        shown.encode(shown.linear_rgb(np.full((4, 3), 20.0), np.array([95.0, 100.0, 108.0])))

    def picture(names: list[str], compression: str, tile: int = 0) -> Callable[[Path], object]:
        def write(path: Path) -> None:
            pixels = np.random.default_rng(0).uniform(0.1, 2.0, (8, 16, len(names))).astype(np.float32)
            spec = oiio.ImageSpec(16, 8, len(names), "half")
            spec.channelnames, spec.tile_width, spec.tile_height = names, tile, tile
            spec.attribute("compression", compression)
            spec.attribute(
                "chromaticities", oiio.TypeDesc("float[8]"), (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329)
            )
            out = oiio.ImageOutput.create(str(path))
            assert out.open(str(path), spec) and out.write_image(pixels) and out.close()

        return write

    def bands(make) -> Callable[[Path], object]:
        return lambda path: list(make(path).read())

    return {
        "ICC of a formula": Reader("a.icc", profile(standard_display("sRGB").curves[0]), display),
        "ICC of samples": Reader("b.icc", profile(SampledCurve(np.linspace(0, 1, 64) ** 2)), display),
        "EXR of RGB": Reader("zip.exr", picture(["R", "G", "B"], "zip"), bands(rgb_picture)),
        "EXR in tiles": Reader("tiles.exr", picture(["R", "G", "B"], "piz", 16), bands(rgb_picture)),
        "EXR of spectra": Reader("spectra.exr", picture(layer_names("S0")[::4], "zips"), bands(spectral_picture)),
        "Radiance HDR": Reader("a.hdr", picture(["R", "G", "B"], "rle"), bands(rgb_picture)),
    }


def mesh_readers() -> dict[str, Reader]:
    """Return the readers of meshes."""
    import trimesh

    from irodori.geometry.mesh_files import read_mesh

    def write(path: Path) -> None:
        corners = np.array([[0, 0, 0], [10, 0, 0], [10, 10, 0], [0, 10, 1]], dtype=float)
        uv = corners[:, :2] / 10.0
        mesh = trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)
        mesh.visual = trimesh.visual.TextureVisuals(uv, material=trimesh.visual.material.PBRMaterial())
        made = mesh.export(None, file_type=path.suffix[1:])
        if isinstance(made, dict):
            for name, content in made.items():
                (path if name.endswith(".gltf") else path.with_name(name)).write_bytes(content)
        else:
            path.write_bytes(made.encode() if isinstance(made, str) else made)

    return {
        suffix: Reader(f"mesh.{suffix}", write, lambda path: read_mesh(path, "mm"))
        for suffix in ("obj", "ply", "glb", "gltf")
    }


def hdf5_readers() -> dict[str, Reader]:
    """Return the readers of the files that stages pass to each other."""
    from made_up_camera import training
    from scenes import material, sky

    from irodori.calibration.estimators import fit
    from irodori.calibration.recovery.calibration_file import Calibration
    from irodori.core import store
    from irodori.core.custody import accept
    from irodori.light.environment_file import Environment
    from irodori.material.material_file import Material

    made = store.Provenance("test")

    def calibration(path: Path) -> None:
        with store.create(path, made) as out:
            fit("pinv", training(0.003), 6).write(out)

    def accepted(load: Callable[[Path], object]) -> Callable[[Path], object]:
        """Read a file whose damage somebody took as it is: its hash would else refuse it before it is read."""

        def read(path: Path) -> object:
            accept(path)
            return load(path)

        return read

    return {
        "material": Reader(
            "material.h5", lambda path: material(np.linspace(0.1, 0.9, 61)).save(path, made), accepted(Material.load)
        ),
        "environment": Reader(
            "sky.h5", lambda path: sky(lambda d: 2 + d[..., 2:], 32, 16).save(path, made), accepted(Environment.load)
        ),
        "calibration": Reader("calibration.h5", calibration, accepted(Calibration.load)),
    }


GROUPS = {"text": text_readers, "pictures": picture_readers, "meshes": mesh_readers, "HDF5": hdf5_readers}


class _HangError(BaseException):
    """More time than any file may take; no reader's own handling of errors catches it."""


def _hang(_number, _frame) -> None:
    raise _HangError


#: Longest CPU time for the first file of a reader, s.
_FIRST_S = 60.0


def outcome(read: Callable[[Path], object], path: Path, longest_s: float = LONGEST_S) -> str:
    """Return how a reader takes a file: ``read``, ``refused``, or what is wrong with it."""
    signal.setitimer(signal.ITIMER_VIRTUAL, longest_s)
    try:
        read(path)
        return "read"
    except PlainError as error:
        told = str(error)
        said = "\n" not in told and len(told) < 1500 and (not isinstance(error, InputError) or error.accepted)
        return "refused" if said and str(path.parent) in told else f"badly worded: {told[:400]!r}"
    except _HangError:
        return f"more than {longest_s:g} s"
    except Exception as error:
        return f"{type(error).__name__}: {error}"[:400]
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)


def _grown_mb() -> float:
    """Return the largest memory that this process has had so far, in MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def main(group: str, folder: str, count: int, seed: int) -> dict:
    """Return {reader: {outcome: count, ``slowest_s``, ``grown_mb``}}, and the first input of each bad outcome."""
    signal.signal(signal.SIGVTALRM, _hang)
    readers, found = GROUPS[group](), {}
    for name, (file, write, read) in readers.items():
        path = Path(folder, file)
        write(path)
        content = path.read_bytes()
        # The first file may have to wait until loops are compiled.
        if (whole := outcome(read, path, _FIRST_S)) != "read":
            found[name] = {f"whole, {whole}": 1}
    size = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (size + _GROWTH_LIMIT_BYTES,) * 2)
    for name, (file, write, read) in readers.items():
        path, counts, slowest, before = Path(folder, file), collections.Counter(), 0.0, _grown_mb()
        write(path)
        content = path.read_bytes()
        for number in range(count):
            path.write_bytes(damaged(content, random.Random(f"{seed} {name} {number}")))
            began = time.process_time()
            what = outcome(read, path)
            slowest = max(slowest, time.process_time() - began)
            counts[what if what in ("read", "refused") else f"input {number}: {what}"] += 1
        found.setdefault(name, {}).update(counts, slowest_s=slowest, grown_mb=_grown_mb() - before)
    return found


if __name__ == "__main__":
    print(json.dumps(main(*sys.argv[1:3], *map(int, sys.argv[3:]))))
