"""Pages beside the product's renderer: what a browser draws, and what `render_frame` renders."""

import numpy as np
from scipy import ndimage

from irodori.colour.colorimetry import delta_e_xyz
from irodori.config.models import Size
from irodori.rendering.scene_arrays import make_view
from irodori.viewer.browser import OpenPage
from irodori.viewer.measured import frame_bands, prepared
from irodori.viewer.page_data import page_data
from irodori.viewer.page_file import page_html
from irodori.viewer.stage import swapped, white_of

MEAN, P99 = 0.05, 0.3
SIZE = Size(width=64, height=48)


class Written:
    """A page, and the same scene for the product's renderer."""

    def __init__(self, folder, given) -> None:
        self.sources = given
        self.data = page_data(given)
        self.payload = self.data.payload({})
        self.view = make_view(given.scene.views["front"], SIZE)
        self.scenes = [prepared(parts) for parts in self.data.rooms]
        self.scene = self.scenes[0]
        self.path = folder / "page.html"
        self.text = page_html("A page", self.payload)
        self.path.write_text(self.text, encoding="utf-8")

    def wanted(self, bands, observer=0, illuminant=None, room=0):
        """XYZ of radiance under another light and for another observer, and the white's."""
        parts = self.data.rooms[room]
        weights = np.array(self.data.header["observers"][observer]["xyz"]).T
        ratio = swapped(self.data, illuminant, parts) if illuminant else np.ones(61)
        white = white_of(parts) * ratio
        matrix = weights * (100.0 / (weights[1] @ white))
        return (bands * ratio) @ matrix.T, matrix @ white


def inside(objects) -> np.ndarray:
    """Pixels that are not beside another object's: outlines are apart."""
    return ndimage.maximum_filter(objects, 3) == ndimage.minimum_filter(objects, 3)


def differences(wanted, white, xyz, objects) -> np.ndarray:
    return delta_e_xyz(wanted, xyz, white)[inside(objects)]


def agree(found) -> bool:
    return bool(found.mean() <= MEAN and np.percentile(found, 99) <= P99)


def compared(written: Written, page: OpenPage, state: dict, view, observer=0, illuminant=None) -> np.ndarray:
    """Return CIEDE2000 between what a page draws of a state and what the scene renders of the same view and room."""
    header = written.data.header
    room = header["environments"].index(state["light"]["environment"])
    state = {**state, "observer": header["observers"][observer]["name"]}
    state["light"] = {**state["light"], "illuminant": illuminant and {"name": illuminant}}
    bands = frame_bands(written.scenes[room], view, written.data.rooms[room])
    wanted = written.wanted(bands, observer, illuminant, room)
    return differences(*wanted, *page.read_xyz(state, view.width, view.height))
