"""Recognition of photographs from their content: charts, white references, dark frames, filter states and poses.

Whatever cannot be recognised with confidence is left open for the user to fill in.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from irodori.calibration.detection import find_chart
from irodori.core.errors import InputError
from irodori.first_project.raw_folder import Photograph
from irodori.ingest.mosaic import decode
from irodori.ingest.plausibility import CLIPPED, LIT
from irodori.spectra.published import chart_spectra

CHART = "BabelColor Average"
#: A dark frame has a level (of its brightest hundredth) below the first number, and a larger share of unlit pixels than
#: the second; the others are hot pixels.
_DARK_LEVEL, _UNLIT = 0.005, 0.99
#: Largest scatter of the brightness of a white reference about a smooth fall-off, and of its colour, both relative.
_EVEN, _GREY = 0.02, 0.02
#: Two photographs show the same view if 1 minus the correlation of their green pictures is below this.
_ALIKE = 0.1
#: Two photographs in the same filter state have the same light if they agree within this, relative, in each band.
_SAME_LIGHT = 0.08
#: Largest transmittance of a filter in any band.
_FILTERED = 0.8
#: Largest factor between the filter's transmittance on an object and on the white reference or the chart.
_LIKE_WHITE = 2.5
_FEWEST_BLOCKS = 16


@dataclass(frozen=True)
class Recognised:
    """A photograph with its role, filter state and pose.

    Parameters
    ----------
    photograph : Photograph
    role : str
        ``chart``, ``white``, ``dark`` or ``object``.
    filter : str
        ``out`` or ``in``; empty if it is unknown.
    pose : int
        Number of the object's pose in the order of the photographs; -1 for other roles.
    """

    photograph: Photograph
    role: str
    filter: str = ""
    pose: int = -1


def recognise(photographs: list[Photograph]) -> list[Recognised]:
    """Recognise role, filter state and pose of each photograph, in the same order."""
    spectra = chart_spectra(CHART)[1]
    found: list[Recognised] = []
    for one in photographs:
        role = "dark" if _is_dark(one) else "white" if _is_white(one) else "object"
        if role == "object":
            role = _seen_before(one, found) or ("chart" if _has_chart(one, spectra) else "object")
        found.append(Recognised(one, role, "out" if role == "dark" else ""))
    passed = None
    for role in ("white", "chart"):
        found, seen = _with_filters_of_one_view(found, role)
        passed = seen if passed is None else passed
    return _with_poses(found, passed)


def _seen_before(one: Photograph, found: list[Recognised]) -> str:
    """Return the role of an earlier photograph of the same view, ``chart`` or ``object``; empty if there is none.

    This saves the slow search for a chart. The role ``object`` is only taken from a photograph that is at least as
    bright, because in a dimmer one a chart may have been missed.
    """
    for other in found:
        tells = other.role == "chart" or (other.role == "object" and other.photograph.look.level >= one.look.level)
        if tells and _alike(other.photograph, one):
            return other.role
    return ""


def _is_dark(one: Photograph) -> bool:
    return one.look.level < _DARK_LEVEL and one.look.dark > _UNLIT


def _is_white(one: Photograph) -> bool:
    """Return whether one grey surface fills the frame: smooth brightness, and the same colour everywhere."""
    picture = one.look.picture.astype(np.float64)
    if picture.min() < LIT / 2.0:
        return False
    rows, columns = picture.shape[:2]
    y, x = np.meshgrid(np.linspace(-1.0, 1.0, rows), np.linspace(-1.0, 1.0, columns), indexing="ij")
    terms = np.stack([x**a * y**b for a in range(5) for b in range(5 - a)], axis=-1).reshape(rows * columns, -1)
    level = picture[..., 1].ravel()
    smooth = terms @ np.linalg.lstsq(terms, level, rcond=None)[0]
    colour = np.log(picture[..., [0, 2]] / picture[..., 1:2])
    return bool((level / smooth - 1.0).std() < _EVEN and colour.std(axis=(0, 1)).max() < _GREY)


def _has_chart(one: Photograph, spectra: np.ndarray) -> bool:
    mosaic = decode(one.path, one.linear)
    try:
        find_chart(mosaic.superpixels / np.float32(mosaic.full_scale), mosaic.largest < CLIPPED, spectra, one.path)
    except InputError:
        return False
    return True


def _ratio(one: Photograph, other: Photograph) -> np.ndarray | None:
    """Return the ratio of the second photograph's light to the first's, by band, (3,).

    None if too few places are well exposed in both.
    """
    common = one.look.whole & other.look.whole & (one.look.picture[..., 1] > LIT / 2.0)
    if common.sum() < _FEWEST_BLOCKS:
        return None
    sums = [photograph.rate[common].sum(axis=0) for photograph in (one, other)]
    return sums[1] / sums[0] if (np.array(sums) > 0.0).all() else None


def _same_light(ratio: np.ndarray | None) -> bool:
    return ratio is not None and bool(np.abs(np.log(ratio)).max() < math.log(1.0 + _SAME_LIGHT))


def _dimmer(ratio: np.ndarray | None) -> bool:
    return ratio is not None and bool(ratio.max() < _FILTERED)


def _with_filters_of_one_view(found: list[Recognised], role: str) -> tuple[list[Recognised], np.ndarray | None]:
    """Set the filter state of all photographs with a role that shows a single view.

    Returns
    -------
    list of Recognised
        All photographs.
    (3,) float or None
        Transmittance of the filter by band; None if no photograph with the filter was found.
    """
    of_role = [one for one in found if one.role == role]
    if not of_role:
        return found, None
    brightest = max(of_role, key=lambda one: float(one.photograph.rate.mean()))
    states, passed = {}, None
    for one in of_role:
        ratio = _ratio(brightest.photograph, one.photograph)
        if one is brightest or _same_light(ratio):
            states[id(one)] = "out"
        elif _dimmer(ratio) and (passed is None or (ratio is not None and _agrees(ratio, passed, 1.0 + _SAME_LIGHT))):
            states[id(one)], passed = "in", ratio
    return [replace(one, filter=states.get(id(one), "")) if one.role == role else one for one in found], passed


def _agrees(ratio: np.ndarray, passed: np.ndarray, factor: float) -> bool:
    return bool(np.abs(np.log(ratio / passed)).max() < math.log(factor))


def _alike(one: Photograph, other: Photograph) -> bool:
    common = one.look.whole & other.look.whole
    if common.sum() < _FEWEST_BLOCKS:
        return False
    a, b = (each.look.picture[..., 1][common].astype(np.float64) for each in (one, other))
    a, b = a - a.mean(), b - b.mean()
    size = math.sqrt(float((a @ a) * (b @ b)))
    return size > 0.0 and 1.0 - float(a @ b) / size < _ALIKE


def _with_poses(found: list[Recognised], passed: np.ndarray | None) -> list[Recognised]:
    """Set pose and filter state of the photographs of the object; return all photographs.

    Successive photographs belong to one pose as long as they look alike, those in the same filter state have the same
    light, and no filter state occurs twice with the same exposure time. If some poses have both filter states, the
    filter of a pose with only one is left open.
    """
    groups: list[list[Recognised]] = []
    for one in (one for one in found if one.role == "object"):
        if groups and _belongs(groups[-1], one, passed):
            groups[-1].append(one)
        else:
            groups.append([one])
    filters: dict[int, str] = {}
    poses: dict[int, int] = {}
    states = [_states(group) for group in groups]
    both = any(len(set(state)) == 2 for state in states) or passed is not None
    for number, (group, state) in enumerate(zip(groups, states, strict=True)):
        for one, through in zip(group, state, strict=True):
            poses[id(one)] = number
            filters[id(one)] = through if len(set(state)) == 2 or not both else ""
    return [
        replace(one, filter=filters[id(one)], pose=poses[id(one)]) if one.role == "object" else one for one in found
    ]


def _belongs(group: list[Recognised], one: Recognised, passed: np.ndarray | None) -> bool:
    ratio = _ratio(group[0].photograph, one.photograph)
    if ratio is None or not _alike(group[0].photograph, one.photograph):
        return False
    if not _same_light(ratio):
        transmittance = ratio if _dimmer(ratio) else 1.0 / ratio
        if not _dimmer(transmittance) or (passed is not None and not _agrees(transmittance, passed, _LIKE_WHITE)):
            return False
    members = [*group, one]
    states = _states(members)
    first = dict(zip(reversed(states), reversed(members), strict=True))
    # If two photographs in the same filter state differ in brightness, the lamp was moved: they are not one pose.
    if not all(
        each is first[state] or _same_light(_ratio(first[state].photograph, each.photograph))
        for each, state in zip(members, states, strict=True)
    ):
        return False
    taken = zip(members, states, strict=True)
    settings = [(state, round(math.log(each.photograph.exposure_s), 2)) for each, state in taken]
    return len(set(settings)) == len(settings)


def _states(group: Iterable[Recognised]) -> list[str]:
    """Return the filter state of each photograph of a pose: ``in`` if dimmer than the brightest in every band."""
    group = list(group)
    brightest = max(group, key=lambda one: float(one.photograph.rate[one.photograph.look.whole].mean()))
    return ["in" if _dimmer(_ratio(brightest.photograph, one.photograph)) else "out" for one in group]
