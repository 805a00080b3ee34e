"""Planning decisions of the interactive integrator, taken in turn within a tolerance [design, §2].

Every decision has candidates from cheap to exact. A candidate is taken if its colour error, measured at the probes
(random rays of the pictures), is below the decision's share of the remaining tolerance, and if the error of the picture
with all decisions so far is below the tolerance. Tolerance that is not used remains for the later decisions.
"""

from dataclasses import replace

import numpy as np

from irodori.config.models import PlanOverrides
from irodori.core.errors import InputError
from irodori.light.blurred_light import first_level
from irodori.rendering.interactive.frame_renderer import light_of
from irodori.rendering.interactive.quadrature import COUNTS
from irodori.rendering.planning.modelled_scene import (
    SceneParts,
    beta_of,
    full_model,
    leading_basis,
    levels_of_lobes,
    stays_grey,
)
from irodori.rendering.planning.probes import BLACK, Changes, Probes, halvings_of
from irodori.rendering.planning.scene_planner import MOST_VIEWS, PROBES, SEED, ScenePlanner
from irodori.rendering.scene_arrays import View, make_light

_THROUGHPUTS = tuple(10.0 ** (-0.5 * n) for n in range(2, 11))
_LEAST_ROWS = 32
#: Largest number of objects for which lobes or textures are tried one by one.
_MOST_TRIED = 32


def choose(
    parts: SceneParts,
    views: list[View],
    names: list[str],
    tolerance: float,
    *,
    max_bounces: int,
    overrides: PlanOverrides,
    where: str = "scene",
) -> ScenePlanner:
    """Decide which simplifications to make in a scene.

    Parameters
    ----------
    parts : SceneParts
    views : list of View
    names : list of str
        Names of the objects.
    tolerance : float
        Limit of CIEDE2000 for 99 of 100 pixels.
    max_bounces : int
        Number of mirror reflections in the full model.
    overrides : PlanOverrides
        Decisions that the scene's definition states.
    where : str
        Name of the scene for error messages.

    Returns
    -------
    ScenePlanner
        Planner with the final ``model`` and ``decisions``. A predicted error is an upper bound for 99 of 100 pixels
        with a certainty of 0.999, estimated from the probes; for a lobe that is left out, it is the largest error of
        all probes.

    Raises
    ------
    InputError
        If an override is not among the candidates.
    """
    ladder, model = make_light(parts.environment), full_model(parts, max_bounces)
    probes = Probes(parts, model, ladder, views, PROBES * min(len(views), MOST_VIEWS), SEED)
    planner = ScenePlanner(parts, probes, model, tolerance, names, overrides, ladder, where)
    _decide_lobes(planner)
    _decide_bounces(planner)
    _decide_light_bases(planner)
    _decide_representation(planner)
    _decide_environment(planner)
    _decide_textures(planner)
    _decide_look_ups(planner)
    planner.joint = planner.bound(planner.errors(planner.changes, planner.xyz))
    return planner


def _traced(planner: ScenePlanner, name: str, own: tuple[bool, ...], asked: tuple[str, ...]) -> tuple[bool, ...]:
    """Return for each object whether its lobe ``name`` is traced, by the list in the scene's definition.

    Raises
    ------
    InputError
        If an object is not in the scene, or has no such lobe.
    """
    having = [n for n, there in zip(planner.names, own, strict=True) if there]
    for wanted in asked:
        if wanted not in having:
            accepted = f"of the objects with that lobe: {', '.join(having) or 'there are none'}"
            raise InputError(planner.where, f"plan.{name}", repr(wanted), accepted)
    return tuple(there and n in asked for n, there in zip(planner.names, own, strict=True))


def _decide_lobes(planner: ScenePlanner) -> None:
    """Decide which gloss and mirror terms to leave out: those of weight 0, and those whose error fits at all probes."""
    for name in ("gloss", "mirror"):
        own = getattr(planner.model, name)
        asked = getattr(planner.overrides, name)
        traced = _without_the_weakest(planner, name, own) if asked is None else _traced(planner, name, own, asked)
        without = frozenset(i for i, (a, b) in enumerate(zip(own, traced, strict=True)) if a and not b)
        alone = float(planner.errors(_without(Changes(), name, without)).max()) if without else 0.0
        changes = _without(planner.changes, name, without)
        absent = sum(not there for there in own)
        why = f"{absent} of {len(own)} objects have none; the largest error at any probe counts"
        planner.decide(name, alone, changes, why, lossy=True, **{name: traced})


def _without(changes: Changes, name: str, objects: frozenset[int]) -> Changes:
    """Return changes with the given objects as those without a term, ``gloss`` or ``mirror``."""
    if name == "gloss":
        return replace(changes, without_gloss=objects)
    return replace(changes, without_mirror=objects)


def _without_the_weakest(planner: ScenePlanner, name: str, own: tuple[bool, ...]) -> tuple[bool, ...]:
    # With many objects only the weakest lobes are tried, because each trial renders all probes.
    weight = [float(beta_of(planner.parts.objects, i).max(initial=0.0)) for i in range(len(own))]
    if name == "mirror":
        weight = list(planner.parts.objects.mirror)
    order = [int(i) for i in np.argsort(weight, kind="stable") if own[i]]
    traced, tried = list(own), 0
    without: frozenset[int] = frozenset()
    before = planner.seen
    for index in order:
        found = planner.probes.radiance(_without(Changes(), name, without | {index}))
        if np.array_equal(found, before):
            continue  # no probe sees this lobe: the picture may
        tried += 1
        alone = float(planner.differences(found).max())
        if planner.fits(alone, _without(planner.changes, name, without | {index})):
            without, traced[index], before = without | {index}, False, found
        if tried == _MOST_TRIED:
            break
    return tuple(traced)


def _first_that_fits(planner: ScenePlanner, name: str, candidates: list, of) -> tuple:
    """Return the first candidate that fits, or the one that the scene's definition states, and the result of ``of``.

    ``of(candidate)`` returns the candidate's own error, all changes so far with it, and the function from spectra to
    XYZ. The last candidate is exact.
    """
    wanted = getattr(planner.overrides, name)
    if wanted is not None:
        if wanted not in candidates:
            accepted = ", ".join(f"{c:g}" if isinstance(c, float) else str(c) for c in candidates[:20])
            raise InputError(planner.where, f"plan.{name}", repr(wanted), accepted)
        return wanted, of(wanted)
    for candidate in candidates:
        found = of(candidate)
        if candidate == candidates[-1] or planner.fits(*found):
            return candidate, found
    raise AssertionError("no candidates")


def _decide_bounces(planner: ScenePlanner) -> None:
    most = planner.model.max_bounces
    reached = most if any(planner.model.mirror) else 0

    def of_bounces(bounces: int):
        alone = 0.0
        if bounces < reached:
            alone = float(planner.errors(Changes(max_bounces=bounces)).max())
        return alone, replace(planner.changes, max_bounces=bounces), None

    candidates = list(range((reached if planner.overrides.max_bounces is None else most) + 1))
    bounces, (alone, changes, _) = _first_that_fits(planner, "max_bounces", candidates, of_bounces)
    why = "the largest error at any probe counts" if reached else "no mirrors"
    planner.decide("max_bounces", alone, changes, why, max_bounces=bounces)
    if bounces == 0:
        planner.model = replace(planner.model, mirror=(False,) * len(planner.names))
    _decide_throughput(planner)


def _decide_throughput(planner: ScenePlanner) -> None:
    lobes = any(planner.model.gloss) or planner.model.max_bounces > 0
    candidates = [*_THROUGHPUTS, 0.0] if lobes else [0.0]

    def of_least(least: float):
        alone = planner.bound(planner.errors(Changes(least_throughput=least))) if least else 0.0
        return alone, replace(planner.changes, least_throughput=least), None

    if planner.overrides.least_throughput is not None:
        least = planner.overrides.least_throughput
        alone, changes, _ = of_least(least)
    else:
        least, (alone, changes, _) = _first_that_fits(planner, "least_throughput", candidates, of_least)
    why = "a path or a lobe that passes less than this is left" if lobes else "no lobes and no mirrors"
    planner.decide("least_throughput", alone, changes, why, least_throughput=least)


def _decide_light_bases(planner: ScenePlanner) -> None:
    light, count = light_of(planner.parts.environment), planner.model.light_bases

    def of_bases(bases: int):
        if bases == count:
            return 0.0, planner.changes, None
        to, basis = leading_basis(light, bases)
        alone = planner.bound(planner.errors(Changes(light_basis=to @ basis)))
        return alone, replace(planner.changes, light_basis=to @ basis), None

    candidates = list(range(1, count + 1)) if planner.model.environment or planner.model.irradiance else [count]
    bases, (alone, changes, _) = _first_that_fits(planner, "light_bases", candidates, of_bases)
    why = f"the light's {bases} leading of {count} vectors"
    planner.decide("light_bases", alone, changes, why, light_bases=bases)


def _decide_representation(planner: ScenePlanner) -> None:
    """Decide for the representation with the least work that fits; the reason lists the work of all."""
    candidates = [("quadrature", nodes) for nodes in COUNTS] + [("spectral", planner.model.nodes)]
    if stays_grey(planner.parts.objects, planner.model):
        candidates.append(("coefficients", 0))
    costs = {c: planner.numbers(replace(planner.model, representation=c[0], nodes=c[1])) for c in candidates}
    candidates.sort(key=lambda c: (c[0] == "spectral", costs[c]))
    wanted = planner.overrides.representation, planner.overrides.nodes
    chosen = [c for c in candidates if wanted[0] in (None, c[0]) and wanted[1] in (None, c[1])]
    if not chosen:
        found = f"{wanted[0]} where gloss or a mirror has a refractive index that varies with the wavelength"
        raise InputError(planner.where, "plan.representation", found, "quadrature, spectral")
    for candidate in chosen:
        alone, changes, xyz = _error_of(planner, *candidate)
        if candidate == chosen[-1] or planner.fits(alone, changes, xyz):
            break
    others = ", ".join(f"{c[0]}{f' {c[1]}' if c[0] == 'quadrature' else ''} {costs[c]:.0f}" for c in candidates)
    planner.xyz = xyz
    why = f"numbers a ray: {others}"
    if wanted != (None, None):
        planner.by_scene |= {"representation", "nodes"}  # stating one of them restricts the other
    planner.decide("representation", alone, changes, why, representation=candidate[0], nodes=candidate[1])
    quadrature = planner.solve(candidate[1]) if candidate[0] == "quadrature" else None
    why = "wavelengths of a quadrature" if quadrature else "no quadrature"
    planner.decide("nodes", 0.0, changes, why, lossy=False, nodes=candidate[1])
    planner.model = replace(planner.model, quadrature=quadrature)


def _error_of(planner: ScenePlanner, representation: str, nodes: int):
    """Return a representation's own error, all changes so far with it, and its function from spectra to XYZ."""
    changes, alone = planner.changes, Changes()
    if representation == "spectral":
        return 0.0, changes, lambda spectra: spectra @ planner.matrix.T
    if representation == "quadrature":
        solved = planner.solve(nodes)

        def xyz(spectra):
            return spectra[:, solved.samples] @ solved.weights.T
    else:

        def xyz(spectra):
            return spectra @ planner.matrix.T

    return planner.bound(planner.errors(alone, xyz)), changes, xyz


def _decide_environment(planner: ScenePlanner) -> None:
    rows = planner.ladder.size[:, 1]
    coarsest = max(int((rows >= min(_LEAST_ROWS, rows[0])).sum()) - 1, 0) if planner.model.environment else 0

    def of_halvings(halvings: int):
        alone = 0.0
        if halvings:
            found = planner.probes.radiance(Changes(sky_level=halvings))
            alone = planner.bound_where(planner.showing(found), found)
        return alone, replace(planner.changes, sky_level=halvings), None

    candidates = list(range(coarsest, -1, -1))
    halvings, (alone, changes, _) = _first_that_fits(planner, "environment_halvings", candidates, of_halvings)
    why = f"{rows[halvings]} of {rows[0]} rows, as the eye and the mirrors see them"
    planner.decide("environment_halvings", alone, changes, why, environment_halvings=halvings)


def _decide_textures(planner: ScenePlanner) -> None:
    objects, count = planner.parts.objects, len(planner.names)
    whole = {*np.flatnonzero(objects.behind >= 0), *objects.through}  # both sides of a sheet, and what passes through
    most = [0 if index in whole else halvings_of(*size) for index, size in enumerate(objects.texture_size)]
    wanted = planner.overrides.texture_halvings
    if wanted is not None:
        halvings = {i: min(wanted, most[i]) for i in range(count) if min(wanted, most[i])}
    else:
        halvings = _halvings_that_fit(planner, most)
    errors = (_texture_error(planner, _showing_object(planner, i), i, level) for i, level in halvings.items())
    alone = max(errors, default=0.0)
    changes = replace(planner.changes, texture_level=halvings)
    why = "as the probes see them; those that none meets stay whole"
    values = tuple(halvings.get(i, 0) for i in range(count))
    planner.decide("texture_halvings", alone, changes, why, texture_halvings=values)


def _showing_object(planner: ScenePlanner, index: int) -> np.ndarray:
    """Return a mask of the probes that show an object's texture, directly or in a mirror, (count,) bool."""
    return planner.showing(planner.probes.radiance(Changes(texture_level={index: BLACK})))


def _texture_error(planner: ScenePlanner, seen: np.ndarray, index: int, level: int) -> float:
    """Return the error bound of a texture halved ``level`` times, over the probes that show its object."""
    return planner.bound_where(seen, planner.probes.radiance(Changes(texture_level={index: level})))


def _halvings_that_fit(planner: ScenePlanner, most: list[int]) -> dict[int, int]:
    """Return the number of halvings of each texture that fit, by the errors at the probes that show its object."""
    sizes = planner.parts.objects.texture_size.prod(axis=1)
    largest = [int(i) for i in np.argsort(-sizes, kind="stable") if most[i]]
    share = (planner.tolerance - planner.spent) / planner.left
    halvings, tried = {}, 0
    for index in largest:
        seen = _showing_object(planner, index)
        if not seen.any():
            continue
        for level in range(1, most[index] + 1):
            if _texture_error(planner, seen, index, level) > share:
                break
            halvings[index] = level
        tried += 1
        if tried == _MOST_TRIED:
            break
    # Each fits alone, but where mirrors show several of them, errors add up.
    while halvings and not planner.fits(0.0, replace(planner.changes, texture_level=halvings)):
        halvings = {i: level - 1 for i, level in halvings.items() if level > 1}
    return halvings


def _decide_look_ups(planner: ScenePlanner) -> None:
    """Note which maps and which levels of blurred light are needed at all; these decisions cause no error."""
    model = planner.model
    levels = (0, 0)
    if model.environment:
        finest = first_level(*planner.parts.environment.coefficients.shape[:2])
        levels = levels_of_lobes(planner.parts.objects, model.gloss, finest)
    why = "those that the roughness of the traced lobes reaches"
    planner.decide("gloss_levels", 0.0, planner.changes, why, lossy=False, gloss_levels=levels)
    why = "light from all sides" if model.environment else "the environment is black"
    planner.decide("environment", 0.0, planner.changes, why, lossy=False, environment=model.environment)
    why = (
        "diffuse surfaces under light from all sides" if model.irradiance else "no such surface or light, or light maps"
    )
    planner.decide("irradiance", 0.0, planner.changes, why, lossy=False, irradiance=model.irradiance)
