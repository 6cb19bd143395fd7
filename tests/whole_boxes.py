"""Points all over boxes and what images do to them, by brute force: to hold the validity of images against.

Shares no code with what it checks. All arrays have a leading axis of n boxes; points are (n, k, 3).
"""

from __future__ import annotations

import numpy as np

_MARKS = np.array(
    [[x, y, z] for x in (0.0, 0.5, 1.0) for y in (0.0, 0.5, 1.0) for z in (0.0, 0.5, 1.0) if (x, y, z) != (0.5,) * 3]
)


def random_boxes(rng, count, *, closest=0.7, farthest=15.0):
    """Viewpoints (n, 3) outside of boxes (n, 2, 3) of all shapes, ``closest`` to ``farthest`` diagonals from their middles."""
    eyes, size = rng.normal(size=(count, 3)) * 5.0, 10.0 ** rng.uniform(-1.0, 1.5, (count, 3))
    towards = directions(rng, count)
    way = np.linalg.norm(size, axis=1) * np.exp(rng.uniform(np.log(closest), np.log(farthest), count))
    middle = eyes + towards * way[:, None]
    boxes = np.stack((middle - 0.5 * size, middle + 0.5 * size), axis=1)
    out = np.any((eyes < boxes[:, 0]) | (eyes > boxes[:, 1]), axis=1)
    return eyes[out], boxes[out]


def directions(rng, count):
    """Unit vectors (n, 3), evenly over the sphere."""
    one = rng.normal(size=(count, 3))
    return one / np.linalg.norm(one, axis=1)[:, None]


def points_of(rng, boxes, count):
    """Points of boxes: corners, middles of edges and faces, then faces, edges and the inside at random."""
    part = rng.uniform(size=(len(boxes), count, 3))
    flat = rng.uniform(size=part.shape) < 0.4
    part = np.where(flat, np.round(part), part)
    part[:, : len(_MARKS)] = _MARKS
    return boxes[:, None, 0] + part * (boxes[:, None, 1] - boxes[:, None, 0])


def angles(eyes, points, others):
    """Angles (n, k) under which ``eyes`` (n, 3) see the two."""
    a, b = points - eyes[:, None], others - eyes[:, None]
    return np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), np.sum(a * b, axis=-1))


def on_quadrilaterals(captured, points, boxes):
    """Where quadrilaterals through the boxes' middles, across the lines to them, show points; nan for what is not before."""
    middle = boxes.mean(axis=1)
    line = middle - captured
    away = np.linalg.norm(line, axis=1)[:, None]
    offsets = points - captured[:, None]
    depth = np.einsum("nkc,nc->nk", offsets, line / away)
    return captured[:, None] + offsets * (away / np.where(depth > 0.0, depth, np.nan))[..., None]


def turned_to(eyes, captured, shown, boxes):
    """Points of quadrilaterals after those turned around the boxes' middles, from facing ``captured`` to facing ``eyes``."""
    middle = boxes.mean(axis=1)
    out = np.empty_like(shown)
    for i in range(len(boxes)):
        before, after = middle[i] - captured[i], middle[i] - eyes[i]
        before, after = before / np.linalg.norm(before), after / np.linalg.norm(after)
        cross = np.cross(before, after)
        skew = np.cross(np.eye(3), cross)
        turn = np.eye(3) + skew + skew @ skew / (1.0 + before @ after)
        out[i] = (shown[i] - middle[i]) @ turn.T + middle[i]
    return out


def stretch_in_box(captured, points, boxes):
    """Where rays from ``captured`` through points of the boxes enter and leave them: distances (n, k) and rays (n, k, 3)."""
    rays = points - captured[:, None]
    rays = rays / np.linalg.norm(rays, axis=-1)[..., None]
    with np.errstate(divide="ignore", invalid="ignore"):
        one, other = ((boxes[:, None, side] - captured[:, None]) / rays for side in (0, 1))
    enter, leave = np.nanmax(np.minimum(one, other), axis=-1), np.nanmin(np.maximum(one, other), axis=-1)
    return np.maximum(enter, 0.0), np.maximum(leave, enter), rays
