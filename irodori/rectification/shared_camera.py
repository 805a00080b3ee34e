"""Registration of objects that were photographed together: all of them tell of the camera and the rig.

A plate tells where the camera stands and how long its lens is; a sphere tells nothing of either, but where the light
stands. The registration of each object is a Gaussian over its own numbers (its place, and the camera angle of each
photograph) and those that rig and camera have in common with other objects. The common ones are combined, each
counting as much as it tells beyond the definitions, and every object's own numbers follow from its covariance.

That nothing was moved between is tested. Objects that contradict each other about camera and lens are left apart, in
sets that agree, and so are those that contradict each other about the light.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from irodori.core import store
from irodori.core.progress import LOGGER
from irodori.rectification.placement_correction import CAMERA, COUNT, LIGHT, QUANTITIES
from irodori.rectification.registration_file import Estimate, Told, read_told, write_angle_errors, write_estimate
from irodori.rectification.told_values import CONTRADICTED, inverse, is_told, only_what_is_told, settle_light

_POSE = list(range(6))  # of each object alone
_COMMON = list(range(6, CAMERA + 1))  # distance, focal length, principal point and zero of the camera's angles
#: Standard deviation of the light's angles before highlights are seen, degrees, so wide that these decide.
_FREE_DEG = 3.0
#: Corrections up to these are none, in the order of `QUANTITIES`. Several objects together have no common bias that
#: would ask for more than significance: a principal point 0.5 px off, known to 0.03 px, puts a ball 0.2 mm off.
_EXACT = np.zeros(COUNT)
_LEAST_INFORMATION = 1.0  # of a combination of numbers, relative to the definitions; less does not count in the test


class Evidence(NamedTuple):
    """Evidence of an object on k common numbers beyond their definitions, in standard deviations of these.

    Parameters
    ----------
    information : (k, k) float64
        Inverse of the covariance; singular if something is not told.
    weighted : (k,) float64
        Information times most probable values.
    """

    information: np.ndarray
    weighted: np.ndarray


class Common(NamedTuple):
    """Common numbers by several objects and their definitions, in standard deviations of these: mean and covariance."""

    mean: np.ndarray
    covariance: np.ndarray


class Placed(NamedTuple):
    """Place of an object by the photographs of all objects.

    Parameters
    ----------
    estimate : Estimate
    remarks : list of str
        What is said beside the quantities.
    """

    estimate: Estimate
    remarks: list[str]


def combine_registrations(names: Sequence[str], registrations: Sequence, outputs: Sequence, provenance) -> None:
    """Combine the registrations of objects that were photographed together and write where each stood.

    Parameters
    ----------
    names : sequence of str
        Names of the objects.
    registrations, outputs : sequence of path
        Files of `irodori.rectification.object_registration.register_object`, and files to write, in the same order.
    provenance : Provenance

    Notes
    -----
    Datasets as in ``registration.h5``: ``/correction``, ``/sigma``, ``/covariance``, ``/prior_sigma``, ``/angle_error``
    and ``/angle_error_of_capture``, of which the last two are missing without observations. Attributes ``told``,
    ``captures`` and ``sentence``.
    """
    told = {name: read_told(path) for name, path in zip(names, registrations, strict=True)}
    for (name, placed), output in zip(combined(told).items(), outputs, strict=True):
        estimate, own = placed.estimate, told[name]
        sentence = "; ".join([*estimate.in_words(), *placed.remarks])
        LOGGER.info("%s: %s", name, sentence)
        by_photograph = own.angles.by_photograph(estimate.moment, float(estimate.prior[LIGHT]))
        with store.create(output, provenance) as out:
            write_estimate(out, estimate, own.captures)
            write_angle_errors(out, own.angles.rms(by_photograph), by_photograph)
            out.attribute("sentence", sentence)


def combined(told: dict[str, Told]) -> dict[str, Placed]:
    """Return where each object stood by what all of them tell; the keys are their names."""
    names, evidence = list(told), [_of_camera(one.estimate) for one in told.values()]
    sets = agreeing(evidence)
    found: dict[str, Placed] = {}
    for number, members in enumerate(sets):
        placed = {names[at]: Placed(told[names[at]].estimate, list(told[names[at]].remarks)) for at in members}
        if len(members) > 1:
            placed = _with_camera(placed, _posterior([evidence[at] for at in members]))
            placed = _with_light(placed, {name: told[name].light_deg for name in placed})
        others = [names[at] for n, other in enumerate(sets) if n != number for at in other]
        if others:
            rest = _posterior([evidence[names.index(name)] for name in others])
            for name, one in placed.items():
                found[name] = _apart(name, one, told[name].estimate, rest, others)
        else:
            found |= placed
    return {name: found[name] for name in names}


# ---- evidence


def _of_camera(estimate: Estimate) -> Evidence:
    """Return what an object tells of camera and lens."""
    scale, size = estimate.prior[_COMMON], len(_COMMON)
    free = np.flatnonzero(scale > 0.0)
    where = np.array(_COMMON)[free]
    both = np.outer(scale[free], scale[free])
    precision = np.linalg.inv(estimate.covariance[np.ix_(where, where)] / both)
    found = Evidence(np.zeros((size, size)), np.zeros(size))
    # The definitions, which all objects have in common, count once.
    told, axes = np.linalg.eigh(precision - np.eye(len(free)))
    found.information[np.ix_(free, free)] = (axes * np.maximum(told, 0.0)) @ axes.T
    found.weighted[free] = precision @ (estimate.probable[where] / scale[free])
    return found


def _of_light(shown_deg: tuple[float, float]) -> Evidence:
    """Return what highlights tell of the light's angles: their error and its standard error, degrees."""
    offset, error = shown_deg
    return Evidence(np.array([[(_FREE_DEG / error) ** 2]]), np.array([offset * _FREE_DEG / error**2]))


def _posterior(evidence: Sequence[Evidence]) -> Common:
    """Return the common numbers by definitions and evidence."""
    size = len(evidence[0].weighted)
    covariance = np.linalg.inv(np.eye(size) + np.sum([one.information for one in evidence], axis=0))
    return Common(covariance @ np.sum([one.weighted for one in evidence], axis=0), covariance)


def disagreement(one: Evidence, others: Sequence[Evidence]) -> tuple[float, int]:
    """Return χ² of what an object tells against what others tell, and its degrees of freedom.

    Combinations of numbers that the object determines less than their definitions do are not counted.
    """
    information, axes = np.linalg.eigh(one.information)
    counts = information > _LEAST_INFORMATION
    information, axes = information[counts], axes[:, counts]
    expected = _posterior(others)
    off = axes.T @ one.weighted / information - axes.T @ expected.mean
    spread = np.diag(1.0 / information) + axes.T @ expected.covariance @ axes
    return float(off @ np.linalg.solve(spread, off)), len(information)


def agreeing(evidence: Sequence[Evidence]) -> list[list[int]]:
    """Return sets of objects, as lists of their numbers, that do not contradict each other.

    Out of all objects, the one is taken that contradicts the others most, as long as one does by four standard errors;
    then the same is done with those that were taken out.
    """
    left, sets = list(range(len(evidence))), []
    while left:
        members = list(left)
        while len(members) > 1:
            against = [
                disagreement(evidence[at], [evidence[other] for other in members if other != at]) for at in members
            ]
            odds = [_chance(*one) for one in against]
            if min(odds) >= _chance(CONTRADICTED**2, 1):
                break
            # The smallest chances may all be zero.
            del members[int(np.argmax([chi2 / max(count, 1) for chi2, count in against]))]
        sets.append(members)
        left = [at for at in left if at not in members]
    return sets


def _chance(chi2: float, count: int) -> float:
    """Return the probability that χ² with so many degrees of freedom is larger."""
    from scipy.special import chdtrc  # slow to import

    return float(chdtrc(count, chi2)) if count else 1.0


# ---- what follows for each object


def _with_camera(placed: dict[str, Placed], common: Common) -> dict[str, Placed]:
    """Return objects with what all of them tell of camera and lens."""
    prior = next(iter(placed.values())).estimate.prior[_COMMON]
    mean, covariance = common.mean * prior, common.covariance * np.outer(prior, prior)
    values, _ = only_what_is_told(mean, inverse(covariance, prior), prior, _EXACT[_COMMON])
    known = is_told(np.sqrt(np.diag(covariance)), prior)
    tellers: dict[str, list[str]] = {}
    for at, quantity in enumerate(_COMMON):
        if known[at]:
            by = [name for name, one in placed.items() if one.estimate.told[quantity]]
            tellers.setdefault(_listed(by) or "all together", []).append(QUANTITIES[quantity].text)
    said = "; ".join(f"{', '.join(texts)} by {by}" for by, texts in tellers.items()) or "nothing"
    remark = f"of camera and lens, {_listed(list(placed))} tell together: {said}"
    return {
        name: Placed(_conditioned(one.estimate, mean, covariance, values), [remark, *one.remarks])
        for name, one in placed.items()
    }


def _listed(names: Sequence[str]) -> str:
    """Return names as in a sentence, of many only the first."""
    return ", ".join(names) if len(names) <= 6 else f"{', '.join(names[:4])} and {len(names) - 4} more"


def _conditioned(estimate: Estimate, mean: np.ndarray, covariance: np.ndarray, values: np.ndarray) -> Estimate:
    """Return an object's estimate with other common numbers.

    Parameters
    ----------
    estimate : Estimate
    mean, covariance : (5,), (5, 5) float
        Camera and lens by all objects.
    values : (5,) float
        Corrections of camera and lens in use.
    """
    whole, prior = estimate.covariance, estimate.prior
    # The change of every number with the common ones, as the object's own photographs relate them.
    gain = whole[:, _COMMON] @ inverse(whole[np.ix_(_COMMON, _COMMON)], prior[_COMMON])
    probable = estimate.probable + gain @ (mean - estimate.probable[_COMMON])
    apart = whole - gain @ whole[_COMMON]
    used = estimate.values.copy()
    used[_COMMON] = values
    place = (probable + gain @ (values - mean))[_POSE]
    information = inverse(apart[np.ix_(_POSE, _POSE)], prior[_POSE])
    used[_POSE], _ = only_what_is_told(place, information, prior[_POSE], _EXACT[_POSE])
    return estimate._replace(probable=probable, covariance=apart + gain @ covariance @ gain.T, values=used)


def _with_light(placed: dict[str, Placed], shown: dict[str, tuple[float, float] | None]) -> dict[str, Placed]:
    """Return objects before one camera with what highlights on all of them tell of the light.

    Objects without highlights take the light that most others show. Where as many show another, it stays as it was.
    """
    telling = [name for name in placed if shown[name] is not None]
    if not telling:
        return placed
    evidence = [_of_light(deg) for name in telling if (deg := shown[name]) is not None]
    sets = sorted(agreeing(evidence), key=len, reverse=True)
    found = dict(placed)
    for number, members in enumerate(sets):
        names = [telling[at] for at in members]
        has_most = number == 0 and (len(sets) == 1 or len(members) > len(sets[1]))
        takers = [*names, *(name for name in placed if shown[name] is None)] if has_most else names
        if len(takers) < 2:
            continue
        common = _posterior([evidence[at] for at in members])
        offset, error = _FREE_DEG * common.mean[0], _FREE_DEG * math.sqrt(common.covariance[0, 0])
        prior = float(placed[names[0]].estimate.prior[LIGHT])
        used, probable, variance = settle_light(offset, error, prior)
        remark = f"{_listed(names)} show the light {offset:+.2f} ± {error:.2f} deg from its typed angles"
        if len(sets) > 1:
            remark += ", which other objects contradict"
        for name in takers:
            estimate = placed[name].estimate
            values, mean, covariance = estimate.values.copy(), estimate.probable.copy(), estimate.covariance.copy()
            values[LIGHT], mean[LIGHT] = used, probable
            covariance[LIGHT], covariance[:, LIGHT] = 0.0, 0.0
            covariance[LIGHT, LIGHT] = variance
            changed = estimate._replace(probable=mean, covariance=covariance, values=values)
            found[name] = Placed(changed, [*placed[name].remarks, remark])
    return found


def _apart(name: str, placed: Placed, estimate: Estimate, rest: Common, others: Sequence[str]) -> Placed:
    """Return an object with the remark that others contradict it, and log a warning.

    Parameters
    ----------
    name : str
    placed : Placed
    estimate : Estimate
        By its own photographs.
    rest : Common
        Camera and lens by the others.
    others : sequence of str
        Names of the others.
    """
    prior = estimate.prior[_COMMON]
    mean, sigma = rest.mean * prior, np.sqrt(np.diag(rest.covariance)) * prior
    own, error = estimate.probable[_COMMON], estimate.sigma[_COMMON]
    both = np.hypot(sigma, error)
    off = np.divide(np.abs(own - mean), both, out=np.zeros(len(both)), where=both > 0.0)
    at = int(np.argmax(off))
    quantity = QUANTITIES[_COMMON[at]]
    against = f"{own[at]:+.2f} ± {error[at]:.2f} against {mean[at]:+.2f} ± {sigma[at]:.2f} {quantity.unit}"
    remark = f"left apart from {_listed(others)}, which contradict it about camera and lens: {quantity.text} {against}"
    LOGGER.warning("%s: %s", name, remark)
    return placed._replace(remarks=[remark, *placed.remarks])
