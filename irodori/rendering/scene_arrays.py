"""Scene as flat arrays for compiled loops: objects, textures, light and camera."""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from irodori.geometry.rig_frame import look_at, rotation_xyz
from irodori.geometry.shapes.placement import Placement
from irodori.geometry.shapes.shape import Shape
from irodori.light.environment_file import Environment, directions
from irodori.material.material_file import Material
from irodori.reflection.coat import COUPLED
from irodori.reflection.lobes import Lobes
from irodori.rendering.view_cameras import KINDS, PERSPECTIVE

if TYPE_CHECKING:
    from irodori.config.models import Body, PlacedObject, Scene, Size
    from irodori.config.models import View as SeenFrom
    from irodori.config.parts import Staging

_COARSEST_ROWS = 4
#: Band whose refractive index a coat has at all wavelengths, 550 nm.
COAT_BAND = 30


class Objects(NamedTuple):
    """Materials of the objects; the first axis counts the objects, and bases have the wavelength on the last axis.

    After the objects follow the backs of those that are thin sheets, then the transmittances of sheets as reflectances;
    the texture of a transmittance has the size of its side's. The *sides* are the objects and the backs.
    ``texels`` has one row per texel: the coefficients of α S / S_G, then β and μ of each gloss component. An object
    with fewer components than another has β = 0 in the rest. ``lobe`` is each component's index in ``lobes``.
    ``grey`` is 1 if the refractive index does not vary with the wavelength, so that all bands have the same Fresnel
    reflectance.
    """

    wraps: np.ndarray  # (objects,) 1 if the texture's left and right sides are joined
    first_texel: np.ndarray  # (objects,)
    texture_size: np.ndarray  # (objects, 2) width, height
    texels: np.ndarray  # (texels, k + 2 c) float32
    basis: np.ndarray  # (objects, k, 61)
    bases: np.ndarray  # (objects,)
    mirror: np.ndarray  # (objects,)
    n: np.ndarray  # (objects, 61)
    k: np.ndarray  # (objects, 61)
    grey: np.ndarray  # (objects,)
    coupled: np.ndarray  # (objects,) 1 if the coat reduces the diffuse term, see `irodori.reflection.coat`
    lobe: np.ndarray  # (objects, c)
    lobes: Lobes  # a compile-time constant, see `irodori.reflection.lobes`
    shape: np.ndarray  # (sides,) placed shape of each side
    behind: np.ndarray  # (sides,) other side of a sheet, -1 if the shape is black from behind
    through: np.ndarray  # (sides,) transmittance from the other side, -1 if there is none


def coefficients_of(objects: Objects, texels: np.ndarray) -> np.ndarray:
    """Return the part of texel rows that holds the coefficients of α S / S_G, (..., k)."""
    return texels[..., : objects.texels.shape[1] - 2 * objects.lobe.shape[1]]


def gloss_of(objects: Objects, texels: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return β and μ of each gloss component in texel rows, (...) each; β is 0 where μ is 0."""
    pairs = texels[..., objects.texels.shape[1] - 2 * objects.lobe.shape[1] :]
    betas, mus = np.moveaxis(pairs[..., ::2], -1, 0), np.moveaxis(pairs[..., 1::2], -1, 0)
    return [(np.where(mu > 0, beta, 0.0), mu) for beta, mu in zip(betas, mus, strict=True)]


def sides_placed(objects: Objects, placements: Sequence[Placement]) -> list[Placement]:
    """Return the placement of each side, see `Objects`; backs are placed as their fronts."""
    return [placements[index] for index in objects.shape]


def placed_of_rows(objects: Objects) -> list[int]:
    """Return the number of the placed shape of each material of `Objects`, of objects, backs and transmittances."""
    sent = dict(zip(objects.through.tolist(), objects.shape.tolist(), strict=True))
    return objects.shape.tolist() + [sent[row] for row in range(len(objects.shape), len(objects.bases))]


def row_names(names: list[str], objects: Objects) -> list[str]:
    """Return a name for each material of `Objects`, from those of the placed shapes."""
    of_side = [""] * len(names) + [", back"] * (len(objects.shape) - len(names))
    return [
        names[index] + (of_side[row] if row < len(of_side) else ", transmittance")
        for row, index in enumerate(placed_of_rows(objects))
    ]


def textures(objects: Objects) -> list[np.ndarray]:
    """Return views of the texels of each object, (height, width, k + 2 c)."""
    found = []
    for first, (columns, rows) in zip(objects.first_texel, objects.texture_size, strict=True):
        found.append(objects.texels[first : first + rows * columns].reshape(rows, columns, -1))
    return found


class Coats(NamedTuple):
    """Coupled coats of a scene's sides, each index once."""

    of_side: np.ndarray  # (sides,) int64, 0 for a side without a coat, else 1 and the number of its coat
    n_k: np.ndarray  # (coats, 2) refractive index


def coats_of(objects: Objects) -> Coats:
    """Return the coupled coats of a scene's sides.

    Raises
    ------
    ValueError
        If light passes through a side that has one: it counts by its angle on that side, but not beneath it.
    """
    sides, of_side = len(objects.shape), np.zeros(len(objects.shape), dtype=np.int64)
    coated = np.flatnonzero(objects.coupled[:sides])
    if (objects.through[coated] >= 0).any():
        raise ValueError("a coupled coat on a thin sheet that lets light through; accepted: the coat sum")
    index = np.stack([objects.n[coated, COAT_BAND], objects.k[coated, COAT_BAND]], axis=1).astype(np.float64)
    found, number = np.unique(index, axis=0, return_inverse=True)
    of_side[coated] = 1 + number.ravel()
    return Coats(of_side, found)


class Light(NamedTuple):
    """Environment as a series of pictures of decreasing resolution, finest first, with its irradiance map."""

    pixels: np.ndarray  # (all pixels, k) float32
    first_pixel: np.ndarray  # (levels,)
    size: np.ndarray  # (levels, 2) width, height
    basis: np.ndarray  # (k, 61)
    irradiance: np.ndarray  # (h * w, k) float32
    irradiance_size: np.ndarray  # (2,) width, height
    under_coats: tuple[np.ndarray, ...] = ()  # (h * w, k) float32 irradiance under each of a scene's `Coats`


def under_coats(light: Light, environment: Environment, objects: Objects) -> Light:
    """Return a light with the irradiance under the coats of a scene's objects, from the environment it was made of."""
    maps = (environment.irradiance_under(n, k) for n, k in coats_of(objects).n_k.tolist())
    return light._replace(under_coats=tuple(one.reshape(-1, one.shape[2]) for one in maps))


class View(NamedTuple):
    """A camera of the scene; x to the right of the picture, y down, z along the line of sight."""

    position_mm: np.ndarray  # (3,) eye, centre of the lens, or centre of the plane where parallel rays start
    world_from_camera: np.ndarray  # (3, 3)
    focal_px: float  # focal length of a perspective view; pixels per mm of an orthographic one
    width: int
    height: int
    kind: int = PERSPECTIVE
    lens_mm: float = 0.0  # diameter of the lens, 0 for a pinhole
    focus_mm: float = 1.0  # along the line of sight to the plane in focus; not read without a lens

    def finer(self, side: int) -> "View":
        """Return the view with ``side`` times the resolution: each pixel is divided along both sides."""
        return self._replace(focal_px=side * self.focal_px, width=side * self.width, height=side * self.height)


def make_placements(scene: "Scene | Staging", shapes: list[Shape]) -> list[Placement]:
    """Return the placements of the scene's objects, followed by those of its bodies."""
    items: tuple[PlacedObject | Body, ...] = (*scene.objects, *scene.bodies)
    return [
        Placement(shape, rotation_xyz(item.rotation_deg), np.asarray(item.position_mm, float), item.scale)
        for item, shape in zip(items, shapes, strict=True)
    ]


def make_objects(placements: list[Placement], materials: list[Material]) -> tuple[Objects, list[float]]:
    """Convert the materials of objects to flat arrays for the integrators.

    A texel off the surface gets the values of the nearest texel on it, so that interpolation at the edge of a mesh's
    chart uses only values of the surface.

    Returns
    -------
    objects : Objects
    filled : list of float
        Share of the texels on each object's surface that had no data of their own.
    """
    shape, behind, through, materials = _sides(placements, materials)
    placements = [placements[index] for index in shape]
    bases = max(m.basis.shape[1] for m in materials)
    lobes = Lobes.of([name for m in materials for name in m.lobes])
    components = max(len(m.lobes) for m in materials)
    lobe = np.zeros((len(materials), components), dtype=np.int64)
    for row, material in zip(lobe, materials, strict=True):
        row[: len(material.lobes)] = [lobes.names.index(name) for name in material.lobes]
    first = np.concatenate([[0], np.cumsum([m.alpha.size for m in materials])])
    # Written in place: a texture of ten megapixels takes half a gigabyte.
    texels = np.zeros((first[-1], bases + 2 * components), dtype=np.float32)
    basis, filled = [], []
    for placement, material, start in zip(placements, materials, first[:-1], strict=True):
        own = texels[start : start + material.alpha.size]
        rows, share = _fill_texels(placement, material, own[:, :bases], own[:, bases:])
        basis.append(np.pad(rows, ((0, bases - len(rows)), (0, 0))))
        filled.append(share)
    n, k = np.stack([m.n for m in materials]), np.stack([m.k for m in materials])
    objects = Objects(
        wraps=np.array([p.shape.wraps for p in placements], dtype=np.int64),
        first_texel=first[:-1],
        texture_size=np.array([m.alpha.shape[::-1] for m in materials]),
        texels=texels,
        basis=np.ascontiguousarray(np.stack(basis)),  # stacked in another order, it would compile kernels of its own
        bases=np.array([m.basis.shape[1] for m in materials]),
        mirror=np.array([m.mirror for m in materials], dtype=np.float64),
        n=n,
        k=k,
        grey=((np.ptp(n, axis=1) == 0) & (np.ptp(k, axis=1) == 0)).astype(np.int64),
        coupled=np.array([m.coat == COUPLED for m in materials], dtype=np.int64),
        lobe=lobe,
        lobes=lobes,
        shape=np.array(shape[: len(behind)]),
        behind=np.array(behind),
        through=np.array(through),
    )
    return objects, filled


def _sides(placements: list[Placement], materials: list[Material]) -> tuple[list, list, list, list[Material]]:
    """Return placed shape, other side and transmittance of each side, see `Objects`, and all materials.

    The shapes of transmittances follow those of the sides.

    Raises
    ------
    ValueError
        For a sheet of a shape that is no plate, disc or mesh.
    """
    count, sheets = len(placements), [index for index, one in enumerate(materials) if one.is_sheet]
    shape, found = [*range(count), *sheets], list(materials)
    behind, through = [-1] * len(shape), [-1] * len(shape)
    for number, index in enumerate(sheets):
        front, kind = materials[index], placements[index].shape
        if kind.is_endless or not (kind.is_flat or kind.triangles is not None):
            raise ValueError(f"a thin sheet of the shape {kind.name}; accepted: a plate, a disc or a mesh")
        behind[index], behind[count + number] = count + number, index
        found.insert(count + number, back_of(front, kind))
    for side, other in enumerate(behind):
        sent = materials[shape[side]].through
        if other < 0 or sent is None:
            continue
        if through[other] >= 0 and found[side].alpha.shape == found[other].alpha.shape:
            through[side] = through[other]
            continue
        through[side] = len(found)
        shape.append(shape[side])
        found.append(sent.resized(found[side].alpha.shape))
    return shape, behind, through, found


def back_of(sheet: Material, shape: Shape) -> Material:
    """Return the material of a sheet's back over the texture coordinates of its front."""
    return sheet if sheet.back is None else _turned_over(sheet.back, shape)


def as_back(sheet: Material, shape: Shape) -> Material:
    """Return the material of a sheet's back, which must be its own, as seen face up, with the sheet's transmittance."""
    assert sheet.back is not None
    sent = None if sheet.through is None else sheet.through.resized(sheet.back.alpha.shape)
    return replace(sheet.back, through=None if sent is None else _turned_over(sent, shape))


def _turned_over(material: Material, shape: Shape) -> Material:
    """Return a material turned over about the y axis; on a mesh, both sides have the same texture coordinates."""
    return material.mirrored() if shape.is_flat else material


def _fill_texels(
    placement: Placement, material: Material, coefficients: np.ndarray, gloss: np.ndarray
) -> tuple[np.ndarray, float]:
    """Fill an object's coefficients, (n, bases), and gloss parameters, (n, 2 components).

    Returns
    -------
    basis : (k, 61)
    share : float
        Share of the texels that had no data.
    """
    # Without a filled copy of the material, which would take as much memory as all texels here.
    gap, origin, share = material.gaps(placement.shape.is_covered(*material.alpha.shape[::-1]))
    count = material.basis.shape[1]
    scale = material.spectrum_scale.reshape(-1, 1)
    np.multiply(material.coefficients.reshape(-1, count), scale, out=coefficients[:, :count], casting="same_kind")
    for number, (_, beta, mu) in enumerate(material.typically_filled()):
        gloss[:, 2 * number], gloss[:, 2 * number + 1] = beta.ravel(), mu.ravel()
    for filled in (coefficients, gloss):
        filled[gap] = filled[origin]
    return material.basis.T, share


def make_light(environment: Environment) -> Light:
    """Return the levels of an environment, each half the size of the one before, averaged by solid angle."""
    pixels, sizes = [], []
    height, width = environment.coefficients.shape[:2]
    solid_angle = directions(width, height)[1][..., None]
    weighted = environment.coefficients * solid_angle
    while True:
        row_edges, column_edges = (
            np.arange(n) * full // n for n, full in ((height, weighted.shape[0]), (width, weighted.shape[1]))
        )

        def sums(values, rows=row_edges, columns=column_edges):
            return np.add.reduceat(np.add.reduceat(values, rows, axis=0), columns, axis=1)

        pixels.append((sums(weighted) / sums(solid_angle)).astype(np.float32).reshape(width * height, -1))
        sizes.append((width, height))
        if height // 2 < _COARSEST_ROWS:
            break
        width, height = width // 2, height // 2
    first = np.concatenate([[0], np.cumsum([len(p) for p in pixels])[:-1]])
    irradiance = np.ascontiguousarray(environment.irradiance, dtype=np.float32)
    return Light(
        pixels=np.concatenate(pixels),
        first_pixel=first,
        size=np.array(sizes),
        basis=np.ascontiguousarray(environment.basis.T, dtype=np.float64),
        irradiance=irradiance.reshape(-1, irradiance.shape[2]),
        irradiance_size=np.array(irradiance.shape[1::-1]),
    )


def make_view(view: "SeenFrom", image: "Size") -> View:
    """Return the camera of a scene's view.

    Parameters
    ----------
    view : PerspectiveView or OrthographicView
    image : Size
        Size of the picture, px.
    """
    diameter_mm, focus_mm = 0.0, 1.0
    if view.kind == "orthographic":
        focal = image.height / view.height_mm
    else:
        focal = 0.5 * image.height / np.tan(np.radians(view.field_of_view_deg) / 2)
        if view.lens is not None:
            diameter_mm, focus_mm = view.lens.diameter_mm, view.lens.focus_mm
    return View(
        np.asarray(view.position_mm, dtype=np.float64),
        np.ascontiguousarray(look_at(view.position_mm, view.target_mm, view.up)),
        float(focal),
        image.width,
        image.height,
        KINDS[view.kind],
        diameter_mm,
        focus_mm,
    )
