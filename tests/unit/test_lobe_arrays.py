"""Lobes as callers in Python meet them: by name, over arrays, as tables of albedo, as one term of equation (5)."""

import importlib.util
import math
from pathlib import Path

import numpy as np
import pytest
from equation5_written_out import gloss_factors
from lobe_albedos import lobe_albedo

from irodori.reflection import ggx, lobes
from irodori.reflection.albedo import gloss_albedo
from irodori.reflection.equation5 import angles_from_directions, reflect
from irodori.reflection.lobe import Lobe
from irodori.reflection.lobe_arrays import evaluate, evaluate_with_derivatives
from irodori.reflection.lobes import Lobes
from irodori.reflection.registry import lobe, names

every_lobe = pytest.mark.parametrize("name", names())


def directions(shape: tuple[int, ...], seed: int, lowest: float = -1.0) -> np.ndarray:
    """Return unit vectors at random, (*shape, 3), their third component from ``lowest`` to 1."""
    rng = np.random.default_rng(seed)
    cosine, turn = rng.uniform(lowest, 1.0, shape), rng.uniform(0.0, 2.0 * math.pi, shape)
    sine = np.sqrt(1.0 - cosine**2)
    return np.stack([sine * np.cos(turn), sine * np.sin(turn), cosine], axis=-1)


# --- angles and the term -------------------------------------------------------------------------------------------


def test_angles_of_arrays_are_those_between_their_directions():
    normal, light, view = directions((4, 1), 1), directions((5,), 2), directions((4, 5), 3)
    found = angles_from_directions(normal, light, view)
    assert found.shape == (4, 5, 4)
    half = light + view
    half /= np.linalg.norm(half, axis=-1, keepdims=True)
    pairs = ((normal, light), (normal, view), (half, light), (normal, half))
    expected = np.stack([np.broadcast_to(np.sum(a * b, axis=-1), (4, 5)) for a, b in pairs], axis=-1)
    assert np.cos(found) == pytest.approx(expected, abs=1e-12)
    assert ((found >= 0.0) & (found <= math.pi)).all()


def test_between_opposite_directions_the_normal_stands_for_the_half_vector():
    light = directions((6,), 4)
    found = angles_from_directions(np.array([0.0, 0.0, 1.0]), light, -light)
    assert (found[:, 3] == 0.0).all() and found[:, 2] == pytest.approx(found[:, 0], abs=1e-12)


def test_reflection_is_equation_5_written_out():
    light, view = directions((30,), 5), directions((20, 30), 6)
    geometry = angles_from_directions(np.array([0.0, 0.0, 1.0]), light, view)
    alpha, beta, mu = np.random.default_rng(7).uniform([[0.1], [0.5], [0.1]], [[1.0], [5.0], [1.2]], (3, 30))
    found = reflect(alpha, 0.6, beta, mu, geometry, n=0.4, k=3.0)
    gloss = beta * gloss_factors(geometry, 0.4, 3.0) * np.exp(-((geometry[..., 3] / mu) ** 2))
    lit = (light[:, 2] > 0.0) & (view[..., 2] > 0.0)
    assert found.shape == (20, 30) and 0.1 < lit.mean() < 0.5
    assert found == pytest.approx(np.where(lit, alpha * 0.6 * light[:, 2] + gloss, 0.0), rel=1e-11, abs=1e-12)


def test_another_lobe_than_the_papers_reflects_as_its_arrays_say():
    geometry = angles_from_directions(np.array([0.0, 0.0, 1.0]), directions((9,), 8, 0.1), directions((9,), 9, 0.1))
    found = reflect(0.0, 1.0, 2.0, 0.3, geometry, n=1e6, lobe="ggx")
    assert found == pytest.approx(2.0 * evaluate("ggx", 0.3, geometry), rel=1e-4)


@every_lobe
def test_arrays_are_broadcast(name):
    mu = np.array([[0.1], [0.4]])
    seen = angles_from_directions(np.array([0.0, 0.0, 1.0]), directions((5, 1, 3), 1, 0.1), directions((3,), 2, 0.1))
    found = evaluate_with_derivatives(name, mu, seen)
    assert found.shape == (3, 5, 2, 3) and (found != 0.0).all()
    for place in np.ndindex(5, 2, 3):
        i, j, k = place
        alone = evaluate_with_derivatives(name, mu[j, 0], seen[i, 0, k])
        assert np.array_equal(found[(slice(None), *place)], alone)
    assert np.array_equal(evaluate(name, mu, seen), found[0])


# --- albedo --------------------------------------------------------------------------------------------------------


@every_lobe
def test_the_albedo_is_what_even_light_leaves(name):
    mu, cosine = np.array([0.3, 0.6]), np.array([1.0, 0.6])
    theta, azimuth = (np.arange(500) + 0.5) * math.pi / 1000, (np.arange(150) + 0.5) * math.pi / 150
    sine, turn = np.sin(theta)[:, None], azimuth[None]
    light = np.stack(np.broadcast_arrays(sine * np.cos(turn), sine * np.sin(turn), np.cos(theta)[:, None]), axis=-1)
    found = lobe_albedo(name, mu, cosine)
    for i, one in enumerate(mu):
        for j, c in enumerate(cosine):
            view = np.array([math.sqrt(1.0 - c * c), 0.0, c])
            value = evaluate(name, one, angles_from_directions(np.array([0.0, 0.0, 1.0]), light, view))
            total = 2.0 * (value * sine).sum() * (math.pi / 1000) * (math.pi / 150) / math.pi
            assert found[i, j] == pytest.approx(total, rel=2e-3)


# --- names ---------------------------------------------------------------------------------------------------------


def test_a_lobe_that_is_not_there_is_refused_with_those_that_are():
    for ask in (lobe, Lobes.of, lambda name: evaluate(name, 0.1, np.zeros(4))):
        with pytest.raises(ValueError, match=r"no lobe 'phong'; lobes: gaussian, ggx"):
            ask("phong")


def test_lobes_are_named_once_each_in_the_order_given():
    assert Lobes.of("ggx").names == ("ggx",)
    assert Lobes.of(["ggx", "gaussian", "ggx"]).names == ("ggx", "gaussian")


def test_a_module_without_a_kernel_is_no_lobe():
    with pytest.raises(ValueError, match="lobes has no NAME"):
        Lobe.of_module(lobes)


def test_a_module_is_the_lobe_that_it_defines_and_its_digest_that_of_its_code(tmp_path):
    found = Lobe.of_module(ggx)
    assert found == lobe("ggx") and found.digest == lobe("ggx").digest
    assert (found.name, found.draw, found.roughness) == ("ggx", ggx.draw, ggx.ROUGHNESS)
    digests = []
    for number, added in enumerate(("# a comment\n", "CHANGED = 1\n")):
        path = tmp_path / f"other{number}.py"
        path.write_text(Path(ggx.__file__).read_text("utf-8") + added, "utf-8")
        spec = importlib.util.spec_from_file_location(path.stem, path)
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        digests.append(Lobe.of_module(module).digest)
    assert digests[0] == found.digest != digests[1]


def test_albedos_that_are_kept_are_those_of_each_index_and_cannot_be_changed():
    one, other = (gloss_albedo("gaussian", [0.1, 0.3], 0.5, n, 0.0) for n in (1.5, 2.0))
    both = gloss_albedo("gaussian", [0.1, 0.3], 0.5, [1.5, 2.0], [0.0, 0.0])
    assert both.shape == (2, 1, 2) and (other > one).all()
    np.testing.assert_array_equal(both, np.concatenate([one, other], axis=2))
    with pytest.raises(ValueError, match="read-only"):
        one[0] = 1.0
