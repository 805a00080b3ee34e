"""Transfer of light to a scene's surfaces, from which light maps follow for any light without tracing anything again.

From each texel of the maps, rays are traced once, in directions that fill cells of the sphere. They find the share of
each cell that surfaces hide, and the texel of another map that is seen there. The light on all texels then follows for
any light from all directions, turned about the vertical axis by any angle, any collimated lamps, and any colours:

* Light from the surroundings is the irradiance without obstacles, less that of the hidden parts of cells. Of the light
  in each cell, the integral of radiance times direction is known. Its product with a normal is the cell's irradiance,
  exactly if all of the cell is above the horizon.
* Light between surfaces is gathered from the texels that are seen, reflection by reflection and wavelength by
  wavelength (radiosity). A surface sends diffuse light evenly in all directions, and a thin sheet also what passes
  through it. Its gloss and its mirror send on what comes from the mirror direction, from a cell or another texel, with
  their albedo at that angle.

Under a coupled coat, the light that falls on a texel and the diffuse light that it sends count by their angles to its
normal (`irodori.reflection.coat`); the map of a coated object holds light that has been reduced on its way in.

The number of texels is increased until light interpolated between them is close to light found at the same points.
"""

from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from irodori.core.progress import LOGGER
from irodori.geometry.embree import NO_HIT, Tracer
from irodori.geometry.rig_frame import rotation_z
from irodori.geometry.shapes.placement import Placement, reaches
from irodori.geometry.shapes.surface_nodes import extend_to_closed, raised
from irodori.light.environment_file import Environment
from irodori.light.equirectangular import look_up
from irodori.reflection.albedo import gloss_albedo
from irodori.reflection.coat import passed_array
from irodori.reflection.fresnel import fresnel_array
from irodori.rendering.interactive.cube_maps import FACES
from irodori.rendering.interactive.surroundings import SEEN, SIDE, coarse_texels, stored_cubes, ways_out
from irodori.rendering.light_cells import CELLS, Moments, cell_of, cell_vectors
from irodori.rendering.light_maps import Bake, LightMaps, spectral_basis
from irodori.rendering.map_layouts import Points, make_layout
from irodori.rendering.scene_arrays import Objects, coats_of, coefficients_of, gloss_of, sides_placed, textures
from irodori.rendering.texel_views import Links, TexelView, look_around

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix
    from scipy.spatial import cKDTree

#: Texels of a map, initially and at most; largest error between them, relative to the mean light on the object.
_FEWEST_TEXELS, _MOST_TEXELS, MOST_ERROR = 1 << 10, 1 << 14, 0.02
#: Neighbours from which light is spread to the other corners of a fine mesh; distance, in sizes of the mesh, that
#: counts like a difference of normals by 1; share of open neighbours beyond which a corner is open.
_NEIGHBOURS, _BESIDE, _MOSTLY = 4, 0.05, 0.5
#: Number of points between texels at which the error is measured, and their seed.
_JUDGED, _SEED = 512, 307
#: Texels along each side of a texture, about, from which the reflectances are found.
_MOST_SIDE = 128
#: Cosines at which the albedo of gloss and mirrors is tabulated, the place of the one that stands for its colour, and
#: the albedo below which an object's gloss and mirror light no other object.
_COSINES, _MIDDLE, LEAST_SHINE = np.linspace(0.02, 1.0, 25), 17, 1e-3
#: Cosine from which a texel is seen from behind; that next to a place on an outline may face away a little.
_GRAZING = 0.15
#: Largest change of the light, relative to its mean, at which no further reflection is followed; reflections at most.
_SETTLED, _MOST_REFLECTIONS = 2e-3, 64
#: Share of the light that objects send which its basis for gloss may leave out without a warning.
_LEFT_OUT = 0.05
#: Angles of the environment from whose light the basis of the maps is made.
_ANGLES_DEG = (0.0, 90.0, 180.0, 270.0)


class _Mirror(NamedTuple):
    """Light that texels receive by way of an object's gloss or mirror, as if all were reflected in one direction."""

    colour: np.ndarray  # (61,) relative reflectance, mean 1
    cells: "csr_matrix"  # (texels, cells) from mean radiance in the cells
    texels: "csr_matrix"  # (texels, texels) from the light that texels send


#: For each object, the numbers of its open texels and a tree of their places, or None if there are none.
_Trees = list["tuple[np.ndarray, cKDTree] | None"]
#: Numbers of a sparse matrix, with their rows and columns.
_Entries = tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]


class _Rows:
    """Sparse matrix to which rows are added, so that there is no second copy of it at any time.

    Parameters
    ----------
    rows, columns : int
    most : int
        Entries that are added at most.
    """

    def __init__(self, rows: int, columns: int, most: int) -> None:
        self.columns, self.starts, self.count = columns, np.zeros(rows + 1, np.int32), 0
        # The memory of an empty array is taken up as it is written.
        self.data, self.indices = np.empty(most, np.float32), np.empty(most, np.int32)

    def add(self, rows: int, numbers: np.ndarray, places: tuple[np.ndarray, np.ndarray]) -> None:
        """Add some rows below those that are there, from numbers with rows and columns, summed for each place."""
        from scipy.sparse import csr_matrix

        part = csr_matrix((numbers, places), shape=(rows, self.columns), dtype=np.float32)
        stored = slice(self.starts[self.count], self.starts[self.count] + part.nnz)
        self.data[stored], self.indices[stored] = part.data, part.indices
        self.starts[self.count : self.count + rows + 1] = stored.start + part.indptr
        self.count += rows

    def matrix(self) -> "csr_matrix":
        """Return the matrix."""
        from scipy.sparse import csr_matrix

        stored = slice(self.starts[-1])
        shape = len(self.starts) - 1, self.columns
        return csr_matrix((self.data[stored], self.indices[stored], self.starts), shape=shape)


class LightTransfer:
    """Transfer of light to each texel of a scene's light maps, and the maps for any light; see the module.

    Parameters
    ----------
    tracer : Tracer
        Shape i is object i.
    objects : Objects
    environment : Environment
        Light from all directions. In it, turned by quarters, the number of texels is judged.
    """

    def __init__(self, tracer: Tracer, objects: Objects, environment: Environment) -> None:
        self.tracer, self._moments = tracer, Moments(environment.coefficients)
        self._bases: dict[bytes, np.ndarray] = {}
        self._shape, self._behind, self._coats = objects.shape, objects.behind, coats_of(objects)
        self._under = [environment.irradiance_under(n, k) for n, k in self._coats.n_k.tolist()]
        fronts, placements = len(tracer.placements), sides_placed(objects, tracer.placements)
        self._reach = reaches(tracer.placements)[self._shape]
        self.layouts = [
            make_layout(tracer.placements, index, 1.0 if side < fronts else -1.0)
            for side, index in enumerate(self._shape)
        ]
        judged: dict[int, tuple] = {}
        for side, other in enumerate(self._behind):
            if side not in judged:  # both sides of a sheet have texels at the same places
                judged |= self._fine_enough([side] if other < 0 else [side, int(other)], environment)
        found = [judged.pop(side) for side in range(len(placements))]
        self.most, self.errors, points, around, self._spread = zip(*found, strict=True)
        self.sizes = [layout.size(most) for layout, most in zip(self.layouts, self.most, strict=True)]
        self.first = np.cumsum([0, *(len(p.point) for p in points)])
        self.points = Points(*(np.concatenate(parts) for parts in zip(*points, strict=True)))
        self._coat = np.repeat(self._coats.of_side, np.diff(self.first))
        views = [view for views in around for view in views]
        del found, around  # so that no view is kept longer than `_link` needs it
        self.is_open = np.concatenate([view.is_open for view in views])
        shines = [shine_of(objects, index) for index in range(len(placements))]
        near = self._trees()
        self._link(views, shines, near)
        self._trace_gloss(near)
        own = [self._mean_spectra(p, objects, i, points[i]) for i, p in enumerate(placements)]
        self.reflectance = np.concatenate(own)
        shine = np.stack([one[_MIDDLE] for one in shines]).astype(np.float32)
        self.shine = np.repeat(shine, np.diff(self.first), axis=0)
        self.passed = [
            (
                np.s_[self.first[side] : self.first[side + 1]],
                np.s_[self.first[self._behind[side]] : self.first[self._behind[side] + 1]],
                self._mean_spectra(placements[side], objects, sent, points[side]),
            )
            for side, sent in enumerate(objects.through)
            if sent >= 0
        ]

    @staticmethod
    def _mean_spectra(placement: Placement, objects: Objects, index: int, points: Points) -> np.ndarray:
        """Return the mean spectra of a texture around the texels at some points, (n, 61) float32."""
        found = mean_coefficients(placement, objects, index, points) @ objects.basis[index, : objects.bases[index]]
        return found.astype(np.float32)

    def _fine_enough(self, sides: list[int], environment: Environment) -> dict[int, tuple]:
        """Return the number of texels of one or both sides of a shape, and for each side their error and what they see.

        These are the error, the traced places, their views, and how light is spread.
        """
        layout, most = self.layouts[sides[0]], _FEWEST_TEXELS
        while True:
            found = {}
            for side in sides:
                points, spread = thinned(self._raised(self.layouts[side].points(most), side), _MOST_TEXELS)
                views = self._look_around(points, side)
                found[side] = most, self._error(side, most, (points, views, spread), environment), points, views, spread
            error = max(one[1] for one in found.values())
            if error <= MOST_ERROR or 4 * most > _MOST_TEXELS or layout.size(4 * most) == layout.size(most):
                return found
            most *= 4

    def _look_around(self, points: Points, side: int, start: int = 0) -> list[TexelView]:
        behind, first = self._behind[: len(self.tracer.placements)], 0
        views, coat = look_around(self.tracer, points, self._shape[side], behind, start), self._coats.of_side[side]
        for number, view in enumerate(views if coat else ()):
            normal = points.normal[first : first + len(view.is_open)]
            views[number] = view.weighted(normal, lambda cosine: passed_array(cosine, *self._coats.n_k[coat - 1]))
            first += len(normal)
        return views

    def _passed(self, coat: np.ndarray, cosine: np.ndarray) -> np.ndarray:
        """Return the share of light that passes coats by their numbers, (n,), at cosines to the normals, (n,)."""
        share = np.ones(len(cosine))
        for number, (n, k) in enumerate(self._coats.n_k, 1):
            own = coat == number
            share[own] = passed_array(np.clip(cosine[own], 0.0, 1.0), n, k)
        return share

    def _let_out(self, texel: np.ndarray, way: np.ndarray) -> np.ndarray:
        """Return the share of diffuse light that texels let out against ways, (n, 3) of any length; 1 for no texel."""
        if not len(self._coats.n_k):
            return np.ones(len(texel))
        cosine = -(self.points.normal[texel] * way).sum(axis=1) / np.maximum(np.linalg.norm(way, axis=1), 1e-30)
        return self._passed(np.where(texel < 0, 0, self._coat[texel]), cosine)

    def _raised(self, points: Points, index: int) -> Points:
        """Return points of an object, raised above it by more than rounding errors, in double precision."""
        parts = (np.ascontiguousarray(values, dtype=np.float64) for values in points)
        point, normal, facet = parts
        return Points(raised(point, facet, self._reach[index]), normal, facet)

    def _error(self, index: int, most: int, traced: tuple, environment: Environment) -> float:
        """Return the root-mean-square error of direct light between the texels, relative to its mean, without noise."""

        def light(normal: np.ndarray, views: list[TexelView]) -> tuple[np.ndarray, np.ndarray]:
            hidden, is_open = ([getattr(view, name) for view in views] for name in ("hidden", "is_open"))
            coat = np.full(len(normal), self._coats.of_side[index])
            turned = (
                self._direct(environment, np.radians(a), (normal, coat), hidden).mean(axis=1) for a in _ANGLES_DEG
            )
            return np.stack(list(turned), axis=1).astype(np.float64), np.concatenate(is_open)

        (points, views, spread), layout = traced, self.layouts[index]
        found = _on_texels(*light(points.normal, views), spread, layout.cells(most))
        places, shown = layout.between(found.reshape(*layout.size(most), -1), most, _JUDGED, _SEED)
        places, halves = self._raised(places, index), []
        for number in range(2):
            half, is_open = light(places.normal, self._look_around(places, index, number))
            halves.append(half)
        off = [(shown - half)[is_open] for half in halves]
        mean = float(np.mean(halves))
        return float(np.sqrt(max(np.mean(off[0] * off[1]), 0.0))) / mean if mean > 0.0 and is_open.any() else 0.0

    def _trees(self) -> _Trees:
        from scipy.spatial import cKDTree

        own = [first + np.flatnonzero(self.is_open[first:end]) for first, end in pairwise(self.first)]
        return [(texels, cKDTree(self.points.point[texels])) if len(texels) else None for texels in own]

    def _link(self, views: list[TexelView], shines: list[np.ndarray], near: _Trees) -> None:
        """Make the matrices by which texels receive light from cells, from other texels, and by way of mirrors.

        The views are removed one after the other, because enclosed texels have hundreds of links each.
        """
        count, shiny = self.first[-1], [index for index, one in enumerate(shines) if one.max() > LEAST_SHINE]
        most = np.sum([np.bincount(view.shape[view.shape != NO_HIT], minlength=len(shines)) for view in views], axis=0)
        self.hidden: list[csr_matrix] = []
        seen = _Rows(count, count, most.sum())
        cells, texels = ({index: _Rows(count, size, most[index]) for index in shiny} for size in (CELLS, count))
        views.reverse()
        while views:
            view, first = views.pop(), sum(part.shape[0] for part in self.hidden)
            self.hidden.append(view.hidden)
            links = view.links(Points(*(values[first : first + len(view.is_open)] for values in self.points)))
            target = _nearest(near, links.shape, links.place)
            # From here on, links have the texels next to the places that are seen, in place of shapes.
            shape, links = links.shape[target >= 0], Links(*(v[target >= 0] for v in links._replace(shape=target)))
            sent = links.weight * self._let_out(links.shape, links.way)
            seen.add(len(view.is_open), sent, (links.texel, links.shape))
            for index in shiny:
                rays = Links(*(values[shape == index] for values in links))
                to_cells, to_texels = self._reflected(rays, index, shines[index], near)
                cells[index].add(len(view.is_open), *to_cells)
                texels[index].add(len(view.is_open), *to_texels)
        self.seen, colours = seen.matrix(), {index: shines[index][_MIDDLE] for index in shiny}
        self.mirrors = [
            _Mirror((colour / colour.mean()).astype(np.float32), cells[index].matrix(), texels[index].matrix())
            for index, colour in colours.items()
        ]

    def _reflected(self, rays: Links, index: int, shine: np.ndarray, near: _Trees) -> tuple[_Entries, _Entries]:
        """Follow rays to the cells and texels that they meet after an object has reflected them like a mirror.

        Returns their weights in the light of the texels that the rays come from, and the places of these weights.
        """
        normal = self.points.normal[rays.shape]
        way = rays.way / np.maximum(np.linalg.norm(rays.way, axis=1, keepdims=True), 1e-30)
        steep = (way * normal).sum(axis=1)
        way -= 2.0 * steep[:, None] * normal
        distance, shape = self.tracer.intersect(raised(rays.place, normal, self._reach[index]), way)
        share = np.interp(np.clip(-steep, 0.0, 1.0), _COSINES, shine.mean(axis=1)) * (steep < 0.0) * rays.weight
        met = shape != NO_HIT
        there, front = self._met(near, shape[met], rays.place[met] + distance[met, None] * way[met], way[met])
        cells = share[~met], (rays.texel[~met], cell_of(way[~met]))
        front = front * self._let_out(there, way[met])
        return cells, (share[met] * front, (rays.texel[met], np.maximum(there, 0)))

    def _met(self, near: _Trees, shape, place: np.ndarray, way: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the open texels where rays meet sides of shapes, and whether they face the rays."""
        there = _nearest(near, shape, place)
        over = (self._behind[shape] >= 0) & ((self.points.facet[there] * way).sum(axis=1) > 0.0)
        if over.any():
            there[over] = _nearest(near, self._behind[shape[over]], place[over])
        return there, ((self.points.facet[there] * way).sum(axis=1) < _GRAZING) & (there >= 0)

    def _trace_gloss(self, near: _Trees) -> None:
        from scipy.sparse import csr_matrix, vstack

        places, self.gloss_sizes = coarse_texels(self.tracer.placements, self._shape, self.most)
        free, rows = [], []
        for points in places:
            direction = ways_out(points.facet)
            count = direction.shape[0] * direction.shape[1]
            flat = direction.reshape(-1, 3)
            origin = np.repeat(points.point, direction.shape[1] * direction.shape[2], axis=0)
            distance, shape = self.tracer.intersect(origin, flat)
            met = np.flatnonzero(shape != NO_HIT)
            target, front = self._met(near, shape[met], origin[met] + distance[met, None] * flat[met], flat[met])
            cell = met // max(direction.shape[2], 1)
            sent = self._let_out(target, flat[met]) / max(direction.shape[2], 1)
            weight = np.where(front, sent, 0.0).astype(np.float32)
            rows.append(csr_matrix((weight, (cell, np.maximum(target, 0))), shape=(count, self.first[-1])))
            free.append((shape == NO_HIT).reshape(count, -1).mean(axis=1) if count else np.zeros(0))
        self.gloss_seen, self.gloss_free = vstack(rows).tocsr(), np.concatenate(free)

    def maps(self, environment: Environment, angle_deg: float, lamps: np.ndarray, towards: np.ndarray) -> LightMaps:
        """Return the light maps of the scene; those for lights with equal spectra have one basis.

        Parameters
        ----------
        environment : Environment
            Light from all directions; its basis may differ from that of other calls, its coefficients may not.
        angle_deg : float
            Angle by which the environment is turned, from +x towards +y.
        lamps : (n, 61) float
            Spectral irradiance of each collimated light; its direct light is not part of the maps.
        towards : (n, 3) float
            Direction towards each of them, unit.
        """
        key, lit = environment.basis.tobytes() + lamps.tobytes(), (lamps, towards)
        light, sent = self.light(environment, angle_deg, *lit)
        if key not in self._bases:
            others = {angle: self.light(environment, angle, *lit)[0] for angle in _ANGLES_DEG if angle != angle_deg}
            found = [others.get(angle, light) for angle in _ANGLES_DEG]
            self._bases = {key: spectral_basis([one.astype(np.float64) for one in found])}
        basis = self._bases[key]
        coefficients, stored = light @ basis.astype(np.float32), []
        for index, (layout, size) in enumerate(zip(self.layouts, self.sizes, strict=True)):
            own = slice(self.first[index], self.first[index + 1])
            cells = layout.cells(self.most[index])
            spread_out = _on_texels(coefficients[own], self.is_open[own], self._spread[index], cells)
            stored.append(spread_out.astype(np.float32).reshape(*size, -1))
        sizes = zip(self.sizes, self.errors, self.most, strict=True)
        bakes = tuple(Bake(rows * columns, error, most) for (rows, columns), error, most in sizes)
        return LightMaps(tuple(stored), basis, "", bakes, *self._gloss_maps(sent))

    def light(self, environment: Environment, angle_deg: float, lamps, towards) -> tuple[np.ndarray, np.ndarray]:
        """Return the light on texels, as radiance of a perfect diffuser, and that which they send, (texels, 61) each.

        Parameters are those of `maps`.
        """
        angle, normal = np.radians(angle_deg), self.points.normal
        direct = self._direct(environment, angle, (normal, self._coat), self.hidden) + self._mirrored(
            environment, angle
        )
        direct = np.maximum(direct, 0.0)
        source = direct.copy()
        for spectrum, direction in zip(lamps, towards, strict=True):
            facing = normal @ direction
            lit = (facing > 0.0) & ~self.tracer.occluded(self.points.point, np.tile(direction, (len(normal), 1)))
            facing = np.where(lit, facing * self._passed(self._coat, facing), 0.0)
            source += np.outer(facing, spectrum / np.pi).astype(np.float32)
        reflected, settled = np.zeros_like(source), _SETTLED * source.mean()
        for _ in range(_MOST_REFLECTIONS):
            before, sent = reflected, self._sent(self.reflectance, source + reflected)
            reflected = sum((mirror.colour * (mirror.texels @ sent) for mirror in self.mirrors), self.seen @ sent)
            left = np.abs(reflected - before).max()
            if left <= settled:
                break
        else:
            share = left / max(float(source.mean()), np.finfo(np.float32).tiny)
            LOGGER.warning(
                "light maps leave out reflections after %d; the last changed the light by %.2g of its mean",
                _MOST_REFLECTIONS,
                share,
            )
        return direct + reflected, self._sent(self.reflectance + self.shine, source + reflected)

    def _sent(self, reflectance: np.ndarray, light: np.ndarray) -> np.ndarray:
        """Return the light that texels reflect or sheets let through, (texels, 61), of the light on all texels."""
        sent = reflectance * light
        for here, there, transmittance in self.passed:
            sent[here] += transmittance * light[there]
        return sent

    def _direct(self, environment: Environment, angle: float, places: tuple, hidden) -> np.ndarray:
        """Return the light from the environment, turned by an angle, rad, (n, 61), on points that see it in part.

        ``places`` and ``hidden`` have the points' normals, (n, 3), and coats, (n,), and the hidden shares of their
        cells, in matrices of (some points, cells) each.
        """
        (normal, coat), k = places, environment.basis.shape[1]
        free, unit = np.empty((len(normal), k)), normal @ rotation_z(angle)
        for number, irradiance in enumerate((environment.irradiance, *self._under)):
            own = coat == number
            found = np.empty((np.count_nonzero(own), k))
            look_up(irradiance.astype(np.float64), np.ascontiguousarray(unit[own]), found)
            free[own] = found
        cells = self._moments.turned(angle)
        lost = np.concatenate([part @ cells[..., :3].reshape(CELLS, -1) for part in hidden]).reshape(len(normal), k, 3)
        return ((free - (lost * normal[:, None]).sum(axis=2)) / np.pi @ environment.basis.T).astype(np.float32)

    def _mirrored(self, environment: Environment, angle: float) -> np.ndarray:
        """Return the light from the turned environment that texels receive by one mirror, (texels, 61) float32."""
        radiance = self._moments.turned(angle)[..., 3] / np.linalg.norm(cell_vectors(), axis=1, keepdims=True)
        basis, found = environment.basis.T.astype(np.float32), np.zeros_like(self.reflectance)
        for mirror in self.mirrors:
            found += mirror.colour * ((mirror.cells @ radiance.astype(np.float32)) @ basis)
        return found

    def _gloss_maps(self, sent: np.ndarray) -> tuple[tuple[np.ndarray, ...], np.ndarray]:
        """Return `LightMaps.seen` and `LightMaps.seen_basis` for the light that the texels send, (texels, 61)."""
        values, vectors = np.linalg.eigh((sent.T @ sent).astype(np.float64))
        rest, whole = max(values[: 1 - SEEN].sum(), 0.0), values.sum()
        if rest > _LEFT_OUT**2 * whole:
            share = np.sqrt(rest / whole)
            LOGGER.warning("gloss shows the light of other objects without %.2g of it: its spectra differ much", share)
        basis = np.ascontiguousarray(vectors[:, ::-1][:, : SEEN - 1])
        found = np.concatenate([self.gloss_free[:, None], self.gloss_seen @ (sent @ basis.astype(np.float32))], axis=1)
        cubes, first, cells = [], 0, FACES * SIDE**2
        for rows, columns in self.gloss_sizes:
            own = found[first : first + rows * columns * cells].reshape(rows * columns, cells, SEEN)
            cubes.append(stored_cubes(own).reshape(rows, columns, FACES, SIDE + 2, SIDE + 2, SEEN))
            first += len(own) * cells
        return tuple(cubes), basis


def _nearest(trees: _Trees, shape: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Return the open texel of a shape, (n,) of -1 and more, next to each place, (n, 3); -1 for no shape."""
    found = np.full(len(place), -1)
    for index, tree in enumerate(trees):
        chosen = np.flatnonzero(shape == index)
        if len(chosen) and tree is not None:
            found[chosen] = tree[0][tree[1].query(place[chosen])[1]]
    return found


def thinned(points: Points, most: int) -> tuple[Points, "csr_matrix | None"]:
    """Return at most ``most`` of some points, and the matrix that spreads light from these to all of them.

    The corners of a fine mesh may be many more than there have to be.
    """
    from scipy.sparse import csr_matrix
    from scipy.spatial import cKDTree

    count = len(points.point)
    if count <= 2 * most:
        return points, None
    chosen = np.sort(np.random.default_rng(_SEED).permutation(count)[:most])
    scale = np.ptp(points.point, axis=0).max() * _BESIDE
    place = np.concatenate([points.point, scale * points.normal], axis=1)
    away, near = cKDTree(place[chosen]).query(place, k=_NEIGHBOURS)
    weight = 1.0 / np.maximum(away, 1e-6 * scale)
    weight = (weight / weight.sum(axis=1, keepdims=True)).astype(np.float32)
    row = np.repeat(np.arange(count), _NEIGHBOURS)
    spread = csr_matrix((weight.ravel(), (row, near.ravel())), shape=(count, len(chosen)))
    return Points(*(values[chosen] for values in points)), spread


def _on_texels(found: np.ndarray, is_open: np.ndarray, spread, cells: np.ndarray) -> np.ndarray:
    """Return light on all texels of an object from that on traced ones; those inside others are as their neighbours."""
    if spread is not None:
        found, is_open = spread @ found, spread @ is_open > _MOSTLY
    if not is_open.all():
        found = found.copy()
        extend_to_closed(found, is_open, cells)
    return found


def mean_coefficients(placement: Placement, objects: Objects, index: int, points: Points) -> np.ndarray:
    """Return coefficients of an object's diffuse reflectance at its texels, (n, k): the mean of the texture around."""
    from scipy.spatial import cKDTree

    texture = textures(objects)[index]
    weights = coefficients_of(objects, texture)[..., : objects.bases[index]].astype(np.float64)
    texture_mean, count = weights.mean(axis=(0, 1)), len(points.point)
    found = np.tile(texture_mean, (count, 1))
    if not placement.shape.is_endless and weights.shape[0] * weights.shape[1] > 1:
        rows, columns = (-(-side // max(side // _MOST_SIDE, 1)) for side in weights.shape[:2])
        u, v = (np.minimum((np.arange(n) + 0.5) * side / n, side - 1).astype(int)
                for n, side in zip((rows, columns), weights.shape[:2], strict=True))  # fmt: skip
        covered = placement.shape.is_covered(columns, rows)
        place = placement.points(placement.shape.atlas(columns, rows).position[covered])
        nearest, some = cKDTree(points.point).query(place)[1], weights[np.ix_(u, v)][covered]
        number = np.bincount(nearest, minlength=count)[:, None]
        sums = np.stack([np.bincount(nearest, one, minlength=count) for one in some.T], axis=1)
        found = np.where(number > 0, sums / np.maximum(number, 1), texture_mean)
    return found


def shine_of(objects: Objects, index: int) -> np.ndarray:
    """Return the albedo of an object's gloss and mirror at the cosines `_COSINES`, (cosines, 61)."""
    n, k = objects.n[index], objects.k[index]
    found = (
        np.stack([fresnel_array(_COSINES, *pair) for pair in zip(n, k, strict=True)], axis=1) * objects.mirror[index]
    )
    for component, (beta, mu) in enumerate(gloss_of(objects, textures(objects)[index])):
        if beta.any():
            name = objects.lobes.names[objects.lobe[index, component]]
            found += beta.mean() * gloss_albedo(name, (beta * mu).sum() / beta.sum(), _COSINES, n, k)[0]
    return found
