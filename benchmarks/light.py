"""Benchmark of the recovery of light: its speed, and its error on lamps that are not in its prior.

``python -m benchmarks.light [--size small] [--runs 7] [--output speed_error.csv]``. Camera and filter are those of
``config/cameras/d5100-comb.yaml``, calibrated on a ColorChecker under illuminant A with 0.1 % noise. The light of 52
CIE illuminants is recovered, directly and reflected from coloured walls (CIE 224), with all similar published lamps
(cosine 0.9995) left out of the prior. The error is the mean CIEDE2000 of a ColorChecker under the recovered and the
true light, each adapted to its own white. Variants: ``rig-lamp`` takes the light to be the rig's lamp times a recovered
reflectance; ``posterior`` has a prior of one family, all lamps on surfaces; ``mixture`` is the light stage without
further information; ``filter-table`` adds the data sheet of the camera's filter to the calibration; ``room-chart`` has
a ColorChecker under the lamp; ``named`` has the lamp's published name and ``measured`` its measured spectrum. Published
and measured spectra differ at random from the true one: by 5 % over 40 nm, and by 2 % over 100 nm with 0.5 % noise. The
time is that for a panorama of 6000 x 3000 px, or small 512 x 256 px: sampling its directions, estimating the light on
two charts if there are some, and the room's families, and recovering every pixel. The variants ``stage`` and ``stage
rig-lamp`` are the whole light stage of this panorama without gloss maps, from file to file, with ``mixture`` and with
``rig-lamp``, for which the panorama was computed twice. Its pixels have 0.5 % of noise, as photographs do; their time
is the least processor time of all threads, and their error that of the light in the file, against the simulated room.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import yaml

from benchmarks.table import COLUMNS, arguments_of, least_processor_s, medians_s, own_peak_mb, report
from irodori.calibration.best_response import NOTHING, Given
from irodori.calibration.estimators import fit
from irodori.calibration.filter_table import read_filter
from irodori.calibration.recovery.calibration_file import Calibration
from irodori.calibration.response_model import smooth_covariance
from irodori.calibration.training import Training
from irodori.colour.colorimetry import delta_e, lab_from_xyz, xyz_from_radiance
from irodori.config.models import Camera, IrradianceMap
from irodori.core import store
from irodori.core.threads import use_threads
from irodori.light.environment_file import Environment
from irodori.light.known_lamps import given_prior, known_prior, require_lamps_seen
from irodori.light.light_prior import LightPrior, light_prior, prior_of_any_lamp, published_lamps
from irodori.light.light_recovery import Directions, LightRecovery, ResponseModel, draw_directions
from irodori.light.omnidirectional import OmnidirectionalPicture, bands, from_panorama
from irodori.light.room_charts import ChartResponses, recovery_with
from irodori.light.stage import fill_masked, prepare_environment, write_environment
from irodori.material.principal_components.basis_count import CompressOptions
from irodori.simulation.virtual_rig.sensor import band_weights
from irodori.spectra.published import MEASURED_LAMP_ERROR, NAMED_LAMP_ERROR, chart_spectra, spectrum
from irodori.spectra.published_names import ILLUMINANTS

CAMERA = Path(__file__).resolve().parents[1] / "config/cameras/d5100-comb.yaml"
LIKE = 0.9995  # least cosine between two spectra that count as similar
HEIGHTS = {"small": 256, "full": 3000}
CIE = tuple(name for name in ILLUMINANTS if not name.startswith("ISO"))
WALLS = tuple(f"TCS{number}" for number in range(0, 99, 16))
ROOM = ("D65", "LED-B3")  # lamps of the panorama
CHART, RIG_LIGHT, NOISE = "BabelColor Average", "A", 1e-3
PIXEL_NOISE = np.float32(5e-3)
JUDGED_PIXELS = 2000  # of the whole stage


@dataclass(frozen=True)
class Seen:
    """A calibrated camera, and its true response per unit radiance, (bands, 61)."""

    calibration: Calibration
    sensitivity: np.ndarray

    @cached_property
    def model(self) -> ResponseModel:
        """Response model from the calibration."""
        return ResponseModel.of(self.calibration)


def camera(seed: int = 0, table: bool = False, light: np.ndarray | None = None) -> Seen:
    """Return the default camera calibrated on a chart, if requested also with the table of its filter.

    ``light`` is the spectrum of the rig's lamp, (61,), by default illuminant A.
    """
    chart, light = chart_spectra(CHART)[1], spectrum(RIG_LIGHT) if light is None else light
    definition = Camera.of(yaml.safe_load(CAMERA.read_text(encoding="utf-8")))
    sensitivity = band_weights(definition, np.ones(len(light)))
    sensitivity = sensitivity / (sensitivity @ light)[:, None]
    response = sensitivity * light
    noise = 1.0 + NOISE * np.random.default_rng(seed).standard_normal((len(chart), len(response)))
    given = NOTHING
    if table and (known := definition.comb_filter) is not None:
        given = Given(read_filter(CAMERA.parents[2] / known.transmittance, known.name, known.shift_nm))
    training = Training(chart @ response.T * noise, chart, light, given=given)
    return Seen(fit("pinv", training, 6, np.inf), sensitivity)


def unlike(lamps: np.ndarray, *others: np.ndarray) -> np.ndarray:
    """Return those of the lamps (n, 61) that are not similar to any of the others."""
    unit, known = (rows / np.linalg.norm(rows, axis=1, keepdims=True) for rows in (lamps, np.stack(others)))
    return lamps[(unit @ known.T).max(axis=1) < LIKE]


def one_family(lamps: np.ndarray) -> LightPrior:
    """Return a prior with a single family, all lamps reflected from surfaces."""
    prior = light_prior(lamps)
    return LightPrior(prior.moment[-1:], np.ones(1), 1)


def adapted_errors(true: np.ndarray, found: np.ndarray) -> np.ndarray:
    """Return the mean CIEDE2000 of a ColorChecker between two lights, (61,) each, each adapted to its own white."""
    chart = chart_spectra(CHART)[1]
    shown = ((chart * one) @ xyz_from_radiance(one).T for one in (true, found))
    whites = (xyz_from_radiance(one) @ one for one in (true, found))
    return delta_e(*(lab_from_xyz(xyz, white) for xyz, white in zip(shown, whites, strict=True))).mean()


VARIANTS: dict[str, Callable[[np.ndarray], LightPrior] | None] = {
    "rig-lamp": None,
    "posterior": one_family,
    "mixture": prior_of_any_lamp,
    "filter-table": prior_of_any_lamp,
    "room-chart": prior_of_any_lamp,
    "named": partial(given_prior, error=NAMED_LAMP_ERROR),
    "measured": partial(given_prior, error=MEASURED_LAMP_ERROR),
}
#: Errors of given spectra: relative standard deviation of a smooth error, its correlation length in nm, and noise.
GIVEN = {"named": (0.05, 40.0, 0.0), "measured": (0.02, 100.0, 0.005)}


def chart_under(seen: Seen, lamp: np.ndarray, seed: int = 0, name: str = "chart") -> ChartResponses:
    """Return the camera's responses to a ColorChecker under a lamp, with noise."""
    chart = chart_spectra(CHART)[1]
    response = (chart * lamp) @ seen.sensitivity.T
    noise = NOISE * np.random.default_rng(seed).standard_normal(response.shape)
    return ChartResponses(name, name, response * (1.0 + noise), chart, np.square(NOISE * response))


def given(variant: str, lamp: np.ndarray, seed: int = 0) -> np.ndarray:
    """Return the spectrum (61,) that a variant is given for a lamp, with the random errors of its source."""
    smooth, length_nm, noise = GIVEN[variant]
    covariance = smooth**2 * smooth_covariance(length_nm) + noise**2 * np.eye(len(lamp))
    off = np.random.default_rng(seed).multivariate_normal(np.zeros(len(lamp)), covariance, method="eigh")
    return lamp * np.maximum(1.0 + off, 0.0)


def recovered(
    seen: Seen, light: np.ndarray, prior: LightPrior | None, chart_lamp: np.ndarray | None = None
) -> np.ndarray:
    """Recover the spectrum of a light (61,); without a prior, as the rig's lamp times a reflectance.

    The room contains only this light; with a lamp on a chart, half of the room's directions show the lamp itself.
    """
    response = seen.sensitivity @ light
    if prior is None:
        return seen.calibration.light * seen.calibration.spectra(response)
    if chart_lamp is not None:
        room = Directions(np.stack([response, seen.sensitivity @ chart_lamp]), np.full(2, 0.5))
        recovery = recovery_with([chart_under(seen, chart_lamp)], seen.model, room, prior)
    else:
        recovery = LightRecovery.of_room(seen.model, Directions(response[None], np.ones(1)), prior)
    return recovery.basis @ recovery.weights(response)


def errors(seen: Seen, variant: str, walls: tuple[str, ...] = (), names: tuple[str, ...] = CIE) -> np.ndarray:
    """Return the errors of lamps, seen directly (lamps, 1) or reflected from walls (lamps, walls)."""
    surfaces, make_prior = [spectrum(wall) for wall in walls] or [np.ones(61)], VARIANTS[variant]
    found = np.empty((len(names), len(surfaces)))
    for number, (row, name) in enumerate(zip(found, names, strict=True)):
        lamp = spectrum(name)
        lamp = lamp / lamp.mean()
        known = given(variant, lamp, number)[None] if variant in GIVEN else unlike(published_lamps(), lamp)
        prior = make_prior and make_prior(known)
        for column, surface in enumerate(surfaces):
            found_light = recovered(seen, lamp * surface, prior, lamp if variant == "room-chart" else None)
            row[column] = adapted_errors(lamp * surface, found_light)
    return found


def panorama(height: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the light of a room with two lamps and walls of all test colours.

    Returns
    -------
    lights : (512, 61) float64
    shown : (height, 2 height) int
        The light that each pixel shows.
    """
    rng = np.random.default_rng(1)
    walls = np.stack([spectrum(f"TCS{number}") for number in range(99)])
    lamps = np.stack([spectrum(name) / spectrum(name).mean() for name in ROOM])
    share = rng.uniform(size=(512, 1))
    lights = (share * lamps[0] + (1.0 - share) * lamps[1]) * walls[rng.integers(99, size=512)]
    return lights, rng.integers(512, size=(height, 2 * height))


def photographed(seen: Seen, lights: np.ndarray, shown: np.ndarray) -> np.ndarray:
    """Return the responses to a panorama, (height, 2 height, bands); parameters as `panorama` returns them."""
    return (lights @ seen.sensitivity.T).astype(np.float32)[shown]


def recover(
    seen: Seen, picture: np.ndarray, charts: tuple[ChartResponses, ...] = (), lamps: tuple[str, ...] = ()
) -> np.ndarray:
    """Recover the weights of a whole picture as in the light stage, some rows at a time."""
    parts = (picture[first : first + 32] for first in range(0, len(picture), 32))
    drawn = draw_directions((part.reshape(-1, part.shape[-1]), 1.0) for part in parts)
    prior = published = prior_of_any_lamp()
    if lamps:
        prior = known_prior(lamps)
        require_lamps_seen(lamps, drawn, seen.model, prior, published, "panorama")
    recovery = recovery_with(charts, seen.model, drawn, prior)
    return np.concatenate([recovery.weights(picture[first : first + 32]) for first in range(0, len(picture), 32)])


def write_place(folder: Path, seen: Seen, picture: np.ndarray) -> None:
    """Write the calibration, and a panorama (height, width, bands) with noise, as files of the stages before."""
    rng = np.random.default_rng(2)
    noisy = np.concatenate(
        [rows * (1.0 + PIXEL_NOISE * rng.standard_normal(rows.shape, dtype=np.float32)) for rows in picture[:, None]]
    )
    with store.create(folder / "calibration.h5", store.Provenance("benchmark")) as out:
        seen.calibration.write(out)
    with store.create(folder / "linear.h5", store.Provenance("benchmark")) as out:
        axes = "row,column,band"
        out.write("response", noisy, units="1", dims=axes, quantity="response", compression="none")
        for mask, value in (("valid", 1), ("clipped", 0)):
            out.write(mask, np.full(picture.shape[:2], value, np.uint8), units="1", dims="row,column", quantity=mask)
        out.attribute("filters", list(seen.calibration.filters))


def stage(folder: Path) -> None:
    """Run the light stage on the files of a place."""
    options = CompressOptions(), IrradianceMap(), store.Provenance("benchmark")
    prepare_environment(folder / "linear.h5", folder / "calibration.h5", folder / "light.h5", *options)


def stage_with_rig_lamp(folder: Path) -> None:
    """Run the light stage with the rig's lamp times a reflectance in place of recovered light."""
    linear, calibration = folder / "linear.h5", Calibration.load(folder / "calibration.h5")
    with store.open_file(linear) as file:
        valid = file.read("valid").astype(bool)

    def read():
        with store.open_file(linear) as file:
            for rows in bands(len(valid)):
                response = fill_masked(file.read("response", rows), ~valid[rows])
                yield from_panorama(calibration.weights(response))

    picture = OmnidirectionalPicture(valid.shape, calibration.light[:, None] * calibration.basis, read, linear)
    for _ in read():  # as when the stage read every picture twice
        pass
    options = CompressOptions(), IrradianceMap(), store.Provenance("benchmark")
    write_environment(picture, calibration.light, folder / "light.h5", *options)


def stage_error(file: Path, lights: np.ndarray, shown: np.ndarray) -> float:
    """Return the mean error of the light in a file over pixels at equal steps; lights and pixels as in `panorama`."""
    found, true = Environment.load(file), from_panorama(shown[..., None]).ravel()
    some = np.unique(np.linspace(0, true.size - 1, JUDGED_PIXELS).astype(int))
    recovered_lights = found.coefficients.reshape(true.size, -1)[some] @ found.basis.T
    pairs = zip(lights[true[some]], recovered_lights, strict=True)
    return float(np.mean([adapted_errors(*pair) for pair in pairs]))


def main() -> None:
    """Run the benchmark, print its table and write it as CSV if requested."""
    arguments = arguments_of(__doc__.splitlines()[0]).parse_args()
    use_threads(arguments.threads)
    seen, with_table = camera(), camera(table=True)
    room = panorama(HEIGHTS[arguments.size])
    picture = photographed(seen, *room)
    charts = tuple(chart_under(seen, spectrum(name)) for name in ROOM)
    timed = {
        "rig-lamp": partial(seen.calibration.weights, picture),
        "mixture": partial(recover, seen, picture),
        "room-chart": partial(recover, seen, picture, charts),
        "named": partial(recover, seen, picture, lamps=ROOM),
    }
    seconds = medians_s(timed, arguments.runs)
    with TemporaryDirectory() as folder:
        files = Path(folder)
        write_place(files, seen, picture)
        whole = {
            name: (least_processor_s(partial(run, files), 2), stage_error(files / "light.h5", *room))
            for name, run in (("stage rig-lamp", stage_with_rig_lamp), ("stage", stage))
        }
    work, rows = picture.shape[0] * picture.shape[1] / 1e6, []
    for variant in VARIANTS:
        for place, walls in (("", ()), (" walls", WALLS)):
            # The families of a picture cost the same whatever one spectrum they are of.
            taken = seconds[
                {"posterior": "mixture", "filter-table": "mixture", "measured": "named"}.get(variant, variant)
            ]
            found = errors(with_table if variant == "filter-table" else seen, variant, walls)
            metric = f"mean CIEDE2000 of a chart, adapted, {len(CIE)} lamps left out" + (", off walls" if walls else "")
            values = ("light", variant + place, f"{work:.4g}", "megapixels", f"{taken:.4f}", f"{work / taken:.3f}",
                      metric, f"{found.mean():.4f}", f"{own_peak_mb():.0f}", "rig-lamp",
                      f"{taken / seconds['rig-lamp']:.3f}")  # fmt: skip
            rows.append(dict(zip(COLUMNS, values, strict=True)))
            worse = found.mean(axis=1)
            print(f"{variant}{place}: worst {CIE[int(worse.argmax())]} {worse.max():.2f}")
    for variant, (taken, error) in whole.items():
        values = ("light", variant, f"{work:.4g}", "megapixels", f"{taken:.4f}", f"{work / taken:.3f}",
                  "mean CIEDE2000 of a chart, adapted, over the pixels", f"{error:.4f}", f"{own_peak_mb():.0f}",
                  "stage rig-lamp", f"{taken / whole['stage rig-lamp'][0]:.3f}")  # fmt: skip
        rows.append(dict(zip(COLUMNS, values, strict=True)))
    report(rows, arguments.threads, arguments.output)


if __name__ == "__main__":
    main()
