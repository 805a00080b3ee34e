"""Table that expresses the gloss lobe of equation (5) as a few Gaussians on the sphere.

The lobe about (θ_r, μ) is neither round nor centred on the mirror direction: it is long in the plane of incidence and
narrow across, it leans from the mirror direction, and the horizon cuts it. For a ladder of roughnesses and view angles
D G / cosθ_r is therefore a sum with positive weights of the lobes of `irodori.light.blurred_light`, on the plane of
incidence and in pairs on both sides of it. Each keeps the angle θ_H at which its light is reflected, and the Fresnel
reflectance F(n, k, θ_H) multiplies it at look-up: one table serves every refractive index.
`irodori.light.gloss.make_lobe_table` makes the table.
"""

from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from irodori.core import store
from irodori.core.errors import InputError

#: Roughnesses of the ladder, rad, a factor √2 apart; rougher surfaces are for `irodori.light.gloss.point_sources`.
MU_RAD = 0.01 * 2.0 ** (0.5 * np.arange(12))
#: View angles of the ladder, rad.
THETA_R_RAD = np.radians([0.0, 20.0, 40.0, 50.0, 60.0, 67.5, 75.0, 80.0, 84.0, 87.0, 89.0])
#: Changes whenever the table is made anew, so that what was made with another is made again.
TABLE = 1
PATH = Path(__file__).with_name("lobe_table.h5")


class Lobes(NamedTuple):
    """The fitted table, over roughnesses and view angles; a weight of 0 ends the lobes of an entry.

    ``weight`` is ∫ D G / cosθ_r dω of the lobe, of both where it is a pair. ``offset`` is the angle of its axis from
    the normal within the plane of incidence, away from the view, less θ_r; ``across`` its angle out of that plane, 0 or
    that of a pair. ``incidence`` is the angle θ_H at which its light is reflected, less θ_r.
    """

    mu: np.ndarray  # (m,) rad
    theta_r: np.ndarray  # (t,) rad
    width: np.ndarray  # (m, t, lobes) of `irodori.light.blurred_light.WIDTHS_RAD`, its number
    offset: np.ndarray  # (m, t, lobes) rad
    across: np.ndarray  # (m, t, lobes) rad
    weight: np.ndarray  # (m, t, lobes) sr
    incidence: np.ndarray  # (m, t, lobes) rad


#: What a table's file says of its datasets after the ladders: units and quantity.
COLUMNS = {
    "width": ("1", "number of the lobe's width on the ladder"),
    "offset": ("rad", "axis within the plane of incidence, less the view angle"),
    "across": ("rad", "axis out of the plane of incidence, of a pair where it is not 0"),
    "weight": ("sr", "integral of D G / cos(theta_r) over the lobe"),
    "incidence": ("rad", "angle of incidence on the facets, less the view angle"),
}


@lru_cache(maxsize=1)
def fitted_lobes() -> Lobes:
    """Return the table.

    Raises
    ------
    InputError
        If it is another version's.
    """
    with store.open_file(PATH) as file:
        if file.attribute("table") != TABLE or not np.allclose(file.read("mu"), MU_RAD):
            raise InputError(
                PATH,
                "table",
                str(file.attribute("table")),
                f"{TABLE}, by python -m irodori.light.gloss.make_lobe_table",
            )
        columns = [file.read(name).astype(np.int64 if name == "width" else np.float64) for name in COLUMNS]
    return Lobes(MU_RAD, THETA_R_RAD, *columns)
