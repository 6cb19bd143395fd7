"""City objects, streets and ground as CityJSON's City Objects: whole numbers of millimetres, and indices of them.

Prisms become Solids of LoD 1.2 with whole walls and roofs, courtyards as inner rings; meshes become Solids of triangles where
they are closed, else MultiSurfaces. Several prisms, or parts of a mesh, are one CompositeSolid: a Building may have no
MultiSolid, and readers take one geometry of a level. (Nothing here makes sure that its solids touch without overlapping.)

Rounding moves nothing further than 0.5 mm in each direction, and opens nothing: triangles that collapse take their neighbours'
edges with them; footprints that it makes invalid are repaired on the grid of millimetres. A prism flatter or thinner than a
millimetre vanishes, so an object that has nothing else is left without geometry.

Source: CityJSON 2.0.1 (OGC 20-072r5), sections on City Objects, Geometry Objects and Appearance.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import networkx as nx
import numpy as np
import shapely
from numpy.typing import NDArray

from mmi.city.model import PLAIN, CityObject, Prism, TriangleMesh
from mmi.city.outlines import outlines_of
from mmi.city.terrain import Terrain, grid_triangles
from mmi.city.welding import is_closed, volume, weld
from mmi.reading.models.needles import without_needles
from mmi.reading.models.raw_meshes import linked

__all__ = ["SCALE", "Named", "Pools", "buildings", "millimetres", "reliefs", "roads"]

SCALE = 0.001
"""Metres that one step of a written coordinate is."""

_THEME = "default"
_SEMANTICS = ("GroundSurface", "RoofSurface", "WallSurface")
_GROUND, _ROOF, _WALL = range(3)
_STEEP = np.cos(np.radians(80.0))  # vertical part of a wall's normal, at most
_DETAILED = 100  # triangles from which a mesh is LoD 3
_FLAT = 0.5  # cubic millimetres: what encloses less is no solid
_TILE = 256  # squares of terrain along the side of one TINRelief

Named = tuple[str, dict[str, Any], "Pools"]
_Point = tuple[int, ...]


class Pools:
    """What City Objects share by index: vertices, colours, textures and their coordinates, numbered as they come."""

    def __init__(self) -> None:
        self._vertices: dict[_Point, int] = {}
        self._materials: dict[tuple[int, ...], int] = {}
        self._textures: dict[int, int] = {}
        self._uv: dict[tuple[float, ...], int] = {}

    def vertices(self, points: Iterable[_Point]) -> list[int]:
        """Indices of ``points``, in millimetres."""
        known = self._vertices
        return [known.setdefault(point, len(known)) for point in points]

    def material(self, color: tuple[int, ...]) -> int:
        """Index of a colour, sRGB bytes."""
        return self._materials.setdefault(color, len(self._materials))

    def texture(self, number: int) -> int:
        """Index of the city's texture ``number``."""
        return self._textures.setdefault(number, len(self._textures))

    def uv(self, pairs: Iterable[tuple[float, ...]]) -> list[int]:
        """Indices of texture coordinates."""
        known = self._uv
        return [known.setdefault(pair, len(known)) for pair in pairs]

    @property
    def points(self) -> list[_Point]:
        """All vertices."""
        return list(self._vertices)

    @property
    def used_textures(self) -> list[int]:
        """The city's textures that were asked for."""
        return list(self._textures)

    def appearance(self, files: Sequence[str]) -> dict[str, Any]:
        """CityJSON's Appearance Object; ``files`` are where the city's textures lie. Empty where nothing has looks."""
        entry: dict[str, Any] = {}
        if self._materials:
            entry["materials"] = [
                {"name": "#{:02x}{:02x}{:02x}".format(*color), "diffuseColor": [round(c / 255.0, 4) for c in color]}
                for color in self._materials
            ]
        if self._textures:
            entry["textures"] = [{"type": "PNG", "image": files[i], "wrapMode": "wrap"} for i in self._textures]
            entry["vertices-texture"] = list(self._uv)
        return entry


def millimetres(metres: NDArray[np.float64]) -> NDArray[np.int64]:
    """Metres as whole steps of :data:`SCALE`, any shape."""
    return np.rint(metres / SCALE).astype(np.int64)


def buildings(objects: Sequence[CityObject], pools: Callable[[], Pools]) -> Iterator[Named]:
    """Id, City Object and pools of each object; ``pools`` gives the pools of each."""
    solids = [prism for one in objects if one.mesh is None for prism in one.prisms]
    shapes = iter(_rounded(solids))
    for one in objects:
        own = pools()
        geometry: list[dict[str, Any]] = []
        if one.mesh is not None:
            geometry = _mesh_geometry(one.mesh, own)
        else:
            for prism in one.prisms:
                bottom, top = round(prism.bottom / SCALE), round(prism.top / SCALE)
                for rings in next(shapes):
                    if bottom < top:
                        geometry.append(_solid(rings, bottom, top, own))
        entry: dict[str, Any] = {"type": "Building"}
        yield one.id, entry | ({"geometry": [_composed(geometry)]} if geometry else {}), own


def roads(
    graph: nx.MultiGraph, ground_at: Callable[[NDArray[np.float64]], NDArray[np.float64]], pools: Callable[[], Pools]
) -> Iterator[Named]:
    """A Road for each street, in the order of their ``index``, on the ground: ``ground_at`` gives heights of (n, 2)."""
    edges = sorted((edge for _, _, edge in graph.edges(data=True)), key=lambda edge: int(edge["index"]))
    for edge in edges:
        own = pools()
        points = shapely.get_coordinates(edge["geometry"])
        line = [tuple(point) for point in millimetres(np.column_stack([points, ground_at(points)])).tolist()]
        line = line[:1] + [after for before, after in pairwise(line) if before != after]
        entry: dict[str, Any] = {
            "type": "Road",
            "attributes": {"name": edge["name"], "highway": edge["kind"], "width": 2.0 * float(edge["half_width"])},
        }
        if len(line) > 1:
            entry["geometry"] = [{"type": "MultiLineString", "lod": "0", "boundaries": [own.vertices(line)]}]
        yield f"street/{edge['index']}", entry, own


def reliefs(terrain: Terrain, pools: Callable[[], Pools]) -> Iterator[Named]:
    """The ground as TINReliefs, two triangles a square of its grid: ``terrain``, or ``terrain/ROW-COLUMN`` if it is large."""
    rows, columns = terrain.heights.shape
    starts = [(j, i) for j in range(0, rows - 1, _TILE) for i in range(0, columns - 1, _TILE)]
    for j, i in starts:
        own = pools()
        points = millimetres(terrain.points[j : j + _TILE + 1, i : i + _TILE + 1])
        index = np.array(own.vertices(map(tuple, points.reshape(-1, 3).tolist())), dtype=np.int64)
        triangles = grid_triangles(index.reshape(points.shape[:2])).reshape(-1, 1, 3)
        geometry = {"type": "CompositeSurface", "lod": "1", "boundaries": triangles.tolist()}
        name = "terrain" if len(starts) == 1 else f"terrain/{j // _TILE}-{i // _TILE}"
        yield name, {"type": "TINRelief", "geometry": [geometry]}, own


def _composed(parts: list[dict[str, Any]]) -> dict[str, Any]:
    """Solids as one CompositeSolid: readers take one geometry at a level of detail."""
    if len(parts) == 1:
        return parts[0]
    whole = {"type": "CompositeSolid", "lod": parts[0]["lod"], "boundaries": [part["boundaries"] for part in parts]}
    values = [part["semantics"]["values"] for part in parts]
    whole["semantics"] = {"surfaces": parts[0]["semantics"]["surfaces"], "values": values}
    for looks, none in (("material", None), ("texture", [[None]])):
        if any(looks in part for part in parts):
            own = [
                part[looks][_THEME]["values"]
                if looks in part
                else [[none] * len(shell) for shell in part["boundaries"]]
                for part in parts
            ]
            whole[looks] = {_THEME: {"values": own}}
    return whole


# ---------------------------------------------------------------------------------------------------------- prisms

_Ring = list[list[int]]


def _rounded(prisms: Sequence[Prism]) -> list[list[list[_Ring]]]:
    """Per prism the polygons that its footprint is in millimetres (one, rarely more or none), as rings of [x, y]."""
    result: list[list[list[_Ring]]] = [[] for _ in prisms]
    if not prisms:
        return result
    footprints = np.array([prism.footprint for prism in prisms])
    whole = shapely.transform(footprints, lambda points: np.rint(points / SCALE))
    bad = ~shapely.is_valid(whole)
    whole[bad] = shapely.set_precision(shapely.transform(footprints[bad], lambda points: points / SCALE), 1.0)
    parts, of = shapely.get_parts(whole, return_index=True)
    filled = ~shapely.is_empty(parts)
    parts, of = shapely.orient_polygons(parts[filled]), of[filled].tolist()
    outlines = outlines_of(parts)
    points, following = outlines.edges
    distinct = (points != following).any(axis=1)
    ends = np.searchsorted(outlines.edge_rings[distinct], np.arange(len(outlines.polygon) + 1)).tolist()
    corners = points[distinct].astype(np.int64).tolist()
    polygons: list[list[_Ring]] = [[] for _ in parts]
    for (start, end), part in zip(pairwise(ends), outlines.polygon.tolist(), strict=True):
        polygons[part].append(corners[start:end])
    for polygon, prism in zip(polygons, of, strict=True):
        result[prism].append(polygon)
    return result


def _solid(rings: list[_Ring], bottom: int, top: int, pools: Pools) -> dict[str, Any]:
    """The rings (outer counter-clockwise, inner clockwise) raised from ``bottom`` to ``top``."""
    floor, roof, walls = [], [], []
    for ring in rings:
        low = pools.vertices([(x, y, bottom) for x, y in ring])
        high = pools.vertices([(x, y, top) for x, y in ring])
        roof.append(high)
        floor.append(low[::-1])
        corners = zip(low, low[1:] + low[:1], high[1:] + high[:1], high, strict=True)
        walls += [[[a, b, c, d]] for a, b, c, d in corners]
    values = [_GROUND, _ROOF, *[_WALL] * len(walls)]
    return {
        "type": "Solid",
        "lod": "1.2",
        "boundaries": [[floor, roof, *walls]],
        "semantics": {"surfaces": [{"type": name} for name in _SEMANTICS], "values": [values]},
    }


# ---------------------------------------------------------------------------------------------------------- meshes


def _mesh_geometry(mesh: TriangleMesh, pools: Pools) -> list[dict[str, Any]]:
    """A Solid for each part if the mesh is closed and faces outwards, else a MultiSurface; nothing if all of it collapsed."""
    mesh = without_needles(replace(mesh, vertices=(millimetres(mesh.vertices) * SCALE).astype(np.float64)))
    points = millimetres(mesh.vertices)
    place = weld(points)
    at = np.zeros((int(place.max(initial=-1)) + 1, 3), dtype=np.int64)
    at[place] = points
    corners = place[mesh.triangles].astype(np.int64)
    rows = np.flatnonzero((corners != np.roll(corners, -1, axis=1)).all(axis=1))
    parts = _components(corners[rows], rows) if is_closed(at, corners[rows]) else []
    solids = [part for part in parts if volume(at, corners[part]) > _FLAT]
    rest = np.setdiff1d(rows, np.concatenate([np.empty(0, dtype=np.int64), *solids]))
    lod = "3" if len(mesh.triangles) >= _DETAILED else "2"
    if solids and not len(rest):
        return [_dressed("Solid", lod, mesh, corners, at, part, pools) for part in solids]
    return [_dressed("MultiSurface", lod, mesh, corners, at, rows, pools)] if len(rows) else []


def _components(corners: NDArray[np.int64], rows: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """``rows`` in groups of connected triangles, in the order of the first of each group."""
    a, b = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]]]).T
    part = linked(int(corners.max()) + 1, a, b)
    own = part[corners[:, 0]]
    names, first = np.unique(own, return_index=True)
    return [rows[own == name] for name in names[np.argsort(first)]]


def _dressed(
    kind: str,
    lod: str,
    mesh: TriangleMesh,
    corners: NDArray[np.int64],
    at: NDArray[np.int64],
    rows: NDArray[np.int64],
    pools: Pools,
) -> dict[str, Any]:
    """Triangles ``rows`` with semantics, colours and textures."""
    chosen = corners[rows]
    used, inverse = np.unique(chosen, return_inverse=True)
    index = np.array(pools.vertices(map(tuple, at[used].tolist())), dtype=np.int64)
    p, q, r = np.moveaxis(at[chosen].astype(np.float64), 1, 0)
    cross = np.cross(q - p, r - p)
    rise = cross[:, 2] / np.maximum(np.linalg.norm(cross, axis=1), 1e-9)
    kinds = np.where(rise > _STEEP, _ROOF, np.where(rise < -_STEEP, _GROUND, _WALL))

    def nest(values: list[Any]) -> list[Any]:
        return [values] if kind == "Solid" else values

    entry: dict[str, Any] = {
        "type": kind,
        "lod": lod,
        "boundaries": nest(index[inverse].reshape(-1, 1, 3).tolist()),
        "semantics": {"surfaces": [{"type": name} for name in _SEMANTICS], "values": nest(kinds.tolist())},
    }
    textures, colors = mesh.textures[rows], mesh.colors[rows]
    colored = (textures == PLAIN) | ((textures >= 0) & (colors != 255).any(axis=1))
    if colored.any():
        pairs = zip(colored.tolist(), map(tuple, colors.tolist()), strict=True)
        entry["material"] = {_THEME: {"values": nest([pools.material(color) if own else None for own, color in pairs])}}
    if (textures >= 0).any():
        entry["texture"] = {_THEME: {"values": nest(_rings_of_texture(mesh, rows, pools))}}
    return entry


def _rings_of_texture(mesh: TriangleMesh, rows: NDArray[np.int64], pools: Pools) -> list[Any]:
    """Per triangle, for its one ring: the texture and the places of its corners in it, or null."""
    textures = mesh.textures[rows]
    numbers, inverse = np.unique(mesh.uv[rows][textures >= 0], return_inverse=True)
    shortest = np.array([float(text) for text in numbers.astype(str)])  # decimals that are this single-precision number
    index = iter(pools.uv(map(tuple, shortest[inverse].reshape(-1, 2).tolist())))
    return [
        [[pools.texture(texture), next(index), next(index), next(index)]] if texture >= 0 else [[None]]
        for texture in textures.tolist()
    ]
