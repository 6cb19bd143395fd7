"""Roofs over any outline: the outline's edges move inwards while they rise, as a wavefront, and what they sweep is the roof.

A hip roof is the straight skeleton of its outline (Aichholzer et al. 1995): all edges move at one speed. A gable is an edge
that stands still. A mansard changes its slope on the way, a parapet goes level and then down. The front moves from event to
event (an edge vanishes, a corner meets another edge); between events each edge sweeps a plane quadrilateral. Degenerate
events need no care of their own: at each event nodes that meet are merged, nodes on edges split them, and opposite edges
cancel out. ``raise_roof`` proves what it returns: no part is folded or stands upright that should slope, and all parts
together cover the outline.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import mapbox_earcut
import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray

__all__ = ["CAP", "Roof", "fill", "raise_roof"]

CAP = -1
"""In ``Roof.segment`` and ``Roof.edge``: the level part that closes a roof."""

_NEAR = 0.02  # metres: nodes nearer than this are one, so that roofs over nearly regular outlines have no slivers
_NEAREST = 1e-4  # metres: the same where that fails, and no slivers are left nevertheless
_FOLD = 1e-4  # metres by which a corner may lie beyond the opposite side
_SLIM = 5e-3  # metres: a triangle less high than that is a sliver, which may lean as it likes
_Ints = NDArray[np.int64]
_Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Roof:
    """Triangles over an outline, counter-clockwise from above; the first vertices are the outline's points in their order.

    ``vertices`` (n, 3), ``run`` (n,) metres that each lies up the slope, ``triangles`` (m, 3), ``segment`` (m,) and
    ``edge`` (m,): the part of the profile and the edge of the outline that each triangle belongs to, or ``CAP``.
    ``depth``: how far in the roof goes.
    """

    vertices: _Floats
    run: _Floats
    triangles: _Ints
    segment: _Ints
    edge: _Ints
    depth: float


@dataclass(frozen=True, slots=True, eq=False)
class _Front:
    """Edge i leads from node ``node[i]`` at ``xy[i]`` to the start of edge ``after[i]``; ``edge[i]`` is its origin."""

    node: _Ints
    xy: _Floats
    after: _Ints
    edge: _Ints


def raise_roof(
    points: _Floats, after: _Ints, profile: tuple[tuple[float, float], ...], *, speeds: _Floats | None = None
) -> Roof | None:
    """The roof over an outline, or None where it is too intricate.

    ``points`` (n, 2) of all rings, ``after`` (n,) each one's successor, the inside to the left. ``profile``: (depth, height)
    from (0, eaves) inwards; where it ends before the front has vanished, the roof is closed with a level cap. ``speeds``
    (n,) of the edges, by default 1; 0 for a gable.
    """
    speed = np.ones(len(points)) if speeds is None else speeds
    rises = np.array([end > start for (start, _), (end, _) in pairwise(profile)])
    for near, slim in ((_NEAR, 0.0), (_NEAREST, _SLIM)):
        roof = _raised(points, after, profile, speed, near)
        if roof is not None:
            slopes = (roof.segment == CAP) | (rises[roof.segment] & (speed[roof.edge] > 0.0))
            if _sound(roof, points, after, slopes, slim):
                return roof
    return None


def _raised(
    points: _Floats, after: _Ints, profile: tuple[tuple[float, float], ...], speed: _Floats, near: float
) -> Roof | None:
    """The roof by this tolerance, sound or not; None where the front does not come to an end."""
    n = len(points)
    along = points[after] - points
    along /= np.hypot(along[:, 0], along[:, 1])[:, None]
    inward = np.column_stack([-along[:, 1], along[:, 0]])
    front: _Front | None = _Front(np.arange(n), points, after, np.arange(n))
    depth, height, run = 0.0, profile[0][1], 0.0
    vertices, runs = [np.column_stack([points, np.full(n, height)])], [np.zeros(n)]
    triangles: list[_Ints] = []
    segments: list[_Ints] = []
    edges: list[_Ints] = []
    count, steps = n, 0
    for segment, (end, level) in enumerate(profile[1:]):
        slope = (level - height) / (end - depth) if end > depth else 0.0
        while front is not None:
            steps += 1
            if steps > 6 * n + 20:
                return None
            moved = _advance(front, inward, along, speed, end - depth, near)
            if moved is None:
                return None
            step, xy, event = moved
            last = step >= end - depth
            depth, raised = (end, level) if last else (depth + step, height + slope * step)
            run += float(np.hypot(step, raised - height))
            height = raised
            swept = _sweep(front, xy, count, near) if event else _lift(front, xy, count)
            if swept is None:
                return None
            nodes, faces, owners, front = swept
            vertices.append(np.column_stack([nodes, np.full(len(nodes), height)]))
            runs.append(np.full(len(nodes), run))
            count += len(nodes)
            triangles.append(faces)
            segments.append(np.full(len(faces), segment))
            edges.append(owners)
            if last:
                break
    if front is not None:
        cap = _cap(front)
        triangles.append(cap)
        segments.append(np.full(len(cap), CAP))
        edges.append(np.full(len(cap), CAP))
    return Roof(
        np.concatenate(vertices),
        np.concatenate(runs),
        np.concatenate(triangles),
        np.concatenate(segments),
        np.concatenate(edges),
        depth,
    )


def _advance(
    front: _Front, inward: _Floats, along: _Floats, speed: _Floats, most: float, near: float
) -> tuple[float, _Floats, bool] | None:
    """How far the front moves until the next event (at most ``most``), where its nodes are then, whether there is an event."""
    if most <= 0.0:
        return 0.0, front.xy, False
    reach = most + near  # an event just beyond is one, too
    k = len(front.node)
    before = np.empty(k, dtype=np.int64)
    before[front.after] = np.arange(k)
    n_own, n_last = inward[front.edge], inward[front.edge[before]]
    w_own, w_last = speed[front.edge], speed[front.edge[before]]
    d_own, d_last = along[front.edge], along[front.edge[before]]
    dot = (n_own * n_last).sum(axis=1)
    det = n_last[:, 0] * n_own[:, 1] - n_last[:, 1] * n_own[:, 0]
    even = w_own == w_last
    if ((dot < -1.0 + 1e-9) | (~even & (np.abs(det) < 1e-2))).any():
        return None
    safe = np.where(even, 1.0, det)
    odd = np.column_stack([w_last * n_own[:, 1] - w_own * n_last[:, 1], w_own * n_last[:, 0] - w_last * n_own[:, 0]])
    velocity = np.where(
        even[:, None], (n_own + n_last) * (w_own / np.maximum(1.0 + dot, 1e-9))[:, None], odd / safe[:, None]
    )
    ahead = front.xy[front.after]
    length = ((ahead - front.xy) * d_own).sum(axis=1)
    rate = ((velocity[front.after] - velocity) * d_own).sum(axis=1)
    shrinks = rate < -1e-12
    step = min(reach, float((np.maximum(length[shrinks], 0.0) / -rate[shrinks]).min(initial=np.inf)))
    reflex = np.flatnonzero(d_last[:, 0] * d_own[:, 1] - d_last[:, 1] * d_own[:, 0] < -1e-9)
    if len(reflex):
        gap = ((front.xy[reflex, None] - front.xy[None]) * n_own[None]).sum(axis=2)  # (reflex, edges)
        closing = w_own[None] - velocity[reflex] @ n_own.T
        with np.errstate(divide="ignore", invalid="ignore"):
            when = gap / closing
        other = np.arange(k)[None] != reflex[:, None]
        other &= np.arange(k)[None] != before[reflex][:, None]
        meets = other & (closing > 1e-9) & (gap > -near) & (when < step)
        r, e = np.nonzero(meets)
        if len(r):
            at = np.maximum(when[r, e], 0.0)
            place = front.xy[reflex[r]] + velocity[reflex[r]] * at[:, None]
            start = front.xy[e] + velocity[e] * at[:, None]
            finish = ahead[e] + velocity[front.after[e]] * at[:, None]
            low, high = ((place - start) * d_own[e]).sum(axis=1), ((finish - place) * d_own[e]).sum(axis=1)
            step = min(step, float(at[(low > -near) & (high > -near)].min(initial=np.inf)))
    event, step = step < reach, min(step, most)
    return step, front.xy + velocity * step, event


def _lift(front: _Front, xy: _Floats, count: int) -> tuple[_Floats, _Ints, _Ints, _Front | None]:
    """As ``_sweep``, where no two nodes meet."""
    low = np.arange(len(xy)) + count
    high = front.after + count
    a, b = front.node, front.node[front.after]
    faces = np.concatenate([np.column_stack([a, b, high]), np.column_stack([a, high, low])])
    return xy, faces, np.concatenate([front.edge, front.edge]), _Front(low, xy, front.after, front.edge)


def _sweep(front: _Front, xy: _Floats, count: int, near: float) -> tuple[_Floats, _Ints, _Ints, _Front | None] | None:
    """New nodes (q, 2) numbered from ``count``, the faces (m, 3) between old and new front, their edges (m,), the new front."""
    k = len(xy)
    apart = np.abs(xy[:, None] - xy[None]).max(axis=2)
    first = (apart < near).argmax(axis=1)
    chosen, name = np.unique(first, return_inverse=True)
    nodes, ends = xy[chosen], name[front.after]
    a, b, low, high = front.node, front.node[front.after], name, ends
    whole = low != high
    span = nodes[high] - nodes[low]
    length = np.hypot(span[:, 0], span[:, 1])
    unit = span / np.maximum(length, 1e-12)[:, None]
    offset = nodes[None] - nodes[low][:, None]  # (edges, nodes)
    place = (offset * unit[:, None]).sum(axis=2)
    aside = np.abs(offset[..., 0] * unit[:, None, 1] - offset[..., 1] * unit[:, None, 0])
    on = whole[:, None] & (aside < near) & (place > near) & (place < length[:, None] - near)
    on[np.arange(k), low] = on[np.arange(k), high] = False
    split = on.any(axis=1)
    plain = whole & ~split
    edge = front.edge
    faces = [np.column_stack([a, b, high + count])]
    owners = [edge]
    faces.append(np.column_stack([a, high + count, low + count])[plain])
    owners.append(edge[plain])
    new = [np.column_stack([low, high, edge])[plain]]
    for i in np.flatnonzero(split):
        inner = np.flatnonzero(on[i])
        chain = np.concatenate([[low[i]], inner[np.argsort(place[i, inner])], [high[i]]])
        fan = np.column_stack([np.full(len(chain) - 1, a[i]), chain[1:] + count, chain[:-1] + count])
        faces.append(fan)
        owners.append(np.full(len(fan), edge[i]))
        new.append(np.column_stack([chain[:-1], chain[1:], np.full(len(fan), edge[i])]))
    traced = _trace(np.concatenate(new), nodes, count)
    if traced is None:
        return None
    return nodes, np.concatenate(faces), np.concatenate(owners), traced[0] if traced else None


def _trace(new: _Ints, nodes: _Floats, count: int) -> tuple[_Front, ...] | None:
    """Directed edges (start, end, origin) -> the front that they form, or () where they cancel out; None if they do not fit."""
    size = len(nodes)
    key, back = new[:, 0] * size + new[:, 1], new[:, 1] * size + new[:, 0]
    if len(np.unique(key)) < len(key):
        return None
    new = new[~np.isin(key, back)]
    if not len(new):
        return ()
    starts = np.argsort(new[:, 0], kind="stable")
    ordered = new[starts, 0]
    low, high = np.searchsorted(ordered, new[:, 1]), np.searchsorted(ordered, new[:, 1], side="right")
    if (high == low).any():
        return None
    after = starts[low]
    for i in np.flatnonzero(
        high - low > 1
    ):  # where the front pinches: the next edge, clockwise from where it comes from
        out = starts[low[i] : high[i]]
        came = nodes[new[i, 0]] - nodes[new[i, 1]]
        leave = nodes[new[out, 1]] - nodes[new[out, 0]]
        turn = (np.arctan2(came[1], came[0]) - np.arctan2(leave[:, 1], leave[:, 0])) % (2.0 * np.pi)
        after[i] = out[np.argmin(np.where(turn < 1e-9, 7.0, turn))]
    if len(np.unique(after)) < len(after):
        return None
    return (_Front(new[:, 0] + count, nodes[new[:, 0]], after, new[:, 2]),)


def _cap(front: _Front) -> _Ints:
    """Triangles that fill the front."""
    loops, seen = [], np.zeros(len(front.node), dtype=bool)
    for start in range(len(front.node)):
        loop = []
        i = start
        while not seen[i]:
            seen[i] = True
            loop.append(i)
            i = int(front.after[i])
        if loop:
            loops.append(np.array(loop))
    if len(loops) == 1:
        return np.asarray(front.node[loops[0][fill(front.xy[loops[0]], [len(loops[0])])]])
    rings = [shapely.LinearRing(front.xy[loop]) for loop in loops]
    inner = [i for i, ring in enumerate(rings) if not ring.is_ccw]
    caps = [np.empty((0, 3), dtype=np.int64)]
    for i in (i for i in range(len(rings)) if i not in inner):
        body = shapely.Polygon(rings[i])
        chosen = [loops[i], *(loops[j] for j in inner if body.covers(rings[j]))]
        places = np.concatenate(chosen)
        caps.append(front.node[places[fill(front.xy[places], np.cumsum([len(one) for one in chosen]))]])
    return np.concatenate(caps)


def fill(points: _Floats, ends: ArrayLike) -> _Ints:
    """Triangles (m, 3), counter-clockwise, between rings of ``points`` (n, 2): the outer one first, ending at ``ends``."""
    near = points - points[0]  # near zero, where float64 is finest
    faces = mapbox_earcut.triangulate_float64(near, np.asarray(ends, dtype=np.uint32)).reshape(-1, 3).astype(np.int64)
    p, q, r = (near[faces[:, i]] for i in range(3))
    turned = (q[:, 0] - p[:, 0]) * (r[:, 1] - p[:, 1]) < (q[:, 1] - p[:, 1]) * (r[:, 0] - p[:, 0])
    faces[turned] = faces[turned][:, ::-1]
    n, rings = len(points), np.asarray(ends, dtype=np.int64)
    if len(faces) == n + 2 * len(rings) - 4:
        return np.asarray(faces)
    after = np.arange(1, n + 1)
    after[rings - 1] = np.concatenate([[0], rings[:-1]])
    return _with_every_point(faces, near, after)


def _with_every_point(faces: _Ints, points: _Floats, after: _Ints) -> _Ints:
    """The same faces, with those points on their sides that earcut left out because they lie in a line with others."""
    n = len(after)
    for _ in range(2 * n):
        start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
        border = ~np.isin(start * n + end, end * n + start)
        for at in np.flatnonzero(border & (after[start] != end)):
            a, b = start[at], end[at]
            span, offset = points[b] - points[a], points - points[a]
            place = offset @ span / (span @ span)
            aside = np.abs(offset[:, 0] * span[1] - offset[:, 1] * span[0]) / np.hypot(*span)
            between = np.flatnonzero((aside < 1e-6) & (place > 1e-9) & (place < 1.0 - 1e-9))
            if len(between):
                break
        else:
            break
        chain = np.concatenate([[a], between[np.argsort(place[between])], [b]])
        face, side = divmod(int(at), 3)
        apex = np.full(len(chain) - 1, faces[face, (side + 2) % 3])
        faces = np.concatenate([np.delete(faces, face, axis=0), np.column_stack([chain[:-1], chain[1:], apex])])
    return faces


def _sound(roof: Roof, points: _Floats, after: _Ints, slopes: NDArray[np.bool_], slim: float) -> bool:
    """Whether the roof is one unfolded sheet whose border is the outline, all of it.

    None of its ``slopes`` (m,) may stand upright, and no triangle may be less than ``slim`` metres high.
    """
    a, b, c = (roof.vertices[roof.triangles[:, i]] for i in range(3))
    normal = np.cross(b - a, c - a)
    area = normal[:, 2]
    longest = np.sqrt(np.maximum.reduce([((p - q) ** 2).sum(axis=1) for p, q in ((a, b), (b, c), (c, a))]))
    whole = np.sqrt((normal**2).sum(axis=1))
    upright = slopes & (area < 0.2 * whole) & (whole > _SLIM * longest)
    near = points - points[0]
    covered = (near[:, 0] * near[after, 1] - near[:, 1] * near[after, 0]).sum()
    if (
        (area < -_FOLD * longest).any()
        or upright.any()
        or (whole < slim * longest).any()
        or abs(area.sum() - covered) > 1e-4 * covered + 1e-3
    ):
        return False
    size = len(roof.vertices)
    start, end = roof.triangles.ravel(), np.roll(roof.triangles, -1, axis=1).ravel()
    key = start * size + end
    ordered = np.sort(key)
    if (ordered[1:] == ordered[:-1]).any():
        return False
    border = np.sort(key[~np.isin(key, end * size + start)])
    n = len(points)
    return len(border) == n and bool((border == np.sort(np.arange(n) * size + after)).all())
