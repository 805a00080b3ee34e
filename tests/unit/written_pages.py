"""Pages beside the product's renderer: what a browser draws, and what `render_frame` renders."""

from dataclasses import replace

import numpy as np
from scipy import ndimage

from irodori.colour.colorimetry import delta_e_xyz
from irodori.config.models import Size
from irodori.reflection.lobes import Lobes
from irodori.rendering.interactive.frame_renderer import Prepared
from irodori.rendering.scene_arrays import make_view
from irodori.viewer import measured
from irodori.viewer.browser import OpenPage
from irodori.viewer.measured import FrameParts, frame_bands
from irodori.viewer.page_data import page_data
from irodori.viewer.page_file import page_html
from irodori.viewer.stage import swapped, white_of

MEAN, P99 = 0.05, 0.3
SIZE = Size(width=64, height=48)


def of_two_lobes(parts: FrameParts) -> FrameParts:
    """Return a scene of sheets, of coats or of GGX with two gloss components, of which one may be without weight.

    The renderer's loop is compiled for what a scene has: with `prepared`, all scenes that are not plain share one loop.
    """
    objects = parts.objects
    if objects.lobes.names == ("gaussian",) and not objects.coupled.any() and (objects.behind < 0).all():
        return parts
    lacking = 2 - objects.lobe.shape[1]
    texels, lobe = np.pad(objects.texels, ((0, 0), (0, 2 * lacking))), np.pad(objects.lobe, ((0, 0), (0, lacking)))
    lobes = Lobes.of((*objects.lobes.names, "ggx"))
    return replace(parts, objects=objects._replace(texels=texels, lobe=lobe, lobes=lobes))


def prepared(parts: FrameParts) -> Prepared:
    """Prepare a scene as the product does; one of two components has the code for sheets and for coats, too."""
    found = measured.prepared(parts)
    if found.layout.components > 1:
        found.layout = replace(found.layout, sheets=True, coats=True)
    return found


class Written:
    """A page, and the same scene for the product's renderer."""

    def __init__(self, folder, given) -> None:
        self.sources, data = given, page_data(given)
        self.data = replace(data, rooms=tuple(of_two_lobes(room) for room in data.rooms))
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
