"""Environments from other programs' files, placed lights and mirror balls: energy, colour, direction."""

import tracemalloc
from collections.abc import Sequence

import numpy as np
import OpenImageIO as oiio
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made import made
from scenes import DATA

from benchmarks.written_pictures import spectra_in
from irodori.colour.colorimetry import colour_matching_weights, delta_e, lab_from_xyz, spectral_rmse
from irodori.config.models import IrradianceMap, LightsSource, PlacedLight, RgbSource, Size, SpectralSource
from irodori.core import store
from irodori.core.errors import InputError
from irodori.export.pictures import layer_names, write_spectral_exr
from irodori.light.environment_file import Environment, directions, row_solid_angles
from irodori.light.irradiance import Integrator
from irodori.light.light_files import mallett_basis, rgb_picture, spectral_picture
from irodori.light.omnidirectional import BAND_ROWS, OmnidirectionalPicture, bands, from_panorama, to_panorama
from irodori.light.placed_lights import direction_of, lights_picture, unit_luminance
from irodori.light.stage import make_environment, write_environment
from irodori.material.principal_components.basis_count import CompressOptions
from irodori.spectra.grid import WAVELENGTH_NM
from irodori.spectra.published import light, spectrum
from irodori.spectra.resampling import resample_picture

OPTIONS = (
    CompressOptions(target_delta_e_mean=0.1, target_delta_e_p99=np.inf, align=4, storage="single"),
    IrradianceMap(max_error=0.002, max_height=64),
    store.Provenance("test"),
)
EXACT = CompressOptions(target_delta_e_mean=0.0, target_delta_e_p99=np.inf, align=4, storage="single")


def write_exr(path, pixels, names=("R", "G", "B"), kind="float", shown=None, chromaticities=None):
    spec = oiio.ImageSpec(pixels.shape[1], pixels.shape[0], len(names), kind)
    spec.channelnames = tuple(names)
    if shown is not None:
        spec.full_height, spec.full_width = shown
    if chromaticities is not None:
        spec.attribute("chromaticities", oiio.TypeDesc("float[8]"), chromaticities)
    output = oiio.ImageOutput.create(str(path))
    assert output.open(str(path), spec) and output.write_image(np.ascontiguousarray(pixels, dtype=np.float32))
    output.close()
    return path


# --- which way round -----------------------------------------------------------------------------------------------


@given(width=st.integers(1, 40).map(lambda half: 2 * half), seed=st.integers(0, 99))
@settings(deadline=None, max_examples=30)
def test_a_panorama_comes_back_as_it_was(width, seed):
    picture = np.random.default_rng(seed).uniform(0, 1, (3, width, 2)).astype(np.float32)
    assert np.array_equal(from_panorama(to_panorama(picture)), picture)


def test_a_panorama_is_what_one_sees_when_turning_to_the_right():
    panorama = np.zeros((1, 8, 1), np.float32)
    panorama[0, 5] = 1.0  # right of the middle, whose azimuth is 0: clockwise from above, so y is negative
    here = directions(8, 1)[0][0, from_panorama(panorama)[0, :, 0].argmax()]
    assert here[0] > 0 and here[1] < 0
    turned = directions(8, 1)[0][0, from_panorama(panorama, 90.0)[0, :, 0].argmax()]
    assert np.allclose(turned, [-here[1], here[0], here[2]])


def test_a_turn_between_columns_keeps_the_light():
    panorama = np.random.default_rng(1).uniform(0, 1, (2, 12, 1)).astype(np.float32)
    turned = from_panorama(panorama, 10.0)
    assert np.allclose(turned.sum(axis=1), panorama.sum(axis=1), rtol=1e-6)
    assert np.allclose(from_panorama(panorama[:, :7], 33.0).sum(axis=1), panorama[:, :7].sum(axis=1), rtol=1e-6)


# --- RGB -----------------------------------------------------------------------------------------------------------


def xyz(spectra):
    """XYZ of light, D65 as tabulated having Y = 1."""
    weights = colour_matching_weights()
    return spectra @ weights.T / (weights[1] @ light("D65"))


def test_upsampled_colours_are_those_of_the_picture():
    rgb = np.random.default_rng(2).uniform(0, 1, (500, 3)) ** 2
    from colour import RGB_COLOURSPACES

    expected = rgb @ RGB_COLOURSPACES["sRGB"].matrix_RGB_to_XYZ.T
    white = RGB_COLOURSPACES["sRGB"].matrix_RGB_to_XYZ.sum(axis=1)
    found = xyz(rgb @ mallett_basis().T)
    error = delta_e(lab_from_xyz(expected, white), lab_from_xyz(found, white))
    assert error.mean() <= 0.3 and error.max() <= 1.5
    assert (mallett_basis() >= 0).all()
    assert np.allclose(mallett_basis().sum(axis=1), light("D65"), rtol=1e-3)


def test_negative_values_are_set_to_nothing_and_counted(tmp_path):
    pixels = np.full((4, 8, 3), 0.5, np.float32)
    pixels[1, 2, 0] = -0.25
    pixels[3, 7] = -1.0
    picture = rgb_picture(write_exr(tmp_path / "a.exr", pixels), scale=2.0)
    weights = picture.weights
    assert (weights >= 0).all() and weights.max() == 1.0
    assert picture.weights.sum() == pytest.approx(2.0 * np.maximum(pixels, 0).sum())
    # Read twice, counted once.
    assert picture.origin["negative_pixels"] == 2 and "Mallett" in picture.origin["assumption"]
    assert picture.origin["negative_sum_over_positive"] == pytest.approx(3.25 / np.maximum(pixels, 0).sum())


def test_pictures_that_are_no_light_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"none\.exr"):
        rgb_picture(tmp_path / "none.exr")
    with pytest.raises(InputError, match="no channel R"):
        rgb_picture(write_exr(tmp_path / "y.exr", np.ones((4, 8, 1)), ["Y"]))
    display = oiio.ImageBuf(oiio.ImageSpec(8, 4, 3, "uint8"))
    assert display.write(str(tmp_path / "display.png"))
    with pytest.raises(InputError, match="made for a display"):
        rgb_picture(tmp_path / "display.png")
    broken = np.ones((4, 8, 3), np.float32)
    broken[2, 2] = np.inf
    with pytest.raises(InputError, match="1 pixel without a finite value"):
        _ = rgb_picture(write_exr(tmp_path / "inf.exr", broken)).weights


def test_a_part_of_a_panorama_and_other_primaries_are_refused(tmp_path):
    pixels = np.ones((8, 16, 3))
    with pytest.raises(InputError, match="16 x 8 pixels of a picture of 20 x 10"):
        rgb_picture(write_exr(tmp_path / "cut.exr", pixels, shown=(10, 20)))
    acescg = (0.713, 0.293, 0.165, 0.830, 0.128, 0.044, 0.32168, 0.33767)
    with pytest.raises(InputError, match=r"0\.713.*linear sRGB"):
        rgb_picture(write_exr(tmp_path / "acescg.exr", pixels, chromaticities=acescg))
    srgb = (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329)
    assert rgb_picture(write_exr(tmp_path / "srgb.exr", pixels, chromaticities=srgb)).size == (8, 16)


def test_what_cannot_be_all_directions_is_refused(tmp_path):
    layers = [f"S0.{nm},0nm" for nm in range(400, 701, 20)]
    for size in ((4, 4), (4, 6), (4, 12)):
        for reader, names in ((rgb_picture, ("R", "G", "B")), (spectral_picture, layers)):
            path = write_exr(tmp_path / "p.exr", np.ones((*size, len(names))), names)
            with pytest.raises(InputError, match=r"p\.exr.*twice as wide as high"):
                reader(path)
    assert rgb_picture(write_exr(tmp_path / "p.exr", np.ones((100, 201, 3)))).size == (100, 201)


@pytest.mark.parametrize("name", ["lobby", "hall", "workshop", "museum"])
def test_measured_places_become_environments(tmp_path, name):
    path = DATA / "environments" / f"{name}.exr"
    if not path.is_file():
        pytest.skip(f"no picture at {path}")
    picture = rgb_picture(path)
    weights = picture.weights
    assert weights.shape == (256, 512, 3) and (weights >= 0).all()
    assert (picture.origin["negative_pixels"] > 0) == (name != "museum")
    assert picture.origin["negative_sum_over_positive"] < 0.05 and picture.origin["warnings"] == []


def test_an_rgb_environment_in_a_file(tmp_path):
    rng = np.random.default_rng(3)
    write_exr(tmp_path / "a.exr", rng.uniform(0, 1, (16, 32, 3)))
    source = {"kind": "rgb", "file": str(tmp_path / "a.exr"), "scale": 1.0, "centre_azimuth_deg": 0.0}
    make_environment(
        made(RgbSource | SpectralSource | LightsSource, source),
        None,
        tmp_path / "e.h5",
        *OPTIONS,
        gloss_maps=True,
    )
    found = Environment.load(tmp_path / "e.h5")
    expected = rgb_picture(tmp_path / "a.exr")
    truth = expected.weights @ expected.basis.T
    assert np.abs(found.coefficients @ found.basis.T - truth).max() <= 0.02 * truth.max()
    with store.open_file(tmp_path / "e.h5") as file:
        assert "assumption" in file.attribute("origin")
        assert "gloss/width" in file


def test_a_panorama_whose_pixels_are_too_large_is_refused(tmp_path):
    """Under even light of 8 rows, irradiance is up to 2 % off; of one row, it is between 0 and twice what it should."""
    write_exr(tmp_path / "a.exr", np.full((8, 16, 3), 0.5))
    source = {"kind": "rgb", "file": str(tmp_path / "a.exr"), "scale": 1.0, "centre_azimuth_deg": 0.0}
    with pytest.raises(InputError, match=r"a\.exr: found 16 x 8 pixels; accepted: 32 x 16 pixels or more"):
        make_environment(made(RgbSource | SpectralSource | LightsSource, source), None, tmp_path / "e.h5", *OPTIONS)


def test_an_unknown_kind_of_light_is_refused(tmp_path):
    with pytest.raises(ValueError, match="kinds rgb, spectral, lights"):
        make_environment(
            made(RgbSource | SpectralSource | LightsSource, {"kind": "captures"}),
            None,
            tmp_path / "e.h5",
            *OPTIONS,
        )


def test_placed_lights_need_the_size_of_their_picture(tmp_path):
    lights = [{"spectrum": "A", "azimuth_deg": 20.0, "elevation_deg": 50.0, "diameter_deg": 0.0, "irradiance": 1.0}]
    source = made(RgbSource | SpectralSource | LightsSource, {"kind": "lights", "lights": lights})
    with pytest.raises(ValueError, match="accepted: image"):
        make_environment(source, None, tmp_path / "e.h5", *OPTIONS)


# --- spectral EXR --------------------------------------------------------------------------------------------------


def test_our_own_spectral_picture_keeps_its_spectra(tmp_path):
    radiance = np.random.default_rng(4).gamma(1.0, 1.0, (6, 12, 61)).astype(np.float32)
    write_spectral_exr(tmp_path / "a.exr", to_panorama(radiance), radiance[..., :3], {})
    picture = spectral_picture(tmp_path / "a.exr", scale=3.0)
    assert np.allclose(picture.weights @ picture.basis.T, 3.0 * radiance, rtol=2.0**-11)


@pytest.mark.parametrize("unit", ["nm", "um", "THz"])
def test_any_wavelengths_and_units_of_the_layout(tmp_path, unit):
    wavelength = np.arange(380.0, 731.0, 10.0)
    name = {
        "nm": lambda w: f"S0.{w:.3f}nm",
        "um": lambda w: f"S0.{w / 1000:.6f}um",
        "THz": lambda w: f"S0.{299792.458 / w:.9f}THz",
    }[unit]
    names = [name(w).replace(".", ",").replace("S0,", "S0.") for w in wavelength]
    line = 2.0 + wavelength / 700
    pixels = np.tile(line, (3, 6, 1))
    shuffled = np.random.default_rng(1).permutation(len(names))
    write_exr(tmp_path / "a.exr", pixels[..., shuffled], [names[i] for i in shuffled])
    picture = spectral_picture(tmp_path / "a.exr")
    assert np.allclose(picture.weights @ picture.basis.T, 2.0 + WAVELENGTH_NM / 700, rtol=1e-4)
    assert picture.origin["wavelengths_nm"] == pytest.approx([380.0, 730.0, 36])


def test_a_fine_picture_keeps_the_power_of_its_lines():
    wavelength = np.arange(390.0, 711.0, 1.0)
    pixels = np.exp(-(((wavelength - 546.0) / 1.5) ** 2)).astype(np.float32).reshape(1, 1, -1)
    out = resample_picture(wavelength, pixels, "a.exr")
    assert out.sum() * 5 == pytest.approx(pixels.sum(), rel=0.01)


@pytest.mark.stability(stage="environment", case="duplicate wavelengths")
def test_spectral_pictures_that_are_no_light_are_refused(tmp_path):
    with pytest.raises(InputError, match="kind S0 among T"):
        spectral_picture(write_exr(tmp_path / "t.exr", np.ones((2, 4, 2)), ["T.400,0nm", "T.700,0nm"]))
    with pytest.raises(InputError, match="500 nm twice"):
        spectral_picture(write_exr(tmp_path / "d.exr", np.ones((2, 4, 2)), ["S0.500,0nm", "S0.500nm"]))
    names = [f"S0.{w},0nm" for w in range(450, 651, 10)]
    with pytest.raises(InputError, match="400"):
        spectral_picture(write_exr(tmp_path / "s.exr", np.ones((2, 4, len(names))), names))


def test_another_programs_chart_is_read_and_brought_to_the_grid():
    path = DATA / "spectral" / "macbeth_chart_36_bands.exr"
    if not path.is_file():
        pytest.skip(f"no picture at {path}")
    wavelength, pixels = spectra_in(path, "T")
    assert len(wavelength) == 36 and wavelength[0] == 380 and wavelength[-1] == 730
    out = resample_picture(wavelength, pixels, path)
    assert out.shape == (400, 600, 61) and out.min() >= 0 and out.max() < 1
    assert np.allclose(out[..., ::2], pixels[..., 2:33], atol=1e-5)
    with pytest.raises(InputError, match="kind S0"):
        spectral_picture(path)


@pytest.mark.stability(stage="environment", case="a picture cut short")
@pytest.mark.parametrize("tiled", [0, 16, 64])
def test_a_picture_is_read_in_bands_that_make_it_whole(tmp_path, tiled):
    pixels = np.random.default_rng(6).uniform(0, 1, (75, 150, 3)).astype(np.float32)
    spec = oiio.ImageSpec(150, 75, 3, "float")
    spec.x, spec.y = 7, -20  # a data window of its own
    if tiled:
        spec.tile_width, spec.tile_height = 64, tiled
    output = oiio.ImageOutput.create(str(tmp_path / "a.exr"))
    assert output.open(str(tmp_path / "a.exr"), spec)
    assert output.write_image(pixels) and output.close()
    picture = rgb_picture(tmp_path / "a.exr")
    assert picture.size == (75, 150)
    assert np.array_equal(picture.weights, from_panorama(pixels))
    assert max(len(band) for band in picture) <= BAND_ROWS
    whole = (tmp_path / "a.exr").read_bytes()
    (tmp_path / "a.exr").write_bytes(whole[: len(whole) * 2 // 3])
    with pytest.raises(InputError, match=r"ends within rows|cannot open"):
        _ = rgb_picture(tmp_path / "a.exr").weights


@pytest.mark.heavy
def test_the_memory_for_an_environment_does_not_grow_with_its_spectra(tmp_path):
    size, spectra = (1200, 1200), np.stack([spectrum(f"TCS{i}") for i in range(99)]).astype(np.float32)

    def read():
        for rows in bands(size[0]):
            first = np.arange(rows.start, rows.stop)[:, None] // 40 + np.arange(size[1]) // 60
            yield spectra[first % 99]

    picture = OmnidirectionalPicture(size, np.eye(61), read)
    tracemalloc.start()
    write_environment(
        picture,
        None,
        tmp_path / "e.h5",
        CompressOptions(),
        made(IrradianceMap, {"max_error": 0.1, "max_height": 32}),
        store.Provenance("test"),
    )
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    found = Environment.load(tmp_path / "e.h5")
    expected = picture.weights
    # The 61 planes take 351 MB; a sample of 65536 pixels of them and k planes are held.
    assert expected.nbytes > 340e6 and peak < 0.6 * expected.nbytes
    assert spectral_rmse(found.coefficients[::50] @ found.basis.T, expected[::50]).mean() < 0.01


@pytest.mark.stability(stage="environment", case="not finite radiance")
@pytest.mark.stability(stage="environment", case="all-black")
def test_light_that_is_not_finite_is_refused_and_black_light_is_black(tmp_path):
    def picture(values):
        return OmnidirectionalPicture(values.shape[:2], np.ones((61, 1)), lambda: iter([values]), "a.h5")

    broken = np.ones((8, 16, 1), np.float32)
    broken[2, 3] = np.nan
    with pytest.raises(InputError, match="1 pixel without a finite value"):
        write_environment(picture(broken), None, tmp_path / "e.h5", *OPTIONS)
    assert not (tmp_path / "e.h5").exists()
    write_environment(picture(0 * np.ones_like(broken)), None, tmp_path / "e.h5", *OPTIONS, gloss_maps=True)
    found = Environment.load(tmp_path / "e.h5")
    assert (found.coefficients == 0).all() and (found.irradiance == 0).all() and (found.upward_white() == 0).all()


@pytest.mark.stability(stage="environment", case="a light of 1e6:1")
@pytest.mark.parametrize("storage", ["half", "single"])
def test_a_light_of_a_million_to_one_keeps_its_shadows_in_the_file(tmp_path, storage):
    rng = np.random.default_rng(9)
    sky = rng.uniform(0.5, 1.0, (1, 300, 3)).astype(np.float32)  # a picture of one row
    sky[0, 17] = 1e6
    options = CompressOptions(storage=storage)
    picture = OmnidirectionalPicture((1, 300), mallett_basis(), lambda: iter([sky]))
    write_environment(picture, None, tmp_path / "e.h5", options, *OPTIONS[1:])
    found = Environment.load(tmp_path / "e.h5")
    expected = sky @ mallett_basis().T.astype(np.float32)
    error = np.abs(found.coefficients @ found.basis.T - expected).max(axis=-1) / expected.max(axis=-1)
    assert error.max() <= (0.005 if storage == "half" else 1e-4)


# --- placed lights -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("diameter", [0.0, 0.5, 3.0, 20.0, 90.0])
@pytest.mark.parametrize(
    "where", [(30.0, 40.0), (0.0, 90.0), (123.0, -90.0), (-0.1, 0.0), (359.9, 0.0), (180.0, -60.0)]
)
def test_placed_lights_keep_their_energy(diameter, where):
    one = {"spectrum": "A", "azimuth_deg": where[0], "elevation_deg": where[1], "diameter_deg": diameter}
    width, height = 120, 60
    unit, solid_angle = directions(width, height)[0], row_solid_angles(width, height)[:, None]
    facing = lights_picture(made(Sequence[PlacedLight], [{**one, "irradiance": 2.0}]), width, height)
    found = Integrator(facing.weights)(direction_of(*where)[None])[0, 0]
    assert found / np.pi == pytest.approx(2.0, rel=0.002)  # a diffuser of radiance 2
    if diameter > 0:
        glowing = lights_picture(made(Sequence[PlacedLight], [{**one, "radiance": 3.0}]), width, height)
        disc = 2 * np.pi * (1 - np.cos(np.radians(diameter / 2)))
        assert (glowing.weights[..., 0] * solid_angle).sum() == pytest.approx(3.0 * disc, rel=1e-5)
        if diameter >= 20:
            assert glowing.weights.max() == pytest.approx(3.0, rel=0.02)
    centre = (unit * (facing.weights[..., 0] * solid_angle)[..., None]).sum(axis=(0, 1))
    assert centre @ direction_of(*where) >= np.cos(np.radians(0.2)) * np.linalg.norm(centre)


@pytest.mark.parametrize(
    ("size", "diameter"), [((80, 160), 4.0), ((41, 60), 25.0), ((80, 160), 130.0), ((41, 60), 300.0)]
)
@pytest.mark.parametrize("where", [(30.0, 40.0), (5.0, 88.0), (359.0, 0.0), (200.0, -70.0)])
def test_a_disc_is_every_pixels_share_of_it(size, diameter, where):
    """Of 16 x 16 places in each pixel, by solid angle; a pixel is as bright as the part of it that the disc covers."""
    height, width = size
    towards, steps = direction_of(*where), (np.arange(16) + 0.5) / 16
    theta = np.pi * (np.arange(height)[:, None, None, None] + steps[:, None]) / height
    azimuth = 2 * np.pi * (np.arange(width)[:, None, None] + steps) / width
    cosine = np.sin(theta) * (np.cos(azimuth) * towards[0] + np.sin(azimuth) * towards[1]) + np.cos(theta) * towards[2]
    weight = np.sin(theta) + 0.0 * azimuth
    share = ((cosine > np.cos(np.radians(diameter / 2))) * weight).sum(axis=(2, 3)) / weight.sum(axis=(2, 3))
    light = {"spectrum": "A", "azimuth_deg": where[0], "elevation_deg": where[1], "diameter_deg": diameter}
    found = lights_picture(made(Sequence[PlacedLight], [{**light, "radiance": 3.0}]), width, height).weights[..., 0]
    solid_angle = row_solid_angles(width, height)[:, None]
    disc = 4.0 * np.pi * np.sin(np.radians(diameter / 4)) ** 2
    assert found == pytest.approx(share * 3.0 * disc / (share * solid_angle).sum(), rel=1e-5, abs=1e-6)


@settings(max_examples=40, deadline=None)
@given(st.floats(-180.0, 180.0), st.floats(-90.0, 90.0), st.sampled_from([(32, 16), (128, 64), (100, 41)]))
def test_a_point_has_its_direction_and_the_irradiance_of_a_surface_at_any_angle(azimuth, elevation, size):
    light = {"spectrum": "A", "azimuth_deg": azimuth, "elevation_deg": elevation, "diameter_deg": 0.0}
    picture = lights_picture(made(Sequence[PlacedLight], [{**light, "irradiance": 2.0}]), *size)
    unit, solid_angle = directions(*size)[0], row_solid_angles(*size)[:, None]
    weights = picture.weights[..., 0].astype(np.float64)
    assert 1 <= np.count_nonzero(weights) <= 4
    towards, moment = direction_of(azimuth, elevation), ((weights * solid_angle)[..., None] * unit).sum(axis=(0, 1))
    step = np.pi / size[1]
    assert moment == pytest.approx(2.0 * np.pi * towards, abs=2.0 * np.pi * 0.4 * step**2)


def test_a_disc_smaller_than_a_pixel_is_a_point_and_a_larger_one_is_spread():
    light = {"spectrum": "A", "azimuth_deg": 91.0, "elevation_deg": 1.2, "radiance": 3.0}
    for factor, least, most in ((0.95, 4, 4), (1.05, 2, 9)):
        one = made(Sequence[PlacedLight], [{**light, "diameter_deg": factor * 360.0 / 128}])
        found = lights_picture(one, 128, 64).weights[..., 0]
        assert least <= np.count_nonzero(found) <= most
        disc = 2.0 * np.pi * (1.0 - np.cos(np.radians(factor * 180.0 / 128)))
        assert (found * row_solid_angles(128, 64)[:, None]).sum() == pytest.approx(3.0 * disc, rel=1e-5)


@pytest.mark.parametrize("size", [(64, 32), (16, 128)])
def test_a_disc_within_the_longer_side_of_a_pixel_is_a_point(size):
    height, width = size
    light = {"spectrum": "A", "azimuth_deg": 91.0, "elevation_deg": 1.2, "radiance": 3.0}
    longest = max(360.0 / width, 180.0 / height)
    one, wide = (made(Sequence[PlacedLight], [{**light, "diameter_deg": part * longest}]) for part in (0.95, 1.4))
    assert np.count_nonzero(lights_picture(one, width, height).weights[..., 0]) == 4
    assert np.count_nonzero(lights_picture(wide, width, height).weights[..., 0]) > 4


def test_lights_have_their_own_spectra_at_one_luminance():
    names = ["D65", "FL11", "P2856"]
    lights = [{"spectrum": n, "azimuth_deg": 120.0 * i, "elevation_deg": 10.0, "diameter_deg": 30.0, "radiance": 1.0}
              for i, n in enumerate(names)]  # fmt: skip
    picture = lights_picture(made(Sequence[PlacedLight], lights), 64, 32)
    luminance = xyz(picture.basis.T)[:, 1]
    assert np.allclose(luminance, 1.0)
    for i, name in enumerate(names):
        assert np.allclose(picture.basis[:, i] / picture.basis[:, i].sum(), spectrum(name) / spectrum(name).sum())
        row, column = np.unravel_index(picture.weights[..., i].argmax(), (32, 64))
        assert picture.weights[row, column, i] == pytest.approx(1.0, rel=0.02)
    assert np.allclose(unit_luminance("D65"), light("D65"))


def test_placed_lights_in_a_file(tmp_path):
    lights = [{"spectrum": "FL11", "azimuth_deg": 20.0, "elevation_deg": 50.0, "diameter_deg": 0.0, "irradiance": 1.0}]
    make_environment(
        made(RgbSource | SpectralSource | LightsSource, {"kind": "lights", "lights": lights}),
        made(Size, {"width": 64, "height": 32}),
        tmp_path / "e.h5",
        *OPTIONS,
    )
    found = Environment.load(tmp_path / "e.h5")
    radiance = found.basis @ (found.coefficients * row_solid_angles(64, 32)[:, None, None]).sum(axis=(0, 1))
    # Of the four pixels together; a surface that faces their middle is not faced by each.
    assert np.allclose(radiance / np.pi, unit_luminance("FL11"), rtol=3e-3)
    assert np.allclose(radiance / radiance.sum(), unit_luminance("FL11") / unit_luminance("FL11").sum(), rtol=1e-4)


# --- what a file states of itself ----------------------------------------------------------------------------------


def write_hdr(path, pixels, lines=(), size=None):
    """Write values (height, width, 3) as an uncompressed Radiance HDR, whose channels share the exponent of a pixel."""
    height, width = pixels.shape[:2]
    _, exponent = np.frexp(pixels.max(axis=-1))
    bytes_of = np.concatenate([pixels / np.ldexp(1.0, exponent)[..., None] * 256.0, exponent[..., None] + 128], axis=-1)
    header = "\n".join(["#?RADIANCE", "FORMAT=32-bit_rle_rgbe", *lines, "", size or f"-Y {height} +X {width}", ""])
    path.write_bytes(header.encode() + bytes_of.astype(np.uint8).tobytes())
    return path


def powers_of_two(height, width):
    return np.ldexp(1.0, np.random.default_rng(8).integers(-6, 6, (height, width, 3)))


@pytest.mark.parametrize(("axes", "turned"), [
    ("-Y +X", np.s_[:, :]), ("+Y +X", np.s_[::-1, :]), ("-Y -X", np.s_[:, ::-1]), ("+Y -X", np.s_[::-1, ::-1])
])  # fmt: skip
def test_a_radiance_picture_stored_from_below_or_from_the_right_is_turned(tmp_path, axes, turned):
    seen = np.broadcast_to(powers_of_two(75, 150).max(axis=-1, keepdims=True), (75, 150, 3))
    size = "{} 75 {} 150".format(*axes.split())
    picture = rgb_picture(write_hdr(tmp_path / "a.hdr", seen[turned], size=size))
    # The format stores 8 bits of each number, and OpenImageIO returns the middle of the step.
    assert picture.weights == pytest.approx(from_panorama(seen), rel=0.01)
    assert max(len(band) for band in picture) <= BAND_ROWS


@pytest.mark.parametrize("tiled", [0, 16])
@pytest.mark.parametrize("reader", [rgb_picture, spectral_picture])
def test_an_exr_is_turned_as_its_orientation_states(tmp_path, reader, tiled):
    names = ["R", "G", "B"] if reader is rgb_picture else layer_names("S0")
    seen = np.random.default_rng(7).uniform(0, 1, (40, 80, len(names))).astype(np.float32)
    spec = oiio.ImageSpec(80, 40, len(names), "float")
    spec.channelnames, spec.tile_width, spec.tile_height = names, tiled, tiled
    spec.attribute("Orientation", 3)
    output = oiio.ImageOutput.create(str(tmp_path / "a.exr"))
    assert output.open(str(tmp_path / "a.exr"), spec)
    assert output.write_image(np.ascontiguousarray(seen[::-1, ::-1])) and output.close()
    assert np.array_equal(reader(tmp_path / "a.exr").weights, from_panorama(seen))


def test_columns_stored_as_rows_are_refused(tmp_path):
    path = write_hdr(tmp_path / "a.hdr", np.ones((8, 16, 3)), size="+X 16 +Y 8")
    with pytest.raises(InputError, match=r"a\.hdr: Orientation: found 6; accepted: rows .*1, 2, 3, 4\."):
        rgb_picture(path)


def test_the_exposure_of_a_radiance_picture_is_taken_out(tmp_path):
    pixels = powers_of_two(8, 16)
    plain = rgb_picture(write_hdr(tmp_path / "a.hdr", pixels)).weights
    lines = ["EXPOSURE=4.0", "pfilt -1", "EXPOSURE= 0.5", "\tEXPOSURE=1000", "COLORCORR= 1 2 0.25"]
    exposed = rgb_picture(write_hdr(tmp_path / "b.hdr", pixels, lines)).weights
    assert exposed == pytest.approx(plain / [2.0, 4.0, 0.5])


@pytest.mark.parametrize(("line", "said"), [
    ("EXPOSURE=", "EXPOSURE: found 0 numbers; accepted: one number"),
    ("EXPOSURE=bright", "EXPOSURE: found 'bright'; accepted: a finite number"),
    ("EXPOSURE=-1", "EXPOSURE: found -1; accepted: a positive factor"),
    ("EXPOSURE=1e-300", "EXPOSURE: found 1e-300; accepted: a positive factor"),
    ("COLORCORR=1 2", "COLORCORR: found 2 numbers; accepted: 3 numbers"),
    ("PRIMARIES=0.64 0.33", "PRIMARIES: found 2 numbers; accepted: 8 numbers"),
    ("PRIMARIES= 0.7 0.3 0.17 0.79 0.13 0.05 0.3127 0.329", "chromaticities: found 0.7, 0.3, 0.17"),
    ("PRIMARIES= 0.64 0.33 0.29 0.6 0.15 0.06 0.333 0.333", "linear sRGB: 0.64, 0.33"),
    ("GAMMA=2.2", "colour space: found g[0-9]+_rec709_scene; accepted: lin_rec709_scene"),
])  # fmt: skip
def test_what_a_radiance_header_states_and_is_not_linear_srgb_is_refused(tmp_path, line, said):
    with pytest.raises(InputError, match=said):
        _ = rgb_picture(write_hdr(tmp_path / "a.hdr", np.ones((8, 16, 3)), [line])).weights


def test_a_radiance_header_that_states_srgb_is_accepted(tmp_path):
    lines = ["PRIMARIES= 0.7 0.3 0.17 0.79 0.13 0.05 0.3127 0.329", "PRIMARIES=.64 .33 .3 .6 .15 .06 .3127 .329"]
    assert rgb_picture(write_hdr(tmp_path / "a.hdr", np.ones((8, 16, 3)), lines)).size == (8, 16)


@pytest.mark.parametrize(("space", "accepted"), [
    ("lin_rec709_scene", True), ("data", True), ("unknown", True), ("lin_ap1_scene", False),
    ("srgb_rec709_scene", False), ("lin_rec2020_scene", False),
])  # fmt: skip
def test_an_exr_of_another_colour_space_is_refused(tmp_path, space, accepted):
    spec = oiio.ImageSpec(16, 8, 3, "half")
    spec.attribute("colorInteropID", space)
    output = oiio.ImageOutput.create(str(tmp_path / "a.exr"))
    assert output.open(str(tmp_path / "a.exr"), spec) and output.write_image(np.ones((8, 16, 3), np.float32))
    output.close()
    if accepted:
        assert rgb_picture(tmp_path / "a.exr").weights.max() == 1.0
    else:
        with pytest.raises(InputError, match=rf"colour space: found {space}; accepted: lin_rec709_scene"):
            rgb_picture(tmp_path / "a.exr")


@pytest.mark.parametrize("value", [0.0, -1.0])
def test_a_picture_without_a_positive_value_is_refused(tmp_path, value):
    for reader, names in ((rgb_picture, ("R", "G", "B")), (spectral_picture, layer_names("S0"))):
        path = write_exr(tmp_path / "a.exr", np.full((40, 80, len(names)), value), names)
        with pytest.raises(InputError, match=r"a\.exr: found no pixel with a positive value"):
            _ = reader(path).weights
        pixels = np.full((40, 80, len(names)), value)
        pixels[3, 4] = 1.0
        assert reader(write_exr(tmp_path / "b.exr", pixels, names)).weights.max() == 1.0
