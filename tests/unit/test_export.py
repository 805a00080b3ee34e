"""Materials and environments in files of other programs: what was written is what is read."""

from dataclasses import replace

import numpy as np
import OpenImageIO as oiio
import pytest
from PIL import Image
from scenes import material
from spectral.io import envi

from benchmarks.written_pictures import spectra_in
from irodori.colour.colorimetry import delta_e, delta_e_reflectance, lab_from_xyz, xyz_from_radiance
from irodori.core import store
from irodori.core.errors import InputError
from irodori.export.export_command import main
from irodori.export.loss import Loss
from irodori.export.material_pictures import export_picture
from irodori.export.pictures import layer_names
from irodori.light.environment_file import Environment
from irodori.light.light_files import spectral_picture
from irodori.light.omnidirectional import from_panorama
from irodori.material.material_file import Material
from irodori.spectra.grid import WAVELENGTH_NM
from irodori.spectra.published import spectrum


def read(path):
    source = oiio.ImageInput.open(str(path))
    spec, pixels = source.spec(), source.read_image("float")
    source.close()
    return spec, pixels


@pytest.fixture
def files(tmp_path):
    rng = np.random.default_rng(1)
    paint = material(spectrum("TCS10"), beta=1.5, mu=0.2)
    paint.coefficients[:] = rng.uniform(0.2, 1.0, paint.coefficients.shape)
    paint.green_response[:] = rng.uniform(0.4, 0.6, paint.green_response.shape)
    paint.alpha[1, 2] = np.nan
    paint.save(tmp_path / "material.h5", store.Provenance("test"))
    coefficients = rng.uniform(0, 1, (70, 140, 3)).astype(np.float32)
    light = Environment(coefficients, rng.uniform(0.1, 1, (61, 3)), np.ones((4, 8, 3), np.float32))
    light.save(tmp_path / "light.h5", store.Provenance("test"))
    return tmp_path, paint, light


def diffuse(paint: Material) -> np.ndarray:
    """Return the diffuse reflectance as it is rendered, NaN without data, (height, width, 61)."""
    return (paint.alpha / paint.green_response)[..., None] * paint.spectra()


def test_a_material_comes_back_from_a_spectral_exr(files):
    folder, paint, _ = files
    export_picture(folder / "material.h5", folder / "out.exr")
    wavelength, reflectance = spectra_in(folder / "out.exr", "T")
    assert np.array_equal(wavelength, WAVELENGTH_NM)
    assert np.allclose(reflectance, diffuse(paint), rtol=1e-6, equal_nan=True)
    spec, pixels = read(folder / "out.exr")
    names = list(spec.channelnames)
    for name, values in (("alpha", paint.alpha), ("beta", paint.beta), ("mu", paint.mu)):
        assert np.allclose(pixels[..., names.index(name)], values, rtol=1e-6, equal_nan=True)
    assert spec.getattribute("spectralLayoutVersion") == "1.0"
    assert [p.name for p in sorted(folder.iterdir())] == ["light.h5", "material.h5", "out.exr"]


def stated_and_read(path, layers):
    """What a file states of its loss, and its spectra as other programs read them."""
    if path.suffix == ".img":
        opened = envi.open(str(path.with_suffix(".hdr")), str(path))
        return opened.metadata["description"], np.asarray(opened.open_memmap(interleave="bip"))
    spec, pixels = read(path)
    if path.suffix == ".tif":
        return spec.getattribute("ImageDescription"), pixels[..., 3:64]
    return f"irodori:loss {spec.getattribute('irodori:loss')}", spectra_in(path, layers)[1]


@pytest.mark.parametrize("suffix", [".exr", ".tif", ".img"])
def test_the_file_of_a_material_states_by_how_much_its_spectra_are_off(files, suffix):
    """The figures are those of what is read back, against the coefficients in double precision."""
    folder, *_ = files
    losses = export_picture(folder / "material.h5", folder / f"out{suffix}")
    stated, found = stated_and_read(folder / f"out{suffix}", "T")
    stored = Material.load(folder / "material.h5")
    exact = stored.spectrum_scale[..., None] * (stored.coefficients.astype(np.float64) @ stored.basis.T)
    off = delta_e_reflectance(exact, found.astype(np.float64))[stored.observed]
    assert f"irodori:loss {Loss.of(off).text}, spectra under D65" in stated
    # The libraries of linear algebra may add in another order: one part in a thousand million.
    assert list(losses) == ["spectra, under D65"] and 0.0 < off.max() < 1e-4
    assert losses["spectra, under D65"] == pytest.approx(Loss.of(off), rel=1e-6, abs=1e-12)


@pytest.mark.parametrize("suffix", [".exr", ".tif", ".img"])
def test_the_file_of_a_light_states_by_how_much_its_colours_are_off(files, suffix):
    """White is a perfect diffuser that faces up, whose light is the irradiance map's at its pole over pi."""
    folder, _, light = files
    losses = export_picture(folder / "light.h5", folder / f"out{suffix}")
    stated, found = stated_and_read(folder / f"out{suffix}", "S0")
    white = light.basis.sum(axis=1) / np.pi
    matrix = xyz_from_radiance(white)
    exact = light.coefficients.astype(np.float64) @ light.basis.T
    labs = [lab_from_xyz(one @ matrix.T, matrix @ white) for one in (exact, from_panorama(found.astype(np.float64)))]
    off = Loss.of(delta_e(*labs))
    assert losses["light of every direction"].text == off.text
    assert f"irodori:loss {off.text}, white is a diffuser that faces up" in stated
    assert 0.0 < off.largest < 1e-3


def test_the_file_of_a_light_that_reaches_no_diffuser_says_that_it_has_no_figure(files):
    folder, _, light = files
    replace(light, irradiance=np.zeros_like(light.irradiance)).save(folder / "below.h5", store.Provenance("test"))
    export_picture(folder / "below.h5", folder / "below.exr")
    assert stated_and_read(folder / "below.exr", "S0")[0].startswith("irodori:loss not measured: nothing lights a diff")


def test_an_environment_comes_back_as_the_same_light(files):
    folder, _, light = files
    export_picture(folder / "light.h5", folder / "out.exr")
    picture = spectral_picture(folder / "out.exr")
    expected = light.coefficients @ light.basis.T
    assert np.allclose(picture.weights @ picture.basis.T, expected, rtol=1e-5)
    assert read(folder / "out.exr")[0].getattribute("emissiveUnits") == "relative spectral radiance"


@pytest.mark.parametrize("suffix", [".tif", ".tiff"])
def test_a_tiff_holds_the_same_numbers_and_tells_its_channels(files, suffix):
    folder, paint, _ = files
    export_picture(folder / "material.h5", folder / f"out{suffix}")
    spec, pixels = read(folder / f"out{suffix}")
    assert pixels.shape == (4, 8, 67) and str(spec.format) == "float"
    assert np.allclose(pixels[..., 3:64], diffuse(paint), rtol=1e-6, equal_nan=True)
    told = spec.getattribute("ImageDescription")
    assert told.startswith("channels: R G B " + " ".join(layer_names("T")) + " alpha beta mu")


def read_flat(path, shape, interleave):
    """The numbers as the header's words lay them out, without the library that wrote them: (height, width, bands)."""
    height, width, bands = shape
    values = np.fromfile(path, np.float32)
    if interleave == "bsq":
        return values.reshape(bands, height, width).transpose(1, 2, 0)
    if interleave == "bil":
        return values.reshape(height, bands, width).transpose(0, 2, 1)
    return values.reshape(height, width, bands)


@pytest.mark.parametrize("interleave", ["bsq", "bil", "bip"])
def test_envi_holds_the_spectra_with_their_wavelengths_and_the_maps_beside(files, interleave):
    folder, paint, light = files
    export_picture(folder / "material.h5", folder / "out.img", interleave)
    header = envi.read_envi_header(str(folder / "out.hdr"))
    assert [float(w) for w in header["wavelength"]] == WAVELENGTH_NM.tolist()
    assert header["wavelength units"] == "Nanometers" and header["interleave"] == interleave
    assert (header["lines"], header["samples"], header["bands"], header["data type"]) == ("4", "8", "61", "4")
    assert "reflectance factor" in header["description"] and header["band names"][::60] == ["400 nm", "700 nm"]
    assert np.allclose(read_flat(folder / "out.img", (4, 8, 61), interleave), diffuse(paint), rtol=1e-6, equal_nan=True)
    maps = read_flat(folder / "out-maps.img", (4, 8, 3), interleave)
    for values, expected in zip(np.moveaxis(maps, -1, 0), (paint.alpha, paint.beta, paint.mu), strict=True):
        assert np.allclose(values, expected, rtol=1e-6, equal_nan=True)
    named = envi.read_envi_header(str(folder / "out-maps.hdr"))
    assert named["band names"] == ["alpha", "beta", "mu"] and "wavelength" not in named
    export_picture(folder / "light.h5", folder / "light.img", interleave)
    opened = envi.open(str(folder / "light.hdr"))
    expected = light.coefficients @ light.basis.T
    assert np.allclose(from_panorama(np.asarray(opened.load())), expected, rtol=1e-5)
    assert opened.bands.centers == WAVELENGTH_NM.tolist() and opened.bands.band_unit == "Nanometers"
    export_picture(folder / "light.h5", folder / "light.img", interleave)  # again, over what is there
    assert not [path for path in folder.iterdir() if "part" in path.name]


def test_an_interleave_is_one_of_envis_and_for_envi(files, capsys):
    folder, _, _ = files
    with pytest.raises(InputError, match=r"bpi.+bsq, bil, bip"):
        export_picture(folder / "material.h5", folder / "out.img", "bpi")
    with pytest.raises(InputError, match=r"suffix \.img"):
        export_picture(folder / "material.h5", folder / "out.exr", "bil")
    assert main([str(folder / "material.h5"), str(folder / "out.img"), "--interleave", "bsl"]) == 2
    assert "bsl" in capsys.readouterr().err
    assert not list(folder.glob("out*"))


def test_a_white_texel_is_white_in_rgb(tmp_path):
    material(1.0).save(tmp_path / "white.h5", store.Provenance("test"))
    export_picture(tmp_path / "white.h5", tmp_path / "white.exr")
    spec, pixels = read(tmp_path / "white.exr")
    rgb = pixels[..., [list(spec.channelnames).index(c) for c in "RGB"]]
    assert np.allclose(rgb, 1.0, atol=0.002)


def test_what_cannot_be_exported_is_refused_in_one_sentence(files, capsys):
    folder, _, _ = files
    with pytest.raises(InputError, match=r"'\.png'.*\.exr, \.tif"):
        export_picture(folder / "material.h5", folder / "out.png")
    with store.create(folder / "other.h5", store.Provenance("test")) as out:
        out.attribute("x", 1)
    with pytest.raises(InputError, match="neither a material nor an environment"):
        export_picture(folder / "other.h5", folder / "out.exr")
    assert main([str(folder / "none.h5"), str(folder / "out.exr")]) == 2
    assert "no such file" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["material.h5", "light.h5"])
def test_a_file_without_to_is_exported_with_its_loss_and_a_preview(files, capsys, name):
    folder, *_ = files
    assert main([str(folder / name), str(folder / "out.exr")]) == 0
    assert "CIEDE2000 mean" in capsys.readouterr().out
    with Image.open(folder / "out.exr.png") as preview:
        assert preview.size == ((8, 4) if name == "material.h5" else (140, 70)) and np.asarray(preview).std() > 5
