"""Benchmark of the integrator `reference` and Mitsuba 3: time to the same colour error, and growth of the time.

``python -m benchmarks.reference [--size small] [--pixels 96x72] [--runs 5] [--output speed_error.csv]``. There are
three scenes that both renderers can represent equally, in 61 bands: ``spheres``, three spheres on a plate (test colours
of CIE 224, gold as a mirror) under uniform D65 and a tungsten panel; ``box``, five walls with only that panel; and
``image``, a ball, a ring of triangles and a golden ball on a plate, lit by the picture of a classroom. Mitsuba traces
four random wavelengths per path; our integrator carries 61 bands.

The error of each renderer is measured against a converged picture of its own (``--converged`` paths per pixel, another
seed), as the mean CIEDE2000 over the pixels with the same white for both, so that differences between the renderers do
not count. ``reference-spectral`` is our integrator as it is by default, with the light cache and the noise filter; the
filling of the cache and the filter are part of its time. ``reference-unbiased`` has neither. Both are compared with the
same converged picture without cache and filter, so that the bias of both counts. The
errors at several sample counts, with two seeds each, give a line on logarithmic scales. From it, the sample count for
the error ``--target`` is read, and the seconds are those of that count, on straight lines between the measured counts.
``converged pictures`` is the mean CIEDE2000 between the converged pictures of both renderers, which shows that the
scenes are the same.

Mitsuba's kernels are compiled before the measurement. Seconds are processor time of all threads divided by their
number, the least of the runs; other work on the machine disturbs them less than wall-clock time, and the renderers
take turns, so that it disturbs all of them alike. Mitsuba's default sampler is ``independent``; ``multijitter``, the
default here, is its best.

Mitsuba's variant ``llvm_ad_spectral`` needs a recent LLVM: it runs with Debian's package ``libllvm19`` and
``DRJIT_LIBLLVM_PATH=/usr/lib/x86_64-linux-gnu/libLLVM.so.19.1``, while LLVM 15 ends the process at the first picture.
Each variant is first tried in a separate process; for one that cannot run, the row states the reason.
"""

import argparse
import os
import tempfile
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import trimesh

from benchmarks.table import (
    COLUMNS,
    arguments_of,
    least_processor_s,
    own_peak_mb,
    report,
    row_without_figures,
    why_it_fails,
)
from irodori.colour.colorimetry import colour_matching_weights, delta_e_xyz, xyz_from_radiance
from irodori.config.definition import typed
from irodori.config.definitions import load_definitions, read_yaml
from irodori.config.models import BodyShape, ObjectShape, SceneLight, Size
from irodori.config.models import View as SeenFrom
from irodori.core.threads import use_threads
from irodori.geometry.mesh import Mesh
from irodori.geometry.rig_frame import rotation_x, rotation_xyz, rotation_y
from irodori.geometry.shapes.placement import Placement
from irodori.geometry.shapes.shape import Shape
from irodori.geometry.shapes.triangle_mesh import TriangleMesh
from irodori.light.environment_file import Environment, directions
from irodori.light.placed_lights import unit_luminance
from irodori.material.material_file import Material
from irodori.rendering.reference.converging_picture import make_scene, render
from irodori.rendering.reference.denoising import denoise
from irodori.rendering.reference.filling_cache import with_cache
from irodori.rendering.scene_arrays import View, make_objects, make_view
from irodori.simulation.virtual_rig.classroom import room_coefficients
from irodori.spectra.published import spectrum

_ROOT = Path(__file__).resolve().parents[1]

# Gold (Johnson and Christy 1972) at 400, 450 ... 700 nm.
GOLD_NM = np.array([400, 450, 500, 550, 600, 650, 700])
GOLD_N = np.array([1.468, 1.384, 0.974, 0.409, 0.245, 0.166, 0.161])
GOLD_K = np.array([1.952, 1.914, 1.866, 2.357, 3.085, 3.150, 3.960])
WAVELENGTH_NM = np.linspace(400, 700, 61)
PANEL = {"kind": "rectangle", "spectrum": "A", "radiance": 12.0, "rotation_deg": [180.0, 0.0, 25.0], "width_mm": 60.0,
         "height_mm": 40.0}  # fmt: skip
# Those of Mitsuba are such as its multijittered sampler takes.
OUR_SAMPLES, THEIR_SAMPLES = (16, 64, 256), (35, 132, 528)
#: Those of our integrator with cache and filter; close together, because its error falls less evenly.
DEFAULT_SAMPLES = (2, 4, 8, 16, 32)
#: Size of the picture that lights the scene ``image``.
SKY_PX = (512, 256)
#: What is measured where the command line does not say it.
SIZES = {
    "small": {"pixels": "48x36", "converged": 1024, "scenes": ["spheres"], "no_growth": True},
    "full": {"pixels": "96x72", "converged": 8192, "scenes": ["spheres", "box", "image"], "no_growth": False},
}


class Body(NamedTuple):
    """A placed shape with a uniform reflectance, or a mirror with refractive index n, k."""

    kind: str
    size_mm: float  # side of a plate, radius of a sphere, outer radius of a ring
    place_mm: tuple
    turn: np.ndarray
    reflectance: np.ndarray | None  # (61,)


class Stage(NamedTuple):
    """A scene for both renderers."""

    bodies: list
    sky: np.ndarray | None  # (61,) radiance
    panel_mm: tuple | None
    eye_mm: tuple
    target_mm: tuple
    field_deg: float
    picture: np.ndarray | None = None  # (height, width) by which the radiance is multiplied


def stages() -> dict[str, Stage]:
    """Return the scenes by name."""
    up = np.eye(3)
    spheres = [Body("plate", 240.0, (0, 0, 0), up, spectrum("TCS10")),
               Body("sphere", 30.0, (-52, 8, 30), up, spectrum("TCS3")),
               Body("sphere", 30.0, (14, 42, 30), up, spectrum("TCS40")),
               Body("sphere", 30.0, (46, -34, 30), up, None)]  # fmt: skip
    walls = [((0, 0, 0), up, "TCS10"), ((0, 0, 100), rotation_x(np.pi), "TCS10"),
             ((0, 50, 50), rotation_x(np.pi / 2), "TCS10"),
             ((-50, 0, 50), rotation_y(np.pi / 2), "TCS3"), ((50, 0, 50), rotation_y(-np.pi / 2), "TCS40")]  # fmt: skip
    box = [Body("plate", 100.0, place, turn, spectrum(name)) for place, turn, name in walls]
    box.append(Body("sphere", 18.0, (15, 5, 18), up, spectrum("TCS70")))
    image = [Body("plate", 240.0, (0, 0, 0), up, spectrum("TCS10")),
             Body("sphere", 30.0, (-52, 8, 30), up, spectrum("TCS3")),
             Body("ring", 34.0, (14, 42, 12), up, spectrum("TCS40")),
             Body("sphere", 30.0, (46, -34, 30), up, None)]  # fmt: skip
    sky = 0.3 * unit_luminance("D65")
    return {
        "spheres": Stage(spheres, sky, (-60.0, -40.0, 180.0), (0, -330, 190), (0, 0, 22), 34.0),
        "box": Stage(box, None, (0.0, 0.0, 98.0), (0, -220, 50), (0, 0, 50), 32.0),
        "image": Stage(image, unit_luminance("D65"), None, (0, -330, 190), (0, 0, 22), 34.0, room_picture()),
    }


@cache
def room_picture() -> np.ndarray:
    """Return the classroom of `config` as a picture of grey light, (height, width), with the mean 1 over the sphere."""
    room = load_definitions(read_yaml(_ROOT / "config/config.yaml"), _ROOT).environments["classroom"].virtual
    sources = room_coefficients(room, *SKY_PX).sum(axis=-1).astype(np.float64)
    solid_angle = np.broadcast_to(directions(*SKY_PX)[1], sources.shape)
    return (sources / np.average(sources, weights=solid_angle)).astype(np.float32)


def ring(radius_mm: float) -> trimesh.Trimesh:
    """Return a ring of triangles that lies on the plane z = -0.35 of its radius."""
    return trimesh.creation.torus(0.65 * radius_mm, 0.35 * radius_mm, major_sections=48, minor_sections=24)


def gold() -> tuple[np.ndarray, np.ndarray]:
    """Return the refractive index n, k of gold on the wavelength grid, (61,) each."""
    return np.interp(WAVELENGTH_NM, GOLD_NM, GOLD_N), np.interp(WAVELENGTH_NM, GOLD_NM, GOLD_K)


def uniform(reflectance: np.ndarray | None) -> Material:
    """Return a material with a uniform reflectance, or a golden mirror."""
    if reflectance is not None:
        return Material.uniform(reflectance)
    n, k = gold()
    return Material.uniform(0.0, mirror=1.0, n=n, k=k)


def light_of(stage: Stage) -> Environment:
    """Return the light of a stage from all directions: uniform, a picture, or none."""
    basis = (np.zeros(61) if stage.sky is None else stage.sky)[:, None]
    picture = np.ones((8, 16), np.float32) if stage.picture is None else stage.picture
    return Environment(picture[..., None], basis, np.full((8, 16, 1), np.pi, np.float32))


def shape_of(body: Body) -> Shape:
    """Return the shape of a body."""
    if body.kind == "ring":
        return flat_mesh(ring(body.size_mm))
    size = (
        {"width_mm": body.size_mm, "height_mm": body.size_mm} if body.kind == "plate" else {"radius_mm": body.size_mm}
    )
    return Shape.from_definition(typed(ObjectShape | BodyShape, {"kind": body.kind, **size}))


class Ours:
    """Renderer for one scene with the integrator `reference`, without cache and filter."""

    name, samples = "reference-unbiased", OUR_SAMPLES

    def __init__(self, stage: Stage, size: tuple[int, int], white: np.ndarray) -> None:
        placements = [Placement(shape_of(b), b.turn, np.array(b.place_mm, float)) for b in stage.bodies]
        objects, _ = make_objects(placements, [uniform(b.reflectance) for b in stage.bodies])
        lights = [PANEL | {"position_mm": list(stage.panel_mm)}] if stage.panel_mm is not None else []
        self.scene = make_scene(placements, objects, light_of(stage), [typed(SceneLight, one) for one in lights])
        self.view = view_of(stage, size)
        self.matrix = xyz_from_radiance(white)

    def xyz(self, samples: int, seed: int) -> np.ndarray:
        """Return a picture, (height, width, 3), white Y = 100."""
        return render(self.scene, self.view, samples, seed, error_by_band=False).radiance @ self.matrix.T


class OursByDefault(Ours):
    """The integrator `reference` with its light cache and noise filter, as used by default."""

    name, samples = "reference-spectral", DEFAULT_SAMPLES

    def xyz(self, samples: int, seed: int) -> np.ndarray:
        """Return a picture, (height, width, 3), white Y = 100."""
        scene = with_cache(self.scene, samples * self.view.width * self.view.height)
        halves = render(scene, self.view, samples, seed, error_by_band=False, halves=True).halves
        assert halves is not None
        return denoise(halves).radiance @ self.matrix.T


def view_of(stage: Stage, size: tuple[int, int]) -> View:
    """Return the camera of a stage."""
    eye = {"position_mm": stage.eye_mm, "target_mm": stage.target_mm, "up": (0, 0, 1)}
    seen = typed(SeenFrom, eye | {"field_of_view_deg": stage.field_deg})
    return make_view(seen, Size(width=size[0], height=size[1]))


def name_of(variant: str) -> str:
    """Return the name of a variant of Mitsuba in the table."""
    return f"mitsuba-{variant.split('_')[0]}"


class Theirs:
    """Renderer for one scene with a variant of Mitsuba 3."""

    samples = THEIR_SAMPLES

    def __init__(self, variant: str, sampler: str, stage: Stage, size: tuple[int, int], white: np.ndarray) -> None:
        import mitsuba

        mitsuba.set_variant(variant)
        self.mitsuba, self.variant, self.name = mitsuba, variant, name_of(variant)
        eye = mitsuba.ScalarTransform4f().look_at(list(stage.eye_mm), list(stage.target_mm), [0, 0, 1])
        film = {"type": "hdrfilm", "width": size[0], "height": size[1], "pixel_format": "xyz",
                "rfilter": {"type": "box"}, "component_format": "float32"}  # fmt: skip
        camera = {"type": "perspective", "fov": stage.field_deg, "fov_axis": "y", "to_world": eye, "film": film}
        parts = {f"body{i}": self._body(body) for i, body in enumerate(stage.bodies)}
        weights = colour_matching_weights()[1]
        self.scale = 100.0 * weights.sum() / (weights @ white)
        if stage.picture is not None:
            parts["sky"] = self._picture(stage.picture, float(weights @ stage.sky / weights.sum()))
        elif stage.sky is not None:
            parts["sky"] = {"type": "constant", "radiance": self._spectrum(stage.sky)}
        if stage.panel_mm is not None:
            parts["panel"] = self._panel(stage.panel_mm)
        camera["sampler"] = {"type": sampler}
        integrator = {"type": "path", "max_depth": -1}
        self.scene = mitsuba.load_dict({"type": "scene", "integrator": integrator, "camera": camera, **parts})

    def _panel(self, place_mm: tuple) -> dict:
        turn, half = rotation_xyz(PANEL["rotation_deg"]), (PANEL["width_mm"] / 2, PANEL["height_mm"] / 2)
        return {
            "type": "rectangle", "to_world": self._transform(place_mm, turn, half),
            "bsdf": {"type": "diffuse", "reflectance": {"type": "uniform", "value": 0.0}},
            "emitter": {"type": "area", "radiance": self._spectrum(PANEL["radiance"] * unit_luminance("A"))},
        }  # fmt: skip

    def _picture(self, picture: np.ndarray, luminance: float) -> dict:
        """Return an environment of D65, which has luminance 1 in Mitsuba; there azimuths turn the other way about y."""
        colours = np.repeat(picture[:, ::-1, None], 3, axis=2)
        turn = np.array([[0.0, 0.0, -1.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
        bitmap = self.mitsuba.Bitmap(np.ascontiguousarray(colours, dtype=np.float32))
        return {"type": "envmap", "bitmap": bitmap, "scale": luminance,
                "to_world": self.mitsuba.ScalarTransform4f(turn)}  # fmt: skip

    def _spectrum(self, values: np.ndarray) -> dict:
        # Held at its ends outside the grid, as ours are when they become colours.
        held = np.interp(np.arange(360, 831, 5), WAVELENGTH_NM, values)
        text = ",".join(f"{v:.9g}" for v in held)
        return {"type": "regular", "wavelength_min": 360.0, "wavelength_max": 830.0, "values": text}

    def _transform(self, place, turn: np.ndarray, half):
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = turn * np.array([*half, 1.0]), place
        return self.mitsuba.ScalarTransform4f(matrix)

    def _body(self, body: Body) -> dict:
        if body.reflectance is None:
            n, k = gold()
            bsdf = {"type": "conductor", "eta": self._spectrum(n), "k": self._spectrum(k)}
        else:
            bsdf = {"type": "diffuse", "reflectance": self._spectrum(body.reflectance)}
        if body.kind == "sphere":
            return {"type": "sphere", "center": list(body.place_mm), "radius": body.size_mm, "bsdf": bsdf}
        if body.kind == "ring":
            return self._ring(body, bsdf)
        half = (body.size_mm / 2, body.size_mm / 2)
        return {"type": "rectangle", "to_world": self._transform(body.place_mm, body.turn, half), "bsdf": bsdf}

    def _ring(self, body: Body, bsdf: dict):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "ring.ply"
            ring(body.size_mm).export(path)
            turn = self._transform(body.place_mm, body.turn, (1.0, 1.0))
            plain = {"type": "ply", "filename": str(path), "face_normals": True, "to_world": turn, "bsdf": bsdf}
            return self.mitsuba.load_dict(plain)

    def xyz(self, samples: int, seed: int) -> np.ndarray:
        """Return a picture, (height, width, 3), white Y = 100; Mitsuba's own scale is ∫ L x̄ dλ / ∫ ȳ dλ."""
        self.mitsuba.set_variant(self.variant)
        return self.scale * np.array(self.mitsuba.render(self.scene, spp=samples, seed=seed), dtype=np.float64)


def mean_error(picture: np.ndarray, truth: np.ndarray, white_xyz: np.ndarray) -> float:
    """Return the mean CIEDE2000 between two pictures in XYZ for a white."""
    return float(delta_e_xyz(truth, picture, white_xyz).mean())


class Line(NamedTuple):
    """Error and time of one renderer as functions of the number of samples."""

    samples: np.ndarray
    errors: np.ndarray
    process_s: np.ndarray

    def seconds_for(self, error: float) -> float:
        """Return the processor time at which the error is reached, on straight lines through the measured times."""
        count, last = self.samples_for(error), len(self.samples) - 1
        after = int(np.clip(np.searchsorted(self.samples, count), 1, last))
        (start, end), (few, many) = self.samples[after - 1 : after + 1], self.process_s[after - 1 : after + 1]
        return float(few + (count - start) * (many - few) / (end - start))

    @property
    def path_s(self) -> float:
        """Processor time of a further sample."""
        return float((self.process_s[-1] - self.process_s[0]) / (self.samples[-1] - self.samples[0]))

    def samples_for(self, error: float) -> float:
        """Return the number of samples at which the error is reached, by a straight line on logarithmic scales."""
        slope, level = np.polyfit(np.log(self.samples), np.log(self.errors), 1)
        return float(np.exp((np.log(error) - level) / slope))


def try_variant(variant: str, sampler: str) -> None:
    """Render 4 x 4 pixels to test a variant; one that compiles its kernels fails only when it renders."""
    picture = Theirs(variant, sampler, stages()["spheres"], (4, 4), unit_luminance("D65")).xyz(THEIR_SAMPLES[0], 1)
    if not np.isfinite(picture).all():
        raise SystemExit(f"{variant}: a picture that is not finite")


def errors_of(renderer, truth: np.ndarray, white_xyz: np.ndarray) -> np.ndarray:
    """Return the error of a renderer at each of its numbers of samples; its loops are compiled then."""
    pictures = [[renderer.xyz(n, seed) for seed in (11, 12)] for n in renderer.samples]
    return np.array([np.mean([mean_error(one, truth, white_xyz) for one in pair]) for pair in pictures])


def times_s(renderers: list, runs: int) -> list[np.ndarray]:
    """Return the processor time of each renderer at each of its numbers of samples, s, the least of the runs.

    Runs alternate between the renderers, so that other load on the machine affects all.
    """
    least = [np.full(len(renderer.samples), np.inf) for renderer in renderers]
    for _ in range(runs):
        for renderer, found in zip(renderers, least, strict=True):
            for at, n in enumerate(renderer.samples):
                found[at] = min(found[at], least_processor_s(lambda r=renderer, n=n: r.xyz(n, 21), 1))
    return least


def compare(name: str, stage: Stage, arguments) -> list[dict]:
    """Compare the renderers on a scene and return its rows of the table."""
    white = unit_luminance("D65")
    white_xyz = xyz_from_radiance(white) @ white
    size = tuple(map(int, arguments.pixels.split("x")))
    pixels = size[0] * size[1]
    renderers = [OursByDefault(stage, size, white), Ours(stage, size, white)]
    renderers += [Theirs(variant, arguments.sampler, stage, size, white) for variant in arguments.variants]
    truths: dict[str, np.ndarray] = {}
    errors = []
    truths["reference"] = renderers[1].xyz(arguments.converged, 99)
    for renderer in renderers:
        kind = renderer.name.split("-")[0]
        if kind not in truths:  # the variants of Mitsuba share their limit
            truths[kind] = renderer.xyz(arguments.converged, 99)
        errors.append(errors_of(renderer, truths[kind], white_xyz))
    lines = []
    for renderer, error, seconds in zip(renderers, errors, times_s(renderers, arguments.runs), strict=True):
        lines.append(Line(np.array(renderer.samples), error, seconds))
        text = ", ".join(f"{n}: {e:.3f}" for n, e in zip(renderer.samples, error, strict=True))
        speed = 1e-6 * pixels / lines[-1].path_s
        print(f"{name} {renderer.name}: CIEDE2000 at samples {text}; {speed:.2f} million paths/s a core", flush=True)
    if len(truths) == 2:
        between = mean_error(*truths.values(), white_xyz)
        print(f"{name} converged pictures: mean CIEDE2000 {between:.3f}")
    rows = []
    for renderer, line in zip(renderers, lines, strict=True):
        samples = line.samples_for(arguments.target)
        seconds = line.seconds_for(arguments.target) / arguments.threads
        first = lines[0].seconds_for(arguments.target) / arguments.threads
        values = ("render", f"{renderer.name} {name}", f"{pixels * samples:.0f}", "paths", f"{seconds:.4f}",
                  f"{pixels * samples / seconds:.0f}", "mean CIEDE2000", f"{arguments.target:.2f}",
                  f"{own_peak_mb():.0f}", f"reference-spectral {name}", f"{seconds / first:.2f}")  # fmt: skip
        rows.append(dict(zip(COLUMNS, values, strict=True)))
        print(f"{name} {renderer.name}: {samples:.0f} samples for {arguments.target}, load {os.getloadavg()[0]:.1f}")
    return rows


def ball_of(triangles: int) -> TriangleMesh:
    """Return a mesh of a sphere with about ``triangles`` triangles."""
    rows = max(3, round((triangles / 4) ** 0.5))
    sphere = trimesh.creation.uv_sphere(radius=30.0, count=[rows, 2 * rows])
    corners = np.asarray(sphere.vertices)[sphere.faces]
    return _mesh(sphere, corners / np.linalg.norm(corners, axis=-1, keepdims=True))


def flat_mesh(mesh: trimesh.Trimesh) -> TriangleMesh:
    """Return a mesh whose triangles have the normals of their planes."""
    return _mesh(mesh, np.repeat(np.asarray(mesh.face_normals)[:, None], 3, axis=1))


def _mesh(mesh: trimesh.Trimesh, normals: np.ndarray) -> TriangleMesh:
    uv = np.full((len(mesh.faces), 3, 2), 0.5)
    uv[0] = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]  # one triangle has the whole texture, which is of one colour
    return TriangleMesh(Mesh(np.asarray(mesh.vertices), np.asarray(mesh.faces, dtype=np.int32), uv, normals), "mesh")


def growth(runs: int) -> None:
    """Print the time for growing numbers of pixels, samples and triangles."""
    stage = stages()["spheres"]
    white = unit_luminance("D65")
    for width, samples in ((48, 64), (96, 64), (192, 64), (96, 16), (96, 256)):
        ours = Ours(stage, (width, width * 3 // 4), white)
        process = least_processor_s(lambda o=ours, n=samples: o.xyz(n, 1), runs)
        each = 1e9 * process / (width * (width * 3 // 4) * samples)
        print(
            f"{width} x {width * 3 // 4} pixels, {samples} samples: {process:.3f} s, {each:.0f} ns a path", flush=True
        )
    for triangles in (1_000, 10_000, 100_000, 1_000_000):
        shape = ball_of(triangles)
        bodies = [stage.bodies[0]]
        placements = [Placement(shape_of(bodies[0])), Placement(shape, np.eye(3), np.array([0.0, 0.0, 30.0]))]
        objects, _ = make_objects(placements, [uniform(bodies[0].reflectance), uniform(spectrum("TCS3"))])
        panel = typed(SceneLight, PANEL | {"position_mm": [0, 0, 180]})
        scene = make_scene(placements, objects, light_of(stage), [panel])
        close = stage._replace(field_deg=14.0)
        view = view_of(close, (96, 72))
        render(scene, view, 8)
        process = least_processor_s(lambda s=scene, v=view: render(s, v, 64, 1), runs)
        print(f"{len(shape.mesh.faces)} triangles: {1e9 * process / (96 * 72 * 64):.0f} ns a path", flush=True)


def main() -> None:
    """Run the benchmark, print its table and write it as CSV if requested."""
    parser = arguments_of(__doc__.splitlines()[0])
    parser.add_argument("--pixels", help="WIDTHxHEIGHT; else by the size")
    parser.add_argument("--converged", type=int, help="paths a pixel of the converged pictures; else by the size")
    parser.add_argument("--target", type=float, default=0.4, help="mean CIEDE2000 at which times are compared")
    parser.add_argument("--sampler", default="multijitter", help="of Mitsuba")
    parser.add_argument("--variants", nargs="*", default=["llvm_ad_spectral", "scalar_spectral"])
    parser.add_argument("--scenes", nargs="*", help="by the size where absent")
    parser.add_argument("--no-growth", action="store_true")
    parser.add_argument("--try", dest="tried", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.tried:
        try_variant(arguments.tried, arguments.sampler)
        return
    for name, value in SIZES[arguments.size].items():
        setattr(arguments, name, getattr(arguments, name) or value)
    wanted, probe = arguments.variants, ("-m", "benchmarks.reference", "--sampler", arguments.sampler, "--try")
    reasons = {variant: why_it_fails(*probe, variant) for variant in wanted}
    arguments.variants = [variant for variant in wanted if not reasons[variant]]
    use_threads(arguments.threads)
    rows = []
    for name in arguments.scenes:
        rows += compare(name, stages()[name], arguments)
        for variant, reason in reasons.items():
            if reason:
                rows.append(row_without_figures("render", f"{name_of(variant)} {name}", reason))
    report(rows, arguments.threads, arguments.output)
    if not arguments.no_growth:
        growth(arguments.runs)


if __name__ == "__main__":
    main()
