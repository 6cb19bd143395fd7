"""One mesh of a whole city ("triangle soup") into its buildings and its ground.

Corners are welded, faces that show nothing or show twice are dropped, the ground is taken away (it may be welded to the
walls that stand on it), and what still hangs together is a part. Parts are one building if the plan of one lies mostly over
that of the other, or if one stands on the other: a house keeps its dormers and chimneys. Nothing depends on the order of
triangles or vertices in the file.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mmi.city.model import TriangleMesh
from mmi.reading.models.raw_meshes import linked
from mmi.reading.raw_layers import RawModel
from mmi.reading.report import Ledger

__all__ = ["split_into_objects", "welded"]

_WELD = 0.001
"""Metres within which corners are one."""
_TOUCH = 0.05
"""Metres between plans, or between the top of a part and the foot of the next, that count as touching."""
_STOREY = 2.0
"""Metres by which the foot of a part that stands on another is higher than the other's foot, at least."""
_LEVEL = 0.7
"""Upward share of the normal of a triangle that may be ground: slopes up to 45 degrees."""
_WIDE = 50.0
"""Metres across, and the share below of the whole plan, from which a level surface may be ground."""
_WIDE_SHARE = 0.02
_OPEN_SHARE = 0.6
"""Share of a surface's box that the box of its free edges has at least if it is ground: a floor has walls all around."""
_EAVES = 2.0
"""Metres in plan from the rim of a roof to its walls."""
_ROOF_SHARE = 0.5
"""A surface with walls below at least this share of its rim is a roof; an embankment has fewer."""
_LOW = 0.6
"""Metres: what is lower is a kerb or a plate, not a building."""
_SMALL = 1.0
"""Metres: what is smaller in all directions is furniture."""
_CITY = 100.0
"""Metres: a model at least so wide is taken for a city in metres; the sizes above are used only then."""


def split_into_objects(
    mesh: TriangleMesh, ledger: Ledger, *, tolerance: float = _WELD
) -> tuple[tuple[RawModel, ...], TriangleMesh | None]:
    """The buildings of ``mesh`` from west to east, and its ground (None: it has none).

    Ids are the middles of the buildings' bounding boxes in metres, ``mesh/x,y``; ``tolerance`` is the distance in metres
    within which corners are taken for one.
    """
    mesh = welded(mesh, ledger, tolerance=tolerance)
    if not len(mesh.triangles):
        return (), None
    size = np.ptp(mesh.vertices[np.unique(mesh.triangles)], axis=0)
    in_metres = bool(np.hypot(size[0], size[1]) > _CITY)
    is_ground = _find_ground(mesh, float(size[0] * size[1])) if in_metres else np.zeros(len(mesh.triangles), dtype=bool)
    ground = mesh.picked(np.flatnonzero(is_ground)) if is_ground.any() else None
    ledger.note("noted", "triangles of one mesh taken for the ground", count=int(is_ground.sum()))
    rest = np.flatnonzero(~is_ground)
    if not rest.size:
        return (), ground
    labels, boxes = _parts(mesh, rest)
    owners = _merged(mesh, rest, labels, boxes)
    ledger.note("noted", "parts joined to the building that they belong to", count=len(boxes) - int(owners.max()) - 1)
    order = np.argsort(owners[labels], kind="stable")
    shares = np.split(rest[order], np.cumsum(np.bincount(owners[labels]))[:-1])
    low, high = _extents(mesh.vertices[mesh.triangles[rest]], owners[labels])
    # The last bits of a sum are left out before rounding, so that a half is the same half in every reading.
    middles = np.round(np.round(0.5 * (low + high), 6)).astype(np.int64)
    too_small = (high[:, 2] - low[:, 2] < _LOW) | (high - low < _SMALL).all(axis=1)
    models: list[RawModel] = []
    taken: dict[str, int] = {}
    for share, (x, y, _), small in zip(shares, middles, too_small & in_metres, strict=True):
        name = f"mesh/{x},{y}"
        if small:
            ledger.note("left out", f"part of a mesh: lower than {_LOW} m or smaller than {_SMALL:.0f} m", name)
            continue
        taken[name] = taken.get(name, 0) + 1
        if taken[name] > 1:
            name = f"{name}#{taken[name]}"
        models.append(RawModel(name, mesh.picked(share)))
    return tuple(models), ground


def welded(mesh: TriangleMesh, ledger: Ledger, *, tolerance: float = _WELD) -> TriangleMesh:
    """The mesh with corners within ``tolerance`` metres as one, less triangles that have no area or are there twice.

    Vertices come sorted by their coordinates, triangles by their vertices: the file's order leaves no trace.
    """
    points, place = np.unique(mesh.vertices, axis=0, return_inverse=True)
    pairs = cKDTree(points).query_pairs(tolerance, output_type="ndarray") if tolerance > 0.0 else np.empty((0, 2), int)
    clusters = linked(len(points), pairs[:, 0], pairs[:, 1])
    # Points are sorted: the first of a cluster is the same one in every order of the file.
    _, first = np.unique(clusters, return_index=True)
    triangles = clusters[place.reshape(-1)][mesh.triangles]
    points = points[first]
    a, b, c = np.moveaxis(points[triangles], 1, 0)
    longest = np.sqrt(np.max([((p - q) ** 2).sum(axis=1) for p, q in ((a, b), (b, c), (c, a))], axis=0))
    height = np.linalg.norm(np.cross(b - a, c - a), axis=1) / np.maximum(longest, 1e-300)
    sound = np.flatnonzero(height > 0.1 * tolerance)
    ledger.note("repaired", "triangle without area dropped", count=len(triangles) - len(sound))
    # Of equal ones the one with a picture stays, then the one that starts the lowest way round.
    corners = triangles[sound]
    turned = np.take_along_axis(corners, (corners.argmin(axis=1)[:, None] + np.arange(3)) % 3, axis=1)
    low = np.sort(corners, axis=1)
    order = np.lexsort((turned[:, 1], -mesh.textures[sound], low[:, 2], low[:, 1], low[:, 0]))
    same = np.zeros(len(low), dtype=bool)
    same[1:] = (low[order][1:] == low[order][:-1]).all(axis=1)
    keep = sound[order[~same]]
    ledger.note("repaired", "triangle that is there twice dropped", count=int(same.sum()))
    return TriangleMesh(points, triangles[keep].astype(np.int32), mesh.textures[keep], mesh.colors[keep], mesh.uv[keep])


def _normals(mesh: TriangleMesh) -> NDArray[np.float64]:
    """Normals (m, 3) as long as twice the area."""
    a, b, c = np.moveaxis(mesh.vertices[mesh.triangles], 1, 0)
    return np.cross(b - a, c - a)


def _find_ground(mesh: TriangleMesh, plan: float) -> NDArray[np.bool_]:
    """Which triangles are ground: wide level surfaces, smooth across their edges, with free edges, and not roofs.

    ``plan`` is the area of the whole model's box, square metres.
    """
    normals = _normals(mesh)
    size = np.linalg.norm(normals, axis=1)
    level = np.flatnonzero(np.abs(normals[:, 2]) > _LEVEL * size)
    is_ground = np.zeros(len(mesh.triangles), dtype=bool)
    if not level.size:
        return is_ground
    # Surfaces: level triangles that share an edge.
    corners = mesh.triangles
    edges = np.sort(np.stack([corners, np.roll(corners, -1, axis=1)], axis=-1), axis=2).reshape(-1, 2)
    _, edge = np.unique(edges[:, 0].astype(np.int64) * len(mesh.vertices) + edges[:, 1], return_inverse=True)
    edge = edge.reshape(-1, 3)
    uses = np.bincount(edge.ravel())
    flat = edge[level].ravel()
    of = np.repeat(np.arange(len(level)), 3)
    order = np.argsort(flat, kind="stable")
    same = np.flatnonzero(flat[order][1:] == flat[order][:-1])
    surfaces = linked(len(level), of[order[same]], of[order[same + 1]])
    low, high = _extents(mesh.vertices[corners[level]], surfaces)
    span = high - low
    wide = (np.hypot(span[:, 0], span[:, 1]) > _WIDE) & (span[:, 0] * span[:, 1] > _WIDE_SHARE * plan)
    for surface in np.flatnonzero(wide):
        mine = level[surfaces == surface]
        open_edges = edges.reshape(-1, 3, 2)[mine][uses[edge[mine]] == 1]
        if not len(open_edges):
            continue
        reach = np.ptp(mesh.vertices[open_edges.ravel(), :2], axis=0)
        if reach[0] * reach[1] < _OPEN_SHARE * span[surface, 0] * span[surface, 1]:
            continue
        own = edge[mine].ravel()
        rim = np.unique(edges.reshape(-1, 3, 2)[mine][np.bincount(own, minlength=len(uses))[edge[mine]] == 1])
        others = np.setdiff1d(np.unique(corners), corners[mine])
        if _share_above(mesh.vertices[rim], mesh.vertices[others]) < _ROOF_SHARE:
            is_ground[mine] = True
    return is_ground


def _share_above(rim: NDArray[np.float64], others: NDArray[np.float64]) -> float:
    """Share of the points ``rim`` (n, 3) that have one of ``others`` (k, 3) below them, as the rim of a roof has its walls."""
    if not len(others):
        return 0.0
    many = min(8, len(others))
    distance, nearest = cKDTree(others[:, :2]).query(rim[:, :2], k=[*range(1, many + 1)], distance_upper_bound=_EAVES)
    depth = rim[:, 2:] - others[np.minimum(nearest, len(others) - 1), 2]
    return float((np.isfinite(distance) & (depth > _SMALL)).any(axis=1).mean())


def _extents(
    corners: NDArray[np.float64], labels: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Lowest and highest corners (k, 3) of the triangles (m, 3, 3) of each label."""
    order = np.argsort(labels, kind="stable")
    starts = np.flatnonzero(np.r_[True, np.diff(labels[order]) > 0])
    return (
        np.minimum.reduceat(corners.min(axis=1)[order], starts),
        np.maximum.reduceat(corners.max(axis=1)[order], starts),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Boxes:
    """Lowest and highest corners (k, 3) of parts."""

    low: NDArray[np.float64]
    high: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.low)


def _parts(mesh: TriangleMesh, rest: NDArray[np.intp]) -> tuple[NDArray[np.int64], _Boxes]:
    """Label (m,) of each of the triangles ``rest``: what shares corners is one part, parts in the order of their boxes."""
    used, corners = np.unique(mesh.triangles[rest], return_inverse=True)
    corners = corners.reshape(-1, 3)
    joined = linked(len(used), corners[:, :2].ravel(), corners[:, 1:].ravel())
    labels = joined[corners[:, 0]]
    low, high = _extents(mesh.vertices[mesh.triangles[rest]], labels)
    order = np.lexsort((*high.T[::-1], *low.T[::-1]))
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order))
    return rank[labels], _Boxes(low[order], high[order])


def _plans(mesh: TriangleMesh, rest: NDArray[np.intp], labels: NDArray[np.int64], boxes: _Boxes) -> NDArray[np.object_]:
    """What each part covers, seen from above; the hull of its corners where that is nearly nothing (a fence)."""
    flat = mesh.vertices[mesh.triangles[rest]][:, :, :2]
    a, b, c = np.moveaxis(flat, 1, 0)
    area = 0.5 * np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    # A roof and the floor below it cover the same: one of them is enough.
    key = np.round(np.sort(flat[:, :, 0], axis=1).sum(axis=1) * 1e3) * 1e3 + np.round(flat[:, :, 1].sum(axis=1) * 1e3)
    order = np.lexsort((area, key, labels))
    twin = np.zeros(len(rest), dtype=bool)
    twin[order[1:]] = (
        (labels[order][1:] == labels[order][:-1])
        & (key[order][1:] == key[order][:-1])
        & (np.abs(area[order][1:] - area[order][:-1]) < 1e-6)
    )
    seen = np.flatnonzero((area > 1e-4) & ~twin)
    polygons = shapely.polygons(np.concatenate([flat[seen], flat[seen][:, :1]], axis=1))
    order = np.argsort(labels[seen], kind="stable")
    counts = np.bincount(labels[seen], minlength=len(boxes))
    plans = np.full(len(boxes), shapely.Polygon(), dtype=object)
    some = np.flatnonzero(counts)
    if some.size:
        together = shapely.multipolygons(polygons[order], indices=np.repeat(np.arange(len(some)), counts[some]))
        plans[some] = shapely.union_all(together[:, None], axis=1)
    bare = np.flatnonzero(shapely.area(plans) < 0.01)
    if bare.size:
        of = np.flatnonzero(np.isin(labels, bare))
        of = of[np.argsort(labels[of], kind="stable")]
        where = np.searchsorted(bare, np.repeat(labels[of], 3))
        hulls = shapely.convex_hull(shapely.multipoints(shapely.points(flat[of].reshape(-1, 2)), indices=where))
        plans[bare] = shapely.buffer(hulls, 0.5 * _TOUCH, cap_style="flat", join_style="mitre")
    return plans


def _merged(mesh: TriangleMesh, rest: NDArray[np.intp], labels: NDArray[np.int64], boxes: _Boxes) -> NDArray[np.int64]:
    """The building (k,) of each part, numbered in the order of their first parts."""
    plans = _plans(mesh, rest, labels, boxes)
    areas = shapely.area(plans)
    a, b = shapely.STRtree(plans).query(plans, predicate="dwithin", distance=_TOUCH)
    a, b = a[a < b], b[a < b]
    shared = shapely.area(shapely.intersection(plans[a], plans[b]))
    over = shared > 0.5 * np.minimum(areas[a], areas[b])
    # The upper of two stands on the lower: it starts well above its foot, at most a touch above its top.
    joined_a, joined_b = a[over], b[over]
    a, b, shared = a[~over], b[~over], shared[~over]
    upper = np.where(boxes.low[a, 2] > boxes.low[b, 2], a, b)
    lower = a + b - upper
    rise = boxes.low[upper, 2] - boxes.low[lower, 2]
    stands = (
        (rise > np.maximum(_STOREY, 0.25 * (boxes.high[lower, 2] - boxes.low[lower, 2])))
        & (boxes.low[upper, 2] < boxes.high[lower, 2] + _TOUCH)
        & (areas[upper] < areas[lower])
    )
    upper, lower, shared = upper[stands], lower[stands], shared[stands]
    # Each stands on one only, the one that it shares most with: a bridge does not join what it connects.
    order = np.lexsort((lower, -np.round(shared, 6), upper))
    _, first = np.unique(upper[order], return_index=True)
    best = order[first]
    return linked(len(plans), np.r_[joined_a, upper[best]], np.r_[joined_b, lower[best]])
