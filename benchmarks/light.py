"""The recovery of light: its speed, and its error on lamps that it has never seen.

``python -m benchmarks.light [--size small] [--runs 7] [--output speed_error.csv]``. Camera and filter are those of
``config/cameras/d5100-comb.yaml``, calibrated on a ColorChecker under A whose responses have 0.1 % of noise. 52 CIE
illuminants are photographed, each with all published lamps that are like it (cosine 0.9995) left out of the prior, bare
and off coloured walls (CIE 224). The error is the mean CIEDE2000 of a ColorChecker under the recovered light, adapted
to its own white. ``rig-lamp`` is the rig's lamp times the reflectance of the same responses, ``posterior`` knows one
family of all lamps on surfaces, ``mixture`` is what the light stage does without help, ``filter-table`` where the
camera's calibration knew the data sheet of its filter, ``room-chart`` with a
ColorChecker under the lamp, ``named`` with the lamp's published name and ``measured`` with its spectrum. A lamp is not
quite the published one of its name, nor its reading quite its spectrum: both are off at random, by 5 % over 40 nm, and
by 2 % over 100 nm with 0.5 % of noise. Timed is a panorama of 6000 x 3000 px, or small 512 x 256 px: the draw of its
directions, the light on two charts where there are some, the room's families and every pixel.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import yaml

from benchmarks.table import COLUMNS, arguments_of, medians_s, own_peak_mb, report
from irodori.calibration.best_response import NOTHING, Given
from irodori.calibration.estimators import fit_checked
from irodori.calibration.filter_table import read_filter
from irodori.calibration.recovery.calibration_file import Calibration
from irodori.calibration.response_model import smooth_covariance
from irodori.calibration.training import Training
from irodori.colour.colorimetry import delta_e, lab_from_xyz, xyz_from_radiance
from irodori.config.models import Camera
from irodori.core.threads import use_threads
from irodori.light.known_lamps import given_prior, known_prior, require_lamps_seen
from irodori.light.light_prior import LightPrior, light_prior, prior_of_any_lamp, published_lamps
from irodori.light.light_recovery import Directions, LightRecovery, ResponseModel, draw_directions
from irodori.light.room_charts import ChartResponses, recovery_with
from irodori.simulation.virtual_rig.sensor import band_weights
from irodori.spectra.published import chart_spectra, spectrum
from irodori.spectra.published_names import ILLUMINANTS

CAMERA = Path(__file__).resolve().parents[1] / "config/cameras/d5100-comb.yaml"
LIKE = 0.9995  # cosine of two spectra from which on the one tells the other
HEIGHTS = {"small": 256, "full": 3000}
CIE = tuple(name for name in ILLUMINANTS if not name.startswith("ISO"))
WALLS = tuple(f"TCS{number}" for number in range(0, 99, 16))
ROOM = ("D65", "LED-B3")  # lamps of the panorama
CHART, RIG_LIGHT, NOISE = "BabelColor Average", "A", 1e-3


@dataclass(frozen=True)
class Seen:
    """A calibrated camera, and what it truly answers per unit radiance, (bands, 61)."""

    calibration: Calibration
    sensitivity: np.ndarray

    @property
    def model(self) -> ResponseModel:
        """What the calibration tells of it."""
        return ResponseModel.of(self.calibration)


def camera(seed: int = 0, table: bool = False) -> Seen:
    """Return the default camera as its photographs of a chart tell it, and the table of its filter where asked."""
    light, chart = spectrum(RIG_LIGHT), chart_spectra(CHART)[1]
    definition = Camera.of(yaml.safe_load(CAMERA.read_text(encoding="utf-8")))
    response = band_weights(definition, light)
    response = response / response.sum(axis=1, keepdims=True)
    noise = 1.0 + NOISE * np.random.default_rng(seed).standard_normal((len(chart), len(response)))
    given = NOTHING
    if table and (known := definition.comb_filter) is not None:
        given = Given(read_filter(CAMERA.parents[2] / known.transmittance, known.name, known.shift_nm))
    training = Training(chart @ response.T * noise, chart, light, given=given)
    return Seen(fit_checked("pinv", training, 6, np.inf), response / light)


def unlike(lamps: np.ndarray, *others: np.ndarray) -> np.ndarray:
    """Return the lamps (n, 61) that are like none of some others."""
    unit, known = (rows / np.linalg.norm(rows, axis=1, keepdims=True) for rows in (lamps, np.stack(others)))
    return lamps[(unit @ known.T).max(axis=1) < LIKE]


def one_family(lamps: np.ndarray) -> LightPrior:
    """Return the prior of a single family, of all lamps on surfaces."""
    prior = light_prior(lamps)
    return LightPrior(prior.moment[-1:], np.ones(1), 1)


def adapted_errors(true: np.ndarray, found: np.ndarray) -> np.ndarray:
    """Return the mean CIEDE2000 of a ColorChecker under two lights, each (61,), each with its own white."""
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
    "named": partial(given_prior, measured=np.array(False)),
    "measured": partial(given_prior, measured=np.array(True)),
}
#: Of what is said of a lamp: relative standard deviation of what is smooth, over how many nm, and of noise.
GIVEN = {"named": (0.05, 40.0, 0.0), "measured": (0.02, 100.0, 0.005)}


def chart_under(seen: Seen, lamp: np.ndarray, seed: int = 0, name: str = "chart") -> ChartResponses:
    """Return what a ColorChecker answers to a lamp, with noise."""
    chart = chart_spectra(CHART)[1]
    response = (chart * lamp) @ seen.sensitivity.T
    noise = NOISE * np.random.default_rng(seed).standard_normal(response.shape)
    return ChartResponses(name, name, response * (1.0 + noise), chart)


def given(variant: str, lamp: np.ndarray, seed: int = 0) -> np.ndarray:
    """Return what is said of a lamp (61,), as far off as the variant's sources are."""
    smooth, length_nm, noise = GIVEN[variant]
    covariance = smooth**2 * smooth_covariance(length_nm) + noise**2 * np.eye(len(lamp))
    off = np.random.default_rng(seed).multivariate_normal(np.zeros(len(lamp)), covariance, method="eigh")
    return lamp * np.maximum(1.0 + off, 0.0)


def recovered(
    seen: Seen, light: np.ndarray, prior: LightPrior | None, chart_lamp: np.ndarray | None = None
) -> np.ndarray:
    """Return a light (61,) as it is recovered; without a prior, as the rig's lamp on paint.

    The room shows the light alone; where a lamp lights a chart, half of what the room shows is this lamp itself.
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
    """Return the errors of lamps, bare (lamps, 1) or off walls (lamps, walls)."""
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


def panorama(seen: Seen, height: int) -> np.ndarray:
    """Return the responses of a room with two lamps and walls of all test colours, (height, 2 height, bands)."""
    rng = np.random.default_rng(1)
    walls = np.stack([spectrum(f"TCS{number}") for number in range(99)])
    lamps = np.stack([spectrum(name) / spectrum(name).mean() for name in ROOM])
    share = rng.uniform(size=(512, 1))
    light = (share * lamps[0] + (1.0 - share) * lamps[1]) * walls[rng.integers(99, size=512)]
    response = (light @ seen.sensitivity.T).astype(np.float32)
    return response[rng.integers(512, size=(height, 2 * height))]


def recover(
    seen: Seen, picture: np.ndarray, charts: tuple[ChartResponses, ...] = (), lamps: tuple[str, ...] = ()
) -> np.ndarray:
    """Return the weights of a whole picture as the light stage does, a band of rows at a time."""
    parts = (picture[first : first + 32] for first in range(0, len(picture), 32))
    drawn = draw_directions((part.reshape(-1, part.shape[-1]), 1.0) for part in parts)
    prior = published = prior_of_any_lamp()
    if lamps:
        prior = known_prior(lamps)
        require_lamps_seen(lamps, drawn, seen.model, prior, published, "panorama")
    recovery = recovery_with(charts, seen.model, drawn, prior)
    return np.concatenate([recovery.weights(picture[first : first + 32]) for first in range(0, len(picture), 32)])


def main() -> None:
    """Measure and print; write a CSV if asked."""
    arguments = arguments_of(__doc__.splitlines()[0]).parse_args()
    use_threads(arguments.threads)
    seen, with_table = camera(), camera(table=True)
    picture = panorama(seen, HEIGHTS[arguments.size])
    charts = tuple(chart_under(seen, spectrum(name)) for name in ROOM)
    timed = {
        "rig-lamp": partial(seen.calibration.weights, picture),
        "mixture": partial(recover, seen, picture),
        "room-chart": partial(recover, seen, picture, charts),
        "named": partial(recover, seen, picture, lamps=ROOM),
    }
    seconds = medians_s(timed, arguments.runs)
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
    report(rows, arguments.threads, arguments.output)


if __name__ == "__main__":
    main()
