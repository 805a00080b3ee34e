"""Benchmark of the maps of an environment: irradiance, and light blurred for gloss.

``python -m benchmarks.environment [--size small] [--height 3000] [--runs 5] [--output speed_error.csv]``. The light is
a bright sky that varies smoothly on four bases, without and with a sun of half a degree that is 50000 times as bright;
6000 x 3000 px, or small 256 x 128 px. The maps of an environment are made in three steps: ``quadtree`` sorts the light,
``irradiance`` fits the irradiance map to 0.2 % of its largest value, or as well as 512 rows allow (128 in small), and
``gloss`` blurs the light. The reference is ``irradiance`` without the sun.
"""

import numpy as np

from benchmarks.table import COLUMNS, arguments_of, medians_s, own_peak_mb, report
from irodori.core.threads import use_threads
from irodori.light.gloss_maps import GlossMaps
from irodori.light.irradiance import Integrator, fitted_irradiance_map

MAX_ERROR = 0.002
SUN, SUN_RAD = 5e4, 0.0093
HEIGHTS, MAX_HEIGHTS = {"small": 128, "full": 3000}, {"small": 128, "full": 512}


def sky(height: int, with_sun: bool) -> np.ndarray:
    """Return the coefficients of the light, (height, 2 height, 4) float32."""
    theta, azimuth = np.pi * (np.arange(height) + 0.5) / height, np.pi * (np.arange(2 * height) + 0.5) / height
    waves = 1.0 + 0.5 * np.sin(5 * theta)[:, None] * np.sin(7 * azimuth)
    out = (waves[..., None] * [1.0, 0.3, 0.1, 0.05]).astype(np.float32)
    if with_sun:
        row, column, radius = int(0.3 * height), int(1.2 * height), max(1, round(0.5 * SUN_RAD / np.pi * height))
        out[row - radius : row + radius, column - radius : column + radius] *= SUN
    return out


def main() -> None:
    """Run the benchmark, print its table and write it as CSV if requested."""
    parser = arguments_of(__doc__.splitlines()[0])
    parser.add_argument("--height", type=int, help="rows of the panorama, twice as many columns; else by the size")
    arguments = parser.parse_args()
    arguments.height = arguments.height or HEIGHTS[arguments.size]
    use_threads(arguments.threads)
    lights = {"": sky(arguments.height, False), "-sun": sky(arguments.height, True)}
    integrators = {name: Integrator(light) for name, light in lights.items()}
    max_height = MAX_HEIGHTS[arguments.size]
    work, errors = {}, {}
    for name, light in lights.items():
        work[f"quadtree{name}"] = lambda light=light: Integrator(light)
        work[f"irradiance{name}"] = lambda name=name, light=light: fitted_irradiance_map(
            light, MAX_ERROR, max_height, integrators[name]
        )
        work[f"gloss{name}"] = lambda light=light: GlossMaps.of(light)
        errors[f"irradiance{name}"] = work[f"irradiance{name}"]()[1]["max_error"]
    seconds = medians_s(work, arguments.runs)
    rows = []
    for name, median in seconds.items():
        count = lights[""].shape[0] * lights[""].shape[1] / 1e6
        metric = "largest error over the largest irradiance" if name in errors else ""
        values = ("environment", name, f"{count:.4g}", "megapixels", f"{median:.4f}", f"{count / median:.3f}", metric,
                  f"{errors.get(name, float('nan')):.5f}", f"{own_peak_mb():.0f}", "irradiance",
                  f"{median / seconds['irradiance']:.3f}")  # fmt: skip
        rows.append(dict(zip(COLUMNS, values, strict=True)))
    report(rows, arguments.threads, arguments.output)


if __name__ == "__main__":
    main()
