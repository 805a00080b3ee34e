"""Check of scenes: views that show nothing, and things that are hidden, float or overlap."""

import math
from collections.abc import Iterator
from itertools import combinations

import numpy as np

from irodori.check.findings import Finding
from irodori.config.cross_checks.plausible_units import check_mesh_in_frame
from irodori.config.loaded import Loaded
from irodori.config.models import Body, MeshShape, OrthographicView, PerspectiveView, PlacedObject, Scene, Size, View
from irodori.core.errors import InputError
from irodori.geometry.enclosure import encloses
from irodori.geometry.rig_frame import look_at, rotation_xyz
from irodori.geometry.shapes.placement import Placement
from irodori.geometry.shapes.shape import Shape
from irodori.rendering.energy_gain import body_fault
from irodori.rendering.eyes import eye_inside

_POINTS = 400
#: Depth of overlap, and distance to all other things, from which a warning is given, as shares of a thing's reach (the
#: radius about its origin). Surfaces are sampled by points, which on a mesh are about a tenth of its reach apart.
_DEEP, _FLOATS, _FLOATS_BY_A_MESH = 0.02, 0.05, 0.15
#: Distance of parallel flat things, as a share of the reach, below which rays cannot tell them apart.
_FLUSH = 1e-5


def of_scene(loaded: Loaded, name: str) -> Iterator[Finding]:
    """Yield the errors and warnings of a scene."""
    scene = loaded.scenes[name]
    try:
        things = _placed(loaded, scene)
    except InputError as error:
        yield Finding(True, str(error))
        return
    file = f"{loaded.config.definitions}/scenes/{name}.yaml"
    if not things:
        return  # light alone
    for label, view in scene.views.items():
        if not any(_may_be_seen(thing, view, scene.image) for thing in things.values()):
            where = f"a view from {_point(view.position_mm)} towards {_point(view.target_mm)}"
            found = f"{file}: views.{label}: found {where} that sees none of {', '.join(things)}"
            yield Finding(True, f"{found}; accepted: one that sees something (are all positions in mm?).")
        for thing, placement in things.items():
            if isinstance(view, PerspectiveView) and encloses(placement, np.array(view.position_mm)):
                yield Finding(True, str(InputError(file, *eye_inside(label, thing))))
            eye = np.array([view.position_mm])
            if placement.shape.is_endless and _is_behind(eye, placement) and _may_be_seen(placement, view, scene.image):
                text = f"views.{label}: the eye is behind {thing}, whose back is black and hides all in front of it"
                yield Finding(False, f"{file}: {text}")
    for index, body in enumerate(scene.bodies):
        fault = None if scene.allow_energy_gain else body_fault(index, body)
        if fault is not None:
            yield Finding(True, str(InputError(file, *fault)))
    yield from _of_places(things, file)


def _point(position) -> str:
    return f"[{', '.join(f'{value:g}' for value in position)}]"


def _placed(loaded: Loaded, scene: Scene) -> dict[str, Placement]:
    def stand(shape: Shape, item: PlacedObject | Body) -> Placement:
        return Placement(shape, rotation_xyz(item.rotation_deg), np.array(item.position_mm, float), item.scale)

    found = {}
    for index, item in enumerate(scene.objects):
        definition = loaded.objects[item.object]
        shape, camera = Shape.from_definition(definition.shape), loaded.cameras[definition.camera]
        if isinstance(definition.shape, MeshShape):
            if camera.optics is not None:
                focal_px = 1000.0 * camera.optics.focal_length_mm / camera.optics.pixel_pitch_um
                distance_mm = loaded.rigs[camera.rig].camera_distance_mm
                check_mesh_in_frame(definition.shape, shape.reach_mm, focal_px, distance_mm)
            shape.atlas(definition.texels.width, definition.texels.height, rows=(0, 1))  # refuses charts that overlap
        found[f"objects[{index}] ({item.object})"] = stand(shape, item)
    for index, body in enumerate(scene.bodies):
        found[f"bodies[{index}] ({body.shape.kind})"] = stand(Shape.from_definition(body.shape), body)
    return found


def _may_be_seen(thing: Placement, view: View, image: Size) -> bool:
    """Whether a thing's bounding ball reaches into a view; for an endless plane, whether one of nine rays hits it."""
    axes = look_at(view.position_mm, view.target_mm, view.up)
    x, y, z = (thing.translation_mm - np.array(view.position_mm)) @ axes
    wide = image.width / image.height
    # Half the height of what is seen at unit distance.
    slope = math.tan(math.radians(view.field_of_view_deg) / 2.0) if isinstance(view, PerspectiveView) else 0.0
    if thing.shape.is_endless:
        rays = np.array([[a * slope * wide, b * slope, 1.0] for a in (-1, 0, 1) for b in (-1, 0, 1)]) @ axes.T
        height = float((np.array(view.position_mm) - thing.translation_mm) @ thing.rotation[:, 2])
        return bool((rays @ thing.rotation[:, 2] * height < 0.0).any())
    radius = thing.shape.reach_mm * thing.scale
    if z + radius <= 0.0:
        return False
    if isinstance(view, OrthographicView):
        half = view.height_mm / 2.0
        return abs(x) - radius < half * wide and abs(y) - radius < half
    # Distance from the planes through the eye and the picture's sides.
    sides = ((abs(x), slope * wide), (abs(y), slope))
    return all((across - z * side) / math.hypot(1.0, side) < radius for across, side in sides)


def _of_places(things: dict[str, Placement], file: str) -> Iterator[Finding]:
    gaps: dict[str, list[float]] = {label: [] for label in things}
    floats = dict.fromkeys(things, _FLOATS)
    for (one, a), (other, b) in combinations(things.items(), 2):
        if a.shape.is_endless and b.shape.is_endless:
            continue
        # In both directions: points sample the first, and the second is exact. An endless plane has no points.
        pairs = [(x, y) for x, y in ((a, b), (b, a)) if not x.shape.is_endless]
        if any(_is_flush(x, y) for x, y in pairs):
            text = f"{one} and {other} lie in one plane, where it is chance which of them is seen; raise one a little"
            yield Finding(False, f"{file}: {text}")
        ways = [_between(x, y) for x, y in pairs]
        gap, depth = min(gap for gap, _ in ways), max(depth for _, depth in ways)
        for label in (one, other):
            gaps[label].append(gap)
            if not (a.shape.is_convex and b.shape.is_convex):
                floats[label] = _FLOATS_BY_A_MESH
        smaller = min(t.shape.reach_mm * t.scale for t in (a, b) if not t.shape.is_endless)
        if depth > _DEEP * smaller:
            yield Finding(False, f"{file}: {one} and {other} stand {depth:.3g} mm in each other")
    planes = {label: thing for label, thing in things.items() if thing.shape.is_endless}
    for label, thing in things.items():
        if thing.shape.is_endless:
            continue
        reach = thing.shape.reach_mm * thing.scale
        points = thing.points(thing.shape.samples(_POINTS)[0])
        behind = [plane for plane, placement in planes.items() if _is_behind(points, placement, _FLUSH * reach)]
        if behind:
            yield Finding(False, f"{file}: {label} is wholly behind {behind[0]} and hidden by it; a floor faces +z")
        elif gaps[label] and min(gaps[label]) > floats[label] * reach:
            yield Finding(False, f"{file}: {label} floats {min(gaps[label]):.3g} mm from all else")


def _between(a: Placement, b: Placement) -> tuple[float, float]:
    """Return the gap between two things' surfaces, and the depth of the first inside or through the second, mm."""
    round_mm = a.shape.reach_mm * a.scale if _is_ball(a) else 0.0
    points = a.translation_mm[None] if round_mm else a.points(a.shape.samples(_POINTS)[0])
    local = (points - b.translation_mm) @ b.rotation
    if _is_ball(b):
        gap = float(np.linalg.norm(local, axis=1).min() - b.shape.reach_mm * b.scale - round_mm)
        return max(gap, 0.0), max(-gap, 0.0)
    if b.shape.is_flat:
        return _from_flat(local, b, round_mm)
    near = b.points(b.shape.samples(4 * _POINTS)[0])
    distance = np.linalg.norm(points[:, None] - near[None], axis=2).min()
    return max(float(distance) - round_mm, 0.0), 0.0


def _is_ball(thing: Placement) -> bool:
    return thing.shape.is_convex and thing.shape.is_curved


def _is_behind(points: np.ndarray, plane: Placement, by_mm: float = 0.0) -> bool:
    """Whether points (n, 3) all lie behind an endless plane, which is opaque and black from there."""
    return bool(((points - plane.translation_mm) @ plane.rotation[:, 2] < -by_mm).all())


def _is_flush(a: Placement, b: Placement) -> bool:
    """Whether a flat thing lies in the plane of another one, with some of its points within that."""
    if not (a.shape.is_flat and b.shape.is_flat):
        return False
    local = (a.points(a.shape.samples(_POINTS)[0]) - b.translation_mm) @ b.rotation
    thick = _FLUSH * a.shape.reach_mm * a.scale
    return bool(np.abs(local[:, 2]).max() <= thick and _beside(local, b).min() < -thick)


def _beside(local: np.ndarray, flat: Placement) -> np.ndarray:
    """Return how far points (n, 3) in the local coordinates of a flat thing lie beside it, mm; below 0 within it."""
    if flat.shape.is_endless:
        return np.full(len(local), -np.inf)
    halves = np.array(flat.shape.size_mm) * flat.scale / 2.0
    beside = (np.abs(local[:, :2]) - halves).max(axis=1)
    # A disc ends before the corners of its square; no plate reaches further than its own.
    return np.maximum(beside, np.hypot(local[:, 0], local[:, 1]) - flat.shape.reach_mm * flat.scale)


def _from_flat(local: np.ndarray, flat: Placement, round_mm: float) -> tuple[float, float]:
    """Return gap and depth, mm, of a thing's points (n, 3) in the local coordinates of a plate, a disc or a plane."""
    beside, height = _beside(local, flat), local[:, 2]
    gap = float(np.hypot(np.maximum(beside, 0.0), height).min()) - round_mm
    over = height[beside <= 0.0]
    # What reaches through has points on both sides; the shorter way out is its depth.
    depth = min(float((over + round_mm).max()), float((round_mm - over).max())) if over.size else 0.0
    return max(gap, 0.0), max(depth, 0.0)
