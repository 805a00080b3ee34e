"""glTF 2.0 files (GLB) of an object or a scene: shapes, textures, and one material variant for each illuminant.

The rough gloss is one GGX lobe (`irodori.export.gltf_refit`). The mirror term uses the extension for a clear coat. Data
that glTF cannot represent are stored under ``extras``: the diffuse spectra of every texel, the path and hash of the
material's file, and the loss.

Lengths are in metres and y is up, as glTF requires; the objects themselves stay in mm below a node that rotates and
scales them. Light is left out: glTF has no spectral light, and viewers have their own.
"""

import base64
import hashlib
import io
import json
import struct
import zlib
from collections.abc import Sequence

import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation

from irodori import __version__
from irodori.colour.colorimetry import xyz_from_reflectance
from irodori.colour.tone_curves import SRGB
from irodori.core.atomic_files import written_whole
from irodori.core.errors import PlainError
from irodori.export.diffuse_picture import colours_from_bands, diffuse_colours
from irodori.export.export_sources import Item, Source
from irodori.export.gltf_loss import SPECTRA, ZLIB_URI, ParsedGltf, judge, judge_spectra, kinds_of_light
from irodori.export.gltf_refit import Refit, fresnel_colours, refit
from irodori.export.loss import Loss
from irodori.geometry.mesh import Mesh
from irodori.geometry.rig_frame import look_at
from irodori.geometry.shapes.placement import reaches
from irodori.jit.half_precision import half_from_single
from irodori.material.coefficients import scale_of
from irodori.reflection.coat import SUM
from irodori.spectra.grid import WAVELENGTH_NM

#: Default illuminants of the variants; a viewer without support for variants shows the first.
ILLUMINANTS = ("D65", "A", "FL11")
EXTENSIONS = ("KHR_materials_clearcoat", "KHR_materials_ior", "KHR_materials_specular", "KHR_materials_variants")
_M_PER_MM = 0.001
#: The index that replaces one that glTF viewers do not support: complex, varying with wavelength, or out of 1 to 2.333.
_USUAL_INDEX, _HIGHEST_INDEX = 1.5, 2.333
_FLOAT, _UINT = 5126, 5125
_ARRAY, _ELEMENTS = 34962, 34963
_LINEAR, _REPEAT, _CLAMP = 9729, 10497, 33071


class _Buffer:
    """The binary buffer of a GLB file, with the tables of buffer views, accessors and images that refer to it."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.views: list[dict] = []
        self.accessors: list[dict] = []
        self.images: list[dict] = []
        self._image_of: dict[bytes, int] = {}

    def _view(self, content: bytes, **more) -> int:
        self.data += b"\0" * (-len(self.data) % 4)
        self.views.append({"buffer": 0, "byteOffset": len(self.data), "byteLength": len(content), **more})
        self.data += content
        return len(self.views) - 1

    def numbers(self, values: np.ndarray, kind: str, component: int, target: int, bounds: bool = False) -> int:
        """Add an array; return the index of its accessor."""
        values = np.ascontiguousarray(values, dtype="<f4" if component == _FLOAT else "<u4")
        view = self._view(values.tobytes(), target=target)
        accessor = {"bufferView": view, "componentType": component, "count": len(values), "type": kind}
        if bounds:
            accessor |= {"min": values.min(axis=0).tolist(), "max": values.max(axis=0).tolist()}
        self.accessors.append(accessor)
        return len(self.accessors) - 1

    def image(self, pixels: np.ndarray, name: str) -> int:
        """Add an 8-bit picture as PNG, unless the same is there already; return its index."""
        content = io.BytesIO()
        Image.fromarray(np.ascontiguousarray(pixels)).save(content, "PNG")
        key = hashlib.sha256(content.getvalue()).digest()
        if key not in self._image_of:
            self._image_of[key] = len(self.images)
            view = self._view(content.getvalue())
            self.images.append({"bufferView": view, "mimeType": "image/png", "name": name})
        return self._image_of[key]


class _Document:
    """A glTF document under construction."""

    def __init__(self, illuminants: Sequence[str]) -> None:
        self.buffer, self.illuminants = _Buffer(), tuple(illuminants)
        self.json: dict = {name: [] for name in ("nodes", "meshes", "materials", "textures", "samplers")}

    def _add(self, table: str, entry: dict) -> int:
        if table in ("samplers", "textures") and entry in self.json[table]:
            return self.json[table].index(entry)
        self.json[table].append(entry)
        return len(self.json[table]) - 1

    def texture(self, pixels: np.ndarray, wraps: bool, name: str) -> dict:
        """Add a texture; return the reference by which a material uses it."""
        across = _REPEAT if wraps else _CLAMP
        sampler = {"magFilter": _LINEAR, "minFilter": _LINEAR, "wrapS": across, "wrapT": _CLAMP}
        entry = {"sampler": self._add("samplers", sampler), "source": self.buffer.image(pixels, name)}
        return {"index": self._add("textures", entry)}

    def mesh(self, mesh: Mesh, name: str, materials: list[int], extras: dict) -> int:
        """Add triangles with their materials, one for each variant; return the index of the mesh."""
        corners = np.concatenate([mesh.vertices_mm[mesh.faces], mesh.normals, mesh.uv], axis=-1).reshape(-1, 8)
        unique, index = np.unique(corners.astype(np.float32), axis=0, return_inverse=True)
        normals = unique[:, 3:6].astype(np.float64)
        add = self.buffer.numbers
        primitive = {
            "attributes": {
                "POSITION": add(unique[:, :3], "VEC3", _FLOAT, _ARRAY, bounds=True),
                "NORMAL": add(normals / np.linalg.norm(normals, axis=1, keepdims=True), "VEC3", _FLOAT, _ARRAY),
                "TEXCOORD_0": add(unique[:, 6:], "VEC2", _FLOAT, _ARRAY),
            },
            "indices": add(index.ravel(), "SCALAR", _UINT, _ELEMENTS),
            "material": materials[0],
            "extensions": {
                "KHR_materials_variants": {
                    "mappings": [{"material": number, "variants": [i]} for i, number in enumerate(materials)]
                }
            },
        }
        return self._add("meshes", {"name": name, "primitives": [primitive], "extras": {"irodori": extras}})

    def materials(self, item: Item, found: Refit) -> list[int]:
        """Add the materials of an object, one for each illuminant; return their indices."""
        shape, material = item.placement.shape, item.material
        roughness, weight = np.sqrt(found.alpha), found.weight
        most, heaviest = float(roughness.max()), float(weight.max())
        gloss = np.full((*weight.shape, 4), 255, dtype=np.uint8)
        gloss[..., 1], gloss[..., 3] = _eight_bits(roughness, most), _eight_bits(weight, heaviest)
        gloss[..., 2] = 0
        # glTF reads roughness from the green channel and the weight from alpha: one picture holds both.
        lobe = self.texture(gloss, shape.wraps, f"{item.name} gloss")
        index = float(material.n[0])
        plain = np.ptp(material.n) == 0.0 and not material.k.any() and 1.0 <= index <= _HIGHEST_INDEX
        ior = index if plain else _USUAL_INDEX
        numbers = []
        for illuminant in self.illuminants:
            matrix = colours_from_bands(illuminant)
            colour = diffuse_colours(material, matrix) * found.base[..., None]
            pixels = np.rint(255.0 * SRGB.code(np.clip(colour, 0.0, 1.0))).astype(np.uint8)
            specular = {"specularFactor": heaviest, "specularTexture": lobe}
            if not plain:
                f0 = np.maximum(fresnel_colours(material, matrix)(np.ones(1))[0], 0.0)
                specular["specularColorFactor"] = (f0 * ((ior + 1.0) / (ior - 1.0)) ** 2).tolist()
            extensions = {"KHR_materials_ior": {"ior": ior}, "KHR_materials_specular": specular}
            if found.coat > 0.0:
                extensions["KHR_materials_clearcoat"] = {"clearcoatFactor": found.coat, "clearcoatRoughnessFactor": 0.0}
            entry = {
                "name": f"{item.name} under {illuminant}",
                "pbrMetallicRoughness": {
                    "baseColorTexture": self.texture(pixels, shape.wraps, f"{item.name} {illuminant}"),
                    "metallicFactor": 0.0,
                    "roughnessFactor": most,
                    "metallicRoughnessTexture": lobe,
                },
                "extensions": extensions,
                "extras": {"irodori": {"illuminant": illuminant}},
            } | ({"doubleSided": True} if item.material.is_sheet else {})
            numbers.append(self._add("materials", entry))
        return numbers

    def whole(self, roots: list[int], cameras: list[dict], extras: dict) -> dict:
        """Assemble the glTF document as a JSON object.

        Parameters
        ----------
        roots : list of int
            Nodes of the scene.
        cameras : list of dict
        extras : dict
            Additional data about the whole file.
        """
        used = [name for name in EXTENSIONS if name in json.dumps([self.json["materials"], self.json["meshes"]])]
        content = {
            "asset": {"version": "2.0", "generator": f"irodori {__version__}", "extras": {"irodori": extras}},
            "extensionsUsed": used,
            "extensions": {"KHR_materials_variants": {"variants": [{"name": name} for name in self.illuminants]}},
            "scene": 0,
            "scenes": [{"nodes": roots}],
            **self.json,
            "images": self.buffer.images,
            "accessors": self.buffer.accessors,
            "bufferViews": self.buffer.views,
            "buffers": [{"byteLength": len(self.buffer.data)}],
        }
        return content | ({"cameras": cameras} if cameras else {})


def _eight_bits(values: np.ndarray, most: float) -> np.ndarray:
    return np.rint(values * (255.0 / most if most > 0.0 else 0.0)).astype(np.uint8)


def _spectra(item: Item) -> dict:
    """Return the diffuse reflectance of every texel of an object as a JSON object.

    The coefficients are half-precision numbers, compressed by zlib, in a data URI: programs that edit glTF files keep
    ``extras``, but drop parts of the buffer to which no other part of glTF refers.
    """
    basis = np.array([[float(f"{value:.6g}") for value in vector] for vector in item.material.basis.T])
    coefficients = (item.material.coefficients * item.material.spectrum_scale[..., None]).astype(np.float32)
    scale = scale_of(coefficients)
    packed = zlib.compress(half_from_single(coefficients / scale).astype("<f2").tobytes(), 9)
    known = {"file": item.file, "sha256": item.sha256} if item.file else {}
    return {
        "quantity": "diffuse reflectance factor: the sum over the basis of coefficient times scale times vector",
        "wavelength_nm": {"first": float(WAVELENGTH_NM[0]), "last": float(WAVELENGTH_NM[-1]), "count": 61},
        "basis": basis.tolist(),
        "coefficients": {
            "uri": ZLIB_URI + base64.b64encode(packed).decode("ascii"),
            "type": "little-endian half-precision numbers, packed by zlib",
            "shape": list(coefficients.shape),
            "axes": ["row of the texture from the top", "column from the left", "vector of the basis"],
            "scale": scale.tolist(),
        },
        "mean_coefficients": coefficients.mean(axis=(0, 1), dtype=np.float64).round(6).tolist(),
        **known,
    }


def _placed(item: Item, mesh: int) -> dict:
    place = item.placement
    return {
        "name": item.name,
        "mesh": mesh,
        "translation": [float(x) for x in place.translation_mm],
        "rotation": [float(x) for x in Rotation.from_matrix(place.rotation).as_quat()],
        "scale": [float(place.scale)] * 3,
    }


def _y_up(vectors: np.ndarray) -> np.ndarray:
    """Convert vectors (..., 3) from a frame with z up to a frame with y up."""
    return np.stack([vectors[..., 0], vectors[..., 2], -vectors[..., 1]], axis=-1)


def _cameras(source: Source) -> tuple[list[dict], list[dict]]:
    """Return the views of a scene as glTF cameras, and the nodes that place them, in the same order."""
    cameras: list[dict] = []
    nodes: list[dict] = []
    if source.scene is None:
        return cameras, nodes
    reach = float(max(reaches([item.placement for item in source.items])))
    for name, view in source.scene.views.items():
        aspect = source.scene.image.width / source.scene.image.height
        position = np.asarray(view.position_mm, dtype=np.float64)
        far = (float(np.linalg.norm(position - np.asarray(view.target_mm))) + 200.0 * reach) * _M_PER_MM
        near = 1e-4 * far
        if view.kind == "orthographic":
            half = 0.5 * view.height_mm * _M_PER_MM
            lens: dict = {"type": "orthographic", "orthographic": {"xmag": half * aspect, "ymag": half}}
        else:
            lens = {"type": "perspective", "perspective": {"yfov": float(np.radians(view.field_of_view_deg)),
                                                           "aspectRatio": aspect}}  # fmt: skip
        lens[view.kind] |= {"znear": near, "zfar": far}
        # glTF's cameras look along -z and have y up; ours look along z and have y down.
        turn = look_at(view.position_mm, view.target_mm, view.up) * np.array([1.0, -1.0, -1.0])
        nodes.append({
            "name": f"view {name}", "camera": len(cameras),
            "translation": (_y_up(position) * _M_PER_MM).tolist(),
            "rotation": Rotation.from_matrix(_y_up(turn.T).T).as_quat().tolist(),
        })  # fmt: skip
        cameras.append({"name": name, **lens})
    return cameras, nodes


def _glb(content: dict, data: bytes) -> bytes:
    text = json.dumps(content, ensure_ascii=False, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    data = bytes(data) + b"\0" * (-len(data) % 4)
    parts = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(data), 0x004E4942) + data
    return struct.pack("<III", 0x46546C67, 2, 12 + len(parts)) + parts


def write_gltf(source: Source, path, illuminants: Sequence[str] = ILLUMINANTS) -> dict[str, Loss]:
    """Write an object or a scene as GLB, including the loss of its materials.

    Parameters
    ----------
    source : Source
    path : path
    illuminants : sequence of str
        Names of the variants' lights, see `irodori.spectra.published.light`.

    Returns
    -------
    dict of str to Loss
        The loss over all variants under the key ``OBJECT: KIND OF LIGHT``, and that of the spectra under ``extras``
        with the key ``OBJECT: SPECTRA``; see `irodori.export.gltf_loss`.

    Raises
    ------
    PlainError
        If an object has a coupled coat, which glTF's own coat does not describe.
    """
    for name in illuminants:
        xyz_from_reflectance(name)  # refuses an unknown light before any work
    coated = [item.name for item in source.items if item.material.coat != SUM]
    if coated:
        raise PlainError(
            f"--to gltf: found the coupled coat of {', '.join(coated)}; accepted: objects of the coat sum."
        )
    document, nodes = _Document(illuminants), []
    reach = float(max(reaches([item.placement for item in source.items])))
    cameras, eyes = _cameras(source)
    for item in source.items:
        found = refit(item.material)
        numbers = document.materials(item, found)
        mesh = item.placement.shape.facetted(reach / item.placement.scale)
        extras = {"spectra": _spectra(item), "mirror": item.material.mirror, "lobes": list(item.material.lobes)}
        if item.material.is_sheet:
            extras["sheet"] = "shown with the front's reflection on both sides; what passes through is left out"
        nodes.append(_placed(item, document.mesh(mesh, item.name, numbers, extras)))
    half = float(np.sqrt(0.5))
    root = {"name": source.name, "rotation": [-half, 0.0, 0.0, half], "scale": [_M_PER_MM] * 3}
    root["children"] = [1 + i for i in range(len(nodes))]
    document.json["nodes"] = [root, *nodes, *eyes]
    roots = [0, *(1 + len(nodes) + i for i in range(len(eyes)))]
    about = {"source": source.name, "loss": "CIEDE2000 against Irodori's own renderer, under the extras of each mesh"}
    content = document.whole(roots, cameras, about)
    # The loss is computed from the content of the file: its 8-bit pictures and its factors.
    parsed, losses = ParsedGltf(content, bytes(document.buffer.data)), {}
    for number, item in enumerate(source.items):
        entry = content["meshes"][number]
        judged = [
            judge(item, parsed, mapping["material"], illuminants[mapping["variants"][0]])
            for mapping in entry["primitives"][0]["extensions"]["KHR_materials_variants"]["mappings"]
        ]
        for kind in kinds_of_light():
            loss = Loss.of(np.concatenate([one[kind].ravel() for one in judged]))
            losses[f"{item.name}: {kind}"] = loss
        losses[f"{item.name}: {SPECTRA}"] = judge_spectra(item, parsed.spectra(number))
        entry["extras"]["irodori"]["loss_ciede2000"] = {
            kind: losses[f"{item.name}: {kind}"].figures() for kind in (*kinds_of_light(), SPECTRA)
        }
    with written_whole(path) as temporary:
        temporary.write_bytes(_glb(content, bytes(document.buffer.data)))
    return losses
