"""A near lamp and a distorting lens, from the virtual rig's photographs through rectification to the fit."""

import copy
import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from lathe import write_obj
from made import made
from shortcuts import ball

from irodori.config.capture_table import Pose
from irodori.config.definitions import load_definitions, read_yaml
from irodori.config.models import (
    BodyShape,
    Camera,
    Object,
    ObjectShape,
    Optics,
    Rig,
    RigPose,
)
from irodori.config.parts import NearLamp, PhotographedObject, RigGeometry, TexturedObject
from irodori.config.photograph_sets import PhotographSets
from irodori.core import store
from irodori.core.errors import InputError
from irodori.fitting.solvers import FitOptions
from irodori.fitting.stage import fit_brdf
from irodori.geometry.embree import Tracer
from irodori.geometry.lamp import Lamp
from irodori.geometry.pinhole import Pinhole
from irodori.geometry.rig_frame import rig_from_object, to_light
from irodori.geometry.shapes.placement import Placement
from irodori.geometry.shapes.shape import Shape
from irodori.ingest.flat_field import evaluate_flat, fit_flat
from irodori.ingest.near_lamp import evenly_lit
from irodori.rectification.stage import RigSetup, observe, rectify_object
from irodori.simulation.virtual_rig.ground_truth import true_material
from irodori.simulation.virtual_rig.samples import Sample
from irodori.simulation.virtual_rig.sensor import band_weights
from irodori.simulation.virtual_rig.subjects import object_mosaic, white_mosaic
from irodori.spectra.published import spectrum

ROOT = Path(__file__).resolve().parents[2]
PROVENANCE = store.Provenance("test")
STRAIGHT = np.eye(2, 3)
NEAR_MM = 350.0
PLATE_POSES = [Pose(45.0, c) for c in (0.0, 25.0, 38.0, 45.0, 52.0, 65.0)] + [Pose(65.0, c) for c in (20.0, 58.0, 66.0)]
SPHERE_POSES = [
    Pose(light, camera, 0.0, turn)
    for light, camera in ((35.0, 0.0), (45.0, 40.0), (60.0, 20.0))
    for turn in (0.0, 90.0, 180.0, 270.0)
]


@pytest.fixture(scope="module")
def definitions():
    return load_definitions(read_yaml(ROOT / "config/config.yaml"), ROOT).plain()


def small(definitions, distance_mm=NEAR_MM, distortion=None):
    """A camera of 200 x 150 superpixels with the field of the configured one, and a rig without faults."""
    camera, rig = copy.deepcopy(definitions["cameras"]["d5100-comb"]), copy.deepcopy(definitions["rigs"]["virtual"])
    camera["optics"] |= {
        "pixel_pitch_um": 20.0,
        "width_px": 400,
        "height_px": 300,
        "principal_point_px": [200.0, 150.0],
    }
    if distortion:
        camera["optics"]["distortion"] = distortion
    for fault in rig["virtual"]["imperfections"].values():
        fault["enabled"] = False
    if distance_mm:
        rig["light"]["distance_mm"] = distance_mm
    return camera, rig


def setup_of(camera, rig, white=True):
    """Return the setup of a camera and a rig; the white reference stands in the camera's pose for it, if asked for."""
    pose = made(RigPose, camera["poses"]["white"]) if white else None
    return RigSetup.from_definitions(made(Optics, camera["optics"]), RigGeometry.of_rig(made(Rig, rig)), pose)


def uniform(definitions, shape, beta=4.0, mu_rad=0.15):
    definition = copy.deepcopy(definitions["objects"]["tile-plate"])
    material = {"spectrum": "TCS16", "beta": beta, "mu_rad": mu_rad}
    definition |= {"shape": shape, "mirror_weight": 0.0, "texels": {"width": 24, "height": 16}}
    definition["virtual"] = {"pattern": {"kind": "uniform"}, "materials": [material]}
    return definition


def superpixels(mosaic):
    """Red, green and blue of an RGGB mosaic, as ingestion bins them."""
    return np.stack([mosaic[::2, ::2], 0.5 * (mosaic[::2, 1::2] + mosaic[1::2, ::2]), mosaic[1::2, 1::2]], axis=-1)


def photographed(tmp_path, definition, camera, rig, poses):
    """Linear files of the poses: the virtual rig's pictures over the surface through its white, as ingestion does."""
    weights = band_weights(made(Camera, camera), spectrum(rig["light"]["spectrum"]))[:3]
    place = Pose(**camera["poses"]["white"])
    white = superpixels(white_mosaic(made(Camera, camera), made(Rig, rig), place, STRAIGHT, weights))
    level = camera["white"]["reflectance_factor"] * math.cos(math.radians(place.light_deg - place.tilt_deg))
    flat = evaluate_flat(fit_flat(white, np.ones(white.shape[:2], dtype=bool)), *white.shape[:2]) / level
    sample, files = Sample.from_definition(made(Object | PhotographedObject, definition)), []
    for pose in poses:
        response = (
            superpixels(object_mosaic(sample, made(Camera, camera), made(Rig, rig), pose, STRAIGHT, weights)) / flat
        )
        files.append(tmp_path / f"{pose.name}.h5")
        with store.create(files[-1], PROVENANCE) as out:
            out.write("response", response.astype("f4"), units="1", dims="row,column,band", quantity="response")
            for name, value in (("valid", 1), ("clipped", 0)):
                values = np.full(response.shape[:2], value, np.uint8)
                out.write(name, values, units="1", dims="row,column", quantity=name)
            out.write("noise_model", np.zeros((3, 2)), units="1", dims="band,term", quantity="noise")
            out.attribute("sample_px", 2)
            out.attribute("mosaic", "")
            out.attribute("pose_deg", [pose.light_deg, pose.camera_deg, pose.tilt_deg, pose.turn_deg])
            out.attribute("filters", ["out"])
    return files


def fitted(tmp_path, definitions, definition, files, setup):
    """Rectify and fit; return α, β, μ and where texels have observations enough."""
    rows = (0, definition["texels"]["height"])
    rectify_object(
        files,
        made(Object | TexturedObject, definition),
        setup,
        rows,
        75.0,
        output=tmp_path / "tile.h5",
        provenance=PROVENANCE,
    )
    options = FitOptions(**definitions["config"]["fit"])
    fit_brdf(tmp_path / "tile.h5", tmp_path / "brdf.h5", options, 1.5, 0.0, provenance=PROVENANCE)
    with store.open_file(tmp_path / "tile.h5") as file:
        enough = (file.read("weight") > 0).sum(axis=1) >= 6
    if definition["shape"]["kind"] == "plate":  # pixels on its edges see the table as well
        edge = np.ones((rows[1], definition["texels"]["width"]), dtype=bool)
        edge[2:-2, 2:-2] = False
        enough &= ~edge.ravel()
    with store.open_file(tmp_path / "brdf.h5") as file:
        return *(file.read(name) for name in ("alpha", "beta", "mu")), enough


def errors(tmp_path, definitions, definition, camera, poses, *, rig, assumed):
    """Return 95th percentiles of the relative errors of α, β and μ, the rectification believing in ``assumed``."""
    files = photographed(tmp_path, definition, camera, rig, poses)
    setup = setup_of(camera, assumed)
    alpha, beta, mu, enough = fitted(tmp_path, definitions, definition, files, setup)
    truth = true_material(made(Object, definition), made(Camera, camera), made(Rig, rig))
    material = definition["virtual"]["materials"][0]
    assert enough.mean() > 0.15
    exact = (truth.alpha.ravel()[0], material["beta"], material["mu_rad"])
    return [
        float(np.nanpercentile(np.abs(f[enough] / e - 1), 95)) for f, e in zip((alpha, beta, mu), exact, strict=True)
    ]


PLATE = {"kind": "plate", "width_mm": 90.0, "height_mm": 70.0}
SPHERE = {"kind": "sphere", "radius_mm": 28.0}


@pytest.mark.default_cases(1)
@pytest.mark.parametrize(("shape", "poses"), [(PLATE, PLATE_POSES), (SPHERE, SPHERE_POSES)], ids=["plate", "sphere"])
def test_a_material_under_a_near_lamp_is_recovered_and_is_not_where_the_lamp_is_taken_as_far(
    tmp_path, definitions, shape, poses
):
    camera, rig = small(definitions)
    far = copy.deepcopy(rig)
    del far["light"]["distance_mm"]
    definition = uniform(definitions, shape, mu_rad=0.25)
    near = errors(tmp_path, definitions, definition, camera, poses, rig=rig, assumed=rig)
    wrong = errors(tmp_path, definitions, definition, camera, poses, rig=rig, assumed=far)
    # What is left on the sphere is the optical low-pass filter's blur over its curvature.
    assert max(near) < (0.003 if shape is PLATE else 0.03), near
    assert wrong[0] > 0.05 and wrong[0] > 5 * near[0], wrong


def test_what_a_near_lamp_does_not_light_is_divided_by_the_vignetting_alone(definitions):
    """The white reference without the lamp's fall-off is that under a far lamp."""
    camera, near = small(definitions)
    far = copy.deepcopy(near)
    del far["light"]["distance_mm"]
    pose, weights = Pose(**camera["poses"]["white"]), band_weights(made(Camera, camera), spectrum("A"))[:3]
    x, y = np.linspace(-1.0, 1.0, 200), np.linspace(-0.75, 0.75, 150)[:, None]
    vignetting, whites = 1.0 - 0.1 * (x - 0.1) ** 2 - 0.1 * y**2, []
    for rig in (near, far):
        white = superpixels(white_mosaic(made(Camera, camera), made(Rig, rig), pose, STRAIGHT, weights))
        white = white * vignetting[..., None]
        whites.append(fit_flat(white, np.ones(white.shape[:2], dtype=bool)))
    geometry = RigGeometry.of_rig(made(Rig, near))
    lamp = NearLamp(
        optics=made(Optics, camera["optics"]), rig=geometry, white_pose=made(RigPose, camera["poses"]["white"])
    )
    size = camera["optics"]["width_px"], camera["optics"]["height_px"]
    found = evaluate_flat(evenly_lit(whites[0], size, lamp), 75, 100)
    uneven, even = (evaluate_flat(white, 75, 100) for white in whites)
    assert np.abs(uneven / even - 1.0).max() > 0.1
    off = np.abs(found / even - 1.0).max(axis=(0, 1))
    # Red and blue lie a quarter of these large superpixels beside the middle.
    assert off[1] < 2e-4 and off.max() < 2e-3


def test_only_what_a_near_lamp_does_not_light_is_ingested_without_its_fall_off():
    config = read_yaml(ROOT / "config/config.yaml")
    asked = {
        "far": SimpleNamespace(environment="classroom"), "place": SimpleNamespace(environment="classroom"),
        "object": SimpleNamespace(object="tile-plate"), "chart": SimpleNamespace(camera="d5100-comb"),
    }  # fmt: skip
    found = {}
    for name, wildcards in asked.items():
        loaded = load_definitions(config, ROOT)
        if name != "far":
            rig = loaded.rigs["virtual"]
            near = replace(rig, light=replace(rig.light, distance_mm=NEAR_MM))
            loaded = replace(loaded, rigs={**loaded.rigs, "virtual": near})
        found[name] = PhotographSets(loaded).near_lamp(wildcards)
    assert found["far"] is found["object"] is found["chart"] is None
    lamp = NearLamp.of(found["place"])
    assert lamp.rig.lamp_distance_mm == NEAR_MM and lamp.optics.width_px > 0


@pytest.mark.heavy
def test_a_mesh_under_a_near_lamp_is_recovered_like_the_sphere(tmp_path, definitions):
    camera, rig = small(definitions)
    write_obj(tmp_path / "ball.obj", *ball(28.0, 64, 128), digits=9)
    definition = uniform(definitions, {"kind": "mesh", "file": str(tmp_path / "ball.obj"), "unit": "mm"}, mu_rad=0.25)
    near = errors(tmp_path, definitions, definition, camera, SPHERE_POSES, rig=rig, assumed=rig)
    assert max(near) < 0.03, near


def test_the_virtual_camera_photographs_a_sphere_of_triangles_as_the_sphere(tmp_path, definitions):
    camera, rig = small(definitions, distance_mm=None)
    write_obj(tmp_path / "ball.obj", *ball(28.0, 64, 128), digits=9)
    weights = band_weights(made(Camera, camera), spectrum("A"))[:3]
    pictures = [
        object_mosaic(
            Sample.from_definition(made(Object | PhotographedObject, uniform(definitions, shape))),
            made(Camera, camera),
            made(Rig, rig),
            Pose(60.0, 20.0),
            STRAIGHT,
            weights,
        )
        for shape in (SPHERE, {"kind": "mesh", "file": str(tmp_path / "ball.obj"), "unit": "mm"})
    ]
    apart = np.abs(pictures[0] - pictures[1])
    assert pictures[0].max() > 0.3
    # At the outline and at the end of the light a point or two of the nine in a pixel go to the other side.
    assert apart.mean() < 1e-3 * pictures[0].mean() * 2 and apart.max() < 0.1 * pictures[0].max()


@pytest.mark.heavy
@pytest.mark.parametrize("near", [False, True])
def test_a_lens_that_distorts_changes_nothing_that_is_recovered(tmp_path, definitions, near):
    lens = {"k1": -0.6, "k2": 0.3, "p1": 0.01, "p2": -0.01}
    found = []
    for distortion in (None, lens):
        camera, rig = small(definitions, NEAR_MM if near else None, distortion)
        definition = uniform(definitions, PLATE, mu_rad=0.25)
        found.append(errors(tmp_path, definitions, definition, camera, PLATE_POSES, rig=rig, assumed=rig))
    assert max(found[0]) < 0.003 and max(found[1]) < 0.003, found


def test_a_distortion_left_out_moves_the_pattern(tmp_path, definitions):
    """Checks of black and white: where the lens is known, texels beside their edges are black or white."""
    camera, rig = small(definitions, None, {"k1": 40.0})
    definition = uniform(definitions, PLATE, beta=0.0)
    definition["texels"] = {"width": 72, "height": 56}
    definition["virtual"] = {
        "pattern": {"kind": "checks", "columns": 9, "rows": 7},
        "materials": [{"spectrum": s, "beta": 0.0, "mu_rad": 0.2} for s in ("TCS0", "TCS98")],
    }
    files = photographed(tmp_path, definition, camera, rig, [Pose(45.0, 0.0)])
    straight = copy.deepcopy(camera)
    del straight["optics"]["distortion"]
    truth = true_material(made(Object, definition), made(Camera, camera), made(Rig, rig)).alpha
    index = Sample.from_definition(made(Object | PhotographedObject, definition)).material_index(72, 56)
    inner = np.zeros_like(index, dtype=bool)
    inner[2:-2, 2:-2] = np.all(
        [index[2 + a : 54 + a, 2 + b : 70 + b] == index[2:-2, 2:-2] for a in (-2, 2, 0) for b in (-2, 2, 0)], axis=0
    )
    worst = []
    for known in (camera, straight):
        rectify_object(
            files,
            made(Object | TexturedObject, definition),
            setup_of(known, rig),
            (0, 56),
            80.0,
            output=tmp_path / "t.h5",
            provenance=PROVENANCE,
        )
        with store.open_file(tmp_path / "t.h5") as file:
            diffuse = file.read("response")[:, 0, 1] / np.cos(math.radians(45.0))
        worst.append(np.abs(diffuse.reshape(56, 72) - truth)[inner].max())
    assert worst[0] < 0.02 * truth.max() and worst[1] > 0.3 * np.ptp(truth), worst


# The lamp


@given(
    distance=st.floats(50.0, 1e5), light=st.floats(35.0, 125.0), seed=st.integers(0, 2**32 - 1),
)  # fmt: skip
@settings(deadline=None, max_examples=50)
def test_power_falls_off_by_the_inverse_square_towards_the_lamps_own_place(distance, light, seed):
    pose = Pose(light, 10.0)
    points = np.random.default_rng(seed).uniform(-20.0, 20.0, (50, 3))
    direction, power, way = Lamp(distance).seen_from(points, pose)
    lamp = distance * np.array([math.sin(math.radians(light)), 0.0, math.cos(math.radians(light))])
    assert points + way[:, None] * direction == pytest.approx(np.tile(lamp, (50, 1)), rel=1e-9, abs=1e-6)
    assert power * np.sum((lamp - points) ** 2, axis=1) == pytest.approx(np.full(50, distance**2), rel=1e-12)


def test_a_lamp_very_far_away_is_a_far_light(definitions):
    points = np.random.default_rng(1).uniform(-50.0, 50.0, (100, 3))
    pose = Pose(60.0, 20.0)
    near, far = Lamp(1e9).seen_from(points, pose), Lamp().seen_from(points, pose)
    assert np.abs(near[0] - far[0]).max() < 1e-7 and np.abs(near[1] - far[1]).max() < 1e-6
    assert np.isinf(far[2]).all() and (far[0] == to_light(pose)).all()
    pinhole = Pinhole.from_optics(made(Optics, small(definitions)[0]["optics"]))
    xy = np.random.default_rng(2).uniform(0, 150, (100, 2))
    assert Lamp(1e9).on_white(xy, pinhole, 900.0, Pose(45.0, 0.0)) == pytest.approx(np.ones(100), abs=1e-6)
    assert (Lamp().on_white(xy, pinhole, 900.0, Pose(45.0, 0.0)) == 1.0).all()


def test_a_perfect_diffuser_in_the_whites_place_has_the_cosine_of_its_own_incidence(definitions):
    # The white's fall-off divided once is the texel's own there: what is left is the cosine.
    camera, rig = small(definitions)
    setup, pose = (
        setup_of(camera, rig),
        Pose(**camera["poses"]["white"]),
    )
    position = np.random.default_rng(3).uniform(-40, 40, (200, 3)) * [1, 1, 0]
    normal = np.tile([0.0, 0.0, 1.0], (200, 1))
    shape = Shape.from_definition(made(ObjectShape | BodyShape, PLATE))
    sight = observe(position, normal, Tracer([Placement(shape, rig_from_object(pose))]), pose, setup)
    assert np.ptp(sight.geometry[:, 0]) > math.radians(3.0)
    file_says = math.cos(math.radians(pose.light_deg))  # a picture of the white over the surface through it
    found = setup.light_gain(sight.xy, sight.power) * file_says
    assert found == pytest.approx(np.cos(sight.geometry[:, 0]), rel=1e-9)


def test_nothing_behind_a_near_lamp_casts_a_shadow(definitions):
    camera, rig = small(definitions, distance_mm=100.0)
    pose = Pose(45.0, 0.0)
    beyond = Placement(
        Shape.from_definition(made(ObjectShape | BodyShape, {"kind": "sphere", "radius_mm": 20.0})),
        translation_mm=150 * to_light(pose),
    )
    tracer = Tracer(
        [
            Placement(Shape.from_definition(made(ObjectShape | BodyShape, PLATE))),
            beyond,
        ]
    )
    point, normal = np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]])
    assert observe(point, normal, tracer, pose, setup_of(camera, rig)).lit[0]
    del rig["light"]["distance_mm"]
    assert not observe(point, normal, tracer, pose, setup_of(camera, rig)).lit[0]


def test_a_near_lamp_without_a_white_reference_is_refused(definitions):
    camera, rig = small(definitions)
    with pytest.raises(InputError, match=r"poses\.white.*near"):
        setup_of(camera, rig, white=False)
    assert setup_of(camera, rig).white_pose is not None


def test_a_lamp_inside_the_object_is_refused(tmp_path, definitions):
    camera, rig = small(definitions, distance_mm=20.0)
    setup = setup_of(camera, rig)
    with pytest.raises(InputError, match=r"light\.distance_mm.*20 mm, within the reach of the object, 28 mm"):
        rectify_object(
            [],
            made(Object | TexturedObject, uniform(definitions, SPHERE)),
            setup,
            (0, 1),
            80.0,
            output=tmp_path / "t.h5",
            provenance=PROVENANCE,
        )


def test_a_white_that_does_not_fill_the_picture_is_refused(definitions):
    camera, _ = small(definitions)
    pinhole = Pinhole.from_optics(made(Optics, camera["optics"]))
    with pytest.raises(InputError, match="do not see lit"):
        Lamp(300.0).on_white(np.array([[0.0, 0.0], [400.0, 0.0], [200.0, 150.0]]), pinhole, 900.0, Pose(45.0, 89.0))
