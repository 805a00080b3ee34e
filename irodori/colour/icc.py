"""Reading and writing of matrix-and-curve ICC profiles (ICC.1:2022, version 4.4).

Profiles with colour tables (LUT) are refused. The library LittleCMS supports them, but Pillow's interface to it is
limited to 8 bits.
"""

import struct
from typing import NamedTuple

import numpy as np

from irodori.colour.tone_curves import Curve, ParametricCurve, SampledCurve
from irodori.core.errors import InputError

#: Profile connection space, ICC.1:2022, 7.2.16.
D50_XYZ = np.array([0.9642, 1.0, 0.8249])
#: Cone responses of the adaptation that ICC.1:2022, annex E, recommends for the ``chad`` tag.
_BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])
_HEADER = 128
#: No display's profile comes near.
MOST_BYTES = 1 << 24
_MOST_TAGS = 200
#: Largest difference of the channels' sum from D50 (XYZ), and of a curve's last value from 1: vendors round.
_WHITE_TOLERANCE = 0.02
#: Largest X, Y or Z of a display's white before it is scaled to Y = 1; its Y is then about 1.
_BRIGHTEST = 10.0
_ACCEPTED = "an ICC profile of an RGB display with a matrix and tone curves"
_CURVE_CODES = 4096
#: Parameters of ``para`` by function type, in the order of the file.
_PARAMETERS = ("g", "gab", "gabc", "gabcd", "gabcdef")


class Profile(NamedTuple):
    """Display as an ICC profile describes it.

    ``xyz_from_rgb`` is (3, 3), for linear RGB; the display's white has Y = 1 and is not adapted to D50.
    """

    description: str
    xyz_from_rgb: np.ndarray
    curves: tuple[Curve, Curve, Curve]


def bradford(target_white: np.ndarray, source_white: np.ndarray) -> np.ndarray:
    """Return the matrix of the Bradford adaptation from a source white to a target white, XYZ to XYZ, (3, 3)."""
    target, source = _BRADFORD @ target_white, _BRADFORD @ source_white
    return np.linalg.inv(_BRADFORD) @ np.diag(target / source) @ _BRADFORD


def write_profile(profile: Profile) -> bytes:
    """Return the bytes of a version 4 profile; primaries are adapted to D50 by the Bradford matrix in its ``chad``.

    A sampled curve is stored at 4096 codes, in steps of 1/65535 of linear light.
    """
    white = profile.xyz_from_rgb.sum(axis=1)
    adapt = bradford(D50_XYZ, white)
    colorants = adapt @ profile.xyz_from_rgb
    tags = {
        b"desc": _text(profile.description),
        b"cprt": _text("No copyright"),
        b"wtpt": _numbers(b"XYZ ", D50_XYZ),
        b"chad": _numbers(b"sf32", adapt),
        b"rXYZ": _numbers(b"XYZ ", colorants[:, 0]),
        b"gXYZ": _numbers(b"XYZ ", colorants[:, 1]),
        b"bXYZ": _numbers(b"XYZ ", colorants[:, 2]),
        **{name: _curve(curve) for name, curve in zip((b"rTRC", b"gTRC", b"bTRC"), profile.curves, strict=True)},
    }
    table, data, first = b"", b"", _HEADER + 4 + 12 * len(tags)
    for name, content in tags.items():
        table += name + struct.pack(">II", first + len(data), len(content))
        data += content + b"\0" * (-len(content) % 4)
    body = struct.pack(">I", len(tags)) + table + data
    # The date is fixed: the same display gives the same bytes.
    header = struct.pack(">I4xI4s4s4s6H4s", _HEADER + len(body), 0x04400000, b"mntr", b"RGB ", b"XYZ ",
                         2000, 1, 1, 0, 0, 0, b"acsp")  # fmt: skip
    header = header.ljust(64, b"\0") + struct.pack(">I", 1) + _fixed(D50_XYZ)
    return header.ljust(_HEADER, b"\0") + body


def read_profile(data: bytes, file) -> Profile:
    """Read a display's profile.

    Parameters
    ----------
    data : bytes
    file : path
        Path of the data's file, for the error message.

    Raises
    ------
    InputError
        If the data are not an ICC profile, are truncated or too long, describe another device or colour space, or hold
        colour tables, a curve that falls or does not end at white, or colorants that do not add up to white.
    """
    if len(data) > MOST_BYTES:
        raise InputError(file, "", f"more than {MOST_BYTES} bytes", _ACCEPTED)
    try:
        return _read(data, file)
    except (struct.error, IndexError, UnicodeDecodeError, np.linalg.LinAlgError, ZeroDivisionError):
        raise InputError(file, "", "a damaged ICC profile", _ACCEPTED) from None
    except ValueError as error:
        raise InputError(file, "", str(error), _ACCEPTED) from None


def _read(data: bytes, file) -> Profile:
    if data[36:40] != b"acsp" or struct.unpack(">I", data[:4])[0] > len(data):
        raise InputError(file, "", "no whole ICC profile", _ACCEPTED)
    device, space = data[12:16], data[16:20]
    if device != b"mntr" or space != b"RGB ":
        found = f"a profile of the class {device.decode()!r} for {space.decode().strip()!r}"
        raise InputError(file, "", found, _ACCEPTED)
    tags = {}
    count = struct.unpack(">I", data[_HEADER : _HEADER + 4])[0]
    if count > _MOST_TAGS:
        raise ValueError(f"{count} tags")
    for i in range(count):
        name, offset, size = struct.unpack(">4sII", data[_HEADER + 4 + 12 * i : _HEADER + 16 + 12 * i])
        if offset + size > len(data):
            raise ValueError(f"a tag that ends {offset + size - len(data)} bytes beyond the file")
        tags[name] = data[offset : offset + size]
    if any(name.startswith((b"A2B", b"B2A")) for name in tags):
        raise InputError(file, "A2B0", "colour tables (LUT)", _ACCEPTED)
    needed = (b"rXYZ", b"gXYZ", b"bXYZ", b"rTRC", b"gTRC", b"bTRC", b"wtpt")
    missing = [name.decode() for name in needed if name not in tags]
    if missing:
        raise InputError(file, missing[0], "no such tag", _ACCEPTED)
    colorants = np.column_stack([_read_fixed(tags[name][8:20]) for name in needed[:3]])
    white = _read_fixed(tags[b"wtpt"][8:20])
    if not (white > 0.0).all() or abs(np.linalg.det(colorants)) < 1e-6:
        raise ValueError("a display without white, or of primaries that lie on one line")
    total = colorants.sum(axis=1)
    if np.abs(total - D50_XYZ).max() > _WHITE_TOLERANCE:
        listed = ", ".join(f"{value:.4g}" for value in total)
        raise ValueError(f"colorants whose sum is {listed} and not the white of D50")
    # A version 2 profile without `chad` states the display's white and leaves the adaptation open; Bradford is usual.
    with np.errstate(all="ignore"):
        adapt = _read_fixed(tags[b"chad"][8:44]).reshape(3, 3) if b"chad" in tags else bradford(D50_XYZ, white)
        matrix = np.linalg.inv(adapt) @ colorants
    own = matrix.sum(axis=1)
    if not (np.isfinite(matrix).all() and (own > 0.0).all() and own.max() < _BRIGHTEST):
        raise ValueError("an adaptation (chad, or the white of wtpt) that does not make the sum of the colorants white")
    red, green, blue = (_read_curve(tags[name]) for name in needed[3:6])
    for name, curve in zip(needed[3:6], (red, green, blue), strict=True):
        top = float(curve.linear(np.ones(1))[0])
        if abs(top - 1.0) > _WHITE_TOLERANCE:
            raise InputError(file, name.decode(), f"a tone curve that ends at {top:g}", "one that ends at 1, white")
    text = "".join(letter for letter in _read_text(tags.get(b"desc", b"")) if letter.isprintable())
    description = text or str(file)
    return Profile(description, matrix / own[1], (red, green, blue))


def _fixed(values) -> bytes:
    return np.rint(np.asarray(values, dtype=np.float64) * 65536).astype(">i4").tobytes()


def _read_fixed(data: bytes) -> np.ndarray:
    return np.frombuffer(data, dtype=">i4").astype(np.float64) / 65536


def _numbers(kind: bytes, values) -> bytes:
    return kind + b"\0" * 4 + _fixed(values)


def _text(text: str) -> bytes:
    content = text.encode("utf-16-be")
    return b"mluc" + struct.pack(">IIIHHII", 0, 1, 12, 0x656E, 0x5553, len(content), 28) + content


def _read_text(data: bytes) -> str:
    if data[:4] == b"mluc":
        size, offset = struct.unpack(">II", data[20:28])
        return data[offset : offset + size].decode("utf-16-be")
    if data[:4] == b"desc":
        size = struct.unpack(">I", data[8:12])[0]
        return data[12 : 12 + size].split(b"\0")[0].decode("ascii", "replace")
    return ""


def _curve(curve: Curve) -> bytes:
    if isinstance(curve, ParametricCurve):
        parameters = (curve.g, curve.a, curve.b, curve.c, curve.d, curve.e, curve.f)
        return b"para" + struct.pack(">IHH", 0, 4, 0) + _fixed(parameters)
    values = np.rint(curve.linear(np.linspace(0.0, 1.0, _CURVE_CODES)) * 65535)
    return b"curv" + struct.pack(">II", 0, _CURVE_CODES) + values.astype(">u2").tobytes()


def _read_curve(data: bytes) -> Curve:
    kind = data[:4]
    if kind == b"para":
        number = struct.unpack(">H", data[8:10])[0]
        names = _PARAMETERS[number]
        values = _read_fixed(data[12 : 12 + 4 * len(names)])
        given = dict(zip(names, map(float, values), strict=True))
        if number == 2:  # its c is added to both pieces
            given |= {"e": given["c"], "f": given.pop("c")}
        if number in (1, 2):
            given["d"] = -given["b"] / given["a"]
        return ParametricCurve(**given)
    if kind != b"curv":
        raise ValueError(f"tone curves of the type {kind.decode('ascii', 'replace')!r}")
    count = struct.unpack(">I", data[8:12])[0]
    values = np.frombuffer(data[12 : 12 + 2 * count], dtype=">u2").astype(np.float64)
    if len(values) != count:
        raise ValueError("a tone curve that ends early")
    if count <= 1:
        return ParametricCurve(float(values[0]) / 256.0 if count else 1.0)
    return SampledCurve(values / 65535.0)
