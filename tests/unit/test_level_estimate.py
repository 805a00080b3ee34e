"""Levels of the lamp with the materials: drift is found where photographs tell it, and no surface is taken for it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from irodori.core import store
from irodori.core.errors import InputError
from irodori.fitting.level_estimate import estimate_levels, turned
from irodori.fitting.level_stage import measure_levels
from irodori.fitting.solvers import FitOptions
from irodori.fitting.stage import fit_brdf, read_observations
from irodori.fitting.texel_sample import Readings
from irodori.material.material_file import Status
from irodori.material.photograph_levels import NOTHING, TEXELS, PhotographLevels, read_levels
from irodori.reflection.equation5 import angles_from_directions, reflect
from irodori.simulation.virtual_rig.sample_reflection import read_measured

N, K, CAMERA, PROVENANCE = 1.5, 0.0, (1e-6, 2e-5), store.Provenance("test")
MEASURED = Path(__file__).resolve().parents[3] / "shared/data/brdf"
TURNS = (0.0, 90.0, 180.0, 270.0)
SITTING = [(light, camera, turn) for light, camera in ((35, 0), (45, 25), (60, 10), (80, 30)) for turn in TURNS]
FLAT = [(45, camera, 0.0) for camera in (0, 20, 35, 41, 45, 49, 55, 65)] + [(65, c, 0.0) for c in (30, 55, 62, 66, 72)]


def direction(angle_deg, side):
    angle = np.radians(angle_deg)
    return np.array([side * np.sin(angle), 0.0, np.cos(angle)])


def sphere(texels=1000, seed=0) -> np.ndarray:
    """Normals of the upper half of a sphere, (texels, 3)."""
    normal = np.random.default_rng(seed).normal(size=(texels, 3))
    normal[:, 2] = np.abs(normal[:, 2])
    return normal / np.linalg.norm(normal, axis=1)[:, None]


def seen(normal, poses, off_deg=None) -> np.ndarray:
    """Angles of texels on a table that turns, (texels, J, 4) rad; every light and camera angle may be off."""
    off_deg = np.zeros((len(poses), 2)) if off_deg is None else off_deg
    found = []
    for (light, camera, turn), (a, b) in zip(poses, off_deg, strict=True):
        c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
        here = normal @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]).T
        found.append(angles_from_directions(here, direction(light + a, 1.0), direction(camera + b, -1.0)))
    return np.stack(found, axis=1)


def paper(geometry, albedo):
    return reflect(0.35 * albedo, 1.0, 2.0, 0.15, geometry)


def ggx(geometry, albedo):
    return reflect(0.35 * albedo, 1.0, 2.0, 0.15, geometry, lobe="ggx")


def dusty(geometry, albedo):
    """Diffuse light that grows towards grazing angles as Disney's does at a roughness of 1, and the paper's lobe."""
    factor = 1.0
    for angle in (geometry[..., 0], geometry[..., 1]):
        factor = factor * (1.0 + (2.0 * np.cos(geometry[..., 2]) ** 2 - 0.5) * (1.0 - np.cos(angle)) ** 5)
    return 0.35 * albedo * np.cos(geometry[..., 0]) * factor + reflect(0.0, 1.0, 2.0, 0.15, geometry)


def measured(name):
    """A surface of measured reflection in the band in which it is brightest."""
    file = MEASURED / f"cornell_{name}.csv"
    if not file.is_file():
        pytest.skip("the measured BRDFs of ../shared/data are not here")
    table = read_measured(file)
    table = table[..., int(np.median(table[20:40], axis=(0, 1)).argmax())]

    def surface(geometry, albedo):
        half = np.sqrt(geometry[..., 3] / (0.5 * np.pi)) * (table.shape[0] - 1)
        difference = geometry[..., 2] / (0.5 * np.pi) * (table.shape[1] - 1)
        i, j = (np.minimum(v.astype(int), n - 2) for v, n in zip((half, difference), table.shape, strict=True))
        a, b = half - i, difference - j
        low, high = ((1 - b) * table[i + s, j] + b * table[i + s, j + 1] for s in (0, 1))
        return albedo * ((1 - a) * low + a * high) * np.cos(geometry[..., 0])

    return surface


def photographed(surface, normal, poses, seed, drift=0.008):
    """Readings of a surface of three paints, and the lamp's true levels; poses are off by 0.05 degrees an angle."""
    rng = np.random.default_rng([31, seed])
    level = 1.0 + drift * rng.normal(size=len(poses))
    level /= level.mean()
    geometry = seen(normal, poses)
    real = seen(normal, poses, 0.05 * rng.normal(size=(len(poses), 2)))
    albedo = rng.choice([0.7, 1.0, 1.4], len(normal))[:, None]
    lit = (real[..., :2] < np.radians(88.0)).all(axis=2)
    clean = np.where(lit, surface(np.minimum(real, 1.55), albedo), 0.0) * level
    response = clean + rng.normal(size=clean.shape) * np.sqrt(CAMERA[0] + CAMERA[1] * clean)
    weight = (geometry[..., :2] < np.radians(80.0)).all(axis=2).astype(float)
    return Readings(response, weight, geometry, np.tile(CAMERA, (len(poses), 1)), N, K), level


@pytest.mark.stability(stage="fit", case="a lamp that drifts")
def test_drift_of_the_lamp_is_found_on_a_glossy_sphere_and_its_error_is_as_stated():
    off, deviations = [], []
    for seed in range(3):
        readings, true = photographed(paper, sphere(seed=seed), SITTING, seed)
        found = estimate_levels(readings, FitOptions())
        assert found is not None and found.level.mean() == pytest.approx(1.0) and found.texels > 200
        off.append(found.level - true)
        deviations.append((found.level - true) / found.error)
    assert np.sqrt(np.mean(np.square(off))) < 0.3 * 0.008
    assert 0.4 < np.sqrt(np.mean(np.square(deviations))) < 1.4


def test_what_all_photographs_share_is_not_the_lamps():
    readings, _ = photographed(paper, sphere(), SITTING, 3)
    brighter = replace(readings, response=1.05 * readings.response)
    one, other = (estimate_levels(given, FitOptions()) for given in (readings, brighter))
    assert one is not None and other is not None
    assert other.level == pytest.approx(one.level, abs=1e-3)


@pytest.mark.stability(stage="fit", case="a lamp that drifts over a lobe that is not modelled")
@pytest.mark.parametrize("seed", [5, 6])
def test_a_lobe_that_is_not_modelled_is_not_taken_for_the_lamp(seed):
    """GGX fitted with the paper's lobe: its tail brightens photographs near the highlight."""
    readings, true = photographed(ggx, sphere(seed=seed), SITTING, seed)
    found = estimate_levels(readings, FitOptions())
    assert found is not None
    off = found.level - true
    assert np.sqrt(np.mean(off**2)) < 0.5 * true.std() and np.sqrt(np.mean((off / found.error) ** 2)) < 2.0


@pytest.mark.stability(stage="fit", case="a lamp that drifts over a surface that no model describes")
@pytest.mark.parametrize("surface", ["dusty", "acryl_blue", "garnet_red", "krylon_blue"])
@pytest.mark.parametrize("poses", [SITTING, FLAT], ids=["sphere", "plate"])
def test_no_surface_is_made_worse_by_levels(surface, poses):
    """Surfaces that the model does not describe: no levels, or levels that are nearer to the truth than none."""
    normal = sphere() if poses is SITTING else np.tile([0.0, 0.0, 1.0], (300, 1))
    readings, true = photographed(dusty if surface == "dusty" else measured(surface), normal, poses, 7, drift=0.004)
    found = estimate_levels(readings, FitOptions())
    assert found is None or np.sqrt(np.mean((found.level - true) ** 2)) < true.std()


@pytest.mark.stability(stage="fit", case="a lamp that drifts over a flat object")
def test_a_flat_object_does_not_tell_the_lamp_from_its_own_reflection():
    readings, _ = photographed(paper, np.tile([0.0, 0.0, 1.0], (400, 1)), FLAT, 8)
    assert estimate_levels(readings, FitOptions()) is None


def test_few_texels_tell_nothing():
    readings, _ = photographed(paper, sphere(texels=60), SITTING, 9)
    assert estimate_levels(readings, FitOptions()) is None


def test_directions_that_move_in_their_plane_are_those_of_vectors():
    normal, light, camera = np.array([0.2, 0.3, 0.933]), direction(40.0, 1.0), direction(25.0, -1.0)
    normal /= np.linalg.norm(normal)
    for which, angles in ((True, (39.0, 25.0)), (False, (40.0, 24.0))):
        exact = angles_from_directions(normal, direction(angles[0], 1.0), direction(angles[1], -1.0))
        moved = turned(angles_from_directions(normal, light, camera), np.radians(1.0), light=which)
        assert moved == pytest.approx(exact, abs=1e-9)


def test_one_direction_of_light_and_camera_has_no_plane():
    geometry = np.array([0.3, 0.3, 0.0, 0.3])
    assert np.isfinite(turned(geometry, 1e-3, light=True)).all()


# ---- files


def write_tile(path, level, texels=1000, seed=11, bands=6):
    """Write a tile of a sphere under a lamp of these levels, (J, filter states)."""
    rng, normal = np.random.default_rng(seed), sphere(texels, seed)
    geometry = seen(normal, SITTING)
    albedo = rng.choice([0.7, 1.0, 1.4], texels)[:, None]
    lit = (geometry[..., :2] < np.radians(80.0)).all(axis=2)
    clean = np.where(lit, paper(np.minimum(geometry, 1.55), albedo), 0.0)[..., None] * np.ones(bands)
    response = clean + rng.normal(size=clean.shape) * np.sqrt(CAMERA[0] + CAMERA[1] * clean)
    response = response * np.repeat(level, 3, axis=1)
    weight, captures = lit.astype(np.float32), [f"photograph-{number}" for number in range(len(SITTING))]
    with store.create(path, PROVENANCE) as out:
        out.coordinate("capture", captures, units="1", quantity="name of the capture")
        for name, values, dims in (
            ("response", response.astype(np.float32), "texel_number,capture,band"),
            ("geometry", geometry.astype(np.float32), "texel_number,capture,angle"),
            ("weight", weight, "texel_number,capture"),
            ("clipped", np.zeros(weight.shape, np.uint8), "texel_number,capture"),
            ("noise_model", np.tile(CAMERA, (len(SITTING), bands, 1)), "capture,band,term"),
            ("texel", np.ones(texels, np.uint8), "texel_number"),
        ):
            out.write(name, values, units="1", dims=dims, quantity=name)
        for name, value in {"rows": [0, 20], "width": texels // 20, "filters": ["out", "in"]}.items():
            out.attribute(name, value)
    return captures


LEVELS = np.stack([1.0 + 0.008 * np.random.default_rng(seed).normal(size=len(SITTING)) for seed in (1, 2)], axis=1)
LEVELS /= LEVELS.mean(axis=0)


def test_the_stage_finds_the_lamp_through_each_filter_and_the_fit_is_that_of_a_steady_lamp(tmp_path):
    captures = write_tile(tmp_path / "drifting.h5", LEVELS)
    write_tile(tmp_path / "steady.h5", np.ones_like(LEVELS))
    measure_levels([tmp_path / "drifting.h5"], tmp_path / "levels.h5", FitOptions(), N, K, provenance=PROVENANCE)
    levels, names = read_levels(tmp_path / "levels.h5")
    assert names == captures and levels.source == TEXELS and levels.common_error == FitOptions().level_error
    assert np.sqrt(np.mean((levels.level - LEVELS) ** 2)) < 0.002
    off = {}
    for name, given in (("steady", []), ("drifting", []), ("levelled", [tmp_path / "levels.h5"])):
        tile = tmp_path / ("steady.h5" if name == "steady" else "drifting.h5")
        fit_brdf(tile, tmp_path / f"{name}-brdf.h5", FitOptions(), N, K, provenance=PROVENANCE, levels=given)
        with store.open_file(tmp_path / f"{name}-brdf.h5") as file:
            off[name] = file.read("alpha"), file.read("status"), file.read("diffuse_response")
    both = np.all([np.isin(status, (Status.OK, Status.DIFFUSE_ONLY)) for _, status, _ in off.values()], axis=0)
    for part, column in ((0, None), (2, 4)):
        steady, drifting, levelled = (v[part][both] if column is None else v[part][both, column] for v in off.values())
        apart = [np.sqrt(np.mean((other / steady - 1.0) ** 2)) for other in (drifting, levelled)]
        assert both.sum() > 100 and apart[1] < 0.5 * apart[0]


def test_levels_divide_responses_and_the_variance_follows(tmp_path):
    captures = write_tile(tmp_path / "tile.h5", np.ones_like(LEVELS), texels=40)
    plain = read_observations(tmp_path / "tile.h5")
    PhotographLevels(LEVELS, 0 * LEVELS, 0.02, TEXELS).write(
        tmp_path / "levels.h5", captures, ["out", "in"], PROVENANCE
    )
    levelled = read_observations(tmp_path / "tile.h5", [tmp_path / "levels.h5"])
    level = np.repeat(LEVELS, 3, axis=1)
    assert levelled.response == pytest.approx(plain.response / level, rel=1e-6)
    variance = [seen.noise[..., 0] + seen.noise[..., 1] * seen.response for seen in (plain, levelled)]
    assert variance[1] == pytest.approx(variance[0] / level**2, rel=1e-5)


def test_the_error_that_all_share_comes_with_the_levels(tmp_path):
    captures = write_tile(tmp_path / "tile.h5", np.ones_like(LEVELS), texels=200)
    stated = {}
    for common in (0.003, 0.05):
        levels = PhotographLevels(np.ones_like(LEVELS), 0 * LEVELS, common, TEXELS)
        levels.write(tmp_path / "levels.h5", captures, ["out", "in"], PROVENANCE)
        files = tmp_path / "tile.h5", tmp_path / "brdf.h5"
        fit_brdf(*files, FitOptions(), N, K, provenance=PROVENANCE, levels=[tmp_path / "levels.h5"])
        with store.open_file(tmp_path / "brdf.h5") as file:
            assert file.attribute("common_error") == common
            stated[common] = file.read("alpha_error"), file.read("alpha")
    (small, alpha), (large, _) = stated.values()
    known = np.isfinite(small) & np.isfinite(large)
    assert known.sum() > 100
    assert large[known] ** 2 - small[known] ** 2 == pytest.approx((0.05**2 - 0.003**2) * alpha[known] ** 2, rel=1e-6)


def test_nothing_told_leaves_responses_as_they_are(tmp_path):
    write_tile(tmp_path / "tile.h5", LEVELS, texels=40)
    measure_levels([tmp_path / "tile.h5"], tmp_path / "levels.h5", FitOptions(), N, K, provenance=PROVENANCE)
    levels, _ = read_levels(tmp_path / "levels.h5")
    assert levels.source == NOTHING and (levels.level == 1.0).all()
    assert (levels.error == FitOptions().model_error).all()


def test_levels_of_other_photographs_are_refused(tmp_path):
    captures = write_tile(tmp_path / "tile.h5", np.ones_like(LEVELS), texels=40)
    levels = PhotographLevels(LEVELS, 0 * LEVELS, 0.01, TEXELS)
    for number, (names, given) in enumerate(
        ((captures[::-1], levels), (captures, replace(levels, level=LEVELS[:, :1], error=LEVELS[:, :1])))
    ):
        path = tmp_path / f"{number}.h5"
        given.write(path, names, ["out", "in"][: given.level.shape[1]], PROVENANCE)
        with pytest.raises(InputError, match="levels of 16 captures"):
            read_observations(tmp_path / "tile.h5", [path])
