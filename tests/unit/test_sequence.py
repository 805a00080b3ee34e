"""Frame sequences: what is turned is turned, light changes its colour, and an interrupted sequence goes on."""

import copy
import dataclasses
import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numba
import numpy as np
import pytest
import yaml
from made import made
from PIL import Image
from scenes import BALL, OPTIONS, constant_light, material, plate, sky

from irodori.colour.colorimetry import delta_e, lab_from_xyz, xyz_from_radiance
from irodori.config.models import Frames, ObjectShape, Render, Scene
from irodori.config.validation import validate
from irodori.core import store
from irodori.core.errors import InputError
from irodori.light.environment_file import Environment
from irodori.light.placed_lights import unit_luminance
from irodori.rendering import sequence
from irodori.rendering.frame_state import Moment, turned_scene
from irodori.rendering.integrators import make_renderer, render_image
from irodori.rendering.interactive import frame_renderer
from irodori.rendering.light_transfer import LightTransfer

pytestmark = pytest.mark.usefixtures("coarse_light_maps")

BASIS = np.stack([np.linspace(0.6, 1.4, 61), np.linspace(1.5, 0.2, 61)], axis=1)
SUN = {"kind": "collimated", "spectrum": "D65", "azimuth_deg": 20.0, "elevation_deg": 50.0, "irradiance": 0.015}
INTERACTIVE = {"kind": "interactive", "light_maps": True}
REFERENCE = {"kind": "reference", "samples": 128, "seed": 0}
EVERY = pytest.mark.parametrize("integrator", [INTERACTIVE, REFERENCE], ids=lambda i: i["kind"])
SHAPES = [plate(160.0), BALL]
PAINTS = [material(np.linspace(0.3, 0.7, 61), mirror=0.3, n=0.2, k=3.0), material(np.linspace(0.9, 0.1, 61))]


def room(rolled=0) -> Environment:
    """Smooth light that differs all around; ``rolled`` quarters of a turn from +x towards +y."""
    light = sky(lambda d: np.stack([1.2 + d[..., 0] + 0.2 * d[..., 2], 1.2 - d[..., 1] * d[..., 2]], axis=-1),
                128, 64, BASIS)  # fmt: skip
    parts = [np.roll(a, rolled * a.shape[1] // 4, axis=1) for a in (light.coefficients, light.irradiance)]
    return Environment(np.ascontiguousarray(parts[0]), light.basis, np.ascontiguousarray(parts[1]))


def scene_of(integrator, size=(30, 24), frames=None):
    scene = {
        "image": {"width": size[0], "height": size[1]}, "integrator": integrator,
        "display": {"exposure": "auto", "device": {"kind": "standard", "name": "sRGB"}},
        "max_bounces": 2, "lights": [SUN],
        "objects": [{"object": "a", "position_mm": [4.0, -3.0, 0.0], "rotation_deg": [0.0, 8.0, 10.0], "scale": 1.0},
                    {"object": "b", "position_mm": [25.0, 10.0, 24.0], "rotation_deg": [0, 0, 0], "scale": 1.0}],
        "views": {"v": {"position_mm": [20.0, -250.0, 130.0], "target_mm": [0.0, 0.0, 10.0], "up": [0.0, 0.1, 1.0],
                        "field_of_view_deg": 22.0}},
    }  # fmt: skip
    return scene | ({"frames": frames} if frames else {})


def renderer(scene, light=None):
    return make_renderer(made(Scene, scene), SHAPES, PAINTS, light or room(), made(Render, OPTIONS))


def alike(one, other, integrator):
    """Whether two pictures are one: to rounding where nothing is random, but for pixels on an outline."""
    off = np.abs(one - other).max(axis=-1) > 0.02 * one.mean()
    if integrator is REFERENCE:
        return abs(one.mean() / other.mean() - 1) < 0.02 and np.abs(one - other).mean() < 0.1 * one.mean()
    return off.mean() < 0.02


def quarter(scene, part):
    """The same scene with a part turned a quarter from +x towards +y by hand."""
    scene = copy.deepcopy(scene)

    def place(p):
        return [-p[1], p[0], p[2]]

    if part == "objects":
        for item in scene["objects"]:
            item["position_mm"] = place(item["position_mm"])
            item["rotation_deg"] = [*item["rotation_deg"][:2], item["rotation_deg"][2] + 90.0]
    elif part == "eye":
        for key in ("position_mm", "target_mm", "up"):
            scene["views"]["v"][key] = place(scene["views"]["v"][key])
    elif part == "lights":
        for light in scene["lights"]:
            light["azimuth_deg"] += 90.0
    return scene


@pytest.mark.default_cases(2)
@pytest.mark.parametrize(
    ("integrator", "part"),
    [
        (integrator, part)
        for integrator in (INTERACTIVE, REFERENCE)
        for part in ("objects", "eye", "lights", "environment")
    ],
    ids=lambda value: value if isinstance(value, str) else value["kind"],
)
def test_a_part_that_is_turned_looks_as_if_it_had_been_placed_so(integrator, part):
    scene = scene_of(integrator)
    found = renderer(scene).picture("v", Moment(**{f"{part}_deg": 90.0}))[0]
    light = room(int(part == "environment"))
    truth = render_image(made(Scene, quarter(scene, part)), "v", SHAPES, PAINTS, light, made(Render, OPTIONS))[0]
    still = renderer(scene).picture("v")[0]
    assert alike(found, truth, integrator)
    assert not alike(found, still, integrator)


def test_area_lights_turn_about_the_pivot():
    lights = [
        {"kind": "rectangle", "spectrum": "E", "position_mm": [40.0, 0.0, 90.0], "rotation_deg": [180.0, 10.0, 5.0]},
        {"kind": "sphere", "spectrum": "E", "position_mm": [40.0, 7.0, 90.0], "radius_mm": 3.0},
    ]
    scene = scene_of(REFERENCE) | {"lights": lights}
    moment = Moment(lights_deg=90.0, pivot_mm=(10.0, 0.0, 0.0))
    panel, bulb = turned_scene(made(Scene, scene), moment).lights
    assert np.allclose(panel.position_mm, [10.0, 30.0, 90.0]) and [*panel.rotation_deg] == [180.0, 10.0, 95.0]
    assert np.allclose(bulb.position_mm, [3.0, 30.0, 90.0]) and bulb.radius_mm == 3.0
    assert turned_scene(made(Scene, scene), moment).objects == turned_scene(made(Scene, scene), Moment()).objects


@EVERY
def test_a_filter_on_all_light_multiplies_every_band_of_the_picture(integrator):
    scene, factor = scene_of(integrator), np.linspace(0.2, 3.0, 61)
    made = renderer(scene)
    still, filtered = made.picture("v")[0], made.picture("v", Moment(filter=tuple(factor)))[0]
    if integrator is REFERENCE:  # lights are chosen by their power, which the filter changes: other random paths
        assert np.allclose(filtered.mean(axis=(0, 1)), (still * factor).mean(axis=(0, 1)), rtol=0.01)
    else:
        assert np.allclose(filtered, still * factor, rtol=1e-3, atol=1e-5)
    assert np.array_equal(made.picture("v")[0], still)  # and the filter is taken off again


# --- what is asked for -------------------------------------------------------------------------------------------


def turntable(count=4, turned="objects"):
    pivot = [1.0, 2.0, 0.0]
    return {"kind": "turntable", "count": count, "turned": turned, "pivot_mm": pivot, "frames_per_second": 10.0}


def change(illuminants, between=0, white="first", source="D65"):
    return {"kind": "illuminant_change", "from_illuminant": source, "illuminants": illuminants, "white": white,
            "count_between": between, "frames_per_second": 4.0}  # fmt: skip


def test_a_turntable_makes_one_turn_without_its_first_frame_twice():
    moments = sequence.make_moments(made(Frames, turntable(8)))
    assert [m.objects_deg for _, m in moments] == [0, 45, 90, 135, 180, 225, 270, 315]
    assert all(
        m.eye_deg == m.lights_deg == m.environment_deg == 0 and m.pivot_mm == (1.0, 2.0, 0.0) for _, m in moments
    )
    assert [m.eye_deg for _, m in sequence.make_moments(made(Frames, turntable(2, "eye")))] == [0, 180]


@pytest.mark.parametrize(("turned", "parts"), [("environment", {"environment"}), ("lights", {"lights"}),
                                               ("both", {"environment", "lights"})])  # fmt: skip
def test_a_sweep_goes_from_its_first_angle_to_its_last(turned, parts):
    frames = {"kind": "light_sweep", "count": 5, "turned": turned, "from_deg": -30.0, "to_deg": 90.0}
    for part in ("objects", "eye", "lights", "environment"):
        angles = [getattr(m, f"{part}_deg") for _, m in sequence.make_moments(made(Frames, frames))]
        assert angles == ([-30, 0, 30, 60, 90] if part in parts else [0] * 5)


def test_a_change_of_illuminant_is_the_quotient_of_two_spectra_of_one_luminance():
    moments = sequence.make_moments(made(Frames, change(["D65", "A", "FL2"], between=1)))
    assert [set(shown["illuminants"]) for shown, _ in moments] == [{"D65"}, {"D65", "A"}, {"A"}, {"A", "FL2"}, {"FL2"}]
    source = unit_luminance("D65")
    lit = [np.asarray(m.filter) * source for _, m in moments]
    for place, name in ((0, "D65"), (2, "A"), (4, "FL2")):
        assert np.allclose(lit[place], unit_luminance(name))
    assert np.allclose(lit[1], 0.5 * (lit[0] + lit[2])) and np.allclose(lit[3], 0.5 * (lit[2] + lit[4]))


def test_light_is_not_divided_by_darkness(tmp_path):
    dark = tmp_path / "laser.csv"
    rows = [f"{w},{1.0 if w == 550 else 0.0}" for w in range(380, 785, 5)]
    dark.write_text("wavelength_nm,laser\n" + "\n".join(rows), encoding="utf-8")
    with pytest.raises(InputError, match="of its peak at 400 nm"):
        sequence.make_moments(made(Frames, change(["A"], source=str(dark))))
    with pytest.raises(ValueError, match="kinds turntable, light_sweep, illuminant_change"):
        sequence.make_moments(made(Frames, {"kind": "zoom"}))


# --- files -------------------------------------------------------------------------------------------------------


def in_files(folder, scene, **options):
    """Render the frames of a scene in files; return where they are."""
    folder.mkdir(exist_ok=True)
    provenance = store.Provenance("test")
    inputs = [folder / "a.h5", folder / "b.h5", folder / "e.h5"]
    if not inputs[0].is_file():
        for path, paint in zip(inputs[:2], PAINTS, strict=True):
            paint.save(path, provenance)
        room().save(inputs[2], provenance)
    shapes = [{"kind": "plate", "width_mm": 160.0, "height_mm": 160.0}, {"kind": "sphere", "radius_mm": 20.0}]
    outputs = {
        "folder": folder / "v" / "frames",
        "animation": folder / "v.frames.png",
        "figures_file": folder / "v.frames.json",
    }
    sequence.render_frames(
        made(Scene, scene),
        "v",
        made(Sequence[ObjectShape], shapes),
        inputs[:2],
        inputs[2],
        inputs=inputs,
        **outputs,
        options=replace(OPTIONS, **options),
    )
    return list(outputs.values())


def pixels(path):
    with Image.open(path) as image:
        return np.asarray(image.convert("RGB"))


def test_frames_in_files_are_those_of_the_animation_and_leave_nothing_else(tmp_path):
    folder, animation, figures = in_files(tmp_path / "s", scene_of(INTERACTIVE, frames=turntable(4)))
    assert sorted(p.name for p in folder.iterdir()) == [f"{n:05d}.png" for n in range(4)]
    assert not (folder.parent / "frames.part").exists()
    single = [pixels(folder / f"{n:05d}.png") for n in range(4)]
    with Image.open(animation) as image:
        assert image.n_frames == 4 and image.info["loop"] == 0 and image.info["icc_profile"]
        for n in range(4):
            image.seek(n)
            assert image.info["duration"] == 100.0
            assert np.array_equal(np.asarray(image.convert("RGB")), single[n])
    told = json.loads(figures.read_text())
    assert [f["objects_deg"] for f in told["frames"]] == [0.0, 90.0, 180.0, 270.0]
    assert told["kind"] == "turntable" and told["exposure"] == 1.0 and told["frames_from_earlier_runs"] == 0
    assert not np.array_equal(single[0], single[1])


def test_the_first_frame_of_a_turntable_has_maps_of_the_same_kind_as_the_others(tmp_path):
    """A full turn ends where it began: the frames before and after must not jump."""
    folder = in_files(tmp_path / "s", scene_of(INTERACTIVE, frames=turntable(2)))[0]
    turning = renderer(scene_of(INTERACTIVE))
    turning.light_turns = True
    pictures = [turning.picture("v", Moment(objects_deg=angle))[0] for angle in (0.0, 360.0, 180.0)]
    assert np.allclose(pictures[0], pictures[1], rtol=1e-4, atol=1e-4) and not np.allclose(
        pictures[0], pictures[2], atol=0.01
    )
    assert not np.array_equal(pixels(folder / "00000.png"), pixels(folder / "00001.png"))


@pytest.mark.parametrize(
    "frames",
    [turntable(2, turned="eye"), turntable(2), change(["D65", "A"])],
    ids=["eye", "objects", "illuminants"],
)
def test_every_frame_shows_light_maps(tmp_path, frames):
    figures = in_files(tmp_path / "m", scene_of(INTERACTIVE, frames=frames))[2]
    assert [frame["light_maps"] for frame in json.loads(figures.read_text())["frames"]] == [True, True]


@pytest.mark.parametrize("white", ["first", "each"])
def test_the_display_s_white_is_the_first_illuminant_s_or_each_ones_own(tmp_path, white):
    """A white plate under even light: white in every frame, or reddish under A with daylight's white."""
    provenance = store.Provenance("test")
    constant_light(unit_luminance("D65") / unit_luminance("D65")[32]).save(tmp_path / "e.h5", provenance)
    material(1.0).save(tmp_path / "w.h5", provenance)
    scene = scene_of(REFERENCE | {"samples": 8}, (5, 5), change(["D65", "A"], white=white)) | {"lights": []}
    scene["objects"] = [{"object": "w", "position_mm": [0, 0, 0], "rotation_deg": [0, 0, 0], "scale": 1.0}]
    scene["views"]["v"] |= {"position_mm": [0, -1, 300.0], "target_mm": [0, 0, 0], "field_of_view_deg": 5.0}
    shapes, inputs = [{"kind": "plate", "width_mm": 160.0, "height_mm": 160.0}], [tmp_path / "w.h5", tmp_path / "e.h5"]
    outputs = {"folder": tmp_path / "frames", "animation": tmp_path / "f.png", "figures_file": tmp_path / "f.json"}
    sequence.render_frames(
        made(Scene, scene),
        "v",
        made(Sequence[ObjectShape], shapes),
        inputs[:1],
        inputs[1],
        inputs=inputs,
        **outputs,
        options=OPTIONS,
    )
    one, other = (pixels(outputs["folder"] / f"{n:05d}.png")[2, 2].astype(int) for n in range(2))
    assert (one >= 254).all()
    assert (other >= 254).all() if white == "each" else other[0] >= 254 and other[2] < 200


def test_an_interrupted_sequence_goes_on_with_the_frames_that_are_missing(tmp_path, monkeypatch):
    from irodori.rendering import integrators

    scene = scene_of(REFERENCE | {"samples": 8}, (12, 9), turntable(5))
    whole = in_files(tmp_path / "whole", scene)
    real, made, stop = integrators.Renderer.picture, [], 2

    def counted(self, view_name, moment, *rest):
        if len(made) == stop:
            raise KeyboardInterrupt
        made.append(moment.objects_deg)
        return real(self, view_name, moment, *rest)

    monkeypatch.setattr(integrators.Renderer, "picture", counted)
    with pytest.raises(KeyboardInterrupt):
        in_files(tmp_path / "again", scene)
    assert made == [0.0, 72.0] and not (tmp_path / "again/v/frames").exists()
    made.clear()
    stop = 5
    again = in_files(tmp_path / "again", scene)
    assert made == [144.0, 216.0, 288.0]
    for n in range(5):
        # Not byte by byte: the profile tells when it was made.
        assert np.array_equal(pixels(again[0] / f"{n:05d}.png"), pixels(whole[0] / f"{n:05d}.png"))
    assert json.loads(again[2].read_text())["frames_from_earlier_runs"] == 2
    # Frames of another definition are none of this one's.
    made.clear()
    stop = 1
    with pytest.raises(KeyboardInterrupt):
        in_files(tmp_path / "again", scene)
    made.clear()
    stop = 5
    in_files(tmp_path / "again", scene | {"max_bounces": 1})
    assert len(made) == 5


@pytest.mark.parametrize("integrator", [INTERACTIVE, REFERENCE | {"samples": 8}], ids=lambda i: i["kind"])
def test_threads_do_not_change_a_bit_of_a_sequence(tmp_path, integrator):
    if numba.config.NUMBA_NUM_THREADS < 2:
        pytest.skip("one thread only")
    frames = {
        "kind": "light_sweep",
        "count": 3,
        "turned": "both",
        "from_deg": 0.0,
        "to_deg": 80.0,
        "frames_per_second": 9.0,
    }
    before, found = numba.get_num_threads(), []
    try:
        for count in (1, 2):
            numba.set_num_threads(count)
            folder, _, _ = in_files(tmp_path / f"t{count}", scene_of(integrator, (20, 15), frames))
            found.append([pixels(path).tobytes() for path in sorted(folder.iterdir())])
    finally:
        numba.set_num_threads(before)
    assert found[0] == found[1] and len(set(found[0])) == 3


def test_a_sweep_keeps_what_the_eye_met_and_a_turntable_does_not(monkeypatch):
    kept, baked = [], []
    real, maps = frame_renderer.render_frame, LightTransfer.maps

    def noted(*arguments, keep_visibility=False, **options):
        kept.append(keep_visibility)
        return real(*arguments, keep_visibility=keep_visibility, **options)

    monkeypatch.setattr(frame_renderer, "render_frame", noted)
    monkeypatch.setattr(LightTransfer, "maps", lambda *arguments: baked.append(arguments[2]) or maps(*arguments))
    made = renderer(scene_of(INTERACTIVE))
    made.light_turns = True  # as in a sequence
    moments = [Moment(environment_deg=a, lights_deg=a) for a in (0.0, 40.0)]
    fresh = [made.picture("v", m)[0] for m in moments]
    again = [made.picture("v", m, keep=True)[0] for m in moments]
    assert kept == [False, False, False, True, True]  # the first is that which compiles
    assert baked == [0.0, 40.0, 0.0, 40.0]  # once for each picture, also for the first
    assert all(np.array_equal(a, b) for a, b in zip(fresh, again, strict=True))


# --- what colours are carried in ---------------------------------------------------------------------------------


def golden() -> list:
    gold = material(0.2, mirror=0.5, n=np.linspace(1.5, 0.2, 61), k=2.0)
    return [PAINTS[0], gold]


def differences(renderer, reference, moment, white):
    found, figures = renderer.picture("v", moment)
    bands = reference.picture("v", moment)[0]
    matrix = xyz_from_radiance(white)
    labs = [lab_from_xyz(p.reshape(-1, 3).astype(float), matrix @ white) for p in (found, bands @ matrix.T)]
    return delta_e(*labs), figures


@pytest.mark.default_cases(1)
@pytest.mark.parametrize("maps", [False, True])
def test_pictures_in_xyz_are_carried_by_coefficients_where_these_are_exact(maps):
    """Grey mirrors, light and surfaces on bases, two objects that throw light on each other: rounding is all."""
    scene, white = scene_of({"kind": "interactive", "light_maps": maps}), room().upward_white()
    planned = make_renderer(made(Scene, scene), SHAPES, PAINTS, room(), OPTIONS, white=white)
    for moment in (Moment(), Moment(environment_deg=70.0, filter=tuple(np.linspace(0.5, 1.5, 61)))):
        found, figures = differences(planned, renderer(scene), moment, white)
        assert figures["representation"] == "coefficients"
        # The basis of light maps leaves out a thousandth of their light.
        assert found.max() < (0.05 if maps else 0.01)


def test_pictures_are_carried_in_bands_where_coefficients_would_err(caplog):
    caplog.set_level("INFO", logger="irodori")
    scene, white = scene_of({"kind": "interactive", "light_maps": False}), room().upward_white()
    coloured = make_renderer(made(Scene, scene), SHAPES, golden(), room(), OPTIONS, white=white)
    picture, figures = coloured.picture("v")
    assert picture.shape[-1] == 61 and figures["representation"] == "spectral"
    assert "varies with the wavelength" in caplog.text
    # Light and surfaces of so many vectors that their products are more than the bands; of few surfaces they are not.
    rng = np.random.default_rng(0)
    values, weights = rng.random((61, 24)), rng.random((4, 8, 24), np.float32)
    many = Environment(np.ones((16, 32, 24), np.float32), values, np.full((8, 16, 24), np.pi, np.float32))
    motley = [PAINTS[0], dataclasses.replace(PAINTS[0], basis=values, coefficients=weights / 12.0)]
    wide, plain = (make_renderer(made(Scene, scene), SHAPES, m, many, OPTIONS, white=white) for m in (motley, PAINTS))
    for one in (wide, plain):
        one.light(Moment())
    assert wide.representation == "spectral" and "more than 61 bands" in wide.why
    assert plain.representation == "coefficients"
    assert renderer(scene).picture("v")[0].shape[-1] == 61  # and where bands are asked for


def test_the_frames_of_the_turntable_that_is_shipped_are_carried_by_coefficients():
    path = Path(__file__).resolve().parents[2] / "config" / "scenes" / "turntable.yaml"
    shipped = yaml.safe_load(path.read_text(encoding="utf-8"))
    scene = Scene.of(validate(shipped, "scene", path))
    six = np.stack([np.linspace(0.1, 0.9, 61) ** p for p in range(6)], axis=1)
    textured = dataclasses.replace(material(beta=2.0, mu=0.2), basis=six, coefficients=np.ones((4, 8, 6), np.float32))
    shown = make_renderer(scene, [BALL], [textured], room(), OPTIONS, white=room().upward_white())
    shown.light(Moment())
    assert shown.representation == "coefficients"
