"""Checks that the photograph of a chart agrees with its spectra and with the white reference."""

import numpy as np

from irodori.calibration.charts import Charts
from irodori.calibration.conditioning import band_name
from irodori.calibration.patch_order import is_telling, predicted_by_others
from irodori.colour.colorimetry import delta_e_reflectance
from irodori.core.errors import InputError
from irodori.core.progress import LOGGER
from irodori.spectra.published import chart_spectra
from irodori.spectra.published_names import CHART_PATCHES

_PATCH_LIMIT = 1.5  # of the limit of the mean: a patch with a larger error is at fault itself
_PATCH_RATIO = 4.0  # of the median error of the other patches, which a faulty patch must exceed too
_MOST_AT_FAULT = 0.25  # of the patches: if more are at fault, the cause is not in the patches
_CURED = 0.5  # of the error of two patches: below that their exchange explains it
_WARNED = 1.0 / 3.0  # of the limit of the level: from here on the difference is said
_LIKELIER = 0.7  # of the error with the spectra given: a published chart below that is likelier


def check_patches(charts: Charts, responses: np.ndarray, limit: float, light: str) -> None:
    """Refuse patches that contradict all others: covered, dirty, or exchanged with each other.

    While any error is too large, the patch without which the others agree best is removed. This need not be the patch
    with the largest error, because a faulty patch also spoils the prediction of similar ones.

    Parameters
    ----------
    charts : Charts
    responses : (m, bands) float
    limit : float
        Largest mean CIEDE2000 of patches predicted by the others; a single patch may have 1.5 times that.
    light : str
        Light for CIEDE2000.

    Raises
    ------
    InputError
        The message names the patches with their errors, and states whether they look exchanged.
    """
    spectra, kept = charts.spectra, np.ones(len(responses), dtype=bool)
    while True:
        error = _delta_e(responses[kept], spectra[kept], light)
        if not is_telling(responses[kept]) or (~kept).sum() > _MOST_AT_FAULT * len(kept):
            return
        if error.max() <= _PATCH_LIMIT * limit:
            break
        kept[_without_which_the_others_agree(responses, spectra, kept, light)] = False
    at_fault = np.flatnonzero(~kept)
    if not at_fault.size:
        return
    from_response = np.linalg.lstsq(responses[kept], spectra[kept], rcond=None)[0]
    own = delta_e_reflectance(spectra[at_fault], responses[at_fault] @ from_response, light)
    if own.max() < _PATCH_RATIO * np.median(error):
        return  # hardly worse than its neighbours: the camera, not the patch
    named = " and ".join(f"{charts.patches[p]} ({e:.0f})" for p, e in zip(at_fault, own, strict=True))
    cause = "exchanged" if _are_exchanged(charts, responses, at_fault, light) else "covered or of other colours"
    found = f"CIEDE2000 of {named} from what the other patches predict, as if {cause}"
    which = int(charts.number[at_fault[0]])
    accepted = f"up to {_PATCH_LIMIT * limit:g}: a chart with every patch bare and in its place"
    raise InputError(charts.photographs[which].path, charts.fields[which], found, accepted)


def check_mean(charts: Charts, error: np.ndarray, limit: float, light: str, likelier: dict[str, str]) -> None:
    """Refuse a chart with a mean CIEDE2000 of patches left out of the calibration above a limit.

    Parameters
    ----------
    charts : Charts
    error : (m,) float
        CIEDE2000 of every patch when it is left out; NaN where not computed.
    limit : float
    light : str
        Light of the error.
    likelier : dict of str to str
        Result of `likelier_charts`.

    Raises
    ------
    InputError
        The message has the mean, the worst patch and, if there is one, the published chart that fits better.
    """
    mean = float(np.nanmean(error))
    if mean <= limit:
        return
    worst = int(np.nanargmax(error))
    found = f"CIEDE2000 of {mean:.1f} in the mean over patches left out ({light}), {error[worst]:.0f} at "
    found += f"{charts.patches[worst]}"
    found += "".join(f"; {field} agrees better with {name}" for field, name in likelier.items())
    accepted = f"up to calibration.max_leave_one_out_error, {limit:g}: the spectra of this very chart, under the light "
    accepted += "that is named, and its corners"
    raise InputError(charts.photographs[0].path, ", ".join(charts.fields), found, accepted)


def check_level(charts: Charts, level: np.ndarray, limit: float) -> None:
    """Refuse a chart whose spectra contradict the level of the white reference, and warn of a smaller difference.

    Responses are relative to a perfect diffuser in the light of the white reference, so that a response model from the
    chart's spectra gives such a diffuser 1 in every band. Another value means that the light, the aperture, the place
    or a reflectance differs between the two photographs; which of them is wrong is not told.

    Parameters
    ----------
    charts : Charts
    level : (bands,) float
        Response of a perfect diffuser according to the chart.
    limit : float
        Largest accepted difference from 1.

    Raises
    ------
    InputError
        The message has the band that differs most, and the smallest and the largest level.
    """
    worst = int(np.argmax(np.abs(level - 1.0)))
    if abs(level[worst] - 1.0) <= _WARNED * limit:
        return
    found = f"a chart {level[worst]:.3f} times as bright in {band_name(worst, charts.filters)} as its spectra and the "
    found += f"white reference say (all bands: {level.min():.3f} to {level.max():.3f})"
    if abs(level[worst] - 1.0) <= limit:
        LOGGER.warning(
            "%s: %s; gloss or colours may be wrong by as much, which the errors of α and β contain",
            charts.photographs[0].path,
            found,
        )
        return
    accepted = f"{1 - limit:g} to {1 + limit:g} (calibration.max_level_difference): chart and white reference in one "
    accepted += "place, light and aperture, and white.reflectance_factor of that white"
    raise InputError(charts.photographs[0].path, ", ".join(charts.fields), found, accepted)


def likelier_charts(charts: Charts, responses: np.ndarray, light: str) -> dict[str, str]:
    """Return the published charts that agree clearly better with the responses of charts than the spectra given.

    Parameters
    ----------
    charts : Charts
    responses : (m, bands) float
    light : str
        Light for CIEDE2000.

    Returns
    -------
    dict of str to str
        {key of a chart in the camera's definition: name of the published chart}
    """
    found = {}
    for which, field in enumerate(charts.fields):
        own = charts.number == which
        if not is_telling(responses[own]):
            continue
        errors = {
            name: float(_delta_e(responses[own], chart_spectra(name)[1], light).mean())
            for name, count in CHART_PATCHES.items()
            if count == own.sum()
        }
        best = min(errors, key=errors.__getitem__, default="")
        if best and errors[best] < _LIKELIER * _delta_e(responses[own], charts.spectra[own], light).mean():
            found[field] = best
    return found


def _without_which_the_others_agree(responses, spectra, kept: np.ndarray, light: str) -> int:
    """Return the index of the kept patch without which the mean error of the other ones is smallest."""
    means = {}
    for patch in np.flatnonzero(kept):
        others = kept & (np.arange(len(kept)) != patch)
        means[int(patch)] = float(_delta_e(responses[others], spectra[others], light).mean())
    return min(means, key=means.__getitem__)


def _are_exchanged(charts: Charts, responses: np.ndarray, patches: np.ndarray, light: str) -> bool:
    """Return whether two patches agree with the others once their responses are exchanged."""
    if len(patches) != 2:
        return False
    exchanged = responses.copy()
    exchanged[patches] = responses[patches[::-1]]
    before, after = (_delta_e(r, charts.spectra, light)[patches].max() for r in (responses, exchanged))
    return after < _CURED * before


def _delta_e(responses: np.ndarray, spectra: np.ndarray, light: str) -> np.ndarray:
    return delta_e_reflectance(spectra, predicted_by_others(responses, spectra), light)
