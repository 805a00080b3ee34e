"""Displays: LittleCMS shows the colours that were meant, and what cannot be shown is counted side by side."""

import io

import imagecodecs
import numpy as np
import OpenImageIO as oiio
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made import made
from PIL import Image, ImageCms

from irodori.colour.display import STANDARD, gamut, make_display, srgb, standard_display
from irodori.colour.icc import D50_XYZ, Profile, bradford, read_profile, write_profile
from irodori.colour.tone_curves import SRGB, ParametricCurve, SampledCurve
from irodori.config.cross_checks.display_files import check_display
from irodori.config.models import DisplayDevice, MeasuredDisplay, ProfileDisplay
from irodori.core.errors import InputError
from irodori.export.pictures import write_display_picture, write_xyz_exr

#: Two roundings of the profile's numbers, 2^-16 each.
FIXED_POINT = 3.1e-5
WIDE = {
    "kind": "primaries", "red_xy": [0.67, 0.32], "green_xy": [0.27, 0.67], "blue_xy": [0.15, 0.05],
    "white_xy": [0.31, 0.325], "tone": {"kind": "gamma", "gamma": 2.35},
}  # fmt: skip
WHITE = np.array([109.85, 100.0, 35.58])  # illuminant A


def shown(profile: bytes, codes: np.ndarray) -> np.ndarray:
    """XYZ under D50 that LittleCMS says a profile's display shows, (n, 3)."""
    out = imagecodecs.cms_transform(
        codes[None].astype(np.float64), profile, imagecodecs.cms_profile("xyz"), colorspace="rgb",
        outcolorspace="xyz", outdtype="f8", intent=1,
    )  # fmt: skip
    return out[0]


def patches(path, matrix, powers=(2.2, 2.0, 1.8), black=(0.1, 0.1, 0.15), levels=16, white_factor=1.0):
    """A table of a display's ramps, its white and a grey, in cd/m² or whatever the matrix is in."""
    ramp = np.linspace(0.0, 1.0, levels)
    codes = [np.eye(3)[i] * level for i in range(3) for level in ramp] + [np.ones(3), np.full(3, 0.5)]
    lines = ["red,green,blue,X,Y,Z"]
    for code in codes:
        xyz = matrix @ code ** np.array(powers) * (white_factor if (code == 1).all() else 1.0) + black
        lines.append(",".join(f"{v:.8g}" for v in (*code, *xyz)))
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.mark.parametrize("name", ["sRGB", "Display P3", "Adobe RGB (1998)", "wide"])
def test_littlecms_shows_the_adapted_colour_of_a_picture_with_its_profile(name):
    display = make_display(made(DisplayDevice, WIDE if name == "wide" else {"kind": "standard", "name": name}))
    linear = np.random.default_rng(1).uniform(0, 1, (400, 3))
    codes, found = display.encode(linear, bits=16)
    assert found.outside == 0
    adapt = bradford(D50_XYZ, display.white_xyz)
    expected = linear @ (adapt @ display.xyz_from_rgb).T
    # Of sRGB, LittleCMS's own profile and the standard's rounded matrix differ in the fourth digit.
    tolerance = 2e-4 if name == "sRGB" else FIXED_POINT + 3 / 65535
    assert np.abs(shown(display.profile, codes / 65535.0) - expected).max() < tolerance


def test_a_pixel_in_a_tiff_and_a_png_is_the_scenes_colour_for_littlecms(tmp_path):
    """A wide display: LittleCMS takes its 8-bit picture to sRGB, where it agrees with the picture made for sRGB."""
    display = make_display(made(DisplayDevice, WIDE))
    small = np.random.default_rng(2).uniform(0.2, 0.7, (30, 40, 3))
    xyz = small @ (100 * np.linalg.inv(srgb()._rgb_from_xyz(WHITE / 100)[0])).T
    assert gamut(display.linear_rgb(xyz, WHITE)).outside == 0
    for name, bits in (("a.png", 8), ("a.tif", 16)):
        pixels, _ = display.encode(display.linear_rgb(xyz, WHITE), bits)
        write_display_picture(tmp_path / name, pixels, display.profile, display.attributes(WHITE))
    with Image.open(tmp_path / "a.png") as image:
        assert not {"srgb", "gamma", "chromaticity"} & set(image.info)
        source = ImageCms.ImageCmsProfile(io.BytesIO(image.info["icc_profile"]))
        target = ImageCms.createProfile("sRGB")
        seen = np.asarray(ImageCms.profileToProfile(image, source, target, renderingIntent=1), dtype=int)
        assert image.info["irodori:chromaticAdaptation"] == "CAT16"
        assert image.info["irodori:whiteXYZ"] == "109.85 100 35.58"
    meant = srgb().encode(srgb().linear_rgb(xyz, WHITE))[0].astype(int)
    # CAT16 to this display's white, then Bradford within the profiles, against CAT16 to D65: two codes; rounding: one.
    assert np.abs(seen - meant).max() <= 3
    source = oiio.ImageInput.open(str(tmp_path / "a.tif"))
    spec, kept = source.spec(), source.read_image("uint16")
    source.close()
    assert np.array_equal(kept, pixels) and "chromaticAdaptation CAT16" in spec.getattribute("ImageDescription")
    assert bytes(np.asarray(spec.getattribute("ICCProfile"))) == display.profile


def test_an_xyz_exr_keeps_every_bit_and_says_that_it_is_not_adapted(tmp_path):
    xyz = np.random.default_rng(3).uniform(0, 300, (5, 7, 3)).astype(np.float32)
    write_xyz_exr(tmp_path / "a.exr", xyz, {"irodori:chromaticAdaptation": "none"})
    source = oiio.ImageInput.open(str(tmp_path / "a.exr"))
    spec, kept = source.spec(), source.read_image("float")
    source.close()
    assert list(spec.channelnames) == ["X", "Y", "Z"] and spec.getattribute("irodori:chromaticAdaptation") == "none"
    assert np.array_equal(kept, xyz)


@pytest.mark.parametrize("curve", [SRGB, ParametricCurve(1.0), ParametricCurve(2.4, 0.9, 0.1, 0.2, 0.03, 0.0, 0.0),
                                   SampledCurve(np.array([0.0, 0.0, 0.1, 0.5, 1.0]))])  # fmt: skip
def test_a_tone_curve_and_its_inverse_cancel(curve):
    linear = curve.linear(np.linspace(0, 1, 997))
    assert curve.linear(curve.code(linear)) == pytest.approx(linear, abs=1e-12)


@given(gamma=st.floats(1.0, 3.5), white=st.tuples(st.floats(0.28, 0.36), st.floats(0.28, 0.36)))
@settings(deadline=None, max_examples=30)
def test_a_profile_read_back_is_the_display_that_was_written(gamma, white):
    display = make_display(
        made(DisplayDevice, WIDE | {"white_xy": list(white), "tone": {"kind": "gamma", "gamma": gamma}})
    )
    found = read_profile(display.profile, "a.icc")
    # The inverse of the adaptation stretches a rounding by at most three, over two of them.
    assert found.xyz_from_rgb == pytest.approx(display.xyz_from_rgb, abs=4 * FIXED_POINT)
    codes = np.linspace(0, 1, 50)
    assert found.curves[1].linear(codes) == pytest.approx(codes**gamma, abs=2e-5)


def test_a_profile_made_by_littlecms_is_read_as_it_means_itself():
    profile = srgb().profile
    found = read_profile(profile, "a.icc")
    codes = np.random.default_rng(4).uniform(0, 1, (100, 3))
    linear = np.stack([curve.linear(codes[:, i]) for i, curve in enumerate(found.curves)], axis=1)
    xyz = linear @ (bradford(D50_XYZ, found.xyz_from_rgb.sum(axis=1)) @ found.xyz_from_rgb).T
    assert xyz == pytest.approx(shown(profile, codes), abs=2 * FIXED_POINT)
    # Its white is that of sRGB.
    assert found.xyz_from_rgb.sum(axis=1) == pytest.approx(srgb().white_xyz, abs=3e-4)


def test_a_profile_of_version_2_tells_its_white_itself():
    """Without the adaptation's tag, white is what stands there, and Bradford is undone."""
    display = make_display(made(DisplayDevice, WIDE))
    data = bytearray(display.profile)
    table = {bytes(data[132 + 12 * i : 136 + 12 * i]): 132 + 12 * i for i in range(11)}
    offset = int.from_bytes(data[table[b"wtpt"] + 4 : table[b"wtpt"] + 8], "big")
    data[offset + 8 : offset + 20] = np.rint(display.white_xyz * 65536).astype(">i4").tobytes()
    data[table[b"chad"] : table[b"chad"] + 4] = b"none"
    found = read_profile(bytes(data), "old.icc")
    assert found.xyz_from_rgb == pytest.approx(display.xyz_from_rgb, abs=5 * FIXED_POINT)
    for dark in (b"wtpt", b"gXYZ"):
        offset = int.from_bytes(data[table[dark] + 4 : table[dark] + 8], "big")
        broken = bytes(data[: offset + 8]) + bytes(12) + bytes(data[offset + 20 :])
        with pytest.raises(InputError, match=r"old\.icc: .*found a display without"):
            read_profile(broken, "old.icc")


def test_sampled_curves_pass_through_a_profile():
    ramp = np.linspace(0, 1, 4096) ** 2.1
    profile = Profile("ramp", standard_display("Display P3").xyz_from_rgb, (SampledCurve(ramp),) * 3)
    found = read_profile(write_profile(profile), "a.icc")
    assert found.curves[2].values == pytest.approx(ramp, abs=0.51 / 65535)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda d: d[:40], "no whole ICC profile"),
        (lambda d: d[:12] + b"prtr" + d[16:], "class 'prtr'"),
        (lambda d: d[:16] + b"CMYK" + d[20:], "'CMYK'"),
        (lambda d: d.replace(b"rTRC", b"A2B0", 1), "colour tables"),
        (lambda d: d.replace(b"gXYZ", b"zzzz", 1), "gXYZ"),
        (lambda d: d.replace(b"para", b"pamm"), "tone curves of the type 'pamm'"),
        (lambda d: b"", "no whole ICC profile"),
    ],
)
def test_a_profile_of_something_else_is_refused_by_name(change, said):
    with pytest.raises(InputError, match=rf"monitor\.icc.*{said}"):
        read_profile(change(make_display(made(DisplayDevice, WIDE)).profile), "monitor.icc")


def test_a_measured_display_shows_a_colour_by_its_own_light(tmp_path):
    """Codes of a picture, put through the display that was measured, give the adapted XYZ, black included."""
    matrix = np.array([[41.0, 35.8, 18.0], [21.3, 71.5, 7.2], [1.9, 11.9, 95.0]])
    powers, black = np.array([2.2, 2.0, 1.8]), np.array([0.1, 0.1, 0.15])
    display = make_display(
        made(DisplayDevice, {"kind": "measured", "file": str(patches(tmp_path / "m.csv", matrix, powers, black))})
    )
    luminance = (matrix.sum(axis=1) + black)[1]
    assert display.white_xyz == pytest.approx((matrix.sum(axis=1) + black) / luminance, abs=1e-6)
    wanted = np.random.default_rng(5).uniform(0.02, 0.9, (200, 3))
    xyz = wanted @ (matrix / luminance).T + black / luminance
    # A scene whose white is the display's needs no adaptation.
    linear = display.linear_rgb(xyz, display.white_xyz)
    codes, found = display.encode(linear, bits=16)
    assert found.outside == 0
    light = (codes / 65535.0) ** powers @ matrix.T + black
    assert light / luminance == pytest.approx(xyz, abs=2e-4)
    # Darker than the display's black cannot be shown.
    assert gamut(display.linear_rgb(np.zeros((1, 3)), display.white_xyz)).below == 1


def test_argylls_table_is_the_same_display(tmp_path):
    matrix = np.array([[41.0, 35.8, 18.0], [21.3, 71.5, 7.2], [1.9, 11.9, 95.0]])
    table = patches(tmp_path / "m.csv", matrix)
    rows = [list(map(float, line.split(","))) for line in table.read_text().splitlines()[1:]]
    text = "CTI3\n\nNUMBER_OF_FIELDS 7\nBEGIN_DATA_FORMAT\nSAMPLE_ID RGB_R RGB_G RGB_B XYZ_X XYZ_Y XYZ_Z\n"
    text += f"END_DATA_FORMAT\nNUMBER_OF_SETS {len(rows)}\nBEGIN_DATA\n"
    text += "\n".join(
        " ".join(map(repr, [i, *(100 * v for v in row[:3]), *row[3:]])) for i, row in enumerate(rows, start=1)
    )
    (tmp_path / "m.ti3").write_text(text + "\nEND_DATA\n")
    a, b = (
        make_display(made(DisplayDevice, {"kind": "measured", "file": str(tmp_path / name)}))
        for name in ("m.csv", "m.ti3")
    )
    assert a.xyz_from_rgb == pytest.approx(b.xyz_from_rgb, abs=1e-9)
    assert a.curves[0].values == pytest.approx(b.curves[0].values, abs=1e-9)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda t: t.replace("red,green", "r,green"), "line 1.*red, green, blue, X, Y, Z"),
        (
            lambda t: "\n".join(line for line in t.splitlines() if not line.startswith("0,0,0")),
            "no patch of code 0, 0, 0",
        ),
        (lambda t: "\n".join(line for line in t.splitlines() if not line.startswith("0,1,0")), "levels of green alone"),
        (lambda t: t.replace("0.2,0,0,", "0.2,0,0,-9"), "red = 0.2"),
        (lambda t: t.replace("1,1,1,", "1,1,2,"), "code values from 0 to 2"),
        (lambda t: t.replace("1,1,1,", "1,1,1,1"), "off the measured white"),
        (lambda t: t.replace("0.2,0,0,", "0.2,0,0,x"), "line 5, X"),
    ],
)
def test_a_faulty_measurement_is_refused_by_name(tmp_path, change, said):
    path = patches(tmp_path / "m.csv", np.array([[41.0, 35.8, 18.0], [21.3, 71.5, 7.2], [1.9, 11.9, 95.0]]))
    path.write_text(change(path.read_text()))
    with pytest.raises(InputError, match=rf"m\.csv.*{said}"):
        make_display(made(DisplayDevice, {"kind": "measured", "file": str(path)}))


@pytest.mark.parametrize(("columns", "said"), [
    ("red,green,blue,Y,X,Z", r"red: found a larger x of green"),
    ("red,green,blue,X,Z,Y", r"green: found a larger y of blue"),
    ("red,green,blue,Z,Y,X", r"red: found a larger x of blue"),
    ("blue,green,red,X,Y,Z", r"red: found a larger x of blue"),
    ("green,red,blue,X,Y,Z", r"red: found a larger x of green"),
    ("red,blue,green,X,Y,Z", r"green: found a larger y of blue"),
])  # fmt: skip
def test_a_display_measured_with_exchanged_columns_is_refused(tmp_path, columns, said):
    path = patches(tmp_path / "m.csv", np.array([[41.0, 35.8, 18.0], [21.3, 71.5, 7.2], [1.9, 11.9, 95.0]]))
    header, *rows = path.read_text().splitlines()
    places = [header.split(",").index(name) for name in columns.split(",")]
    exchanged = [",".join(row.split(",")[place] for place in places) for row in rows]
    path.write_text("\n".join([header, *exchanged]))
    with pytest.raises(InputError, match=rf"m\.csv: {said}.*columns exchanged"):
        make_display(made(DisplayDevice, {"kind": "measured", "file": str(path)}))


@pytest.mark.parametrize("name", STANDARD)
def test_a_measured_display_of_any_standard_is_accepted(tmp_path, name):
    matrix = 100.0 * standard_display(name).xyz_from_rgb
    path = patches(tmp_path / "m.csv", matrix, black=np.zeros(3))
    found = make_display(made(DisplayDevice, {"kind": "measured", "file": str(path)}))
    assert found.xyz_from_rgb == pytest.approx(matrix / matrix[1].sum(), abs=1e-6)


def test_what_a_display_cannot_show_is_counted_on_each_side():
    linear = np.full((4, 5, 3), 0.5)
    linear[0, :3, 1] = -0.2
    linear[1, :2, 0] = 1.3
    linear[2, 0] = [-0.1, 1.2, 0.5]
    found = gamut(linear)
    assert (found.pixels, found.outside, found.below, found.above) == (20, 6, 4, 3)
    assert found.figures()["out_of_gamut_fraction"] == 0.3
    wide = gamut(
        np.array([[1.2, 0.5, 0.5]])
        @ (np.linalg.inv(make_display(made(DisplayDevice, WIDE)).xyz_from_rgb) @ srgb().xyz_from_rgb).T
    )
    assert wide.pixels == 1


def test_primaries_that_do_not_enclose_their_white_and_absent_files_are_refused(tmp_path):
    outside = WIDE | {"white_xy": [0.6, 0.6]}
    with pytest.raises(InputError, match=r"s\.yaml: display\.device\.white_xy"):
        check_display(made(DisplayDevice, outside), tmp_path, "s.yaml")
    check_display(made(DisplayDevice, WIDE), tmp_path, "s.yaml")
    with pytest.raises(ValueError, match="within the triangle"):
        make_display(made(DisplayDevice, outside))
    with pytest.raises(InputError, match=r"display\.device\.file.*no such file: a\.icc"):
        check_display(ProfileDisplay(file="a.icc"), tmp_path, "s.yaml")
    (tmp_path / "a.txt").write_text("red")
    with pytest.raises(InputError, match=r"\.csv or \.ti3"):
        check_display(MeasuredDisplay(file="a.txt"), tmp_path, "s.yaml")
    with pytest.raises(ValueError, match="kinds standard, primaries, measured, profile"):
        make_display(made(DisplayDevice, {"kind": "crt"}))
    with pytest.raises(ValueError, match="accepted: sRGB, Display P3"):
        standard_display("NTSC")
