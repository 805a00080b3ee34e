"""Every photograph predicted from the others: what is compared, with which lamp, and how the error is counted."""

from typing import NamedTuple

import numpy as np
import pytest

from irodori.evaluation.left_out_photographs import fit_known_shape, predict_left_out
from irodori.fitting.one_gloss import MATT
from irodori.rectification.lamp_registration import Lamps

LAMPS = np.array([[0.0, 0.0, 1.0], [0.6, 0.0, 0.8], [-0.6, 0.0, 0.8], [0.0, 0.6, 0.8], [0.0, -0.6, 0.8]])
LEVELS = np.array([1.0, 1.2, 0.9, 1.1, 0.8])
PLACES = 40


def normals() -> np.ndarray:
    """Normals of a cap on which all lamps shine."""
    across = np.random.default_rng(2).uniform(-0.2, 0.2, (PLACES, 2))
    return np.column_stack([across, np.sqrt(1.0 - (across**2).sum(axis=1))])


WHITE = np.random.default_rng(3).uniform(0.1, 0.8, PLACES)


def photographed(directions=LAMPS, levels=LEVELS) -> np.ndarray:
    """Responses of a matt cap by Lambert's law, (places, photographs)."""
    return WHITE[:, None] * (normals() @ directions.T) * levels


def of_cap(response, weight, known=LAMPS, lamps=LAMPS, levels=LEVELS):
    found = Lamps(lamps, levels, np.zeros(len(levels)))
    view = np.broadcast_to([0.0, 0.0, 1.0], (PLACES, 3))

    def fit(kept):
        return fit_known_shape(response, kept, found, normals(), view, lobe=MATT, n=1.5, k=0.0)

    return predict_left_out(response, weight, found, known, fit)


def test_a_matt_surface_is_predicted_as_lamberts_law_says():
    response = photographed()
    found = of_cap(response, np.ones(response.shape))
    np.testing.assert_allclose(found.rendered, response, rtol=1e-9)
    assert found.compared.all() and (found.error < 1e-9).all() and (found.by_file < 1e-9).all()
    assert (found.shadow == 0.0).all()


def test_a_places_weight_rests_on_three_other_photographs():
    response, weight = photographed(), np.ones((PLACES, len(LAMPS)))
    weight[0, 3:] = 0.0  # three photographs show it: two remain without one of them
    weight[1, 4:] = 0.0  # four
    weight[2, 1:] = 0.0
    found = of_cap(response, weight)
    told = np.isfinite(found.rendered)
    assert told[0].tolist() == [False, False, False, True, True]
    assert told[1].all() and not told[2, 0] and told[3:].all()
    # What no weight is given to is predicted, where the others tell it, but not compared.
    assert found.compared[0].tolist() == [False] * 5 and found.compared[1].tolist() == [True] * 4 + [False]
    np.testing.assert_allclose(found.rendered[1], response[1], rtol=1e-9)


def test_the_error_is_the_departure_beside_the_photographs_mean():
    response = photographed()
    response[:10, 2] *= 1.5
    found = of_cap(response, np.ones(response.shape))
    true = photographed()[:, 2]
    expected = np.sqrt(np.mean((response[:, 2] - true) ** 2)) / response[:, 2].mean()
    assert found.error[2] == pytest.approx(expected, rel=1e-9)
    # The other photographs are predicted from one that is wrong in ten places.
    np.testing.assert_allclose(found.rendered[10:], photographed()[10:], rtol=1e-9)
    assert (found.error[[0, 1, 3, 4]] > 0.01).all()


def test_the_level_beside_the_file_comes_from_the_photograph_itself():
    response = photographed()
    dim = LEVELS * [1.0, 1.0, 1.0, 1.0, 2.0]
    found = of_cap(response, np.ones(response.shape), levels=dim)
    # Half as bright as its lamp is said to be: the error with this lamp is the brightness itself, without it the rest.
    assert found.error[4] > 0.5 and found.by_file[4] < found.error[4] / 5.0
    swapped = LAMPS[[0, 1, 2, 4, 3]]
    found = of_cap(response, np.ones(response.shape), known=swapped)
    assert (found.error < 1e-9).all() and (found.by_file[3:] > 0.05).all() and (found.by_file[:3] < 1e-9).all()
    shown = photographed(swapped)[:, 3]
    level = np.linalg.lstsq(shown[:, None], response[:, 3], rcond=None)[0][0]
    left = np.sqrt(np.mean((level * shown - response[:, 3]) ** 2)) / response[:, 3].mean()
    assert found.by_file[3] == pytest.approx(left, rel=1e-6)


class Ledge(NamedTuple):
    """A flat surface of which the first places lie in a shadow and the last beyond the terminator."""

    response: np.ndarray

    def rendered(self, direction) -> np.ndarray:
        return np.full(len(self.response), direction[2])

    def lit(self, direction) -> np.ndarray:
        return np.arange(len(self.response)) < 16

    def in_shadow(self, response, shown) -> np.ndarray:
        return response < 0.5 * shown


def test_places_in_a_shadow_or_beyond_the_terminator_are_counted_or_left_out():
    directions, level = LAMPS[:2], np.ones(2)
    response = np.repeat(directions[:, 2][None], 20, axis=0)
    response[:4, 0] = 0.0
    response[16:] = 7.0
    weight = np.ones(response.shape)
    weight[3, 0] = 0.0
    found = predict_left_out(response, weight, Lamps(directions, level, level), directions, lambda _: Ledge(response))
    # Of 16 places that face the lamp one has no weight, and three are dark.
    assert found.shadow.tolist() == [3 / 15, 0.0]
    assert found.compared[:, 0].tolist() == [False] * 4 + [True] * 12 + [False] * 4
    assert found.compared[:, 1].tolist() == [True] * 16 + [False] * 4
    assert (found.error == 0.0).all()


def test_each_photograph_is_predicted_without_itself():
    response, seen = photographed(), []
    found = Lamps(LAMPS, LEVELS, np.zeros(len(LEVELS)))

    def fit(kept):
        seen.append(kept)
        return Ledge(response)

    weight = np.full(response.shape, 0.5)
    predict_left_out(response, weight, found, LAMPS, fit)
    assert len(seen) == len(LAMPS) and (weight == 0.5).all()
    for number, kept in enumerate(seen):
        assert (kept[:, number] == 0.0).all()
        assert (np.delete(kept, number, axis=1) == 0.5).all()
