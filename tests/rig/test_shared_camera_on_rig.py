"""A plate and a ball before one camera of the virtual rig: together they tell what neither of them tells alone."""

import numpy as np
import pytest
from made import made
from test_object_registration import (  # noqa: F401
    NAMES,
    PLATE,
    POSES,
    SPHERE,
    an_object,
    as_typed,
    definitions,
    error_at_object_mm,
    photographs,
)

from irodori.config.models import Object, Placing
from irodori.config.parts import PhotographedObject
from irodori.core import store
from irodori.rectification.object_registration import register_object
from irodori.rectification.placement_correction import LIGHT
from irodori.rectification.registration_file import read_told
from irodori.rectification.shared_camera import combined

PROVENANCE = store.Provenance("test")
DISTANCE, FOCAL, HEIGHT = (NAMES.index(name) for name in ("camera_distance_mm", "focal_length_percent", "z_mm"))
LAID_OFF = {"plate": (-1.2, 1.5, 0.6, 0.6, 0.5, -1.0), "ball": (1.0, -0.7, -0.4, 0.0, 0.0, 0.0)}


@pytest.mark.heavy
def test_a_plate_tells_a_ball_where_the_camera_stands_and_a_refocused_one_does_not(tmp_path, definitions):  # noqa: F811
    shapes = {"plate": an_object(definitions, PLATE), "ball": an_object(definitions, SPHERE, {"kind": "uniform"})}
    setup, told, files = as_typed(definitions, 850.0, 52.5), {}, {}
    true = np.array([50.0, 100.0 * (50.0 / 52.5 - 1.0)])
    for name, definition in shapes.items():
        folder = tmp_path / name
        folder.mkdir()
        files[name] = photographs(folder, definitions, definition, POSES, LAID_OFF[name])
        whole, output = made(Object | PhotographedObject, definition), tmp_path / f"{name}.h5"
        register_object(files[name], whole, setup, Placing(), output=output, provenance=PROVENANCE)
        told[name] = read_told(output)
    alone, together = ({name: one.estimate for name, one in found.items()} for found in (told, combined(told)))
    optics, ball = [DISTANCE, FOCAL], "ball"
    assert not alone[ball].told[optics].any() and together[ball].told[optics].all()
    off = np.abs(together[ball].values[optics] - true)
    # As exact as photographs agree, and not as edges might be.
    assert (off < 3.0 * together[ball].sigma[optics]).all() and (together[ball].sigma[optics] < [2.5, 0.25]).all()
    assert np.abs(alone[ball].values[optics] - true).max() > 20.0
    assert np.abs(together[ball].values[:3] - LAID_OFF[ball][:3]).max() < 0.02
    assert together[ball].sigma[HEIGHT] < 0.7 * alone[ball].sigma[HEIGHT]
    assert np.abs(together["plate"].values[:3] - LAID_OFF["plate"][:3]).max() < 0.03
    assert together[ball].values[LIGHT] == 0.0

    # The same photographs of the plate, told to be of a lens 2 % longer: as if somebody had refocused before them.
    other = as_typed(definitions, 850.0, 53.55)
    again = tmp_path / "refocused.h5"
    whole = made(Object | PhotographedObject, shapes["plate"])
    register_object(files["plate"], whole, other, Placing(), output=again, provenance=PROVENANCE)
    found = combined({**told, "late": read_told(again)})
    np.testing.assert_array_equal(found[ball].estimate.values, together[ball].values)
    assert found["late"].remarks[0].startswith("left apart from plate, ball, which contradict it")
