"""Cities of any size for benchmarks: copies of a district's mesh side by side, a disc of as many triangles as asked.

Nothing is read or painted again: positions are moved and offsets repeated, so that ten million triangles take seconds. The
district itself keeps its place, and its viewing cells, in the middle. It must be flat, or copies would not meet.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mmi.appearance.city_mesh import CityMesh, mesh_of, object_boxes
from viewer.scene.scene import WalkScene
from viewer.scene.workshop import Workshop

__all__ = ["Copy", "chosen_copies", "laid_out", "put_together"]

_APART = 10.0
"""Metres between copies."""
_SLACK = 1.15
"""A disc of copies is taken so much wider than its triangles need at first."""


class Copy(NamedTuple):
    """Some ``objects`` (n,) of a district, moved by ``shift`` (2,) metres."""

    shift: NDArray[np.float64]
    objects: NDArray[np.int64]


def laid_out(district: WalkScene, triangles: int, *, middle: NDArray[np.float64]) -> WalkScene:
    """The scene of a city of about ``triangles``: the objects of copies of ``district`` nearest to ``middle`` (x, y).

    Raises ValueError for a district with terrain.
    """
    if district.terrain is not None:
        raise ValueError("a flat district expected, or copies would not meet")
    copies = chosen_copies(district.boxes, district.mesh.triangle_counts, triangles, middle)
    low, _ = _bounds(district.boxes)
    period = _period(district.boxes)
    within = 0.5 * district.tiles[:, :, :2].sum(axis=1) - low
    tiles = np.flatnonzero(((within >= 0.0) & (within < period)).all(axis=1))
    if len(copies) == 1:  # its own ground goes on beyond it
        tiles = np.arange(len(district.tiles))
    mesh = put_together(district.mesh, copies)
    ground = put_together(district.ground, [Copy(one.shift, tiles) for one in copies])
    return replace(
        district,
        mesh=mesh,
        ground=ground,
        tiles=object_boxes(ground),
        boxes=object_boxes(mesh),
        objects={},
        workshop=Workshop(),
    )


def chosen_copies(
    boxes: NDArray[np.float64], counts: NDArray[np.int64], triangles: int, middle: NDArray[np.float64]
) -> list[Copy]:
    """Copies of objects with ``boxes`` (n, 2, 3) and ``counts`` (n,) of triangles: those nearest to ``middle`` (2,) that have
    ``triangles`` together, or just more. The district itself comes first, the others in the order of their distance.
    """
    period = _period(boxes)
    low, high = _bounds(boxes)
    middles = 0.5 * np.nan_to_num(boxes[:, :, :2]).sum(axis=1)
    middles[np.isnan(boxes[:, 0, 0])] = np.inf
    radius = _SLACK * math.sqrt(triangles / max(int(counts.sum()), 1) * float(period.prod()) / math.pi)
    while True:
        first = np.floor((middle - radius - high) / period).astype(int)
        last = np.ceil((middle + radius - low) / period).astype(int)
        steps = np.array([(i, j) for i in range(first[0], last[0] + 1) for j in range(first[1], last[1] + 1)])
        steps = steps[np.lexsort((*steps.T, (steps**2).sum(axis=1)))]
        away = np.linalg.norm(middles + (steps * period)[:, None] - middle, axis=2)
        order = np.argsort(away, axis=None, kind="stable")
        order = order[away.reshape(-1)[order] <= radius]
        total = np.cumsum(counts[order % len(counts)])
        if len(total) and total[-1] >= triangles:
            break
        radius *= _SLACK
    order = order[: int(np.searchsorted(total, triangles)) + 1]
    of, objects = np.divmod(np.sort(order), len(counts))
    found = [Copy(step * period, objects[of == copy]) for copy, step in enumerate(steps)]
    return [one for one in found if len(one.objects)]


def put_together(mesh: CityMesh, copies: Sequence[Copy]) -> CityMesh:
    """One mesh of the copies, in their order."""
    parts = [(mesh_of(mesh, one.objects), one.shift.astype(np.float32)) for one in copies]
    vertices = np.cumsum([0, *(len(part.positions) for part, _ in parts)])
    triangles = np.cumsum([0, *(len(part.triangles) for part, _ in parts)])
    positions = np.concatenate([part.positions for part, _ in parts])
    for (_, shift), first, end in zip(parts, vertices[:-1], vertices[1:], strict=True):
        positions[first:end, :2] += shift
    return CityMesh(
        positions=positions,
        uv=np.concatenate([part.uv for part, _ in parts]),
        colors=np.concatenate([part.colors for part, _ in parts]),
        triangles=np.concatenate(
            [part.triangles + np.int32(first) for (part, _), first in zip(parts, vertices[:-1], strict=True)]
        ),
        object_vertices=_joined([part.object_vertices for part, _ in parts], vertices),
        object_triangles=_joined([part.object_triangles for part, _ in parts], triangles),
        texture=mesh.texture,
    )


def _joined(offsets: Sequence[NDArray[np.int64]], starts: NDArray[np.int64]) -> NDArray[np.int64]:
    """Offsets of parts that begin at ``starts``, the last of which is the end of all."""
    moved = [one[:-1] + start for one, start in zip(offsets, starts[:-1], strict=True)]
    return np.concatenate([*moved, starts[-1:]])


def _bounds(boxes: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    return np.nanmin(boxes[:, 0, :2], axis=0), np.nanmax(boxes[:, 1, :2], axis=0)


def _period(boxes: NDArray[np.float64]) -> NDArray[np.float64]:
    """(2,) metres from a copy to the next."""
    low, high = _bounds(boxes)
    period: NDArray[np.float64] = high - low + _APART
    return period
