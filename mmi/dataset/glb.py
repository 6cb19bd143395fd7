"""What datasets keep in binary glTF 2.0, and as little of it as they need: named nodes of unlit textured triangles, images
inside the file. ``mmi.gltf`` has the container and the arrays.

The same contents give the same bytes. Positions stay in the city's frame (metres, Z up); a root node turns them to
glTF's Y up. The reader reads what the writer writes and refuses everything else: it believes no size or index in the file.

Vertex colours multiply the texture as sRGB bytes here; glTF multiplies linear values, so they are stored as linear
16-bit numbers, which return the same bytes. KHR_materials_unlit says that light is already in the picture.
Source: Khronos, glTF 2.0 specification; the extensions KHR_materials_unlit and EXT_texture_webp.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mmi.foundation.errors import DatasetError
from mmi.foundation.srgb import srgb_from_linear
from mmi.gltf.codes import CLAMP, FLOAT, GENERATOR, LINEAR, REPEAT, TRILINEAR, UINT16, UINT32, UNLIT, WEBP
from mmi.gltf.container import BIN, JSON, glb_chunks, glb_pieces
from mmi.gltf.reading import buffer_view, elements, whole_number
from mmi.gltf.writing import BufferViews

__all__ = ["GlbContents", "GlbImage", "GlbNode", "GlbPrimitive", "glb_bytes", "read_glb"]

_Y_UP_FROM_Z_UP = (1, 0, 0, 0, 0, 0, -1, 0, 0, 1, 0, 0, 0, 0, 0, 1)  # by columns


@dataclass(frozen=True, slots=True)
class GlbImage:
    """An encoded PNG, JPEG or WebP; ``repeat``: the texture repeats in both directions, else its edge is clamped."""

    data: bytes
    repeat: bool = False

    def __post_init__(self) -> None:
        if not self.mime_type:
            raise ValueError(f"an image in a glTF is PNG, JPEG or WebP, found one that starts with {self.data[:12]!r}")

    @property
    def mime_type(self) -> str:
        """Told from the first bytes; empty where they are of no known kind."""
        if self.data.startswith(b"\x89PNG\r\n\x1a\n"):
            return "image/png"
        if self.data.startswith(b"\xff\xd8\xff"):
            return "image/jpeg"
        return "image/webp" if self.data[:4] == b"RIFF" and self.data[8:12] == b"WEBP" else ""


@dataclass(frozen=True, slots=True, eq=False)
class GlbPrimitive:
    """Triangles with one texture.

    ``positions`` (n, 3) float32 metres; ``triangles`` (m, 3) int32; ``uv`` (n, 2) float32, v down; ``colors`` (n, 3)
    uint8 multiply the texture; ``image`` is an index into the file's images. ``masked`` or ``cut_out``: texels with alpha
    below a half are holes; where it is ``masked``, texture coordinates lie in [0, 1] (they are stored in steps of 1 / 65535).
    n and m are at least 1 (glTF has no empty primitives).
    """

    positions: NDArray[np.float32]
    triangles: NDArray[np.int32]
    uv: NDArray[np.float32] | None = None
    colors: NDArray[np.uint8] | None = None
    image: int | None = None
    masked: bool = False
    cut_out: bool = False

    def __post_init__(self) -> None:
        positions = np.ascontiguousarray(self.positions, dtype=np.float32)
        triangles = np.ascontiguousarray(self.triangles, dtype=np.int32)
        n = len(positions)
        if positions.shape != (n, 3) or n == 0 or triangles.shape != (len(triangles), 3) or len(triangles) == 0:
            raise ValueError(
                f"a primitive needs positions (n, 3) and triangles (m, 3), both not empty, "
                f"found {positions.shape} and {triangles.shape}"
            )
        if not 0 <= triangles.min() <= triangles.max() < n:
            raise ValueError(f"triangle indices in [0, {n}) expected, found {triangles.min()} to {triangles.max()}")
        arrays: dict[str, NDArray[Any]] = {"positions": positions, "triangles": triangles}
        if self.uv is not None:
            arrays["uv"] = np.ascontiguousarray(self.uv, dtype=np.float32)
        if self.colors is not None:
            arrays["colors"] = np.ascontiguousarray(self.colors, dtype=np.uint8)
        for name, width in (("uv", 2), ("colors", 3)):
            if name in arrays and arrays[name].shape != (n, width):
                raise ValueError(f"{name} of shape ({n}, {width}) expected, found {arrays[name].shape}")
        for name in ("positions", "uv"):
            if name in arrays and not np.isfinite(arrays[name]).all():
                raise ValueError(f"finite {name} expected, found infinities or NaN")
        if self.masked and self.cut_out:
            raise ValueError("a primitive that is masked or a cut-out expected, found one that is both")
        if self.masked and "uv" in arrays and not (0.0 <= arrays["uv"].min() and arrays["uv"].max() <= 1.0):
            raise ValueError("texture coordinates in [0, 1] expected where alpha masks")
        if self.image is not None and (self.uv is None or self.image < 0):
            raise ValueError(f"image {self.image} expected to be an index, with texture coordinates")
        for name, array in arrays.items():
            array.setflags(write=False)
            object.__setattr__(self, name, array)


@dataclass(frozen=True, slots=True, eq=False)
class GlbNode:
    """A named thing, such as a layer or a building; ``extras`` holds what JSON can."""

    name: str
    primitives: tuple[GlbPrimitive, ...] = ()
    extras: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class GlbContents:
    """What a file holds: nodes side by side, the images that they use, and ``extras`` of the whole."""

    nodes: tuple[GlbNode, ...]
    images: tuple[GlbImage, ...] = ()
    extras: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        used = [one.image for node in self.nodes for one in node.primitives if one.image is not None]
        if used and max(used) >= len(self.images):
            raise ValueError(f"an image index below {len(self.images)} expected, found {max(used)}")


def glb_bytes(contents: GlbContents) -> bytes:
    """The contents as binary glTF: one buffer, one view for each kind of vertex data and of indices, one for each image."""
    arrays = BufferViews()
    materials: dict[tuple[int | None, bool], int] = {}
    meshes: list[dict[str, Any]] = []
    children: list[dict[str, Any]] = []
    for node in contents.nodes:
        entry: dict[str, Any] = {"name": node.name}
        if node.primitives:
            entry["mesh"] = len(meshes)
            meshes.append({"primitives": [_primitive_entry(one, arrays, materials) for one in node.primitives]})
        if node.extras:
            entry["extras"] = dict(node.extras)
        children.append(entry)

    root: dict[str, Any] = {"name": "y_up_from_z_up", "matrix": list(_Y_UP_FROM_Z_UP)}
    if children:
        root["children"] = list(range(1, len(children) + 1))
    top: dict[str, Any] = {"nodes": [0]}
    if contents.extras:
        top["extras"] = dict(contents.extras)
    buffers, blobs, first_image = arrays.entries(image.data for image in contents.images)
    used = ([UNLIT] if materials else []) + (
        [WEBP] if any(image.mime_type == "image/webp" for image in contents.images) else []
    )
    document: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": GENERATOR},
        "scene": 0,
        "scenes": [top],
        "nodes": [root, *children],
        "meshes": meshes,
        "materials": [_material_entry(image, masked) for image, masked in materials],
        "extensionsUsed": used,
        "extensionsRequired": [name for name in used if name == WEBP],
        **_texture_entries(contents.images, first_image),
        **buffers,
    }
    return b"".join(glb_pieces(document, blobs, sort_keys=True, ascii_only=True))


def read_glb(source: Path | bytes, *, name: str = "") -> GlbContents:
    """The contents that :func:`glb_bytes` wrote to a file or to bytes; ``name`` is what errors call it (default: the path).

    Raises DatasetError when it is missing, damaged or not of the kind that this project writes.
    """
    if isinstance(source, Path):
        name = name or str(source)
        try:
            source = source.read_bytes()
        except OSError as error:
            raise DatasetError(f"{name}: cannot be read ({error.strerror})") from error
    name = name or "glTF"
    try:
        document, body = _chunks(source)
        reader = _Reader(document, body)
        images = tuple(reader.image(i) for i in range(len(document.get("images", []))))
        top = document["scenes"][0]
        root = document["nodes"][whole_number(top["nodes"][0])]
        if root["matrix"] != list(_Y_UP_FROM_Z_UP):
            raise ValueError("a root node that turns Z up to Y up expected")
        nodes = tuple(reader.node(i) for i in root.get("children", []))
        return GlbContents(nodes, images, dict(top.get("extras", {})))
    except (LookupError, TypeError, ValueError, AttributeError, RecursionError) as error:
        what = f"no {error} in it" if isinstance(error, KeyError) else str(error)
        raise DatasetError(f"{name}: damaged, or not a binary glTF written by this project ({what})") from error


# ----------------------------------------------------------------------------------------------------- writing


def _primitive_entry(
    one: GlbPrimitive, arrays: BufferViews, materials: dict[tuple[int | None, bool], int]
) -> dict[str, Any]:
    """The primitive's entry; adds its data to ``arrays`` and its material to ``materials``."""
    attributes = {"POSITION": arrays.positions(one.positions, shortest=True)}
    if one.uv is not None:
        attributes["TEXCOORD_0"] = arrays.unit_coordinates(one.uv) if one.masked else arrays.coordinates(one.uv)
    if one.colors is not None:
        attributes["COLOR_0"] = arrays.colors(one.colors)
    indices = arrays.indices(one.triangles.reshape(-1), len(one.positions))
    material = materials.setdefault((one.image, one.masked or one.cut_out), len(materials))
    return {"attributes": attributes, "indices": indices, "material": material}


def _material_entry(image: int | None, masked: bool) -> dict[str, Any]:
    surface: dict[str, Any] = {"metallicFactor": 0.0, "roughnessFactor": 1.0}
    if image is not None:
        surface["baseColorTexture"] = {"index": image}
    entry: dict[str, Any] = {"pbrMetallicRoughness": surface, "extensions": {UNLIT: {}}}
    return entry | ({"alphaMode": "MASK", "alphaCutoff": 0.5} if masked else {})


def _texture_entries(images: tuple[GlbImage, ...], first_view: int) -> dict[str, list[dict[str, Any]]]:
    """Images, textures (one for each image, of the same index) and samplers (clamping, then repeating)."""
    textures = []
    for i, image in enumerate(images):
        source = {"extensions": {WEBP: {"source": i}}} if image.mime_type == "image/webp" else {"source": i}
        textures.append({"sampler": int(image.repeat), **source})
    samplers = [{"magFilter": LINEAR, "minFilter": TRILINEAR, "wrapS": w, "wrapT": w} for w in (CLAMP, REPEAT)]
    return {
        "images": [{"bufferView": first_view + i, "mimeType": one.mime_type} for i, one in enumerate(images)],
        "textures": textures,
        "samplers": samplers if images else [],
    }


# ----------------------------------------------------------------------------------------------------- reading


def _chunks(data: bytes) -> tuple[dict[str, Any], bytes]:
    """The JSON document and the binary body of a file that holds one of the former, at most one of the latter, no more."""
    chunks = glb_chunks(data)
    kinds = [kind for kind, _ in chunks]
    if kinds not in ([JSON], [JSON, BIN]):
        raise ValueError(f"a JSON chunk and at most one binary chunk expected, found kinds {kinds}")
    size = 12 + sum(8 + len(chunk) for _, chunk in chunks)
    if size != len(data):
        raise ValueError(f"a file of {size} bytes expected, found {len(data)}")
    document = json.loads(chunks[0][1])
    if not isinstance(document, dict):
        raise TypeError(f"a JSON object expected, found {type(document).__name__}")
    return document, chunks[1][1] if len(chunks) > 1 else b""


@dataclass(frozen=True, slots=True, eq=False)
class _Reader:
    document: dict[str, Any]
    body: bytes

    def array(self, index: object, components: tuple[int, ...], kind: str) -> NDArray[Any]:
        """(count, width) copied out of an accessor, which must have one of these component types and this type."""
        accessor = self.document["accessors"][whole_number(index)]
        component, count, offset = (whole_number(accessor[key]) for key in ("componentType", "count", "byteOffset"))
        if component not in components or accessor["type"] != kind:
            raise ValueError(
                f"{kind} of component type {components} expected, found {accessor['type']!r} of {component}"
            )
        view = buffer_view(self.document, [self.body], accessor["bufferView"])
        return elements(view, offset=offset, count=count, component=component, kind=kind)

    def image(self, index: int) -> GlbImage:
        data = bytes(buffer_view(self.document, [self.body], self.document["images"][index]["bufferView"]).data)
        texture = self.document["textures"][index]
        source = texture["source"] if "source" in texture else texture["extensions"][WEBP]["source"]
        if source != index:
            raise ValueError(f"texture {index} is expected to show image {index}, found {source!r}")
        sampler = self.document["samplers"][whole_number(texture["sampler"])]
        return GlbImage(data, repeat=sampler["wrapS"] == REPEAT)

    def node(self, index: object) -> GlbNode:
        node = self.document["nodes"][whole_number(index)]
        name = node["name"]
        if not isinstance(name, str):
            raise TypeError(f"a node's name expected, found {name!r}")
        entries = self.document["meshes"][whole_number(node["mesh"])]["primitives"] if "mesh" in node else []
        return GlbNode(name, tuple(self.primitive(entry) for entry in entries), dict(node.get("extras", {})))

    def primitive(self, entry: dict[str, Any]) -> GlbPrimitive:
        attributes = entry["attributes"]
        material = self.document["materials"][whole_number(entry["material"])]
        masked = material.get("alphaMode") == "MASK"
        layout = {
            "POSITION": ((FLOAT,), "VEC3"),
            "TEXCOORD_0": ((UINT16, FLOAT) if masked else (FLOAT,), "VEC2"),
            "COLOR_0": ((UINT16,), "VEC4"),
        }
        found = {
            key: self.array(attributes[key], components, kind)
            for key, (components, kind) in layout.items()
            if key in attributes
        }
        cut_out = masked and "TEXCOORD_0" in found and found["TEXCOORD_0"].dtype.kind == "f"
        if masked and "TEXCOORD_0" in found and not cut_out:
            found["TEXCOORD_0"] = (found["TEXCOORD_0"] / 65535.0).astype(np.float32)
        indices = self.array(entry["indices"], (UINT16, UINT32), "SCALAR").astype(np.int64).reshape(-1, 3)
        if indices.size and indices.max() >= len(found["POSITION"]):
            raise ValueError(f"triangle indices below {len(found['POSITION'])} expected, found {indices.max()}")
        texture = material["pbrMetallicRoughness"].get("baseColorTexture")
        return GlbPrimitive(
            positions=found["POSITION"],
            triangles=indices.astype(np.int32),
            uv=found.get("TEXCOORD_0"),
            colors=srgb_from_linear(found["COLOR_0"][:, :3] / 65535.0) if "COLOR_0" in found else None,
            image=None if texture is None else whole_number(texture["index"]),
            masked=masked and not cut_out,
            cut_out=cut_out,
        )
