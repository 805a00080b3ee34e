"""Gloss lobes as few Gaussians of the sphere: the tables that `irodori.light.gloss` looks up with, one a lobe.

The lobe D G / cosθ_r of `irodori.reflection.registry` about (θ_r, μ) is neither round nor centred on the mirror
direction: it is long in the plane of incidence and narrow across, it leans from the mirror direction, and the horizon
cuts it. For a ladder of roughnesses and view angles it is therefore a sum with positive weights of the lobes of
`irodori.light.blurred_light`, on the plane of incidence and in pairs on both sides of it. Each keeps the angle θ_H at
which its light is reflected, and the Fresnel
reflectance F(n, k, θ_H) multiplies it at look-up: one table serves every refractive index.
`irodori.light.gloss.make_lobe_table` makes the tables; those of the package's own lobes are stored beside this module,
that of any other lobe is made when it is first asked for, and kept beside the kernels.
"""

import logging
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from irodori.core import store
from irodori.core.errors import InputError
from irodori.jit.kernel_cache import cache_folder
from irodori.reflection.registry import lobe

#: Roughnesses of the ladder, a factor √2 apart; rougher surfaces are for `irodori.light.gloss.point_sources`.
MU = 0.01 * 2.0 ** (0.5 * np.arange(12))
#: View angles of the ladder, rad.
THETA_R_RAD = np.radians([0.0, 20.0, 40.0, 50.0, 60.0, 67.5, 75.0, 80.0, 84.0, 87.0, 89.0])
#: Changes whenever the table is made anew, so that what was made with another is made again.
TABLE = 2
_FOLDER = Path(__file__).parent
_LOGGER = logging.getLogger("irodori")


def path_of(name: str) -> Path:
    """Return the file of the table of a lobe: the package's own, else one beside the kernels, by the lobe's source."""
    stored, kept = _FOLDER / f"lobe_table-{name}.h5", cache_folder()
    if stored.is_file() or kept is None:
        return stored
    return kept / f"{__name__}.{name}-{TABLE}-{lobe(name).digest}.h5"


class LobeTable(NamedTuple):
    """The fitted table of a lobe, over roughnesses and view angles; a weight of 0 ends the lobes of an entry.

    ``weight`` is ∫ D G / cosθ_r dω of the lobe, of both where it is a pair. ``offset`` is the angle of its axis from
    the normal within the plane of incidence, away from the view, less θ_r; ``across`` its angle out of that plane, 0 or
    that of a pair. ``incidence`` is the angle θ_H at which its light is reflected, less θ_r.
    """

    mu: np.ndarray  # (m,) in the unit of the lobe
    theta_r: np.ndarray  # (t,) rad
    width: np.ndarray  # (m, t, lobes) of `irodori.light.blurred_light.WIDTHS_RAD`, its number
    offset: np.ndarray  # (m, t, lobes) rad
    across: np.ndarray  # (m, t, lobes) rad
    weight: np.ndarray  # (m, t, lobes) sr
    incidence: np.ndarray  # (m, t, lobes) rad


#: Attributes of a table's datasets after the ladders: units and quantity.
COLUMNS = {
    "width": ("1", "number of the lobe's width on the ladder"),
    "offset": ("rad", "axis within the plane of incidence, less the view angle"),
    "across": ("rad", "axis out of the plane of incidence, of a pair where it is not 0"),
    "weight": ("sr", "integral of D G / cos(theta_r) over the lobe"),
    "incidence": ("rad", "angle of incidence on the facets, less the view angle"),
}


@lru_cache(maxsize=8)
def fitted_lobes(name: str = "gaussian") -> LobeTable:
    """Return the table of a lobe; one that the package does not have is made, which takes minutes.

    Raises
    ------
    InputError
        If it is another version's, or there is none and no place to keep one; the command that makes it is named.
    ValueError
        If there is no lobe of that name.
    """
    path, command = path_of(lobe(name).name), f"python -m irodori.light.gloss.make_lobe_table {name}"
    if not path.is_file():
        if path.parent == _FOLDER:
            raise InputError(path, "", "no table of the lobe", f"the one that {command} makes")
        from irodori.light.gloss import make_lobe_table

        _LOGGER.warning("the blurred light of the lobe %s is tabulated once, in minutes: %s", name, path)
        make_lobe_table.write_table(path, name)
    with store.open_file(path) as file:
        found = file.attribute("table"), file.attribute("lobe")
        if found != (TABLE, name) or not np.allclose(file.read("mu"), MU):
            raise InputError(path, "table", " of ".join(map(str, found)), f"{TABLE} of {name}, by {command}")
        columns = [file.read(key).astype(np.int64 if key == "width" else np.float64) for key in COLUMNS]
    return LobeTable(MU, THETA_R_RAD, *columns)
