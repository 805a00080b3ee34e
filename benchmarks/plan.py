"""Benchmark of scene plans: preparation and rendering with and without a plan, in one run.

``python -m benchmarks.plan [--size small] [--tolerance 1] [--width 640] [--output plan.csv]`` takes the still
life of `benchmarks.render` in its classroom, and three scenes made from it: matte (no gloss, no mirror), mirrors only,
and one lamp in a black room. Without a plan (``full``), the integrator `interactive` carries 61 bands and ends paths
with a throughput below a thousandth, as for a workflow's picture; the model against which errors are measured ends
none. Seconds are processor time of all threads divided by their number, for a frame the least of the runs; compilation
is done before. Small: 160 x 120 px in a light 256 px wide.
"""

import tempfile
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.render import Studio, make_inputs
from benchmarks.table import COLUMNS, arguments_of, least_processor_s, own_peak_mb, report
from irodori.colour.colorimetry import xyz_from_radiance
from irodori.config.definition import typed
from irodori.config.models import PlanOverrides, SceneLight
from irodori.core.threads import use_threads
from irodori.light.environment_file import Environment
from irodori.light.gloss_maps import GlossMaps
from irodori.rendering.interactive.frame_renderer import CollimatedLamp, light_of, prepare_scene, render_frame
from irodori.rendering.interactive.pixel_rays import render_pixels
from irodori.rendering.planning.choices import choose
from irodori.rendering.planning.modelled_scene import SceneParts, prepare
from irodori.rendering.planning.planned_check import chosen_pixels, measure
from irodori.rendering.reference.baking import bake_maps
from irodori.rendering.scene_arrays import Objects, make_view
from irodori.rendering.scene_lights import make_lights, upward_radiance

_LAMP = {"kind": "collimated", "spectrum": "D65", "azimuth_deg": -60.0, "elevation_deg": 50.0, "irradiance": 1.0}
_BOUNCES, _LEAST_THROUGHPUT = 5, 1e-3
#: What is measured where the command line does not say it: widths of the light's picture and of a frame, its height.
SIZES = {
    "small": {"environment": 256, "width": 160, "height": 120},
    "full": {"environment": 1000, "width": 640, "height": 480},
}


def scenes(studio: Studio) -> dict[str, Callable[[], SceneParts]]:
    """Return what makes the scenes, by name: light maps are baked only for those that are measured."""
    objects, room = studio.objects, studio.environment
    room = Environment(np.asarray(room.coefficients, dtype=np.float32), room.basis, room.irradiance)
    matte, mirrors = objects.texels.copy(), objects.texels.copy()
    matte[:, -2], mirrors[:, :-1] = 0.0, 0.0
    nobody = np.zeros((0, 3)), np.zeros((0, 61))
    white = room.upward_white()
    black = Environment(0 * room.coefficients, room.basis, 0 * room.irradiance)
    lights = [typed(SceneLight, _LAMP)]
    made, _ = make_lights(lights, 0)
    lamp = made.rotation[:, :, 2].copy(), made.spectrum[:, :61].astype(np.float64)
    of_matte = objects._replace(texels=matte, mirror=0 * objects.mirror)
    of_mirrors = objects._replace(texels=mirrors, mirror=np.maximum(objects.mirror, 0.9))

    def parts(objects: Objects, room: Environment, lights=(), lamps=nobody, white=white) -> SceneParts:
        maps = bake_maps(studio.tracer, objects, room, lights)
        return SceneParts(objects, room, studio.tracer, *lamps, white, maps)

    return {
        "still-life": partial(parts, objects, room),
        "matte": partial(parts, of_matte, room),
        "mirrors": partial(parts, of_mirrors, room),
        "one-lamp": partial(parts, objects, black, lights, lamp, upward_radiance(made)),
    }


def prepare_all(parts: SceneParts):
    """Prepare a scene for rendering without a plan."""
    gloss = GlossMaps.of(parts.environment.coefficients)
    scene = (parts.objects, light_of(parts.environment), gloss, parts.tracer, "spectral", parts.white)
    options = {"max_bounces": _BOUNCES, "least_throughput": _LEAST_THROUGHPUT, "maps": parts.maps}
    return prepare_scene(*scene, lamps=parts.lamp_spectra, **options)


def measure_scene(name: str, parts: SceneParts, studio: Studio, arguments) -> list[dict]:
    """Measure one scene and return its rows of the table."""
    view = make_view(studio.scene.views["front"], studio.image)
    names = [item.object for item in studio.scene.objects]
    lamps, matrix = tuple(CollimatedLamp(towards) for towards in parts.lamp_towards), xyz_from_radiance(parts.white)
    plan = partial(choose, parts, [view], names, arguments.tolerance, max_bounces=_BOUNCES,
                   overrides=PlanOverrides())  # fmt: skip
    planner = plan()
    pixels = chosen_pixels(view)
    truth = render_pixels(prepare(parts, planner.full, matrix), view, pixels, 1, lamps)
    # The reference first: the rows of the plan are ratios to its.
    work = {"full": lambda: prepare_all(parts), "planned": lambda: prepare(parts, planner.model, matrix)}
    processor_s, errors = {"plan": least_processor_s(plan, 1)}, {}
    for variant, make in work.items():
        prepared = make()
        processor_s[f"{variant}, prepare"] = least_processor_s(make, 1)
        frame = partial(render_frame, prepared, lamps=lamps, bands=prepared.representation == "spectral")
        frame(view._replace(width=1, height=1))
        processor_s[f"{variant}, frame"] = least_processor_s(lambda frame=frame: frame(view), arguments.runs)
        found = frame(view)[pixels[:, 1], pixels[:, 0]].astype(np.float64)
        errors[variant] = measure(found if found.shape[1] == 3 else found @ matrix.T, truth, matrix @ parts.white)
    decided = {key: decision.value for key, decision in planner.decisions.items()}
    print(f"{name}: predicted {max(planner.spent, planner.joint):.3f} (together {planner.joint:.3f}), measured "
          f"{asdict(errors['planned'])}; {decided}; processor seconds {processor_s}", flush=True)  # fmt: skip
    seconds = {step: value / arguments.threads for step, value in processor_s.items()}
    # A unit for each scene: the front of speed against error is among variants of one unit.
    rows = [
        row(f"{variant} {name}", view.width * view.height, f"pixel of {name}", seconds[f"{variant}, frame"],
            f"full {name}", seconds["full, frame"], error=errors[variant].p99)
        for variant in work
    ]  # fmt: skip
    whole = f"full {name}, prepare", seconds["full, prepare"]
    rows += [
        row(f"{variant} {name}, {step}", 1, "scene", seconds[key], *whole, error=float("nan"))
        for variant, step, key in (
            ("full", "prepare", "full, prepare"),
            ("planned", "prepare", "planned, prepare"),
            ("planned", "plan", "plan"),
        )
    ]
    return rows


def row(
    variant: str, work: int, unit: str, seconds: float, reference: str, reference_s: float, *, error: float
) -> dict:
    """Return one row of the table of speed against error."""
    metric = "CIEDE2000 to the full model, p99" if np.isfinite(error) else ""
    values = ("plan", variant, f"{work}", unit, f"{seconds:.4f}", f"{work / seconds:.3g}", metric, f"{error:.4f}",
              f"{own_peak_mb():.0f}", reference, f"{seconds / reference_s:.4g}")  # fmt: skip
    return dict(zip(COLUMNS, values, strict=True))


def main() -> None:
    """Run the benchmark."""
    parser = arguments_of(__doc__.splitlines()[0])
    parser.add_argument("--tolerance", type=float, default=1.0, help="CIEDE2000")
    for name, help_text in (("environment", "width of the light's picture"), ("width", "of a frame"), ("height", "")):
        parser.add_argument(f"--{name}", type=int, help=f"{help_text or 'of a frame'}, px; else by the size")
    parser.add_argument("--scenes", nargs="*", help="all where absent")
    parser.add_argument("--inputs", type=Path, help="folder of inputs of benchmarks.render that were made before")
    arguments = parser.parse_args()
    for name, value in SIZES[arguments.size].items():
        setattr(arguments, name, getattr(arguments, name) or value)
    use_threads(arguments.threads)
    with tempfile.TemporaryDirectory() as temporary:
        folder = arguments.inputs or Path(temporary)
        if not (folder / "scene.pickle").exists():
            make_inputs(arguments.environment, folder)
        studio = Studio(folder, arguments.width, arguments.height)
        rows = []
        for name, make in scenes(studio).items():
            if not arguments.scenes or name in arguments.scenes:
                rows += measure_scene(name, make(), studio, arguments)
        report(rows, arguments.threads, arguments.output)


if __name__ == "__main__":
    main()
