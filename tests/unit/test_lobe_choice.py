"""Lobes that photographs choose: those that made them, by what is predicted of photographs left out."""

import functools
from dataclasses import replace

import numpy as np
import pytest
from test_fitting import K, N
from test_fitting_two_lobes import ANGLES, COSINE, NOISE, responses, two_components
from test_measured_materials import needs_data
from test_paints import CREAM, OPTICS, PROVENANCE, SIDE, VERMILION, photographed, sphere, write_tile

from benchmarks import materials
from irodori.config.capture_table import Pose
from irodori.core import store
from irodori.fitting.diffuse_response import Observed
from irodori.fitting.lobe_choice import candidates, choose, left_out_errors
from irodori.fitting.lobe_stage import choose_lobes
from irodori.fitting.paint_stage import share_gloss
from irodori.fitting.solvers import FitOptions
from irodori.fitting.stage import fit_brdf
from irodori.fitting.texel_sample import Readings
from irodori.geometry.rig_frame import rig_from_object, to_camera, to_light
from irodori.material.fitted_tiles import FittedTiles
from irodori.material.lobe_choices import Candidate, LeftOut, chosen_model, read_choice
from irodori.material.material_file import Status
from irodori.reflection import registry
from irodori.reflection.coat import diffuse_cosine
from irodori.reflection.equation5 import angles_from_directions
from irodori.reflection.fresnel import fresnel_array
from irodori.reflection.lobe_arrays import evaluate
from irodori.report import html_page

TEXELS, POSES = 24, slice(0, 60, 2)
OPTIONS = FitOptions(model_error=0.005)
#: Those of the default spheres.
SIXTEEN = [
    *(Pose(60.0, 60.0, 0.0, turn, 150.0) for turn in (45.0, 135.0, 225.0, 315.0)),
    *(Pose(90.0, 90.0, 0.0, turn, 210.0) for turn in (0.0, 90.0, 180.0, 270.0)),
    *(Pose(90.0, 90.0, 0.0, turn, 150.0) for turn in (45.0, 135.0, 225.0, 315.0)),
    *(Pose(80.0, 30.0, 0.0, turn) for turn in (0.0, 90.0, 180.0, 270.0)),
]
#: The package's own: the lobe that other tests register may stand beside them in this process.
ALL = [one for one in candidates(OPTIONS) if "toy" not in one.lobes]


@pytest.fixture(autouse=True)
def _lobes_of_the_package_alone(monkeypatch):
    monkeypatch.delitem(registry._LOBES, "toy", raising=False)


def sample_of(clean, seed=2, drift=0.005) -> Readings:
    """Photographs of texels, each photograph's light off by a common factor."""
    rng, clean, noise = np.random.default_rng(seed), clean[:, POSES], NOISE[POSES]
    gain = 1.0 + drift * rng.normal(size=clean.shape[1])
    response = clean * gain + np.sqrt(noise[:, 0] + noise[:, 1] * clean) * rng.normal(size=clean.shape)
    angles = np.broadcast_to(ANGLES[POSES], (*clean.shape, 4))
    return Readings(
        response.astype(np.float32), np.ones(clean.shape, np.float32), angles.astype(np.float32), noise, N, K
    )


@pytest.mark.default_cases(5)
@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("lobes", [one.lobes for one in ALL], ids="+".join)
def test_the_lobes_that_made_the_photographs_are_chosen(lobes, seed):
    alpha, broad, narrow = two_components(TEXELS, seed)
    parts = [broad] if len(lobes) == 1 else [(2.0 * broad[0], broad[1]), (3.0 * narrow[0], narrow[1])]
    chosen, found = choose(sample_of(responses(lobes, alpha, *parts), seed), OPTIONS, ALL)
    assert chosen.lobes == lobes
    assert min(one.behind for one in found) == 0.0
    right = next(one for one in found if one.lobes == lobes)
    assert right.deviation < 1.6
    assert all(one.deviation > 0.9 * right.deviation for one in found)


def test_a_matt_object_takes_the_simplest():
    chosen, found = choose(sample_of(np.linspace(0.1, 0.8, TEXELS)[:, None] * COSINE), OPTIONS, ALL)
    assert chosen.lobes == ("gaussian",) and all(one.behind < 0.05 for one in found)


def test_one_bad_photograph_changes_no_choice():
    alpha, broad, _ = two_components(TEXELS, 4)
    for lobes in (("gaussian",), ("ggx",)):
        clean = responses(lobes, alpha, broad)
        clean[:, 14] *= 0.3
        assert choose(sample_of(clean), OPTIONS, ALL)[0].lobes == lobes


def test_a_prediction_knows_nothing_of_what_is_left_out_with_it():
    alpha, broad, _ = two_components(TEXELS, 5)
    plain = sample_of(responses(["gaussian"], alpha, broad))
    spoiled = plain.response.copy()
    spoiled[:, 3] *= 2.0
    before, after = (left_out_errors(one, OPTIONS) for one in (plain, replace(plain, response=spoiled)))
    # Of the same fold; the floor of the variance alone knows all readings.
    np.testing.assert_allclose(before[:, 11], after[:, 11], rtol=1e-4)
    assert (np.abs(before[:, 12] / after[:, 12] - 1) > 0.01).mean() > 0.9
    assert (after[:, 3] > before[:, 3]).all()


def test_readings_without_weight_are_not_judged():
    alpha, broad, _ = two_components(TEXELS, 6)
    plain = sample_of(responses(["gaussian"], alpha, broad))
    plain.weight[:, 7], plain.response[:, 7] = 0.0, np.nan
    errors = left_out_errors(plain, OPTIONS)
    assert np.isnan(errors[:, 7]).all() and np.isfinite(np.delete(errors, 7, axis=1)).all()
    assert choose(plain, OPTIONS, ALL)[0].lobes == ("gaussian",)


def test_nothing_seen_takes_the_simplest():
    nothing = Readings(np.zeros((0, 8)), np.zeros((0, 8)), np.zeros((0, 8, 4)), NOISE[:8], N, K)
    chosen, found = choose(nothing, OPTIONS, ALL[:2])
    assert chosen.lobes == ("gaussian",) and np.isnan([one.deviation for one in found]).all()


def test_a_lobe_that_registers_takes_part_alone_and_in_sums(monkeypatch):
    monkeypatch.setitem(registry._LOBES, "bent", replace(registry.lobe("ggx"), name="bent"))
    found = [one.lobes for one in candidates(OPTIONS)]
    assert found[:3] == [("gaussian",), ("bent",), ("ggx",)]
    assert set(found[3:]) == {
        ("gaussian", "gaussian"), ("gaussian", "bent"), ("gaussian", "ggx"), ("bent", "bent"), ("bent", "ggx"),
        ("ggx", "ggx"),
    }  # fmt: skip


def test_sums_are_not_tried_where_the_fit_cannot_have_them():
    assert [one.lobes for one in candidates(replace(OPTIONS, solver="nlopt"))] == [("gaussian",), ("ggx",)]


def ggx_sphere():
    """A sphere with GGX facets, as `test_paints.photographed` photographs one of equation (5)."""
    seen = photographed(np.tile((0.5, 0.3, 0.2), (SIDE * SIDE, 1)), 0.0, 0.15, sphere())
    wide = 3.0 * fresnel_array(np.cos(sphere()[..., 2]), N, K) * evaluate("ggx", 0.2, sphere())
    return replace(seen, response=seen.response + wide[..., None])


def test_the_choice_of_an_object_is_one_for_its_tiles_and_is_kept(tmp_path):
    seen, files = ggx_sphere(), {"observations": [], "tiles": []}
    for number, (first, last) in enumerate([(0, 12), (12, SIDE)]):
        files["observations"].append(tmp_path / f"seen-{number}.h5")
        write_tile(files["observations"][-1], seen[first * SIDE : last * SIDE], [first, last])
    choice = tmp_path / "lobes.h5"
    choose_lobes(files["observations"], choice, OPTICS.options, N, K, provenance=PROVENANCE)
    assert chosen_model(choice) == {"lobes": ("ggx",), "coat": "sum"}
    tried = [Candidate(one.lobes, one.coat) for one in read_choice(choice).candidates]
    # All single lobes, and of the sums those that a paint tells: two Gaussian lobes nearly are a GGX.
    assert tried == [one for one in candidates(OPTICS.options) if len(one.lobes) == 1 or one in tried]
    assert next(one for one in read_choice(choice).candidates if one.lobes == ("ggx",)).deviation < 1.5


#: Lobe, β and μ of a narrow highlight and a broad one, as under a coat of varnish.
PAIR = (("gaussian", 2.0, 0.1), ("ggx", 1.5, 0.4))


def angles_of(normal) -> np.ndarray:
    """Angles of texels with these normals under sixteen poses, (texels, 16, 4) rad."""
    normal = normal / np.linalg.norm(normal, axis=-1, keepdims=True)
    seen = []
    for pose in SIXTEEN:
        light, camera = (np.broadcast_to(to(pose), normal.shape) for to in (to_light, to_camera))
        seen.append(angles_from_directions(normal @ rig_from_object(pose).T, light, camera))
    return np.stack(seen, axis=1)


@functools.cache
def matt_object(seed, long) -> tuple[Observed, np.ndarray, np.ndarray]:
    """A matt `round_object`, the angles under which it is photographed, and the paint of each texel."""
    around, down = np.meshgrid((np.arange(64) + 0.5) / 32.0 * np.pi, (np.arange(SIDE) + 0.5) / SIDE * np.pi)
    normal = [np.sin(down) * np.cos(around), np.sin(down) * np.sin(around), np.cos(down)]
    normal = np.stack(normal, axis=-1).reshape(-1, 3)
    geometry, typed = angles_of(normal / [1.0, 1.0, long]), angles_of(normal)
    weight = (geometry[..., :2] < np.radians(80.0)).all(axis=-1).astype(float)
    paint = np.repeat(np.arange(SIDE) // 6 % 2, 64)
    with np.errstate(invalid="ignore"):
        seen = photographed(0.5 * np.array([VERMILION, CREAM])[paint], 0.0, 0.15, geometry, seed)
    return replace(seen, weight=weight.astype(np.float32), geometry=typed), geometry, paint


def round_object(lobe, beta, mu, seed, coat="sum", grain=0.0, *, long=1.0) -> Observed:
    """A sphere of two paints under sixteen poses, four of them opposite the lamp: texels see a peak once, if at all.

    What is photographed is ``long`` times as long from top to bottom, which the angles do not know.
    """
    seen, geometry, paint = matt_object(seed, long)
    beta, mu = (np.array(one)[paint, None] for one in (beta, mu))
    with np.errstate(invalid="ignore"):
        gloss = beta * evaluate(lobe, mu, geometry) * fresnel_array(np.cos(geometry[..., 2]), N, K)
    rng = np.random.default_rng(seed)
    drift, grains = 1.0 + 0.01 * rng.normal(size=(len(SIXTEEN), 1)), np.exp(grain * rng.normal(size=(len(paint), 1, 3)))
    with np.errstate(invalid="ignore"):
        under = diffuse_cosine(geometry, N, K, coat == "coupled") / diffuse_cosine(geometry, N, K, False)
    diffuse = seen.response * grains * under[..., None]
    lit = np.where(seen.weight[..., None] > 0.0, (diffuse + gloss[..., None]) * drift, 0.0)
    return replace(seen, response=lit.astype(np.float32))


@pytest.mark.default_cases(2)
@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize(
    ("beta", "mu"), [((1.0, 2.5), (0.25, 0.12)), ((2.0, 0.6), (0.15, 0.3)), ((4.0, 1.5), (0.1, 0.2))]
)
@pytest.mark.parametrize("lobe", ["gaussian", "ggx"])
@pytest.mark.parametrize("coat", ["sum", "coupled"])
def test_the_lobe_of_a_round_object_is_told_by_its_paints_though_a_texel_hardly_sees_it(
    tmp_path, coat, lobe, beta, mu, seed
):
    write_tile(tmp_path / "seen.h5", round_object(lobe, beta, mu, seed, coat), [0, SIDE])
    choice = tmp_path / "lobes.h5"
    choose_lobes([tmp_path / "seen.h5"], choice, FitOptions(), N, K, provenance=PROVENANCE, coat="auto")
    assert chosen_model(choice)["lobes"] == (lobe,)
    wrong = "ggx" if lobe == "gaussian" else "gaussian"
    others = [one for one in read_choice(choice).candidates if one.lobes == (wrong,)]
    assert len(others) == 2 and all(one.behind > 2.0 * one.behind_error for one in others)
    with store.open_file(choice) as file:
        assert file.attribute("painted", float) > 0.9


def test_without_paints_the_choice_says_on_what_it_rests(tmp_path, caplog):
    seen = round_object("gaussian", (1.0, 2.5), (0.25, 0.12), 1, grain=0.25)
    write_tile(tmp_path / "seen.h5", seen, [0, SIDE])
    choice = tmp_path / "lobes.h5"
    with caplog.at_level("WARNING"):
        choose_lobes([tmp_path / "seen.h5"], choice, FitOptions(), N, K, provenance=PROVENANCE)
    assert "few texels have the colour of a paint" in caplog.text
    with store.open_file(choice) as file:
        assert file.attribute("painted", float) < 0.5


def test_a_lamp_that_fails_between_photographs_is_told_by_what_no_form_of_gloss_predicts(tmp_path, caplog):
    level = np.where(np.arange(len(SIXTEEN)) < 8, 1.0, 0.6).astype(np.float32)
    for name, levels in (("steady", np.ones_like(level)), ("failing", level)):
        seen = round_object("gaussian", (1.0, 2.5), (0.25, 0.12), 1)
        write_tile(tmp_path / "seen.h5", replace(seen, response=seen.response * levels[:, None]), [0, SIDE])
        caplog.clear()
        with caplog.at_level("WARNING"):
            choose_lobes([tmp_path / "seen.h5"], tmp_path / name, FitOptions(), N, K, provenance=PROVENANCE)
        choice = read_choice(tmp_path / name)
        misfit = choice.misfit(**chosen_model(tmp_path / name))
        assert ("no form of gloss predicts left-out readings" in caplog.text) == (name == "failing")
        assert (misfit > 3.0) if name == "failing" else (misfit == 1.0)


def test_a_ball_that_is_out_of_round_is_told_by_what_no_form_of_gloss_predicts(tmp_path, caplog):
    write_tile(tmp_path / "seen.h5", round_object("gaussian", (4.0, 1.5), (0.2, 0.3), 1, long=1.12), [0, SIDE])
    with caplog.at_level("WARNING"):
        choose_lobes([tmp_path / "seen.h5"], tmp_path / "lobes.h5", FitOptions(), N, K, provenance=PROVENANCE)
    model = chosen_model(tmp_path / "lobes.h5")
    assert read_choice(tmp_path / "lobes.h5").misfit(**model) > 1.0 and "the surface has another shape" in caplog.text


@pytest.mark.parametrize(("beta", "mu"), [(2.0, 0.15), (6.0, 0.08)])
def test_three_photographs_of_a_sound_object_contradict_no_form_of_gloss(tmp_path, caplog, beta, mu):
    """Two of them do not tell what the third shows."""
    seen = photographed(np.tile(VERMILION, (SIDE * SIDE, 1)), beta, mu, sphere(3))
    write_tile(tmp_path / "seen.h5", seen, [0, SIDE])
    with caplog.at_level("WARNING"):
        choose_lobes([tmp_path / "seen.h5"], tmp_path / "lobes.h5", FitOptions(), N, K, provenance=PROVENANCE)
    assert "no form of gloss predicts" not in caplog.text
    model = chosen_model(tmp_path / "lobes.h5")
    assert read_choice(tmp_path / "lobes.h5").misfit(**model) == 1.0


def shared_and_own(seen: Observed, tmp_path, names) -> tuple[dict, dict]:
    """Maps of a tile under two lobes, with the gloss of its paints and from the texels' own fits."""
    options = replace(OPTICS.options, lobes=("gaussian", "ggx"))
    rows = len(seen.response) // SIDE
    write_tile(tmp_path / "seen.h5", seen, [0, rows])
    fit_brdf(tmp_path / "seen.h5", tmp_path / "own.h5", options, N, K, provenance=PROVENANCE)
    files = [tmp_path / "seen.h5"], [tmp_path / "own.h5"], tmp_path / "surface.h5"
    share_gloss(*files, options, N, K, provenance=PROVENANCE)
    return tuple(next(FittedTiles([path], rows, SIDE).read(*names))[1] for path in (files[2], files[1][0]))


def test_texels_of_a_surface_with_one_lobe_keep_their_own_gloss_under_two(tmp_path):
    names = ("alpha", "beta", "mu", "beta_2", "mu_2", "status", "paint")
    shared, own = shared_and_own(ggx_sphere(), tmp_path, names)
    for name in names:
        np.testing.assert_array_equal(own[name], shared[name])


def varnished(seed=1) -> Observed:
    """The round object with a narrow highlight of equation (5) over a broad one of GGX."""
    broad, narrow = (round_object(lobe, (beta, beta), (mu, mu), seed) for lobe, beta, mu in PAIR)
    bare = round_object("ggx", (0.0, 0.0), (0.1, 0.1), seed)
    return replace(broad, response=broad.response + narrow.response - bare.response)


def test_texels_under_two_lobes_have_the_gloss_of_their_paint(tmp_path):
    names = ("beta", "mu", "beta_2", "mu_2", "beta_error", "mu_2_error", "status", "paint")
    shared, own = shared_and_own(varnished(), tmp_path, names)
    lit = (varnished().weight > 0.0).any(axis=1).reshape(shared["paint"].shape)
    seen, told = shared["paint"] >= 0, np.isin(shared["status"], (Status.OK, Status.PAINT))
    # Of the second paint no photograph shows the narrow highlight.
    assert seen[lit].mean() > 0.35 and told[seen].all() and (own["status"] == Status.OK)[lit].mean() < 0.25
    for name, truth, within in zip(names, (2.0, 0.1, 1.5, 0.4), (0.06, 0.06, 0.05, 0.05), strict=False):
        assert np.median(np.abs(shared[name][seen] / truth - 1.0)) < within, name
    assert np.isfinite(shared["beta_error"][seen]).all() and np.isfinite(shared["mu_2_error"][seen]).all()
    with store.open_file(tmp_path / "surface.h5") as file:
        assert file.read("parameter").astype(str).tolist() == ["log_beta", "log_mu", "log_beta_2", "log_mu_2"]
        assert file.layout("paints/error").shape[1:] == (4, 4)


@pytest.mark.default_cases(1)
@pytest.mark.parametrize("seed", [1, 2])
def test_two_lobes_of_a_round_object_are_told_by_its_paints(tmp_path, seed):
    write_tile(tmp_path / "seen.h5", varnished(seed), [0, SIDE])
    choose_lobes([tmp_path / "seen.h5"], tmp_path / "lobes.h5", FitOptions(), N, K, provenance=PROVENANCE)
    found = read_choice(tmp_path / "lobes.h5").candidates
    assert chosen_model(tmp_path / "lobes.h5")["lobes"] == ("gaussian", "ggx")
    assert all(one.behind > 2.0 * one.behind_error for one in found if len(one.lobes) == 1)


@pytest.mark.parametrize("painted", [None, 0.25, 0.75])
@pytest.mark.parametrize("figures", [[], [LeftOut(("gaussian",), 2.5, 0.25, 0.125), LeftOut(("ggx",), 1.25, 0.0, 0.0)]])
def test_the_report_shows_a_choice_and_no_table_without_one(figures, painted):
    source = html_page._TEMPLATES.loader.get_source(html_page._TEMPLATES, "objects.html.j2")[0]
    template = html_page._TEMPLATES.from_string(source.replace('{% include "compression.html.j2" %}', ""))
    numbers = ("texels_fitted", "fit_seconds", "observed_fraction", "negative_fraction", "reflectance_error_median")
    errors = dict.fromkeys((*numbers, "delta_e_error_median"), 1.0)
    errors |= {"compression": {}, "lobe_choice": [{**vars(one), "lobes": list(one.lobes)} for one in figures]}
    errors |= {"lobe_choice_painted": painted, "lobe_choice_favours_tails": painted == 0.25}
    errors["lobe_choice_misfit"] = 7.2 if painted == 0.75 else 1.0
    errors["filter_level"] = {"ratio": 0.7, "error": 0.03, "paints": 9, "is_other": True} if painted else None
    shown = {"name": "jar", "errors": errors, "stored": "", "maps": "", "spectra": "", "bases": 3, "gloss": ""}
    shown["placement"] = "confirmed as typed: every camera angle" if figures else ""
    shown["mirror"], shown["angles"], errors["energy"] = 0.0, "0.09 deg by registration" if figures else "", {}
    page = template.render(objects=[shown | {"lobes": ["ggx"], "coat": "sum"}])
    assert ("of the compared texels" in page) == (bool(figures) and painted is not None)
    assert painted is None or (f"{painted:.0%} of the compared texels" in page) == bool(figures)
    assert ("long tails may be favoured" in page) == (bool(figures) and painted == 0.25)
    assert ("through the filter are 0.70 times as bright" in page) == bool(painted)
    assert ("are off by\n7.2 of their stated errors" in page) == (bool(figures) and painted == 0.75)
    assert ("Standard errors of the angles: 0.09 deg by registration." in page) == bool(figures)
    assert ("Standard errors of the angles" in page) == bool(figures)
    assert ("Registration: confirmed as typed: every camera angle." in page) == bool(figures)
    assert ("ggx (in use)" in page, "gaussian</td><td>2.50</td><td>0.250</td><td>0.125" in page) == (bool(figures),) * 2


@pytest.mark.default_cases(1)
@needs_data
@pytest.mark.parametrize("name", materials.CORNELL[1:])
def test_lobes_chosen_by_half_of_the_directions_predict_the_other_half_better_than_equation_5(name):
    rows = materials.choices(name)
    chosen = next(row for row in rows if row["chosen"])
    plain = next(row for row in rows if (row["lobes"], row["coat"]) == ("gaussian", "sum"))
    assert chosen["lobes"] != "gaussian"
    for figure in ("held_out_rms", "held_out_median"):
        assert chosen[figure] < 0.85 * plain[figure]
