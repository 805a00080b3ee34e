"""Level of photographs through the filter, told by the colours of an object alone."""

import numpy as np
import pytest
from made_up_camera import patches, system
from scenes import DATA

from irodori.material.filter_level import filter_level, level_of_object
from irodori.spectra.published import read_spectra

CHART = patches() @ system().T
NEEDS = pytest.mark.skipif(not (DATA / "reflectance").is_dir(), reason="needs ../shared/data")


@NEEDS
@pytest.mark.parametrize("name", ["munsell_matt_1269", "vrhel_170", "colorchecker_digital_sg_140", "esser_chart"])
@pytest.mark.parametrize("paints", [1, 5, 16])
def test_colours_of_no_other_set_are_taken_for_another_level(name, paints):
    """Of objects with random paints of measured sets: at most 3 % are doubted without a cause."""
    spectra, rng = read_spectra(DATA / f"reflectance/{name}.csv")[1], np.random.default_rng(1)
    objects = [spectra[rng.choice(len(spectra), paints, replace=False)] @ system().T for _ in range(400)]
    assert np.mean([filter_level(CHART, colours).is_other for colours in objects]) <= 0.03


@NEEDS
@pytest.mark.parametrize(("level", "paints"), [(0.6, 5), (0.75, 16), (1.35, 16)])
def test_another_level_of_an_object_with_several_paints_is_found(level, paints):
    spectra, rng = read_spectra(DATA / "reflectance/vrhel_170.csv")[1], np.random.default_rng(2)
    colours = [spectra[rng.choice(len(spectra), paints, replace=False)] @ system().T for _ in range(200)]
    found = [filter_level(CHART, one * np.repeat([1.0, level], 3)) for one in colours]
    assert np.mean([one.is_other for one in found]) >= 0.95
    assert np.median([one.ratio for one in found]) == pytest.approx(level, rel=0.05)


def test_tiles_of_an_object_are_one_and_what_is_not_known_has_no_part():
    paint = np.repeat(np.arange(-1, 5), 4).reshape(4, 6)
    response = CHART[paint + 6].astype(np.float32)
    response[1, 2] = np.nan
    tiles = [(slice(0, 2), {"diffuse_response": response[:2], "paint": paint[:2]}),
             (slice(2, 4), {"diffuse_response": response[2:], "paint": paint[2:]})]  # fmt: skip
    found = level_of_object(("out", "in"), CHART, tiles)
    assert found.paints == 6 and found.ratio == pytest.approx(filter_level(CHART, CHART[5:11]).ratio, rel=1e-6)
    assert (
        level_of_object(("out",), CHART[:, :3], tiles) is None and level_of_object(("out", "in"), None, tiles) is None
    )
    nothing = [(slice(0, 2), {"diffuse_response": np.full((2, 6, 6), np.nan), "paint": paint[:2]})]
    assert not level_of_object(("out", "in"), CHART, nothing).is_other
