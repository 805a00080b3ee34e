"""Angles that are computed as observations are read, against those of equation (5), which calls atan2."""

import numpy as np
import pytest

from irodori.core import store
from irodori.core.errors import InputError
from irodori.material.observed_angles import Surroundings, angles_of, read_angles, read_texels, write_surroundings
from irodori.reflection.equation5 import angles_from_directions

MADE = store.Provenance("rectify_object")


def unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def surroundings(is_near: bool) -> Surroundings:
    """A ball of 40 texels, the last of which is none, before 7 photographs; in the last two, special directions."""
    rng = np.random.default_rng(48)
    normal = unit(rng.normal(size=(40, 3)))
    position, light, camera = 30.0 * normal, unit(rng.normal(size=(7, 3))), 600.0 * unit(rng.normal(size=(7, 3)))
    light *= 700.0 if is_near else 1.0
    # Of texel 0: light and camera along the normal, and opposite to each other.
    light[5], camera[5] = (position[0] + 500.0 * normal[0]) if is_near else normal[0], position[0] + 500.0 * normal[0]
    light[6], camera[6] = (position[0] - 500.0 * normal[0]) if is_near else -normal[0], position[0] + 500.0 * normal[0]
    position[-1] = normal[-1] = 0.0
    return Surroundings(position, normal, light, camera, is_near)


@pytest.mark.parametrize("is_near", [False, True], ids=["far", "near"])
def test_the_angles_are_those_of_the_reflection_model_also_at_special_directions(is_near):
    around = surroundings(is_near)
    found = angles_of(around)
    to_light = unit(around.light - is_near * around.position[:, None])
    to_camera = unit(around.camera - around.position[:, None])
    expected = angles_from_directions(around.normal[:, None], to_light, to_camera)
    ordinary = np.ones(found.shape[:2], dtype=bool)
    ordinary[0, 5:], ordinary[-1] = False, False
    # Half a unit of single precision is 6e-8.
    np.testing.assert_allclose(found[ordinary], expected[ordinary], rtol=2e-7, atol=1e-12)
    assert not found[-1].any()
    np.testing.assert_allclose(found[0, 5], 0.0, atol=1e-6)
    # Between opposite directions, the normal stands for the half vector.
    np.testing.assert_allclose(found[0, 6, :2], [np.pi, 0.0], atol=1e-6)


def test_a_tile_gives_the_angles_of_all_texels_or_of_some(tmp_path):
    around = surroundings(True)
    with store.create(tmp_path / "tile.h5", MADE) as out:
        write_surroundings(out, around)
    with store.open_file(tmp_path / "tile.h5") as file:
        assert np.array_equal(read_angles(file), angles_of(around))
        assert np.array_equal(read_angles(file, np.array([3, 17])), angles_of(around)[[3, 17]])


def test_a_tile_without_what_determines_the_angles_is_refused(tmp_path):
    with store.create(tmp_path / "tile.h5", MADE) as out:
        out.write("normal", np.zeros((5, 3)), units="1", dims="texel_number,component", quantity="normal")
    with store.open_file(tmp_path / "tile.h5") as file, pytest.raises(InputError, match="position"):
        read_angles(file)


@pytest.mark.parametrize("chosen", [[], [7], [0, 1, 4097, 8194, 8195, 29_999], list(range(0, 30_000, 5000))])
def test_texels_far_apart_are_read_as_if_all_between_them_were_read(tmp_path, chosen):
    values = np.random.default_rng(3).random((30_000, 3)).astype(np.float16)
    with store.create(tmp_path / "tile.h5", MADE) as out:
        out.write("response", values, units="1", dims="texel_number,band", quantity="numbers", compression="fast")
    with store.open_file(tmp_path / "tile.h5") as file:
        found = read_texels(file, "response", np.array(chosen, dtype=np.int64))
    assert found.dtype == values.dtype and np.array_equal(found, values[chosen])
