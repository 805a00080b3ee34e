"""The interactive integrator where everything that is hard comes at once."""

import numpy as np
import pytest
from depth import examples
from hard_scenes import SCENES, brightest_of, hard_scene
from hypothesis import given, settings
from studio import picture


@pytest.mark.stability(stage="render", case="all of part F together, interactive")
@given(**SCENES)
@settings(deadline=None, max_examples=examples(10))
def test_a_scene_that_is_hard_in_several_ways_ends_finite_interactively(**scene):
    shapes, materials, light, view = hard_scene(**scene)
    places, position = view.pop("places"), view.pop("position")
    found = picture(shapes, materials, light, "spectral", {"position": position, "size": (8, 6), **view}, places=places,
                    white=np.ones(61))  # fmt: skip
    assert np.isfinite(found).all()
    # Blurred light is a Fourier series, which rounds to either side of zero.
    assert found.min() >= -1e-5 * brightest_of(scene)
    if scene["sun"] == "none" and (scene["beta"] == "none" or scene["mirror"] == 1.0):
        assert found.max() <= 1.002
