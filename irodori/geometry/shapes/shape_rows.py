"""Layout of the numbers of a placed shape in the table that the interactive integrator reads."""

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from irodori.geometry.shapes.placement import Placement

#: Count of numbers for each shape, and the index of each number.
SHAPE = 24
CENTRE, RADIUS, CURVATURE, TURN, WIDE, HIGH, KIND, MIRROR, COLUMNS, ROWS = 0, 3, 4, 5, 14, 15, 16, 17, 18, 19
#: Of a thin sheet: the row of the other side, and the number of the texture of its transmittance; -1 if there is none.
BEHIND, THROUGH = 20, 21


def shape_row(placement: "Placement", reach_mm: float, number: int, dtype=np.float32) -> np.ndarray:
    """Return the numbers of a placed shape, (SHAPE,), with zeros for its material.

    Parameters
    ----------
    placement : Placement
    reach_mm : float
        See `irodori.geometry.shapes.placement.reaches`.
    number : int
        See `irodori.geometry.shape_registry.number_of`.
    dtype : type
        float32, which the integrator reads, or float64.
    """
    row = np.zeros(SHAPE, dtype=dtype)
    shape = placement.shape
    row[CENTRE : CENTRE + 3] = shape.frame_origin(placement)
    row[TURN : TURN + 9] = np.ravel(placement.rotation)
    row[RADIUS], row[KIND] = reach_mm, number
    row[CURVATURE] = shape.curvature_per_mm(placement.scale)
    row[WIDE : WIDE + 2] = shape.texture_per_mm(placement.scale)
    return row
