"""A photograph beside the rendering of its view: equal scenes differ by noise alone, a changed one where it changed."""

import json
from collections.abc import Sequence
from pathlib import Path

import h5py
import numpy as np
import pytest
from definitions import ROOT, edit, fault, load
from made import made
from PIL import Image
from scenes import BALL, constant_light, material, plate
from scipy import ndimage

from irodori.calibration.recovery.calibration_file import Calibration
from irodori.calibration.recovery.mappings import LinearMapping
from irodori.capture.stage import Target, capture_camera, capture_photograph
from irodori.config.cross_checks.scene_photographs import check_photograph
from irodori.config.definitions import load_definitions, read_yaml
from irodori.config.loaded import Loaded
from irodori.config.models import Camera, ObjectShape, Optics, Rig, ScenePhotograph
from irodori.config.parts import Staging
from irodori.core import store
from irodori.core.custody import accept
from irodori.core.errors import InputError
from irodori.evaluation.photograph_comparison import Photograph, compare, compare_photograph, read_photograph
from irodori.geometry.ideal_camera import IdealView
from irodori.geometry.pinhole import Pinhole
from irodori.ingest.camera_reference import ingest_reference
from irodori.ingest.ingest_options import IngestOptions
from irodori.ingest.stage import ingest_raw
from irodori.rendering.photographed_view import render_photographed
from irodori.simulation.virtual_rig.sensor import band_weights
from irodori.spectra.published import light, spectrum

MADE = store.Provenance("test", "config", "code")
SCENE = {
    "objects": [
        {"object": "plate", "position_mm": [0, 0, 0], "rotation_deg": [0, 0, 0], "scale": 1.0},
        {"object": "ball", "position_mm": [10, 0, 20.1], "rotation_deg": [0, 0, 0], "scale": 1.0},
    ],
    "bodies": [], "lights": [],
    "display": {"exposure": "auto", "device": {"kind": "standard", "name": "sRGB"}},
}  # fmt: skip
SHAPES = [
    {"kind": "plate", "width_mm": 100.0, "height_mm": 80.0},
    {"kind": "sphere", "radius_mm": 20.0},
]
PLACED = {
    "camera": "d5100-comb", "position_mm": [0.0, -500.0, 400.0], "target_mm": [0.0, 0.0, 8.0], "up": [0.0, 0.0, 1.0],
    "exposure_s": {"out": [0.02, 0.005], "in": [0.05, 0.01]}, "block": 2, "samples": 64, "seed": 0, "scale": 1.0,
}  # fmt: skip
PAINT, OTHER = spectrum("TCS11"), spectrum("TCS40")


def definitions() -> tuple[dict, dict]:
    """The repository's camera with a small sensor, vignetting, distortion, its filter's plate; a steady, known lamp."""
    # Read as they stand: to check all definitions takes longer than to take the photograph.
    camera, rig = (
        Camera.of(read_yaml(ROOT / "config/cameras/d5100-comb.yaml")).plain(),
        Rig.of(read_yaml(ROOT / "config/rigs/virtual.yaml")).plain(),
    )
    camera["optics"].update(width_px=160, height_px=120, focal_length_mm=8.0, principal_point_px=[78.0, 61.0])
    camera["optics"]["distortion"] = {"k1": -0.1}
    camera["exposure_s"] = {"out": [0.02], "in": [0.05]}
    del rig["motion"]
    for name in ("light_drift", "stray_light", "pose_error", "lamp_spectrum"):
        rig["virtual"]["imperfections"][name]["enabled"] = False
    return camera, rig


def known_calibration(camera: dict, rig: dict, path: Path) -> Calibration:
    """A calibration that errs on nothing in the scene: its basis spans the paints and their reflections."""
    lamp = light(rig["light"]["spectrum"])
    spans = np.stack([np.ones(61), PAINT, PAINT**2, PAINT**3, OTHER, spectrum("TCS56")], axis=1)
    basis = np.linalg.qr(spans)[0]
    weights = band_weights(made(Camera, camera), lamp)
    response_from_weights = weights @ basis / weights.sum(axis=1, keepdims=True)
    exact = Calibration(basis, LinearMapping(np.linalg.inv(response_from_weights).T), lamp, ("out", "in"))
    with store.create(path, MADE) as out:
        exact.write(out)
    return exact


@pytest.fixture(scope="module")
def studio(tmp_path_factory):
    """Folder with a calibrated camera, and a photograph of a red ball on a grey plate under the rig's light."""
    folder = tmp_path_factory.mktemp("photograph")
    camera, rig = definitions()
    known_calibration(camera, rig, folder / "calibration.h5")
    constant_light(0.6 * light(rig["light"]["spectrum"])).save(folder / "light.h5", MADE)
    material(0.4).save(folder / "plate.h5", MADE)
    for name, paint in (("red", PAINT), ("other", OTHER)):
        material(paint, beta=1.0, mu=0.2).save(folder / f"{name}.h5", MADE)
    table = folder / "camera" / "captures.csv"
    table.parent.mkdir()
    capture_camera(Target("camera", made(Camera, camera), made(Rig, rig), table=table), folder / "camera.json", MADE)
    options = IngestOptions()
    ingest_reference(table, table.parent, folder / "reference.h5", MADE, 0.99, options)
    files = [folder / "plate.h5", folder / "red.h5"]
    render_photographed(
        made(Staging, SCENE),
        made(ScenePhotograph, PLACED),
        made(Optics, camera["optics"]),
        made(Sequence[ObjectShape], SHAPES),
        files,
        folder / "light.h5",
        output=folder / "seen.h5",
        provenance=MADE,
    )
    table = folder / "photograph" / "captures.csv"
    table.parent.mkdir()
    capture_photograph(
        made(ScenePhotograph, PLACED),
        folder / "seen.h5",
        Target("s-front", made(Camera, camera), made(Rig, rig), table=table),
        folder / "p.json",
        MADE,
    )
    ingest_raw(table, table.parent, "scene", folder / "reference.h5", folder / "scene.h5", MADE, options=options)
    return folder, camera


def compared(studio, out: Path, materials, virtual=True, **placed) -> tuple[dict, dict]:
    """Figures and datasets of a comparison with the rendering of other materials."""
    folder, camera = studio
    inputs = {
        "linear": folder / "scene.h5",
        "calibration": folder / "calibration.h5",
        "radiance": [folder / "seen.h5"] * virtual,
    }
    inputs |= {"environment": folder / "light.h5", "materials": [folder / f"{name}.h5" for name in materials]}
    outputs = {key: out / f"{key}.png" for key in ("comparison", "photograph", "rendering")}
    outputs |= {"difference": out / "difference.h5", "figures": out / "figures.json"}
    compare_photograph(
        inputs,
        made(Staging, SCENE),
        made(ScenePhotograph, PLACED | placed),
        made(Optics, camera["optics"]),
        made(Sequence[ObjectShape], SHAPES),
        outputs=outputs,
        provenance=MADE,
    )
    with h5py.File(outputs["difference"]) as file:
        data = {name: file[name][()] for name in file}
    return json.loads(outputs["figures"].read_text()), data


def away_from_edges(data) -> np.ndarray:
    """Pixels two away from any edge: there the filter's shift is interpolated."""
    level = data["rendering"][..., 1]
    steep = np.zeros(level.shape, bool)
    for axis in (0, 1):
        steep |= np.abs(np.gradient(level, axis=axis)) > 3.0
    return ~ndimage.binary_dilation(steep, np.ones((3, 3))) & np.isfinite(data["delta_e"])


def test_a_photograph_of_the_very_materials_differs_by_noise_alone(studio, tmp_path):
    figures, data = compared(studio, tmp_path, ("plate", "red"))
    chosen = away_from_edges(data) & (data["objects"] == 1)
    assert chosen.sum() > 150
    found, noise = data["delta_e"][chosen], data["noise"][chosen]
    # Two draws of about 200 pixels, each scattering by 60 % of its mean: the means agree within 6 %, three times over.
    assert found.mean() == pytest.approx(noise.mean(), rel=0.2)
    assert np.percentile(found, 95) == pytest.approx(np.percentile(noise, 95), rel=0.3)
    assert noise.mean() < 1.5
    assert figures["noise_counts"] == ["paths of the rendering", "paths of the photograph", "camera"]
    assert figures["samples"] == PLACED["samples"] * PLACED["block"] ** 2
    assert data["value"].tolist() == [b"X", b"Y", b"Z"]
    known = np.isfinite(data["delta_e"])
    for name, part in (("", known), ("_objects", known & (data["objects"] == 1))):
        assert figures[f"delta_e{name}"]["mean"] == pytest.approx(data["delta_e"][part].mean(), rel=1e-5)
        assert figures[f"noise_floor{name}"]["mean"] == pytest.approx(data["noise"][part].mean(), rel=1e-5)
    assert 0.0 < (known & (data["objects"] == 1)).mean() < known.mean()
    assert figures["luminance_ratio"] == pytest.approx(1.0, abs=0.01) and figures["compared_fraction"] > 0.7
    for name in ("comparison", "photograph", "rendering"):
        with Image.open(tmp_path / f"{name}.png") as image:
            assert image.mode in ("RGB", "RGBA")


def test_a_photograph_of_a_camera_has_no_paths_in_its_noise(studio, tmp_path):
    figures, data = compared(studio, tmp_path, ("plate", "red"), virtual=False, samples=16)
    assert figures["noise_counts"] == ["paths of the rendering", "camera"]
    assert figures["compared_fraction"] > 0.7 and np.nanmax(data["noise"]) > 0.0


def test_a_changed_material_shows_at_its_own_pixels(studio, tmp_path):
    figures, data = compared(studio, tmp_path, ("plate", "other"))
    _, camera = studio
    ideal = IdealView.covering(Pinhole.from_optics(made(Optics, camera["optics"])), 2)
    centre = ideal.pinhole.project([10.0, 0.0, 20.1], np.array(PLACED["position_mm"]), _axes())
    x, y = ideal.pixels_of(2.0 * (centre + 0.5))
    rows, columns = np.indices(data["delta_e"].shape)
    away = np.hypot(rows - y, columns - x) / (20.0 * ideal.focal_px / 640.0)
    known = np.isfinite(data["delta_e"])
    ball, rest = known & (away < 0.9), known & (away > 2.5)
    assert data["delta_e"][ball].min() > 5.0 > np.percentile(data["delta_e"][rest & away_from_edges(data)], 99)
    assert figures["delta_e"]["max"] > 15.0


def _axes():
    from irodori.geometry.rig_frame import look_at

    return look_at(PLACED["position_mm"], PLACED["target_mm"], PLACED["up"])


def test_a_scale_is_applied_or_found(studio, tmp_path):
    half, _ = compared(studio, tmp_path, ("plate", "red"), scale=0.5)
    found, _ = compared(studio, tmp_path, ("plate", "red"), scale="auto")
    assert half["luminance_ratio"] == pytest.approx(0.5, abs=0.005) and half["scale"] == 0.5
    assert found["scale"] == pytest.approx(1.0, abs=0.01) and found["luminance_ratio"] == pytest.approx(1.0, abs=1e-9)
    assert half["delta_e_objects"]["mean"] > 5 * found["delta_e_objects"]["mean"]


def test_the_noise_floor_is_that_of_a_second_draw():
    """Two flat pictures with noise of the camera and of the paths: what is drawn scatters as what is compared."""
    rng = np.random.default_rng(7)
    basis = np.linalg.qr(rng.normal(size=(61, 3)) + 1.0)[0]
    calibration = Calibration(basis, LinearMapping(np.eye(3)), np.ones(61), ("out",))
    flat, size = np.array([0.3, 0.1, 0.1]) @ basis.T + 0.4, (60, 80)
    every = np.ones(size, bool)
    response = (flat @ basis) + rng.normal(0, 0.02, (*size, 3))
    halves = (flat @ basis @ basis.T) * (1 + rng.normal(0, 0.03, (2, *size, 1)))
    found = compare(Photograph(response, every, np.full((*size, 3), 0.02**2)), calibration, halves, np.ones(61))
    assert found.delta_e.mean() == pytest.approx(found.noise.mean(), rel=0.05)
    silent = compare(Photograph(response, every, None), calibration, halves, np.ones(61))
    assert silent.noise.mean() < 0.9 * found.noise.mean()
    # What stood before the camera was rendered too: at a scale of 2 its paths scatter twice as much.
    small = halves.mean(axis=0) + 0.25 * (halves - halves.mean(axis=0))
    picture = Photograph(response, every, None)
    one = compare(picture, calibration, halves, np.ones(61), 2.0, small)
    two = compare(picture, calibration, halves.mean(axis=0) + 1.5 * (halves - halves.mean(axis=0)), np.ones(61))
    assert one.noise == pytest.approx(two.noise, abs=1e-9)
    assert one.photograph == pytest.approx(2.0 * two.photograph) and one.rendering == pytest.approx(two.rendering)
    lost = every.copy()
    lost[5, 7] = False
    some = compare(Photograph(response, lost, None), calibration, halves, np.ones(61))
    assert np.argwhere(np.isnan(some.delta_e)).tolist() == [[5, 7]]


@pytest.mark.parametrize("wavelength_nm", [460.0, 550.0, 680.0])
def test_a_scale_is_found_under_light_of_one_wavelength(wavelength_nm):
    """Deep red has no Z, and still a luminance by which both can be brought to the same brightness."""
    line = (np.arange(400.0, 701.0, 5.0) == wavelength_nm)[:, None].astype(float)
    calibration = Calibration(line, LinearMapping(np.eye(1)), np.ones(61), ("out",))
    response, halves = np.full((4, 5, 1), 0.6), np.broadcast_to(0.2 * line[:, 0], (2, 4, 5, 61)).copy()
    halves[:, 0, 0] = 0.0  # a black pixel tells no ratio
    picture = Photograph(response, np.ones((4, 5), bool), None)
    found = compare(picture, calibration, halves, np.ones(61), "auto")
    assert found.scale == pytest.approx(1 / 3) and found.luminance_ratio == pytest.approx(1.0)
    assert found.delta_e[1:].max() < 1e-6 < 1.0 < found.delta_e[0, 0]


def test_an_undistorted_picture_is_the_scene_seen_straight():
    """What a distorting camera with its axis aside sees of a smooth picture is resampled to where it belongs."""
    pinhole = Pinhole(900.0, (170.0, 110.0), 320, 240, (-0.15, 0.02, 0.001, -0.002, 0.0, 0.0, 0.0, 0.0))
    ideal = IdealView.covering(pinhole, 2)

    def pattern(direction):
        x, y = direction[..., 0] / direction[..., 2], direction[..., 1] / direction[..., 2]
        return np.stack([1 + np.sin(20 * x) * np.cos(17 * y), 1 + x + y], axis=-1)

    centres = np.stack(np.meshgrid(2.0 * np.arange(160) + 1.0, 2.0 * np.arange(120) + 1.0), axis=-1)
    valid = np.ones((120, 160), bool)
    valid[60, 80] = False
    seen, known = ideal.resample(pattern(pinhole.directions(centres, np.eye(3))), valid, 2)
    # Interpolation of the pattern between samples 1/450 apart errs by (20/450)^2 / 8 of it at most.
    assert np.abs(seen - pattern(ideal.rays()))[known].max() < 1e-3
    assert 0.9 * ideal.width * ideal.height > known.sum() > 0.7 * 120 * 160 / 4
    row, column = np.round(ideal.pixels_of(np.array([161.0, 121.0]))[::-1]).astype(int)
    assert not known[row, column]
    # Three of its four samples are valid: their mean is shown, of a place half a sample aside.
    assert seen[row, column] == pytest.approx(pattern(ideal.rays())[row, column], abs=0.03)


def test_blocks_of_a_finer_view_are_gathered_about_the_axis():
    pinhole = Pinhole(900.0, (160.0, 120.0), 320, 240)
    fine, coarse = IdealView.covering(pinhole, 1, 16), IdealView.covering(pinhole, 3)
    assert (fine.width, fine.height, coarse.width) == (176, 136, 54)
    direction = fine.rays()
    gathered = coarse.gathered(direction / direction[..., 2:])
    straight = coarse.rays() / coarse.rays()[..., 2:]
    assert gathered == pytest.approx(straight, abs=1e-12)
    with pytest.raises(ValueError, match="covers"):
        coarse.gathered(direction[40:-40])


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"filters": ("out",)}, r"scene\.h5: filters"),
        ({"unit": "1/s"}, r"scene\.h5: response.*white reference"),
        ({"size_px": (320, 240)}, r"scene\.h5: response.*160 x 120.*320 x 240"),
        ({"size_px": (162, 120)}, r"scene\.h5: response.*160 x 120.*162 x 120"),
        ({"size_px": (160, 119)}, r"scene\.h5: response.*160 x 120.*160 x 119"),
    ],
)
def test_a_photograph_of_another_camera_is_refused_by_name(studio, tmp_path, change, said):
    folder, camera = studio
    calibration = Calibration.load(folder / "calibration.h5")
    optics = camera["optics"]
    if "filters" in change:
        calibration = Calibration(calibration.basis, LinearMapping(np.eye(3, 6)), calibration.light, change["filters"])
    if "size_px" in change:
        width, height = change["size_px"]
        optics = optics | {"width_px": width, "height_px": height}
    linear = tmp_path / "scene.h5"
    linear.write_bytes((folder / "scene.h5").read_bytes())
    if "unit" in change:
        with h5py.File(linear, "a") as file:
            file["response"].attrs["units"] = change["unit"]
        accept(linear)
    with pytest.raises(InputError, match=said):
        read_photograph(linear, calibration, IdealView.covering(Pinhole.from_optics(made(Optics, optics)), 2))


@pytest.mark.parametrize("block", [2, 3])
def test_a_pixel_of_many_samples_has_the_noise_of_their_mean(studio, block):
    """A pixel of two by two superpixels averages four samples of a mosaic that is not interpolated."""
    folder, camera = studio
    ideal = IdealView.covering(Pinhole.from_optics(made(Optics, camera["optics"])), block)
    found = read_photograph(folder / "scene.h5", Calibration.load(folder / "calibration.h5"), ideal)
    with h5py.File(folder / "scene.h5") as file:
        assert file.attrs["sample_px"] == 2
        constant, slope = file["noise_model"][()].T
    seen = found.whole
    one = constant + slope * np.maximum(found.response[seen], 0.0)
    assert found.variance[seen] == pytest.approx(one / block**2, rel=1e-6)


FRONT = "photographs.front"


@pytest.mark.parametrize(
    ("file", "key", "value", "field", "accepted"),
    [
        ("scenes/still-life.yaml", f"{FRONT}.camera", "d5100", f"{FRONT}.camera", "d5100-comb"),
        ("scenes/still-life.yaml", f"{FRONT}.exposure_s", ..., f"{FRONT}.exposure_s", "kind virtual"),
        ("scenes/still-life.yaml", f"{FRONT}.exposure_s", {"out": [0.1]}, f"{FRONT}.exposure_s", "in, out"),
        ("scenes/still-life.yaml", f"{FRONT}.captures", {"table": "a.csv"}, f"{FRONT}.captures", "leave it out"),
        ("scenes/still-life.yaml", f"{FRONT}.target_mm", [0.0, -1399.2, 734.3], f"{FRONT}.target_mm", "another point"),
        ("scenes/still-life.yaml", f"{FRONT}.samples", 24, f"{FRONT}.samples", "16"),
        ("scenes/still-life.yaml", f"{FRONT}.field_of_view_deg", 30.0, f"{FRONT}.field_of_view_deg", ""),
        ("objects/leaf-sphere.yaml", "virtual.materials.0", {"kind": "measured", "file": "config/even.csv"},
         f"{FRONT}.camera", "other kinds"),
    ],
)  # fmt: skip
def test_a_faulty_photograph_in_a_scene_is_refused_before_anything_runs(tmp_path, file, key, value, field, accepted):
    import shutil

    shutil.copytree(ROOT / "config", tmp_path / "config")
    assert load(tmp_path).scenes["still-life"].photographs["front"].samples == 16
    grid = [str(nm) for nm in range(400, 701, 20)]
    rows = [",".join(["theta_i_rad,phi_i_rad,theta_r_rad,phi_r_rad", *grid])]
    rows += [",".join([f"{0.1 * i},0.0,0.3,3.1", *["0.2"] * len(grid)]) for i in range(10)]
    (tmp_path / "config/even.csv").write_text("\n".join(rows) + "\n")
    edit(tmp_path, file, key, value)
    error = fault(tmp_path)
    assert error.field == field and accepted in error.accepted and error.file.endswith("still-life.yaml")


@pytest.mark.parametrize("missing", ["optics", "white"])
def test_a_camera_without_lens_or_white_reference_takes_no_photograph_of_a_scene(missing):
    found = load_definitions(read_yaml(ROOT / "config/config.yaml"), ROOT).plain()
    del found["cameras"]["d5100-comb"][missing]
    loaded = Loaded.of(found)
    with pytest.raises(InputError, match=rf"photographs\.front\.camera: .*without {missing}; accepted: .*{missing}"):
        check_photograph(loaded, loaded.scenes["still-life"], "front", {"out", "in"}, ROOT, lambda kind, name="s": name)


def test_a_users_photograph_needs_its_files_in_the_filter_states_of_the_chart(tmp_path):
    found = load_definitions(read_yaml(ROOT / "config/config.yaml"), ROOT).plain()
    found["rigs"]["virtual"]["kind"] = "files"
    placed = found["scenes"]["still-life"]["photographs"]["front"]
    del placed["exposure_s"]

    def check():
        loaded, states = Loaded.of(found), {"out", "in"}
        scene = loaded.scenes["still-life"]
        check_photograph(loaded, scene, "front", states, tmp_path, lambda kind, name="s.yaml": name)

    with pytest.raises(InputError, match=r"photographs\.front\.captures: found no such key"):
        check()
    placed["captures"] = {"table": "a.csv"}
    with pytest.raises(InputError, match=r"no such file: a\.csv"):
        check()
    lines = ["file,role,light_deg,camera_deg,filter,exposure_s", "a.dng,scene,0,0,out,0.1", "b.dng,scene,0,0,in,0.2"]
    for name in ("a.dng", "b.dng"):
        (tmp_path / name).write_bytes(b"raw")
    (tmp_path / "a.csv").write_text("\n".join(lines[:2]))
    with pytest.raises(InputError, match="filter of the capture scene"):
        check()
    (tmp_path / "a.csv").write_text("\n".join(lines))
    check()
    (tmp_path / "a.csv").write_text("\n".join(lines).replace("scene", "environment"))
    with pytest.raises(InputError, match="of the role scene"):
        check()


def test_a_plate_seen_straight_is_where_the_shapes_say():
    from irodori.evaluation.photograph_comparison import shows_an_object
    from irodori.geometry.shapes.placement import Placement

    ideal = IdealView.covering(Pinhole(1000.0, (100.0, 100.0), 200, 200), 1)
    placed = {"position_mm": [0.0, 0.0, 1000.0], "target_mm": [0.0, 0.0, 0.0], "up": [0.0, 1.0, 0.0]}
    seen = shows_an_object(ideal, made(ScenePhotograph, placed), [Placement(plate(100.0), np.eye(3), np.zeros(3))])
    rows, columns = np.nonzero(seen)
    assert seen.sum() == 50 * 50 and rows.min() == columns.min() == 25
    ball = shows_an_object(ideal, made(ScenePhotograph, placed), [Placement(BALL, np.eye(3), np.zeros(3))])
    assert ball.sum() == pytest.approx(np.pi * 10.0**2, rel=0.05)
