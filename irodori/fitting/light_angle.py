"""Angle of the light from an object's photographs: where its highlights and its shading show the light.

The angle is a further unknown of the estimate in `irodori.fitting.level_estimate`. The materials of texels, the lamp's
level and the errors of the angles in every photograph, a lobe of any form and a departure from Lambert's law are
estimated together with it. Each step observes the texels anew under the angle found so far. Flat objects are not asked:
each photograph shows them under one set of angles.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from irodori.config.parts import typed_index
from irodori.fitting.diffuse_response import GREEN
from irodori.fitting.level_estimate import MOST_TEXELS, adjust, describe, predict
from irodori.fitting.solvers import FitOptions
from irodori.fitting.texel_sample import Readings
from irodori.geometry.atlas import are_alike
from irodori.geometry.shapes.shape import Shape
from irodori.material.lobe_choices import model_before_choice
from irodori.rectification.placement_correction import LIGHT
from irodori.rectification.stage import RigSetup, angles_in_captures, noise_models, observe_captures
from irodori.spectra.published import refractive_index

if TYPE_CHECKING:
    from irodori.config.models import Object
    from irodori.config.parts import TexturedObject

_STEPS = 8
_STILL = 0.2  # standard errors within which a step ends the search
#: Errors of the light angles at which the search begins: the first under which the model describes the surface.
_STARTS_DEG = (0.0, *(sign * size for size in (1.0, 2.0, 3.0, 4.0, 5.0) for sign in (1.0, -1.0)))
_FREE_DEG = 3.0  # standard deviation of the angle before the estimate, so wide that the photographs decide
_ASIDE_DEG = 0.02  # of a numerical derivative
_LARGEST_DEG = 6.0
_MOST_ERROR_DEG = 0.15  # standard error of an angle that the photographs determine
_OBSERVED = 0.4  # share of a round object's texels, about, with enough observations


class LightAngle(NamedTuple):
    """Error of all light angles as the photographs show it: to be added to the typed angles; its standard error."""

    offset_deg: float
    error_deg: float


class Sight(NamedTuple):
    """Functions of a number of degrees that is added to all light angles.

    ``readings`` returns the readings of texels; ``geometry`` only their angles θ_i, θ_r, θ_H, φ, (texels, J, 4) rad.
    """

    readings: Callable[[float], Readings]
    geometry: Callable[[float], np.ndarray]


def estimate_light_angle(sight: Sight, options: FitOptions) -> LightAngle | None:
    """Return the error of all light angles; None where the photographs do not determine it.

    The steps begin at the typed angles or, where the observations of more than a quarter of the texels contradict the
    model under these, at the next whole degree under which they do not, up to five. The result is None if there is none
    or if fewer than fifty texels with five observations fit the model, and if the standard error exceeds 0.15 degrees.

    Parameters
    ----------
    sight : Sight
    options : FitOptions
        ``model_error`` is the standard deviation of a photograph's level before the estimate, ``pose_error_deg`` that
        of the angles of light and camera in single photographs.
    """
    if not options.model_error > 0.0:
        return None
    level = np.ones(sight.readings(0.0).response.shape[1])
    starts = ((start, describe(sight.readings(start), options, level)) for start in _STARTS_DEG)
    offset, texels = next((found for found in starts if found[1] is not None), (0.0, None))
    for _ in range(_STEPS):
        if texels is None or abs(offset) > _LARGEST_DEG:
            return None
        before = offset
        aside = [predict(texels, sight.geometry(offset + way * _ASIDE_DEG)[texels.chosen]) for way in (1.0, -1.0)]
        slope = (aside[0] - aside[1]) * (_FREE_DEG / (2.0 * _ASIDE_DEG))
        step = adjust(texels, options, level, slope[..., None], (offset / _FREE_DEG,))
        level, offset, error = step.level, _FREE_DEG * float(step.further[0]), _FREE_DEG * float(step.further_error[0])
        if abs(offset - before) < _STILL * error:
            return LightAngle(offset, error) if error <= _MOST_ERROR_DEG else None
        texels = describe(sight.readings(offset), options, level)
    return None


@dataclass(frozen=True)
class LightSearch:
    """Search for the light in photographs of one object; called with a setup, it returns what they tell.

    Parameters
    ----------
    linear : sequence of path
        Files of linear responses.
    definition : Object or TexturedObject
    options : FitOptions
    index : (n, k) of float or (61,) float
        Complex refractive index, of which the mean is taken.
    max_angle_deg : float
        Observations under larger angles of incidence or reflection do not count.
    """

    linear: Sequence
    definition: "Object | TexturedObject"
    options: FitOptions
    index: tuple
    max_angle_deg: float

    @classmethod
    def of(cls, linear: Sequence, definition: "Object | TexturedObject", params) -> "LightSearch":
        """Return the search with a rule's plain parameters fit, lobes, coat, refractive_index and max_angle_deg."""
        options = FitOptions(**params.fit, **model_before_choice(params.lobes, params.coat))
        index = refractive_index(typed_index(params.refractive_index))
        return cls(linear, definition, options, index, params.max_angle_deg)

    def __call__(self, setup: RigSetup) -> LightAngle | None:
        """Return the error of all light angles; None where the photographs do not determine it.

        Parameters
        ----------
        setup : RigSetup
            Camera and rig, with the object's place corrected.
        """
        shape, size = Shape.from_definition(self.definition.shape), self.definition.texels
        shrink = min(1.0, np.sqrt(MOST_TEXELS / _OBSERVED / (size.width * size.height)))
        texels = shape.atlas(*(max(2, round(side * shrink)) for side in (size.width, size.height)))
        if are_alike(texels.normal[texels.covered]):
            return None
        noise, (n, k) = noise_models(list(self.linear))[:, GREEN], (float(np.mean(value)) for value in self.index)

        def lit_from(offset_deg: float) -> RigSetup:
            values = list(setup.correction.values)
            values[LIGHT] += offset_deg
            return replace(setup, correction=setup.correction.by(values))

        def readings(offset_deg: float) -> Readings:
            found = observe_captures(self.linear, shape, texels, lit_from(offset_deg), self.max_angle_deg)
            angles, coupled = found.geometry.astype(np.float64), self.options.is_coupled
            weight = found.weight.astype(np.float32)
            return Readings(found.response[..., GREEN], weight, angles, noise, n, k, coupled)

        def geometry(offset_deg: float) -> np.ndarray:
            return angles_in_captures(self.linear, shape, texels, lit_from(offset_deg))

        return estimate_light_angle(Sight(readings, geometry), self.options)
