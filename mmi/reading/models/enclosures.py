"""What meshes hide that are no closed solids: the places on the map that closed walls go all the way around.

Take the walls of a building, and of all that touches it, which are closed from the ground up to a height
(:mod:`mmi.reading.models.opaque_walls`), and the faces into which they divide the map. Whoever is outside of a face, below the
top of the lowest of its walls, cannot look into it or through it: the sight enters at a wall, lower than it ends. So a prism
over the face, from the ground to that height, hides like a solid one, whatever the mesh is like inside: floors, roofs, party
walls may be missing, corners need not be shared, and faces may look either way. Where a party wall is missing, the face goes on
into the neighbour, to the far side of that. Where a front is missing or has a hole, sight runs in, and the face hides nothing.
Eyes above the prism do not matter: the sweep takes nothing to hide that is lower than the eye.

How high a face is closed is how high water stands in it before it runs off: over the lowest way out, across other faces. Those
that water joins on that way are one place, which a viewer inside of any part is in.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.cluster.hierarchy import DisjointSet
from shapely.geometry import Polygon

from mmi.city.model import CityObject, Prism, Texture
from mmi.city.terrain import Terrain
from mmi.reading.models.opaque_walls import Stretches, opaque_stretches
from mmi.reading.models.raw_meshes import linked
from mmi.reading.report import Ledger

__all__ = ["enclosing", "note_open"]

_LEAST_AREA = 4.0
"""Square metres: smaller places hide nothing worth a prism."""
_LOW = 2.0
"""Metres above the ground: lower walls hide nothing worth a prism, either."""
_TOUCH = 0.02
"""Metres between buildings that are looked at together."""
_NODES = 1e-4
"""Metres to which the corners of the map's faces are rounded."""
_DUST = 1e-3
"""Square metres of holes between walls that are there twice."""
_ON = 1e-3
"""Metres: an edge of the map this close to a stretch lies on it."""


class _Basins(NamedTuple):
    """Places that walls go around: ``shapes`` (n,) polygons, closed up to ``tops`` (n,)."""

    shapes: NDArray[np.object_]
    tops: NDArray[np.float64]


def enclosing(
    objects: Sequence[CityObject],
    open_ids: frozenset[str],
    ground: Terrain | float,
    textures: tuple[Texture, ...],
    ledger: Ledger,
) -> tuple[CityObject, ...]:
    """``objects``, of which those of ``open_ids``, whose meshes are not closed, hide what their walls enclose.

    They stand on the ``ground`` as they will be drawn. Walls with a cut-out among their ``textures`` do not count.
    """
    result = list(objects)
    open_ = np.array([i for i, one in enumerate(objects) if one.id in open_ids], dtype=np.int64)
    if not len(open_):
        return tuple(result)
    clear = np.array([texture.is_cut_out for texture in textures], dtype=bool)
    footprints = np.array([one.footprint for one in objects], dtype=object)
    one, other = shapely.STRtree(footprints).query(footprints[open_], predicate="dwithin", distance=_TOUCH)
    place = np.full(len(objects), -1)
    place[open_] = np.arange(len(open_))
    both = place[other] >= 0
    block = linked(len(open_), one[both], place[other[both]])
    heights = _heights(ground)
    enclosed = np.zeros(len(objects), dtype=bool)
    for k in range(int(block.max()) + 1):
        around = np.unique(other[block[one] == k])
        corners = np.concatenate([_opaque_corners(objects[i], clear) for i in around.tolist()])
        found = _basins(opaque_stretches(corners, heights, least=_LOW))
        tree = shapely.STRtree(footprints[around])
        basin, touched = tree.query(found.shapes, predicate="intersects")
        shared = shapely.area(shapely.intersection(found.shapes[basin], footprints[around[touched]]))
        for b, (shape, top) in enumerate(zip(found.shapes.tolist(), found.tops.tolist(), strict=True)):
            inside = np.flatnonzero(basin == b)
            if 2.0 * shared[inside].sum() < shape.area:
                continue  # a courtyard
            owner = int(around[touched[inside[np.argmax(shared[inside])]]])
            if place[owner] < 0:
                continue  # has a core of its own
            hidden = result[owner]
            # From the ground up, whatever the owner is: a roof that is an object of its own hangs in the air.
            foot = ground.under(found.shapes[b : b + 1])[0][0] if isinstance(ground, Terrain) else ground
            prism = Prism(shape, min(float(foot), top - _LOW), top)
            result[owner] = replace(hidden, core=(*(hidden.core or ()), prism))
            here = around[touched[inside]]
            enclosed[here[2.0 * shared[inside] >= shapely.area(footprints[here])]] = True
    for i in open_[enclosed[open_]].tolist():
        ledger.note("noted", "building: not closed, hides what its walls enclose", objects[i].id)
    note_open([result[i] for i in open_[~enclosed[open_]].tolist()], open_ids, ledger)
    return tuple(result)


def note_open(objects: Sequence[CityObject], open_ids: frozenset[str], ledger: Ledger) -> None:
    """Counts those of ``open_ids`` that hide nothing."""
    for one in objects:
        if one.id in open_ids and not one.core:
            ledger.note("noted", "building: not closed, hides nothing", one.id)


def _heights(ground: Terrain | float) -> Callable[[NDArray[np.float64]], NDArray[np.float64]]:
    if isinstance(ground, Terrain):
        return ground.at
    return lambda points: np.full(len(points), ground)


def _opaque_corners(one: CityObject, clear: NDArray[np.bool_]) -> NDArray[np.float64]:
    """(m, 3, 3) the triangles of an object's mesh but for cut-outs."""
    if one.mesh is None:
        return np.empty((0, 3, 3))
    textured = one.mesh.textures >= 0
    solid = np.ones(len(textured), dtype=bool)
    solid[textured] = ~clear[one.mesh.textures[textured]]
    return one.mesh.vertices[one.mesh.triangles[solid]]


def _basins(walls: Stretches) -> _Basins:
    """The largest places that walls enclose, each up to the height at which one looks in over the lowest of them."""
    if not len(walls.tops):
        return _Basins(np.empty(0, dtype=object), np.empty(0))
    lines = walls.lines
    noded = shapely.union_all(lines, grid_size=_NODES)
    faces = shapely.get_parts(shapely.polygonize(shapely.get_parts(noded)))
    faces = faces[shapely.get_type_id(faces) == 3]
    if not len(faces):
        return _Basins(np.empty(0, dtype=object), np.empty(0))
    ends, face, beyond = _edges(faces)
    height = _edge_heights(ends, lines, walls.tops)
    # Lowest edges first; of edges that are as high, those at the outside, so that what is as high stays apart.
    order = np.lexsort([beyond >= 0, height])
    places = DisjointSet(range(len(faces)))
    top = np.full(len(faces), -np.inf)
    flooded = np.zeros(len(faces), dtype=bool)

    for e in order.tolist():
        a, b = places[int(face[e])], places[int(beyond[e])] if beyond[e] >= 0 else -1
        outside = b < 0 or flooded[b]
        if outside or flooded[a]:
            for basin in (a, b):
                if basin >= 0 and not flooded[basin]:
                    flooded[basin], top[basin] = True, height[e]
        else:
            places.merge(a, b)
    roots = np.array([places[i] for i in range(len(faces))])
    shapes: list[Polygon] = []
    tops: list[float] = []
    for i in np.flatnonzero(np.isfinite(top)).tolist():
        if roots[i] != i:
            continue
        for part in shapely.get_parts(shapely.union_all(faces[roots == i])).tolist():
            if part.geom_type == "Polygon" and part.area >= _LEAST_AREA:
                shapes.append(shapely.Polygon(part.exterior, [r for r in part.interiors if Polygon(r).area > _DUST]))
                tops.append(float(np.floor(top[i] * 1e3) / 1e3))
    return _Basins(np.array(shapes, dtype=object), np.array(tops))


def _edges(
    faces: NDArray[np.object_],
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
    """The edges (n, 2, 2) between faces, a face (n,) that each bounds, and the other one (n,), -1 for the outside."""
    rings, owner = shapely.get_rings(faces, return_index=True)
    xy, ring = shapely.get_coordinates(rings, return_index=True)
    goes_on = ring[1:] == ring[:-1]
    ends = np.stack([xy[:-1], xy[1:]], axis=1)[goes_on]
    of = owner[ring[:-1][goes_on]]
    keys = np.rint(ends / _NODES).astype(np.int64)
    swapped = (keys[:, 0] > keys[:, 1])[:, 0] | ((keys[:, 0, 0] == keys[:, 1, 0]) & (keys[:, 0, 1] > keys[:, 1, 1]))
    keys[swapped] = keys[swapped][:, ::-1]
    _, first, name = np.unique(keys.reshape(-1, 4), axis=0, return_index=True, return_inverse=True)
    beyond = np.full(len(first), -1)
    name = name.reshape(-1)
    second = np.ones(len(of), dtype=bool)
    second[first] = False
    beyond[name[second]] = of[second]
    return ends[first], of[first].astype(np.int64), beyond


def _edge_heights(
    ends: NDArray[np.float64], lines: NDArray[np.object_], tops: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(n,) how high the highest of the walls is that all of an edge lies on."""
    edges = shapely.linestrings(ends)
    edge, wall = shapely.STRtree(lines).query(edges, predicate="dwithin", distance=_ON)
    on = np.ones(len(edge), dtype=bool)
    for end in range(2):
        on &= shapely.dwithin(shapely.points(ends[edge, end]), lines[wall], _ON)
    height = np.full(len(ends), -np.inf)
    np.maximum.at(height, edge[on], tops[wall[on]])
    return height
