"""Ground truth of virtual objects and lights, in the file formats of the workflow, used only for the report."""

import numpy as np

from irodori.config.models import EnvironmentDefinition, IrradianceMap, Object, Rig
from irodori.config.parts import AnyCamera, TrueObject
from irodori.light.environment_file import Environment
from irodori.light.irradiance import fitted_irradiance_map
from irodori.material.material_file import Material
from irodori.reflection.coat import COUPLED, SUM
from irodori.simulation.virtual_rig.classroom import room_coefficients, source_spectra
from irodori.simulation.virtual_rig.imperfections import lamp_light
from irodori.simulation.virtual_rig.samples import Sample
from irodori.simulation.virtual_rig.sensor import band_weights

_GREEN = 1


def true_material(definition: Object | TrueObject, camera: AnyCamera, rig: Rig) -> Material:
    """Return the true material of an object on the virtual rig.

    The basis holds the true spectra, and the coefficients of a texel are 1 for its own spectrum and 0 for the others. α
    is the response of the green band to S(λ) under the rig's light, as the fit defines it [design, §3]. The gloss
    components are those of the sample, see `_gloss`; β and μ are NaN for a material from measured BRDF samples.
    """
    sample = Sample.from_definition(definition)
    width, height = definition.texels.width, definition.texels.height
    index = sample.material_index(width, height)
    weights = band_weights(camera, lamp_light(rig))[_GREEN]
    green = sample.reflectance @ weights / weights.sum()
    lobes, gloss, typical = _gloss(sample)
    (beta, mu), *further = [(beta[index], mu[index]) for beta, mu in gloss]
    coefficients, through = np.eye(len(green), dtype=np.float32)[index], None
    if definition.sheet is not None:
        through = Material.diffuse(coefficients, sample.through.T)
    return Material(
        alpha=green[index],
        beta=beta,
        mu=mu,
        green_response=green[index],
        coefficients=coefficients,
        basis=sample.reflectance.T,
        n=sample.n,
        k=sample.k,
        mirror=sample.mirror,
        typical_gloss=typical,
        lobes=lobes,
        further_gloss=tuple(further),
        through=through,
        transmittance="" if through is None else "measured",
        coat=COUPLED if sample.is_coupled else SUM,
    )


def _gloss(sample: Sample) -> tuple[tuple[str, ...], list[tuple[np.ndarray, np.ndarray]], tuple[float, ...]]:
    """Return gloss components that are common to all materials: lobes, (β, μ) of each material, and typical values.

    Of each lobe there are as many components as any single material has. A material that lacks a component gets β = 0,
    which reflects nothing, and the typical μ. All values of a measured material are NaN.
    """
    places: dict[tuple[str, int], list[int | None]] = {}
    for m, names in enumerate(sample.lobes):
        # Components with the same lobe are in order from the broadest, as in the fit.
        for c in range(len(names)):
            broader = sum(other == names[c] and (-sample.mu[m, d], d) < (-sample.mu[m, c], c)
                          for d, other in enumerate(names))  # fmt: skip
            places.setdefault((names[c], broader), [None] * len(sample.lobes))[m] = c
    if not places:
        places = {("gaussian", 0): [None] * len(sample.lobes)}
    gloss: list[tuple[np.ndarray, np.ndarray]] = []
    typical: list[float] = []
    # The broadest components of all lobes come first, then the second broadest, and so on.
    places = dict(sorted(places.items(), key=lambda item: item[0][1]))
    for components in places.values():
        own = [(m, c) for m, c in enumerate(components) if c is not None]
        usual = (float(sample.beta[own[0]]), float(sample.mu[own[0]])) if own else (0.0, 1.0)
        beta, mu = np.zeros(len(components)), np.full(len(components), usual[1])
        for m, c in own:
            beta[m], mu[m] = sample.beta[m, c], sample.mu[m, c]
        beta[sample.table >= 0] = mu[sample.table >= 0] = np.nan
        gloss.append((beta, mu))
        typical += usual
    return tuple(name for name, _ in places), gloss, tuple(typical)


def true_environment(definition: EnvironmentDefinition, rig: Rig, irradiance_options: IrradianceMap) -> Environment:
    """Return the true light of a virtual room as an environment with one basis vector for each source."""
    image, room = definition.image, definition.virtual
    if image is None or room is None:
        raise ValueError("an environment without the blocks image and virtual; accepted: a room of the virtual rig")
    spectra = source_spectra(room, lamp_light(rig))[1]
    coefficients = room_coefficients(room, image.width, image.height)
    irradiance, _ = fitted_irradiance_map(coefficients, **vars(irradiance_options))
    return Environment(coefficients, spectra.T, irradiance)
