"""Meshes of bodies of revolution with texture coordinates, as examples and test cases.

``python tests/lathe.py OUT.obj`` writes the lid of ``config/objects/celadon-lid.yaml``.
"""

import sys
from pathlib import Path

import numpy as np

#: Radius and height of the lid of a box, mm: rim, dome, knob. It is open below, where no camera sees it.
LID_MM = (
    (30.4, 0.0), (31.0, 1.4), (30.8, 3.0), (29.6, 5.0), (27.4, 7.8), (24.4, 10.6), (20.6, 13.2), (16.2, 15.4),
    (11.6, 17.0), (7.6, 18.0), (4.8, 18.8), (3.9, 20.2), (4.5, 22.0), (5.6, 23.6), (6.0, 25.2),
    (5.4, 26.8), (3.8, 28.0), (1.8, 28.6), (0.0, 28.8),
)  # fmt: skip
_SEGMENTS = 36
_MARGIN = 1.0 / 64.0  # of the texture, between the chart and its edge


def lathe(profile_mm, segments: int, margin: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Turn a profile about z.

    Parameters
    ----------
    profile_mm : (p, 2) float
        Radius and height; the outside lies to the right of the way from the first point to the last.
    segments : int
        Facets around.
    margin : float
        Of the texture's width and height left free on each side.

    Returns
    -------
    corners_mm : (m, 3, 3) float64, counter-clockwise seen from outside
    uv : (m, 3, 2) float64
        u is the azimuth from +x towards +y, v the way along the profile from its last point (top) to its first, so
        that the texture reads as seen from outside. Where the profile meets the axis the quadrangles are triangles.
    """
    profile = np.asarray(profile_mm, dtype=np.float64)
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(profile, axis=0), axis=1))])
    v = 1.0 - way / way[-1]
    u = np.arange(segments + 1) / segments
    azimuth = 2 * np.pi * (np.arange(segments + 1) % segments) / segments
    position = np.stack(
        [
            profile[:, :1] * np.cos(azimuth),
            profile[:, :1] * np.sin(azimuth),
            np.repeat(profile[:, 1:], segments + 1, axis=1),
        ],
        axis=-1,
    )
    coordinates = np.stack(np.broadcast_arrays(u[None, :], v[:, None]), axis=-1)
    coordinates = margin + (1.0 - 2.0 * margin) * coordinates
    corners: list[np.ndarray] = []
    uv: list[np.ndarray] = []
    for values, out in ((position, corners), (coordinates, uv)):
        a, b, c, d = values[:-1, :-1], values[:-1, 1:], values[1:, 1:], values[1:, :-1]
        for triangle in ((a, b, c), (a, c, d)):
            out.append(np.stack(triangle, axis=2).reshape(-1, 3, values.shape[-1]))
    return np.concatenate(corners), np.concatenate(uv)


def write_obj(path, corners_mm, uv, normals=None, digits: int = 6) -> None:
    """Write triangles as an OBJ, each position and each texture coordinate once.

    Parameters
    ----------
    path : path
    corners_mm : (m, 3, 3) float
    uv : (m, 3, 2) float or None
        v from the top, as everywhere here; the file counts it from below.
    normals : (m, 3, 3) float, optional
    digits : int
        Significant digits.
    """
    tables = {"v": np.asarray(corners_mm).reshape(-1, 3)}
    if uv is not None:
        tables["vt"] = np.asarray(uv).reshape(-1, 2) * [1.0, -1.0] + [0.0, 1.0]
    if normals is not None:
        tables["vn"] = np.asarray(normals).reshape(-1, 3)
    lines, columns = [], []
    for name, values in tables.items():
        texts: dict[str, int] = {}
        numbers = []
        for row in values:
            text = " ".join(f"{value + 0.0:.{digits}g}" for value in row)
            numbers.append(texts.setdefault(text, len(texts) + 1))
        lines += [f"{name} {text}" for text in texts]
        columns.append(numbers)
    parts = ["/".join(map(str, numbers)) for numbers in zip(*columns, strict=True)]
    if uv is None and normals is not None:
        parts = [part.replace("/", "//") for part in parts]
    lines += [f"f {' '.join(parts[i : i + 3])}" for i in range(0, len(parts), 3)]
    Path(path).write_text("\n".join(lines) + "\n", encoding="utf-8")


def write_lid(path) -> None:
    """Write the example's lid, mm, its rim at z = 0."""
    corners, uv = lathe(LID_MM, _SEGMENTS, _MARGIN)
    solid = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) > 1e-9
    write_obj(path, corners[solid], uv[solid], digits=5)


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python tests/lathe.py OUT.obj")
    write_lid(sys.argv[1])
