"""Gloss lobes as sums of few spherical Gaussians: the tables for look-ups in `irodori.light.gloss`, one per lobe.

The lobe D G / cosθ_r of `irodori.reflection.registry` for given θ_r and μ is neither round nor centred on the mirror
direction: it is long in the plane of incidence and narrow across it, its peak is off the mirror direction, and the
horizon cuts it. For a set of roughnesses and view angles it is therefore represented as a sum, with positive weights,
of the round lobes of `irodori.light.blurred_light`, in the plane of incidence and in pairs on both sides of it. For
each round lobe the angle θ_H at which its light is reflected is stored, and the Fresnel reflectance F(n, k, θ_H) is
multiplied in at look-up, so that one table serves all refractive indices. The tables are computed by
`irodori.light.gloss.make_lobe_table`. Those of the lobes of the package are stored in the folder of this module; that
of any other lobe is computed at its first use, and stored in the folder of compiled kernels.
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

#: Roughnesses of the table, a factor √2 apart; rougher surfaces use `irodori.light.gloss.point_sources`.
MU = 0.01 * 2.0 ** (0.5 * np.arange(12))
#: View angles of the table, rad.
THETA_R_RAD = np.radians([0.0, 20.0, 40.0, 50.0, 60.0, 67.5, 75.0, 80.0, 84.0, 87.0, 89.0])
#: Version of the table, to be changed whenever it is made anew, so that results of older versions are recomputed.
TABLE = 2
_FOLDER = Path(__file__).parent
_LOGGER = logging.getLogger("irodori")


def path_of(name: str) -> Path:
    """Return the path of the table of a lobe: in the package, or else in the folder of compiled kernels.

    The name of the latter contains a hash of the lobe's source.
    """
    stored, kept = _FOLDER / f"lobe_table-{name}.h5", cache_folder()
    if stored.is_file() or kept is None:
        return stored
    return kept / f"{__name__}.{name}-{TABLE}-{lobe(name).digest}.h5"


class LobeTable(NamedTuple):
    """Table of a gloss lobe as sums of spherical Gaussians, over roughnesses and view angles.

    A weight of 0 ends the list of Gaussians of an entry. ``weight`` is the contribution of the Gaussian (or of both in
    a pair) to ∫ D G / cosθ_r dω. ``offset`` is the angle of its axis from the normal in the plane of incidence, away
    from the view, minus θ_r. ``across`` is the angle of the axis out of this plane, 0 unless it is a pair.
    ``incidence`` is the angle θ_H at which its light is reflected, minus θ_r.
    """

    mu: np.ndarray  # (m,) in the unit of the lobe
    theta_r: np.ndarray  # (t,) rad
    width: np.ndarray  # (m, t, lobes), index in `irodori.light.blurred_light.WIDTHS_RAD`
    offset: np.ndarray  # (m, t, lobes) rad
    across: np.ndarray  # (m, t, lobes) rad
    weight: np.ndarray  # (m, t, lobes) sr
    incidence: np.ndarray  # (m, t, lobes) rad


#: Units and quantity of the table's datasets other than roughnesses and view angles.
COLUMNS = {
    "width": ("1", "number of the lobe's width on the ladder"),
    "offset": ("rad", "axis within the plane of incidence, less the view angle"),
    "across": ("rad", "axis out of the plane of incidence, of a pair where it is not 0"),
    "weight": ("sr", "integral of D G / cos(theta_r) over the lobe"),
    "incidence": ("rad", "angle of incidence on the facets, less the view angle"),
}


@lru_cache(maxsize=8)
def fitted_lobes(name: str = "gaussian") -> LobeTable:
    """Read the table of a lobe; one that does not exist yet is computed, which takes minutes.

    Raises
    ------
    InputError
        If the table is of another version, or there is none and no place to store one; the message names the command
        that makes it.
    ValueError
        If there is no lobe with this name.
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
