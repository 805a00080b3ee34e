"""glTF files: their triangles, their materials beside ours, and what other programs make of them."""

import dataclasses
import itertools
import re
from pathlib import Path

import numpy as np
import pytest
import trimesh
from exported import alone, item, painted, scene_of, shape, validated
from scenes import GOLD_K, GOLD_N, THIRDS, constant_light, material

from irodori.colour.colorimetry import delta_e_reflectance
from irodori.core import store
from irodori.core.errors import PlainError
from irodori.export.gltf_file import EXTENSIONS, write_gltf
from irodori.export.gltf_loss import EVEN, HIGHLIGHT, LAMP, ParsedGltf, judge
from irodori.export.gltf_refit import Texel as Reflecting
from irodori.export.gltf_refit import about_highlight, everywhere, fresnel_colours, refit, rough_terms
from irodori.export.gltf_reflection import GltfSurface, facets, mirrored, reflected
from irodori.export.loss import Loss
from irodori.geometry.atlas import mesh_texels, rasterise
from irodori.material.material_file import Material
from irodori.reflection.equation5 import angles_from_directions
from irodori.reflection.lobe_arrays import evaluate
from irodori.spectra.grid import WAVELENGTH_NM

EXPORTS = Path(__file__).resolve().parents[2] / "docs/exports.md"
KINDS = ["plate", "sphere", "disc", "mesh", "plane"]
GLOSSY = {"reflectance": 0.4, "beta": 2.0, "mu": 0.15}
GREY = np.full((1, 61), 1.0 / 61.0)


@pytest.mark.parametrize("kind", KINDS)
def test_the_triangles_of_a_shape_have_its_places_under_its_texels(kind):
    """The shape's own texel positions are the other account of what its texture coordinates mean."""
    own = shape(kind)
    mesh = own.facetted(50.0)
    covered = mesh_texels(mesh, rasterise(mesh, 64, 32))
    assert (mesh.normals * mesh.facets[:, None]).sum(axis=-1).min() > 0.7
    if kind == "plane":
        assert np.abs(mesh.vertices_mm[:, :2]).max() == 100 * 50.0 and not mesh.vertices_mm[:, 2].any()
        return
    expected = own.atlas(64, 32)
    both = covered.covered & expected.covered
    assert both.mean() > (0.7 if kind == "disc" else 0.9)
    apart = np.linalg.norm(covered.position - expected.position, axis=-1)[both]
    assert apart.max() < 2e-3 * own.reach_mm
    assert (covered.normal * expected.normal).sum(axis=-1)[both].min() > 0.999


def test_the_lobe_of_gltf_is_the_ggx_of_this_package_where_its_facets_cover_the_surface_once():
    geometry = everywhere(400, 0.1)
    for alpha in (0.02, 0.2, 0.9):
        ours = evaluate("ggx", alpha, geometry) / (4 * alpha**2)
        cos_i, cos_r, _, cos_phi = np.cos(geometry).T
        theirs = np.pi * cos_i * facets(alpha, (cos_i, cos_r, cos_phi))
        assert np.allclose(ours, theirs, rtol=1e-6, atol=1e-9)


def test_a_gltf_surface_is_reciprocal_without_its_coat_and_reflects_no_more_than_it_gets():
    geometry = everywhere(4000, 0.7)
    surface = GltfSurface.of([0.9, 0.5, 0.1], 0.8, [0.3, 0.2, 0.04], 0.3, 0.0)
    turned = geometry[:, [1, 0, 2, 3]]
    one, other = (reflected(surface, g) / np.cos(g[:, :1]) for g in (geometry, turned))
    assert np.allclose(one, other, rtol=1e-9)
    # Directions of light even in projected solid angle: the mean is the share of even light that is reflected.
    white = GltfSurface.of([1.0] * 3, 1.0, [0.04] * 3, 0.4, 0.6)
    for theta_r in (0.1, 0.8, 1.3):
        around = everywhere(20000, 0.2)
        azimuth = 2 * np.pi * np.arange(20000) * 0.618034
        eye = np.array([np.sin(theta_r), 0.0, np.cos(theta_r)])
        light = np.stack([np.sin(around[:, 0]) * np.cos(azimuth), np.sin(around[:, 0]) * np.sin(azimuth),
                          np.cos(around[:, 0])], axis=1)  # fmt: skip
        angles = angles_from_directions(np.array([0.0, 0.0, 1.0]), light, eye)
        rough = (reflected(white, angles) / np.cos(angles[:, :1])).mean(axis=0)
        whole = rough + mirrored(white, np.array(theta_r))
        # The rule of glTF, by the half vector's angle, gives rough white a little too much.
        assert (whole <= 1.03).all() and (whole > 0.8).all()


def test_a_ggx_lobe_comes_back_as_it_is_and_mirrors_become_coat_or_lobe():
    for mu in (0.05, 0.2, 0.5):
        own = dataclasses.replace(material(0.3, beta=0.5 / (4 * mu**2), mu=mu), lobes=("ggx",))
        found = refit(own)
        assert found.alpha[0, 0] == pytest.approx(mu, rel=0.05)
        assert found.weight[0, 0] == pytest.approx(0.5, rel=0.15)
        assert found.base[0, 0] == pytest.approx(1.0, abs=0.06)
        assert found.coat == 0.0
    both = refit(material(0.3, beta=1.0, mu=0.2, mirror=0.7))
    assert both.coat == pytest.approx(0.7, rel=1e-3) and both.alpha[0, 0] > 0.1
    mirror = refit(material(0.3, mirror=0.7))
    assert mirror.coat == 0.0 and mirror.alpha[0, 0] == 0.0 and mirror.weight[0, 0] == pytest.approx(0.7)
    matt = refit(material(0.3))
    assert matt.coat == 0.0 and matt.weight[0, 0] == 0.0 and matt.base[0, 0] == pytest.approx(1.0, abs=1e-4)
    # Half of the texels have no gloss: their roughness is that of the others, so that between them no mirror appears.
    some = material(0.3, beta=1.0, mu=0.2)
    some.beta[:, :4] = 0.0
    half = refit(some)
    assert not half.weight[:, :4].any() and half.weight[:, 4:].all()
    assert half.alpha[:, :4] == pytest.approx(half.alpha[0, 4])


TWO = Material.uniform(0.2, beta=1.0, mu=0.3, lobes=("gaussian", "ggx"), further_gloss=((4.0, 0.06),))


@pytest.mark.parametrize("own", [material(0.4, beta=2.0, mu=0.15), material(0.02, beta=0.3, mu=0.5), TWO])
def test_no_lobe_nearby_is_nearer_to_the_material_over_other_directions(own):
    """Lightness from the definition of CIELAB, directions that the fit never saw, roughness and weight all around."""
    found, texels = refit(own), [(name, beta.ravel()[:1], mu.ravel()[:1]) for name, beta, mu in own.gloss]
    reach = np.full((1, 400), 0.6)
    geometry = np.concatenate([everywhere(400, 0.83)[None], about_highlight(reach, 0.83)], axis=1)
    geometry = geometry[:, ~np.isnan(geometry[0, :, 0])]
    diffuse = float(own.basis[0, 0])
    ours = rough_terms(Reflecting(np.array([[diffuse]]), texels), fresnel_colours(own, GREY), geometry)[0, :, 0]

    def root_mean_square(alpha, weight, base):
        surface = GltfSurface.of(diffuse * base, weight, [0.04], alpha, 0.0)
        theirs = reflected(surface, geometry[0])[..., 0]
        light = [np.where(y > 0.008856, 116 * np.cbrt(y) - 16, 903.3 * y) for y in (ours, theirs)]
        return np.sqrt(np.mean((light[0] - light[1]) ** 2))

    alpha, weight, base = found.alpha[0, 0], found.weight[0, 0], found.base[0, 0]
    best = root_mean_square(alpha, weight, base)
    factors = [*itertools.product((0.7, 1.0, 1.4), (0.6, 1.0, 1.6), (0.9, 1.0, 1.1))]
    factors.remove((1.0, 1.0, 1.0))
    around = [root_mean_square(alpha * a, min(weight * w, 1.0), base * b) for a, w, b in factors]
    assert best < 1.1 * min(around)
    # What roughness one reads off the lobe's name, and the weight of its power, are worse.
    (_, beta, mu), *_ = texels
    assert best < root_mean_square(mu[0], min(4 * beta[0] * mu[0] ** 2, 1.0), 1.0)


@pytest.mark.default_cases(2)
@pytest.mark.parametrize("kind", KINDS)
def test_the_validator_finds_nothing_and_trimesh_reads_the_shape_in_metres_with_y_up(kind, tmp_path):
    path, own = tmp_path / "one.glb", painted(**GLOSSY, mirror=0.5)
    write_gltf(alone(kind, own), path, ("D65", "FL11"))
    read = trimesh.load(path)
    low, high = read.bounds
    original = shape(kind).facetted(1.0).vertices_mm
    x, y, z = original.min(axis=0), original.max(axis=0), 1e-3
    assert low == pytest.approx([z * x[0], z * x[2], -z * y[1]], abs=1e-7)
    assert high == pytest.approx([z * y[0], z * y[2], -z * x[1]], abs=1e-7)
    (mesh,) = read.geometry.values()
    assert mesh.visual.uv.shape == (len(mesh.vertices), 2)
    issues = validated(path)["issues"]
    assert issues["numErrors"] == issues["numWarnings"] == 0, issues["messages"]


def test_a_scene_has_its_objects_views_and_one_variant_a_light(tmp_path):
    constant_light().save(tmp_path / "light.h5", store.Provenance("test"))
    views = {"front": {"position_mm": [0.0, -200.0, 90.0], "target_mm": [0.0, 0.0, 0.0], "field_of_view_deg": 30.0},
             "above": {"kind": "orthographic", "position_mm": [0.0, 0.0, 300.0], "target_mm": [0.0, 0.0, 0.0],
                       "height_mm": 100.0, "up": [0.0, 1.0, 0.0]}}  # fmt: skip
    things = [("plate", painted(**GLOSSY), (0, 0, 0), (0, 0, 30)), ("sphere", painted(), (5, 0, 20), (20, 10, 0))]
    path = tmp_path / "stage.glb"
    write_gltf(scene_of(things, views, tmp_path / "light.h5"), path, ("D65", "A"))
    content = ParsedGltf.load(path).content
    assert [one["name"] for one in content["extensions"]["KHR_materials_variants"]["variants"]] == ["D65", "A"]
    assert set(content["extensionsUsed"]) <= set(EXTENSIONS) and len(content["materials"]) == 4
    read = trimesh.load(path)
    assert set(read.geometry) == {"plate", "sphere"}
    centre = read.graph["sphere"][0][:3, 3]
    assert centre == pytest.approx([0.005, 0.020, 0.0], abs=1e-9)
    issues = validated(path)["issues"]
    assert issues["numErrors"] == issues["numWarnings"] == 0, issues["messages"]
    # A camera of glTF looks along its -z: both views meet the target, the origin.
    for node in [one for one in content["nodes"] if "camera" in one]:
        x, y, z, w = node["rotation"]
        forward = -np.array([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])
        at = np.array(node["translation"])
        assert forward == pytest.approx(-at / np.linalg.norm(at), abs=1e-6)


def test_the_file_holds_the_basis_the_loss_that_it_has_and_the_colours_of_every_light(tmp_path):
    own, path = painted(**GLOSSY), tmp_path / "plate.glb"
    losses = write_gltf(alone("plate", own), path, ("D65", "A"))
    parsed = ParsedGltf.load(path)
    told = parsed.content["meshes"][0]["extras"]["irodori"]
    spectra = told["spectra"]
    assert np.array(spectra["basis"]).shape == (2, WAVELENGTH_NM.size)
    mean = np.array(spectra["mean_coefficients"]) @ np.array(spectra["basis"])
    diffuse = own.spectra() * own.spectrum_scale[..., None]
    assert mean == pytest.approx(diffuse.mean(axis=(0, 1)), rel=1e-4)
    again = [judge(item("plate", own), parsed, number, light) for number, light in enumerate(("D65", "A"))]
    for kind in (LAMP, HIGHLIGHT, EVEN):
        values = np.concatenate([one[kind].ravel() for one in again])
        assert told["loss_ciede2000"][kind]["mean"] == pytest.approx(np.nanmean(values), rel=1e-3)
        assert losses[f"plate: {kind}"].mean == pytest.approx(np.nanmean(values), rel=1e-3)
    # Each light's colours belong to its own variant.
    wrong = judge(item("plate", own), parsed, 0, "A")
    assert np.nanmean(wrong[LAMP]) > 2 * np.nanmean(again[1][LAMP])


def test_the_extras_hold_the_spectrum_of_every_texel_and_their_loss(tmp_path):
    """A file that another program has read and written again; the numbers are unpacked as docs/exports.md says."""
    own, path = painted(**GLOSSY), tmp_path / "plate.glb"
    own.alpha[:, ::2] *= 0.53  # the colour that is rendered is α S / S_G, and not S
    losses = write_gltf(alone("plate", own), path, ("D65",))
    trimesh.load(path).export(tmp_path / "again.glb")
    for file in (path, tmp_path / "again.glb"):
        stored = reflectance_of(file, "plate")
        exact = own.alpha[..., None] * own.spectra() / own.green_response[..., None]
        assert np.abs(stored - exact).max() < exact.max() / 1024 and stored.shape == (8, 16, 61)
    found = Loss.of(delta_e_reflectance(exact, stored))
    assert losses["plate: spectra under D65"].text == found.text and 0.0 < found.largest < 0.05
    written = ParsedGltf.load(path).content["meshes"][0]["extras"]["irodori"]["loss_ciede2000"]["spectra under D65"]
    assert written == found.figures()


def reflectance_of(file, name):
    """Run the example of docs/exports.md on another file."""
    (example,) = [
        block
        for block in re.findall(r"```python\n(.*?)```", EXPORTS.read_text(encoding="utf-8"), re.S)
        if "trimesh" in block
    ]
    found: dict = {}
    exec(example.replace("exports/still-life.glb", str(file)).replace("tile-plate", name), found)
    return found["reflectance"]


def test_the_loss_is_that_of_the_file(tmp_path):
    own, path = painted(**GLOSSY), tmp_path / "plate.glb"
    write_gltf(alone("plate", own), path, ("D65",))
    whole = judge(item("plate", own), ParsedGltf.load(path), 0, "D65")
    dull = ParsedGltf.load(path)
    dull.content["materials"][0]["extensions"]["KHR_materials_specular"]["specularFactor"] = 0.0
    without = judge(item("plate", own), dull, 0, "D65")
    assert np.nanmean(without[HIGHLIGHT]) > 5 * np.nanmean(whole[HIGHLIGHT])
    bright = ParsedGltf.load(path)
    bright.content["materials"][0]["extensions"]["KHR_materials_ior"]["ior"] = 2.3
    assert np.nanmean(judge(item("plate", own), bright, 0, "D65")[EVEN]) > 2 * np.nanmean(whole[EVEN])


def test_a_matt_grey_loses_its_rounding_alone_and_gold_keeps_its_colour(tmp_path):
    """The grey one is a sheet: shown from both sides, without what passes through, as its mesh says."""
    sheet = dataclasses.replace(material(0.4), through=material(0.2))
    losses = write_gltf(alone("plate", sheet), tmp_path / "grey.glb")
    content = ParsedGltf.load(tmp_path / "grey.glb").content
    assert all(one["doubleSided"] for one in content["materials"])
    assert "what passes through is left out" in content["meshes"][0]["extras"]["irodori"]["sheet"]
    assert max(loss.largest for loss in losses.values()) < 0.5  # a code of 8 bits is 0.4 of lightness there
    gold = material(0.0, mirror=1.0, n=np.array(GOLD_N)[::-1][THIRDS], k=np.array(GOLD_K)[::-1][THIRDS])
    losses = write_gltf(alone("plate", gold), tmp_path / "gold.glb")
    assert losses["plate: even light"].largest < 4.0
    (entry, *_) = ParsedGltf.load(tmp_path / "gold.glb").content["materials"]
    assert "doubleSided" not in entry
    entry = entry["extensions"]
    red, green, blue = entry["KHR_materials_specular"]["specularColorFactor"]
    assert red > green > blue > 0
    issues = validated(tmp_path / "gold.glb")["issues"]
    assert issues["numErrors"] == issues["numWarnings"] == 0, issues["messages"]


@pytest.mark.parametrize(
    "own",
    [material(0.0), material(1.0), material(0.0, beta=1e5, mu=0.005), material(0.9, beta=10.0, mu=1.2),
     material(0.3, beta=1e-8, mu=1.2), material(0.3, beta=1.0, mu=0.1, n=1.0), material(0.3, 1.0, 0.1, n=10.0, k=5.0),
     material(0.3, beta=1.0, mu=0.1, n=0.2), material(-0.02, beta=1.0, mu=0.1, mirror=50.0)],
)  # fmt: skip
def test_extreme_materials_make_a_finite_file(own, tmp_path):
    losses = write_gltf(alone("plate", own), tmp_path / "one.glb", ("D65",))
    assert all(np.isfinite([loss.mean, loss.p95, loss.largest]).all() for loss in losses.values())
    surface = ParsedGltf.load(tmp_path / "one.glb").surface(0, np.array([0]), np.array([0]))
    for values in surface:
        assert np.isfinite(values).all() and (values >= 0.0).all() and (values <= 1.0).all()
    issues = validated(tmp_path / "one.glb")["issues"]
    assert issues["numErrors"] == issues["numWarnings"] == 0, issues["messages"]


def test_an_unknown_light_is_refused_before_anything_is_written(tmp_path):
    with pytest.raises(PlainError, match="D6"):
        write_gltf(alone("plate", material(0.4)), tmp_path / "one.glb", ("D65", "D6"))
    assert not list(tmp_path.iterdir())
