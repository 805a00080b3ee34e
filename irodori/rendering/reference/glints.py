"""Glints: images of suns in mirrors that are smaller than a pixel, at which some of the pixel's paths are aimed.

Half of the paths of such a pixel start towards a place in the sun, see `irodori.rendering.reference.sun_images`, the
others anywhere in the pixel. All are weighted by the density of both together, so that the pixel's mean stays as it is.
"""

from typing import NamedTuple

import numpy as np

from irodori.jit.compilation import uncounted
from irodori.rendering.reference.sun_images import Images, aim_at_directions, if_images, image_density
from irodori.rendering.scene_arrays import View
from irodori.rendering.surface_hits import frame
from irodori.rendering.view_cameras import ORTHOGRAPHIC

#: Share of a pixel's paths that are aimed at its glints; area of a glint, in pixels, from which on none are.
AIMED, _LARGEST_PX2 = 0.5, 1.0
_AROUND = 12  # directions around a sun from which the outline of its image is found
_RIM = 4  # points of the lens's rim
_BLURS = 2.0  # standard deviations by which the image is larger where a gloss lobe blurs it


class Glints(NamedTuple):
    """Places of glints in a picture, and how directions lead to it."""

    chain: np.ndarray  # (glints,) int64 of `Images`
    box: np.ndarray  # (glints, 4) px, left, upper, right and lower edge
    camera_from_world: np.ndarray  # (3, 3)
    volume: float  # determinant of its inverse, 1 for a picture at right angles to the line of sight


def find_glints(images: Images, view: View) -> Glints:
    """Return the glints of a view; none for parallel rays, whose directions are all the same."""
    axes = view.world_from_camera
    turn = np.ascontiguousarray(np.linalg.inv(axes)), abs(float(np.linalg.det(axes)))
    if not len(images.weight) or view.kind == ORTHOGRAPHIC:
        return Glints(np.zeros(0, np.int64), np.zeros((0, 4)), *turn)
    eyes = [view.position_mm]
    for angle in np.arange(_RIM) * 2.0 * np.pi / _RIM if view.lens_mm > 0.0 else ():
        eyes.append(view.position_mm + 0.5 * view.lens_mm * axes[:, :2] @ [np.cos(angle), np.sin(angle)])
    found = []
    for chain, kappa in enumerate(images.kappa):
        blur = _BLURS / np.sqrt(kappa) if kappa > 0.0 else 0.0
        for middle, reach in zip(images.towards, images.reach, strict=True):
            sun = _around(middle, reach + blur)
            box = _box(images, view, chain, [(eye, towards) for eye in eyes for towards in sun], turn[0])
            if box is not None:
                found.append((chain, box))
    return Glints(
        np.array([one for one, _ in found], dtype=np.int64), np.array([box for _, box in found]).reshape(-1, 4), *turn
    )


def _around(towards: np.ndarray, reach: float) -> list[np.ndarray]:
    """Return the direction of a sun and some around it."""
    tangent, bitangent = (np.array(side) for side in frame(towards))
    turns = np.arange(_AROUND) * 2.0 * np.pi / _AROUND
    ring = [np.cos(reach) * towards + np.sin(reach) * (np.cos(a) * tangent + np.sin(a) * bitangent) for a in turns]
    return [towards, *ring]


def _box(images: Images, view: View, chain: int, rays: list, camera_from_world: np.ndarray) -> np.ndarray | None:
    """Return the part of the picture where a chain shows a sun to the eye, px; None if there is none or it is large."""
    origin, target = (np.array(one) for one in zip(*rays, strict=True))
    direction, met = np.zeros_like(origin), np.zeros(len(origin), dtype=np.bool_)
    aim_at_directions(images, np.full(len(origin), chain), origin, target, direction, met)
    away, lens = direction[met] @ camera_from_world.T, (origin[met] - view.position_mm) @ camera_from_world.T
    away, lens = away[away[:, 2] > 0.0], lens[away[:, 2] > 0.0]
    if not len(away):
        return None
    place = view.focal_px * (away[:, :2] / away[:, 2:] + lens[:, :2] / view.focus_mm)
    place += 0.5 * np.array([view.width, view.height])
    box = np.concatenate([place.min(axis=0), place.max(axis=0)])
    size, whole = box[2:] - box[:2], np.array([view.width, view.height])
    seen = (box[2:] >= 0.0).all() and (box[:2] <= whole).all()
    return box if seen and size.prod() <= _LARGEST_PX2 else None


@if_images(False)
@uncounted(error_model="numpy")
def fill_glint_shares(images, glints, x, y, share):
    """Fill the probabilities of the chains that show glints in a pixel; return whether there are any."""
    total = 0.0
    for glint in range(glints.chain.size):
        box, chain = glints.box, glints.chain[glint]
        if box[glint, 0] <= x + 1 and box[glint, 2] >= x and box[glint, 1] <= y + 1 and box[glint, 3] >= y:
            if total == 0.0:
                for other in range(images.weight.size):
                    share[other] = 0.0
            if share[chain] == 0.0:
                share[chain] = images.weight[chain]
                total += share[chain]
    for chain in range(images.weight.size):
        share[chain] = share[chain] / total if total > 0.0 else 0.0
    return total > 0.0


@if_images(1.0)
@uncounted(forceinline=True, error_model="numpy")
def weight_in_pixel(images, camera, glints, place, work):
    """Return the weight of a path from the eye in the mean of a pixel with glints, 0 if it lies outside the pixel.

    It is the inverse of the path's density in the pixel, by which all paths are drawn together.

    Parameters
    ----------
    place : (x, y)
        Column and row of the pixel.
    work : Work
        Of the path, with its origin, its direction and the shares of `fill_glint_shares`.
    """
    origin, direction = work.origin, work.direction
    turn, eye = glints.camera_from_world, camera.position_mm
    away_x, away_y, away_z, lens_x, lens_y = 0.0, 0.0, 0.0, 0.0, 0.0
    for axis in range(3):
        away_x += turn[0, axis] * direction[axis]
        away_y += turn[1, axis] * direction[axis]
        away_z += turn[2, axis] * direction[axis]
        lens_x += turn[0, axis] * (origin[axis] - eye[axis])
        lens_y += turn[1, axis] * (origin[axis] - eye[axis])
    if away_z <= 0.0:
        return 0.0
    x = camera.focal_px * (away_x / away_z + lens_x / camera.focus_mm) + 0.5 * camera.width - place[0]
    y = camera.focal_px * (away_y / away_z + lens_y / camera.focus_mm) + 0.5 * camera.height - place[1]
    if not (0.0 <= x < 1.0 and 0.0 <= y < 1.0):
        return 0.0
    start, way = (origin[0], origin[1], origin[2]), (direction[0], direction[1], direction[2])
    of_pixel = glints.volume * away_z**3 / (camera.focal_px * camera.focal_px)  # sr / px²
    return 1.0 / (1.0 - AIMED + AIMED * of_pixel * image_density(images, work.glint, start, way))
