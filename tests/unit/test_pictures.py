"""Pictures in files: every bit kept, channels named as published, broken files refused."""

import json
from collections.abc import Sequence
from functools import partial

import numpy as np
import OpenImageIO as oiio
import pytest
from made import made
from PIL import Image
from scenes import DATA, OPTIONS, constant_light, material

from benchmarks.written_pictures import loss_stated_in, spectra_in
from irodori.colour.colorimetry import delta_e, lab_from_xyz, xyz_from_radiance
from irodori.colour.display import srgb
from irodori.config.models import ObjectShape, Render, Scene
from irodori.core import store
from irodori.core.errors import InputError
from irodori.export.loss import Loss
from irodori.export.pictures import layer_names, read_xyz, write_display_picture, write_spectral_exr
from irodori.rendering.stage import render_view, write_picture, write_tiff, write_xyz
from irodori.report.html_page import fragment
from irodori.report.page import rendered_views
from irodori.spectra.grid import WAVELENGTH_NM

TO_XYZ = xyz_from_radiance(np.ones(61))
DISPLAY = {"exposure": "auto", "device": {"kind": "standard", "name": "sRGB"}}


def spectral_picture(path, seed=2, size=(24, 32), storage="half"):
    rng = np.random.default_rng(seed)
    radiance = rng.gamma(1.0, 1.0, (*size, 61)).astype(np.float32)
    write_spectral_exr(path, radiance, radiance[..., :3], {"irodori:test": "yes"}, storage=storage)
    return radiance


def test_a_spectral_exr_in_single_precision_keeps_every_bit(tmp_path):
    radiance = spectral_picture(tmp_path / "a.exr", storage="single")
    assert np.array_equal(spectra_in(tmp_path / "a.exr")[1], radiance)
    assert [file.name for file in tmp_path.iterdir()] == ["a.exr"]


def test_layers_are_named_as_the_published_layout_says(tmp_path):
    spectral_picture(tmp_path / "a.exr")
    source = oiio.ImageInput.open(str(tmp_path / "a.exr"))
    names, spec = list(source.spec().channelnames), source.spec()
    source.close()
    expected = [f"S0.{wavelength},000000nm" for wavelength in range(400, 701, 5)]
    assert layer_names("S0") == expected
    assert sorted(names) == sorted(["R", "G", "B", *expected])
    assert spec.getattribute("spectralLayoutVersion") == "1.0" and spec.getattribute("emissiveUnits")
    assert spec.getattribute("irodori:test") == "yes"


@pytest.mark.parametrize(("storage", "brightest"), [("half", 1.0), ("half", 1e6), ("single", 1.0)])
def test_a_spectral_exr_states_the_loss_of_its_numbers(tmp_path, storage, brightest):
    """The figures are those of what is read back; of a picture that is scaled into the range of half precision too."""
    radiance = (brightest * np.random.default_rng(3).uniform(0.0, 1.0, (70, 9, 61))).astype(np.float32)
    white = brightest * np.linspace(0.5, 1.5, 61)
    write_spectral_exr(tmp_path / "a.exr", radiance, radiance[..., :3], {}, storage=storage, white=white)
    matrix = xyz_from_radiance(white)
    # In one order in memory: otherwise a product of matrices may be added up in two.
    pictures = [np.ascontiguousarray(one, dtype=np.float64) for one in (radiance, spectra_in(tmp_path / "a.exr")[1])]
    off = Loss.of(delta_e(*(lab_from_xyz(one @ matrix.T, matrix @ white) for one in pictures)))
    assert loss_stated_in(tmp_path / "a.exr").text == off.text
    assert off.compared == 630 and (off.largest < 0.1 if storage == "half" else off.largest == 0.0)
    assert storage == "single" or off.largest > 1e-4


@pytest.mark.parametrize(("suffix", "bits"), [(".png", 8), (".tif", 16)])
def test_a_picture_for_a_display_states_what_rounding_and_the_gamut_take(tmp_path, suffix, bits):
    display, white = srgb(), np.array([95.0, 100.0, 109.0])
    inside = np.random.default_rng(4).uniform(0.0, 1.0, (40, 30, 3))
    for name, linear in (("inside", inside), ("outside", inside * [3.0, 1.0, 0.5])):
        xyz = (linear @ np.linalg.inv(display._rgb_from_xyz(white)[0]).T).astype(np.float64)
        path = tmp_path / f"{name}{suffix}"
        write_picture(path, xyz, white, display, bits)
        # The standard's curve, written out.
        code = oiio_pixels(path) / (2**bits - 1)
        shown = np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4)
        exact = display.linear_rgb(xyz, white)
        labs = [lab_from_xyz(one @ display.xyz_from_rgb.T, display.white_xyz) for one in (exact, shown)]
        off = Loss.of(delta_e(*labs))
        assert loss_stated_in(path).text == off.text
        assert off.mean > 3.0 if name == "outside" else off.mean < (0.5 if bits == 8 else 0.002)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_picture_that_is_not_finite_is_refused_with_its_first_pixel(tmp_path, value):
    xyz = np.full((4, 6, 3), 50.0)
    xyz[2, 5, 1] = xyz[3, 0] = value
    with pytest.raises(
        InputError, match=r"a\.png: found 2 pixels without a finite colour, the first in row 2, column 5"
    ):
        write_picture(tmp_path / "a.png", xyz, np.array([95.0, 100.0, 109.0]), srgb())
    assert not list(tmp_path.iterdir())


def oiio_pixels(path):
    source = oiio.ImageInput.open(str(path))
    pixels = source.read_image(source.spec().format).astype(np.float64)
    source.close()
    return pixels


@pytest.mark.stability(stage="environment", case="a picture cut short")
@pytest.mark.parametrize("keep", [0, 4, 300, 0.25, 0.5, 0.9, 0.999])
def test_a_truncated_exr_is_refused(tmp_path, keep):
    path = tmp_path / "a.exr"
    spectral_picture(path)
    content = path.read_bytes()
    path.write_bytes(content[: keep if isinstance(keep, int) else int(keep * len(content))])
    with pytest.raises(InputError, match=r"a\.exr"):
        read_xyz(path, TO_XYZ)


def test_an_exr_that_is_missing_or_lacks_a_wavelength_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"missing\.exr"):
        read_xyz(tmp_path / "missing.exr", TO_XYZ)
    spec = oiio.ImageSpec(4, 4, 3, "float")
    output = oiio.ImageOutput.create(str(tmp_path / "rgb.exr"))
    assert output.open(str(tmp_path / "rgb.exr"), spec) and output.write_image(np.ones((4, 4, 3), np.float32))
    output.close()
    with pytest.raises(InputError, match="400 nm"):
        read_xyz(tmp_path / "rgb.exr", TO_XYZ)


def test_another_programs_exr_of_other_wavelengths_is_refused_by_name():
    path = DATA / "spectral" / "macbeth_chart_36_bands.exr"
    if not path.is_file():
        pytest.skip(f"no picture at {path}")
    with pytest.raises(InputError, match="no layer for 4"):
        read_xyz(path, TO_XYZ)


def test_a_png_keeps_its_pixels_and_carries_srgb(tmp_path):
    from PIL import ImageCms

    pixels = np.random.default_rng(3).integers(0, 256, (20, 30, 3), dtype=np.uint8)
    write_display_picture(tmp_path / "a.png", pixels, srgb().profile, {})
    with Image.open(tmp_path / "a.png") as image:
        assert image.mode == "RGB" and np.array_equal(np.asarray(image), pixels)
        profile = image.info["icc_profile"]
    (tmp_path / "profile.icc").write_bytes(profile)
    assert "sRGB" in ImageCms.getProfileDescription(ImageCms.getOpenProfile(str(tmp_path / "profile.icc")))


def outputs_of(folder, name) -> dict:
    """The files of a view, by the names that `render_view` has for them."""
    return {"exr": folder / f"{name}.exr", "png": folder / f"{name}.png", "figures_file": folder / f"{name}.json"}


def test_a_view_in_files_shows_a_white_diffuser_as_white(tmp_path):
    light = constant_light(np.linspace(0.3, 3.0, 61))
    provenance = store.Provenance("test")
    light.save(tmp_path / "e.h5", provenance)
    for name, reflectance in (("white", 1.0), ("grey", 0.2)):
        material(reflectance).save(tmp_path / f"{name}.h5", provenance)
    shapes = [{"kind": "plate", "width_mm": 100.0, "height_mm": 100.0}, {"kind": "sphere", "radius_mm": 20.0}]
    scene = {
        "image": {"width": 31, "height": 31}, "display": DISPLAY,
        "integrator": {"kind": "interactive", "light_maps": False},
        "objects": [{"object": n, "position_mm": [0, 0, z], "rotation_deg": [0, 0, 0], "scale": 1.0}
                    for n, z in (("white", 0.0), ("grey", 40.0))],
        "views": {"v": {"position_mm": [0, -0.01, 500.0], "target_mm": [0, 0, 0], "up": [0, 0, 1],
                        "field_of_view_deg": 11.0}},
    }  # fmt: skip
    render_view(
        made(Scene, scene),
        "v",
        made(Sequence[ObjectShape], shapes),
        [tmp_path / "white.h5", tmp_path / "grey.h5"],
        tmp_path / "e.h5",
        **outputs_of(tmp_path, "v"),
        options=made(Render, OPTIONS),
    )
    radiance = spectra_in(tmp_path / "v.exr")[1]
    assert np.allclose(radiance[2, 2], np.linspace(0.3, 3.0, 61), rtol=2e-3)
    with Image.open(tmp_path / "v.png") as image:
        pixels = np.asarray(image).astype(int)
    assert (pixels[2, 2] >= 254).all()
    # sRGB of a fifth of white, neutral: 255 (1.055 * 0.2^(1/2.4) - 0.055).
    assert np.abs(pixels[15, 15] - 255 * (1.055 * 0.2 ** (1 / 2.4) - 0.055)).max() <= 1
    figures = json.loads((tmp_path / "v.json").read_text())
    assert figures["exposure"] == 1.0 and figures["filled_fraction"] == {"white": 0.0, "grey": 0.0}
    assert WAVELENGTH_NM.size == radiance.shape[2]
    assert figures["display"] == "sRGB" and figures["out_of_gamut_pixels"] == 0
    _check_further_outputs(scene, tmp_path, pixels)


def _check_further_outputs(scene, folder, pixels):
    """XYZ and a TIFF of the view's EXR: the grey ball has Y = 20 and the same code as in the PNG, 16 bits of it."""
    write_xyz(made(Scene, scene), folder / "v.exr", folder / "e.h5", folder / "v.xyz.exr")
    source = oiio.ImageInput.open(str(folder / "v.xyz.exr"))
    xyz, white = source.read_image("float"), source.spec().getattribute("irodori:whiteXYZ")
    source.close()
    # Half precision in the spectra, 8 bits in the PNG, 32 bits in the XYZ.
    means = [loss_stated_in(folder / name).mean for name in ("v.exr", "v.png", "v.xyz.exr")]
    assert 0.0 < means[0] < 0.02 and 0.02 < means[1] < 0.5 and means[2] < 1e-4
    assert xyz[15, 15] == pytest.approx(0.2 * np.array(list(map(float, white.split()))), rel=0.01)
    write_tiff(made(Scene, scene), folder / "v.exr", folder / "e.h5", folder / "v.tif")
    source = oiio.ImageInput.open(str(folder / "v.tif"))
    assert np.abs(source.read_image("uint16") / 257 - pixels).max() <= 0.51
    source.close()


def test_a_view_by_paths_in_files_tells_its_error_and_leaves_no_tiles(tmp_path):
    """A white plate under constant light and a lamp above it: their sum is the picture's white."""
    light = constant_light(np.linspace(0.3, 3.0, 61))
    light.save(tmp_path / "e.h5", store.Provenance("test"))
    material(1.0).save(tmp_path / "white.h5", store.Provenance("test"))
    sun = {"kind": "collimated", "spectrum": "A", "azimuth_deg": 0.0, "elevation_deg": 30.0, "irradiance": 4.0}
    lamp = {"kind": "sphere", "spectrum": "D65", "position_mm": [-200, 0, 100], "radius_mm": 10.0, "radiance": 900.0}
    panel = {"kind": "rectangle", "spectrum": "D65", "position_mm": [90, 0, 200], "rotation_deg": [180, 20, 0],
             "width_mm": 60.0, "height_mm": 90.0, "radiance": 5.0}  # fmt: skip
    scene = {
        "image": {"width": 7, "height": 5}, "display": DISPLAY, "lights": [sun, lamp, panel],
        "integrator": {"kind": "reference", "samples": 512, "seed": 3},
        "objects": [{"object": "white", "position_mm": [0, 0, 0], "rotation_deg": [0, 0, 0], "scale": 1.0}],
        "views": {"v": {"position_mm": [0, -0.01, 500.0], "target_mm": [0, 0, 0], "up": [0, 0, 1],
                        "field_of_view_deg": 0.1}},
    }  # fmt: skip
    outputs = outputs_of(tmp_path, "v")
    shapes = [{"kind": "plate", "width_mm": 100.0, "height_mm": 100.0}]
    arguments = "v", made(Sequence[ObjectShape], shapes), [tmp_path / "white.h5"], tmp_path / "e.h5"
    render = partial(render_view, **outputs, options=OPTIONS)
    render(made(Scene, scene), *arguments)
    with Image.open(tmp_path / "v.png") as image:
        assert (np.asarray(image) >= 252).all()
    figures = json.loads((tmp_path / "v.json").read_text())
    assert figures["integrator"] == "reference" and figures["samples"] == 512 and figures["paths_cut"] == 0
    assert 0 < figures["relative_standard_error"]["mean"] <= figures["relative_standard_error"]["max"] < 0.02
    filtered = figures["denoised"]
    assert figures["relative_standard_error"]["mean"] <= filtered["relative_standard_error_before"]["mean"] < 0.02
    assert filtered["relative_distance_to_unbiased"]["max"] < 0.005
    assert not (tmp_path / "v.tiles").exists()
    with pytest.raises(ValueError, match=r"area lights .* accepted: collimated"):
        render(made(Scene, scene | {"integrator": {"kind": "interactive", "light_maps": True}}), *arguments)
    with pytest.raises(ValueError, match="kinds interactive, reference"):
        render(made(Scene, scene | {"integrator": {"kind": "bidirectional"}}), *arguments)


def test_a_fault_of_the_renderer_is_said_before_anything_is_written(tmp_path, monkeypatch):
    constant_light(1.0).save(tmp_path / "light.h5", store.Provenance("test"))
    material(1.0).save(tmp_path / "white.h5", store.Provenance("test"))
    scene = {
        "image": {"width": 3, "height": 3}, "display": DISPLAY,
        "objects": [{"object": "white", "position_mm": [0, 0, 0], "rotation_deg": [0, 0, 0], "scale": 1.0}],
        "views": {"v": {"position_mm": [0, -0.01, 500.0], "target_mm": [0, 0, 0], "up": [0, 0, 1],
                        "field_of_view_deg": 0.1}},
    }  # fmt: skip
    radiance = np.ones((3, 3, 61), np.float32)
    radiance[1, 2, 7] = np.nan
    monkeypatch.setattr("irodori.rendering.stage.render_prepared", lambda *_, **__: (radiance, {}))
    with pytest.raises(
        InputError, match=r"v\.exr: found 1 pixel without a finite colour, the first in row 1, column 2"
    ):
        render_view(
            made(Scene, scene), "v", [made(ObjectShape, {"kind": "plate", "width_mm": 100.0, "height_mm": 100.0})],
            [tmp_path / "white.h5"], tmp_path / "light.h5", **outputs_of(tmp_path, "v"), options=OPTIONS,
        )  # fmt: skip
    assert {file.name for file in tmp_path.iterdir()} == {"light.h5", "white.h5"}


def test_a_scene_in_the_dark_is_refused_before_anything_is_written(tmp_path):
    constant_light(0.0).save(tmp_path / "dark.h5", store.Provenance("test"))
    material(1.0).save(tmp_path / "white.h5", store.Provenance("test"))
    scene = {
        "image": {"width": 3, "height": 3}, "display": DISPLAY,
        "objects": [{"object": "white", "position_mm": [0, 0, 0], "rotation_deg": [0, 0, 0], "scale": 1.0}],
        "views": {"v": {"position_mm": [0, -0.01, 500.0], "target_mm": [0, 0, 0], "up": [0, 0, 1],
                        "field_of_view_deg": 0.1}},
    }  # fmt: skip
    outputs = outputs_of(tmp_path, "v")
    shapes = [{"kind": "plate", "width_mm": 100.0, "height_mm": 100.0}]
    with pytest.raises(InputError, match=r"dark\.h5: found no light on a surface that faces up"):
        render_view(
            made(Scene, scene),
            "v",
            made(Sequence[ObjectShape], shapes),
            [tmp_path / "white.h5"],
            tmp_path / "dark.h5",
            **outputs,
            options=OPTIONS,
        )
    assert not any(path.exists() for path in outputs.values())


def test_an_interactive_view_in_files_has_the_light_of_its_lamp(tmp_path):
    """A white plate under constant light and a lamp aslant: together they are the picture's white."""
    constant_light(np.linspace(0.3, 3.0, 61)).save(tmp_path / "e.h5", store.Provenance("test"))
    material(1.0).save(tmp_path / "white.h5", store.Provenance("test"))
    sun = {"kind": "collimated", "spectrum": "A", "azimuth_deg": 0.0, "elevation_deg": 30.0, "irradiance": 4.0}
    scene = {
        "image": {"width": 7, "height": 5}, "display": DISPLAY, "lights": [sun],
        "integrator": {"kind": "interactive", "light_maps": True},
        "objects": [{"object": "white", "position_mm": [0, 0, 0], "rotation_deg": [0, 0, 0], "scale": 1.0}],
        "views": {"v": {"position_mm": [0, -0.01, 500.0], "target_mm": [0, 0, 0], "up": [0, 0, 1],
                        "field_of_view_deg": 0.1}},
    }  # fmt: skip
    outputs = outputs_of(tmp_path, "v")
    shapes = [{"kind": "plate", "width_mm": 100.0, "height_mm": 100.0}]
    render_view(
        made(Scene, scene),
        "v",
        made(Sequence[ObjectShape], shapes),
        [tmp_path / "white.h5"],
        tmp_path / "e.h5",
        **outputs,
        options=OPTIONS,
    )
    from irodori.light.placed_lights import unit_luminance

    expected = np.linspace(0.3, 3.0, 61) + 4.0 * 0.5 * unit_luminance("A")
    np.testing.assert_allclose(spectra_in(outputs["exr"])[1][2, 3], expected, rtol=3e-3)
    with Image.open(outputs["png"]) as image:
        assert (np.asarray(image) >= 252).all()
    figures = json.loads(outputs["figures_file"].read_text())
    assert figures["integrator"] == "interactive" and figures["rays"] >= 35


@pytest.mark.default_cases(1)
@pytest.mark.parametrize(
    "integrator",
    [
        {"kind": "interactive", "light_maps": False},
        {"kind": "reference", "samples": 4096, "seed": 0},
    ],
)
def test_a_body_is_rendered_from_its_names_alone(tmp_path, integrator):
    """A photographed plate, a ball of a test colour and one that mirrors too, under constant light."""
    from irodori.spectra.published import spectrum

    light = constant_light(2.0)
    light.save(tmp_path / "e.h5", store.Provenance("test"))
    material(0.5).save(tmp_path / "plate.h5", store.Provenance("test"))
    where = {"rotation_deg": [0, 0, 0], "scale": 2.0, "shape": {"kind": "sphere", "radius_mm": 10.0}}
    index = tmp_path / "gold.csv"
    index.write_text("wavelength_nm,n,k\n" + "".join(f"{w},{0.2 + w / 1e3},3.5\n" for w in range(380, 721, 20)))
    smooth = {"spectrum": "TCS12", "beta": 0.0, "mu_rad": 0.1, "mirror": 0.0, "refractive_index": {"n": 1.5, "k": 0.0}}
    golden = smooth | {"mirror": 1.0, "refractive_index": {"file": str(index)}}
    scene = {
        "image": {"width": 3, "height": 1}, "display": DISPLAY, "integrator": integrator,
        "allow_energy_gain": True,  # a coloured ball that is a mirror of gold besides
        "objects": [{"object": "plate", "position_mm": [0, 0, -500], "rotation_deg": [0, 0, 0], "scale": 1.0}],
        "bodies": [where | {"position_mm": [-100, 0, 0], "material": smooth},
                   where | {"position_mm": [100, 0, 0], "material": golden}],
        "views": {},
    }  # fmt: skip
    for name, x in (("left", -100), ("right", 100)):
        scene["views"][name] = {"position_mm": [x, -0.01, 5000.0], "target_mm": [x, 0, 0], "up": [0, 1, 0],
                                "field_of_view_deg": 0.002}  # fmt: skip
        render_view(
            made(Scene, scene),
            name,
            made(Sequence[ObjectShape], [{"kind": "plate", "width_mm": 10.0, "height_mm": 10.0}]),
            [tmp_path / "plate.h5"],
            tmp_path / "e.h5",
            **outputs_of(tmp_path, name),
            options=OPTIONS,
        )
    left, right = (spectra_in(tmp_path / f"{name}.exr")[1][0, 1] for name in ("left", "right"))
    # Each sees nothing but the light; the second adds its mirror term to its diffuse one.
    assert np.allclose(left, 2.0 * np.maximum(spectrum("TCS12"), 0), rtol=2e-3)
    n = 0.2 + WAVELENGTH_NM / 1e3
    mirrored = ((n - 1) ** 2 + 3.5**2) / ((n + 1) ** 2 + 3.5**2)
    assert np.allclose(right, 2.0 * (spectrum("TCS12") + mirrored), rtol=5e-3)
    views = rendered_views(["s/left"], [tmp_path / "left.png"], [tmp_path / "left.json"], {})
    page = fragment("views.html.j2", views=views)
    assert integrator["kind"] in page and ("4096" in page) == (integrator["kind"] == "reference")
    figures = json.loads((tmp_path / "left.json").read_text())
    assert figures["integrator"] == integrator["kind"] and figures["filled_fraction"] == {"plate": 0.0}
