"""Files explain themselves: axes, units, codes and decoding are told by h5py and xarray alone."""

import re

import h5py
import numpy as np
import OpenImageIO as oiio
import pytest
import xarray as xr
from made_up_camera import training
from scenes import material, sky

from benchmarks.written_pictures import spectra_in
from irodori.calibration.estimators import fit
from irodori.core import store
from irodori.core.custody import accept
from irodori.core.errors import InputError
from irodori.core.units import require_unit
from irodori.export.pictures import picture_bands, read_xyz, write_spectral_exr
from irodori.light.gloss_maps import GlossMaps
from irodori.material.coefficients import read_coefficients, write_coefficients
from irodori.material.material_file import Material, NloptResult, Status
from irodori.spectra.coordinates import write_wavelength
from irodori.spectra.grid import WAVELENGTH_NM

PROVENANCE = store.Provenance("test")


def write_light(path) -> None:
    light = sky(lambda d: 2 + d[..., 2:], 32, 16)
    light.save(path, PROVENANCE, gloss=GlossMaps.of(light.coefficients), storage="half")


def write_calibration(path, name: str) -> None:
    with store.create(path, PROVENANCE) as out:
        fit(name, training(0.003), 6).write(out)


def write_material(path, **storage) -> None:
    material(np.linspace(0.1, 0.9, 61)).save(path, PROVENANCE, **storage)


WRITERS = {
    "material": write_material,
    "environment": write_light,
    "calibration": lambda path: write_calibration(path, "pinv"),
    "calibration-local": lambda path: write_calibration(path, "local"),
}


@pytest.mark.parametrize("name", WRITERS)
def test_xarray_names_every_axis_of_every_group(tmp_path, name):
    WRITERS[name](tmp_path / "a.h5")
    with xr.open_datatree(tmp_path / "a.h5", engine="h5netcdf") as tree:
        for group in tree.subtree:
            for one in group.data_vars.values():
                assert list(one.dims) == [axis for axis in one.attrs["dims"].split(",") if axis]
                assert one.attrs["units"] and one.attrs["quantity"]
                one.load()
        spectral = [group for group in tree.subtree if "wavelength" in group.dims]
        assert spectral
        for group in spectral:
            assert np.array_equal(group.coords["wavelength"], WAVELENGTH_NM)
        assert tree.attrs["units_vocabulary"].startswith("UCUM")


@pytest.mark.parametrize(
    "code", ["1", "nm", "mm", "deg", "rad", "sr", "1/s", "/s", "s-1", "W/m2/sr", "W.m-2", "{superpixel}", "1/{DN}",
             "{electron}/{DN}", "cd/m2", "Cel", "%", "min", "um"],
)  # fmt: skip
def test_codes_of_the_vocabulary_are_taken(code):
    require_unit(code)


@pytest.mark.parametrize(
    "code", ["", "px", "superpixel", "1/DN", "step", "degree", "°", "see quantities", "s,1", "1 / s", "nm^2", "µm",
             "{a b}", "mdeg", "m//s", "0", "{}"],
)  # fmt: skip
def test_a_unit_outside_the_vocabulary_is_refused_and_leaves_no_file(tmp_path, code):
    with (
        pytest.raises(ValueError, match="accepted: a code of UCUM"),
        store.create(tmp_path / "a.h5", PROVENANCE) as out,
    ):
        out.write("a", np.zeros(3), units=code, dims="row", quantity="a")
    assert list(tmp_path.iterdir()) == []


def test_codes_are_an_enumeration_that_h5py_and_netcdf_readers_can_name(tmp_path):
    codes = np.array([[Status.OK, Status.PAINT], [Status.DARK, Status.OK]], np.int8)
    with store.create(tmp_path / "a.h5", PROVENANCE) as out:
        out.write("status", codes, units=Status, dims="row,column", quantity="outcome of the fit")
        out.write("nlopt", codes - 5, units=NloptResult, dims="row,column", quantity="return code")
        out.write("mask", np.zeros((200, 2), np.uint8), units=store.Mask, dims="long,column", quantity="whether")
    with h5py.File(tmp_path / "a.h5") as file:
        meanings = h5py.check_enum_dtype(file["status"].dtype)
        assert meanings == {status.name: status.value for status in Status}
        assert h5py.check_enum_dtype(file["nlopt"].dtype)["INVALID_ARGS"] == -2
        assert h5py.check_enum_dtype(file["mask"].dtype) == {"NO": 0, "YES": 1}
    with xr.open_dataset(tmp_path / "a.h5", engine="h5netcdf") as opened:
        named = dict(zip(opened.status.attrs["flag_values"], opened.status.attrs["flag_meanings"].split(), strict=True))
        assert [named[code] for code in opened.status.values.ravel()] == ["ok", "paint", "dark", "ok"]
    with store.open_file(tmp_path / "a.h5") as file:
        assert np.array_equal(file.read("status"), codes) and file.read("status").dtype.metadata is None


def test_a_coded_number_without_a_name_is_no_whole_number_and_is_refused(tmp_path):
    with pytest.raises(TypeError), store.create(tmp_path / "a.h5", PROVENANCE) as out:
        out.write("status", np.zeros(3), units=Status, dims="row", quantity="outcome")


@pytest.mark.parametrize(
    ("written", "found"),
    [
        ([("a", (3, 4), "row,column"), ("b", (3, 5), "row,column")], "b: 5 along column; accepted: 4"),
        ([("a", (3, 3), "row,row")], "a: 2 axes but dims 'row,row'"),
        ([("row", (3, 4), "row,column")], "the axis row has the name of a dataset"),
        ([("a", (61,), "wavelength")], "wavelength without its values"),
    ],
)
def test_axes_that_a_reader_could_mistake_are_refused(tmp_path, written, found):
    with pytest.raises(ValueError, match=found), store.create(tmp_path / "a.h5", PROVENANCE) as out:
        for name, shape, dims in written:
            out.write(name, np.zeros(shape), units="1", dims=dims, quantity="a")
    assert list(tmp_path.iterdir()) == []


def test_the_same_content_gives_the_same_bytes(tmp_path):
    contents = []
    for _ in range(2):
        write_light(tmp_path / "a.h5")
        contents.append((tmp_path / "a.h5").read_bytes())
    assert contents[0] == contents[1]


@pytest.mark.parametrize("storage", ["half", "single"])
@pytest.mark.parametrize("codec", ["gzip", "lzf"])
def test_plain_h5py_decodes_spectra_by_what_the_file_says(tmp_path, storage, codec):
    """The sentence in the file names the datasets, their axes and what is done with them."""
    rng = np.random.default_rng(2)
    coefficients, basis = rng.normal(size=(40, 30, 3)).astype(np.float32), rng.normal(size=(61, 3))
    with store.create(tmp_path / "a.h5", PROVENANCE) as out:
        write_wavelength(out)
        out.write("own/basis", basis, units="1", dims="wavelength,component", quantity="basis")
        names = {"quantity": "coefficients", "storage": storage, "codec": codec, "basis": "own/basis"}
        write_coefficients(out, "own/coefficients", coefficients, **names)
    with h5py.File(tmp_path / "a.h5") as file:
        made, of = file["own/coefficients"].attrs["decoding"].split(" = sum over component of ")
        factors = [re.fullmatch(r"(/[\w/]+)\[([\w,]+)\]", factor).groups() for factor in of.split(" * ")]
        axes = {"row": "r", "column": "c", "component": "k", "wavelength": "w"}
        letters = [",".join(axes[axis] for axis in dims.split(",")).replace(",", "") for _, dims in factors]
        sum_over = ",".join(letters) + "->rcw"
        decoded = np.einsum(sum_over, *(file[name][()].astype(float) for name, _ in factors))
        assert made == "spectrum[row,column,wavelength]"
        assert ("packing" in file.attrs) == (codec == "lzf")
    assert np.abs(decoded - coefficients @ basis.T).max() < (5e-3 if storage == "half" else 1e-5)


def test_data_packed_by_a_missing_plugin_is_refused_in_words_that_name_the_package(tmp_path):
    path = tmp_path / "old.h5"
    with store.create(path, PROVENANCE) as out:
        out.write("beta", np.zeros(3), units="1", dims="row", quantity="x")
    with h5py.File(path, "a") as file:
        packed = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        packed.set_chunk((100,))
        # A number that no filter has; optional, so that this program can write without it.
        packed.set_filter(509, h5py.h5z.FLAG_OPTIONAL, ())
        space = h5py.h5s.create_simple((100,))
        h5py.h5d.create(file.id, b"alpha", h5py.h5t.IEEE_F32LE, space, packed)
    accept(path)
    with store.open_file(path) as file, pytest.raises(InputError, match=r"filter 509.*the package hdf5plugin"):
        file.read("alpha")


# ---- half precision


@pytest.mark.stability(stage="store", case="a picture beyond half precision")
@pytest.mark.parametrize("top", [1e-30, 1e-9, 1e-3, 1.0, 60000.0, 65504.0, 65520.0, 1e9, 1e30])
def test_a_picture_of_any_brightness_is_rounded_to_a_part_in_2048(tmp_path, top):
    """Down to four parts in a thousand million of its largest number, and the rest by no more than that allows."""
    rng = np.random.default_rng(5)
    radiance = (top * 10.0 ** rng.uniform(-6, 0, (9, 7, 61))).astype(np.float32)
    radiance[0, 0] = top
    write_spectral_exr(tmp_path / "a.exr", radiance, radiance[..., :3], {})
    found = spectra_in(tmp_path / "a.exr")[1]
    assert np.isfinite(found).all()
    assert np.abs(found.astype(float) - radiance).max() <= 2.0**-11 * top
    within = radiance > 1e-4 * top
    assert np.abs(found / radiance - 1)[within].max() <= 2.0**-11 * 1.001
    assert np.abs(found / radiance - 1).max() <= 2.0**-5


def test_a_picture_that_half_precision_cannot_span_is_stored_whole(tmp_path):
    radiance = np.full((4, 4, 61), 1e-3, np.float32)
    radiance[0, 0] = 1e12
    write_spectral_exr(tmp_path / "a.exr", radiance, radiance[..., :3], {})
    assert np.array_equal(spectra_in(tmp_path / "a.exr")[1], radiance)


def test_what_is_no_number_stays_none_and_nothing_else_becomes_one(tmp_path):
    radiance = np.full((4, 4, 61), 1e7, np.float32)
    radiance[1, 1], radiance[2, 2] = np.nan, np.inf
    write_spectral_exr(tmp_path / "a.exr", radiance, radiance[..., :3], {})
    found = spectra_in(tmp_path / "a.exr")[1]
    assert np.array_equal(np.isnan(found), np.isnan(radiance)) and np.array_equal(np.isinf(found), np.isinf(radiance))
    usual = np.isfinite(radiance)
    assert found[usual] == pytest.approx(radiance[usual], rel=2.0**-11)


@pytest.mark.parametrize("level", [1e-8, 1e9])
def test_colours_beside_scaled_spectra_are_not_scaled(tmp_path, level):
    """Programs that know of no scale show red, green and blue, and dark spectra keep their digits beside them."""
    rng = np.random.default_rng(3)
    radiance = (level * rng.uniform(0.1, 1.0, (8, 8, 61))).astype(np.float32)
    rgb = rng.uniform(0.0, 1.1, (8, 8, 3))
    rgb[0, 0] = 1e6
    write_spectral_exr(tmp_path / "a.exr", radiance, rgb, {})
    kept = np.where(rgb > 1e5, 65504.0, rgb)
    # As any program reads it, and as this package does.
    stored = oiio.ImageBuf(str(tmp_path / "a.exr")).get_pixels(oiio.FLOAT)[..., :3]
    own = np.concatenate([band[..., :3] for _, band in picture_bands(tmp_path / "a.exr", 4)])
    for found in (stored, own):
        np.testing.assert_allclose(found, kept, rtol=2.0**-11, atol=1e-7)
    np.testing.assert_allclose(spectra_in(tmp_path / "a.exr")[1], radiance, rtol=2.0**-11)


@pytest.mark.parametrize("scale", ["3", "0", "-2", "nan", "inf", "much"])
def test_a_scale_that_is_no_power_of_two_is_refused(tmp_path, scale):
    radiance = np.ones((4, 4, 61), np.float32)
    write_spectral_exr(tmp_path / "a.exr", radiance, radiance[..., :3], {"irodori:scale": scale})
    with pytest.raises(InputError, match=r"irodori:scale: found .*accepted: a power of two"):
        read_xyz(tmp_path / "a.exr", np.ones((3, 61)))


def test_blurred_light_is_kept_in_half_precision(tmp_path):
    light = sky(lambda d: 1e6 * (2 + d[..., 2:]), 64, 32)
    gloss = GlossMaps.of(light.coefficients)
    light.save(tmp_path / "e.h5", PROVENANCE, gloss=gloss, storage="half")
    for level, original in zip(GlossMaps.load(tmp_path / "e.h5").levels, gloss.levels, strict=True):
        assert level.dtype == np.float32 and 0.0 < np.abs(level - original).max() <= 2.0**-11 * np.abs(original).max()


def test_an_axis_beyond_three_is_read_as_it_was_written(tmp_path):
    radiance = np.random.default_rng(1).gamma(1.0, 1.0, (2, 20, 30, 61)).astype(np.float32)
    with store.create(tmp_path / "r.h5", PROVENANCE) as out:
        write_wavelength(out)
        names = {"quantity": "radiance", "storage": "half", "codec": "lzf", "dims": "half,row,column,wavelength"}
        write_coefficients(out, "radiance", radiance, **names)
    with store.open_file(tmp_path / "r.h5") as file:
        assert read_coefficients(file, "radiance") == pytest.approx(radiance, rel=2.0**-11, abs=1e-7)


# ---- open_material


def large_material(path, side: int = 600) -> np.ndarray:
    """Write a material of random colours that no codec makes small, and return its spectra."""
    rng = np.random.default_rng(3)
    one = rng.uniform(0.2, 0.8, (side, side))
    coefficients = rng.uniform(0.1, 0.2, (side, side, 4)).astype(np.float32)
    made = Material(
        alpha=one, beta=one, mu=one, green_response=one, coefficients=coefficients, basis=np.eye(61)[:, :4] + 0.5,
        n=np.full(61, 1.5), k=np.zeros(61), mirror=0.0, typical_gloss=(0.5, 0.1),
        extra={"status": (np.full((side, side), Status.PAINT, np.int8), Status, "outcome of the fit")},
    )  # fmt: skip
    made.save(path, PROVENANCE, {"pixels": side * side}, storage="half")
    return made.spectra()


def bytes_read() -> int:
    with open("/proc/self/io", encoding="ascii") as file:
        return int(next(line for line in file if line.startswith("rchar")).split()[1])


def test_a_material_is_opened_without_reading_it_and_decoded_where_it_is_asked_for(tmp_path):
    import irodori

    path = tmp_path / "material.h5"
    truth = large_material(path)
    irodori.open_material(path).close()  # imports
    before = bytes_read()
    with irodori.open_material(path) as opened:
        assert bytes_read() - before < 0.02 * path.stat().st_size
        assert opened.reflectance.dims == ("row", "column", "wavelength") and opened.reflectance.shape == truth.shape
        assert opened.attrs["lobes"] == ["gaussian"] and opened.attrs["errors"] == {"pixels": truth.shape[0] ** 2}
        green = opened.reflectance.sel(wavelength=550.0)
        assert bytes_read() - before < 0.02 * path.stat().st_size
        assert np.abs(green.values - truth[..., 30]).max() < 1e-3
        some = opened.reflectance[[3, 500], 7:2:-2, ::20]
        assert np.abs(some.values - truth[[3, 500], 7:2:-2, ::20]).max() < 1e-3
        assert opened.reflectance[4, 5, 6].values == pytest.approx(truth[4, 5, 6], abs=1e-3)
        assert opened.reflectance.isel(row=slice(5, 5)).values.shape == (0, *truth.shape[1:])
        assert opened.status.attrs["flag_meanings"].split()[Status.PAINT] == "paint" and (opened.status == 8).all()
        assert opened.refractive_index_n.dims == ("wavelength",) and float(opened.refractive_index_n[0]) == 1.5
        assert opened.alpha.attrs["units"] == "1" and opened.wavelength.attrs["units"] == "nm"


def test_a_material_that_was_changed_is_refused_with_its_first_number(tmp_path):
    import irodori

    path = tmp_path / "material.h5"
    large_material(path, 80)
    content = bytearray(path.read_bytes())
    with h5py.File(path) as file:
        content[file["alpha"].id.get_chunk_info(0).byte_offset + 9] ^= 1
    path.write_bytes(content)
    with irodori.open_material(path) as opened, pytest.raises(InputError, match="content that its rule did not write"):
        opened.mu[0, 0].load()


def test_what_is_no_material_is_refused_at_once(tmp_path):
    import irodori

    write_light(tmp_path / "e.h5")
    with pytest.raises(InputError, match="reflectance/coefficients: found no such dataset"):
        irodori.open_material(tmp_path / "e.h5")
    with pytest.raises(InputError, match="no such file"):
        irodori.open_material(tmp_path / "absent.h5")


def test_without_xarray_one_sentence_says_how_to_have_it(tmp_path, monkeypatch):
    import irodori

    monkeypatch.setitem(__import__("sys").modules, "xarray", None)
    with pytest.raises(ImportError, match=r"pip install 'irodori\[xarray\]'"):
        irodori.open_material(tmp_path / "a.h5")


def test_the_package_offers_no_other_names():
    import irodori

    with pytest.raises(AttributeError, match="close_material"):
        _ = irodori.close_material
