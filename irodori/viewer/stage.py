"""Viewer stage: reads materials, light and a scene; writes one page, which states its own measured errors."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from irodori.colour.colorimetry import colour_matching_weights, delta_e_xyz, xyz_from_radiance
from irodori.config.models import Scene, Size
from irodori.core.atomic_files import written_whole
from irodori.core.progress import LOGGER
from irodori.export.pictures import read_xyz
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
)
from irodori.viewer.page_data import PageData, SceneSources, page_data
from irodori.viewer.page_file import write_page
from irodori.viewer.payload import payload_header, read_payload, with_stated_errors
from irodori.viewer.scene_data import decoded_light, decoded_objects

#: Conditions of a page's checks: rotations of the light, illuminants (None is the recovered light), and observers.
TURNS_DEG, ILLUMINANTS, OBSERVERS = (0.0, 110.0), (None, "A", "FL11"), (0, 1)
#: Loss of the format, CIEDE2000, above which a warning is logged; the page states its loss in any case.
LOSS_MEAN, LOSS_P99 = 0.1, 0.3
#: Share of the peak of a room's light at which a wavelength has no power, as in the page's `Spectra.lit`.
_NO_POWER = 1e-4
_SIZE = Size(width=160, height=120)
_SELFTEST_SIZE = Size(width=40, height=30)


def export_viewer(sources: SceneSources, *, output, poster=None, picture=None) -> dict:
    """Write the page of a scene and return the errors that it states.

    Parameters
    ----------
    sources : SceneSources
    output : path
    poster : path, optional
        PNG that is shown if the page cannot draw.
    picture : path, optional
        EXR of the page's first view, rendered by the scene's integrator, with which the page is also compared.
    """
    with TemporaryDirectory(dir=Path(output).parent) as folder:
        payload = Path(folder) / "viewer.payload"
        encode_viewer(sources, output=payload)
        return finish_viewer(
            payload, sources.scene, sources.environments[0], output=output, poster=poster, picture=picture
        )


def encode_viewer(sources: SceneSources, *, output) -> dict:
    """Write the payload of a scene's page; measure, store and return the errors that need no rendered picture.

    Parameters
    ----------
    sources : SceneSources
    output : path
        Text file, base64.
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
    """Write a page from its payload and return the errors that it states.

    Parameters
    ----------
    payload : path
        File that `encode_viewer` wrote.
    scene : Scene
    environment : path
    output : path
    poster, picture : path, optional
        As in `export_viewer`.
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
    """Write a payload's page to a temporary folder next to the output and open it in the browser."""
    with TemporaryDirectory(dir=Path(output).parent) as folder:
        draft = Path(folder) / "draft.html"
        _write(payload, draft)
        with opened(draft) as page:
            yield page


def measured_loss(data: PageData, payload: str, originals: Sequence[Prepared], view: View) -> dict:
    """Return mean and 99th percentile of CIEDE2000 between frames from decoded planes and from the original data."""
    header, planes = read_payload(payload)
    objects = decoded_objects(data.parts.objects, planes, header["objects"] + header["sides"])
    found = []
    for number, (parts, original) in enumerate(zip(data.rooms, originals, strict=True)):
        maps = decoded_light(planes, number, header["light"][number])
        decoded = prepared(parts, Decoded(objects, maps))
        for turn in TURNS_DEG:
            before, after = (frame_bands(scene, view, parts, turn) for scene in (original, decoded))
            found.append(differences(before, after, white_of(parts)))
    return mean_and_p99(found)


def white_of(parts: FrameParts) -> np.ndarray:
    """Return the radiance of a perfect diffuser that faces up, (61,), under the environment and the scene's lamps."""
    lamps = np.maximum(parts.directions[:, 2], 0.0) @ parts.lamps / np.pi
    return parts.environment.upward_white() + lamps


def swapped(data: PageData, name: str, parts: FrameParts) -> np.ndarray:
    """Return the factor (61,) on a room's light that gives its white an illuminant's spectrum at equal luminance."""
    power = np.array(next(entry["power"] for entry in data.header["illuminants"] if entry["name"] == name))
    white, luminance = parts.environment.upward_white(), colour_matching_weights()[1]
    return power / white * (luminance @ white) / (luminance @ power)


def add_selftest(data: PageData, originals: Sequence[Prepared], view: View) -> None:
    """Add small reference frames of `checks` to a page's planes, with which the page tests itself."""
    entries: list[dict] = []
    for check in checks(data, originals, view):
        data.planes.add_floats(f"selftest/{len(entries)}", check.wanted)
        entries.append({"light": check.light, "observer": check.observer, "size": [view.height, view.width]})
    data.header["selftest"] = entries


@dataclass(frozen=True)
class Check:
    """Reference frame for the check of a page.

    Parameters
    ----------
    light : dict
        Changes to the light in the page's state.
    observer : str
        Name of the observer.
    wanted : (height, width, 3) float
        XYZ from the interactive renderer.
    white_xyz : (3,) float
        XYZ of the white.
    """

    light: dict
    observer: str
    wanted: np.ndarray
    white_xyz: np.ndarray


def checks(data: PageData, originals: Sequence[Prepared], view: View) -> Iterator[Check]:
    """Yield reference frames of every room, for several rotations of the light, illuminants and observers.

    Illuminants are exchanged only if the scene has no lamps and the room's light has power at all wavelengths.
    """
    for name, parts, original in zip(data.header["environments"], data.rooms, originals, strict=True):
        white = parts.environment.upward_white()
        has_all = (white > _NO_POWER * white.max()).all()
        for turn in TURNS_DEG:
            bands = frame_bands(original, view, parts, turn)
            for illuminant in ILLUMINANTS if has_all and not len(parts.lamps) else (None,):
                ratio = swapped(data, illuminant, parts) if illuminant else np.ones_like(white)
                seen_white = white_of(parts) * ratio
                light = {"environment": name, "turn_deg": turn, "illuminant": illuminant and {"name": illuminant}}
                for number in OBSERVERS:
                    observer = data.header["observers"][number]
                    weights = np.array(observer["xyz"]).T
                    matrix = weights * (100.0 / (weights[1] @ seen_white))
                    yield Check(light, observer["name"], (bands * ratio) @ matrix.T, matrix @ seen_white)


def measured_page(page: OpenPage, data: PageData, originals: Sequence[Prepared], view: View) -> dict:
    """Return mean and 99th percentile of CIEDE2000 between a page and the interactive renderer, over `checks`.

    ``view`` must be the initial view of the page. Pixels at outlines, where both may show different objects, count too.
    """
    found = []
    state = page.default_state()
    for check in checks(data, originals, view):
        now = {**state, "light": state["light"] | check.light, "observer": check.observer}
        xyz, _ = page.read_xyz(now, view.width, view.height)
        found.append(delta_e_xyz(check.wanted, xyz, check.white_xyz))
    return mean_and_p99(found)


def measured_reference(page: OpenPage, scene: Scene, environment, picture) -> dict:
    """Return mean and 99th percentile of CIEDE2000 between a page and a picture by the scene's integrator."""
    from irodori.light.environment_file import Environment

    white, _ = shown_white(scene, Environment.load(environment), environment)
    matrix = xyz_from_radiance(white)
    wanted = read_xyz(picture, matrix.astype(np.float32))
    xyz, _ = page.read_xyz(page.default_state(), wanted.shape[1], wanted.shape[0])
    found = mean_and_p99([delta_e_xyz(wanted, xyz, matrix @ white)])
    return found | {"integrator": scene.integrator.kind}
