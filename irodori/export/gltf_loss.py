"""Colour differences between the materials of a glTF file and the materials from which they were made.

The numbers and pictures of the file are read back, and its reflection is evaluated as the glTF specification defines it
(`irodori.export.gltf_reflection`). The directions differ from those of the refit, so that the refit is judged on new
ones. Differences are CIEDE2000 for an observer adapted to the light, with a perfect diffuser facing the light as white:

* *lamp*: a single lamp and the observer in directions spread evenly over the hemisphere;
* *highlight*: the same with half vectors about the normal, where the gloss is;
* *even light*: the same radiance from all directions, at several angles of the observer, with the mirror term;
* *spectra under D65*: the diffuse spectra under ``extras``, as colours under D65.
"""

import base64
import io
import json
import struct
import zlib
from pathlib import Path

import numpy as np
from PIL import Image

from irodori.colour.colorimetry import xyz_from_reflectance
from irodori.colour.display import srgb
from irodori.colour.tone_curves import SRGB
from irodori.core.errors import InputError
from irodori.export.diffuse_picture import colours_from_bands, diffuse_colours
from irodori.export.export_sources import Item
from irodori.export.gltf_refit import Texel, about_highlight, everywhere, fresnel_colours, gloss_reach, rough_terms
from irodori.export.gltf_reflection import GltfSurface, mirrored, reflected
from irodori.export.loss import Loss, differences, stored_loss
from irodori.reflection.equation5 import angles_from_directions

LAMP, HIGHLIGHT, EVEN = "lamp", "highlight", "even light"
#: The spectra of the diffuse colour under ``extras``, seen under D65.
SPECTRA = "spectra under D65"
ZLIB_URI = "data:application/zlib;base64,"
#: Number of texels, and of pairs of directions, at which colours are compared.
_TEXELS, _PAIRS = 256, 64
_START = 0.3172  # start of the sequence of directions, different from that of the refit
_EVEN_DEG = (0.0, 20.0, 40.0, 60.0, 75.0)
_NODES, _TURNS = 48, 48


def kinds_of_light() -> tuple[str, ...]:
    """Return the names of the kinds of light under which materials are compared."""
    return LAMP, HIGHLIGHT, EVEN


class ParsedGltf:
    """A glTF document and its buffer, with access to the materials of files that this package wrote.

    Parameters
    ----------
    content : dict
        The document, parsed JSON.
    data : bytes
        The binary buffer.
    """

    def __init__(self, content: dict, data: bytes) -> None:
        self.content, self.data = content, data
        self._pictures: dict[int, np.ndarray] = {}

    @classmethod
    def load(cls, path) -> "ParsedGltf":
        """Read a GLB file.

        Raises
        ------
        InputError
            If the file is not a binary glTF file.
        """
        content = Path(path).read_bytes()
        if content[:4] != b"glTF" or len(content) < 28:
            raise InputError(path, "", "no binary glTF", "a .glb file that irodori wrote")
        (size,) = struct.unpack("<I", content[12:16])
        return cls(json.loads(content[20 : 20 + size]), content[28 + size :])

    def texture(self, reference: dict) -> np.ndarray:
        """Return the picture of a referenced texture, (height, width, channels) float64, code values 0..1."""
        number = self.content["textures"][reference["index"]]["source"]
        if number not in self._pictures:
            view = self.content["bufferViews"][self.content["images"][number]["bufferView"]]
            part = self.data[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]
            with Image.open(io.BytesIO(part)) as picture:
                self._pictures[number] = np.asarray(picture, dtype=np.float64) / 255.0
        return self._pictures[number]

    def spectra(self, number: int) -> np.ndarray:
        """Return the diffuse reflectance factor of a mesh from its ``extras``, (height, width, 61) float64."""
        stored = self.content["meshes"][number]["extras"]["irodori"]["spectra"]
        packed = stored["coefficients"]
        numbers = np.frombuffer(zlib.decompress(base64.b64decode(packed["uri"].removeprefix(ZLIB_URI))), "<f2")
        coefficients = numbers.reshape(packed["shape"]).astype(np.float64) * np.array(packed["scale"])
        return coefficients @ np.array(stored["basis"])

    def surface(self, number: int, rows: np.ndarray, columns: np.ndarray) -> GltfSurface:
        """Return the parameters of material ``number`` at the c texels with the given rows and columns, (c,) each."""
        material = self.content["materials"][number]
        rough, extensions = material["pbrMetallicRoughness"], material["extensions"]
        specular = extensions["KHR_materials_specular"]
        ior = extensions["KHR_materials_ior"]["ior"]
        base = SRGB.linear(self.texture(rough["baseColorTexture"])[rows, columns])
        roughness = rough["roughnessFactor"] * self.texture(rough["metallicRoughnessTexture"])[rows, columns, 1]
        weight = specular["specularFactor"] * self.texture(specular["specularTexture"])[rows, columns, 3]
        colour = np.array(specular.get("specularColorFactor", [1.0, 1.0, 1.0]))
        f0 = np.minimum(((ior - 1.0) / (ior + 1.0)) ** 2 * colour, 1.0)
        coat = extensions.get("KHR_materials_clearcoat", {}).get("clearcoatFactor", 0.0)
        return GltfSurface.of(base, weight, f0, roughness**2, coat)


def _along(surface: GltfSurface) -> GltfSurface:
    """Insert an axis for pairs of directions after the first axis of the parameters."""
    return GltfSurface(surface.base[:, None], surface.weight[:, None], surface.f0, surface.alpha[:, None], surface.coat)


def _half_vectors(theta_r: float, scale: float) -> tuple[np.ndarray, np.ndarray]:
    """Return quadrature nodes for light from all directions: angles (n, 4) in rad, and solid angles (n,) in sr.

    The nodes are placed by their half vectors, more densely near the normal.

    Parameters
    ----------
    theta_r : float
        Angle of the observer from the normal, rad.
    scale : float
        Angle from the normal within which the half vectors are densest, rad.
    """
    node, weight = np.polynomial.legendre.leggauss(_NODES)
    most = np.arcsinh(0.5 * np.pi / scale)
    t = 0.5 * most * (node + 1.0)
    phi, step = scale * np.sinh(t), 0.5 * most * weight * scale * np.cosh(t)
    turn = 2.0 * np.pi * (np.arange(_TURNS) + 0.5) / _TURNS
    eye = np.array([np.sin(theta_r), 0.0, np.cos(theta_r)])
    half = np.stack([np.outer(np.sin(phi), np.cos(turn)), np.outer(np.sin(phi), np.sin(turn)),
                     np.outer(np.cos(phi), np.ones(_TURNS))], axis=-1).reshape(-1, 3)  # fmt: skip
    cosine = half @ eye
    light = 2.0 * cosine[:, None] * half - eye
    solid = (np.sin(phi) * step)[:, None] * np.full(_TURNS, 2.0 * np.pi / _TURNS)
    solid = solid.ravel() * 4.0 * np.maximum(cosine, 0.0)
    seen = (light[:, 2] > 1e-6) & (cosine > 1e-6)
    return angles_from_directions(np.array([0.0, 0.0, 1.0]), light[seen], eye), solid[seen]


def judge(item: Item, parsed: ParsedGltf, number: int, illuminant: str) -> dict[str, np.ndarray]:
    """Return CIEDE2000 between the material of an object and a material of a glTF file, for each kind of light.

    Each array is (texels, pairs of directions), or (texels, angles of the observer) for even light.


    Parameters
    ----------
    item : Item
    parsed : ParsedGltf
    number : int
        Index of the material in the file.
    illuminant : str
        Light of the variant.
    """
    material, matrix = item.material, colours_from_bands(illuminant)
    place = np.flatnonzero(item.observed.ravel())
    place = place[:: max(1, len(place) // _TEXELS)]
    rows, columns = np.unravel_index(place, item.observed.shape)
    gloss = [(name, beta[rows, columns], mu[rows, columns]) for name, beta, mu in material.gloss]
    texel = Texel(diffuse_colours(material, matrix)[rows, columns], gloss)
    surface, fresnel = parsed.surface(number, rows, columns), fresnel_colours(material, matrix)
    found = {}
    near = about_highlight(gloss_reach(gloss, _PAIRS), _START)
    for kind, geometry in ((LAMP, everywhere(_PAIRS, _START)[None]), (HIGHLIGHT, near)):
        seen = ~np.isnan(geometry[..., 0])
        geometry = np.where(seen[..., None], geometry, 0.1)
        ours, theirs = rough_terms(texel, fresnel, geometry), reflected(_along(surface), geometry)
        found[kind] = np.where(seen, differences(srgb(), ours, theirs), np.nan)
    found[EVEN] = _under_even_light(texel, fresnel, material.mirror, surface)
    return found


def judge_spectra(item: Item, spectra: np.ndarray) -> Loss:
    """Return the loss of the diffuse spectra in a file, (height, width, 61), over the texels with data."""
    material, matrix = item.material, xyz_from_reflectance("D65")
    scale = np.where(item.observed, material.spectrum_scale, np.nan)

    def exact(part: slice) -> np.ndarray:
        coefficients = material.coefficients[part].astype(np.float64) * scale[part, :, None]
        return coefficients @ material.basis.astype(np.float64).T

    return stored_loss(matrix, matrix.sum(axis=1), exact, spectra.__getitem__, len(spectra))


def _under_even_light(texel: Texel, fresnel, mirror: float, surface: GltfSurface) -> np.ndarray:
    """Return CIEDE2000 under the same radiance from all directions, (texels, angles of the observer)."""
    # Both models are linear in the diffuse colour: all texels with the same gloss share their integrals.
    parameters = [part for _, *pair in texel.gloss for part in pair]
    table = np.column_stack([*parameters, surface.weight, surface.alpha]).round(5)
    _, first, which = np.unique(table, axis=0, return_index=True, return_inverse=True)
    which, columns = which.ravel(), []
    for theta_r in np.radians(_EVEN_DEG):
        values = np.empty((2, 2, len(first), 3))  # our model and the file's, over a black and over a white base
        for kind, at in enumerate(first):
            gloss = [(name, beta[at : at + 1], mu[at : at + 1]) for name, beta, mu in texel.gloss]
            alpha = float(surface.alpha[at])
            widths = [float(mu[0]) for _, beta, mu in gloss if beta[0] > 0.0] + ([alpha] if alpha > 0.0 else [])
            geometry, solid = _half_vectors(theta_r, max(min(widths, default=0.5), 1e-3))
            for colour in (0, 1):
                body = Texel(np.full((1, 3), float(colour)), gloss)
                own = GltfSurface.of([colour] * 3, surface.weight[at], surface.f0, alpha, surface.coat)
                values[0, colour, kind] = solid @ rough_terms(body, fresnel, geometry[None])[0] / np.pi
                values[1, colour, kind] = solid @ reflected(own, geometry) / np.pi
        over = (texel.diffuse, surface.base)
        seen = [black[which] + (white - black)[which] * colour
                for (black, white), colour in zip(values, over, strict=True)]  # fmt: skip
        angle = np.full(len(which), theta_r)
        columns.append(
            differences(srgb(), seen[0] + mirror * fresnel(np.cos(angle)), seen[1] + mirrored(surface, angle))
        )
    return np.stack(columns, axis=1)
