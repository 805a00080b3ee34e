"""The plate of the virtual rig, seen through a filter that shifts, turns and magnifies, is registered."""

import math
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from made import made
from shortcuts import moving_from_fixed

from benchmarks.plate_pictures import photograph
from irodori.config.capture_table import Pose
from irodori.config.definitions import load_definitions, read_yaml
from irodori.config.models import Camera, Object, Rig
from irodori.config.parts import PhotographedObject
from irodori.geometry.pinhole import bayer_offsets_px
from irodori.ingest.registration.similarity import Registration, register
from irodori.simulation.virtual_rig.samples import Sample
from irodori.simulation.virtual_rig.sensor import band_weights
from irodori.simulation.virtual_rig.subjects import object_mosaic
from irodori.spectra.published import spectrum

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def definitions():
    return load_definitions(read_yaml(ROOT / "config/config.yaml"), ROOT).plain()


def ideal_from_seen(plate: Registration, width_px: int, height_px: int) -> np.ndarray:
    """Return the inverse of a plate's map in mosaic coordinates, (2, 3)."""
    turn = plate.scale * np.exp(1j * plate.rotation_rad)
    matrix = np.linalg.inv([[turn.real, -turn.imag], [turn.imag, turn.real]])
    centre = np.array([width_px / 2, height_px / 2])
    return np.column_stack([matrix, centre - matrix @ (centre + np.array([2.0 * plate.dx_px, 2.0 * plate.dy_px]))])


def see(definitions, pose: Pose, plate: Registration, state: int) -> np.ndarray:
    """Return the mosaic of white-referenced responses of the tile plate through a filter plate."""
    camera, rig = definitions["cameras"]["d5100-comb"], definitions["rigs"]["virtual"]
    sample = Sample.from_definition(made(Object | PhotographedObject, definitions["objects"]["tile-plate"]))
    weights = band_weights(made(Camera, camera), spectrum("A"))[3 * state : 3 * state + 3]
    moved = ideal_from_seen(plate, camera["optics"]["width_px"], camera["optics"]["height_px"])
    image = object_mosaic(sample, made(Camera, camera), made(Rig, rig), pose, moved, weights)
    row, column = np.indices(image.shape, sparse=True)
    return image / weights.sum(axis=1)[row % 2 + column % 2]


@pytest.fixture(scope="module")
def unfiltered(definitions):
    """Return a function that returns the mosaic of a pose without the plate, computed once."""
    return cache(lambda pose: see(definitions, pose, Registration(0.0, 0.0, 0.0, 1.0, 0.0, 0.0), 0))


def found_error_px(definitions, unfiltered, pose: Pose, plate) -> float:
    """Return the rms error over the object."""
    dx, dy, rotation_deg, scale = plate
    rng = np.random.default_rng(3)
    truth = Registration(dx, dy, math.radians(rotation_deg), scale, 0.0, 0.0, (199.5, 149.5))
    fixed, fixed_valid = photograph(unfiltered(pose), 0, rng)
    moving, moving_valid = photograph(see(definitions, pose, truth, 1), 1, rng)
    found = register(fixed, moving, fixed_valid, moving_valid, band_offsets_px=bayer_offsets_px("RGGB"))
    row, column = np.nonzero(fixed.sum(axis=-1) > 0.02)
    place = np.stack([column, row], axis=-1)
    error = moving_from_fixed(found, place) - moving_from_fixed(truth, place)
    return math.sqrt((error**2).sum(axis=-1).mean())


FROM_ABOVE = Pose(45.0, 0.0, 0.0)


@pytest.mark.default_cases(2)
@pytest.mark.parametrize(
    ("pose", "plate"),
    [
        (FROM_ABOVE, (6.3, -4.7, 0.4, 1.008)),
        (FROM_ABOVE, (8.0, -8.0, -0.5, 0.99)),
        (FROM_ABOVE, (-5.84, 3.54, 0.025, 0.996)),
        (FROM_ABOVE, (1.6, -0.9, 0.03, 1.0015)),
        (Pose(45.0, 35.0, 0.0), (-7.6, 2.2, -0.3, 0.992)),
        (Pose(65.0, 62.0, 0.0), (-2.6, -6.2, 0.2, 1.004)),
        (Pose(45.0, 12.0, 20.0), (3.9, 3.3, 0.1, 0.995)),
        # Edges along the rows and columns in both pictures, at all fractions of a superpixel.
        *((FROM_ABOVE, (1.0 + k / 8, -2.0 + 3 * k / 8, 0.0, 1.0)) for k in range(8)),
        *((FROM_ABOVE, (-7.0 + k / 4, 5.0 - k / 4, 0.0, scale)) for k, scale in enumerate((0.99, 0.995, 1.005, 1.01))),
    ],
)
def test_a_plate_of_upright_squares_is_registered_to_a_twentieth_of_a_superpixel(definitions, unfiltered, pose, plate):
    # Its only content is edges along rows and columns, which alias.
    assert found_error_px(definitions, unfiltered, pose, plate) <= 0.05


def test_a_plate_that_moves_by_a_tenth_of_a_superpixel_shows_so(definitions):
    plates = [Registration(0.1 * k, 0.0, 0.0, 1.0, 0.0, 0.0, (199.5, 149.5)) for k in range(6)]
    pictures = [see(definitions, FROM_ABOVE, plate, 1) for plate in plates]
    lit = np.flatnonzero(pictures[0].sum(axis=0) > 0.0)
    # The plate's left edge and half of the first of four squares.
    window = slice(0, lit[0] + (lit[-1] - lit[0]) // 8)
    light = np.array([picture[:, window].sum() for picture in pictures])
    # Edges seen at multiples of half a mosaic pixel only would move in steps of a quarter of a superpixel.
    assert np.diff(light) / (light[-1] - light[0]) == pytest.approx(0.2, abs=0.01)
