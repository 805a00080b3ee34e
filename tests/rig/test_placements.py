"""A ball that was turned over and laid down again, somewhat otherwise than typed, is put together on one texture."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from laid_balls import OVER, POSES, angle_deg
from made import made
from test_object_registration import PROVENANCE, SPHERE, an_object, as_typed, photographs

from irodori.config.definitions import load_definitions, read_yaml
from irodori.config.models import LaidOff, Object, Placing
from irodori.config.parts import PhotographedObject
from irodori.core.errors import InputError
from irodori.core.store import open_file
from irodori.geometry.rig_frame import rotation_xyz
from irodori.geometry.shapes.placement import Placement
from irodori.geometry.shapes.sphere import Sphere
from irodori.rectification.object_registration import FirstPlacement, register_object
from irodori.rectification.placement_correction import Correction
from irodori.simulation.virtual_rig.subjects import _laid_off

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def definitions():
    return load_definitions(read_yaml(ROOT / "config/config.yaml"), ROOT).plain()


def a_ball(definitions, pattern=None, rotation_deg=OVER):
    return an_object(definitions, SPHERE, pattern, placements=[{"rotation_deg": list(rotation_deg)}])


class Laid:
    """A ball photographed in two placements, the first of them registered."""

    def __init__(self, folder, definitions, pattern=None) -> None:
        self.folder, self.definitions, self.pattern = folder, definitions, pattern
        for name in ("1", "2", "wrong"):
            (folder / name).mkdir()
        ball, off = a_ball(definitions, pattern), (0.8, -0.6, 0.2, 0.2, -0.3, 0.4)
        self.first = named(photographs(folder / "1", definitions, ball, POSES, off))
        self.further = [replace(pose, placement=2) for pose in POSES]
        self.second = named(photographs(folder / "2", definitions, ball, self.further, off))
        self.at_first = folder / "registration.h5"
        self.register(self.first, self.at_first)

    def register(self, files, output, rotation_deg=OVER) -> None:
        first = None if files is self.first else FirstPlacement.load(self.first, self.at_first)
        whole = made(Object | PhotographedObject, a_ball(self.definitions, self.pattern, rotation_deg))
        setup, placing = as_typed(self.definitions), Placing()
        register_object(files, whole, setup, placing, first=first, output=output, provenance=PROVENANCE)


def named(files):
    """Rename files as the workflow names them."""
    return [file.rename(file.with_name(file.name[4:])) for file in files]


@pytest.fixture(scope="module")
def laid(tmp_path_factory, definitions):
    return Laid(tmp_path_factory.mktemp("laid"), definitions)


def real_turn(definitions, number) -> np.ndarray:
    """table_from_object of the ball as the virtual rig laid it, of which registration is told nothing."""
    rig = definitions["rigs"]["virtual"]["virtual"]
    off = made(LaidOff, {"enabled": True, "rotation_deg": [0.2, -0.3, 0.4]})
    lain = Placement(Sphere(30.0), np.eye(3) if number == 1 else rotation_xyz(OVER))
    return _laid_off(lain, off, rig["seed"], number).rotation


@pytest.mark.heavy
def test_the_paints_tell_how_a_ball_was_turned_when_it_was_laid_down_again(laid):
    output = laid.folder / "registration-2.h5"
    laid.register(laid.second, output)
    with open_file(output) as file:
        sigma, sentence = file.read("sigma")[3:6], file.attribute("sentence")
    assert "placement 2: by texture, turned by" in sentence and (sigma < 0.5).all()
    first, second = (Correction.load(path).table_from_object for path in (laid.at_first, output))
    real = real_turn(laid.definitions, 2) @ real_turn(laid.definitions, 1).T @ first
    typed = rotation_xyz(OVER)
    assert angle_deg(real @ typed.T) > 3.0
    assert angle_deg(real @ (second @ typed).T) < min(0.5, 4.0 * np.linalg.norm(sigma))


@pytest.mark.heavy
def test_a_rotation_of_90_degrees_typed_for_180_is_refused_with_that_which_the_paints_show(laid):
    with pytest.raises(InputError, match=r"placements\[0\].*placement 2 show.*turned by \[-?1[78]\d, ") as raised:
        laid.register(laid.second, laid.folder / "none.h5", (90.0, 0.0, 0.0))
    assert raised.value.field == "placements[0].rotation_deg"


@pytest.mark.heavy
def test_a_photograph_in_the_wrong_placement_is_refused_by_its_name(laid):
    ball, off = a_ball(laid.definitions), (0.8, -0.6, 0.2, 0.2, -0.3, 0.4)
    # What its line says to be the second placement shows the first.
    strange = named(
        photographs(laid.folder / "wrong", laid.definitions, ball, POSES[2:3], off, lies={0: laid.further[2]})
    )
    files = [*laid.second[:2], strange[0].rename(strange[0].with_name(laid.second[2].name)), *laid.second[3:]]
    with pytest.raises(InputError, match=r"found 2, though the photograph shows the object in placement 1") as raised:
        laid.register(files, laid.folder / "none.h5")
    assert Path(raised.value.file).name == laid.second[2].name and raised.value.field == "placement"


@pytest.mark.heavy
def test_a_ball_of_one_paint_tells_nothing_of_its_turn(tmp_path, definitions):
    uniform = Laid(tmp_path, definitions, {"kind": "uniform"})
    uniform.register(uniform.second, tmp_path / "registration-2.h5")
    with open_file(tmp_path / "registration-2.h5") as file:
        assert "no texture that both placements show tells its rotation" in file.attribute("sentence")
        assert (file.read("correction")[3:6] == 0.0).all() and (file.read("sigma")[3:6] > 4.0).all()
