"""The command ``irodori export`` with names: files, previews, losses, and what it refuses."""

import argparse
import csv
import json
import shutil

import h5py
import numpy as np
import OpenImageIO as oiio
import pytest
import tifffile
import yaml
from exported import painted
from PIL import Image
from scenes import smooth_sky
from tm27_files import tm27

from benchmarks.written_pictures import loss_stated_in
from irodori.colour.colorimetry import xyz_from_radiance
from irodori.colour.display import standard_display
from irodori.config.photograph_sets import light_definition, light_files, material_definition, material_files
from irodori.config.project import load_named
from irodori.core import custody, store
from irodori.core.errors import InputError
from irodori.core.made_of import made_of
from irodori.export.export_command import TARGETS, command_parser, export_named, main
from irodori.export.export_sources import find
from irodori.export.gltf_loss import EVEN, HIGHLIGHT, LAMP, SPECTRA, ParsedGltf
from irodori.export.pictures import write_display_picture, write_spectral_exr
from irodori.rendering.stage import write_picture
from irodori.viewer import viewer_command

OBJECTS = ("tile-plate", "vermilion-sphere", "indigo-sphere", "leaf-sphere")
#: IEC 61966-2-1, whose white is that of D65.
SRGB_FROM_XYZ = np.array([[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]])


@pytest.fixture
def project(root, monkeypatch):
    """The default project with small results; half of the plate is not photographed."""
    monkeypatch.chdir(root)
    own = painted(reflectance=0.4, beta=2.0, mu=0.15, mirror=0.3)
    own.alpha[:, 8:] = np.nan
    for name in OBJECTS:
        (root / "results" / name).mkdir(parents=True)
        own.save(root / "results" / name / "material.h5", store.Provenance("test"))
    (root / "results/environments").mkdir()
    smooth_sky(64, 32).save(root / "results/environments/classroom.h5", store.Provenance("test"))
    return root, own


def read(path) -> np.ndarray:
    source = oiio.ImageInput.open(str(path))
    pixels = source.read_image(source.spec().format)
    source.close()
    return pixels


def given(*words) -> argparse.Namespace:
    return command_parser("export").parse_intermixed_args([str(word) for word in words])


def test_a_tiff_of_16_bits_has_its_profile_its_loss_and_the_colours_of_the_standard(project, capsys):
    root, own = project
    assert main(["tile-plate", "--to", "tiff"]) == 0
    path = root / "exports/tile-plate.tif"
    assert capsys.readouterr().out.startswith("exports/tile-plate.tif\nunder D65: CIEDE2000 mean")
    codes = read(path)
    assert codes.dtype == np.uint16 and codes.shape == (8, 16, 3)
    with tifffile.TiffFile(path) as file:
        embedded, known = file.pages[0].tags[34675].value, standard_display("sRGB").profile
        told = file.pages[0].tags["ImageDescription"].value
    assert embedded[:24] == known[:24] and embedded[36:] == known[36:]  # between them stands when it was made
    assert "irodori:illuminant D65" in told and "irodori:loss CIEDE2000 mean" in told
    # Colorimetry of colour-science, the matrix and the curve of the standard as they are printed there.
    import colour

    wavelength = np.arange(400, 701, 5)
    d65 = colour.SDS_ILLUMINANTS["D65"]
    for column in (0, 4):
        spectrum = own.spectra()[0, column].astype(float)
        reflectance = colour.SpectralDistribution(dict(zip(wavelength, spectrum, strict=True)))
        reflectance = reflectance.extrapolate(colour.SpectralShape(360, 780, 5))
        with colour.utilities.suppress_warnings(colour_runtime_warnings=True):  # it aligns both, and says so
            rgb = SRGB_FROM_XYZ @ colour.sd_to_XYZ(reflectance, illuminant=d65) / 100
        expected = np.where(rgb <= 0.0031308, 12.92 * rgb, 1.055 * np.maximum(rgb, 0) ** (1 / 2.4) - 0.055)
        inside = (rgb > 0.0) & (rgb < 1.0)
        assert np.abs(codes[0, column] / 65535 - expected)[inside].max() < 2e-3
    # What no photograph shows has the colour of its nearest neighbour.
    assert (codes[:, 8] == codes[:, 7]).all()


def test_a_wide_display_loses_what_rounding_takes_and_srgb_what_it_cannot_show(project):
    root, _ = project
    losses = {}
    for display in ("sRGB", "Adobe RGB (1998)"):
        words = ("tile-plate", "--to", "tiff", "--illuminant", "A", "--display", display)
        losses[display] = export_named("tile-plate", root / "a.tif", given(*words))[1]["under A"]
    assert losses["Adobe RGB (1998)"].largest < 0.05
    assert losses["sRGB"].mean >= losses["Adobe RGB (1998)"].mean
    assert losses["sRGB"].compared == 64  # texels that were photographed


@pytest.mark.parametrize("to", ["gltf", "tiff", "spectral-exr", "envi"])
def test_an_object_is_exported_with_a_preview_beside_it(project, to):
    root, _ = project
    path, losses = export_named("tile-plate", None, given("tile-plate", "--to", to, "--illuminant", "D65"))
    assert path.is_file() and losses and path.suffix == TARGETS[to].suffix
    with Image.open(root / f"{path}.png") as preview:
        assert preview.size == (16, 8) and preview.info["icc_profile"]
        assert np.asarray(preview).std() > 5
    assert not [file for file in (root / "exports").iterdir() if "part" in file.name]


def of_today(root, name):
    """Store today's definition with the small material of an object, as its rule does."""
    definition = load_named("objects", name).objects[name]
    state(root / f"results/{name}/material.h5", made_of(material_definition(definition), material_files(definition)))


def state(file, own):
    """Store a definition with a result."""
    with h5py.File(file, "r+") as out:
        out.attrs["made_of"] = "json:" + json.dumps(own)
    custody.accept(file)


def edited(root, name, kind="objects", **keys):
    file = root / f"config/{kind}/{name}.yaml"
    file.write_text(yaml.safe_dump(yaml.safe_load(file.read_text(encoding="utf-8")) | keys), encoding="utf-8")


@pytest.mark.parametrize("name", ["tile-plate", "still-life"])
def test_a_material_is_refused_after_its_definition_has_changed(project, capsys, name):
    root, _ = project
    of_today(root, "tile-plate")
    edited(root, "tile-plate", description="Other words.")
    find(name)
    edited(root, "tile-plate", shape={"kind": "plate", "width_mm": 45.0, "height_mm": 90.0}, lobes=["ggx"])
    assert main([name, "--to", "gltf"]) == 2
    said = capsys.readouterr().err
    assert "made before shape, lobes of config/objects/tile-plate.yaml changed" in said
    assert "accepted: what 'snakemake --cores 2 results/tile-plate/material.h5' makes" in said and said.count("\n") == 1
    assert viewer_command.main(["still-life"]) == 2 and "made before shape" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["environments/classroom", "still-life"])
def test_a_light_is_refused_after_its_definition_has_changed(project, capsys, name):
    root, _ = project
    place = load_named("environments", "classroom").environments["classroom"]
    light = root / "results/environments/classroom.h5"
    find(name)  # of an earlier version, which states nothing
    state(light, made_of(light_definition(place), light_files(place)))
    edited(root, "classroom", "environments", description="Other words.")
    find(name)
    edited(root, "classroom", "environments", lamps=["FL2"], image={"width": 64, "height": 32})
    accepted = "accepted: what 'snakemake --cores 2 results/environments/classroom.h5' makes"
    with pytest.raises(InputError, match=r"made before image, lamps of config/environments/classroom\.yaml") as error:
        find(name)
    assert accepted in str(error.value)
    assert viewer_command.main(["still-life"]) == 2 and "made before image, lamps" in capsys.readouterr().err


def test_a_material_is_refused_after_a_table_of_its_definition_has_changed(project):
    root, _ = project
    table = "wavelength_nm,n,k\n" + "".join(f"{nm},1.5,0\n" for nm in range(400, 701, 50))
    (root / "index.csv").write_text(table, encoding="utf-8")
    edited(root, "tile-plate", refractive_index={"file": "index.csv"})
    of_today(root, "tile-plate")
    find("tile-plate")
    (root / "index.csv").write_text(table.replace("1.5", "1.6"), encoding="utf-8")
    with pytest.raises(InputError, match="made before files of"):
        find("tile-plate")


def test_definitions_of_another_configuration_are_found_and_its_command_is_named(project, capsys):
    root, _ = project
    shutil.copytree(root / "config", root / "mine")
    (root / "config/config.yaml").unlink()
    shutil.rmtree(root / "config/objects")
    (root / "mine.yaml").write_text("definitions: mine\n", encoding="utf-8")
    assert main(["tile-plate", "--configfile", "mine.yaml", "--to", "tiff"]) == 0
    (root / "results/tile-plate/material.h5").unlink()
    capsys.readouterr()
    for command in (main, viewer_command.main):
        words = ["still-life", "--to", "gltf"] if command is main else ["still-life"]
        assert command(["--configfile=mine.yaml", *words]) == 2
        said = "'snakemake --cores 2 --configfile mine.yaml -- results/tile-plate/material.h5'"
        assert said in capsys.readouterr().err


def test_the_back_of_a_sheet_is_among_the_materials_of_a_page(project, monkeypatch):
    root, _ = project
    file = root / "config/scenes/still-life.yaml"
    scene = yaml.safe_load(file.read_text(encoding="utf-8"))
    scene["objects"][0]["back"] = "lining"
    file.write_text(yaml.safe_dump(scene), encoding="utf-8")
    edited(root, "tile-plate", sheet={"transmittance": 0.2})
    shutil.copy(root / "config/objects/tile-plate.yaml", root / "config/objects/lining.yaml")
    shutil.copytree(root / "results/tile-plate", root / "results/lining")
    given = []
    monkeypatch.setattr("irodori.viewer.stage.export_viewer", lambda sources, **_: given.append(sources))
    assert viewer_command.main(["still-life"]) == 0
    files = [str(path) for path in given[0].materials]
    assert files == [f"results/{name}/material.h5" for name in (*OBJECTS, "lining")]


def test_a_light_is_exported_by_its_name(project):
    root, _ = project
    export_named("classroom", root / "room.exr", given("classroom", "--to", "spectral-exr"))
    with Image.open(root / "room.exr.png") as preview:
        assert preview.size == (64, 32)
    assert loss_stated_in(root / "room.exr").compared == 64 * 32


def test_every_picture_of_a_view_has_its_row_in_the_table_of_losses(project, tmp_path):
    from benchmarks.exports import pictures

    root, _ = project
    (root / "results/still-life").mkdir()
    radiance = np.random.default_rng(5).uniform(0.1, 1.0, (48, 64, 61)).astype(np.float32)
    view, white = root / "results/still-life/front", np.ones(61)
    write_spectral_exr(view.with_suffix(".exr"), radiance, radiance[..., :3], {}, white=white)
    matrix = xyz_from_radiance(white)
    write_picture(view.with_suffix(".png"), radiance @ matrix.T, matrix @ white, standard_display("sRGB"))
    rows = pictures(tmp_path)
    assert [row["export"] for row in rows] == [
        f"results/still-life/front.{kind}" for kind in ("exr", "png", "tif", "xyz.exr")
    ]
    spectral, eight_bits, sixteen_bits, xyz = (row["mean"] for row in rows)
    assert eight_bits > sixteen_bits and spectral > xyz > 0.0 and all(row["count"] == 3072 for row in rows)


def test_a_scene_has_its_picture_as_preview_and_its_objects_where_they_stand(project):
    root, _ = project
    profile = standard_display("sRGB").profile
    (root / "results/still-life").mkdir()
    picture = np.full((6, 8, 3), 90, np.uint8)
    write_display_picture(root / "results/still-life/front.png", picture, profile, {})
    assert main(["still-life", "--to", "gltf", "out/scene.glb", "--illuminant", "D65"]) == 0
    assert (root / "out/scene.glb.png").read_bytes() == (root / "results/still-life/front.png").read_bytes()
    content = ParsedGltf.load(root / "out/scene.glb").content
    placed = {one["name"]: one for one in content["nodes"]}
    assert placed["tile-plate"]["scale"] == [2.4] * 3 and placed["leaf-sphere"]["translation"] == [46.0, -34.0, 30.1]
    assert content["meshes"][0]["extras"]["irodori"]["spectra"]["file"] == "results/tile-plate/material.h5"
    assert len(content["meshes"]) == len(OBJECTS) + 1  # and the table


@pytest.mark.heavy
def test_a_loss_that_cannot_be_measured_is_told_with_its_reason(project, capsys, monkeypatch):
    root, _ = project
    (root / "results/still-life").mkdir()
    profile = standard_display("sRGB").profile
    write_display_picture(root / "results/still-life/front.png", np.full((48, 64, 3), 9, np.uint8), profile, {})
    radiance = np.ones((48, 64, 61), np.float32)
    write_spectral_exr(root / "results/still-life/front.exr", radiance, radiance[..., :3], {})
    (root / "mitsuba.py").write_text("raise ImportError('no Mitsuba on this machine')\n")
    monkeypatch.setenv("PYTHONPATH", str(root), prepend=":")
    assert main(["still-life", "--to", "mitsuba"]) == 0
    assert "view front: not measured: ImportError: no Mitsuba on this machine" in capsys.readouterr().out
    about = json.loads((root / "exports/still-life-mitsuba/about.json").read_text())
    assert about["loss_ciede2000"] == {"not_measured": "ImportError: no Mitsuba on this machine"}
    names = {file.name for file in (root / "exports/still-life-mitsuba").iterdir()}
    assert {"scene.xml", "sky.npz", "irodori_mitsuba.py", "00-tile-plate.npz"} <= names


@pytest.mark.default_cases(7)
@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["still-life", "--to", "obj"], "--to: found 'obj'; accepted: gltf, mitsuba, tiff, spectral-exr, envi."),
        (["jar", "--to", "gltf"], "no scene or object 'jar'; accepted: one of: celadon-lid,"),
        (["bowls/jar", "--to", "gltf"], "no scene or object 'bowls/jar'"),
        (["still-life", "--to", "tiff"], "--to tiff: found the scene 'still-life'; accepted: object."),
        (["tile-plate", "--to", "mitsuba"], "--to mitsuba: found the object 'tile-plate'; accepted: scene."),
        (["classroom", "--to", "gltf"], "--to gltf: found the environment 'classroom'; accepted: scene or object."),
        (
            ["celadon-lid", "--to", "gltf"],
            "material.h5: found no file; accepted: what 'snakemake --cores 2 results",
        ),
        (["still-life", "--to", "gltf"], "results/still-life/front.png: found no file; accepted: what 'snakemake"),
        (["still-life", "--to", "mitsuba"], "results/still-life/front.png: found no file; accepted: what 'snakemake"),
        (["tile-plate", "--to", "tiff", "config/config.yaml/a.tif"], "config/config.yaml: cannot be written: "),
        (["tile-plate", "--to", "gltf", "a.obj"], "a.obj: found the suffix '.obj'; accepted: .glb, of --to gltf."),
        (["tile-plate", "--to", "gltf", "--illuminant", "D6"], "found 'D6'; accepted:"),
        (["tile-plate", "--to", "tiff", "--illuminant", "TCS3"], "--illuminant: found 'TCS3'; accepted: "),
        (["tile-plate", "--to", "gltf", "--illuminant", "A", "no.csv"], "--illuminant: found no such file: no.csv;"),
        (["tile-plate", "--to", "tiff", "--illuminant", "A", "D65"], "--illuminant: found 2 lights; accepted: one"),
        (["tile-plate", "--to", "spectral-exr", "--interleave", "bil"], "with the suffix .img"),
        (["tile-plate"], "tile-plate: found neither --to nor a file to write; accepted: one of them."),
    ],
)
def test_what_cannot_be_exported_is_refused_in_one_sentence(project, capsys, words, said):
    root, _ = project
    assert main(words) == 2
    out, err = capsys.readouterr()
    assert said in err and err.count("\n") == 1 and not out
    exports = root / "exports"
    assert not exports.exists() or not [file for file in exports.iterdir() if file.suffix in (".glb", ".tif", ".exr")]


@pytest.mark.parametrize("to", ["tiff", "gltf"])
def test_a_reflectance_is_refused_as_illuminant(project, capsys, to):
    root, _ = project
    (root / "refl.spdx").write_text(tm27("reflectance"))
    assert main(["tile-plate", "--to", to, "--illuminant", "refl.spdx"]) == 2
    err = capsys.readouterr().err
    assert err.startswith("refl.spdx: SpectralQuantity: found reflectance; accepted: the power of a light")
    assert err.count("\n") == 1 and not (root / "exports").exists()


def test_a_folder_that_is_a_file_is_refused_before_anything_is_written(project, capsys):
    root, _ = project
    (root / "results/still-life").mkdir()
    for kind in ("png", "exr"):
        (root / f"results/still-life/front.{kind}").write_bytes(b"")
    assert main(["still-life", "--to", "mitsuba", "config/config.yaml"]) == 2
    assert "config/config.yaml: found a file; accepted: the name of a folder" in capsys.readouterr().err
    assert not (root / "config/config.yaml.png").exists()


def test_a_material_that_no_photograph_determines_is_refused(project, capsys):
    root, own = project
    own.alpha[:] = np.nan
    own.save(root / "results/tile-plate/material.h5", store.Provenance("test"))
    assert main(["tile-plate", "--to", "gltf"]) == 2
    assert "no texel on the surface with data" in capsys.readouterr().err


def test_the_table_of_losses_is_measured_from_the_files_and_shown_with_its_reasons(project, tmp_path):
    from benchmarks.exports import COLUMNS, measured
    from benchmarks.published_tables import exports_block

    calls = ("tile-plate --to gltf --illuminant D65", "tile-plate --to spectral-exr", "tile-plate --to envi",
             "classroom --to spectral-exr", "classroom --to envi")  # fmt: skip
    rows = [row for call in calls for row in measured(call, tmp_path)]
    assert [row["compared"] for row in rows[:4]] == [f"tile-plate: {kind}" for kind in (LAMP, HIGHLIGHT, EVEN, SPECTRA)]
    spectral = rows[4:]
    assert [row["count"] for row in spectral] == [64, 64, 2048, 2048] and all(row["max"] < 1e-3 for row in spectral)
    sizes = [(tmp_path / f"tile-plate-{name}").stat().st_size for name in ("gltf.glb", "spectral-exr.exr")]
    assert [float(rows[at]["mb"]) for at in (0, 4)] == pytest.approx([size / 1e6 for size in sizes], rel=1e-3)
    rows.append({"export": "still-life mitsuba", "compared": "view front", "count": "not measured: no | LLVM"})
    with (tmp_path / "exports.csv").open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, COLUMNS)
        writer.writeheader()
        writer.writerows(row | {"mb": "1", "cpu_s": "2"} for row in rows)
    *_, last = exports_block(tmp_path).splitlines()
    assert last == "| `still-life mitsuba` | view front: not measured: no / LLVM | – | – | – | 1 | 2 |"
