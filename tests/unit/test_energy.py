"""Light that materials send back: against quadrature and furnaces, and refused where it is more than they get."""

import math
from dataclasses import replace

import numpy as np
import pytest
from made import made
from path_scenes import traced
from scenes import BALL, GOLD_K, GOLD_N, THIRDS, constant_light, fresnel, material

from irodori.config.models import Scene
from irodori.core import store
from irodori.core.errors import InputError
from irodori.material import energy
from irodori.material.energy import ALBEDO, CERTAIN, ERROR, RIM, AlbedoModel, Energy, Errors, Reflecting, energy_of
from irodori.material.material_file import Material
from irodori.reflection.albedo import gloss_albedo
from irodori.reflection.equation5 import angles_from_directions
from irodori.reflection.lobe_arrays import evaluate
from irodori.rendering.energy_gain import body_fault, load_materials

PROVENANCE = store.Provenance("test")
N, K = np.array(GOLD_N)[THIRDS], np.array(GOLD_K)[THIRDS]


def sent(name, mu, theta_r, n, k) -> float:
    """∫ F D G / cosθ_r dω_i / π over a fine grid of directions of light, F by complex arithmetic."""
    theta, azimuth = (np.arange(1200) + 0.5) * math.pi / 2400, (np.arange(240) + 0.5) * math.pi / 240
    sine, turn = np.sin(theta)[:, None], azimuth[None]
    light = np.stack(np.broadcast_arrays(sine * np.cos(turn), sine * np.sin(turn), np.cos(theta)[:, None]), axis=-1)
    view = np.array([math.sin(theta_r), 0.0, math.cos(theta_r)])
    angles = angles_from_directions(np.array([0.0, 0.0, 1.0]), light, view)
    values = evaluate(name, mu, angles) * fresnel(np.cos(angles[..., 2]), n, k)
    return 2.0 * float((values * sine).sum()) * (math.pi / 2400) * (math.pi / 240) / math.pi


@pytest.mark.parametrize("name", ["gaussian", "ggx"])
def test_the_albedo_of_gloss_is_its_integral_with_fresnel_reflectance(name):
    angles, n, k = (0.0, 0.9, 1.45), (1.5, 0.42), (0.0, 2.35)
    for mu in (0.1, 0.5):
        found = gloss_albedo(name, mu, np.cos(angles), n, k)[0]
        for i, theta_r in enumerate(angles):
            for j in range(2):
                assert found[i, j] == pytest.approx(sent(name, mu, theta_r, n[j], k[j]), rel=1e-3)


def judged(one: Material, errors=None) -> np.ndarray:
    count = one.alpha.size
    gloss = [np.stack([maps[i].ravel() for maps in one.gloss], axis=-1) for i in (1, 2)]
    coefficients = one.coefficients.reshape(count, -1) * one.spectrum_scale.reshape(-1, 1)
    return AlbedoModel(one.lobes, one.n, one.k, one.mirror).of(
        Reflecting(coefficients, one.basis, *gloss), errors or Errors.none(count, len(one.lobes))
    )


@pytest.mark.default_cases(1)
@pytest.mark.parametrize("of_gold", [False, True], ids=["lacquer", "gold"])
def test_the_albedo_is_the_largest_of_all_bands_and_angles(of_gold):
    """Between the table's roughnesses too, with two lobes; against the sum written out band by band."""
    index = {"n": N, "k": K} if of_gold else {}
    reflectance = np.linspace(0.5, 0.1, 61)
    lobes, pairs = ("gaussian", "ggx"), ((3.0, 0.217), (2.0, 0.431))
    one = Material.uniform(reflectance, *pairs[0], mirror=0.4, lobes=lobes, further_gloss=pairs[1:], **index)
    found = judged(one)[0]
    cosines = np.cos(np.radians(np.sort([*np.linspace(0.0, 89.47, 119), 60.0])))
    total = np.tile(reflectance, (120, 1))
    for name, (beta, mu) in zip(lobes, pairs, strict=True):
        total += (
            beta * gloss_albedo(name, mu, cosines, one.n[::20], one.k[::20])[0][:, np.minimum(np.arange(61) // 20, 3)]
        )
    total += 0.4 * np.array([fresnel(c, one.n, one.k) for c in cosines])
    even = np.trapezoid(2.0 * cosines[::-1, None] * total[::-1], cosines[::-1], axis=0)
    assert found[ALBEDO] == pytest.approx(max(total[cosines >= 0.5 - 1e-9].max(), even.max()), rel=3e-3)
    assert found[RIM] == pytest.approx(total.max(), rel=3e-3) and found[RIM] > found[ALBEDO]


@pytest.mark.stability(stage="render", case="gloss that sends back more light than it gets")
def test_a_ball_in_a_furnace_is_as_bright_as_its_albedo(tmp_path):
    """Seen from far off, a pixel shows one angle; paths know nothing of the table."""
    glossy = material(0.0, beta=50.0, mu=0.5)
    picture = traced([BALL], [glossy], constant_light(), 64, size=(61, 61), position=(0, -4000.0, 0), fov=0.58)
    radius = 20.0 / (4000.0 * math.tan(math.radians(0.29))) * 30.5
    off = np.hypot(*(np.indices((61, 61)) - 30.0)) / radius
    inside = off <= 0.97
    expected = 50.0 * gloss_albedo("gaussian", 0.5, np.sqrt(1.0 - off[inside] ** 2), 1.5, 0.0)[0, :, 0]
    seen, error = picture.radiance[inside, 30], picture.standard_error[inside, 30]
    assert seen.min() > 1.3  # brighter than all there is
    assert abs(seen.mean() - expected.mean()) <= 5 * error.mean() / math.sqrt(inside.sum()) + 2e-3 * expected.mean()
    # It grows towards the rim: at 60 degrees it is more than the mean.
    steep = off[inside] <= math.sin(math.radians(60.0))
    assert judged(glossy)[0, ALBEDO] == pytest.approx(expected[steep].max(), rel=0.02)
    with pytest.raises(InputError, match="allow_energy_gain"):
        load_materials(scene(), [BALL] * 2, [saved(glossy, tmp_path)] * 2)


def test_what_a_coat_reflects_at_the_rim_is_told_apart():
    """Half the diffuse light under a mirror of glass sends back less than all, but not at the rim."""
    found = energy_of(Material.uniform(0.5, mirror=1.0))
    assert found.albedo_max == pytest.approx(0.5 + 0.0918, abs=1e-3)  # 0.0918: of even light, glass of index 1.5
    assert not found.gains and found.gain_fraction == 0.0
    assert found.rim_fraction == 1.0 and 1.4 < found.rim_max <= 1.5 and found.rim_deg > 85.0


def test_an_error_as_large_as_the_gain_excuses_it():
    one = Material.uniform(0.9, beta=20.0, mu=0.3)
    found = judged(one)[0]
    gain = found[ALBEDO] - 1.0
    assert gain > 0.1 and found[ERROR] == 0.0
    for size, certain in ((0.9, True), (1.1, False)):
        error = np.full(4, size * gain / CERTAIN)
        assert (Energy.of(judged(one, Errors(error, np.zeros(4), np.zeros((4, 1))))).certain_fraction == 1.0) == certain
    several = judged(one, Errors(np.full(4, 0.03), np.full(4, 0.02), np.full((4, 1), 0.1)))
    gloss = found[ALBEDO] - 0.9
    assert several[0, ERROR] == pytest.approx(math.sqrt(0.03**2 + (0.02 * 0.9) ** 2 + (0.1 * gloss) ** 2), rel=1e-6)
    unknown = judged(one, Errors(*[np.full(shape, np.nan) for shape in ((4,), (4,), (4, 1))]))
    assert (unknown[:, ERROR] == 0.0).all()


def test_texels_that_are_not_known_count_for_nothing_and_gloss_that_is_not_is_the_typical():
    one = Material.uniform(0.9)
    few = replace(one, alpha=np.array([[1.0, np.nan], [1.0, 1.0]]), beta=np.array([[np.nan, 9e9], [0.0, 0.0]]),
                  typical_gloss=(20.0, 0.3))  # fmt: skip
    found = energy_of(few)
    assert found.texels == 3 and found.certain_fraction == pytest.approx(1 / 3)
    assert found.albedo_max == energy_of(Material.uniform(0.9, beta=20.0, mu=0.3)).albedo_max
    assert Energy.of(np.full((5, 4), np.nan)) == Energy()


def test_summaries_of_parts_are_that_of_the_whole():
    rng = np.random.default_rng(3)
    found = rng.uniform(0.5, 1.2, (1000, 4))
    found[:, ERROR] *= 0.05
    found[::7, ALBEDO] = np.nan
    whole, parts = Energy.of(found), Energy.of(found[:300]).joined(Energy.of(found[300:]))
    assert parts == Energy(**{name: pytest.approx(value) for name, value in vars(whole).items()})
    assert Energy().joined(Energy()) == Energy()


def test_a_texture_is_judged_in_pieces_as_in_one(monkeypatch):
    rng = np.random.default_rng(5)
    beta, mu = rng.uniform(0.0, 30.0, (40, 50)), rng.uniform(0.05, 0.5, (40, 50))
    one = Material.uniform(0.6)
    maps = {name: np.ones((40, 50)) for name in ("alpha", "green_response")}
    one = replace(one, **maps, beta=beta, mu=mu, coefficients=np.ones((40, 50, 1), np.float32))
    error = rng.uniform(0.0, 0.3, (40, 50))
    whole = energy_of(one, error)
    monkeypatch.setattr(energy, "_AT_ONCE", 350)
    pieces = energy_of(one, error)
    assert 0.1 < whole.certain_fraction < whole.gain_fraction < 0.9
    assert pieces == Energy(**{name: pytest.approx(value) for name, value in vars(whole).items()})


# --- scenes --------------------------------------------------------------------------------------------------------


def scene(**keys) -> Scene:
    objects = [{"object": "jar", "position_mm": [x, 0.0, 0.0]} for x in (0.0, 90.0)]
    return made(Scene, {"objects": objects, **keys})


def saved(one: Material, folder, error=None):
    path = folder / "material.h5"
    extra = {} if error is None else {"albedo_error": (np.full(one.alpha.shape, error), "1", "standard error")}
    replace(one, extra=extra).save(path, PROVENANCE)
    return path


def test_a_scene_refuses_a_material_that_makes_light_in_one_sentence(tmp_path, caplog):
    part = material(0.9)
    part.beta[0, :2], part.mu[0, :2] = 50.0, 0.5
    path = saved(part, tmp_path)
    with pytest.raises(InputError) as caught:
        load_materials(scene(), [BALL] * 2, [path, path])
    said = str(caught.value)
    for words in ("material.h5: albedo: found jar", "on 6.25 % of its texels", "allow_energy_gain: true in the scene"):
        assert words in said
    assert f"up to {judged(part)[:, ALBEDO].max():.3g} times" in said and "\n" not in said
    with caplog.at_level("WARNING", "irodori"):
        loaded = load_materials(scene(allow_energy_gain=True), [BALL] * 2, [path, path])
    assert len(loaded) == 2 and "allow_energy_gain is set" in caplog.text
    # An error in the file that is as large makes it possible that there is no gain.
    path = saved(part, tmp_path, error=2.0)
    assert len(load_materials(scene(), [BALL] * 2, [path, path])) == 2


def test_a_scene_refuses_a_body_that_makes_light():
    paint = {"spectrum": "TCS1", "beta": 50.0, "mu_rad": 0.5}
    shape = {"kind": "sphere", "radius_mm": 10.0}
    bodies = [{"shape": shape, "position_mm": [0, 0, 0], "material": paint | {"beta": beta}} for beta in (1.0, 50.0)]
    own = made(Scene, {"bodies": bodies})
    assert body_fault(0, own.bodies[0]) is None
    with pytest.raises(InputError, match=r"bodies\[1\]\.material: found a body that sends back up to 3\.\d+ times"):
        load_materials(own, [], [])
    load_materials(replace(own, allow_energy_gain=True), [], [])
