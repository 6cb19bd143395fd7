"""A plan is rehearsed with what is really drawn, where that is more than prisms: roofs, reveals, balconies, open meshes.

Weights and self-parallax look at the prisms around a mesh (docs/bound.md). What the mesh itself hides, of itself and of others
of its layer, is looked for here, as :mod:`mmi.planning.rehearsal` does for walls: from viewpoints around the cell, at the
bottom and the top of its eye band, all that may be visible is drawn with its own triangles. A point X of a far object that is
seen there is in its layer's picture if the texel that it falls into, seen from the reference viewpoint, or one beside it,
shows the triangle of X, or one that goes on in its plane, or a point of its object that the viewer sees within a pixel of X.
If not it is missed. Where the largest disc of what is missed exceeds the limit, the object that covers most of it stays
geometry.

Viewpoints are samples: this measures, and promises nothing of what is seen from between them.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mmi.appearance.city_mesh import CityMesh
from mmi.cells.viewing_cells import ViewingCell
from mmi.city.ranges import numbers_in
from mmi.foundation.kernels import kernel
from mmi.planning.missed_regions import WORTH_KNOWING, thickest_region
from mmi.planning.rehearsal import Rehearsal
from mmi.planning.triangle_panorama import Panorama, draw_triangles, empty_panorama, spans_of
from mmi.visibility.visible_walls import around

__all__ = ["MESH_VIEWPOINTS", "rehearse_meshes"]

_SPOTS = 8
"""Places around the cell: its corners and the middles of its sides, or thereabouts."""
MESH_VIEWPOINTS = 2 * _SPOTS
"""Viewpoints of a rehearsal: both ends of the eye band at each place."""
_STEEPEST = 3.0
"""What is steeper than this slope, up or down, is not looked at."""
_ALIKE = 0.98
"""Least cosine between the normals of triangles that go on in one plane."""


class _Surfaces(NamedTuple):
    """All triangles of the city: ``vertices`` (n, 3), ``triangles`` (m, 3), and the object of each, ``owner`` (m,)."""

    vertices: NDArray[np.float32]
    triangles: NDArray[np.int32]
    owner: NDArray[np.int32]


class _Captured(NamedTuple):
    """The panoramas of all layers from the reference viewpoint: ``inverse`` and ``triangle`` (layers, columns, rows)."""

    inverse: NDArray[np.float32]
    triangle: NDArray[np.int32]


def rehearse_meshes(
    cell: ViewingCell,
    mesh: CityMesh,
    objects: NDArray[np.int64],
    layers: tuple[NDArray[np.int64], ...],
    *,
    pixel: tuple[float, float],
    limit: float,
) -> Rehearsal:
    """Which objects of ``layers`` have to stay geometry for no missed region to be thicker than ``limit`` pixels.

    ``objects`` (n,) are all that may be visible, sorted, those of ``layers`` among them; ``mesh`` has the triangles of the
    whole city. ``pixel`` is the width of a pixel (and of a texel) in radians of azimuth, and its height as a slope.
    """
    far = np.concatenate([np.empty(0, dtype=np.int64), *layers])
    if not far.size:
        return Rehearsal(far, 0.0)
    near = np.setdiff1d(objects, far)
    owner = np.repeat(np.arange(len(mesh.triangle_counts), dtype=np.int32), mesh.triangle_counts)
    surfaces = _Surfaces(mesh.positions, mesh.triangles, owner)
    layer = np.full(len(mesh.triangle_counts), -1, dtype=np.int64)
    for i, members in enumerate(layers):
        layer[members] = i
    eyes = np.array([(*spot, height) for spot in around(cell.corners, _SPOTS) for height in cell.eye])
    columns = math.ceil(2.0 * math.pi / pixel[0])
    up, down = _rows(mesh, far, np.vstack([eyes, cell.reference]), pixel[1])

    def draw(members: NDArray[np.int64], eye: NDArray[np.float64], panorama: Panorama, rows: NDArray[np.int64]) -> None:
        chosen = numbers_in(mesh.object_triangles[members], mesh.object_triangles[members + 1])
        draw_triangles(mesh.positions, mesh.triangles, chosen, eye, panorama, rows)

    def capture(i: int, members: NDArray[np.int64]) -> None:
        captured.inverse[i], captured.triangle[i] = 0.0, -1
        panorama = Panorama(captured.inverse[i], captured.triangle[i], down, pixel[1])
        draw(members, cell.reference, panorama, everywhere)

    shape = (columns, up + down)
    everywhere = np.tile(np.array([0, up + down], dtype=np.int64), (columns, 1))
    captured = _Captured(np.empty((len(layers), *shape), np.float32), np.empty((len(layers), *shape), np.int32))
    for i, members in enumerate(layers):
        capture(i, members)
    missed, spans = np.empty(shape, dtype=np.int32), np.empty((columns, 2), dtype=np.int64)
    demoted: list[int] = []
    thickest = WORTH_KNOWING * limit
    for eye in eyes:
        seen = empty_panorama(columns, up=up, down=down, row=pixel[1])
        draw(far, eye, seen, everywhere)
        draw(near, eye, seen, spans_of(seen))  # what hides something of these
        while True:
            _look(surfaces, layer, seen, eye - cell.reference, captured, missed, spans)
            thick, inside = thickest_region(missed, spans, thickest)
            if thick <= limit:
                break
            names, counts = np.unique(inside, return_counts=True)
            worst = int(names[np.argmax(counts)])
            i, layer[worst] = int(layer[worst]), -1
            demoted.append(worst)
            capture(i, np.setdiff1d(layers[i], demoted))
        thickest = max(thickest, thick)
    return Rehearsal(np.sort(np.array(demoted, dtype=np.int64)), thickest)


def _rows(mesh: CityMesh, far: NDArray[np.int64], eyes: NDArray[np.float64], row: float) -> tuple[int, int]:
    """How many rows it takes, above eye level and below, for all of the ``far`` (k,) objects from all ``eyes`` (n, 3)."""
    vertices = mesh.positions[numbers_in(mesh.object_vertices[far], mesh.object_vertices[far + 1])].astype(np.float64)
    up, down = 0.0, 0.0
    for eye in eyes:
        slopes = (vertices[:, 2] - eye[2]) / np.maximum(np.hypot(*(vertices[:, :2] - eye[:2]).T), 1.0)
        up, down = max(up, float(slopes.max(initial=0.0))), max(down, -float(slopes.min(initial=0.0)))
    return tuple(math.ceil(min(slope, _STEEPEST) / row) + 2 for slope in (up, down))  # type: ignore[return-value]


@kernel(error_model="numpy")
def _look(
    surfaces: _Surfaces,
    layer: NDArray[np.int64],
    seen: Panorama,
    viewpoint: NDArray[np.float64],
    captured: _Captured,
    missed: NDArray[np.int32],
    spans: NDArray[np.int64],
) -> None:
    """Sets which object is ``missed`` (columns, rows), -1 for none, and the ``spans`` (columns, 2) of rows that hold all of it.

    ``viewpoint`` (3,) is where ``seen`` was drawn, metres from the reference; an object has a place in ``layer`` (k,), -1
    for none.
    """
    columns, rows = missed.shape
    turn, row, down = 2.0 * math.pi / columns, seen.row, seen.down
    for c in range(columns):
        low, high = rows, 0
        ux, uy = math.cos((c + 0.5) * turn), math.sin((c + 0.5) * turn)
        for r in range(rows):
            missed[c, r] = -1
            t = seen.triangle[c, r]
            if t < 0:
                continue
            one = surfaces.owner[t]
            if layer[one] < 0:
                continue
            d = 1.0 / seen.inverse[c, r]
            offset = (d * ux, d * uy, d * (r + 0.5 - down) * row)
            if not _has(surfaces, captured, layer[one], t, offset, viewpoint, (turn, row, down)):
                missed[c, r] = one
                low, high = min(low, r), r + 1
        spans[c, 0], spans[c, 1] = min(low, high), high


@kernel(error_model="numpy")
def _has(
    surfaces: _Surfaces,
    captured: _Captured,
    i: int,
    t: int,
    offset: tuple[float, float, float],
    viewpoint: NDArray[np.float64],
    scale: tuple[float, float, int],
) -> bool:
    """Whether the picture of layer ``i`` has a point of triangle ``t``, which lies at ``offset`` metres from the viewpoint."""
    turn, row, down = scale
    _, columns, rows = captured.inverse.shape
    x, y, z = offset[0] + viewpoint[0], offset[1] + viewpoint[1], offset[2] + viewpoint[2]
    away = math.hypot(x, y)
    column, up = math.floor(math.atan2(y, x) / turn), math.floor(z / away / row) + down
    distance = math.sqrt(offset[0] ** 2 + offset[1] ** 2 + offset[2] ** 2)
    nx, ny, nz = _normal(surfaces, t)
    for dc, dr in ((0, 0), (-1, 0), (1, 0), (0, -1), (0, 1), (-1, -1), (1, -1), (-1, 1), (1, 1)):
        c, r = (column + dc) % columns, up + dr
        if r < 0 or r >= rows:
            continue
        other = captured.triangle[i, c, r]
        if other == t:
            return True
        if other < 0 or surfaces.owner[other] != surfaces.owner[t]:
            continue
        d = 1.0 / captured.inverse[i, c, r]
        qx = d * math.cos((c + 0.5) * turn) - x
        qy = d * math.sin((c + 0.5) * turn) - y
        qz = d * (r + 0.5 - down) * row - z
        mx, my, mz = _normal(surfaces, other)
        if abs(nx * mx + ny * my + nz * mz) >= _ALIKE and abs(nx * qx + ny * qy + nz * qz) <= distance * turn:
            return True
        # Points that close together, across the line of sight, are one as the viewer sees them.
        along = (qx * offset[0] + qy * offset[1] + qz * offset[2]) / distance
        across = qx * qx + qy * qy + qz * qz - along * along
        if across <= (turn * max(distance + along, 0.0)) ** 2:
            return True
    return False


@kernel(error_model="numpy")
def _normal(surfaces: _Surfaces, t: int) -> tuple[float, float, float]:
    """The unit normal of triangle ``t``; what is no number where it has no area."""
    a, b = surfaces.vertices[surfaces.triangles[t, 0]], surfaces.vertices[surfaces.triangles[t, 1]]
    c = surfaces.vertices[surfaces.triangles[t, 2]]
    px, py, pz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    qx, qy, qz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    x, y, z = py * qz - pz * qy, pz * qx - px * qz, px * qy - py * qx
    length = math.sqrt(x * x + y * y + z * z)
    return x / length, y / length, z / length
