"""Binary glTF 2.0, as little of it as datasets need: named nodes of unlit textured triangles, images inside the file.

The same scene gives the same bytes. Positions stay in the city's frame (metres, Z up); a root node turns them to
glTF's Y up. The reader reads what the writer writes and refuses everything else: it believes no size or index in the file.

Vertex colours multiply the texture as sRGB bytes here; glTF multiplies linear values, so they are stored as linear
16-bit numbers, which return the same bytes. KHR_materials_unlit says that light is already in the picture.
Source: Khronos, glTF 2.0 specification; the extensions KHR_materials_unlit and EXT_texture_webp.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mmi.foundation.errors import DatasetError
from mmi.foundation.srgb import linear_from_srgb, srgb_from_linear

__all__ = ["GlbImage", "GlbNode", "GlbPrimitive", "GlbScene", "glb_bytes", "read_glb"]

_MAGIC, _JSON, _BIN = 0x46546C67, 0x4E4F534A, 0x004E4942
_REPEAT, _CLAMP = 10497, 33071
_LINEAR, _TRILINEAR = 9729, 9987
_VERTICES, _INDICES = 34962, 34963
_Y_UP_FROM_Z_UP = (1, 0, 0, 0, 0, 0, -1, 0, 0, 1, 0, 0, 0, 0, 0, 1)  # by columns
_WEBP = "EXT_texture_webp"
_UNLIT = "KHR_materials_unlit"
_DTYPES: Mapping[int, np.dtype[Any]] = MappingProxyType(
    {5123: np.dtype("<u2"), 5125: np.dtype("<u4"), 5126: np.dtype("<f4")}
)
_WIDTHS = MappingProxyType({"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4})
# Attribute and kind of it -> (its bytes a vertex, component type, type).
_LAYOUT = MappingProxyType(
    {
        "POSITION": (12, 5126, "VEC3"),
        "TEXCOORD_0": (8, 5126, "VEC2"),
        "TEXCOORD_0 in [0, 1]": (4, 5123, "VEC2"),
        "COLOR_0": (8, 5123, "VEC4"),
    }
)


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
    uint8 multiply the texture; ``image`` is an index into the scene's images. ``masked``: texels with alpha below a half
    are holes, and texture coordinates lie in [0, 1] (they are stored in steps of 1 / 65535). n and m are at least 1 (glTF
    has no empty primitives).
    """

    positions: NDArray[np.float32]
    triangles: NDArray[np.int32]
    uv: NDArray[np.float32] | None = None
    colors: NDArray[np.uint8] | None = None
    image: int | None = None
    masked: bool = False

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
class GlbScene:
    """What a file holds: nodes side by side, the images that they use, and ``extras`` of the whole."""

    nodes: tuple[GlbNode, ...]
    images: tuple[GlbImage, ...] = ()
    extras: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        used = [one.image for node in self.nodes for one in node.primitives if one.image is not None]
        if used and max(used) >= len(self.images):
            raise ValueError(f"an image index below {len(self.images)} expected, found {max(used)}")


def glb_bytes(scene: GlbScene) -> bytes:
    """The scene as binary glTF: one buffer, one view for each kind of vertex data and of indices, one for each image."""
    chunks: dict[str, bytearray] = {}
    accessors: list[dict[str, Any]] = []
    materials: dict[tuple[int | None, bool], int] = {}
    meshes: list[dict[str, Any]] = []
    children: list[dict[str, Any]] = []
    for node in scene.nodes:
        entry: dict[str, Any] = {"name": node.name}
        if node.primitives:
            entry["mesh"] = len(meshes)
            meshes.append(
                {"primitives": [_primitive_entry(one, chunks, accessors, materials) for one in node.primitives]}
            )
        if node.extras:
            entry["extras"] = dict(node.extras)
        children.append(entry)

    places = {name: i for i, name in enumerate(chunks)}
    for accessor in accessors:
        accessor["bufferView"] = places[accessor["bufferView"]]
    views, body = [], bytearray()
    blobs: list[tuple[str, bytes | bytearray]] = [*chunks.items(), *(("image", image.data) for image in scene.images)]
    for name, blob in blobs:
        view: dict[str, Any] = {"buffer": 0, "byteOffset": len(body), "byteLength": len(blob)}
        if name in _LAYOUT:
            view |= {"byteStride": _LAYOUT[name][0], "target": _VERTICES}
        elif name != "image":
            view["target"] = _INDICES
        views.append(view)
        body += blob
        body += b"\0" * (-len(body) % 4)

    root: dict[str, Any] = {"name": "y_up_from_z_up", "matrix": list(_Y_UP_FROM_Z_UP)}
    if children:
        root["children"] = list(range(1, len(children) + 1))
    top: dict[str, Any] = {"nodes": [0]}
    if scene.extras:
        top["extras"] = dict(scene.extras)
    document: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": "multi-mesh-impostors"},
        "scene": 0,
        "scenes": [top],
        "nodes": [root, *children],
        "meshes": meshes,
        "accessors": accessors,
        "materials": [_material_entry(image, masked) for image, masked in materials],
        "bufferViews": views,
        "buffers": [{"byteLength": len(body)}] if body else [],
    }
    document |= _texture_entries(scene.images, len(chunks))
    used = ([_UNLIT] if materials else []) + (
        [_WEBP] if any(image.mime_type == "image/webp" for image in scene.images) else []
    )
    document["extensionsUsed"] = used
    document["extensionsRequired"] = [name for name in used if name == _WEBP]
    filled = {key: value for key, value in document.items() if value != []}
    text = json.dumps(filled, sort_keys=True, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-len(text) % 4)
    parts: list[bytes | bytearray] = [struct.pack("<II", len(text), _JSON), text]
    if body:
        parts += [struct.pack("<II", len(body), _BIN), body]
    size = 12 + sum(len(part) for part in parts)
    return b"".join([struct.pack("<III", _MAGIC, 2, size), *parts])


def read_glb(source: Path | bytes, *, name: str = "") -> GlbScene:
    """The scene that :func:`glb_bytes` wrote to a file or to bytes; ``name`` is what errors call it (default: the path).

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
        root = document["nodes"][_index(top["nodes"][0])]
        if root["matrix"] != list(_Y_UP_FROM_Z_UP):
            raise ValueError("a root node that turns Z up to Y up expected")
        nodes = tuple(reader.node(i) for i in root.get("children", []))
        return GlbScene(nodes, images, dict(top.get("extras", {})))
    except (LookupError, TypeError, ValueError, AttributeError, RecursionError, struct.error) as error:
        what = f"no {error} in it" if isinstance(error, KeyError) else str(error)
        raise DatasetError(f"{name}: damaged, or not a binary glTF written by this project ({what})") from error


# ----------------------------------------------------------------------------------------------------- writing


def _primitive_entry(
    one: GlbPrimitive,
    chunks: dict[str, bytearray],
    accessors: list[dict[str, Any]],
    materials: dict[tuple[int | None, bool], int],
) -> dict[str, Any]:
    """The primitive's entry; adds its data to the views under construction (named, as yet) and to the other lists."""

    def add(view: str, array: NDArray[Any], component: int, kind: str) -> int:
        chunk = chunks.setdefault(view, bytearray())
        offset = len(chunk)
        chunk += array.tobytes()
        chunk += b"\0" * (-len(chunk) % 4)
        accessors.append(
            {
                "bufferView": view,
                "byteOffset": offset,
                "componentType": component,
                "count": len(array),
                "type": kind,
            }
        )
        return len(accessors) - 1

    positions = one.positions.astype("<f4")
    attributes = {"POSITION": add("POSITION", positions, 5126, "VEC3")}
    accessors[-1] |= {"min": _shortest(positions.min(axis=0)), "max": _shortest(positions.max(axis=0))}
    if one.uv is not None and one.masked:
        steps = np.rint(65535.0 * one.uv.astype(np.float64)).astype("<u2")
        attributes["TEXCOORD_0"] = add("TEXCOORD_0 in [0, 1]", steps, 5123, "VEC2")
        accessors[-1]["normalized"] = True
    elif one.uv is not None:
        attributes["TEXCOORD_0"] = add("TEXCOORD_0", one.uv.astype("<f4"), 5126, "VEC2")
    if one.colors is not None:
        linear = np.ones((len(one.colors), 4))
        linear[:, :3] = linear_from_srgb(one.colors)
        attributes["COLOR_0"] = add("COLOR_0", np.rint(65535.0 * linear).astype("<u2"), 5123, "VEC4")
        accessors[-1]["normalized"] = True
    flat = one.triangles.reshape(-1)
    # 65535 itself would restart the primitive.
    if len(positions) <= 65535:
        indices = add("indices16", flat.astype("<u2"), 5123, "SCALAR")
    else:
        indices = add("indices32", flat.astype("<u4"), 5125, "SCALAR")
    material = materials.setdefault((one.image, one.masked), len(materials))
    return {"attributes": attributes, "indices": indices, "material": material}


def _shortest(values: NDArray[np.float32]) -> list[float]:
    """The shortest decimals that are these numbers in single precision."""
    return [float(str(value)) for value in values.astype(np.float32)]


def _material_entry(image: int | None, masked: bool) -> dict[str, Any]:
    surface: dict[str, Any] = {"metallicFactor": 0.0, "roughnessFactor": 1.0}
    if image is not None:
        surface["baseColorTexture"] = {"index": image}
    entry: dict[str, Any] = {"pbrMetallicRoughness": surface, "extensions": {_UNLIT: {}}}
    return entry | ({"alphaMode": "MASK", "alphaCutoff": 0.5} if masked else {})


def _texture_entries(images: tuple[GlbImage, ...], first_view: int) -> dict[str, list[dict[str, Any]]]:
    """Images, textures (one for each image, of the same index) and samplers (clamping, then repeating)."""
    textures = []
    for i, image in enumerate(images):
        source = {"extensions": {_WEBP: {"source": i}}} if image.mime_type == "image/webp" else {"source": i}
        textures.append({"sampler": int(image.repeat), **source})
    samplers = [{"magFilter": _LINEAR, "minFilter": _TRILINEAR, "wrapS": w, "wrapT": w} for w in (_CLAMP, _REPEAT)]
    return {
        "images": [{"bufferView": first_view + i, "mimeType": one.mime_type} for i, one in enumerate(images)],
        "textures": textures,
        "samplers": samplers if images else [],
    }


# ----------------------------------------------------------------------------------------------------- reading


def _chunks(data: bytes) -> tuple[dict[str, Any], bytes]:
    """The JSON document and the binary body of a GLB container."""
    if len(data) < 20:
        raise ValueError(f"a header of 20 bytes expected, found {len(data)}")
    magic, version, size, text_size, kind = struct.unpack_from("<IIIII", data)
    if magic != _MAGIC or version != 2:
        raise ValueError(f"glTF version 2 expected, found {data[:4]!r} version {version}")
    if size != len(data):
        raise ValueError(f"a file of {size} bytes expected, found {len(data)}")
    end = 20 + text_size
    if kind != _JSON or end > size:
        raise ValueError(f"a JSON chunk within the file expected, found one of {text_size} bytes")
    document = json.loads(data[20:end])
    if not isinstance(document, dict):
        raise TypeError(f"a JSON object expected, found {type(document).__name__}")
    if end == size:
        return document, b""
    body_size, kind = struct.unpack_from("<II", data, end)
    if kind != _BIN or end + 8 + body_size != size:
        raise ValueError(f"a binary chunk up to the end of the file expected, found one of {body_size} bytes")
    return document, data[end + 8 :]


def _index(value: object) -> int:
    """A whole number that is not negative; JSON has others, and Python would count those from the end."""
    if type(value) is not int or value < 0:
        raise ValueError(f"a whole number >= 0 expected, found {value!r}")
    return value


@dataclass(frozen=True, slots=True, eq=False)
class _Reader:
    document: dict[str, Any]
    body: bytes

    def view(self, index: object) -> memoryview:
        view = self.document["bufferViews"][_index(index)]
        start, size = _index(view["byteOffset"]), _index(view["byteLength"])
        if start + size > len(self.body):
            raise ValueError(f"bytes {start} to {start + size} wanted, the file has {len(self.body)}")
        return memoryview(self.body)[start : start + size]

    def array(self, index: object, components: tuple[int, ...], kind: str) -> NDArray[Any]:
        """(count, width) copied out of an accessor, which must have one of these component types and this type."""
        accessor = self.document["accessors"][_index(index)]
        component, count, offset = (_index(accessor[key]) for key in ("componentType", "count", "byteOffset"))
        if component not in components or accessor["type"] != kind:
            raise ValueError(
                f"{kind} of component type {components} expected, found {accessor['type']!r} of {component}"
            )
        data = self.view(accessor["bufferView"])
        dtype, width = _DTYPES[component], _WIDTHS[kind]
        size = count * width * dtype.itemsize
        if offset + size > len(data):
            raise ValueError(f"{count} times {kind} from byte {offset} wanted, the view has {len(data)} bytes")
        return np.frombuffer(data[offset : offset + size], dtype=dtype).reshape(count, width).copy()

    def image(self, index: int) -> GlbImage:
        data = bytes(self.view(self.document["images"][index]["bufferView"]))
        texture = self.document["textures"][index]
        source = texture["source"] if "source" in texture else texture["extensions"][_WEBP]["source"]
        if source != index:
            raise ValueError(f"texture {index} is expected to show image {index}, found {source!r}")
        sampler = self.document["samplers"][_index(texture["sampler"])]
        return GlbImage(data, repeat=sampler["wrapS"] == _REPEAT)

    def node(self, index: object) -> GlbNode:
        node = self.document["nodes"][_index(index)]
        name = node["name"]
        if not isinstance(name, str):
            raise TypeError(f"a node's name expected, found {name!r}")
        entries = self.document["meshes"][_index(node["mesh"])]["primitives"] if "mesh" in node else []
        return GlbNode(name, tuple(self.primitive(entry) for entry in entries), dict(node.get("extras", {})))

    def primitive(self, entry: dict[str, Any]) -> GlbPrimitive:
        attributes = entry["attributes"]
        material = self.document["materials"][_index(entry["material"])]
        masked = material.get("alphaMode") == "MASK"
        found = {}
        for key in ("POSITION", "TEXCOORD_0", "COLOR_0"):
            if key in attributes:
                _, component, kind = _LAYOUT["TEXCOORD_0 in [0, 1]" if masked and key == "TEXCOORD_0" else key]
                found[key] = self.array(attributes[key], (component,), kind)
        if masked and "TEXCOORD_0" in found:
            found["TEXCOORD_0"] = (found["TEXCOORD_0"] / 65535.0).astype(np.float32)
        indices = self.array(entry["indices"], (5123, 5125), "SCALAR").astype(np.int64).reshape(-1, 3)
        if indices.size and indices.max() >= len(found["POSITION"]):
            raise ValueError(f"triangle indices below {len(found['POSITION'])} expected, found {indices.max()}")
        texture = material["pbrMetallicRoughness"].get("baseColorTexture")
        return GlbPrimitive(
            positions=found["POSITION"],
            triangles=indices.astype(np.int32),
            uv=found.get("TEXCOORD_0"),
            colors=srgb_from_linear(found["COLOR_0"][:, :3] / 65535.0) if "COLOR_0" in found else None,
            image=None if texture is None else _index(texture["index"]),
            masked=masked,
        )
