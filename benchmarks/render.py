"""Benchmark of the interactive integrator: speed against error on the paper's scene, with moving camera and light.

``python -m benchmarks.render [--size small] [--environment 6000] [--width 640] [--output render.csv]`` makes its own
inputs: the classroom of `config` on four principal vectors of its sources' spectra, and the still life with its true
materials. Every frame turns camera and light by half a degree. Errors are CIEDE2000 between the first frame and the
path-traced one at pixels that show objects, with the noise removed. The error of the representation itself, against the
61-band frame with all reflections, is printed too. Peak and resident memory are those of a process that memory-maps the
files of the light, prepares one variant and renders it. Processor time divided by the number of threads is the time of
a frame on idle cores. ``spectral`` carries 61 bands and decodes them from the four coefficients at every look-up;
``spectral, stored`` uses no compression and also stores light and blurred light in 61 bands. ``light maps`` are baked
for the unrotated light, which therefore does not turn. Outlines are smooth as in a scene by default, except in the
variant with rough ones.
"""

import pickle
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property, partial
from pathlib import Path

import numba
import numpy as np

from benchmarks.table import arguments_of, least_processor_s, medians_s, own_peak_mb, printed_by, report
from irodori.colour.colorimetry import delta_e_xyz, summary, xyz_from_radiance
from irodori.config.definitions import load_definitions, read_yaml
from irodori.config.models import InteractiveIntegrator, Size
from irodori.geometry.embree import Tracer
from irodori.geometry.rig_frame import rotation_xyz
from irodori.geometry.shapes.shape import Shape
from irodori.light.environment_file import Environment
from irodori.light.gloss_maps import GlossMaps
from irodori.light.irradiance import fitted_irradiance_map
from irodori.material.material_file import Material
from irodori.rendering.interactive.frame_renderer import CollimatedLamp, light_of, prepare_scene, render_frame
from irodori.rendering.light_maps import LightMaps
from irodori.rendering.reference.baking import bake_maps
from irodori.rendering.reference.converging_picture import TracedScene, make_scene
from irodori.rendering.reference.distance import Distance, distance_to_reference, object_pixels
from irodori.rendering.scene_arrays import View, make_objects, make_placements, make_view
from irodori.simulation.virtual_rig.classroom import room_coefficients, source_spectra
from irodori.simulation.virtual_rig.ground_truth import true_material
from irodori.spectra.published import light

_ROOT = Path(__file__).resolve().parents[1]
_BASES = 4
_STEP_DEG = 0.5
_LAMP_DIRECTION = (0.4, -0.5, 1.0)
#: Representation, options of `prepare_scene`, and options of `render_frame`.
VARIANTS = {
    "rgb": ("rgb", {}, {}),
    "coefficients": ("coefficients", {}, {}),
    "coefficients, all bounces": ("coefficients", {"least_throughput": 0.0}, {}),
    "coefficients, cut at 1e-2": ("coefficients", {"least_throughput": 1e-2}, {}),
    "coefficients, camera rests": ("coefficients", {}, {"keep_visibility": True}),
    "coefficients, rough outlines": ("coefficients", {"smooth_outlines": False}, {}),
    "coefficients, light maps": ("coefficients", {"baked": True}, {}),
    "spectral, light maps": ("spectral", {"baked": True}, {}),
    "coefficients, a lamp": ("coefficients", {"lamps": 1}, {}),
    "quadrature": ("quadrature", {}, {}),
    "spectral": ("spectral", {}, {}),
    "spectral, bands": ("spectral", {}, {"bands": True}),
    "spectral, stored": ("spectral", {"stored": True}, {}),
}
#: What is measured where the command line does not say it; every representation compiles loops of its own.
SIZES = {
    "small": {
        "environment": 1000,
        "width": 320,
        "height": 240,
        "variants": ["rgb", "coefficients", "coefficients, light maps", "spectral"],
    },
    "full": {"environment": 6000, "width": 640, "height": 480, "variants": list(VARIANTS)},
}


def true_light(loaded, width: int) -> Environment:
    """Return the light of the still life's room, ``width`` px wide, on the principal vectors of its sources."""
    room = loaded.environments[loaded.scenes["still-life"].environment].virtual
    spectra = source_spectra(room, light(loaded.rigs["virtual"].light.spectrum))[1]
    sources = room_coefficients(room, width, width // 2)
    flat = sources.reshape(-1, len(spectra))
    root = np.linalg.cholesky((flat.T @ flat).astype(np.float64) / len(flat))
    basis = np.linalg.svd(root.T @ spectra, full_matrices=False)[2][:_BASES].T
    coefficients = (flat @ (spectra @ basis).astype(np.float32)).reshape(*sources.shape[:2], _BASES)
    irradiance, _ = fitted_irradiance_map(coefficients, max_error=2e-3, max_height=128)
    return Environment(coefficients, basis, irradiance)


def true_materials(loaded) -> list[Material]:
    """Return the true materials of the still life's objects."""
    objects = [loaded.objects[item.object] for item in loaded.scenes["still-life"].objects]
    return [true_material(one, loaded.cameras[one.camera], loaded.rigs["virtual"]) for one in objects]


def make_inputs(width: int, folder: Path) -> None:
    """Write the scene for an environment ``width`` px wide to a folder."""
    loaded = load_definitions(read_yaml(_ROOT / "config/config.yaml"), _ROOT)
    # Without the table, which earlier measurements did not have.
    scene, materials = replace(loaded.scenes["still-life"], bodies=()), true_materials(loaded)
    # The room is traced at half the width: blurred light needs no more, and the picture is as large as any.
    room = true_light(loaded, width // 2)
    stored = np.repeat(np.repeat(room.coefficients.astype(np.float16), 2, axis=0), 2, axis=1)
    np.save(folder / "coefficients.npy", stored)
    gloss = GlossMaps.of(room.coefficients)
    for number, level in enumerate(gloss.levels):
        np.save(folder / f"gloss-{number}.npy", level)
    blurred = (gloss.first, len(gloss.levels))
    shapes = [loaded.objects[item.object].shape for item in scene.objects]
    with (folder / "scene.pickle").open("wb") as out:
        pickle.dump((scene, shapes, materials, room.basis, room.irradiance, blurred), out)


class Studio:
    """The scene in a folder that `make_inputs` wrote, for preparing and rendering its frames."""

    def __init__(self, folder: Path, width: int, height: int) -> None:
        with (folder / "scene.pickle").open("rb") as source:
            self.scene, shapes, materials, basis, irradiance, (first, count) = pickle.load(source)
        levels = (np.load(folder / f"gloss-{number}.npy", mmap_mode="r") for number in range(count))
        self.gloss = GlossMaps(first, tuple(levels))
        placements = make_placements(self.scene, [Shape.from_definition(shape) for shape in shapes])
        self.tracer = Tracer(placements)
        self.objects, _ = make_objects(placements, materials)
        self.environment = Environment(np.load(folder / "coefficients.npy", mmap_mode="r"), basis, irradiance)
        self.white = self.environment.upward_white()
        self.image = Size(width=width, height=height)

    @cached_property
    def maps(self) -> LightMaps:
        """Light maps of the scene, baked once."""
        began = time.process_time()
        maps = bake_maps(self.tracer, self.objects, self.environment)
        made = ", ".join(f"{bake.texels} texels ({bake.error:.3f})" for bake in maps.bakes)
        print(f"light maps: {time.process_time() - began:.1f} s of CPU time, compilation included; {made}")
        return maps

    def prepare(self, representation: str, lamps: int = 0, stored: bool = False, baked: bool = False, **options):
        """Prepare the scene for a representation; with ``stored``, light is decoded to 61 bands in advance."""
        options = {"smooth_outlines": InteractiveIntegrator().smooth_outlines} | options
        options |= {"maps": self.maps} if baked else {}
        spectra = np.repeat(2.0 * light("LED-B3")[None] / light("LED-B3").mean(), lamps, axis=0)
        environment, gloss = self._in_bands() if stored else (self.environment, self.gloss)
        scene = (self.objects, light_of(environment), gloss, self.tracer, representation, self.white)
        return prepare_scene(*scene, lamps=spectra, **options)

    def _in_bands(self) -> tuple[Environment, GlossMaps]:
        """Return light and blurred light in 61 bands, with the identity as their basis."""

        def decoded(pixels: np.ndarray) -> np.ndarray:
            out = np.empty((*pixels.shape[:2], len(self.environment.basis)), dtype=pixels.dtype)
            for line, coefficients in zip(out, pixels, strict=True):
                line[:] = coefficients.astype(np.float32) @ self.environment.basis.T.astype(np.float32)
            return out

        light_in_bands = decoded(self.environment.coefficients), decoded(self.environment.irradiance)
        environment = Environment(light_in_bands[0], np.eye(len(self.environment.basis)), light_in_bands[1])
        levels = tuple(decoded(level) for level in self.gloss.levels)
        return environment, GlossMaps(self.gloss.first, levels)

    def traced_view(self) -> tuple[TracedScene, View, np.ndarray]:
        """Return the scene prepared for path tracing, the view of the first frame, and pixels that show its objects."""
        scene = make_scene(list(self.tracer.placements), self.objects, self.environment)
        view = make_view(self.scene.views["front"], self.image)
        return scene, view, object_pixels(scene.tracer, view, len(self.tracer.placements))

    def frame(self, prepared, number: int, **options) -> np.ndarray:
        """Render a frame; the light turns unless it is baked, and the camera unless visibility is kept."""
        turn = 0.0 if options.get("keep_visibility") else number * _STEP_DEG
        view = self.scene.views["front"]
        x, y, z = rotation_xyz([0.0, 0.0, turn]) @ np.asarray(view.position_mm)
        view = make_view(replace(view, position_mm=(x, y, z)), self.image)
        lamps = tuple(CollimatedLamp(np.array(_LAMP_DIRECTION)) for _ in range(prepared.lamps))
        rotation = rotation_xyz([0.0, 0.0, 0.0 if prepared.world.baked_maps else number * _STEP_DEG])
        return render_frame(prepared, view, world_from_light=rotation, lamps=lamps, **options)


def own_resident_mb() -> float:
    """Return the resident memory of this process, MB."""
    status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    return float(status["VmRSS"].split()[0]) / 1024


def print_memory(name: str, folder: Path, width: int, height: int) -> None:
    """Prepare one variant, release its inputs, render it, and print peak and resident memory, MB."""
    representation, options, frame = VARIANTS[name]
    studio = Studio(folder, width, height)
    prepared = studio.prepare(representation, **options)
    del studio.environment, studio.gloss
    for number in range(2):
        studio.frame(prepared, number, **frame)
    print(own_peak_mb(), own_resident_mb())


def _memory_mb(names: Sequence[str], arguments, folder: Path) -> list[tuple[float, float]]:
    size = ("--width", str(arguments.width), "--height", str(arguments.height))
    printed = printed_by("render", [("--memory-of", name, "--inputs", str(folder), *size) for name in names])
    return [tuple(map(float, text.split()[-2:])) for text in printed]


def _error(name: str, image: np.ndarray, reference: np.ndarray, white_xyz: np.ndarray) -> dict:
    """Return CIEDE2000 of a variant to the same picture in 61 bands; NaN for a picture under other light."""
    if image.shape[2] != 3 or any(word in name for word in ("lamp", "maps")):
        return {"mean": float("nan"), "p99": float("nan"), "max": float("nan")}
    return summary(delta_e_xyz(reference, image, white_xyz))


def _rays(studio: Studio, prepared) -> int:
    """Return the number of rays in the first frame."""
    figures: dict = {}
    studio.frame(prepared, 0, figures=figures)
    return figures["rays"]


def measure(arguments, folder: Path) -> list[dict]:
    """Time all variants in turn, frame by frame, and return the rows of the table."""
    studio = Studio(folder, arguments.width, arguments.height)
    white_xyz = xyz_from_radiance(studio.white) @ studio.white
    reference = studio.frame(studio.prepare("spectral", least_throughput=0.0), 0)
    names = [name for name in VARIANTS if name in arguments.variants]
    work, errors, far, rays = {}, {}, {}, {}
    traced, view, pixels = studio.traced_view()
    matrix = xyz_from_radiance(studio.white)
    for name in names:
        representation, options, frame = VARIANTS[name]
        prepared = studio.prepare(representation, **options)
        image = studio.frame(prepared, 0, **frame)
        errors[name] = _error(name, image, reference, white_xyz)
        if "lamp" not in name:  # which the traced scene has not
            shown = image[pixels[:, 1], pixels[:, 0]].astype(np.float64)
            shown = shown if shown.shape[1] == 3 else shown @ matrix.T
            far[name] = distance_to_reference(traced, view, pixels, shown, matrix, white_xyz)
        rays[name] = _rays(studio, prepared)
        work[name] = partial(_next_frame, studio, prepared, frame, [0])
    seconds = medians_s(work, arguments.runs)
    own_s = {name: least_processor_s(function, arguments.runs) for name, function in work.items()}
    rows = []
    for name, (peak, resident) in zip(names, _memory_mb(names, arguments, folder), strict=True):
        error = errors[name]
        alone = own_s[name] / arguments.threads
        print(f"{name}: {1 / seconds[name]:.1f} frames/s ({1 / alone:.1f} on idle cores), {rays[name]} rays, "
              f"{rays[name] / alone / 1e6:.1f} million rays/s; {_told(far.get(name))}; own error mean "
              f"{error['mean']:.4f}, p99 {error['p99']:.3f}, max {error['max']:.2f}; "
              f"resident {resident:.0f} MB")  # fmt: skip
        rows.append(
            {
                "stage": "render", "variant": f"interactive-{name}", "work": f"{arguments.width * arguments.height}",
                "unit": "pixel", "seconds": f"{seconds[name]:.4f}",
                "throughput": f"{arguments.width * arguments.height / seconds[name]:.3g}",
                "error_metric": "CIEDE2000 to reference, mean, objects" if name in far else "",
                "error": f"{far[name].mean:.3f}" if name in far else "",
                "peak_mb": f"{peak:.0f}", "reference": "interactive-rgb",
                "ratio": f"{seconds[name] / seconds['rgb']:.2f}" if "rgb" in seconds else "",
            }
        )  # fmt: skip
    return rows


def _told(far: Distance | None) -> str:
    """Return a variant's distance to the path-traced frame as text."""
    if far is None:
        return "not compared with paths"
    return (f"to reference mean {far.mean:.2f} ± {far.standard_error_of_mean:.2f}, p99 {far.p99:.1f} ± "
            f"{far.standard_error_of_p99:.1f}")  # fmt: skip


def _next_frame(studio: Studio, prepared, options: dict, number: list[int]) -> None:
    number[0] += 1
    studio.frame(prepared, number[0], **options)


def main() -> None:
    """Run the benchmark."""
    parser = arguments_of(__doc__.splitlines()[0])
    for name, help_text in (("environment", "width of the light's picture"), ("width", "of a frame"), ("height", "")):
        parser.add_argument(f"--{name}", type=int, help=f"{help_text or 'of a frame'}, px; else by the size")
    parser.add_argument("--variants", nargs="*", choices=list(VARIANTS), help="by the size where absent")
    parser.add_argument("--inputs", type=Path, help="folder of inputs that were made before")
    parser.add_argument("--memory-of", choices=list(VARIANTS), help="print the memory of a variant and end")
    parser.add_argument("--make", action="store_true", help="make the inputs and end")
    arguments = parser.parse_args()
    for name, value in SIZES[arguments.size].items():
        setattr(arguments, name, getattr(arguments, name) or value)
    numba.set_num_threads(arguments.threads)
    if arguments.make:
        make_inputs(arguments.environment, arguments.inputs)
        return
    if arguments.memory_of:
        print_memory(arguments.memory_of, arguments.inputs, arguments.width, arguments.height)
        return
    with tempfile.TemporaryDirectory() as temporary:
        folder = arguments.inputs or Path(temporary)
        if not (folder / "scene.pickle").exists():
            printed_by("render", [("--make", "--environment", str(arguments.environment), "--inputs", str(folder))])
        report(measure(arguments, folder), arguments.threads, arguments.output)


if __name__ == "__main__":
    main()
