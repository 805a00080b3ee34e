"""Viewer stage: materials, light and a scene in; one page out, with the errors that it states of itself."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from irodori.colour.colorimetry import colour_matching_weights, xyz_from_radiance
from irodori.config.models import Scene, Size
from irodori.core.atomic_files import written_whole
from irodori.core.progress import LOGGER
from irodori.export.pictures import read_xyz
from irodori.geometry.rig_frame import rotation_z
from irodori.rendering.interactive.frame_renderer import Prepared
from irodori.rendering.scene_arrays import View, make_view
from irodori.rendering.scene_white import shown_white
from irodori.viewer.browser import OpenPage, browser_command, opened
from irodori.viewer.measured import (
    Decoded,
    FrameParts,
    differences,
    frame_bands,
    mean_and_p99,
    prepared,
    xyz_differences,
)
from irodori.viewer.page_data import PageData, SceneSources, page_data
from irodori.viewer.page_file import write_page
from irodori.viewer.payload import payload_header, read_payload, with_stated_errors
from irodori.viewer.scene_data import decoded_light, decoded_objects

#: What a page is checked with: turns of the light, illuminants (none is the light as it was recovered), and observers.
TURNS_DEG, ILLUMINANTS, OBSERVERS = (0.0, 110.0), (None, "A", "FL11"), (0, 1)
#: Loss of the format, CIEDE2000, over which a page's maker is warned; the page states its own in any case.
LOSS_MEAN, LOSS_P99 = 0.1, 0.3
_SIZE = Size(width=160, height=120)
_SELFTEST_SIZE = Size(width=40, height=30)


def export_viewer(sources: SceneSources, *, output, poster=None, picture=None) -> dict:
    """Write the page of a scene; return the errors that it states.

    Parameters
    ----------
    sources : SceneSources
    output : path
    poster : path, optional
        PNG that is shown where the page cannot draw.
    picture : path, optional
        EXR of the page's first view by the scene's integrator, which the page is compared with too.
    """
    with TemporaryDirectory(dir=Path(output).parent) as folder:
        payload = Path(folder) / "viewer.payload"
        encode_viewer(sources, output=payload)
        return finish_viewer(
            payload, sources.scene, sources.environments[0], output=output, poster=poster, picture=picture
        )


def encode_viewer(sources: SceneSources, *, output) -> dict:
    """Write the payload of a scene's page, with the errors that need no picture of the scene; return these.

    Parameters
    ----------
    sources : SceneSources
    output : path
        Text, base64.
    """
    data = page_data(sources)
    first_view = sources.scene.views[data.header["views"][0]["name"]]
    view = make_view(first_view, _SIZE)
    originals = [prepared(parts) for parts in data.rooms]
    add_selftest(data, originals, make_view(first_view, _SELFTEST_SIZE))
    first = data.payload({})
    errors: dict = {"data_loss": measured_loss(data, first, originals, view), "cpu": None, "reference": None}
    LOGGER.info("loss of the format, CIEDE2000: %s; %.2f MB of base64", errors["data_loss"], len(first) / 1e6)
    if errors["data_loss"]["mean"] > LOSS_MEAN or errors["data_loss"]["p99"] > LOSS_P99:
        LOGGER.warning("the format loses more than mean %g, 99th percentile %g of this scene", LOSS_MEAN, LOSS_P99)
    if browser_command() is None:
        LOGGER.warning("no browser: what the page draws is not checked, and it says so")
    else:
        with _drawn(first, output) as page:
            errors["cpu"] = measured_page(page, data, originals, view)
        LOGGER.info("the page against the interactive renderer, CIEDE2000: %s", errors["cpu"])
    with written_whole(output) as temporary:
        temporary.write_text(with_stated_errors(first, errors), encoding="ascii")
    return errors


def finish_viewer(payload, scene: Scene, environment, *, output, poster=None, picture=None) -> dict:
    """Write a page from its payload; return the errors that it states.

    Parameters
    ----------
    payload : path
        Written by `encode_viewer`.
    scene : Scene
    environment : path
    output : path
    poster, picture : path, optional
        As of `export_viewer`.
    """
    text = Path(payload).read_text(encoding="ascii", errors="replace")
    errors = payload_header(text, payload)["stated_errors"]
    if picture is not None and browser_command() is not None:
        with _drawn(text, output) as page:
            errors["reference"] = measured_reference(page, scene, environment, picture)
        text = with_stated_errors(text, errors, payload)
    _write(text, output, poster)
    return errors


def _write(payload: str, output, poster=None) -> None:
    header = payload_header(payload)
    write_page(output, header["title"] or header["scene"], payload, poster)


@contextmanager
def _drawn(payload: str, output) -> Iterator[OpenPage]:
    """Open a payload's page in the browser; it stands beside an output meanwhile."""
    with TemporaryDirectory(dir=Path(output).parent) as folder:
        draft = Path(folder) / "draft.html"
        _write(payload, draft)
        with opened(draft) as page:
            yield page


def measured_loss(data: PageData, payload: str, originals: Sequence[Prepared], view: View) -> dict:
    """Return CIEDE2000 between frames from the decoded planes and from the originals, mean and 99th percentile."""
    header, planes = read_payload(payload)
    objects = decoded_objects(data.parts.objects, planes, header["objects"])
    found = []
    for number, (parts, original) in enumerate(zip(data.rooms, originals, strict=True)):
        maps = decoded_light(planes, number, header["light"][number])
        decoded = prepared(parts, Decoded(objects, maps, planes))
        for turn in TURNS_DEG:
            before, after = (frame_bands(scene, view, parts, _turned(turn)) for scene in (original, decoded))
            found.append(differences(before, after, white_of(parts)))
    return mean_and_p99(found)


def _turned(degrees: float) -> np.ndarray:
    return rotation_z(np.radians(degrees))


def white_of(parts: FrameParts) -> np.ndarray:
    """Return the radiance of a perfect diffuser that faces up, (61,), under the light and the scene's lamps."""
    lamps = np.maximum(parts.directions[:, 2], 0.0) @ parts.lamps / np.pi
    return parts.environment.upward_white() + lamps


def swapped(data: PageData, name: str, parts: FrameParts) -> np.ndarray:
    """Return the factor on a room's light, (61,), that gives its white an illuminant's spectrum, and its luminance."""
    power = np.array(next(entry["power"] for entry in data.header["illuminants"] if entry["name"] == name))
    white, luminance = parts.environment.upward_white(), colour_matching_weights()[1]
    return power / white * (luminance @ white) / (luminance @ power)


def add_selftest(data: PageData, originals: Sequence[Prepared], view: View) -> None:
    """Add small frames of `checks` to a page's planes, for the check that it makes of itself."""
    entries: list[dict] = []
    for check in checks(data, originals, view):
        data.planes.add_floats(f"selftest/{len(entries)}", check.wanted)
        entries.append({"light": check.light, "observer": check.observer, "size": [view.height, view.width]})
    data.header["selftest"] = entries


@dataclass(frozen=True)
class Check:
    """A frame that a page is checked with.

    Parameters
    ----------
    light : dict
        What it changes in the light of the page's state.
    observer : str
    wanted : (height, width, 3) float
        XYZ by the interactive renderer.
    white_xyz : (3,) float
    """

    light: dict
    observer: str
    wanted: np.ndarray
    white_xyz: np.ndarray


def checks(data: PageData, originals: Sequence[Prepared], view: View) -> Iterator[Check]:
    """Yield what a page is checked with: every room, turned, under some illuminants and for some observers.

    The light is exchanged where it is all that lights the scene.
    """
    for name, parts, original in zip(data.header["environments"], data.rooms, originals, strict=True):
        white = parts.environment.upward_white()
        for turn in TURNS_DEG:
            bands = frame_bands(original, view, parts, _turned(turn))
            for illuminant in ILLUMINANTS if white.all() and not len(parts.lamps) else (None,):
                ratio = swapped(data, illuminant, parts) if illuminant else np.ones_like(white)
                seen_white = white_of(parts) * ratio
                light = {"environment": name, "turn_deg": turn, "illuminant": illuminant and {"name": illuminant}}
                for number in OBSERVERS:
                    observer = data.header["observers"][number]
                    weights = np.array(observer["xyz"]).T
                    matrix = weights * (100.0 / (weights[1] @ seen_white))
                    yield Check(light, observer["name"], (bands * ratio) @ matrix.T, matrix @ seen_white)


def measured_page(page: OpenPage, data: PageData, originals: Sequence[Prepared], view: View) -> dict:
    """Return CIEDE2000 between what a page draws and the interactive renderer, over `checks`.

    The page begins with the same view; pixels at which both see different things, at outlines, are left in.
    """
    found = []
    state = page.default_state()
    for check in checks(data, originals, view):
        now = {**state, "light": state["light"] | check.light, "observer": check.observer}
        xyz, _ = page.read_xyz(now, view.width, view.height)
        found.append(xyz_differences(check.wanted, xyz, check.white_xyz))
    return mean_and_p99(found)


def measured_reference(page: OpenPage, scene: Scene, environment, picture) -> dict:
    """Return CIEDE2000 between what a page draws and a picture of the scene's own integrator, its noise included."""
    from irodori.light.environment_file import Environment

    white, _ = shown_white(scene, Environment.load(environment), environment)
    matrix = xyz_from_radiance(white)
    wanted = read_xyz(picture, matrix.astype(np.float32))
    xyz, _ = page.read_xyz(page.default_state(), wanted.shape[1], wanted.shape[0])
    found = mean_and_p99([xyz_differences(wanted, xyz, matrix @ white)])
    return found | {"integrator": scene.integrator.kind}
