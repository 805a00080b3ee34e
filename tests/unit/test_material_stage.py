"""Fitted tiles become one material: every texel in its place, read tile by tile, or refused."""

import math
import tracemalloc
from dataclasses import asdict, replace

import h5py
import numpy as np
import pytest
from made import made
from made_up_camera import patches, system

from irodori.calibration.recovery.calibration_file import Calibration
from irodori.calibration.recovery.mappings import LinearMapping
from irodori.calibration.recovery.posterior import Posterior
from irodori.calibration.sensitivity_prior import of_independent_bands
from irodori.colour.colorimetry import delta_e_reflectance
from irodori.config.models import Object
from irodori.config.parts import Surface
from irodori.core import store
from irodori.core.custody import accept
from irodori.core.errors import InputError
from irodori.material.energy import energy_of
from irodori.material.fitted_tiles import FittedTiles, columns
from irodori.material.lobe_choices import Comparison, LeftOut
from irodori.material.material_file import Material, Status, gloss_maps
from irodori.material.principal_components.basis_count import CompressOptions
from irodori.material.stage import compress_reflectance
from irodori.report.html_page import fragment
from irodori.report.page import objects
from irodori.spectra.published import spectrum

PROVENANCE = store.Provenance("test")
BASIS = np.linalg.svd(np.stack([spectrum(f"TCS{i}") for i in range(99)]), full_matrices=False)[2][:6].T
FILTERS = ["out", "in"]


def write_tile(
    path, rows, width, seed, *, filters=FILTERS, noise=1e-6, lobes=("gaussian",), coat="sum", by_noise=False
):
    """A fitted tile of random measured colours; the first texel of each row was not seen."""
    first, last = rows
    count = (last - first) * width
    rng = np.random.default_rng(seed)
    reflectance = np.stack([spectrum(f"TCS{i}") for i in range(99)])[rng.integers(99, size=count)]
    response = (reflectance @ BASIS).astype(np.float32)
    response[::width] = np.nan
    alpha = np.where(np.isfinite(response[:, 1]), rng.uniform(0.2, 0.8, count), np.nan)
    values = {"diffuse_response": response, "diffuse_variance": np.full_like(response, noise), "alpha": alpha}
    values |= {name: rng.uniform(0.1, 0.5, count).astype(np.float32) for name in gloss_maps(lobes) | columns(lobes)}
    if by_noise:
        values["alpha_error"] = np.full(count, math.sqrt(noise), np.float32)
    # Codes are whole numbers.
    coded = [name for name, (units, _) in columns(lobes).items() if not isinstance(units, str)]
    values |= {name: rng.integers(0, 2, count).astype(np.int8) for name in coded}
    values["texel"], values["paint"] = np.ones(count, np.uint8), np.zeros(count, np.int16)
    with store.create(path, PROVENANCE) as out:
        for name, one in values.items():
            out.write(name, one, units="1", dims=",".join(["texel_number", "band"][: one.ndim]), quantity=name)
        out.attribute("filters", filters)
        out.attribute("lobes", list(lobes))
        out.attribute("coat", coat)
        out.attribute("rows", list(rows))
        out.attribute("fit_seconds", 0.5)
        out.attribute("texels_fitted", count)
    return {name: one.reshape(last - first, width, *one.shape[1:]) for name, one in values.items()}


@pytest.fixture
def calibration(tmp_path):
    rng = np.random.default_rng(5)
    chart = rng.uniform(0.1, 1, (24, 6))
    bells = np.exp(-0.5 * ((np.arange(61) - np.arange(5, 60, 10)[:, None]) / 5.0) ** 2) / 12.5
    open_part = of_independent_bands([1e-8 * np.eye(61)] * 6)
    found = Calibration(BASIS, LinearMapping(np.eye(6)), np.ones(61), tuple(FILTERS), training=chart,
                        band_response=bells, band_response_covariance=open_part)  # fmt: skip
    with store.create(tmp_path / "calibration.h5", PROVENANCE) as out:
        found.write(out)
    return tmp_path / "calibration.h5"


def definition(height, width):
    return {"texels": {"height": height, "width": width}, "refractive_index": {"n": 1.5, "k": 0.0},
            "mirror_weight": 0.0}  # fmt: skip


def compress(tiles, calibration, size, output, **options):
    compress_reflectance(
        tiles,
        calibration,
        made(Object | Surface, definition(*size)),
        output,
        options=CompressOptions(**options),
        lights=["D65"],
        provenance=PROVENANCE,
    )
    return Material.load(output)


@pytest.mark.parametrize("storage", ["half", "single"])
def test_every_texel_of_every_tile_is_in_its_place(tmp_path, calibration, storage):
    bounds = [(0, 7), (7, 8), (8, 20)]
    paths = [tmp_path / f"tile-{i}.h5" for i in range(3)]
    tiles = [
        write_tile(path, rows, 30, seed, by_noise=True)
        for seed, (path, rows) in enumerate(zip(paths, bounds, strict=True))
    ]
    whole = {name: np.concatenate([tile[name] for tile in tiles]) for name in tiles[0]}
    # In any order, as a glob may give them.
    found = compress([paths[2], paths[0], paths[1]], calibration, (20, 30), tmp_path / "m.h5", storage=storage)
    for name in ("alpha", "beta", "mu"):
        assert np.array_equal(getattr(found, name), whole[name], equal_nan=True)
    assert np.array_equal(found.green_response, whole["diffuse_response"][..., 1], equal_nan=True)
    truth = whole["diffuse_response"] @ BASIS.T
    assert np.array_equal(found.observed, np.isfinite(truth[..., 0])) and not found.observed[:, 0].any()
    error = np.abs(found.spectra() - truth)[found.observed]
    assert error.max() <= (3e-3 if storage == "half" else 1e-5)
    better = whole["mu_error"] / whole["mu"] <= np.median(whole["mu_error"] / whole["mu"])
    assert found.typical_gloss == pytest.approx((np.median(whole["beta"][better]), np.median(whole["mu"][better])))
    with store.open_file(tmp_path / "m.h5") as file:
        for name in columns(found.lobes):
            assert np.array_equal(file.read(name), whole[name])
        errors = file.attribute("errors")
        reliability, spectral, colour = (file.read(f"{name}_error") for name in ("reflectance", "spectral", "delta_e"))
        assert np.array_equal(file.read("error_wavelength"), np.arange(400.0, 701.0, 20.0))
    stated = Posterior(Calibration.load(calibration)).of(
        whole["diffuse_response"], whole["diffuse_variance"], stated=True
    )
    assert np.allclose(spectral, stated.standard_deviation, rtol=2e-3, equal_nan=True)
    assert np.allclose(colour, stated.delta_e, rtol=1e-3, equal_nan=True)
    assert errors["fit_seconds"] == 1.5 and errors["texels_fitted"] == 600
    assert errors["observed_fraction"] == pytest.approx(29 / 30)
    assert errors["compression"]["masked_pixels"] == 20 and errors["compression"]["pixels"] == 600
    assert errors["reflectance_error_median"] == pytest.approx(float(np.median(reliability[found.observed])))


def test_where_no_model_predicts_the_photographs_all_errors_are_larger_and_nothing_is_ok(tmp_path, calibration):
    tile = write_tile(tmp_path / "tile.h5", (0, 8), 30, 1, noise=1e-4, by_noise=True)
    for deviation, times in ((1.4, 1.0), (8.0, 8.0)):
        choice = Comparison((LeftOut(("gaussian",), deviation, 0.0, 0.0),))
        size, output = made(Object | Surface, definition(8, 30)), tmp_path / f"{times:g}.h5"
        compress_reflectance([tmp_path / "tile.h5"], calibration, size, output, lobe_choice=choice,
                             options=CompressOptions(), lights=["D65"], provenance=PROVENANCE)  # fmt: skip
        variance = np.float32(times**2) * tile["diffuse_variance"]
        expected = Posterior(Calibration.load(calibration)).of(tile["diffuse_response"], variance, stated=True).delta_e
        with store.open_file(output) as file:
            assert np.allclose(file.read("delta_e_error"), expected, rtol=1e-3, equal_nan=True)
            assert file.attribute("errors")["lobe_choice_misfit"] == times
            for name in ("alpha_error", "beta_error", "mu_error"):
                assert np.allclose(file.read(name), times * tile[name], rtol=1e-5, equal_nan=True), name
            determined = np.isin(tile["status"], (Status.OK, Status.PAINT, Status.DIFFUSE_ONLY))
            assert determined.any() and (file.read("status")[determined] == Status.OK).any() == (times == 1.0)


def test_a_white_reference_that_contradicts_the_chart_is_in_the_errors_of_alpha_and_beta(tmp_path, calibration):
    """Which of the two errs is not told: gloss and diffuse weights may be wrong by the difference, and μ is not."""
    tile, found = write_tile(tmp_path / "tile.h5", (0, 8), 30, 1, noise=1e-4, by_noise=True), {}
    with h5py.File(tmp_path / "tile.h5", "r+") as file:
        file.attrs["common_error"] = 0.01
    accept(tmp_path / "tile.h5")
    for level in (1.0, 1.08):
        known = replace(Calibration.load(calibration), level=(level,) * 6)
        with store.create(tmp_path / "levelled.h5", PROVENANCE) as out:
            known.write(out)
        compress([tmp_path / "tile.h5"], tmp_path / "levelled.h5", (8, 30), tmp_path / "m.h5")
        with store.open_file(tmp_path / "m.h5") as file:
            found[level] = {name: file.read(name) for name in ("alpha_error", "beta_error", "mu_error")}
            common = file.attribute("errors")["common_error"]
            colour = file.read("delta_e_error")
        found[level] |= {"colour": colour, "common": common}
    for name in ("alpha", "beta"):
        expected = np.hypot(tile[f"{name}_error"], 0.08 * tile[name])
        assert np.allclose(found[1.08][f"{name}_error"], expected, rtol=1e-4, equal_nan=True), name
        assert np.array_equal(found[1.0][f"{name}_error"], tile[f"{name}_error"], equal_nan=True), name
    assert found[1.0]["common"] == 0.01 and found[1.08]["common"] == pytest.approx(np.hypot(0.01, 0.08))
    # Colours follow the chart, not the white reference.
    for name in ("mu_error", "colour"):
        assert np.allclose(found[1.08][name], found[1.0][name], rtol=1e-3, atol=1e-6, equal_nan=True), name


@pytest.mark.parametrize("alpha_error", [0.003, 0.3])
def test_what_photographs_do_not_tell_from_gloss_is_in_the_errors_of_colours(
    tmp_path, calibration, alpha_error, caplog
):
    """Errors of α by gloss that was not subtracted, or too much of it, are the same in all bands."""
    tile = write_tile(tmp_path / "tile.h5", (0, 16), 64, 1, noise=1e-8)
    off = alpha_error * np.random.default_rng(2).normal(size=(16 * 64, 1)).astype(np.float32)
    with h5py.File(tmp_path / "tile.h5", "r+") as file:
        file["diffuse_response"][:] += off
        file["alpha_error"][:] = alpha_error
        file.attrs["common_error"] = 0.0
        file["alpha_error"][5] = np.nan
    accept(tmp_path / "tile.h5")
    with caplog.at_level("WARNING"):
        found = compress([tmp_path / "tile.h5"], calibration, (16, 64), tmp_path / "m.h5", storage="single")
    assert ("photographs do not tell gloss from colour" in caplog.text) == (alpha_error == 0.3)
    truth, seen = tile["diffuse_response"] @ BASIS.T, found.observed
    with store.open_file(tmp_path / "m.h5") as file:
        stated, spectral = file.read("delta_e_error"), file.read("spectral_error").astype(float)
    assert stated[0, 5] > 5.0  # without an error of α, all of the light may be gloss
    seen[0, 5] = False
    distance = delta_e_reflectance(truth[seen], found.spectra()[seen]) / stated[seen]
    z = np.abs(truth - found.spectra())[..., ::4][seen] / spectral[seen]
    for one in (distance, z):
        assert (one <= 1.0).mean() > 0.62 and (one <= 2.0).mean() > 0.93
    if alpha_error == 0.3:  # far more than what chart and bands leave open
        assert (distance <= 1.0).mean() < 0.9


@pytest.mark.parametrize("level", [1.0, 0.7])
def test_photographs_through_the_filter_at_another_level_are_said_to_be(tmp_path, calibration, caplog, level):
    chart, paint = patches() @ system().T, np.arange(8 * 32) % 16
    write_tile(tmp_path / "tile.h5", (0, 8), 32, 1)
    with h5py.File(tmp_path / "tile.h5", "r+") as file:
        file["diffuse_response"][:] = chart[paint + 2] * np.repeat([1.0, level], 3)
        file["paint"][:] = paint
    with h5py.File(calibration, "r+") as file:
        file["chart_response"][:] = chart
    accept(tmp_path / "tile.h5")
    accept(calibration)
    with caplog.at_level("WARNING"):
        compress([tmp_path / "tile.h5"], calibration, (8, 32), tmp_path / "m.h5")
    assert ("as white reference and chart let expect of 16 paints" in caplog.text) == (level != 1.0)
    with store.open_file(tmp_path / "m.h5") as file:
        found = file.attribute("errors")["filter_level"]
    assert found["is_other"] == (level != 1.0) and found["ratio"] == pytest.approx(level, rel=0.07)


def test_every_gloss_component_has_its_maps_its_unit_and_its_typical_values(tmp_path, calibration):
    lobes = ("ggx", "gaussian")
    tile = write_tile(tmp_path / "a.h5", (0, 8), 12, 4, lobes=lobes)
    found = compress([tmp_path / "a.h5"], calibration, (8, 12), tmp_path / "m.h5")
    assert [name for name, _, _ in found.gloss] == list(lobes)
    for (_, beta, mu), names in zip(found.gloss, (("beta", "mu"), ("beta_2", "mu_2")), strict=True):
        assert np.array_equal(beta, tile[names[0]]) and np.array_equal(mu, tile[names[1]])
    medians = []
    for beta, mu, error in (("beta", "mu", "mu_error"), ("beta_2", "mu_2", "mu_2_error")):
        relative = tile[error] / tile[mu]
        better = relative <= np.median(relative)
        medians += [np.median(tile[beta][better]), np.median(tile[mu][better])]
    assert found.typical_gloss == pytest.approx(medians)
    with store.open_file(tmp_path / "m.h5") as file:
        assert [file.dataset(name).attrs["units"] for name in ("mu", "mu_2", "mu_error", "mu_2_error")] == [
            "1", "rad", "1", "rad"
        ]  # fmt: skip


def test_what_texels_send_back_is_mapped_summed_up_and_told(tmp_path, calibration, caplog):
    write_tile(tmp_path / "a.h5", (0, 4), 12, 4)
    write_tile(tmp_path / "b.h5", (4, 8), 12, 5)
    with h5py.File(tmp_path / "b.h5", "r+") as file:
        file["beta"][:], file["mu"][:], file["mu_error"][:] = 0.1, 0.3, 1e-3
        file["beta"][10], file["mu"][10], file["beta_error"][10] = 300.0, 0.5, 1.0
    accept(tmp_path / "b.h5")
    with caplog.at_level("WARNING", "irodori"):
        found = compress([tmp_path / "a.h5", tmp_path / "b.h5"], calibration, (8, 12), tmp_path / "m.h5")
    assert "1.14 % of texels send back up to" in caplog.text
    with store.open_file(tmp_path / "m.h5") as file:
        albedo, error, stated = file.read("albedo"), file.read("albedo_error"), file.attribute("errors")["energy"]
    assert np.array_equal(np.isfinite(albedo), found.observed) and (error[found.observed] > 0.0).all()
    largest = np.unravel_index(np.nanargmax(albedo), albedo.shape)
    assert largest == (4, 10) and albedo[largest] > 10.0
    text = " ".join(fragment("objects.html.j2", objects=objects(["jar"], [tmp_path / "m.h5"], {})).split())
    assert f"back): at most {stated['albedo_max']:.3f}, above 1 in {stated['gain_fraction']:.2%} of texels" in text
    assert "Mirror weight: 0, as the object's file states; it is ASSUMED." in text
    # The same from the file as it is rendered from, compressed.
    again = asdict(energy_of(found, error))
    assert again["texels"] == stated["texels"] == 88
    assert again == {name: pytest.approx(value, rel=2e-3) for name, value in stated.items()}


def test_a_component_that_most_texels_lack_is_not_typical(tmp_path, calibration):
    write_tile(tmp_path / "a.h5", (0, 8), 12, 4, lobes=("ggx", "gaussian"))
    with h5py.File(tmp_path / "a.h5", "r+") as file:
        for name, value in (("beta_2", 0.0), ("mu_2", np.nan), ("mu_2_error", np.nan)):
            file[name][:60] = value
    accept(tmp_path / "a.h5")
    assert FittedTiles([tmp_path / "a.h5"], 8, 12).typical_gloss()[2] == 0.0
    found = compress([tmp_path / "a.h5"], calibration, (8, 12), tmp_path / "m.h5")
    assert (found.filled()[0].further_gloss[0][0].ravel()[:60] == 0.0).all()


def test_noise_that_one_texel_lacks_has_no_part_in_any(tmp_path, calibration):
    write_tile(tmp_path / "a.h5", (0, 4), 10, 1)
    assert FittedTiles([tmp_path / "a.h5"], 4, 10).is_noise_known()
    write_tile(tmp_path / "b.h5", (4, 8), 10, 2, noise=np.nan)
    assert not FittedTiles([tmp_path / "a.h5", tmp_path / "b.h5"], 8, 10).is_noise_known()
    compress([tmp_path / "a.h5", tmp_path / "b.h5"], calibration, (8, 10), tmp_path / "m.h5")
    with store.open_file(tmp_path / "m.h5") as file:
        assert "noise" not in file.dataset("reflectance_error").attrs["quantity"]


def test_tiles_that_do_not_make_the_texture_are_refused(tmp_path, calibration):
    write_tile(tmp_path / "a.h5", (0, 4), 10, 1)
    write_tile(tmp_path / "b.h5", (3, 8), 10, 2)
    write_tile(tmp_path / "c.h5", (4, 8), 10, 2, filters=["out"])
    with pytest.raises(InputError, match="1 row missing or doubled"):
        FittedTiles([tmp_path / "a.h5", tmp_path / "b.h5"], 8, 10)
    with pytest.raises(InputError, match="4 rows missing or doubled"):
        FittedTiles([tmp_path / "a.h5"], 8, 10)
    with pytest.raises(InputError, match="as in the other tiles"):
        FittedTiles([tmp_path / "a.h5", tmp_path / "c.h5"], 8, 10)
    write_tile(tmp_path / "e.h5", (4, 8), 10, 2, lobes=("ggx",))
    with pytest.raises(InputError, match=r"lobes.*ggx.*gaussian, as in the other tiles"):
        FittedTiles([tmp_path / "a.h5", tmp_path / "e.h5"], 8, 10)
    write_tile(tmp_path / "f.h5", (4, 8), 10, 2, coat="coupled")
    with pytest.raises(InputError, match=r"coat.*coupled.*sum, as in the other tiles"):
        FittedTiles([tmp_path / "a.h5", tmp_path / "f.h5"], 8, 10)
    write_tile(tmp_path / "d.h5", (0, 4), 1, 3)  # its only column was not seen
    with pytest.raises(InputError, match=r"no texel with enough observations.*flip the faces of a mesh"):
        compress([tmp_path / "d.h5"], calibration, (4, 1), tmp_path / "m.h5")
    assert not (tmp_path / "m.h5").exists()


@pytest.mark.heavy
def test_memory_is_that_of_a_tile_and_a_sample(tmp_path, calibration):
    width, rows = 400, 40

    def peak(tiles):
        paths = [tmp_path / f"{tiles}-{i}.h5" for i in range(tiles)]
        for i, path in enumerate(paths):
            write_tile(path, (i * rows, (i + 1) * rows), width, i)
        size = (tiles * rows, width)
        tracemalloc.start()
        compress_reflectance(
            paths,
            calibration,
            made(Object | Surface, definition(*size)),
            tmp_path / "m.h5",
            options=CompressOptions(),
            lights=["D65"],
            provenance=PROVENANCE,
        )
        found = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return found

    peak(1)  # what is loaded late is there
    few, many = peak(5), peak(12)  # of five, the sample is full
    # 7 more tiles of 16000 texels; the maps that a material is made of take 25 numbers a texel, gathered are few.
    assert many - few <= 7 * rows * width * 4 * 8
