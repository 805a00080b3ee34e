"""Payload of a classroom page: a JSON header and planes of numbers, compressed and written as base64.

The base64 text holds one gzip stream, whose CRC-32 detects damage (the checksum of a zlib stream missed a wrong byte in
smooth planes). Decompressed, it holds the length of the header in bytes as a little-endian uint32; the header, JSON in
UTF-8; and the planes in order, each in the form that its entry of ``planes`` in the header describes. The integers q of
a plane are stored as differences in zigzag coding (0, -1, 1, -2 ... become 0, 1, 2, 3 ...): first the lowest bytes of
all numbers, then the second bytes, and so on. ``irodori/viewer/page/payload.js`` reads the same format.
"""

import base64
import binascii
import json
import math
import struct
import zlib
from dataclasses import asdict, dataclass, fields

import numpy as np

from irodori.core.errors import InputError

SCHEMA_VERSION = 2
#: Largest accepted size of a decompressed payload, bytes: no page of this package is larger.
MOST_BYTES = 1 << 28
_GZIP = 16 + zlib.MAX_WBITS
#: First bytes of the stream: a gzip header without name and time.
_HEAD = zlib.compress(b"", wbits=_GZIP)[:9]
_BITS = 10
#: Steps of light: of the logarithm of the first coefficient, octaves, and of the others over the first.
LOG_STEP, RATIO_STEP = 1.0 / 256.0, 1.0 / 448.0
_FLOOR = 1e-4  # share of the mean first coefficient below which steps are no longer proportional to the level
CODES, DELTAS = ("linear", "log", "light", "float"), ("row", "above")


@dataclass(frozen=True)
class StoredPlane:
    """Entry of the header that describes a stored plane: its shape and the coding of its numbers.

    Parameters
    ----------
    name : str
    shape : tuple of int
        Channels first; the last axis runs along a row.
    code : str
        How integers q become values. ``linear``: low + q step, by channel. ``log``: floor (2^(q step) - 1). ``light``:
        channel 0 as in ``log``, the others (channel 0 + floor) (low + q step). ``float``: no integers, but
        little-endian float32.
    delta : str
        ``row``: differences to the preceding number in the row are stored; ``above``: these differences less those in
        the row above.
    width : int
        Bytes per number.
    low, step : tuple of float
        Offset and step of each channel.
    floor : float
        Scale of the logarithm.
    """

    name: str
    shape: tuple[int, ...]
    code: str
    delta: str = "row"
    width: int = 4
    low: tuple[float, ...] = ()
    step: tuple[float, ...] = ()
    floor: float = 0.0

    @property
    def bytes(self) -> int:
        """Number of bytes that the plane takes in the stream."""
        return math.prod(self.shape) * self.width


class StoredPlanes:
    """Planes of a payload, to which new ones are added."""

    def __init__(self) -> None:
        self.entries: list[StoredPlane] = []
        self.content: list[bytes] = []

    def add_floats(self, name: str, values: np.ndarray) -> None:
        """Add a plane in single precision, without quantisation."""
        values = np.ascontiguousarray(values, dtype="<f4")
        self.entries.append(StoredPlane(name, values.shape, "float"))
        self.content.append(values.tobytes())

    def add_linear(self, name: str, values: np.ndarray, bits: int = _BITS) -> None:
        """Add channels, (channels, ...), each quantised uniformly between its least and its largest number."""
        flat = np.asarray(values, dtype=np.float64).reshape(len(values), -1)
        low, high = flat.min(axis=1), flat.max(axis=1)
        step = np.where(high > low, (high - low) / (2**bits - 1), 1.0)
        q = np.rint((flat - low[:, None]) / step[:, None])
        self._add(StoredPlane(name, np.shape(values), "linear", low=tuple(low), step=tuple(step)), q)

    def add_integers(self, name: str, values: np.ndarray) -> None:
        """Add non-negative integers, (channels, ...), exactly."""
        count = len(values)
        self._add(
            StoredPlane(name, np.shape(values), "linear", low=(0.0,) * count, step=(1.0,) * count), np.asarray(values)
        )

    def add_log(self, name: str, values: np.ndarray, bits: int = _BITS) -> None:
        """Add channels of non-negative numbers, (channels, ...), quantised on a logarithmic scale."""
        flat = np.maximum(np.asarray(values, dtype=np.float64), 0.0).reshape(len(values), -1)
        floor = _FLOOR * flat.max() or 1.0
        octaves = np.log2(flat / floor + 1.0)
        step = octaves.max() / (2**bits - 1) or 1.0
        plane = StoredPlane(name, np.shape(values), "log", low=(), step=(step,) * len(flat), floor=floor)
        self._add(plane, np.rint(octaves / step))

    def add_light(self, name: str, values: np.ndarray, basis: np.ndarray) -> None:
        """Add coefficients of light, (k, ...), on a basis, (k, 61): logarithm of the level, colour relative to it.

        The first coefficient is the level; if spectral recovery made it negative, it is set to 0. The steps of the
        others are equal steps of the spectrum: they are larger for a basis vector that is shorter than the first.
        """
        flat = np.asarray(values, dtype=np.float64).reshape(len(values), -1)
        level = np.maximum(flat[0], 0.0)
        floor = _FLOOR * level.mean() or 1.0
        q = [np.rint(np.log2(level / floor + 1.0) / LOG_STEP)]
        level = floor * (np.exp2(q[0] * LOG_STEP) - 1.0)
        length = np.linalg.norm(basis, axis=1)
        steps = [LOG_STEP, *(RATIO_STEP * length[0] / np.where(length[1:] > 0, length[1:], 1.0))]
        lows = [0.0]
        for channel, step in zip(flat[1:], steps[1:], strict=True):
            ratio = np.rint(channel / (level + floor) / step)
            lows.append(float(ratio.min()) * step)
            q.append(ratio - ratio.min())
        plane = StoredPlane(
            name, np.shape(values), "light", low=tuple(lows), step=tuple(map(float, steps)), floor=floor
        )
        self._add(plane, np.stack(q))

    def _add(self, plane: StoredPlane, q: np.ndarray) -> None:
        q = np.asarray(q, dtype=np.int64).reshape(plane.shape)
        found = {}
        for delta in DELTAS:
            difference = np.diff(q, axis=-1, prepend=0)
            if delta == "above":
                difference = np.diff(difference, axis=-2, prepend=0)
            found[delta] = ((difference << 1) ^ (difference >> 63)).astype(np.uint64)
        # The coding with the fewer bits is used; a single row has no row above.
        costs = {d: float(np.log2(z + 1.0).sum()) for d, z in found.items() if d == "row" or q.ndim > 1}
        delta = min(costs, key=lambda name: costs[name])
        stored = found[delta]
        width = max((int(stored.max(initial=0)).bit_length() + 7) // 8, 1)
        entry = StoredPlane(plane.name, plane.shape, plane.code, delta, width, plane.low, plane.step, plane.floor)
        self.entries.append(entry)
        self.content.append(b"".join(((stored >> (8 * i)) & 255).astype(np.uint8).tobytes() for i in range(width)))


def write_payload(header: dict, planes: StoredPlanes) -> str:
    """Return a payload as base64; the schema version and the list of planes are added to the header."""
    whole = {"schema_version": SCHEMA_VERSION, **header, "planes": [asdict(entry) for entry in planes.entries]}
    return _packed(whole, b"".join(planes.content))


def _packed(header: dict, planes: bytes | memoryview) -> str:
    """Return a payload as base64 from a complete header and the bytes of its planes."""
    text = json.dumps(header, ensure_ascii=False, allow_nan=False, separators=(",", ":")).encode()
    stream = b"".join([struct.pack("<I", len(text)), text, planes])
    return base64.b64encode(zlib.compress(stream, wbits=_GZIP)).decode("ascii")


def payload_header(text: str, source="payload") -> dict:
    """Return the header of a payload; parameters and errors are those of `read_payload`."""
    return _header(_unfolded(text, source), source)[0]


def with_stated_errors(text: str, errors: dict, source="payload") -> str:
    """Return a copy of a payload with other stated errors; other parameters and errors are those of `read_payload`."""
    stream = _unfolded(text, source)
    header, first = _header(stream, source)
    return _packed({**header, "stated_errors": errors}, memoryview(stream)[first:])


def _fault(source, found: str, accepted: str = "a payload that irodori wrote", field: str = "") -> InputError:
    return InputError(source, field, found, accepted)


def _plane(source, number: int, entry) -> StoredPlane:
    """Check an entry of the header and return it as a `StoredPlane`."""
    place = f"planes.{number}"
    names = {f.name for f in fields(StoredPlane)}
    if not isinstance(entry, dict) or set(entry) != names:
        raise _fault(source, "an entry with other fields", ", ".join(sorted(names)), place)
    shape, low, step = (entry[name] for name in ("shape", "low", "step"))
    sizes = isinstance(shape, list) and shape and all(type(n) is int and 0 <= n < MOST_BYTES for n in shape)
    if not sizes or not isinstance(entry["name"], str):
        raise _fault(source, "an entry without a name or a shape", "a name and whole numbers", place)
    if entry["code"] not in CODES or entry["delta"] not in DELTAS or entry["width"] not in range(1, 9):
        raise _fault(source, "an unknown code", f"one of {', '.join(CODES)}", place)
    numbers = isinstance(low, list) and isinstance(step, list)
    if not numbers or not all(type(n) in (int, float) for n in [*low, *step, entry["floor"]]):
        raise _fault(source, "steps that are not numbers", "numbers", place)
    needed = {"linear": (shape[0], shape[0]), "log": (0, shape[0]), "light": (shape[0], shape[0]), "float": (0, 0)}
    if (len(low), len(step)) != needed[entry["code"]]:
        raise _fault(source, f"{len(step)} steps of {shape[0]} channels", "one a channel", place)
    return StoredPlane(**{**entry, "shape": tuple(shape), "low": tuple(low), "step": tuple(step)})


def _values(plane: StoredPlane, content: memoryview) -> np.ndarray:
    """Decode the numbers of a plane, float32."""
    if plane.code == "float":
        return np.frombuffer(content, dtype="<f4").reshape(plane.shape)
    parts = np.frombuffer(content, dtype=np.uint8).reshape(plane.width, *plane.shape)
    stored = sum((parts[i].astype(np.int64) << (8 * i) for i in range(plane.width)), np.zeros(plane.shape, np.int64))
    q = (stored >> 1) ^ -(stored & 1)
    if plane.delta == "above":
        q = np.cumsum(q, axis=-2)
    q = np.cumsum(q, axis=-1).astype(np.float64)
    by_channel = (len(q), *(1,) * (q.ndim - 1))
    step = np.array(plane.step).reshape(by_channel)
    if plane.code == "linear":
        return (np.array(plane.low).reshape(by_channel) + q * step).astype(np.float32)
    if plane.code == "log":
        return (plane.floor * (np.exp2(q * step) - 1.0)).astype(np.float32)
    level = plane.floor * (np.exp2(q[0] * plane.step[0]) - 1.0)
    others = (level + plane.floor) * (np.array(plane.low).reshape(by_channel)[1:] + q[1:] * step[1:])
    return np.concatenate([level[None], others]).astype(np.float32)


def read_payload(text: str, source="payload") -> tuple[dict, dict[str, np.ndarray]]:
    """Decode a payload and return its header and its planes by name, float32.

    Parameters
    ----------
    text : str
        Payload as base64.
    source : path or str
        For error messages.

    Raises
    ------
    InputError
        If the payload is damaged or of another version.
    """
    stream = _unfolded(text, source)
    header, first = _header(stream, source)
    view, planes = memoryview(stream), {}
    for number, entry in enumerate(header["planes"]):
        plane = _plane(source, number, entry)
        if first + plane.bytes > len(stream):
            raise _fault(source, "a plane that is cut short", field=f"planes.{number}")
        planes[plane.name] = _values(plane, view[first : first + plane.bytes])
        first += plane.bytes
    if first != len(stream):
        raise _fault(source, f"{len(stream) - first} bytes after the last plane")
    return header, planes


def _unfolded(text: str, source) -> bytes:
    """Decode and decompress a payload into its bytes."""
    try:
        packed = base64.b64decode(text, validate=True)
    except (binascii.Error, ValueError):
        raise _fault(source, "text that is not base64") from None
    unfolding = zlib.decompressobj(_GZIP)
    try:
        if not packed.startswith(_HEAD):
            raise zlib.error
        stream = unfolding.decompress(packed, MOST_BYTES)
    except zlib.error:
        raise _fault(source, "a stream that does not unfold") from None
    if not unfolding.eof or unfolding.unused_data:
        raise _fault(source, "a stream that is cut short, too long or followed by something else")
    return stream


def _header(stream: bytes, source) -> tuple[dict, int]:
    """Return the header and the offset in bytes at which the planes begin."""
    length = struct.unpack("<I", stream[:4])[0] if len(stream) >= 4 else MOST_BYTES
    try:
        header = json.loads(stream[4 : 4 + length].decode("utf-8")) if 4 + length <= len(stream) else None
    except (UnicodeDecodeError, json.JSONDecodeError, RecursionError):
        header = None
    if not isinstance(header, dict) or not isinstance(header.get("planes"), list):
        raise _fault(source, "no header")
    if header.get("schema_version") != SCHEMA_VERSION:
        found = f"version {json.dumps(header.get('schema_version'))[:20]}"
        raise _fault(source, found, f"version {SCHEMA_VERSION}", "schema_version")
    return header, 4 + length
