"""Blurred light that stands in the environment's file is what the picture is made of."""

from dataclasses import replace

import numpy as np
import pytest
from made import made
from scenes import BALL, OPTIONS, material, sky
from studio import BASIS

from irodori.config.models import Render, Scene
from irodori.core.store import Provenance
from irodori.light.environment_file import Environment
from irodori.light.gloss_maps import GlossMaps
from irodori.rendering.frame_state import STILL
from irodori.rendering.integrators import render_image
from irodori.rendering.planning.scene_plan import ScenePlan
from irodori.rendering.planning.stage import plan_of

SHINY = [material(0.3, beta=3.0, mu=0.15)]
SCENE = {
    "integrator": {"kind": "interactive", "light_maps": False},
    "image": {"width": 24, "height": 24},
    "objects": [{"object": "ball", "position_mm": [0, 0, 0], "rotation_deg": [0, 0, 0], "scale": 1.0}],
    "views": {"v": {"position_mm": [0, -200, 0], "target_mm": [0, 0, 0], "up": [0, 0, 1], "field_of_view_deg": 13.0}},
    "lights": [],
    "max_bounces": 4,
    "display": {"exposure": "auto", "device": {"kind": "standard", "name": "sRGB"}},
    "tolerance_ciede2000": 1.0,
    "plan": {},
}


def picture(light, plan=None) -> np.ndarray:
    return render_image(made(Scene, SCENE), "v", [BALL], SHINY, light, made(Render, OPTIONS), plan=plan)[0]


def saved(light: Environment, path, gloss: GlossMaps | None) -> Environment:
    """The light as it is read from a file with these maps."""
    light.save(path, Provenance("test"), gloss=gloss)
    return Environment.load(path)


@pytest.fixture(scope="module")
def light() -> Environment:
    def coefficients(unit):
        x, y, z = np.moveaxis(unit, -1, 0)
        return np.stack([1.2 + z + 0.3 * x, 0.5 + 0.4 * y * z, 0.4 - 0.3 * x * z], axis=-1)

    return sky(coefficients, 64, 32, BASIS)


def test_the_stored_maps_give_the_picture_of_light_that_is_blurred_anew(light, tmp_path):
    truth = picture(light)
    for name, gloss in (("with.h5", GlossMaps.of(light.coefficients)), ("without.h5", None)):
        found = saved(light, tmp_path / name, gloss)
        assert (GlossMaps.stored(found) is None) == (gloss is None)
        assert np.allclose(picture(found), truth, rtol=1e-5, atol=1e-6 * truth.max())


def test_the_stored_maps_are_those_that_are_read(light, tmp_path):
    gloss = GlossMaps.of(light.coefficients)
    dark = replace(gloss, levels=tuple(0 * level for level in gloss.levels))
    matte = render_image(made(Scene, SCENE), "v", [BALL], [material(0.3)], light, made(Render, OPTIONS))[0]
    found = picture(saved(light, tmp_path / "dark.h5", dark))
    assert np.allclose(found, matte, rtol=1e-5, atol=1e-6 * matte.max())
    ball = slice(10, 14), slice(10, 14)
    assert (picture(light)[ball] > 1.02 * matte[ball]).all()


def test_a_plan_finds_the_stored_maps_on_its_own_basis(light, tmp_path):
    found = saved(light, tmp_path / "light.h5", GlossMaps.of(light.coefficients))
    document = plan_of("ball", made(Scene, SCENE), [BALL], SHINY, light, made(Render, OPTIONS))
    assert document["decisions"]["gloss_levels"]["value"][1] > 0
    document["decisions"]["light_bases"]["value"] = light.basis.shape[1] - 1
    truth = render_image(
        made(Scene, SCENE), "v", [BALL], SHINY, light, made(Render, OPTIONS), plan=ScenePlan.of(document), check=False
    )[0]
    same = render_image(
        made(Scene, SCENE), "v", [BALL], SHINY, found, made(Render, OPTIONS), plan=ScenePlan.of(document), check=False
    )[0]
    assert np.allclose(same, truth, rtol=2e-3, atol=1e-4 * truth.max())


def test_light_of_another_colour_has_the_same_maps(light, tmp_path):
    found = saved(light, tmp_path / "light.h5", GlossMaps.of(light.coefficients))
    redder = STILL._replace(filter=tuple(np.linspace(0.5, 1.5, 61))).environment(found)
    assert redder.file == found.file and GlossMaps.stored(redder).first == GlossMaps.stored(found).first
