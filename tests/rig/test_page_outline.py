"""The outline of an object on the page at the rig, held against the edge of the photograph that it is drawn over."""

import io
import threading

import numpy as np
import patience
import pytest
from made import made
from PIL import Image
from scipy.ndimage import binary_erosion, distance_transform_edt
from sessions import MADE, QuickCamera, assert_whole, definitions, shots
from test_check import SIZE
from test_rig_page import pictured, press, says, visit  # noqa: F401 - the fixture of a browser

from irodori.capture.dialogue import Dialogue, State
from irodori.capture.journal import Journal
from irodori.capture.operator import AutoOperator
from irodori.capture.page_server import Address, served
from irodori.capture.session import Session, take_stock
from irodori.capture.stage import Target, capture_camera, capture_object
from irodori.config.capture_table import Pose
from irodori.config.models import Camera, Object, Optics, Rig
from irodori.core.errors import InputError
from irodori.geometry.projected_outline import Outline, ProjectedOutlines

POSE = {"light_deg": [45.0], "camera_deg": [20.0], "tilt_deg": [10.0], "turn_deg": [20.0]}


class Sitting:
    """A session of the virtual rig whose hands are the page's, in a thread."""

    def __init__(self, folder, kind: str = "object", **optics) -> None:
        plate, camera, rig = definitions(poses=[POSE])
        # The line shows where the object is stated to lie: what lies off is not what these tests are about.
        for name in ("laid_off", "focal_length"):
            rig["virtual"]["imperfections"][name]["enabled"] = False
        camera["optics"] |= SIZE | optics
        camera |= {"dark_frames": 0, "white_frames": 1, "linearity_exposure_s": []}
        self.target = Target(
            "plate", made(Camera, camera), made(Rig, rig | {"operator": "prompt"}), "virtual", folder / "captures.csv"
        )
        self.plate, self.kind, self.record, self.dialogue = made(Object, plate), kind, folder / "s.json", Dialogue()
        self.server, self._up, self.ended = None, threading.Event(), None
        self._thread = threading.Thread(target=self._hold, daemon=True)

    def _hold(self) -> None:
        try:
            with served(self.dialogue, Address(port=0), "plate") as self.server:
                self._up.set()
                if self.kind == "object":
                    capture_object(self.plate, self.target, self.record, MADE, self.dialogue)
                else:
                    capture_camera(self.target, self.record, MADE, self.dialogue)
                self.ended = "complete"
        except Exception as error:
            self.ended = error

    def __enter__(self):
        self._thread.start()
        assert self._up.wait(patience.LONG_S)
        return self

    def __exit__(self, *_) -> None:
        while self.ended is None:
            if (view := self.dialogue.view).offers and view.state is not State.WORKING:
                self.dialogue.act(view.offers[0].action, view.turn)
            patience.until(lambda seen=view: self.ended or self.dialogue.view.version != seen.version)
        self._thread.join(patience.LONG_S)


@pytest.fixture(autouse=True)
def without_terminal(monkeypatch):
    monkeypatch.setattr("sys.stdin", None)


def seen(page) -> np.ndarray:
    """Return what the page shows of its picture, (height, width, 3) in 0 to 1."""
    return np.asarray(Image.open(io.BytesIO(page.locator("#frame").screenshot())).convert("RGB")) / 255.0


def test_the_outline_lies_on_the_edge_of_the_photographed_plate(tmp_path, visit):  # noqa: F811
    with Sitting(tmp_path, focal_length_mm=40.0) as sitting:
        page = visit(sitting.server.url)
        says(page, "set the light to")
        press(page, "Done")
        says(page, "Take the comb filter out")
        # A test exposure says where the object is to be sought.
        press(page, "Test exposure")
        page.get_by_text("Test exposure, not kept").wait_for()
        assert "by its pose the object lies from" in page.locator("#finding").inner_text()
        # The filter shifts the picture: what is compared is the photograph without it.
        press(page, "Done")
        says(page, "All 2 photographs are there")
        pictured(page, 120)
        assert "by its pose the object lies from" in page.locator("#outline").get_attribute("aria-label")
        page.locator("#marks").uncheck()
        drawn = seen(page)
        page.locator("#lines").uncheck()
        plain = seen(page)
        page.locator("#lines").check()
        assert np.abs(seen(page) - drawn).max() < 0.02
        lit = np.where(plain[..., 1] > 0.04, plain[..., 1], 0.0) ** 2.2
        plate = lit > 0.08 * np.percentile(lit, 90.0)
        edge = plate & ~binary_erosion(plate)
        # The line in its colour, without the dark rim that sets it off.
        line = (np.abs(drawn - plain).max(axis=2) > 0.1) & (np.abs(drawn - [1.0, 0.83, 0.47]).max(axis=2) < 0.3)
        # Two pixels of the sensor are one of the 120 that the picture has across.
        within = plain.shape[1] / 120.0 + 1.0
        assert line.sum() > 200 and distance_transform_edt(~edge)[line].max() <= within
        for axis in (0, 1):
            ends = [np.flatnonzero(mask.any(axis=axis))[[0, -1]] for mask in (line, plate)]
            assert np.abs(ends[0] - ends[1]).max() <= within


@pytest.mark.heavy
def test_nothing_is_drawn_where_no_object_stands_or_the_lens_is_unknown(tmp_path, visit):  # noqa: F811
    with Sitting(tmp_path, kind="camera") as sitting:
        page = visit(sitting.server.url)
        says(page, "white")
        press(page, "Done")
        says(page, "Take the comb filter out")
        pictured(page, 120)
        assert not page.locator("#outline").is_visible() and not page.locator("#lines").is_visible()
        assert sitting.dialogue.view.shown.outline is None


def test_why_no_outline_is_drawn_is_said_and_the_session_goes_on(tmp_path, monkeypatch):
    def without_mesh(shot):
        raise InputError("config/objects/vase.yaml", "shape.file", "no such file", "a mesh")

    planned, seen = shots(3), []
    monkeypatch.setattr(Dialogue, "show", lambda self, *shown: seen.append(shown))
    other = Outline("M0 0h8", (0, 7, 0, 7), (400, 300))
    for name, outline_of in (("a", without_mesh), ("b", lambda shot: other), ("c", lambda shot: None)):
        (tmp_path / name).mkdir()
        journal = Journal(tmp_path / name / "captures.csv")
        dialogue = Dialogue(watched=True)
        dialogue.ask = lambda *_: ""
        how = {"dialogue": dialogue, "outline_of": outline_of}
        Session(QuickCamera(), AutoOperator(dict), journal, None, take_stock(journal, planned), **how).run(planned, "x")
        assert_whole(tmp_path / name, planned)
    assert [shown[3] for shown in seen] == [None] * 9
    said = [shown[1] for shown in seen]
    assert all("; no outline is drawn: config/objects/vase.yaml: shape.file" in text for text in said[:3])
    assert all("has 16 x 12 superpixels, and by the camera's optics 400 x 300" in text for text in said[3:6])
    assert not any("outline" in text for text in said[6:])


def test_the_outline_of_a_small_picture_is_that_of_the_large_one():
    plate, camera, _ = definitions()
    large = camera["optics"] | {"width_px": 4928, "height_px": 3264, "pixel_pitch_um": 4.8,
                                "principal_point_px": [2464.0, 1632.0]}  # fmt: skip
    found = [ProjectedOutlines(made(Object, plate).shape, made(Optics, optics), 900.0).of(Pose(45.0, 20.0))
             for optics in (large, large | {"width_px": 1232, "height_px": 816, "pixel_pitch_um": 19.2,
                                            "principal_point_px": [616.0, 408.0]})]  # fmt: skip
    assert found[0].size == (2464, 1632) and found[1].size == (616, 408)
    assert np.allclose(np.array(found[0].box) / 4.0, found[1].box, atol=1.5)


@pytest.mark.parametrize(
    ("box", "words"),
    [
        (None, "outside the picture"),
        ((10, 59, 0, 39), "from 10% to 60% of the picture's width and 0% to 80% of its height, and beyond its upper"),
        ((0, 99, 5, 49), "beyond its left and right and lower edge"),
    ],
)
def test_what_is_said_of_an_outline(box, words):
    assert words in str(Outline("", box, (100, 50)))
