"""The virtual sensor: photons, noise, saturation and the comb filter."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from made import made

from irodori.config.models import Camera, CombFilter
from irodori.core import store
from irodori.simulation.virtual_rig.dng_writer import write_dng
from irodori.simulation.virtual_rig.sensor import Sensor, band_weights, comb_transmittance
from irodori.spectra.grid import WAVELENGTH_NM
from irodori.spectra.published import camera_sensitivities, spectrum

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT.parent / "shared" / "data" / "raw"
CAMERA = yaml.safe_load((ROOT / "config/cameras/d5100-comb.yaml").read_text())
BLACK, WHITE = 600, 16383
PROVENANCE = store.Provenance("test")


def dng(path, mosaic, black=BLACK, white=WHITE, exposure_s=0.02):
    write_dng(path, mosaic, black_level=black, white_level=white, exposure_s=exposure_s, model="test")
    return path


def random_mosaic(rng, height=64, width=96, top=WHITE) -> np.ndarray:
    return rng.integers(0, top + 1, (height, width), dtype=np.uint16)


SENSOR = Sensor(**CAMERA["virtual"]["sensor"])


def test_photon_transfer_gives_the_conversion_gain():
    rng = np.random.default_rng(4)
    level = np.full((500, 500), 0.6)
    first, second = (SENSOR.expose(level, 0.02, rng).astype(np.float64) for _ in range(2))
    signal = 0.5 * (first.mean() + second.mean()) - SENSOR.black_level
    read = SENSOR.read_noise_e / SENSOR.electrons_per_dn
    # Poisson: variance in DN² is signal in DN over the gain; two frames hold twice the variance.
    gain = signal / ((first - second).var() / 2 - read**2)
    assert gain == pytest.approx(SENSOR.full_well_e / (2**SENSOR.bits - 1 - SENSOR.black_level), rel=0.03)
    expected = SENSOR.full_well_e * 0.6 / SENSOR.response_at_full_well
    assert signal * gain == pytest.approx(expected, rel=0.03)


def test_darkness_is_black_level_with_read_noise():
    rng = np.random.default_rng(5)
    frame = SENSOR.expose(np.zeros((400, 400)), 1e-6, rng).astype(np.float64)
    noise = SENSOR.read_noise_e / SENSOR.electrons_per_dn
    assert frame.mean() == pytest.approx(SENSOR.black_level, abs=5 * noise / 400)
    assert frame.std() == pytest.approx(np.sqrt(noise**2 + 1 / 12), rel=0.02)  # and 1/12 of quantisation


def test_dark_current_grows_with_time():
    rng = np.random.default_rng(6)
    frame = SENSOR.expose(np.zeros((300, 300)), 50.0, rng).astype(np.float64)
    electrons = (frame.mean() - SENSOR.black_level) * SENSOR.electrons_per_dn
    assert electrons == pytest.approx(SENSOR.dark_current_e_per_s * 50.0, rel=0.01)


@pytest.mark.parametrize("overload", [1.5, 1e3, 1e12])
def test_saturation_is_the_converters_top(overload):
    level = np.full((50, 50), SENSOR.response_at_full_well * overload)
    frame = SENSOR.expose(level, SENSOR.base_exposure_s, np.random.default_rng(7))
    assert frame.dtype == np.uint16 and (frame == 2**14 - 1).all()


def test_response_is_linear_in_light_and_in_time():
    rng = np.random.default_rng(8)
    levels = np.array([0.01, 0.03, 0.1, 0.3, 1.0, 1.4])
    light = [SENSOR.expose(np.full((300, 300), r), 0.02, rng).mean() - BLACK for r in levels]
    time = [SENSOR.expose(np.full((300, 300), 0.35), 0.02 * r, rng).mean() - BLACK for r in levels]
    scale = (2**14 - 1 - BLACK) / SENSOR.response_at_full_well
    # Standard error of a mean of 90000 pixels, in DN, from shot and read noise; four of them.
    error = 4 * np.sqrt(levels * scale / SENSOR.electrons_per_dn + 40) / 300
    assert (np.abs(light - levels * scale) <= error + 0.05).all()
    assert (np.abs(time - 0.35 * levels * scale) <= error + 0.05).all()


def test_the_same_seed_gives_the_same_frame():
    level = np.full((64, 64), 0.5)
    frames = [SENSOR.expose(level, 0.02, np.random.default_rng(seed)) for seed in (9, 9, 10)]
    assert np.array_equal(frames[0], frames[1]) and not np.array_equal(frames[0], frames[2])


def test_comb_transmits_its_peaks_and_half_of_them_at_the_edges():
    comb = comb_transmittance(made(CombFilter, CAMERA["virtual"]["comb_filter"]))
    floor = CAMERA["virtual"]["comb_filter"]["floor"]
    assert ((comb >= 0) & (comb <= 1)).all()
    for band in CAMERA["virtual"]["comb_filter"]["passbands"]:
        at = np.interp(band["centre_nm"], WAVELENGTH_NM, comb)
        assert at == pytest.approx(band["peak"] + floor, abs=0.01)
    edge = comb_transmittance(
        made(CombFilter, {"passbands": [{"centre_nm": 550, "width_nm": 40, "peak": 0.8}], "floor": 0.0})
    )
    assert edge[WAVELENGTH_NM == 530] == pytest.approx(0.4) and edge[WAVELENGTH_NM == 570] == pytest.approx(0.4)


@given(
    passbands=st.lists(
        st.fixed_dictionaries(
            {"centre_nm": st.floats(350, 750), "width_nm": st.floats(1, 300), "peak": st.floats(0, 1)}
        ),
        max_size=8,
    ),
    floor=st.floats(0, 1),
)
def test_no_comb_makes_light(passbands, floor):
    comb = comb_transmittance(made(CombFilter, {"passbands": passbands, "floor": floor}))
    assert comb.shape == (61,) and ((comb >= 0) & (comb <= 1)).all()


def test_band_weights_integrate_equation_one():
    light = spectrum("A")
    weights = band_weights(made(Camera, CAMERA), light)
    surface = spectrum("TCS20")
    sensitivities = camera_sensitivities(CAMERA["virtual"]["sensitivities"])
    comb = comb_transmittance(made(CombFilter, CAMERA["virtual"]["comb_filter"]))
    integrals = [
        np.trapezoid(light * surface * r * t, WAVELENGTH_NM) for t in (np.ones(61), comb) for r in sensitivities
    ]
    white = max(np.trapezoid(light * r, WAVELENGTH_NM) for r in sensitivities)
    assert np.allclose(weights @ surface, np.array(integrals) / white, rtol=1e-12)
    assert (weights[3:] <= weights[:3] + 1e-15).all()
