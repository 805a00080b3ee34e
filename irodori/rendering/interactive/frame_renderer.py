"""Interface of the interactive integrator: prepare a scene once, render it frame by frame."""

from dataclasses import dataclass, field

import numpy as np

from irodori.colour.colorimetry import xyz_from_radiance
from irodori.geometry.embree import Tracer
from irodori.jit.chunks import run_chunks
from irodori.light.environment_file import Environment
from irodori.light.gloss_maps import GlossMaps
from irodori.rendering.compiled_calls import resolved
from irodori.rendering.interactive.channels import (
    REPRESENTATIONS,
    Channels,
    coefficient_channels,
    is_grey,
    quadrature_channels,
    rgb_channels,
    spectral_channels,
)
from irodori.rendering.interactive.packets import KEPT, PATHS, RAYS, TILE
from irodori.rendering.interactive.prepared_scene import (
    FrameView,
    PreparedWorld,
    joined,
    make_query,
    make_seen,
    make_world,
    stored_maps,
)
from irodori.rendering.interactive.quadrature import Quadrature, path_spectra, solve_quadrature
from irodori.rendering.interactive.representation_layout import Layout
from irodori.rendering.interactive.round_lobes import TAPS, lobe_table
from irodori.rendering.interactive.smooth_outlines import spread_points
from irodori.rendering.interactive.tile_loop import (
    COUNTED,
    FIGURES,
    RECALLED,
    STORED,
    TRACED,
    FrameBuffers,
    Job,
    PathLimits,
    render_tiles,
)
from irodori.rendering.light_maps import LightMaps
from irodori.rendering.scene_arrays import Light, Objects, View, sides_placed
from irodori.rendering.view_cameras import ORTHOGRAPHIC
from irodori.spectra.grid import SAMPLES

#: Flag for Embree: the rays of a packet are coherent.
_COHERENT = 1 << 16
#: Number of reflections whose hits are kept while only the light moves; later ones are traced again.
_KEPT_REFLECTIONS = 2
_NO_LAMPS = np.zeros((0, SAMPLES))


@dataclass(frozen=True)
class CollimatedLamp:
    """A collimated light in a frame.

    Parameters
    ----------
    direction : (3,) float
        Direction from the scene towards the lamp, of any length.
    strength : float
        Factor on the lamp's spectral irradiance in `prepare_scene`.
    """

    direction: np.ndarray
    strength: float = 1.0


@dataclass
class Prepared:
    """A scene prepared for `render_frame`; made by `prepare_scene`.

    Attributes
    ----------
    representation : str
    quadrature : Quadrature or None
    lamps : int
        Number of collimated lights in its frames.
    world, layout, limits
        Data of the scene in the form of the rendering kernel.
    """

    representation: str
    world: PreparedWorld
    layout: Layout
    limits: PathLimits
    lamps: int
    quadrature: Quadrature | None = None
    owned: tuple = ()
    channels: Channels | None = None
    _seen: tuple | None = None
    _kept: np.ndarray = field(default_factory=lambda: np.zeros((1, 0), np.float32))

    def show(self, maps: LightMaps) -> None:
        """Replace the light maps by others of the same texels, whose spectra are in the span of the same basis."""
        placements, channels = self.owned[2], self.channels
        assert channels is not None  # of a scene that `prepare_scene` made
        baked = joined(stored_maps(maps, placements, channels))
        self.world = self.world._replace(baked=baked, **make_seen(maps, placements, channels))


def light_of(environment: Environment) -> Light:
    """Return an environment as a `Light` of one level, without copying its coefficients."""
    height, width, k = environment.coefficients.shape
    rows, columns = environment.irradiance.shape[:2]
    return Light(
        pixels=environment.coefficients.reshape(height * width, k),
        first_pixel=np.array([0]),
        size=np.array([(width, height)]),
        basis=np.ascontiguousarray(environment.basis.T, dtype=np.float64),
        irradiance=np.ascontiguousarray(environment.irradiance, dtype=np.float32).reshape(rows * columns, k),
        irradiance_size=np.array([columns, rows]),
    )


def prepare_scene(
    objects: Objects,
    light: Light,
    gloss: GlossMaps,
    tracer: Tracer,
    representation: str,
    white: np.ndarray,
    *,
    lamps: np.ndarray = _NO_LAMPS,
    max_bounces: int = 5,
    least_throughput: float = 1e-3,
    quadrature: Quadrature | None = None,
    spare_texels: int = 0,
    maps: LightMaps | None = None,
    smooth_outlines: bool = False,
) -> Prepared:
    """Prepare a scene for `render_frame`.

    Parameters
    ----------
    objects : Objects
        Object i is shape i of the tracer.
    light : Light
        Environment, of which the finest level and the irradiance are used; see `light_of`. Without ``maps``, it needs
        the irradiance under the objects' coats, see `irodori.rendering.scene_arrays.under_coats`.
    gloss : GlossMaps
        Blurred maps of the same environment.
    tracer : Tracer
    representation : str
        ``spectral``, ``coefficients``, ``quadrature`` or ``rgb``, see `irodori.rendering.interactive.channels`.
    white : (61,) float
        Radiance with Y = 100 in the returned XYZ.
    lamps : (n, 61) float
        Spectral irradiance of each collimated light, measured normal to its beam; a perfect diffuser that it lights at
        normal incidence has the radiance E / π.
    max_bounces : int
        Number of mirror reflections to follow.
    least_throughput : float
        Throughput below which a path ends.
    quadrature : Quadrature, optional
        For the representation of that name; solved for the scene by default.
    spare_texels : int
        Additional memory for texels, for a caller that tries other textures.
    maps : LightMaps, optional
        Baked light on the objects, used instead of irradiance. They must be baked for this environment
        without rotation and for the objects' places in the tracer.
    smooth_outlines : bool
        Whether pixels at outlines show the mean over several rays, see `irodori.rendering.interactive.smooth_outlines`.

    Raises
    ------
    ValueError
        For an unknown representation, or ``coefficients`` with coloured gloss or a coloured mirror.
    """
    if representation not in REPRESENTATIONS:
        raise ValueError(f"unknown representation {representation!r}; accepted: {', '.join(REPRESENTATIONS)}")
    lamps = np.asarray(lamps, dtype=np.float64).reshape(-1, SAMPLES)
    matrix = xyz_from_radiance(np.asarray(white, dtype=np.float64))
    if representation == "quadrature" and quadrature is None:
        spectra = path_spectra(objects, light, lamps, max_bounces)
        quadrature = solve_quadrature(spectra, matrix, white)
    if representation == "coefficients":
        channels = coefficient_channels(objects, light, lamps, matrix, maps)
    else:
        channels = _channels(representation, objects, light, lamps, matrix=matrix, white=white, quadrature=quadrature)
    query = make_query(_COHERENT)
    functions = (tracer.intersect16_address, tracer.occluded16_address, query.ctypes.data)
    scene = objects, light, gloss, tracer, channels, functions
    world = make_world(*scene, spare=spare_texels, maps=maps)
    limits = PathLimits(
        max_bounces,
        least_throughput,
        least_throughput / TAPS,
        TRACED,
        1 + min(max_bounces, _KEPT_REFLECTIONS),
        int(smooth_outlines),
    )
    owned = tracer, query, sides_placed(objects, tracer.placements)
    parts = max(len(lobe_table(name).entries) for name in objects.lobes.names)
    layout = Layout(
        channels.surface,
        channels.light,
        channels.coloured,
        components=objects.lobe.shape[1],
        parts=parts,
        sheets=bool((objects.behind >= 0).any()),
        coats=bool(objects.coupled.any()),
    )
    return Prepared(representation, world, layout, limits, len(lamps), quadrature, owned, channels)


def _channels(
    representation: str,
    objects: Objects,
    light: Light,
    lamps: np.ndarray,
    *,
    matrix: np.ndarray,
    white: np.ndarray,
    quadrature: Quadrature | None,
) -> Channels:
    coloured = not is_grey(objects)
    if representation == "spectral":
        return spectral_channels(objects, light, lamps, matrix)
    if representation == "quadrature":
        assert quadrature is not None  # solved for the scene where it was absent
        return quadrature_channels(objects, light, lamps, quadrature, coloured)
    return rgb_channels(objects, light, lamps, matrix, white, coloured)


def _single(values) -> np.ndarray:
    return np.asarray(values, dtype=np.float32).ravel()


def refuse_lens(view: View) -> None:
    """Raise an error for a view with a lens, because its aperture would have to be sampled.

    Raises
    ------
    ValueError
    """
    if view.lens_mm > 0.0:
        raise ValueError(
            f"a lens of {view.lens_mm:g} mm in a view of the integrator 'interactive', which samples nothing; "
            "accepted: a view without a lens, or the integrator 'reference'"
        )


def frame_of(prepared: Prepared, view: View, world_from_light, lamps) -> FrameView:
    """Return view, light rotation and lamps of a frame for the kernel; parameters and errors as in `render_frame`."""
    rotation = np.eye(3) if world_from_light is None else np.asarray(world_from_light, dtype=np.float64)
    if len(lamps) != prepared.lamps:
        raise ValueError(f"{len(lamps)} lamps; accepted: the {prepared.lamps} that the scene was prepared for")
    directions = np.array([lamp.direction for lamp in lamps], dtype=np.float64).reshape(-1, 3)
    length = np.linalg.norm(directions, axis=1, keepdims=True)
    if not (np.isfinite(length) & (length > 0)).all():
        raise ValueError("a lamp without a direction; accepted: three finite numbers, not all zero")
    directions /= length
    return FrameView(
        position_mm=_single(view.position_mm),
        world_from_camera=_single(view.world_from_camera),
        pixel=1.0 / view.focal_px,
        parallel=int(view.kind == ORTHOGRAPHIC),
        width=view.width,
        height=view.height,
        light_from_world=_single(rotation.T),
        lamps=len(lamps),
        lamp_direction=_single(directions),
        lamp_strength=_single([lamp.strength for lamp in lamps]),
        rays=_single([]),
        listed=0,
        parts=spread_points().T.ravel(),
    )


def _visibility(prepared: Prepared, view: View, keep: bool, tiles: int) -> PathLimits:
    """Return the limits with the mode for kept hits (trace, store or recall), and allocate memory for them."""
    if not keep:
        return prepared.limits._replace(visibility=TRACED)
    seen = tuple(value.tobytes() if isinstance(value, np.ndarray) else value for value in view)
    if prepared._seen == seen:
        return prepared.limits._replace(visibility=RECALLED)
    numbers = prepared.limits.kept_bounces * (PATHS // RAYS) * KEPT
    if prepared._kept.shape != (tiles, numbers):
        prepared._kept = np.empty((tiles, numbers), dtype=np.float32)
    prepared._seen = seen
    return prepared.limits._replace(visibility=STORED)


def render_frame(
    prepared: Prepared,
    view: View,
    *,
    world_from_light: np.ndarray | None = None,
    lamps: tuple[CollimatedLamp, ...] = (),
    bands: bool = False,
    keep_visibility: bool = False,
    figures: dict | None = None,
    out: np.ndarray | None = None,
) -> np.ndarray:
    """Render a frame.

    Parameters
    ----------
    prepared : Prepared
    view : View
    world_from_light : (3, 3) float, optional
        Rotation of the environment.
    lamps : tuple of Lamp
        Number of lamps as prepared.
    bands : bool
        Whether to return the 61 bands; only for the representation ``spectral``.
    keep_visibility : bool
        Whether to keep the hits of the rays and use them in later frames of the same view. The picture has the same
        bits.
    figures : dict, optional
        Filled with the number of ``rays``, including those decided by the shapes' bounds and those that find outlines,
        and of their ``hits``, ``glossy`` hits and ``misses``.
    out : array, optional
        Picture to fill.

    Returns
    -------
    (height, width, 3) float32 XYZ, white Y = 100; or (height, width, 61) float32 radiance

    Raises
    ------
    ValueError
        If lamps or bands do not fit the scene, a lamp has no direction, or the view has a lens.
    """
    refuse_lens(view)
    if bands and prepared.representation != "spectral":
        raise ValueError(f"bands of the representation {prepared.representation!r}; accepted: spectral")
    frame = frame_of(prepared, view, world_from_light, lamps)
    image = np.empty((view.height, view.width, SAMPLES if bands else 3), np.float32) if out is None else out
    columns, rows = -(-view.width // TILE), -(-view.height // TILE)
    limits = _visibility(prepared, view, keep_visibility, columns * rows)
    counted = np.zeros((columns * rows, FIGURES), dtype=np.int64)
    job = Job(prepared.world, frame, prepared.layout, limits)
    target = FrameBuffers(image.ravel(), image.shape[2], prepared._kept.ravel(), counted.ravel())
    run_chunks(resolved(render_tiles, job, target, 0, 0), columns * rows, columns, job, target)
    if figures is not None:
        figures |= dict(zip(COUNTED, counted.sum(axis=0).tolist(), strict=True))
    return image
