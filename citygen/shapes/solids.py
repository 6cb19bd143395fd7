"""Solids that generated objects are put together from: boxes, bodies of revolution, tubes, each closed and textured.

A ``Piece`` is an unchecked mesh in the making; ``join`` turns many into one ``TriangleMesh``. Every piece made here is a
closed surface, counter-clockwise from outside, whose triangles share vertices. Frames: z up, metres; v of textures runs up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray

from mmi.city.model import PLAIN, CityObject, Prism, TriangleMesh

__all__ = [
    "Piece",
    "box",
    "compacted",
    "extrusion",
    "hexahedra",
    "hull_prism",
    "join",
    "lathe",
    "object_of",
    "painted",
    "placed",
    "tube",
]

_FACES = np.array([(3, 2, 1, 0), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7), (4, 5, 6, 7)])
_WHITE = (255, 255, 255)


@dataclass(frozen=True, slots=True, eq=False)
class Piece:
    """As ``TriangleMesh``: ``vertices`` (n, 3), ``triangles`` and ``colors`` (m, 3), ``textures`` (m,), ``uv`` (m, 3, 2)."""

    vertices: NDArray[np.float64]
    triangles: NDArray[np.int64]
    textures: NDArray[np.int64]
    colors: NDArray[np.float64]
    uv: NDArray[np.float64]


def join(pieces: Sequence[Piece]) -> Piece:
    """All pieces as one, in their order."""
    shifts = np.cumsum([0, *(len(piece.vertices) for piece in pieces[:-1])])
    return Piece(
        np.concatenate([piece.vertices for piece in pieces]),
        np.concatenate([piece.triangles + shift for piece, shift in zip(pieces, shifts, strict=True)]),
        np.concatenate([piece.textures for piece in pieces]),
        np.concatenate([piece.colors for piece in pieces]),
        np.concatenate([piece.uv for piece in pieces]),
    )


def compacted(piece: Piece) -> TriangleMesh:
    """A mesh of those vertices that triangles use."""
    used = np.zeros(len(piece.vertices), dtype=bool)
    used[piece.triangles] = True
    place = np.cumsum(used) - 1
    colors = np.clip(np.rint(piece.colors), 0, 255).astype(np.uint8)
    return TriangleMesh(
        piece.vertices[used],
        place[piece.triangles].astype(np.int32),
        piece.textures.astype(np.int32),
        colors,
        piece.uv.astype(np.float32),
    )


def object_of(id: str, pieces: Sequence[Piece], *, core: tuple[Prism, ...] = ()) -> CityObject:  # noqa: A002
    """An object of these pieces; its prism is the hull of its vertices."""
    mesh = compacted(join(pieces))
    return CityObject(id, (hull_prism(mesh.vertices),), mesh, core)


def hull_prism(points: NDArray[np.float64]) -> Prism:
    """The upright convex prism around points (n, 3), a hundredth of a millimetre larger."""
    hull = shapely.convex_hull(shapely.multipoints(points[:, :2])).buffer(1e-5, join_style="mitre")
    return Prism(hull, float(points[:, 2].min()) - 1e-5, float(points[:, 2].max()) + 1e-5)


def painted(piece: Piece, color: ArrayLike, *, texture: int | None = None) -> Piece:
    """The piece in another colour (sRGB bytes) and, where given, with another texture."""
    m = len(piece.triangles)
    textures = piece.textures if texture is None else np.full(m, texture)
    colors = np.broadcast_to(np.asarray(color, dtype=np.float64), (m, 3))
    return Piece(piece.vertices, piece.triangles, textures, colors, piece.uv)


def placed(piece: Piece, position: ArrayLike, *, heading: float = 0.0, scale: ArrayLike = 1.0) -> Piece:
    """The piece scaled (evenly or per axis), turned by ``heading`` radians about z, counter-clockwise, then moved."""
    c, s = np.cos(heading), np.sin(heading)
    turned = (piece.vertices * np.asarray(scale)) @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    return Piece(turned + np.asarray(position), piece.triangles, piece.textures, piece.colors, piece.uv)


def hexahedra(
    corners: NDArray[np.float64],
    *,
    texture: int = PLAIN,
    metres: float | tuple[float, float] | None = 1.0,
    color: ArrayLike = _WHITE,
) -> Piece:
    """Bodies with eight corners (n, 8, 3): four below, counter-clockwise from above, then the four above them.

    A picture stands for ``metres`` (both ways, or width and height), or (None) is fitted to each face. ``color`` (3,) or
    (n, 3).
    """
    n = len(corners)
    quads = corners[:, _FACES]  # (n, 6, 4, 3)
    if metres is None:
        uv = np.broadcast_to(np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)]), (n, 6, 4, 2))
    else:
        wide, high = np.broadcast_to(metres, (2,))
        u = np.linalg.norm(quads[:, :, 1] - quads[:, :, 0], axis=-1) / wide
        v = np.linalg.norm(quads[:, :, 3] - quads[:, :, 0], axis=-1) / high
        uv = np.zeros((n, 6, 4, 2))
        uv[:, :, 1, 0] = uv[:, :, 2, 0] = u
        uv[:, :, 2, 1] = uv[:, :, 3, 1] = v
    faces = _FACES[:, [0, 1, 2, 0, 2, 3]].reshape(1, 12, 3) + 8 * np.arange(n)[:, None, None]
    colors = np.broadcast_to(np.asarray(color, dtype=np.float64), (n, 3))
    return Piece(
        corners.reshape(-1, 3),
        faces.reshape(-1, 3),
        np.full(12 * n, texture),
        np.repeat(colors, 12, axis=0),
        uv[:, :, [0, 1, 2, 0, 2, 3]].reshape(-1, 3, 2),
    )


def box(
    low: ArrayLike,
    high: ArrayLike,
    *,
    texture: int = PLAIN,
    metres: float | tuple[float, float] | None = 1.0,
    color: ArrayLike = _WHITE,
) -> Piece:
    """Upright boxes from ``low`` to ``high``, (3,) or (n, 3) each."""
    a, b = np.atleast_2d(np.asarray(low, dtype=np.float64)), np.atleast_2d(np.asarray(high, dtype=np.float64))
    a, b = np.broadcast_arrays(a, b)
    ends = np.stack([a, b], axis=1)  # (n, 2, 3)
    x, y, z = [0, 1, 1, 0, 0, 1, 1, 0], [0, 0, 1, 1, 0, 0, 1, 1], [0, 0, 0, 0, 1, 1, 1, 1]
    corners = np.stack([ends[:, x, 0], ends[:, y, 1], ends[:, z, 2]], axis=-1)
    return hexahedra(corners, texture=texture, metres=metres, color=color)


def extrusion(
    outline: ArrayLike,
    low: float,
    high: float,
    *,
    texture: int = PLAIN,
    metres: float | tuple[float, float] = 1.0,
    color: ArrayLike = _WHITE,
) -> Piece:
    """A convex outline (k, 2), counter-clockwise, between two heights."""
    xy = np.asarray(outline, dtype=np.float64)
    k = len(xy)
    wide, high_metres = np.broadcast_to(metres, (2,))
    i = np.arange(k)
    j = (i + 1) % k
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*(xy[j] - xy).T))]) / wide
    tall = (high - low) / high_metres
    sides = np.concatenate([np.column_stack([i, j, j + k]), np.column_stack([i, j + k, i + k])])
    u, w = along[:-1], along[1:]
    zero, top = np.zeros(k), np.full(k, tall)
    lower = np.stack([np.column_stack([u, zero]), np.column_stack([w, zero]), np.column_stack([w, top])], axis=1)
    upper = np.stack([np.column_stack([u, zero]), np.column_stack([w, top]), np.column_stack([u, top])], axis=1)
    fan = np.column_stack([np.zeros(k - 2, dtype=np.int64), np.arange(1, k - 1), np.arange(2, k)])
    triangles = np.concatenate([sides, fan[:, ::-1], fan + k])
    flat = xy / np.array([wide, high_metres])
    uv = np.concatenate([lower, upper, flat[fan[:, ::-1]], flat[fan]])
    vertices = np.concatenate([np.column_stack([xy, np.full(k, low)]), np.column_stack([xy, np.full(k, high)])])
    colors = np.broadcast_to(np.asarray(color, dtype=np.float64), (len(triangles), 3))
    return Piece(vertices, triangles, np.full(len(triangles), texture), colors, uv)


def lathe(
    profile: ArrayLike,
    segments: int,
    *,
    texture: int = PLAIN,
    repeats: tuple[float, float] = (1.0, 1.0),
    color: ArrayLike = _WHITE,
) -> Piece:
    """A body of revolution about z: ``profile`` (k, 2) of (radius, height), the first and the last radius 0, going up.

    ``repeats``: how often the picture goes around and up. Rings of radius 0 are single vertices.
    """
    rows = np.asarray(profile, dtype=np.float64)
    k = len(rows)
    angle = 2.0 * np.pi * np.arange(segments) / segments
    ring = np.column_stack([np.cos(angle), np.sin(angle)])
    middle = rows[1:-1]
    sides = np.concatenate(
        [middle[:, :1, None] * ring[None], np.repeat(middle[:, None, 1:], segments, axis=1)], axis=2
    ).reshape(-1, 3)
    vertices = np.concatenate([sides, [[0.0, 0.0, rows[0, 1]], [0.0, 0.0, rows[-1, 1]]]])
    south, north = len(sides), len(sides) + 1
    i = np.arange(segments)
    j = (i + 1) % segments
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(rows, axis=0).T))])
    v = way / way[-1] * repeats[1]
    u0, u1 = i / segments * repeats[0], (i + 1) / segments * repeats[0]
    triangles, uv = [], []

    def add(corners: list[NDArray[np.int64]], us: list[NDArray[np.float64]], vs: list[float]) -> None:
        triangles.append(np.column_stack(corners))
        uv.append(np.stack([np.column_stack([a, np.full(segments, b)]) for a, b in zip(us, vs, strict=True)], axis=1))

    um = 0.5 * (u0 + u1)
    add([np.full(segments, south), j, i], [um, u1, u0], [v[0], v[1], v[1]])
    for r in range(k - 3):
        a, b = r * segments, (r + 1) * segments
        add([a + i, a + j, b + j], [u0, u1, u1], [v[r + 1], v[r + 1], v[r + 2]])
        add([a + i, b + j, b + i], [u0, u1, u0], [v[r + 1], v[r + 2], v[r + 2]])
    last = (k - 3) * segments
    add([last + i, last + j, np.full(segments, north)], [u0, u1, um], [v[-2], v[-2], v[-1]])
    m = sum(len(part) for part in triangles)
    colors = np.broadcast_to(np.asarray(color, dtype=np.float64), (m, 3))
    return Piece(vertices, np.concatenate(triangles), np.full(m, texture), colors, np.concatenate(uv))


def tube(
    points: ArrayLike,
    radii: ArrayLike,
    segments: int,
    *,
    texture: int = PLAIN,
    repeats: tuple[float, float] = (1.0, 1.0),
    color: ArrayLike = _WHITE,
) -> Piece:
    """Closed tubes around paths (k, 3) or (n, k, 3), with ``radii`` of the points; flat ends."""
    paths = np.asarray(points, dtype=np.float64)
    paths = paths[None] if paths.ndim == 2 else paths
    n, k, _ = paths.shape
    radius = np.broadcast_to(np.asarray(radii, dtype=np.float64), (n, k))
    forward = np.gradient(paths, axis=1)
    forward /= np.linalg.norm(forward, axis=2)[..., None]
    aside = np.cross(forward[:, 0], np.eye(3)[np.argmin(np.abs(forward[:, 0]), axis=1)])
    sides = np.empty((n, k, 3))
    for row in range(k):  # carried along the path, so that a tube does not twist
        aside = aside - forward[:, row] * (aside * forward[:, row]).sum(axis=1)[:, None]
        aside = aside / np.linalg.norm(aside, axis=1)[:, None]
        sides[:, row] = aside
    ups = np.cross(forward, sides)
    angle = 2.0 * np.pi * np.arange(segments) / segments
    reach = np.cos(angle)[:, None] * sides[:, :, None] + np.sin(angle)[:, None] * ups[:, :, None]
    rings = (paths[:, :, None] + radius[..., None, None] * reach).reshape(n, -1, 3)
    vertices = np.concatenate([rings, paths[:, :1], paths[:, -1:]], axis=1)
    profile = [(0.0, 0.0), *((1.0, float(row)) for row in range(k)), (0.0, k - 1.0)]
    body = lathe(profile, segments, texture=texture, repeats=repeats, color=color)
    size = vertices.shape[1]
    triangles = (body.triangles[None] + size * np.arange(n)[:, None, None]).reshape(-1, 3)
    return Piece(
        vertices.reshape(-1, 3),
        triangles,
        np.tile(body.textures, n),
        np.tile(body.colors, (n, 1)),
        np.tile(body.uv, (n, 1, 1)),
    )
