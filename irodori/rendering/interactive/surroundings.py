"""Surroundings of a scene's objects as their gloss sees them: which directions other objects hide, and their light.

For some texels of each object, a cube map of coarse directions holds the share of directions that lead to the
environment, and the radiance of the objects in the others. A rough lobe reflects the blurred environment by that share,
and the objects' light in place of the rest. The radiance is that of the interactive integrator itself, with light maps,
so that it takes a second where path tracing would take minutes.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from irodori.core.progress import LOGGER
from irodori.geometry.embree import NO_HIT, Tracer
from irodori.geometry.shapes.placement import reaches
from irodori.geometry.shapes.shadow_nodes import raised
from irodori.light.gloss.gloss_maps import GlossMaps
from irodori.rendering.interactive.cube_maps import FACES, face_directions, fill_borders
from irodori.rendering.interactive.frame_renderer import CollimatedLamp, Prepared, prepare_scene
from irodori.rendering.interactive.pixel_rays import render_rays
from irodori.rendering.interactive.tile_loop import LISTED
from irodori.rendering.light_maps import LightMaps
from irodori.rendering.map_layouts import Points, make_layout
from irodori.rendering.scene_arrays import Light, Objects, View
from irodori.spectra.grid import SAMPLES

#: Texels of an object, texels along the side of a cube's face, and rays along each side of such a texel.
TEXELS, SIDE, _ALONG = 1 << 8, 4, 4
#: Numbers of a direction, see `irodori.rendering.interactive.representation_layout.Layout.seen`.
SEEN = 8
_LIFT = 0.02  # height above the horizon to which directions below it are lifted, for the look-ups next to it
_TOGETHER = 64  # texels whose rays are traced at a time
_CHOSEN = 64  # texels of each object from whose surroundings the basis is made
_LEFT_OUT = 0.05  # share of the objects' light that the basis may leave out without a warning


class _Sight(NamedTuple):
    """A scene into which rays are traced from the texels, in the representation ``spectral`` and with light maps."""

    prepared: Prepared
    tracer: Tracer
    lamps: tuple[CollimatedLamp, ...]


def with_surroundings(
    maps: LightMaps,
    objects: Objects,
    light: Light,
    gloss: GlossMaps,
    tracer: Tracer,
    *,
    lamps: np.ndarray,
    directions: Sequence[np.ndarray] = (),
) -> LightMaps:
    """Return light maps with the surroundings of all objects except meshes, whose gloss is left unoccluded.

    Parameters
    ----------
    maps : LightMaps
    objects, light, gloss, tracer
        As in `irodori.rendering.interactive.frame_renderer.prepare_scene`.
    lamps : (n, 61) float
        Spectral irradiance of each collimated light.
    directions : sequence of (3,) float
        Direction towards each of them.
    """
    white = np.ones(SAMPLES)  # not used for bands
    prepared = prepare_scene(objects, light, gloss, tracer, "spectral", white, lamps=lamps, maps=maps)
    sight = _Sight(prepared, tracer, tuple(CollimatedLamp(direction) for direction in directions))
    places, sizes = [], []
    for index, (placement, reach) in enumerate(zip(tracer.placements, reaches(tracer.placements), strict=True)):
        layout, is_mesh = make_layout(tracer.placements, index), placement.shape.triangles is not None
        points = Points(*np.zeros((3, 0, 3))) if is_mesh else layout.points(TEXELS)
        places.append(points._replace(point=raised(points.point, points.facet, reach)))
        sizes.append((0, 0) if is_mesh else layout.size(TEXELS))
    basis = _basis(sight, places)
    seen = [_seen(sight, points, basis).reshape(*size, FACES, SIDE + 2, SIDE + 2, SEEN)
            for points, size in zip(places, sizes, strict=True)]  # fmt: skip
    return replace(maps, seen=tuple(seen), seen_basis=basis)


def _basis(sight: _Sight, places: Sequence[Points]) -> np.ndarray:
    """Return orthonormal vectors, (61, SEEN - 1), that represent the objects' light best."""
    squares, rng = np.zeros((SAMPLES, SAMPLES)), np.random.default_rng(0)
    for points in places:
        chosen = rng.permutation(len(points.point))[:_CHOSEN]
        for _, radiance in _radiance(sight, Points(*(values[chosen] for values in points))):
            flat = radiance.reshape(-1, SAMPLES).astype(np.float64)
            squares += flat.T @ flat
    values, vectors = np.linalg.eigh(squares)
    rest, whole = values[: 1 - SEEN].sum(), values.sum()
    if rest > _LEFT_OUT**2 * whole:
        share = np.sqrt(rest / whole)
        LOGGER.warning("gloss shows the light of other objects without %.2g of it: its spectra differ much", share)
    return np.ascontiguousarray(vectors[:, ::-1][:, : SEEN - 1])


def _seen(sight: _Sight, points: Points, basis: np.ndarray) -> np.ndarray:
    """Return the cube maps of some texels, (n, 6, SIDE + 2, SIDE + 2, SEEN) float32."""
    stored = np.zeros((FACES, SIDE + 2, SIDE + 2, len(points.point), SEEN), np.float32)
    first = 0
    for free, radiance in _radiance(sight, points):
        found = np.concatenate([free[..., None], radiance @ basis.astype(np.float32)], axis=-1)
        found = found.reshape(-1, FACES, SIDE, SIDE, SEEN)
        stored[:, 1:-1, 1:-1, first : first + len(free)] = np.moveaxis(found, 0, -2)
        first += len(free)
    if first:
        fill_borders(stored.reshape(FACES, SIDE + 2, SIDE + 2, -1))
    return np.moveaxis(stored, 3, 0)


def _radiance(sight: _Sight, points: Points) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield for some texels at a time the share of free directions, (n, cells), and the radiance, (n, cells, 61)."""
    fine = np.stack([face_directions(face, SIDE * _ALONG) for face in range(FACES)])
    parts = fine.reshape(FACES, SIDE, _ALONG, SIDE, _ALONG, 3).swapaxes(2, 3).reshape(FACES * SIDE**2, -1, 3)
    view = View(np.zeros(3), np.eye(3), 1.0, 1, 1)  # of which only the kind counts
    for first in range(0, len(points.point), _TOGETHER):
        origin, facet = (values[first : first + _TOGETHER, None, None] for values in (points.point, points.facet))
        direction = parts + np.maximum(_LIFT - (parts * facet).sum(axis=-1, keepdims=True), 0.0) * facet
        rays = np.zeros((*direction.shape[:3], LISTED), np.float32)
        rays[..., :3], rays[..., 3:6] = origin, direction / np.linalg.norm(direction, axis=-1, keepdims=True)
        rays[..., 7] = 0.5 * np.pi / (SIDE * _ALONG)
        flat = rays.reshape(-1, LISTED)
        met = sight.tracer.intersect(flat[:, :3], flat[:, 3:6])[1] != NO_HIT
        found = np.zeros((len(flat), SAMPLES), np.float32)
        found[met] = render_rays(sight.prepared, view, flat[met], sight.lamps, bands=True)
        cells = rays.shape[:3]
        yield 1.0 - met.reshape(cells).mean(axis=2), found.reshape(*cells, SAMPLES).mean(axis=2)
