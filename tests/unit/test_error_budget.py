"""The error budget: parts that sum to the whole, each fault in its own row, known errors predicted."""

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from made import made
from scenes import OPTIONS, plate, sky, smooth_light

from irodori.calibration.recovery.calibration_file import Calibration
from irodori.calibration.recovery.mappings import LinearMapping
from irodori.colour.colorimetry import delta_e_reflectance
from irodori.config.models import Compress, EnvironmentMaps, Fit, ReferenceIntegrator, Render, Scene, Size
from irodori.config.parts import Subject
from irodori.core.store import Provenance
from irodori.evaluation import error_budget as module
from irodori.evaluation.error_budget import (
    BudgetOptions,
    Measured,
    away_from_edges,
    compressed_light,
    compressed_material,
    error_budget,
    measure_error_budget,
    substitutes,
)
from irodori.evaluation.error_prediction import noisy, other_gloss
from irodori.evaluation.known_errors import Known, Photographs, Spread, colours
from irodori.evaluation.renderer_noise import (
    Paths,
    TracedBlocks,
    block_places,
    expected_noise,
    measured_noise,
    traced_blocks,
)
from irodori.evaluation.result_tables import BudgetRow, read_rows
from irodori.evaluation.truth_errors import radiance_delta_e
from irodori.light.environment_file import Environment, PixelNoise
from irodori.material.material_file import Material
from irodori.material.principal_components.basis_count import CompressOptions
from irodori.rendering.integrators import render_image
from irodori.rendering.planning.plan_file import write_plan
from irodori.rendering.reference.denoising import Halves
from irodori.rendering.reference.world import NORMAL, SEEN
from irodori.rendering.scene_white import scene_white
from irodori.spectra.published import spectrum

SIDE = 40
PAINTS = np.stack([spectrum("TCS1"), spectrum("TCS14"), spectrum("TCS56")], axis=1)
BASIS = np.linalg.svd(np.stack([spectrum(f"TCS{i}") for i in range(99)]), full_matrices=False)[2][:6].T
#: A camera whose responses are the coefficients themselves.
CALIBRATION = Calibration(BASIS, LinearMapping(np.eye(6)), np.ones(61), ("out", "in"), band_response=BASIS.T)


def truth() -> Material:
    """Three paints side by side."""
    paint = np.broadcast_to(np.arange(SIDE) * 3 // SIDE, (SIDE, SIDE))
    green = PAINTS[30][paint]
    return Material(alpha=green, beta=np.full((SIDE, SIDE), 2.0), mu=np.full((SIDE, SIDE), 0.1), green_response=green,
                    coefficients=np.eye(3, dtype=np.float32)[paint], basis=PAINTS, n=np.full(61, 1.5), k=np.zeros(61),
                    mirror=0.0, typical_gloss=(2.0, 0.1))  # fmt: skip


def measured(change=0.0, deviation=0.0, unseen=np.s_[:0], gloss=(0.0, 0.0), border="unknown") -> Measured:
    """What a chain might find: the truth on the camera's basis, changed and with scatter of a known deviation."""
    exact = truth()
    rng = np.random.default_rng(3)
    response = (exact.coefficients @ PAINTS.T) @ BASIS + change
    noisy_response = response + deviation * rng.standard_normal(response.shape)
    alpha = (noisy_response @ BASIS.T)[..., 30]
    alpha[unseen] = np.nan
    own = replace(exact, alpha=alpha, green_response=alpha, coefficients=noisy_response.astype(np.float32), basis=BASIS,
                  beta=exact.beta + gloss[0] * rng.standard_normal(alpha.shape),
                  mu=exact.mu + gloss[1] * rng.standard_normal(alpha.shape))  # fmt: skip
    every = np.ones((SIDE, SIDE, 1))
    known = Known(own, np.broadcast_to(gloss, (*alpha.shape, 2)), noisy_response, np.full(response.shape, deviation**2),
                  CALIBRATION, 0.5, Photographs(every, 0.0 * every, 1.0), Spread(1e-3, 1e-3, border), 0.0, 0.0,
                  np.ones((SIDE, SIDE), bool))  # fmt: skip
    return Measured(known, exact)


def spectra(material: Material) -> np.ndarray:
    return material.coefficients * material.spectrum_scale[..., None] @ material.basis.T


def colour_errors(one: Measured) -> dict[str, float]:
    """Mean CIEDE2000 of every part's reflectance."""
    parts = substitutes(one)
    exact = spectra(one.truth)
    return {name: float(delta_e_reflectance(exact, spectra(part)).mean()) for name, part in parts.items()}


@pytest.mark.parametrize(
    "unseen",
    [np.s_[3:9, 5:30], pytest.param(np.s_[:, :16], id="no texel of the first paint"),
     pytest.param(np.s_[:, 24:], id="no texel of the last paint")],
)  # fmt: skip
def test_the_parts_sum_to_what_was_measured(unseen):
    one = measured(0.01, 0.01, unseen)
    parts = substitutes(one)
    exact = spectra(one.truth)
    changes = sum(spectra(parts[name]) - exact for name in ("noise", "calibration", "seams", "unseen"))
    assert np.abs(exact + changes - spectra(parts["all"])).max() < 1e-5


def test_the_colour_of_a_material_follows_its_diffuse_weight():
    own = truth()
    dimmed = replace(own, alpha=0.4 * own.alpha)
    coefficients, basis = colours(dimmed)
    np.testing.assert_allclose(coefficients @ basis.T, 0.4 * (own.coefficients @ own.basis.T), rtol=1e-6)


def test_what_is_wrong_alike_is_calibration_and_what_scatters_is_noise():
    # Six vectors do not hold the paints exactly: what that leaves is calibration in both.
    floor = colour_errors(measured())
    assert floor["noise"] < 1e-3 and floor["calibration"] > 0
    biased, noisy = colour_errors(measured(change=0.02)), colour_errors(measured(deviation=0.02))
    assert biased["calibration"] > floor["calibration"] + 0.5 and biased["noise"] < 1e-3
    assert noisy["noise"] > 0.5 and noisy["calibration"] < floor["calibration"] + 0.1
    assert biased["gloss"] == noisy["gloss"] == 0.0


def test_texels_that_nobody_saw_are_a_part_of_their_own():
    hole = colour_errors(measured(unseen=np.s_[:, 12:28]))
    assert hole["unseen"] > 1.0
    assert hole["noise"] < 1e-3


def test_the_edge_of_a_flat_object_is_a_seam_and_that_of_a_closed_one_is_not():
    flat, closed = (away_from_edges(measured(border=border)) for border in ("black", "joined"))
    assert not flat[:2].any() and not flat[-2:].any() and not flat[:, :2].any() and not flat[:, -2:].any()
    assert closed[:, 0].all() and (flat[2:-2, 2:-2] == closed[2:-2, 2:-2]).all()


@pytest.mark.parametrize("deviation", [0.003, 0.01, 0.03])
def test_noise_that_is_known_is_predicted(deviation):
    one = measured(deviation=deviation)
    found = colour_errors(one)["noise"]
    estimate = one.known.estimate()
    drawn = noisy(one.known, estimate, np.random.default_rng(0))
    expected = delta_e_reflectance(spectra(estimate), spectra(drawn)).mean()
    # Texels at seams have no part in what is measured.
    assert found / away_from_edges(one).mean() == pytest.approx(expected, rel=0.08)


def test_gloss_errors_that_are_known_are_drawn_as_large():
    def drawn(one):
        found = other_gloss(one, one.estimate(), np.random.default_rng(0))
        return found.beta, found.mu

    beta, mu = drawn(measured().known)
    assert (beta == 2.0).all() and (mu == 0.1).all()
    sure = measured().known
    beta, mu = drawn(replace(sure, gloss_error=np.broadcast_to((0.1, 0.004), (SIDE, SIDE, 2))))
    assert (beta - 2.0).std() == pytest.approx(0.1, rel=0.05)
    assert (mu - 0.1).std() == pytest.approx(0.004, rel=0.05)
    # An error that the fit does not state is not drawn, and no draw leaves a roughness of nothing.
    half = np.stack([np.full((SIDE, SIDE), np.nan), np.full((SIDE, SIDE), 9.0)], -1)
    assert (drawn(replace(sure, gloss_error=half))[0] == 2.0).all()
    beta, mu = drawn(replace(sure, gloss_error=np.full((SIDE, SIDE, 2), 9.0)))
    assert mu.min() == pytest.approx(0.5 * 0.1) and beta.min() == 0.0


COMPRESSION = CompressOptions()


def light_of_three():
    return sky(lambda d: np.stack([smooth_light(d), 0.3 + d[..., 2] ** 2, 1.0 + d[..., 0]], axis=-1), 64, 32, PAINTS)


def test_light_loses_nothing_to_all_its_bases():
    exact = light_of_three()
    light, stated = compressed_light(
        exact, CompressOptions(target_delta_e_mean=0.0, target_delta_e_p99=0.0, storage="single")
    )
    assert stated < 1e-3
    assert np.allclose(light.irradiance @ light.basis.T, exact.irradiance @ exact.basis.T, atol=1e-4)


def scene_of(integrator: dict) -> dict:
    return {
        "image": {"width": 24, "height": 16},
        "integrator": integrator,
        "display": {"exposure": "auto"},
        "objects": [{"object": "a", "position_mm": [0.0, 0.0, 0.0], "rotation_deg": [0.0, 0.0, 0.0], "scale": 1.0}],
        "views": {"v": {"position_mm": [0.0, -80.0, 150.0], "target_mm": [0.0, 0.0, 0.0], "up": [0.0, 0.0, 1.0],
                        "field_of_view_deg": 20.0}},
    }  # fmt: skip


def budget(one: Measured, estimated, scene=None, backs=()) -> dict[str, BudgetRow]:
    """Return the rows of a small picture by the first words of their stage."""
    names = ("target_delta_e_mean", "target_delta_e_p99", "align", "weighting", "storage", "codec")
    compress = dict(zip(names, (0.1, 0.5, 4, "nothing", "half", "gzip"), strict=True))
    options = BudgetOptions(
        made(Render, OPTIONS), made(Fit, {}), made(Compress, compress), made(EnvironmentMaps, compress)
    )
    scene = made(Scene, scene or scene_of({"kind": "reference", "samples": 16, "seed": 0}))
    lights = (estimated, light_of_three())
    rows = error_budget(scene, "v", [plate(60.0)], [one, *backs], lights, options)
    return {row.stage.split(":")[0]: row for row in rows}


def warmer() -> Environment:
    """The light as a camera recovered it, and an error of the size that it has."""
    basis = PAINTS * np.linspace(0.9, 1.1, 61)[:, None]
    return replace(light_of_three(), basis=basis, basis_errors=(basis - PAINTS)[None])


@pytest.fixture(scope="module")
def rows():
    return (
        budget(measured(0.02, 0.01, gloss=(0.3, 0.01)), light_of_three()),
        budget(measured(0.02, unseen=np.s_[4:36, 8:14]), warmer()),
    )


def test_each_fault_stands_in_its_own_row(rows):
    first, second = rows
    assert first["light"].max == 0.0 and second["light"].mean > 0.5
    assert first["gloss of the fit"].mean > 5 * second["gloss of the fit"].mean
    assert first["noise"].mean > 10 * second["noise"].mean
    assert first["coverage"].max == first["coverage"].predicted == 0.0
    assert second["coverage"].mean > 0.5 and second["coverage"].predicted > 0.1
    assert second["calibration and fit"].mean > 0.5 and second["calibration and fit"].predicted == 0.5


def test_what_is_not_known_has_a_reason_for_no_prediction(rows):
    assert np.isnan(rows[0]["light"].predicted) and "no camera" in rows[0]["light"].by
    assert rows[1]["light"].predicted > 0.0


def test_the_noise_of_the_panorama_reaches_the_picture_as_large_as_predicted():
    """The pixels of a small panorama are large: their noise does not cancel on what they light."""
    exact = replace(light_of_three(), basis_errors=np.zeros((1, 61, 3)))
    noise = PixelNoise(np.full((1, 3, 2), [1e-9, 0.5]), np.zeros((1, 3)), np.linalg.pinv(PAINTS), PAINTS.T)
    for one in (exact, replace(exact, noise=noise)):
        found = budget(measured(), one.drawn(np.random.default_rng(5)))["light"]
        assert (found.mean > 0.1) == (one.noise is not None)
        assert found.predicted == pytest.approx(found.mean, rel=0.4)


def test_noise_and_gloss_reach_the_picture_as_large_as_predicted(rows):
    for stage in ("noise", "gloss of the fit"):
        row = rows[0][stage]
        # A small picture shows few texels at each pixel; some of them lie at seams.
        assert row.predicted == pytest.approx(row.mean, rel=0.4), stage


def test_the_noise_of_paths_is_predicted(rows):
    for found in rows:
        assert found["renderer"].predicted == pytest.approx(found["renderer"].mean, rel=0.3)
        assert found["renderer"].mean > 0.05


def test_the_whole_is_no_more_than_its_parts(rows):
    for found in rows:
        parts = [row for stage, row in found.items() if not stage.startswith(("all", "renderer"))]
        whole = found["all but the renderer"]
        assert max(row.mean for row in parts) * 0.5 < whole.mean < sum(row.mean for row in parts) + 0.1
        predicted = [row.predicted for row in parts if np.isfinite(row.predicted)]
        assert max(predicted) <= whole.predicted <= sum(predicted)


def test_each_row_is_the_picture_with_one_part_not_true():
    one, light, own = measured(0.02, 0.01, np.s_[4:36, 8:14], gloss=(0.3, 0.01)), light_of_three(), warmer()
    found = budget(one, own)
    parts = substitutes(one)
    paths = Paths(made(Scene, scene_of({"kind": "reference", "samples": 16, "seed": 0})), "v", [plate(60.0)])
    true = paths.picture([one.truth], light, 64)
    white = scene_white(paths.scene, light)[0]
    shown = (paths.picture([parts["all"]], light, 64) != true).any(axis=-1)
    assert 0.1 < shown.mean() < 1.0
    lit = {"light": (one.truth, own), "all but the renderer": (parts["all"], own)}
    lit |= {stage: (parts[name], light) for stage, name in (
        ("noise", "noise"), ("calibration and fit", "calibration"), ("rectification", "seams"),
        ("coverage", "unseen"), ("gloss of the fit", "gloss"))}  # fmt: skip
    for stage, (material, sky_light) in lit.items():
        off = radiance_delta_e(true, paths.picture([material], sky_light, 64), white)[shown]
        row = found[stage]
        assert row.mean == pytest.approx(off.mean(), rel=1e-5) and row.max == pytest.approx(off.max(), rel=1e-5), stage
        assert row.p95 == pytest.approx(np.percentile(off, 95), rel=1e-4), stage
    # Parts add by squares, pixel by pixel: no less than the root of their means' squares, no more than their sum.
    known = [row.predicted for stage, row in found.items() if not stage.startswith(("all", "renderer"))]
    whole = found["all but the renderer"].predicted
    assert np.sqrt(np.sum(np.square(known))) * 0.999 <= whole < np.sum(known)
    compressed = Paths.picture(paths, [compressed_material(one.truth, COMPRESSION)[0]], light, 64)
    off = radiance_delta_e(true, compressed, white)[shown]
    assert found["compression of the materials"].mean == pytest.approx(off.mean(), rel=1e-3)
    assert found["compression of the materials"].predicted == compressed_material(one.truth, COMPRESSION)[1]
    off = radiance_delta_e(true, paths.picture([one.truth], compressed_light(light, COMPRESSION)[0], 64), white)[shown]
    assert found["compression of the light"].mean == pytest.approx(off.mean(), rel=1e-3)


def test_a_back_has_the_errors_of_its_own_photographs(rows):
    """A sheet that lies on its face shows the errors of its back, as the back alone does face up."""
    scene = scene_of({"kind": "reference", "samples": 16, "seed": 0})
    scene["objects"][0] |= {"rotation_deg": [0.0, 180.0, 0.0], "back": "b"}
    found = budget(measured(0.05), light_of_three(), scene, [measured(0.02, 0.01, gloss=(0.3, 0.01))])
    for stage in ("noise", "calibration and fit", "rectification", "gloss of the fit", "all but the renderer"):
        assert found[stage].mean == pytest.approx(rows[0][stage].mean, rel=1e-3), stage
    assert found["noise"].predicted == pytest.approx(rows[0]["noise"].predicted, rel=0.1)


def test_what_an_integrator_leaves_out_is_seen_beside_paths():
    scene, one, light = scene_of({"kind": "interactive"}), measured(0.02), light_of_three()
    found = budget(one, light, scene)["renderer"]
    assert np.isnan(found.predicted) and "beside paths alone" in found.by
    scene, shapes = made(Scene, scene), [plate(60.0)]
    own, other = (render_image(scene, "v", shapes, [m], light, made(Render, OPTIONS))[0]
                  for m in (one.truth, one.known.estimate()))  # fmt: skip
    long = Paths(scene, "v", shapes).picture([one.truth], light, 512)
    off = radiance_delta_e(long, own, scene_white(scene, light)[0])[(own != other).any(axis=-1)]
    assert found.mean == pytest.approx(off.mean(), rel=1e-4) and found.max == pytest.approx(off.max(), rel=1e-4)


class Scattering:
    """Grey pictures whose noise falls with the root of the number of paths, and has no likeness from pixel to pixel."""

    def __init__(self, denoise: bool) -> None:
        self.scene = SimpleNamespace(integrator=ReferenceIntegrator(samples=16, denoise=denoise))

    def blocks(self, materials, light, samples, seed, margin, cached=False) -> Halves:
        size = (60, 8 + 2 * margin, 8 + 2 * margin, 1)
        mean, half = np.random.default_rng(seed).normal(size=(2, *size)) / np.sqrt(samples)
        seen = np.zeros((*size[:3], SEEN), np.float32)
        seen[..., NORMAL] = 1.0
        shape = np.ones(61, np.float32)
        return Halves((0.4 + 0.008 * mean * shape).astype(np.float32), (0.008 * half * shape).astype(np.float32), seen)


@pytest.mark.parametrize("noise", [measured_noise, expected_noise])
def test_the_renderers_noise_is_that_of_its_own_number_of_paths(noise):
    white, paths = np.ones(61), Scattering(denoise=False)
    own = radiance_delta_e(
        np.full(paths.blocks([], None, 16, 5, 0).mean.shape, 0.4), paths.blocks([], None, 16, 5, 0).mean, white
    )
    found = noise(paths, [], None, white)
    assert np.sqrt((found**2).mean()) == pytest.approx(np.sqrt((own**2).mean()), rel=0.06)


def test_the_noise_of_the_picture_beside_it_is_subtracted(monkeypatch):
    # As noisy as what it judges: of the mean square between both, half is its own.
    white = np.ones(61)
    usual = measured_noise(Scattering(denoise=False), [], None, white)
    monkeypatch.setattr("irodori.evaluation.renderer_noise.MORE", 1)
    equal = measured_noise(Scattering(denoise=False), [], None, white)
    assert np.sqrt((equal**2).mean()) == pytest.approx(np.sqrt((usual**2).mean()), rel=0.08)


def test_pictures_without_noise_have_none():
    class Certain(Scattering):
        def blocks(self, materials, light, samples, seed, margin, cached=False) -> Halves:
            halves = super().blocks(materials, light, samples, seed, margin, cached)
            return halves._replace(mean=np.full_like(halves.mean, 0.4), difference=np.zeros_like(halves.mean))

    for noise in (measured_noise, expected_noise):
        assert (noise(Certain(denoise=False), [], None, np.ones(61)) == 0.0).all()


def test_an_unfiltered_pixel_is_expected_to_be_off_by_half_of_what_its_two_sets_of_paths_differ(monkeypatch):
    white, paths = np.ones(61), Scattering(denoise=False)
    traced = traced_blocks(paths, [], None, 9)
    monkeypatch.setattr("irodori.evaluation.renderer_noise.traced_blocks", lambda *_: traced)
    found = expected_noise(paths, [], None, white)
    np.testing.assert_allclose(found, radiance_delta_e(traced.first, traced.second, white) / 2.0)
    assert found.std() > 0.3 * found.mean()


def test_a_block_with_a_margin_shows_the_same_and_what_is_around_it():
    scene = made(Scene, scene_of({"kind": "reference", "samples": 64, "denoise": True}))
    paths, light, materials = Paths(scene, "v", [plate(60.0)]), light_of_three(), [truth()]
    alone, wider = (paths.blocks(materials, light, 64, 3, margin).mean for margin in (0, 2))
    assert alone.shape[1:] == (8, 8, 61) and wider.shape == (len(alone), 12, 12, 61)
    inner = wider[:, 2:-2, 2:-2]
    # The paths are others, the places the same: blocks agree in the mean, and no shifted ones do better.
    off = np.abs(inner - alone).mean()
    assert off < np.abs(wider[:, :8, :8] - alone).mean() and off < np.abs(wider[:, 4:, 4:] - alone).mean()
    assert inner.mean() == pytest.approx(alone.mean(), rel=0.05)


def test_the_noise_of_a_filtered_picture_is_what_its_filter_leaves():
    white, paths = np.ones(61), Scattering(denoise=True)
    shown = traced_blocks(paths, [], None, 5).shown
    left = np.sqrt((radiance_delta_e(np.full(shown.shape, 0.4), shown, white) ** 2).mean())
    as_traced = np.sqrt((measured_noise(Scattering(denoise=False), [], None, white) ** 2).mean())
    assert left < 0.45 * as_traced
    # Here a ninth is left, less than the noise of the many paths beside it, of which some stays.
    for noise in (measured_noise, expected_noise):
        found = noise(paths, [], None, white)
        assert 0.5 * left < np.sqrt((found**2).mean()) < 0.3 * as_traced


@pytest.mark.parametrize("noise", [measured_noise, expected_noise])
def test_an_integrator_without_random_numbers_has_no_noise(noise):
    silent = SimpleNamespace(scene=made(Scene, scene_of({"kind": "interactive"})))
    with pytest.raises(ValueError, match="accepted: a scene of the integrator reference"):
        noise(silent, [], None, np.ones(61))


def test_blocks_for_the_noise_lie_evenly_over_the_picture():
    image = Size(width=640, height=480)
    places = np.array(block_places(image, 32, 7))
    assert 15 < len(places) < 60 and (places >= 4).all() and (places <= [636, 476]).all()
    # Each third of the height and of the width has its share.
    for axis, size in enumerate((640, 480)):
        counts = np.histogram(places[:, axis], bins=3, range=(0, size))[0]
        assert counts.min() >= len(places) // 6
    assert len(block_places(image, 1 << 20, 0)) == 1
    assert len(block_places(Size(width=16, height=8), 8, 0)) == 2
    assert block_places(Size(width=5, height=3), 8, 0) == [(2.5, 1.5)]


def test_blocks_are_as_many_as_a_given_number_of_paths_traces():
    wide = Size(width=6400, height=4800)
    for samples, margin in ((32, 0), (32, 7), (128, 7)):
        # A block is rendered twice with its margin, and once without it with 16 times the paths.
        paths = samples * (2 * (8 + 2 * margin) ** 2 + 16 * 8 * 8)
        assert len(block_places(wide, samples, margin)) == pytest.approx(1.5e6 / paths, abs=0.5)
    # More than there is room for are all blocks of the picture, each once.
    every = block_places(Size(width=24, height=16), 8, 0)
    assert sorted(every) == [(x, y) for x in (4.0, 12.0, 20.0) for y in (4.0, 12.0)]


def grey(radiance: float) -> np.ndarray:
    """One block of one radiance in all bands."""
    return np.full((1, 8, 8, 61), radiance)


@pytest.mark.parametrize(
    "first, second, filtered, share",
    [
        # Both halves lose the same detail: what the filter takes away is seen beside the other, unfiltered half.
        (0.3, 0.3, (0.5, 0.5), 1.0),
        # By chance the other half looks better than it is: what the filter leaves is half the distance of what it made.
        (0.34, 0.3, (0.3, 0.34), 0.5),
    ],
)
def test_what_a_filter_takes_away_and_what_it_leaves_are_both_expected(monkeypatch, first, second, filtered, share):
    traced = TracedBlocks(grey(np.mean(filtered)), grey(first), grey(second), np.stack([grey(v) for v in filtered]))
    monkeypatch.setattr("irodori.evaluation.renderer_noise.traced_blocks", lambda *_: traced)
    white = np.ones(61)
    off = share * radiance_delta_e(grey(filtered[1]), grey(0.3), white)
    found = expected_noise(Scattering(denoise=True), [], None, white)
    assert off.min() > 0.5
    np.testing.assert_allclose(found, off, rtol=1e-6)


def test_the_table_keeps_its_rows(tmp_path, monkeypatch):
    row = BudgetRow("light", 1.25, 2.5, 3.5, 4.5, np.nan, "none, said with a comma")
    monkeypatch.setattr(module, "error_budget", lambda *_, **__: [row, replace(row, stage="b", predicted=0.5)])
    light_of_three().save(tmp_path / "light.h5", Provenance("test"))
    lists = ("materials", "true_materials", "calibrations", "tiles", "observations", "plan")
    inputs = {key: [] for key in lists} | dict.fromkeys(("environment", "true_environment"), tmp_path / "light.h5")
    scene = made(Scene, scene_of({"kind": "interactive"}))
    subjects = made(Sequence[Subject], [])
    measure_error_budget(inputs, scene, "v", subjects, BudgetOptions(*(None,) * 4), tmp_path / "budget.csv")
    first, second = read_rows(tmp_path / "budget.csv", BudgetRow)
    assert np.isnan(first.predicted) and replace(first, predicted=0.0) == replace(row, predicted=0.0)
    assert second == replace(row, stage="b", predicted=0.5)


def test_each_object_is_judged_by_its_own_files_and_shape(tmp_path, monkeypatch):
    taken, files_of = [], {}

    def load(files, shape, sample_mm, fit):
        files_of[files["material"]] = files, shape, sample_mm, fit
        return files["material"]

    monkeypatch.setattr(module.Known, "load", load)
    monkeypatch.setattr(module.Material, "load", str)
    monkeypatch.setattr(module, "error_budget", lambda *given: taken.append(given) or [])
    light_of_three().save(tmp_path / "light.h5", Provenance("test"))
    inputs = {key: [tmp_path / name / f"{key}.h5" for name in "ab"] for key in
              ("materials", "true_materials", "calibrations", "tiles", "observations")}  # fmt: skip
    inputs |= {"plan": []} | dict.fromkeys(("environment", "true_environment"), tmp_path / "light.h5")
    plates = [{"kind": "plate", "width_mm": width, "height_mm": 20.0} for width in (30.0, 50.0)]
    samples_mm = 0.2, 0.3
    described = [{"shape": plate, "sample_mm": mm} for plate, mm in zip(plates, samples_mm, strict=True)]
    subjects = made(Sequence[Subject], described)
    options = BudgetOptions(*(None,) * 4)
    scene = scene_of({"kind": "interactive"})
    scene["objects"].append(scene["objects"][0] | {"object": "b"})
    measure_error_budget(inputs, made(Scene, scene), "v", subjects, options, tmp_path / "c")
    _, view, solids, objects, lights, given = taken[0]
    assert view == "v" and given is options and len(lights) == 2
    assert [one.known for one in objects] == inputs["materials"]
    assert [one.truth for one in objects] == [str(path) for path in inputs["true_materials"]]
    for name, own, solid, mm in zip("ab", objects, solids, samples_mm, strict=True):
        files, shape, sample_mm, _ = files_of[own.known]
        assert shape is solid and sample_mm == mm
        assert files == {key.removesuffix("s") if key in ("materials", "calibrations") else key:
                         inputs[key]["ab".index(name)] if key in ("materials", "calibrations")
                         else [inputs[key]["ab".index(name)]]
                         for key in ("materials", "calibrations", "tiles", "observations")}  # fmt: skip


@pytest.mark.parametrize(("samples", "kind"), [(64, "reference"), (None, "reference"), (64, "interactive")])
def test_the_noise_of_a_planned_scene_is_that_of_the_paths_it_is_rendered_with(tmp_path, monkeypatch, samples, kind):
    taken = []
    monkeypatch.setattr(module, "error_budget", lambda scene, *_, **__: taken.append(scene.integrator) or [])
    light_of_three().save(tmp_path / "light.h5", Provenance("test"))
    plan = {"scene": "s", "integrator": kind, "tolerance_ciede2000": 1.0, "predicted_delta_e": 0.9}
    write_plan(tmp_path / "plan.yaml", plan | {"decisions": {"samples": {"value": samples}}})
    lists = ("materials", "true_materials", "calibrations", "tiles", "observations")
    inputs = {key: [] for key in lists} | dict.fromkeys(("environment", "true_environment"), tmp_path / "light.h5")
    inputs["plan"] = [tmp_path / "plan.yaml"] if samples else []
    scene = scene_of({"kind": kind} | ({"samples": 512} if kind == "reference" else {}))
    measure_error_budget(
        inputs,
        made(Scene, scene),
        "v",
        made(Sequence[Subject], []),
        BudgetOptions(*(None,) * 4),
        tmp_path / "budget.csv",
    )
    assert getattr(taken[0], "samples", None) == (samples or 512 if kind == "reference" else None)
