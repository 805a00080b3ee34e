"""Directions to lamps from their mirror images on a ball, such as a polished bearing ball.

A distant camera sees a lamp mirrored where the normal of the ball bisects the angle between the directions to the lamp
and to the camera. The camera is assumed to be infinitely far away. If it is n radii away, the direction to the camera
is wrong by up to 1 / n rad at the rim of the ball, and less towards its centre.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from irodori.core.atomic_files import written_whole
from irodori.core.errors import InputError
from irodori.core.file_kinds import is_picture
from irodori.export.pictures import stored_samples
from irodori.geometry.circle_search import Circle, find_circle
from irodori.ingest.mosaic import decode

#: Pixels brighter than this share of the brightest one on the ball belong to a mirror image.
_HIGHLIGHT = 0.5
#: If a second mirror image has more than this share of the pixels of the first, it is unclear which is the lamp's.
_SECOND = 0.5
_ACCEPTED = "RAW files, or TIFF or PNG pictures, which need not be linear here"


def brightness(path) -> np.ndarray:
    """Return the darkest band of each pixel or superpixel, (rows, columns), as a fraction of the file's full scale."""
    if is_picture(path):
        samples, _ = stored_samples(path, _ACCEPTED)
        top = np.iinfo(samples.dtype).max if np.issubdtype(samples.dtype, np.integer) else 1.0
        return samples[..., :3].min(axis=-1) / top
    mosaic = decode(path)
    return mosaic.superpixels.min(axis=-1) / mosaic.full_scale


def outline(pictures: Sequence[np.ndarray], path) -> Circle:
    """Find the outline of a ball that has the same place in all pictures, see `find_circle`."""
    # Square roots, so that a highlight in one picture does not outweigh the background of all.
    return find_circle(np.mean([np.sqrt(np.maximum(one, 0.0)) for one in pictures], axis=0) ** 2, path)


def lamp_direction(picture: np.ndarray, circle: Circle, path) -> np.ndarray:
    """Return the direction from a mirror ball to the lamp: x right, y up, z to the camera, (3,) of unit length.

    Parameters
    ----------
    picture : (rows, columns) float
        Brightness.
    circle : Circle
        Outline of the ball.
    path : path
        Name of the picture for the error message.

    Raises
    ------
    InputError
        If there is no highlight on the ball, or two of similar size.
    """
    from scipy import ndimage  # slow to import

    normals = circle.normals(picture.shape)
    on_ball = np.isfinite(normals[..., 2])
    level = np.where(on_ball, picture, 0.0)
    top, usual = float(level.max()), float(np.median(picture[on_ball])) if on_ball.any() else 0.0
    if not top > 2.0 * usual + 0.02:
        raise InputError(path, "", "no highlight on the ball", "a polished ball that mirrors one lamp")
    numbers, _ = ndimage.label(level >= _HIGHLIGHT * top)
    sizes = np.bincount(numbers.ravel())[1:]
    order = np.argsort(-sizes)
    if len(sizes) > 1 and sizes[order[1]] > _SECOND * sizes[order[0]]:
        raise InputError(path, "", f"{len(sizes)} highlights on the ball", "one lamp alone")
    rows, columns = np.nonzero(numbers == 1 + order[0])
    # A small highlight covers most of its pixels only in part: brighter pixels count more.
    weight = level[rows, columns] - 0.99 * _HIGHLIGHT * top
    x, y = (float(np.average(places, weights=weight)) for places in (columns, rows))
    a, b = (x - circle.x) / circle.radius, (circle.y - y) / circle.radius
    normal = np.array([a, b, np.sqrt(max(1.0 - a * a - b * b, 0.0))])
    return 2.0 * normal[2] * normal - [0.0, 0.0, 1.0]


def write_light_places(path, directions: dict[str, np.ndarray]) -> None:
    """Write a light-position file (.lp) for `irodori.first_project.light_places.read_light_places`.

    Parameters
    ----------
    path : path
    directions : dict
        Direction to the lamp, (3,), by the name of the photograph.
    """
    lines = [f"{name} " + " ".join(f"{value:.6f}" for value in place) for name, place in directions.items()]
    with written_whole(path) as temporary:
        Path(temporary).write_text("\n".join([str(len(lines)), *lines]) + "\n", encoding="utf-8")
