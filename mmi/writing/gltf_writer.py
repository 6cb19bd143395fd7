"""Cities out as binary glTF 2.0: a node for each object, each street and the ground, for engines and for reading again.

``mmi.dataset.glb`` writes what datasets need (baked light, unlit, masked layers) and reads its own only; this is for
cities: lit materials by their names, lines, no vertices that are shared between objects. Positions are metres from the
city's origin, turned to glTF's Y up as (x, z, -y). ``asset.extras`` has ``crs``, ``origin`` and ``source``, so that nothing
is lost.

Materials say what ``TriangleMesh.textures`` does: one for each texture, ``plain`` for triangles of their own colour
(COLOR_0, linear as glTF wants it), ``painted`` for those without looks, such as all prisms. Normals are left out: glTF says
that surfaces are flat then. Prisms are triangulated along one set of edges, so that each is closed.

Source: Khronos, glTF 2.0 specification.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path
from types import MappingProxyType
from typing import Any

import networkx as nx
import numpy as np
import shapely
from numpy.typing import NDArray

from mmi.city.model import PAINTED, PLAIN, City, CityObject, Prism, Texture, TriangleMesh
from mmi.city.terrain import Terrain, grid_triangles
from mmi.city.triangulate import triangulate
from mmi.city.welding import weld
from mmi.foundation.errors import CityError
from mmi.foundation.srgb import linear_from_srgb, png_bytes
from mmi.foundation.whole_files import whole_file

__all__ = ["write_glb"]

_CHUNK = 4096  # objects whose prisms are triangulated together
_MOST_BYTES = 2**32 - 1  # what a GLB's header can say
_LINE_STRIP = 3
_REPEAT, _LINEAR, _TRILINEAR = 10497, 9729, 9987
_VERTICES, _INDICES = 34962, 34963
_TERRAIN, _STREET = -3, -4  # as if they were textures: materials of their own
# Name and base colour of the materials that show no texture.
_MATERIALS: Mapping[int, tuple[str, tuple[float, float, float]]] = MappingProxyType({
    PLAIN: ("plain", (1.0, 1.0, 1.0)), PAINTED: ("painted", (0.6, 0.6, 0.6)),
    _TERRAIN: ("terrain", (0.3, 0.35, 0.25)), _STREET: ("street", (0.1, 0.1, 0.1)),
})  # fmt: skip
# View -> bytes from vertex to vertex (0: none), target.
_VIEWS: Mapping[str, tuple[int, int]] = MappingProxyType({
    "POSITION": (12, _VERTICES), "TEXCOORD_0": (8, _VERTICES), "COLOR_0": (8, _VERTICES), "16-bit": (0, _INDICES),
    "32-bit": (0, _INDICES),
})  # fmt: skip


def write_glb(city: City, path: Path) -> None:
    """Write ``city`` to ``path`` as binary glTF. Raises CityError where that cannot be written, or would pass 4 GiB."""
    scene = _Scene(city.textures)
    objects = iter(city.objects)
    while chunk := list(islice(objects, _CHUNK)):
        solids = _prism_corners([prism for one in chunk if one.mesh is None for prism in one.prisms])
        for one in chunk:
            scene.add_object(one, [next(solids) for _ in one.prisms] if one.mesh is None else [])
    scene.add_streets(city)
    if city.terrain is not None:
        scene.add_terrain(city.terrain)
    extras = {"crs": city.crs, "origin": [float(one) for one in city.origin], "source": city.source}
    text, blobs = scene.parts(extras)
    size = 12 + 8 + len(text) + (8 + sum(map(len, blobs)) if blobs else 0)
    if size > _MOST_BYTES:
        raise CityError(f"{path}: a binary glTF of at most {_MOST_BYTES} bytes expected, found {size}; write CityJSON")
    with whole_file(path) as file:
        file.write(struct.pack("<4sIIII", b"glTF", 2, size, len(text), 0x4E4F534A) + text)
        if blobs:
            file.write(struct.pack("<II", sum(map(len, blobs)), 0x004E4942))
            for blob in blobs:
                file.write(blob)


class _Scene:
    """A glTF that grows node by node: its JSON, and one buffer view for each kind of data."""

    def __init__(self, textures: Sequence[Texture]) -> None:
        self._textures = textures
        self._nodes: list[dict[str, Any]] = []
        self._meshes: list[dict[str, Any]] = []
        self._accessors: list[dict[str, Any]] = []
        self._views: dict[str, bytearray] = {}
        self._materials: dict[int, int] = {}  # places in ``City.textures``, or PLAIN and so on -> index

    def add_object(self, one: CityObject, solids: Sequence[NDArray[np.float64]]) -> None:
        """An object's mesh, or the triangles (m, 3, 3) of its prisms."""
        primitives = _parts(one.mesh) if one.mesh is not None else [(PAINTED, np.concatenate(solids), None, None)]
        entries = [self._triangles(*parts) for parts in primitives]
        self._node(one.id, [entry for entry in entries if entry is not None], {"id": one.id})

    def add_streets(self, city: City) -> None:
        """A line strip for each street, on the ground."""
        graph: nx.MultiGraph = city.streets
        for edge in sorted((edge for _, _, edge in graph.edges(data=True)), key=lambda edge: int(edge["index"])):
            points = shapely.get_coordinates(edge["geometry"])
            line = _y_up(np.column_stack([points, city.ground_at(points)]))
            line = line[np.append(True, (line[1:] != line[:-1]).any(axis=1))]
            entry = {
                "attributes": {"POSITION": self._positions(line)},
                "material": self._material(_STREET),
                "mode": _LINE_STRIP,
            }
            extras = {"name": edge["name"], "kind": edge["kind"], "width": 2.0 * float(edge["half_width"])}
            self._node(edge["name"] or f"street/{edge['index']}", [entry] if len(line) > 1 else [], extras)

    def add_terrain(self, terrain: Terrain) -> None:
        """Two triangles for each square of the grid."""
        points = _y_up(terrain.points.reshape(-1, 3))
        triangles = grid_triangles(np.arange(len(points)).reshape(terrain.heights.shape))
        entry = {
            "attributes": {"POSITION": self._positions(points)},
            "indices": self._indices(triangles.reshape(-1), len(points)),
            "material": self._material(_TERRAIN),
        }
        self._node("terrain", [entry], {})

    def parts(self, extras: dict[str, Any]) -> tuple[bytes, list[bytes | bytearray]]:
        """The JSON chunk, and what follows one another in the binary chunk; all of it in fours of bytes."""
        names = list(self._views)
        images = [number for number in self._materials if number >= 0]
        blobs: list[bytes | bytearray] = list(self._views.values())
        views: list[dict[str, Any]] = []
        start = 0
        for i, blob in enumerate([*blobs, *(png_bytes(self._textures[number].image) for number in images)]):
            view: dict[str, Any] = {"buffer": 0, "byteOffset": start, "byteLength": len(blob)}
            if i < len(names):
                stride, target = _VIEWS[names[i]]
                view |= ({"byteStride": stride} if stride else {}) | {"target": target}
            else:
                blobs.append(blob + b"\0" * (-len(blob) % 4))
            views.append(view)
            start += len(blob) + -len(blob) % 4
        accessors = [one | {"bufferView": names.index(one["bufferView"])} for one in self._accessors]
        textures = range(len(images))
        document: dict[str, Any] = {
            "asset": {"version": "2.0", "generator": "multi-mesh-impostors", "extras": extras},
            "scene": 0,
            "scenes": [{"nodes": list(range(len(self._nodes)))} if self._nodes else {}],
            "nodes": self._nodes,
            "meshes": self._meshes,
            "materials": [self._material_entry(number, images) for number in self._materials],
            "textures": [{"source": i, "sampler": 0} for i in textures],
            "images": [
                {"name": self._textures[number].name, "bufferView": len(names) + i, "mimeType": "image/png"}
                for i, number in enumerate(images)
            ],
            "samplers": [{"magFilter": _LINEAR, "minFilter": _TRILINEAR, "wrapS": _REPEAT, "wrapT": _REPEAT}]
            if images
            else [],
            "accessors": accessors,
            "bufferViews": views,
            "buffers": [{"byteLength": start}] if start else [],
        }
        filled = {key: value for key, value in document.items() if value != []}
        text = json.dumps(filled, ensure_ascii=False, allow_nan=False, separators=(",", ":")).encode()
        return text + b" " * (-len(text) % 4), blobs

    def _node(self, name: str, primitives: list[dict[str, Any]], extras: dict[str, Any]) -> None:
        node: dict[str, Any] = {"name": name}
        if primitives:
            node["mesh"] = len(self._meshes)
            self._meshes.append({"name": name, "primitives": primitives})
        if extras:
            node["extras"] = extras
        self._nodes.append(node)

    def _triangles(
        self,
        texture: int,
        corners: NDArray[np.float64],
        uv: NDArray[np.float32] | None,
        colors: NDArray[np.uint8] | None,
    ) -> dict[str, Any] | None:
        """A primitive of triangles (m, 3 corners, 3); None if single precision leaves nothing of them.

        ``uv`` (m, 3, 2), ``colors`` (m, 3) sRGB.
        """
        points = _y_up(corners)
        a, b, c = (points[:, k] for k in range(3))
        whole = ((a != b).any(axis=1)) & ((b != c).any(axis=1)) & ((c != a).any(axis=1))
        if not whole.any():
            return None
        columns: list[NDArray[Any]] = [points[whole].reshape(-1, 3)]
        if uv is not None:
            columns.append(uv[whole].reshape(-1, 2))
        if colors is not None:
            columns.append(np.repeat(colors[whole], 3, axis=0))
        place = weld(np.concatenate(columns, axis=1))
        first = np.empty(int(place.max()) + 1, dtype=np.int64)
        first[place] = np.arange(len(place))
        attributes = {"POSITION": self._positions(columns[0][first])}
        if uv is not None:
            u, v = columns[1][first].T  # v up here, down there
            down = np.stack([u, 1.0 - v], axis=1).astype("<f4")
            attributes["TEXCOORD_0"] = self._accessor("TEXCOORD_0", down, 5126, "VEC2")
        if colors is not None:
            linear = np.ones((len(first), 4))
            linear[:, :3] = linear_from_srgb(columns[-1][first])
            attributes["COLOR_0"] = self._accessor("COLOR_0", np.rint(65535.0 * linear).astype("<u2"), 5123, "VEC4")
            self._accessors[-1]["normalized"] = True
        return {
            "attributes": attributes,
            "indices": self._indices(place, len(first)),
            "material": self._material(texture),
        }

    def _positions(self, points: NDArray[np.float32]) -> int:
        number = self._accessor("POSITION", points, 5126, "VEC3")
        self._accessors[-1] |= {"min": points.min(axis=0).tolist(), "max": points.max(axis=0).tolist()}
        return number

    def _indices(self, index: NDArray[np.int64], vertices: int) -> int:
        if vertices <= 65535:  # 65535 itself would restart the primitive
            return self._accessor("16-bit", index.astype("<u2"), 5123, "SCALAR")
        return self._accessor("32-bit", index.astype("<u4"), 5125, "SCALAR")

    def _accessor(self, view: str, array: NDArray[Any], component: int, kind: str) -> int:
        """Adds data to a view (which has its number only in the end)."""
        data = self._views.setdefault(view, bytearray())
        entry = {"bufferView": view, "byteOffset": len(data), "componentType": component}
        self._accessors.append(entry | {"count": len(array), "type": kind})
        data += array.tobytes()
        data += b"\0" * (-len(data) % 4)
        return len(self._accessors) - 1

    def _material(self, texture: int) -> int:
        return self._materials.setdefault(texture, len(self._materials))

    def _material_entry(self, number: int, images: list[int]) -> dict[str, Any]:
        surface: dict[str, Any] = {"metallicFactor": 0.0, "roughnessFactor": 1.0}
        if number >= 0:
            name = self._textures[number].name
            surface["baseColorTexture"] = {"index": images.index(number)}
        else:
            name, color = _MATERIALS[number]
            surface["baseColorFactor"] = [*color, 1.0]
        return {"name": name, "pbrMetallicRoughness": surface}


def _y_up(points: NDArray[np.float64]) -> NDArray[np.float32]:
    """(..., 3) in the city's frame -> the same in glTF's, little-endian."""
    return np.stack([points[..., 0], points[..., 2], -points[..., 1]], axis=-1).astype("<f4") + np.float32(0.0)


def _parts(
    mesh: TriangleMesh,
) -> Iterator[tuple[int, NDArray[np.float64], NDArray[np.float32] | None, NDArray[np.uint8] | None]]:
    """By texture: the corners (m, 3, 3) of its triangles, their texture coordinates and colours, where they need any."""
    for texture in np.unique(mesh.textures).tolist():
        rows = mesh.textures == texture
        colors = mesh.colors[rows]
        colored = texture == PLAIN or (texture >= 0 and bool((colors != 255).any()))
        corners = mesh.vertices[mesh.triangles[rows]]
        yield texture, corners, mesh.uv[rows] if texture >= 0 else None, colors if colored else None


def _prism_corners(prisms: Sequence[Prism]) -> Iterator[NDArray[np.float64]]:
    """Per prism the corners (m, 3, 3) of triangles that close it: a roof, a floor, and walls on the roof's border."""
    if not prisms:
        return
    points, triangles, of = triangulate([prism.footprint for prism in prisms])
    place = weld(np.column_stack([points, of]))
    flat = np.empty((int(place.max()) + 1, 2))
    flat[place] = points
    used = place[triangles]
    whole = (used != np.roll(used, -1, axis=1)).all(axis=1)
    used, prism = used[whole], of[triangles[whole, 0]]
    a, b = used.reshape(-1), np.roll(used, -1, axis=1).reshape(-1)
    border = ~np.isin(a * len(flat) + b, b * len(flat) + a)
    a, b, wall = a[border], b[border], np.repeat(prism, 3)[border]

    heights = np.array([(prism.bottom, prism.top) for prism in prisms])

    def at(index: NDArray[np.int64], owner: NDArray[np.int64], end: int) -> NDArray[np.float64]:
        z = np.broadcast_to(heights[owner, end].reshape(-1, *[1] * (index.ndim - 1)), index.shape)
        return np.concatenate([flat[index], z[..., None]], axis=-1)

    a0, b0, b1, a1 = at(a, wall, 0), at(b, wall, 0), at(b, wall, 1), at(a, wall, 1)
    corners = np.concatenate([
        at(used, prism, 1), at(used[:, ::-1], prism, 0), np.stack([a0, b0, b1], axis=1), np.stack([a0, b1, a1], axis=1)
    ])  # fmt: skip
    owner = np.concatenate([prism, prism, wall, wall])
    order = np.argsort(owner, kind="stable")
    yield from np.split(corners[order], np.searchsorted(owner[order], np.arange(1, len(prisms))))
