"""Material files: parameter maps and reflectance, stored and loaded for rendering."""

from dataclasses import dataclass, field, replace
from enum import IntEnum
from typing import Any

import numpy as np

from irodori.core import store
from irodori.core.errors import InputError
from irodori.material.coefficients import read_coefficients, write_coefficients
from irodori.reflection.coat import COATS, SUM
from irodori.reflection.registry import DEFAULT_LOBES, lobe, names
from irodori.spectra.coordinates import write_wavelength
from irodori.spectra.grid import SAMPLES
from irodori.spectra.spectral_files import REFLECTANCE
from irodori.spectra.tables import LEAST_N, MOST_K, MOST_N

_DARKEST_GREEN = 1e-3
#: Largest number of texels along a side at which a file's reflectance is checked.
_LOOKED_AT = 500
#: Maps of a material's file other than those of gloss: units and quantity.
MAPS = {
    "alpha": ("1", "diffuse weight"),
    "green_response": ("1", "green-band response of S"),
}
BASIS, COEFFICIENTS, QUANTITY = (
    "reflectance/basis",
    "reflectance/coefficients",
    "coefficients of the reflectance factor",
)
#: Of a thin sheet's transmittance.
SENT_BASIS, SENT_COEFFICIENTS, SENT = (
    "transmittance/basis",
    "transmittance/coefficients",
    "coefficients of the transmittance",
)
_ERROR = "reflectance_error"
#: First version of the files that names the lobes; earlier ones have a single Gaussian lobe.
_LOBES_SINCE = 2


class Status(IntEnum):
    """Outcome of a texel's fit."""

    OK = 0
    MU_UNIDENTIFIABLE = 1  # there is gloss, but the data does not determine β or μ: both are NaN
    AT_BOUND = 2
    TOO_FEW_OBSERVATIONS = 3
    NON_FINITE = 4  # too few observations, because those with weight are not finite
    DIFFUSE_ONLY = 5  # the observations show no gloss
    SATURATED = 6  # the camera clips where the highlight is
    DARK = 7  # no light beyond the noise
    PAINT = 8  # β and μ are mostly those of all texels of its paint, and agree with its own observations
    CONTRADICTED = 9  # even the best fit of the model misses the observations by more than their errors
    MIXTURE = 10  # perhaps of two paints: β and μ are between theirs, and errors contain both


class NloptResult(IntEnum):
    """Return codes of the optimisation library NLopt, with the names and numbers of its manual."""

    FORCED_STOP = -5
    ROUNDOFF_LIMITED = -4
    OUT_OF_MEMORY = -3
    INVALID_ARGS = -2
    FAILURE = -1
    NOT_CALLED = 0
    SUCCESS = 1
    STOPVAL_REACHED = 2
    FTOL_REACHED = 3
    XTOL_REACHED = 4
    MAXEVAL_REACHED = 5
    MAXTIME_REACHED = 6


def gloss_names(component: int) -> tuple[str, str]:
    """Return the dataset names of β and μ of a gloss component: ``beta``, ``mu`` of 0, ``beta_2``, ``mu_2`` of 1."""
    return ("beta", "mu") if component == 0 else (f"beta_{component + 1}", f"mu_{component + 1}")


def gloss_maps(lobes: tuple[str, ...]) -> dict[str, tuple[str, str]]:
    """Return the dataset names of the gloss components of the given lobes: name -> (units, quantity)."""
    maps = {}
    for component, name in enumerate(lobes):
        beta, mu = gloss_names(component)
        kind, which = lobe(name), "" if component == 0 else f" of gloss component {component + 1}"
        maps[beta] = ("1", f"gloss weight{which}")
        maps[mu] = (kind.roughness.unit, f"{kind.roughness.quantity}{which}")
    return maps


def read_lobes(file: store.Reader) -> tuple[str, ...]:
    """Return the lobes of the gloss components in an open file of fitted tiles or of a material.

    Files of schema version 1 do not name lobes: all of them have one Gaussian lobe.

    Raises
    ------
    InputError
        If a newer file does not name its lobes, or names one that is not registered.
    """
    if not file.has_attribute("lobes") and file.attribute("schema_version", int) < _LOBES_SINCE:
        return DEFAULT_LOBES
    found = file.attribute("lobes", list)
    if not found or any(name not in names() for name in found):
        listed = ", ".join(map(str, found)) or "an empty list"
        raise InputError(file.path, "lobes", listed, f"one or more of: {', '.join(names())}")
    return tuple(found)


def read_coat(file: store.Reader) -> str:
    """Return the coat in an open file of fitted tiles or of a material; files of earlier versions name none.

    Raises
    ------
    InputError
        If the file names an unknown coat.
    """
    found = file.attribute("coat", str) if file.has_attribute("coat") else SUM
    if found not in COATS:
        raise InputError(file.path, "coat", found, f"one of: {', '.join(COATS)}")
    return found


@dataclass(frozen=True)
class Material:
    """Diffuse reflection, gloss components and perfect mirror over a texture.

    The model is α S cosθ_i + Σ β F D G / cosθ_r over the gloss components, each with a lobe of
    `irodori.reflection.registry`; equation (5) has one, ``gaussian``.

    Parameters
    ----------
    alpha, beta, mu, green_response : (height, width) float
        Weights, roughness of the first gloss component in the unit of its lobe, and S_G; NaN where the data does not
        determine them.
    coefficients : (height, width, k) float32
    basis : (61, k) float
        S(λ) = basis @ coefficients, absolute reflectance factor.
    n, k : (61,) float
        Complex refractive index.
    mirror : float, χ
    typical_gloss : tuple of float
        β and μ of each component in turn, from the object's well-determined texels; used where a texel's own data do
        not determine its gloss.
    extra : dict
        Further maps: name -> (values, units, quantity).
    lobes : tuple of str
        Lobe of each gloss component.
    further_gloss : tuple of (beta, mu)
        Maps of the components after the first, (height, width) float each.
    through : Material, optional
        Transmittance of a thin sheet, as the diffuse reflectance of a material without gloss and with maps of the same
        size: the share of the light on one side that leaves the other side evenly diffuse.
    back : Material, optional
        Material of a sheet's back, as seen when it lies face up; by default that of the front. With neither ``through``
        nor ``back`` the material is not that of a sheet, and the surface is black from behind.
    transmittance : str
        Where the transmittance of a material's file is from: ``measured`` or ``assumed``.
    coat : str
        ``sum``, or ``coupled`` if the coat reduces the diffuse term, see `irodori.reflection.coat`.

    Raises
    ------
    ValueError
        For an unknown lobe or coat, or if ``further_gloss`` or ``typical_gloss`` does not fit the number of ``lobes``.
    """

    alpha: np.ndarray
    beta: np.ndarray
    mu: np.ndarray
    green_response: np.ndarray
    coefficients: np.ndarray
    basis: np.ndarray
    n: np.ndarray
    k: np.ndarray
    mirror: float
    typical_gloss: tuple[float, ...]
    extra: dict = field(default_factory=dict)
    lobes: tuple[str, ...] = DEFAULT_LOBES
    further_gloss: tuple[tuple[np.ndarray, np.ndarray], ...] = ()
    through: "Material | None" = None
    back: "Material | None" = None
    transmittance: str = ""
    coat: str = SUM

    def __post_init__(self) -> None:
        if self.coat not in COATS:
            raise ValueError(f"the coat {self.coat!r}; accepted: {', '.join(COATS)}")
        for name in self.lobes:
            lobe(name)
        for what, count in (("maps", 1 + len(self.further_gloss)), ("typical gloss", len(self.typical_gloss) / 2)):
            if count != len(self.lobes):
                raise ValueError(f"{what} of {count:g} gloss components; accepted: {len(self.lobes)}, one a lobe")

    @classmethod
    def uniform(
        cls,
        reflectance,
        beta: float = 0.0,
        mu: float = 0.1,
        mirror: float = 0.0,
        *,
        n=1.5,
        k=0.0,
        lobes: tuple[str, ...] = DEFAULT_LOBES,
        further_gloss: tuple[tuple[float, float], ...] = (),
        transmittance=None,
        coat: str = SUM,
    ) -> "Material":
        """Return a material with the same parameters in every texel.

        Parameters
        ----------
        reflectance : float or (61,) float
            Absolute reflectance factor α S / S_G of the diffuse term.
        beta, mu, mirror : float
            Weight of the first gloss component and its roughness in the unit of its lobe, weight of the mirror term.
        n, k : float or (61,) float
            Complex refractive index.
        lobes : tuple of str
            Lobe of each gloss component.
        further_gloss : tuple of (beta, mu)
            Parameters of the components after the first, a pair of float each.
        transmittance : float or (61,) float, optional
            Transmittance of a thin sheet, even 0; a surface without one is black from behind.
        coat : str
            See `Material`.
        """
        one = np.ones((2, 2))
        spectrum, n, k = (np.broadcast_to(np.asarray(v, dtype=np.float64), SAMPLES).copy() for v in (reflectance, n, k))
        coefficients = np.ones((2, 2, 1), dtype=np.float32)
        return cls(
            alpha=one,
            beta=beta * one,
            mu=mu * one,
            green_response=one,
            coefficients=coefficients,
            basis=spectrum[:, None],
            n=n,
            k=k,
            mirror=mirror,
            typical_gloss=(beta, mu, *(value for pair in further_gloss for value in pair)),
            lobes=tuple(lobes),
            further_gloss=tuple((b * one, m * one) for b, m in further_gloss),
            through=None if transmittance is None else cls.uniform(transmittance),
            coat=coat,
        )

    @classmethod
    def diffuse(cls, coefficients: np.ndarray, basis: np.ndarray) -> "Material":
        """Return a material without gloss from its reflectance: coefficients (height, width, k) on a basis, (61, k)."""
        one = np.ones(coefficients.shape[:2])
        n, k, nothing = np.full(SAMPLES, 1.5), np.zeros(SAMPLES), np.zeros_like(one)
        return cls(one, nothing, 0.1 * one, one, coefficients, basis, n, k, 0.0, (0.0, 0.1))

    def save(
        self,
        path,
        provenance: store.Provenance,
        errors: dict | None = None,
        *,
        storage: str = "single",
    ) -> None:
        """Write ``material.h5``, with ``errors`` as an attribute.

        ``storage`` is as in `irodori.material.coefficients.write_coefficients`.
        """
        with store.create(path, provenance) as out:
            maps = {name: (getattr(self, name), units, what) for name, (units, what) in MAPS.items()}
            for component, (_, beta, mu) in enumerate(self.gloss):
                described = [gloss_maps(self.lobes)[name] for name in gloss_names(component)]
                pairs = zip(gloss_names(component), (beta, mu), described, strict=True)
                maps |= {name: (values, *what) for name, values, what in pairs}
            store.write_maps(out, maps | self.extra, "row,column")
            write_coefficients(
                out,
                COEFFICIENTS,
                self.coefficients,
                quantity=QUANTITY,
                storage=storage,
                codec="gzip",
                basis=BASIS,
            )
            if self.through is not None:
                write_coefficients(
                    out,
                    SENT_COEFFICIENTS,
                    self.through.coefficients,
                    quantity=SENT,
                    storage=storage,
                    codec="gzip",
                    basis=SENT_BASIS,
                    dims="row,column,part",
                )
                write_sent_basis(out, self.through.basis, self.transmittance)
            constants = (self.basis, self.n, self.k, self.mirror)
            write_constants(out, *constants, errors, lobes=self.lobes, typical_gloss=self.typical_gloss, coat=self.coat)

    @classmethod
    def load(cls, path) -> "Material":
        """Read ``material.h5``.

        Raises
        ------
        InputError
            If the file is no material or damaged, its datasets do not fit together, a lobe is not registered, the basis
            is not finite, the refractive index is outside the range of real materials, or the surface reflects more
            light than falls on it.
        """
        axes = {
            COEFFICIENTS: "row,column,component",
            BASIS: "wavelength,component",
            "refractive_index/n": "wavelength",
            "refractive_index/k": "wavelength",
        }
        with store.open_file(path) as file:
            lobes = read_lobes(file)
            named = [*MAPS, *gloss_maps(lobes), *(name for name in (_ERROR,) if name in file)]
            is_sheet = SENT_BASIS in file
            if is_sheet:
                axes |= {SENT_COEFFICIENTS: "row,column,part", SENT_BASIS: "wavelength,part"}
            file.require_axes(dict.fromkeys(named, "row,column") | axes, wavelength=SAMPLES)
            typical = file.attribute("typical_gloss", list)
            if len(typical) != 2 * len(lobes):
                raise InputError(path, "typical_gloss", f"{len(typical)} numbers", f"{2 * len(lobes)}: β and μ a lobe")
            further = [gloss_names(component) for component in range(1, len(lobes))]
            found = cls(
                alpha=file.read("alpha"),
                beta=file.read("beta"),
                mu=file.read("mu"),
                green_response=file.read("green_response"),
                coefficients=read_coefficients(file, COEFFICIENTS),
                basis=file.read_within(BASIS),
                n=file.read_within("refractive_index/n", LEAST_N, MOST_N),
                k=file.read_within("refractive_index/k", 0.0, MOST_K),
                mirror=file.attribute("mirror", (float, int)),
                typical_gloss=tuple(typical),
                lobes=lobes,
                further_gloss=tuple((file.read(beta), file.read(mu)) for beta, mu in further),
                through=cls.diffuse(read_coefficients(file, SENT_COEFFICIENTS), file.read_within(SENT_BASIS))
                if is_sheet
                else None,
                transmittance=file.attribute("transmittance", str) if is_sheet else "",
                coat=read_coat(file),
            )
            error = file.read(_ERROR) if _ERROR in file else np.zeros(found.alpha.shape)
            found._check_reflectance(error, path)
        return found

    def _check_reflectance(self, error: np.ndarray, path) -> None:
        """Raise an error if the median texel reflects more light than falls on it by more than its standard deviation.

        Parameters
        ----------
        error : (height, width) float
            Standard deviation of the reflectance factor.
        path : path
            For the error message.
        """
        step = 1 + max(self.alpha.shape) // _LOOKED_AT
        some = np.s_[::step, ::step]
        mean, error = self.coefficients[some] @ self.basis.mean(axis=0), error[some]
        known = np.isfinite(self.alpha[some]) & np.isfinite(mean) & np.isfinite(error)
        if not known.any():
            return
        reflectance, allowed = float(np.median(mean[known])), REFLECTANCE[1] + float(np.median(error[known]))
        if reflectance > allowed:
            found = f"a reflectance factor of {reflectance:.3g}, the median of its texels"
            accepted = f"up to {allowed:.3g}: {REFLECTANCE[1]:g}, as of a table, and its standard deviation"
            raise InputError(path, COEFFICIENTS, found, accepted)

    @property
    def gloss(self) -> list[tuple[str, np.ndarray, np.ndarray]]:
        """Lobe, map of β and map of μ of every gloss component."""
        return [(n, *pair) for n, pair in zip(self.lobes, [(self.beta, self.mu), *self.further_gloss], strict=True)]

    def with_gloss(self, pairs) -> "Material":
        """Return a copy with other maps (β, μ), one pair for each gloss component."""
        (beta, mu), *further = pairs
        return replace(self, beta=beta, mu=mu, further_gloss=tuple(further))

    def rows(self, part: slice) -> "Material":
        """Return some rows of the maps as a material; its maps are views, nothing is copied."""
        return self._at(part)

    @property
    def is_sheet(self) -> bool:
        """Whether both sides of the surface are seen."""
        return self.through is not None or self.back is not None

    def mirrored(self) -> "Material":
        """Return the material with its maps mirrored from left to right."""
        return self._at(np.s_[:, ::-1])

    def resized(self, size: tuple[int, int]) -> "Material":
        """Return the material with (height, width) other texels, each the nearest of its own."""
        rows, columns = (
            ((np.arange(n) + 0.5) * old / n).astype(int) for n, old in zip(size, self.alpha.shape, strict=True)
        )
        return self._at(np.ix_(rows, columns))

    def _at(self, texels) -> "Material":
        gloss = [(beta[texels], mu[texels]) for _, beta, mu in self.gloss]
        maps = {name: getattr(self, name)[texels] for name in (*MAPS, "coefficients")}
        through = None if self.through is None else self.through._at(texels)
        extra = {name: (values[texels], *about) for name, (values, *about) in self.extra.items()}
        return replace(self.with_gloss(gloss), **maps, through=through, extra=extra)

    @property
    def observed(self) -> np.ndarray:
        """Mask of the texels with a diffuse reflectance from their own observations, (height, width) bool."""
        finite = np.isfinite(self.alpha) & np.isfinite(self.coefficients).all(axis=-1)
        return finite & np.isfinite(self.green_response)

    @property
    def spectrum_scale(self) -> np.ndarray:
        """Factor α / S_G by which rendering multiplies S(λ), (height, width); 1 where S_G is too dark to divide by."""
        return spectrum_scale(self.alpha, self.green_response)

    def typically_filled(self) -> list[tuple[str, np.ndarray, np.ndarray]]:
        """Return lobe, β and μ of every gloss component; where gloss is unknown, it is the object's typical gloss."""
        return typically_filled(self.lobes, [(beta, mu) for _, beta, mu in self.gloss], self.typical_gloss)

    def filled(self, covered: np.ndarray | None = None) -> tuple["Material", float]:
        """Return a copy without gaps, and the share of texels that were filled.

        A texel that no capture determined takes colour and gloss of the nearest observed texel (the left and right
        sides of the texture are joined). Gloss that is not known there either is the object's typical gloss. If a
        material has several components, one with β = 0 in a texel keeps β = 0.

        Parameters
        ----------
        covered : (height, width) bool, optional
            Mask of the texels that lie on the surface; all by default. The others are filled too, from the nearest
            texel of the surface, but are not counted in the share.
        """
        gap, origin, share = self.gaps(covered)

        def patched(values: np.ndarray) -> np.ndarray:
            out = values.reshape(-1, *values.shape[2:]).copy()
            out[gap] = out[origin]
            return out.reshape(values.shape)

        pairs = [(patched(beta), patched(mu)) for _, beta, mu in self.typically_filled()]
        maps: dict[str, Any] = {name: patched(getattr(self, name)) for name in (*MAPS, "coefficients")}
        return replace(self.with_gloss(pairs), **maps), share

    def gaps(self, covered: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray, float]:
        """Return the texels that `filled` fills and those that they take their values from; arguments as there.

        Returns
        -------
        gap, origin : (m,) int
            Indices into the flattened maps.
        share : float
            Share of the texels on the surface that are filled.

        Raises
        ------
        ValueError
            If no texel on the surface was observed.
        """
        observed = self.observed
        if covered is None or covered.all():
            covered = np.ones(observed.shape, dtype=bool)
        observed &= covered
        if not observed.any():
            raise ValueError("a material without a single observed texel; accepted: at least one")
        share = float(1.0 - observed[covered].mean())
        gap = np.flatnonzero(~observed)
        if not gap.size:
            return gap, gap, share
        width = observed.shape[1]
        beside = (width + 1) // 2  # nothing is farther away around the texture than this
        origin = _nearest(
            np.concatenate([observed[:, -beside:], observed, observed[:, :beside]], axis=1), beside, width
        )
        if not covered.all():
            outside = np.flatnonzero(~covered)
            on_surface = _nearest(covered, 0, width)[outside]
            origin[outside] = origin[on_surface]
        return gap, origin[gap], share

    def spectra(self) -> np.ndarray:
        """Return S(λ) of every texel, (height, width, 61)."""
        return self.coefficients @ self.basis.T


def _nearest(chosen: np.ndarray, skipped: int, width: int) -> np.ndarray:
    """Return the flat index of the chosen texel nearest to each texel; the texture begins after ``skipped`` columns."""
    from scipy import ndimage  # slow to import

    places = ndimage.distance_transform_edt(~chosen, return_distances=False, return_indices=True)
    row, column = places[:, :, skipped : skipped + width]
    return (row.astype(np.int64) * width + (column - skipped) % width).ravel()


def spectrum_scale(alpha: np.ndarray, green_response: np.ndarray) -> np.ndarray:
    """Return α / S_G, 1 where S_G is too dark to divide by."""
    return np.divide(alpha, green_response, out=np.ones_like(alpha), where=green_response > _DARKEST_GREEN)


def typically_filled(lobes, gloss, typical_gloss) -> list[tuple[str, np.ndarray, np.ndarray]]:
    """Return lobe, β and μ of every gloss component; unknown values are replaced by typical ones.

    If there are several components, one with β = 0 in a texel keeps β = 0.

    Parameters
    ----------
    lobes : sequence of str
    gloss : sequence of (beta, mu)
        Maps of the components, (...) float each.
    typical_gloss : sequence of float
        β and μ of each component.
    """
    found = []
    typical = zip(typical_gloss[::2], typical_gloss[1::2], strict=True)
    for name, (beta, mu), (usual_beta, usual_mu) in zip(lobes, gloss, typical, strict=True):
        known = np.isfinite(beta) & np.isfinite(mu)
        # A component that is absent from a texel has no roughness, but its weight is known: 0.
        weighed = known | (beta == 0.0) if len(lobes) > 1 else known
        found.append((name, np.where(weighed, beta, usual_beta), np.where(known, mu, usual_mu)))
    return found


def write_sent_basis(out: store.Writer, basis: np.ndarray, source: str) -> None:
    """Write the basis of a sheet's transmittance, (61, k), and whether it is ``measured`` or ``assumed``."""
    quantity = "spectral basis of the transmittance"
    out.write(SENT_BASIS, basis, units="1", dims="wavelength,part", quantity=quantity)
    out.attribute("transmittance", source)


def write_constants(
    out: store.Writer,
    basis,
    n,
    k,
    mirror: float,
    errors: dict | None,
    *,
    lobes: tuple[str, ...],
    typical_gloss: tuple[float, ...],
    coat: str,
) -> None:
    """Write basis, refractive index, mirror weight, lobes, coat, typical gloss and errors to an open file."""
    write_wavelength(out)
    out.write(BASIS, basis, units="1", dims="wavelength,component", quantity="spectral basis")
    names = {"units": "1", "dims": "wavelength", "quantity": "complex refractive index n + ik"}
    for name, values in (("n", n), ("k", k)):
        out.write(f"refractive_index/{name}", values, **names)
    out.attribute("mirror", mirror)
    out.attribute("lobes", list(lobes))
    out.attribute("coat", coat)
    out.attribute("typical_gloss", list(typical_gloss))
    out.attribute("errors", errors or {})
