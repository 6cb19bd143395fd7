"""From street network to land: blocks between the carriageways, lots by recursive halving, and walls that neighbours share.

Every function takes whole arrays of polygons and says for each result which input it came from.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from citygen.streets.networks import Network
from citygen.streets.ragged import are_convex, cut, following, from_rings, oriented_boxes, pairs, to_rings

__all__ = ["carve_blocks", "chamfer", "cut_lots", "grow", "subtract_cores", "weld"]

_ON = 0.002
"""Metres: a street this near to the border of a block runs along it."""
_NEAR = 0.1
"""Metres: corners nearer to each other are one, and a corner that near to a wall is on it: no wall and no gap is that short."""

_Polygons = NDArray[np.object_]
_Owners = NDArray[np.int64]


def carve_blocks(
    areas: _Polygons, network: Network, *, pavement: float, least: float = 150.0
) -> tuple[_Polygons, _Owners]:
    """What the carriageways and ``pavement`` metres beside them leave of the faces ``areas`` (f,).

    Blocks (b,), and which face each is part of. Pieces smaller than ``least`` square metres are left to the street.
    """
    convex = are_convex(areas, bend=0.03)  # what a slight bend costs is a wider pavement
    middles = shapely.line_interpolate_point(network.lines, 0.5, normalized=True)
    led_into, _ = shapely.STRtree(middles).query(grow(areas, -_ON), predicate="contains_properly")
    convex[led_into] = False  # a dead end lies inside
    straight = _inset(areas, np.flatnonzero(convex), network, pavement)
    bent = _without_streets(areas, np.flatnonzero(~convex), network, pavement)
    blocks, owners = (np.concatenate(both) for both in zip(straight, bent, strict=True))
    # What two streets pinch off is opened away: no block has a part narrower than this.
    opened = grow(grow(blocks, -4.0), 4.0)
    blocks, owners = _polygons(shapely.intersection(opened, blocks), owners)
    order = np.argsort(owners, kind="stable")
    order = order[shapely.area(blocks[order]) >= least]
    return blocks[order], owners[order]


def _inset(areas: _Polygons, which: _Owners, network: Network, pavement: float) -> tuple[_Polygons, _Owners]:
    """Convex faces, each cut along the edge of every street beside it."""
    if not len(which):
        return areas[which], which
    ends, street = shapely.get_coordinates(network.lines, return_index=True)
    inner = np.flatnonzero(np.diff(street) == 0)
    known = _names(ends[inner], ends[inner + 1])
    order = np.argsort(known, kind="stable")
    xy, owner = to_rings(areas[which])
    after = following(owner)
    place = order[np.clip(np.searchsorted(known[order], _names(xy, xy[after])), 0, len(order) - 1)]
    width = network.half_widths[street[inner[place]]] + pavement
    along = xy[after] - xy
    normals = np.stack([-along[:, 1], along[:, 0]], axis=1) / np.linalg.norm(along, axis=1)[:, None]
    points = xy + width[:, None] * normals
    first = np.searchsorted(owner, np.arange(len(which)))
    count = np.bincount(owner, minlength=len(which))
    rings = xy, owner
    for k in range(int(count.max())):
        edge = first + np.minimum(k, count - 1)
        rings, _ = cut(rings, points[edge[rings[1]]], normals[edge[rings[1]]])
    blocks, owners = from_rings(rings)
    return blocks, which[owners]


def _names(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.complex128]:
    """A name for each segment (n,), whichever way it runs: its middle, to the millimetre."""
    middle = np.round(500.0 * (a + b)) + 0.0
    return np.asarray(middle[:, 0] + 1j * middle[:, 1])


def _without_streets(areas: _Polygons, which: _Owners, network: Network, pavement: float) -> tuple[_Polygons, _Owners]:
    """Faces of any shape less the strips that streets take."""
    strips = shapely.buffer(network.lines, network.half_widths + pavement, quad_segs=2, join_style="mitre")
    left = areas[which]
    tree = shapely.STRtree(strips)
    for i, face in enumerate(left):
        beside = strips[np.sort(tree.query(face, predicate="intersects"))]
        left[i] = shapely.difference(face, shapely.union_all(beside))
    return _polygons(shapely.simplify(left, 0.25), which)


def grow(polygons: _Polygons, distance: ArrayLike, *, corners: Literal["mitre", "bevel"] = "mitre") -> _Polygons:
    """The polygons with all within ``distance`` metres of them; shrunk, if it is negative."""
    with np.errstate(divide="ignore", invalid="ignore"):  # GEOS divides by the length of what vanishes
        return np.asarray(shapely.buffer(polygons, distance, join_style=corners, mitre_limit=2.0))


def chamfer(blocks: _Polygons, distance: NDArray[np.float64]) -> _Polygons:
    """The blocks (b,) with their corners cut off, some ``distance`` (b,) metres along either side."""
    grown = grow(grow(blocks, -distance), distance, corners="bevel")
    cut = shapely.simplify(shapely.intersection(grown, blocks), 0.2)
    return np.where((shapely.get_type_id(cut) == 3) & ~shapely.is_empty(cut), cut, blocks)


def cut_lots(
    blocks: _Polygons, targets: NDArray[np.float64], rng: np.random.Generator, *, spread: float = 0.35
) -> tuple[_Polygons, _Owners]:
    """Lots of some ``targets`` (b,) square metres: blocks (b,) are halved across their longer side until they are small enough.

    All lots of a level are halved at once. ``spread`` is the standard deviation of the logarithm of a lot's area.
    """
    done: list[_Polygons] = []
    done_owners: list[_Owners] = []
    lots, owners = blocks, np.arange(len(blocks))
    limits = targets * 1.45 * np.exp(rng.normal(0.0, spread, len(blocks)))
    while len(lots):
        whole = shapely.area(lots) <= limits
        done.append(lots[whole])
        done_owners.append(owners[whole])
        lots, owners = lots[~whole], owners[~whole]
        lots, owners = _halve(lots, owners, rng)
        limits = targets[owners] * 1.45 * np.exp(rng.normal(0.0, spread, len(owners)))
    lots, owners = np.concatenate(done), np.concatenate(done_owners)
    order = np.argsort(owners, kind="stable")
    return lots[order], owners[order]


def _halve(lots: _Polygons, owners: _Owners, rng: np.random.Generator) -> tuple[_Polygons, _Owners]:
    """Both sides of a line near the middle of each lot, across its longer side."""
    if not len(lots):
        return lots, owners
    middle, along, size = oriented_boxes(lots)
    middle += along * (size[:, 0] * rng.uniform(-0.1, 0.1, len(lots)))[:, None]
    convex = are_convex(lots)
    xy, owner = to_rings(lots[convex])
    halves = [from_rings(ring) for ring in cut((xy, owner), middle[convex][owner], along[convex][owner])]
    halves = [(parts, owners[convex][places]) for parts, places in halves]
    halves += _halve_bent(lots[~convex], owners[~convex], middle[~convex], along[~convex], size[~convex])
    parts, whose = (np.concatenate(both) for both in zip(*halves, strict=True))
    large = shapely.area(parts) > 1.0
    return parts[large], whose[large]


def _halve_bent(
    lots: _Polygons,
    owners: _Owners,
    middle: NDArray[np.float64],
    along: NDArray[np.float64],
    size: NDArray[np.float64],
) -> list[tuple[_Polygons, _Owners]]:
    """Both sides of lots of any shape, of lines through ``middle`` (n, 2) square to ``along`` (n, 2)."""
    far = 2.0 * size.sum(axis=1)[:, None]
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    low, high = middle - far * across, middle + far * across
    beyond = [np.stack([low, high, high + s * far * along, low + s * far * along], axis=1) for s in (1.0, -1.0)]
    return [_polygons(shapely.intersection(lots, shapely.polygons(one)), owners) for one in beyond]


def subtract_cores(lots: _Polygons, cores: _Polygons) -> tuple[_Polygons, _Owners]:
    """What of each lot (n,) lies outside its core (n,): polygons, and whose they are.

    Most lots are convex and meet one edge of a convex core: these are cut all at once.
    """
    pieces: list[_Polygons] = []
    owners: list[_Owners] = []
    filled = ~shapely.is_empty(cores)
    simple = np.flatnonzero(filled & are_convex(lots) & are_convex(np.where(filled, cores, lots)))
    others = np.setdiff1d(np.flatnonzero(filled), simple)
    if len(simple):
        cxy, cowner = to_rings(cores[simple])
        normals = cxy[following(cowner)] - cxy
        normals = np.stack([-normals[:, 1], normals[:, 0]], axis=1)
        xy, owner = to_rings(lots[simple])
        # Side > 0 is towards the core.
        edges = np.bincount(cowner)
        e, c, run = pairs(cowner, owner)
        side = ((xy[c] - cxy[e]) * normals[e]).sum(axis=1)
        inside, outside = np.maximum.reduceat(side, run) > 1e-6, np.minimum.reduceat(side, run) < -1e-6
        start = np.concatenate([[0], np.cumsum(edges)[:-1]])
        apart = np.add.reduceat(~inside, start) > 0
        crossed = np.add.reduceat(inside & outside, start)
        once = ~apart & (crossed == 1)
        edge = start.copy()
        edge[cowner[inside & outside]] = np.flatnonzero(inside & outside)
        chosen = once[owner]
        _, beyond = cut((xy[chosen], owner[chosen]), cxy[edge[owner[chosen]]], normals[edge[owner[chosen]]])
        found, places = from_rings(beyond)
        pieces += [found, lots[simple[apart]]]
        owners += [simple[places], simple[apart]]
        others = np.concatenate([others, simple[~apart & (crossed > 1)]])
    rest, places = _polygons(shapely.difference(lots[others], cores[others]), others)
    pieces += [rest, lots[~filled]]
    owners += [places, np.flatnonzero(~filled)]
    order = np.argsort(np.concatenate(owners), kind="stable")
    return np.concatenate(pieces)[order], np.concatenate(owners)[order]


def weld(pieces: _Polygons) -> _Polygons:
    """The pieces (n,) with walls that neighbours share vertex by vertex: where a corner meets a wall, the wall has one, too.

    Corners are rounded to the millimetre, and those that nearly meet are one: walls may turn a little, and a hole, spike or
    neck that is no wider than that is closed (of a piece in parts, the largest stays). The pieces are wider than that.
    """
    if not len(pieces):
        return pieces
    rings, piece = shapely.get_rings(pieces, return_index=True)
    xy, ring = shapely.get_coordinates(rings, return_index=True)
    xy, ring = _distinct(np.round(xy, 3) + 0.0, ring)
    starts = np.flatnonzero(np.diff(ring) == 0)
    names = np.round(1000.0 * xy) @ np.array([1.0, 1j])
    unique, which = np.unique(names, return_index=True)
    walls = shapely.STRtree(shapely.linestrings(np.stack([xy[starts], xy[starts + 1]], axis=1)))
    corner, wall = walls.query(shapely.points(xy[which]), predicate="dwithin", distance=_NEAR)
    inside = (unique[corner] != names[starts[wall]]) & (unique[corner] != names[starts[wall] + 1])
    corner, start = which[corner[inside]], starts[wall[inside]]
    along = xy[start + 1] - xy[start]
    t = ((xy[corner] - xy[start]) * along).sum(axis=1) / (along**2).sum(axis=1)
    proper = (t > 0.0) & (t < 1.0)
    corner, start, t = corner[proper], start[proper], t[proper]
    order = np.lexsort((np.concatenate([np.zeros(len(xy)), t]), np.concatenate([np.arange(len(xy)), start])))
    xy, ring = np.concatenate([xy, xy[corner]])[order], np.concatenate([ring, ring[start]])[order]
    xy, ring = _distinct(_gathered(xy), ring)
    wide = np.bincount(ring)[ring] > 3
    left, ring = np.unique(ring[wide], return_inverse=True)
    welded = shapely.polygons(shapely.linearrings(xy[wide], indices=ring), indices=piece[left])
    folded = np.flatnonzero(~shapely.is_valid(welded))
    parts, whose = shapely.get_parts(
        shapely.make_valid(welded[folded], method="structure", keep_collapsed=False), return_index=True
    )
    largest = np.lexsort((shapely.area(parts), whose))
    welded[folded[whose[largest]]] = parts[largest]  # the last assignment stays
    return np.asarray(welded)


def _distinct(xy: NDArray[np.float64], ring: _Owners) -> tuple[NDArray[np.float64], _Owners]:
    """The points (n, 2) of rings ``ring`` (n,) but those that lie where the one before them does."""
    new = np.append(True, (np.diff(ring) != 0) | (np.diff(xy, axis=0) != 0.0).any(axis=1))
    return xy[new], ring[new]


def _gathered(xy: NDArray[np.float64]) -> NDArray[np.float64]:
    """The points (n, 2), each moved to the first of those that it nearly meets."""
    _, start, which = np.unique(xy @ np.array([1.0, 1j]), return_index=True, return_inverse=True)
    places = xy[start]
    pairs = cKDTree(places).query_pairs(_NEAR, output_type="ndarray")
    links = coo_array((np.ones(len(pairs), dtype=bool), (pairs[:, 0], pairs[:, 1])), shape=(len(places), len(places)))
    _, group = connected_components(links, directed=False)
    _, first = np.unique(group, return_index=True)
    return np.asarray(places[first[group[which]]])


def _polygons(shapes: _Polygons, owners: _Owners) -> tuple[_Polygons, _Owners]:
    """The polygons among the parts of the shapes, with their owners."""
    parts, index = shapely.get_parts(shapes, return_index=True)
    solid = (shapely.get_type_id(parts) == 3) & (shapely.area(parts) > 1.0)
    return parts[solid], owners[index[solid]]
