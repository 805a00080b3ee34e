"""Surfaces of several lobes, one from outside the package among them, in scenes that share one loop."""

import dataclasses

import numpy as np
import toy_lobe
from scenes import BALL, material

from irodori.material.material_file import Material
from irodori.reflection.lobe import Lobe
from irodori.reflection.registry import register

register(Lobe.of_module(toy_lobe))


def surface(components, n=1.5, k=0.0, reflectance=0.0) -> Material:
    """A uniform material of several gloss components."""
    (_, beta, mu), *further = components
    one = material(reflectance, beta=beta, mu=mu, n=n, k=k)
    maps = tuple((np.full(one.beta.shape, b), np.full(one.mu.shape, m)) for _, b, m in further)
    typical = tuple(value for _, b, m in components for value in (b, m))
    return dataclasses.replace(one, lobes=tuple(c[0] for c in components), further_gloss=maps, typical_gloss=typical)


#: Loops are compiled for the lobes of a scene and for how many a surface has: beside a ball of all three, scenes share
#: one loop of each integrator.
MIXED = surface([(name, 1.0, 0.1) for name in ("gaussian", "ggx", "toy")])


def beside(shape, own: Material) -> list[list]:
    """Return shapes, materials and places of a ball of all lobes out of sight and of one surface in the origin."""
    scene = [(BALL, MIXED, (0.0, 0.0, -2000.0)), (shape, own, (0.0, 0.0, 0.0))]
    return [list(column) for column in zip(*scene, strict=True)]
