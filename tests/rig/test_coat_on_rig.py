"""A coupled coat on the virtual rig: photographed, rectified and fitted, it is recovered, and as a sum it is not."""

import pytest
from test_near_light import PLATE, PLATE_POSES, errors, small, uniform
from test_near_light import definitions as definitions

from irodori.reflection.coat import COATS, COUPLED


@pytest.mark.parametrize("coat", COATS)
def test_a_plate_under_a_coupled_coat_is_recovered_by_the_fit_that_knows_of_it(tmp_path, definitions, coat):
    camera, rig = small(definitions)
    definition = uniform(definitions, PLATE, mu_rad=0.25)
    definition["virtual"]["coat"] = COUPLED
    believed = definitions | {"config": definitions["config"] | {"fit": definitions["config"]["fit"] | {"coat": coat}}}
    off = errors(tmp_path, believed, definition, camera, PLATE_POSES, rig=rig, assumed=rig)
    assert max(off) < 0.003 if coat == COUPLED else off[0] > 0.01, off
