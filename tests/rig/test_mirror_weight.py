"""The weight of the mirror term on the virtual rig: measured where the lamp's image is not clipped, else assumed."""

import math
from dataclasses import replace

import numpy as np
import pytest
from made import made
from test_near_light import PLATE, PROVENANCE, fitted, photographed, setup_of, small, uniform
from test_near_light import definitions as definitions

from irodori.config.capture_table import Pose
from irodori.config.models import Camera, Object, Rig
from irodori.core import store
from irodori.fitting.diffuse_response import GREEN
from irodori.fitting.mirror_image import MirrorImages
from irodori.fitting.paint_stage import share_gloss
from irodori.fitting.solvers import FitOptions
from irodori.fitting.stage import read_observations
from irodori.simulation.virtual_rig.ground_truth import true_material

#: Three of them look where the lamp's mirror image is.
POSES = [Pose(45.0, c) for c in (0.0, 25.0, 36.0, 45.0, 54.0, 65.0)] + [Pose(60.0, c) for c in (20.0, 50.0, 60.0)]
POSES += [Pose(30.0, 30.0), Pose(30.0, 10.0)]
RADIUS_DEG = 1.5


def surface(tmp_path, definitions, weight, radius_deg=RADIUS_DEG) -> dict:
    """What the file of the fit says of the mirror weight of a plate, and the largest error of its α."""
    camera, rig = small(definitions, None)
    rig["virtual"]["light_angular_radius_deg"] = RADIUS_DEG
    definition = uniform(definitions, PLATE, mu_rad=0.2) | {
        "mirror_weight": weight,
        "texels": {"width": 48, "height": 32},
    }
    files, setup = photographed(tmp_path, definition, camera, rig, POSES), setup_of(camera, rig, white=False)
    options = definitions["config"]["fit"] | {"lamp_radius_deg": radius_deg}
    believed = definitions | {"config": definitions["config"] | {"fit": options}}
    fitted(tmp_path, believed, definition, files, setup)
    out = tmp_path / "surface.h5"
    share_gloss(
        [tmp_path / "tile.h5"], [tmp_path / "brdf.h5"], out, FitOptions(**options), 1.5, 0.0, provenance=PROVENANCE
    )  # fmt: skip
    truth = true_material(made(Object, definition), made(Camera, camera), made(Rig, rig)).alpha.ravel()[0]
    with store.open_file(out) as file:
        inside = np.zeros((32, 48), dtype=bool)
        inside[3:-3, 3:-3] = True
        off = np.abs(file.read("alpha").ravel() / truth - 1.0)[inside.ravel()]
        return file.attribute("mirror_weight", dict) | {"off": float(np.nanquantile(off, 0.95))}


@pytest.mark.stability(stage="fit", case="a lamp's mirror image that is not clipped")
@pytest.mark.default_cases(1)
@pytest.mark.parametrize("weight", [0.0, 0.004, 0.02])
def test_a_mirror_image_that_is_not_clipped_measures_the_weight(tmp_path, definitions, weight):
    found = surface(tmp_path, definitions, weight)
    assert found["photographs"] == 3 and found["clipped"] == 0
    assert abs(found["weight"] - weight) < max(2.5 * found["error"], 1e-4)
    assert found["error"] < 0.1 * weight + 3e-4
    assert found["off"] < 0.01


def test_a_clipped_image_and_a_lamp_of_unknown_size_tell_nothing(tmp_path, definitions):
    assert surface(tmp_path, definitions, 0.02, radius_deg=None)["photographs"] == 0
    observed = read_observations(tmp_path / "tile.h5")
    bright = observed.geometry[..., 3] < 0.4 * math.radians(RADIUS_DEG)
    clipped = replace(observed, clipped=bright.astype(np.uint8), weight=np.where(bright, 0.0, observed.weight))
    images = MirrorImages(FitOptions(**definitions["config"]["fit"], lamp_radius_deg=RADIUS_DEG), 1.5, 0.0, GREEN)
    with store.open_file(tmp_path / "surface.h5") as file:
        maps = {name: file.read(name) for name in ("alpha", "beta", "mu")}
    images.add(clipped, maps)
    found = images.measured()
    assert math.isnan(found.weight) and found.clipped == found.photographs == 3
