"""Ground truth in the formats of the chain, for the report alone."""

import numpy as np

from irodori.config.models import Camera, IrradianceMap, Object, Rig
from irodori.config.models import Environment as Place
from irodori.core import store
from irodori.light.environment_file import Environment
from irodori.light.irradiance import fitted_irradiance_map
from irodori.material.material_file import Material
from irodori.simulation.virtual_rig.classroom import room_coefficients, source_spectra
from irodori.simulation.virtual_rig.sample_reflection import PAPER
from irodori.simulation.virtual_rig.samples import Sample
from irodori.simulation.virtual_rig.sensor import band_weights
from irodori.spectra.published import light

_GREEN = 1


def true_material(definition: Object, camera: Camera, rig: Rig) -> Material:
    """Return what stands on the virtual rig as a material; its spectra are one-hot on the true spectra.

    α is the response of the green band to S(λ) under the rig's light, as the fit defines it [design, §3]. β and μ are
    those of equation (5), NaN for a material that follows another model.
    """
    sample = Sample.from_definition(definition)
    width, height = definition.texels.width, definition.texels.height
    index = sample.material_index(width, height)
    weights = band_weights(camera, light(rig.light.spectrum))[_GREEN]
    green = sample.reflectance @ weights / weights.sum()
    beta, mu = (np.where(sample.model == PAPER, values, np.nan) for values in (sample.beta, sample.mu_rad))
    return Material(
        alpha=green[index],
        beta=beta[index],
        mu=mu[index],
        green_response=green[index],
        coefficients=np.eye(len(green), dtype=np.float32)[index],
        basis=sample.reflectance.T,
        n=sample.n,
        k=sample.k,
        mirror=sample.mirror,
        typical_gloss=(float(sample.beta[0]), float(sample.mu_rad[0])),
    )


def true_environment(definition: Place, rig: Rig, irradiance_options: IrradianceMap) -> Environment:
    """Return the virtual room's light: one basis vector a source."""
    image, room = definition.image, definition.virtual
    if image is None or room is None:
        raise ValueError("an environment without the blocks image and virtual; accepted: a room of the virtual rig")
    spectra = source_spectra(room, light(rig.light.spectrum))[1]
    coefficients = room_coefficients(room, image.width, image.height)
    irradiance, _ = fitted_irradiance_map(coefficients, **vars(irradiance_options))
    return Environment(coefficients, spectra.T, irradiance)


def write_true_material(definition: Object, camera: Camera, rig: Rig, output, provenance: store.Provenance) -> None:
    """Write the true material of an object."""
    true_material(definition, camera, rig).save(output, provenance)


def write_true_environment(
    definition: Place, rig: Rig, irradiance_options: IrradianceMap, output, provenance: store.Provenance
) -> None:
    """Write the true light of an environment."""
    true_environment(definition, rig, irradiance_options).save(output, provenance)
