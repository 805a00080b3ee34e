"""What a plan saves: preparing and rendering a scene with it and without it, in one run.

``python -m benchmarks.scene_plan [--tolerance 1] [--width 640] [--output plan.csv]`` takes the still life of
`benchmarks.render` under its classroom, and three scenes made of it: matte (no gloss, no mirror), mirrors alone, and
one lamp in a black room. Without a plan the integrator `interactive` carries 61 bands as a workflow's picture has them.
Seconds are the least processor time, all threads together; what is compiled is compiled before.
"""

import tempfile
from dataclasses import asdict
from pathlib import Path

import numba
import numpy as np

from benchmarks.render import Studio, make_inputs
from benchmarks.table import arguments_of, least_processor_s, own_peak_mb, report
from irodori.colour import xyz_from_radiance
from irodori.gloss import GlossMaps
from irodori.light import Environment
from irodori.rendering.interactive import Lamp, light_of, prepare_scene, render_frame
from irodori.rendering.interactive.pixels import render_pixels
from irodori.rendering.lights import make_lights, upward_radiance
from irodori.rendering.scene import make_view
from irodori.rendering.scene_plan.check import chosen_pixels, measure
from irodori.rendering.scene_plan.choices import choose
from irodori.rendering.scene_plan.model import Parts, prepare

_LAMP = {"kind": "collimated", "spectrum": "D65", "azimuth_deg": -60.0, "elevation_deg": 50.0, "irradiance": 1.0}
_BOUNCES, _LEAST_THROUGHPUT = 5, 1e-3


def scenes(studio: Studio) -> dict[str, Parts]:
    """Return the scenes by name."""
    objects, room = studio.objects, studio.environment
    room = Environment(np.asarray(room.coefficients, dtype=np.float32), room.basis, room.irradiance)
    matte, mirrors = objects.texels.copy(), objects.texels.copy()
    matte[:, -2], mirrors[:, :-1] = 0.0, 0.0
    nobody = np.zeros((0, 3)), np.zeros((0, 61))
    white = room.upward_white()
    black = Environment(0 * room.coefficients, room.basis, 0 * room.irradiance)
    lights, _ = make_lights([_LAMP], 0)
    lamp = lights.rotation[:, :, 2].copy(), lights.spectrum[:, :61].astype(np.float64)
    return {
        "still life": Parts(objects, room, studio.tracer, *nobody, white),
        "matte": Parts(objects._replace(texels=matte, mirror=0 * objects.mirror), room, studio.tracer, *nobody, white),
        "mirrors": Parts(
            objects._replace(texels=mirrors, mirror=np.maximum(objects.mirror, 0.9)),
            room,
            studio.tracer,
            *nobody,
            white,
        ),
        "one lamp": Parts(objects, black, studio.tracer, *lamp, upward_radiance(lights)),
    }


def prepare_all(parts: Parts):
    """Prepare a scene as it is rendered without a plan."""
    gloss = GlossMaps.of(parts.environment.coefficients)
    scene = (parts.objects, light_of(parts.environment), gloss, parts.tracer, "spectral", parts.white)
    options = {"max_bounces": _BOUNCES, "least_throughput": _LEAST_THROUGHPUT, "half": False, "ambient": True}
    return prepare_scene(*scene, lamps=parts.lamp_spectra, **options)


def measure_scene(name: str, parts: Parts, studio: Studio, arguments) -> list[dict]:
    """Return the rows of one scene."""
    view = make_view(studio.scene["views"]["front"], studio.image)
    names = [item["object"] for item in studio.scene["objects"]]
    lamps, matrix = tuple(Lamp(towards) for towards in parts.lamp_towards), xyz_from_radiance(parts.white)
    task = (parts, [view], names, arguments.tolerance, _BOUNCES, True)
    planner = choose(*task)
    seconds = {"plan": least_processor_s(lambda: choose(*task), 1)}
    work = {"planned": lambda: prepare(parts, planner.model, matrix), "everything": lambda: prepare_all(parts)}
    for variant, make in work.items():
        prepared = make()
        seconds[f"{variant}, prepare"] = least_processor_s(make, 1)
        bands = {"bands": variant == "everything"}
        render_frame(prepared, view._replace(width=1, height=1), lamps=lamps, **bands)
        seconds[f"{variant}, frame"] = least_processor_s(
            lambda prepared=prepared, bands=bands: render_frame(prepared, view, lamps=lamps, **bands), arguments.runs
        )
        if variant == "planned":
            picture = render_frame(prepared, view, lamps=lamps, bands=planner.model.representation == "spectral")
    pixels = chosen_pixels(view)
    truth = render_pixels(prepare(parts, planner.full, matrix), view, pixels, 1, lamps)
    found = picture[pixels[:, 1], pixels[:, 0]].astype(np.float64)
    found = found @ matrix.T if found.shape[1] != 3 else found
    measured = measure(found, truth, matrix @ parts.white)
    decided = {key: decision.value for key, decision in planner.decisions.items()}
    print(f"{name}: predicted {max(planner.spent, planner.joint):.3f} (together {planner.joint:.3f}), measured "
          f"{asdict(measured)}; {decided}; {seconds}", flush=True)  # fmt: skip
    rows = []
    for variant, value in seconds.items():
        reference = seconds.get(variant.replace("planned", "everything"), float("nan"))
        rows.append(
            {
                "stage": "plan", "variant": f"{name}: {variant}", "work": f"{view.width * view.height}",
                "unit": "pixel", "seconds": f"{value:.3f}", "throughput": f"{view.width * view.height / value:.3g}",
                "error_metric": "CIEDE2000 to the full model, p99",
                "error": f"{measured.p99:.4f}" if variant == "planned, frame" else "",
                "peak_mb": f"{own_peak_mb():.0f}", "reference": f"{name}: everything",
                "ratio": f"{value / reference:.3f}" if np.isfinite(reference) else "",
            }
        )  # fmt: skip
    return rows


def main() -> None:
    """Run the benchmark."""
    parser = arguments_of(__doc__.splitlines()[0])
    parser.add_argument("--tolerance", type=float, default=1.0, help="CIEDE2000")
    parser.add_argument("--environment", type=int, default=1000, help="width of the light's picture, px")
    parser.add_argument("--width", type=int, default=640, help="of a frame, px")
    parser.add_argument("--height", type=int, default=480, help="of a frame, px")
    parser.add_argument("--scenes", nargs="*", help="all where absent")
    parser.add_argument("--inputs", type=Path, help="folder of inputs of benchmarks.render that were made before")
    arguments = parser.parse_args()
    numba.set_num_threads(arguments.threads)
    with tempfile.TemporaryDirectory() as temporary:
        folder = arguments.inputs or Path(temporary)
        if not (folder / "scene.pickle").exists():
            make_inputs(arguments.environment, folder)
        studio = Studio(folder, arguments.width, arguments.height)
        rows = []
        for name, parts in scenes(studio).items():
            if not arguments.scenes or name in arguments.scenes:
                rows += measure_scene(name, parts, studio, arguments)
        report(rows, arguments.threads, arguments.output)


if __name__ == "__main__":
    main()
