"""More paths at outlines, and noise that cancels between neighbours: neither changes a mean."""

import numpy as np
import pytest
from path_scenes import DARK, ball, traced
from scenes import constant_light, material, plate

from irodori.rendering.reference import converging_picture
from irodori.rendering.reference.outline_paths import MORE

SIDE, SAMPLES = 32, 8


def test_the_outline_of_a_ball_is_as_even_as_its_area_in_each_pixel(monkeypatch):
    """A ball of reflectance 1/2 in even light darkens each pixel by half of the part that it covers."""

    def picture():
        return traced([ball(20.0)], [material(0.5)], constant_light(), SAMPLES, size=(SIDE, SIDE), replicates=2)

    radius = 0.5 * SIDE / np.tan(np.radians(6.5)) * 20.0 / np.sqrt(200.0**2 - 20.0**2)
    fine = (np.arange(SIDE * 32) + 0.5) / 32 - 0.5 * SIDE
    inside = (fine[:, None] ** 2 + fine**2 < radius**2).reshape(SIDE, 32, SIDE, 32).mean(axis=(1, 3))
    edge = (inside > 0.0) & (inside < 1.0)
    found, errors = picture(), []
    more = found.paths - SIDE * SIDE * SAMPLES
    assert more % ((MORE - 1) * SAMPLES) == 0 and edge.sum() <= more / ((MORE - 1) * SAMPLES) + 8
    assert more < 2 * edge.sum() * (MORE - 1) * SAMPLES
    for one in (found, picture_without_more(monkeypatch, picture)):
        covered = 2.0 - 2.0 * one.radiance[..., 30]
        assert covered.sum() == pytest.approx(np.pi * radius**2, rel=5e-3)
        errors.append(np.sqrt(np.mean(np.square(covered - inside)[edge])))
    # Points that cover a pixel evenly: the error falls with the power 3/4 of their number.
    assert errors[0] < 1.3 * MORE**-0.75 * errors[1]


def picture_without_more(monkeypatch, picture):
    with monkeypatch.context() as patch:
        patch.setattr(converging_picture, "MORE", 1)
        return picture()


def paths_of(*materials, position) -> int:
    """Paths of a ball that stands beside the view of a plate."""
    shapes, places = [plate(4000.0), ball(20.0)], [(0, 0, 0), (0, 30, 25)]
    shown = shapes[: len(materials)], list(materials), constant_light(), 2
    return traced(*shown, size=(24, 24), places=places[: len(materials)], position=position, target=(0, 0, 0), fov=6.0,
                  replicates=2).paths  # fmt: skip


def test_outlines_are_looked_for_in_mirrors_and_a_plane_has_none():
    least = 24 * 24 * 2
    steep, grazing = (0, -200.0, 200.0), (0, -200.0, 40.0)
    assert paths_of(material(0.5), position=steep) == paths_of(material(0.5), position=grazing) == least
    assert paths_of(material(0.5), material(0.5), position=steep) == least
    shown = paths_of(material(mirror=1.0, n=0.2, k=3.4), material(0.5), position=steep)
    assert least < shown < 1.5 * MORE * least


def test_noise_of_neighbours_cancels(monkeypatch):
    """Under a panel, means of 8 x 8 pixels come nearer to the truth than pixels of their own numbers would."""
    panel = {"kind": "rectangle", "spectrum": "A", "radiance": 9.0, "position_mm": [0, 0, 60],
             "rotation_deg": [180, 0, 0], "width_mm": 90.0, "height_mm": 60.0}  # fmt: skip

    def blocks(samples: int, seed: int) -> np.ndarray:
        made = traced([plate(400.0)], [material(0.5)], DARK, samples, size=(32, 32), position=(0, -150, 100), fov=15,
                      lights=[panel], replicates=2, seed=seed)  # fmt: skip
        return made.radiance[..., 30].reshape(4, 8, 4, 8).mean(axis=(1, 3))

    truth = blocks(512, 5)
    ordered = [blocks(2, seed) / truth - 1.0 for seed in range(4)]
    monkeypatch.setattr(converging_picture, "in_order", lambda numbers, width, height: numbers)
    apart = [blocks(2, seed) / truth - 1.0 for seed in range(4)]
    assert np.sqrt(np.mean(np.square(ordered))) < 0.5 * np.sqrt(np.mean(np.square(apart)))
    assert abs(np.mean(ordered)) < 0.01
