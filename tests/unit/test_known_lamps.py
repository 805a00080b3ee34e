"""Lamps that a user names or has measured: how much better they are than any published ones, and which are refused."""

import numpy as np
import pytest

from benchmarks.light import CIE, GIVEN, VARIANTS, WALLS, adapted_errors, camera, errors, given, recovered
from irodori.core.errors import InputError
from irodori.light.known_lamps import given_prior, known_prior, require_lamps_seen, told_by
from irodori.light.light_prior import prior_of_any_lamp
from irodori.light.light_recovery import Directions, LightRecovery, draw_directions
from irodori.spectra.grid import WAVELENGTH_NM
from irodori.spectra.published import spectrum

SURFACES = np.stack([spectrum(f"TCS{number}") for number in range(99)])


@pytest.fixture(scope="module")
def seen():
    return camera()


@pytest.fixture(scope="module")
def published():
    return prior_of_any_lamp()


def room(seen, *names: str, seed: int = 0) -> Directions:
    """A room that shows its lamps, and sixty surfaces under mixtures of them."""
    rng = np.random.default_rng(seed)
    lamps = np.stack([spectrum(name) / spectrum(name).mean() for name in names])
    walls = rng.dirichlet(np.ones(len(names)), 60) @ lamps * SURFACES[rng.integers(len(SURFACES), size=60)]
    response = np.concatenate([lamps, walls]) @ seen.sensitivity.T
    return Directions(response, response.sum(axis=1) / response.sum())


@pytest.mark.heavy
def test_a_named_lamp_is_recovered_better_than_an_unknown_one_and_a_measured_one_better_still(seen):
    """What is said of each lamp is off by some per cent; its own spectrum is in no prior."""
    unknown, named, measured = (errors(seen, variant)[:, 0] for variant in ("mixture", "named", "measured"))
    assert measured.mean() < 0.7 * named.mean() and named.mean() < 0.6 * unknown.mean()
    assert measured.max() < 0.5 and named.max() < 1.0


@pytest.mark.heavy
def test_off_coloured_walls_too(seen):
    some = CIE[::4]
    unknown, named, measured = (
        errors(seen, variant, WALLS[::2], some).mean() for variant in ("mixture", "named", "measured")
    )
    # What a wall adds is the same unknown for both: neither source tells of it.
    assert max(named, measured) < 0.8 * unknown


@pytest.mark.parametrize("variant", ["named", "measured"])
@pytest.mark.parametrize("names", [("FL11",), ("LED-B2",), ("D65", "LED-B3"), ("A", "HP4"), ("FL4", "D50")])
def test_the_lamps_of_a_room_are_accepted_though_they_are_not_quite_as_said(seen, published, names, variant):
    spectra = np.stack([given(variant, spectrum(name), seed) for seed, name in enumerate(names, start=40)])
    known = given_prior(spectra, GIVEN[variant][0])
    for seed in range(3):
        require_lamps_seen(names, room(seen, *names, seed=seed), seen.model, known, published, "p.h5")


@pytest.mark.parametrize(
    ("names", "lit_by"),
    [(("A",), ("D65",)), (("D65",), ("FL11",)), (("FL11", "D65"), ("HP1",)), (("A",), ("A", "HP4"))],
)
def test_lamps_that_do_not_light_the_room_or_leave_one_out_are_refused(seen, published, names, lit_by):
    with pytest.raises(InputError, match=f"found {', '.join(names)} for a panorama that other lamps") as caught:
        require_lamps_seen(names, room(seen, *lit_by), seen.model, known_prior(names), published, "p.h5")
    assert (caught.value.file, caught.value.field) == ("p.h5", "lamps")


def test_a_black_room_is_lit_by_any_lamps(seen, published):
    black = draw_directions([(np.zeros((9, 6)), 1.0)])
    require_lamps_seen(["FL11"], black, seen.model, known_prior(["FL11"]), published, "p.h5")


def written(path, power) -> str:
    """Write a spectrum as a CSV or, by its suffix, as CGATS; return its path."""
    if path.suffix == ".csv":
        lines = ["wavelength_nm,power", *(f"{at:g},{one:.9g}" for at, one in zip(WAVELENGTH_NM, power, strict=True))]
    else:
        fields = " ".join(f"SPEC_{at:.0f}" for at in WAVELENGTH_NM)
        values = " ".join(f"{one:.9g}" for one in power)
        lines = ["CTI3", f"NUMBER_OF_FIELDS {len(power) + 1}", "BEGIN_DATA_FORMAT", f"SAMPLE_ID {fields}",
                 "END_DATA_FORMAT", "NUMBER_OF_SETS 1", "BEGIN_DATA", f"lamp {values}", "END_DATA"]  # fmt: skip
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return str(path)


@pytest.mark.parametrize("suffix", [".csv", ".ti3"])
def test_a_measured_spectrum_is_the_lamp_in_any_unit_and_is_trusted_more_than_a_name(tmp_path, suffix):
    found = known_prior([written(tmp_path / f"lamp{suffix}", 1e-3 * spectrum("FL11"))])
    exact, named = given_prior(spectrum("FL11")[None], 0.02), known_prior(["FL11"])
    np.testing.assert_allclose(found.moment, exact.moment, rtol=1e-6)
    assert (np.diagonal(found.moment[0]) < np.diagonal(named.moment[0])).all()
    # What the definition says of its error counts, however the spectrum is given.
    for lamp in (named_file := written(tmp_path / f"lamp{suffix}", spectrum("FL11"))), "FL11":
        stated = known_prior([lamp], 2.0)
        np.testing.assert_allclose(stated.moment, exact.moment, rtol=1e-6)
    assert (np.diagonal(known_prior([named_file], 9.0).moment[0]) > np.diagonal(named.moment[0])).all()


def test_what_told_of_the_lamps_is_said_in_words():
    assert told_by(["FL11", "lamp.csv", "D65"]) == "named lamps (FL11, D65) and measured spectra (lamp.csv)"
    assert told_by(["lamp.TI3"]) == "measured spectra (lamp.TI3)"
    with pytest.raises(InputError, match="FL99"):
        known_prior(["FL99"])


def stated_error(recovery: LightRecovery, response: np.ndarray) -> float:
    """Return the mean CIEDE2000 of a ColorChecker that a recovery states of itself, by drawn lights."""
    weights, rng = recovery.weights(response), np.random.default_rng(1)
    drawn = np.tensordot(rng.standard_normal((16, len(recovery.errors))), recovery.errors, axes=1)
    own = recovery.basis @ weights
    return np.mean([adapted_errors(own, own + error @ weights) for error in drawn])


@pytest.mark.default_cases(1)
@pytest.mark.parametrize(
    "nm",
    [
        pytest.param(590, marks=pytest.mark.stability(stage="light", case="low-pressure sodium")),
        pytest.param(530, marks=pytest.mark.stability(stage="light", case="laser")),
        pytest.param(640, marks=pytest.mark.stability(stage="light", case="laser")),
    ],
)
def test_a_single_line_is_recovered_where_it_is_known_and_otherwise_known_to_be_unsure(seen, published, nm):
    """The statement of a light that no lamp resembles, in the mean over three draws of the calibration's noise."""
    line = np.where(nm == WAVELENGTH_NM, 61.0, 1e-6)
    for variant in ("named", "measured"):
        known = VARIANTS[variant](given(variant, line)[None])
        assert adapted_errors(line, recovered(seen, line, known)) <= 1.5
    sums = np.zeros(2)
    for own in (seen, camera(1), camera(2)):
        response = own.sensitivity @ line
        blind = LightRecovery.of_room(own.model, Directions(response[None], np.ones(1)), published)
        found = blind.basis @ blind.weights(response)
        assert np.isfinite(found).all()
        sums += stated_error(blind, response), adapted_errors(line, found)
    assert sums[0] >= 0.5 * sums[1]
