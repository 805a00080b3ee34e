"""Materials of the virtual samples: measured spectra and reflection parameters."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from irodori.config.models import (
    ChecksPattern,
    FurtherGloss,
    MeasuredMaterial,
    ModelledMaterial,
    Object,
    TrueMaterial,
)
from irodori.config.parts import PhotographedObject, TrueObject
from irodori.geometry.shapes.shape import Shape
from irodori.reflection.coat import COUPLED
from irodori.reflection.fresnel import fresnel
from irodori.simulation.virtual_rig.sample_reflection import measured_lobe, read_measured
from irodori.spectra.grid import SAMPLES
from irodori.spectra.published import refractive_index, spectrum

_FRESNEL_NODES = 512


@dataclass(frozen=True)
class Sample:
    """Ground truth of an object on the virtual rig: its shape, its pattern and its materials.

    Parameters
    ----------
    shape : Shape
    columns, rows : int
        Number of checks of the pattern across and down the texture; 1 for a uniform sample.
    reflectance : (m, 61) float
        S(λ) of each material; for a measured one, its reflectance factor lit at 45 degrees and seen from above.
    lobes : tuple of tuple of str
        For each material, the lobe of each gloss component; empty for a measured material.
    beta : (m, components) float
        Weight of each component.
    mu : (m, components) float
        Roughness of each component, in the unit of the lobe.
    table : (m,) int
        Index of a measured material's table, -1 for the others.
    measured : (tables, half nodes, difference nodes, 61) float
        π times the BRDF of measured materials; one table of zeros if there is none.
    mirror : float
        Weight χ of the mirror term.
    n, k : (61,) float
        Complex refractive index.
    through : (m, 61) float
        Transmittance of each material.
    is_coupled : bool
        Whether the coat reduces the diffuse term, see `irodori.reflection.coat`.
    """

    shape: Shape
    columns: int
    rows: int
    reflectance: np.ndarray
    lobes: tuple[tuple[str, ...], ...]
    beta: np.ndarray
    mu: np.ndarray
    table: np.ndarray
    measured: np.ndarray
    mirror: float
    n: np.ndarray
    k: np.ndarray
    through: np.ndarray
    is_coupled: bool = False

    @classmethod
    def from_definition(cls, definition: Object | PhotographedObject | TrueObject) -> "Sample":
        """Return the sample that the ``virtual`` block of an object's definition describes."""
        virtual = definition.virtual
        if virtual is None:
            raise ValueError("an object without the block virtual; accepted: an object of the virtual rig")
        pattern, materials = virtual.pattern, virtual.materials
        n, k = refractive_index(definition.refractive_index)
        columns, rows = (pattern.columns, pattern.rows) if isinstance(pattern, ChecksPattern) else (1, 1)
        files = sorted({m.file for m in materials if isinstance(m, MeasuredMaterial)})
        tables = [read_measured(file) for file in files]
        gloss = [_components(material) for material in materials]
        most = max(1, *map(len, gloss))
        beta, mu = np.zeros((len(gloss), most)), np.ones((len(gloss), most))
        for m, components in enumerate(gloss):
            for c, component in enumerate(components):
                beta[m, c], mu[m, c] = component.beta, component.mu_rad
        return cls(
            shape=Shape.from_definition(definition.shape),
            columns=columns,
            rows=rows,
            reflectance=np.stack(
                [
                    _reflectance_factor(tables[files.index(m.file)])
                    if isinstance(m, MeasuredMaterial)
                    else spectrum(m.spectrum)
                    for m in materials
                ]
            ),
            lobes=tuple(tuple(c.lobe for c in components) for components in gloss),
            beta=beta,
            mu=mu,
            table=np.array([files.index(m.file) if isinstance(m, MeasuredMaterial) else -1 for m in materials]),
            measured=np.stack(tables) if tables else np.zeros((1, 2, 2, SAMPLES)),
            mirror=definition.mirror_weight,
            n=n,
            k=k,
            through=np.stack([_transmittance(material) for material in materials]),
            is_coupled=virtual.coat == COUPLED,
        )

    @cached_property
    def fresnel(self) -> np.ndarray:
        """Fresnel reflectance over the cosine of the angle of incidence, equally spaced from 0 to 1, (nodes, 61)."""
        cosines = np.linspace(0.0, 1.0, _FRESNEL_NODES)
        return np.array([[fresnel(c, n, k) for n, k in zip(self.n, self.k, strict=True)] for c in cosines])

    def material_index(self, width: int, height: int) -> np.ndarray:
        """Return the index of the material at each texel centre, (height, width) int."""
        column = np.floor((np.arange(width) + 0.5) / width * self.columns).astype(int)
        row = np.floor((np.arange(height) + 0.5) / height * self.rows).astype(int)
        return (row[:, None] * self.columns + column[None, :]) % len(self.reflectance)


def _components(material: TrueMaterial) -> list[ModelledMaterial | FurtherGloss]:
    """Return the gloss components of a virtual material's definition: ``lobe``, ``beta`` and ``mu_rad`` of each."""
    return [] if isinstance(material, MeasuredMaterial) else [material, *material.further_gloss]


def _transmittance(material: TrueMaterial) -> np.ndarray:
    sent = 0.0 if isinstance(material, MeasuredMaterial) else material.transmittance
    return spectrum(sent) if isinstance(sent, str) else np.full(SAMPLES, float(sent))


def _reflectance_factor(table: np.ndarray) -> np.ndarray:
    """Return the reflectance factor of a measured material in the geometry 45:0, (61,)."""
    half = math.cos(math.radians(22.5))
    return np.array([measured_lobe(table, half, half, band) for band in range(SAMPLES)])
