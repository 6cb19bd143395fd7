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
from mmi.foundation.srgb import png_bytes
from mmi.foundation.whole_files import whole_file
from mmi.gltf.codes import GENERATOR, LINE_STRIP, LINEAR, REPEAT, TRILINEAR
from mmi.gltf.container import glb_pieces
from mmi.gltf.writing import BufferViews

__all__ = ["write_glb"]

_CHUNK = 4096  # objects whose prisms are triangulated together
_TERRAIN, _STREET = -3, -4  # as if they were textures: materials of their own
# Name and base colour of the materials that show no texture.
_MATERIALS: Mapping[int, tuple[str, tuple[float, float, float]]] = MappingProxyType({
    PLAIN: ("plain", (1.0, 1.0, 1.0)), PAINTED: ("painted", (0.6, 0.6, 0.6)),
    _TERRAIN: ("terrain", (0.3, 0.35, 0.25)), _STREET: ("street", (0.1, 0.1, 0.1)),
})  # fmt: skip


def write_glb(city: City, path: Path) -> None:
    """Write ``city`` to ``path`` as binary glTF. Raises CityError where that cannot be written, or would pass 4 GiB."""
    draft = _Draft(city.textures)
    objects = iter(city.objects)
    while chunk := list(islice(objects, _CHUNK)):
        solids = _prism_corners([prism for one in chunk if one.mesh is None for prism in one.prisms])
        for one in chunk:
            draft.add_object(one, [next(solids) for _ in one.prisms] if one.mesh is None else [])
    draft.add_streets(city)
    if city.terrain is not None:
        draft.add_terrain(city.terrain)
    extras = {"crs": city.crs, "origin": [float(one) for one in city.origin], "source": city.source}
    try:
        pieces = draft.pieces(extras)
    except OverflowError as error:
        raise CityError(f"{path}: {error}; write CityJSON") from error
    with whole_file(path, error=CityError) as file:
        for piece in pieces:
            file.write(piece)


class _Draft:
    """A glTF that grows node by node: its JSON, and the arrays that it refers to."""

    def __init__(self, textures: Sequence[Texture]) -> None:
        self._textures = textures
        self._nodes: list[dict[str, Any]] = []
        self._meshes: list[dict[str, Any]] = []
        self._arrays = BufferViews()
        self._materials: dict[int, int] = {}  # places in ``City.textures``, or PLAIN and so on -> index

    def add_object(self, one: CityObject, solids: Sequence[NDArray[np.float64]]) -> None:
        """An object's mesh, or the triangles (m, 3, 3) of its prisms."""
        primitives = _by_texture(one.mesh) if one.mesh is not None else [(PAINTED, np.concatenate(solids), None, None)]
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
                "attributes": {"POSITION": self._arrays.positions(line)},
                "material": self._material(_STREET),
                "mode": LINE_STRIP,
            }
            extras = {"name": edge["name"], "kind": edge["kind"], "width": 2.0 * float(edge["half_width"])}
            self._node(edge["name"] or f"street/{edge['index']}", [entry] if len(line) > 1 else [], extras)

    def add_terrain(self, terrain: Terrain) -> None:
        """Two triangles for each square of the grid."""
        points = _y_up(terrain.points.reshape(-1, 3))
        triangles = grid_triangles(np.arange(len(points)).reshape(terrain.heights.shape))
        entry = {
            "attributes": {"POSITION": self._arrays.positions(points)},
            "indices": self._arrays.indices(triangles.reshape(-1), len(points)),
            "material": self._material(_TERRAIN),
        }
        self._node("terrain", [entry], {})

    def pieces(self, extras: dict[str, Any]) -> list[bytes | bytearray]:
        """What makes the file when it is written one after another. Raises OverflowError past 4 GiB."""
        images = [number for number in self._materials if number >= 0]
        buffers, blobs, first_image = self._arrays.entries(png_bytes(self._textures[number].image) for number in images)
        textures = range(len(images))
        document: dict[str, Any] = {
            "asset": {"version": "2.0", "generator": GENERATOR, "extras": extras},
            "scene": 0,
            "scenes": [{"nodes": list(range(len(self._nodes)))} if self._nodes else {}],
            "nodes": self._nodes,
            "meshes": self._meshes,
            "materials": [self._material_entry(number, images) for number in self._materials],
            "textures": [{"source": i, "sampler": 0} for i in textures],
            "images": [
                {"name": self._textures[number].name, "bufferView": first_image + i, "mimeType": "image/png"}
                for i, number in enumerate(images)
            ],
            "samplers": [{"magFilter": LINEAR, "minFilter": TRILINEAR, "wrapS": REPEAT, "wrapT": REPEAT}]
            if images
            else [],
            **buffers,
        }
        return glb_pieces(document, blobs)

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
        attributes = {"POSITION": self._arrays.positions(columns[0][first])}
        if uv is not None:
            u, v = columns[1][first].T  # v up here, down there
            attributes["TEXCOORD_0"] = self._arrays.coordinates(np.stack([u, 1.0 - v], axis=1))
        if colors is not None:
            attributes["COLOR_0"] = self._arrays.colors(columns[-1][first])
        return {
            "attributes": attributes,
            "indices": self._arrays.indices(place, len(first)),
            "material": self._material(texture),
        }

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


def _by_texture(
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
