"""City objects as textured triangles: what captures render and what stays geometry.

There is one mesh and one texture for the whole city, ordered by object, so that any set of objects is one gather and one draw.
The texture is that of painted facades (``mmi.appearance.facades``), or an atlas with the city's own pictures as well
(``mmi.appearance.texture_atlas``). Vertex colours multiply it: a tint of the building's own and light
(``mmi.appearance.shading``).

Geometry is exactly that of the prisms, or of the mesh that an object came with (``mmi.appearance.model_surfaces``): walls of
prisms are vertical, their roofs are flat, and positions are float32 in the city's local frame. Walls between touching buildings
are kept (each object is whole by itself); they have no windows, except along cuts, where they look like the facade that ends
there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray

from mmi.appearance import facades
from mmi.appearance.coarser_pictures import with_coarser_pictures
from mmi.appearance.model_surfaces import Surfaces, repeats_of, strip_uv, surfaces_of_models
from mmi.appearance.shading import Looks, contact, light, looks_of
from mmi.appearance.texture_atlas import pack_atlas
from mmi.city.model import PAINTED, City
from mmi.city.outlines import outlines_of
from mmi.city.ranges import numbers_in
from mmi.city.triangulate import triangulate

__all__ = ["CityMesh", "build_city_mesh", "mesh_of", "object_boxes", "triangles_of"]

_FLOATING = 1.0  # metres above ground from which a prism is a bridge or a bay: no doors, but an underside
_BLIND = 1.5  # metres below which a wall has no room for a window


@dataclass(frozen=True, slots=True, eq=False)
class CityMesh:
    """Textured triangles in the city's frame, grouped by object.

    ``positions`` (n, 3) float32 metres; ``uv`` (n, 2) float32, u right and v down, (0, 0) the texture's upper left
    corner, the texture repeats; ``colors`` (n, 3) uint8 multiply the texture; ``triangles`` (m, 3) int32,
    counter-clockwise from outside. Object i owns vertices ``object_vertices[i]`` to ``object_vertices[i + 1]`` and
    likewise ``object_triangles``, both (k + 1,) int64; no triangle uses another object's vertices.
    ``texture`` (h, w, 3) uint8 sRGB, or (h, w, 4) where the city has cut-outs: where alpha is below 128, a surface is clear
    (``mmi.appearance.cut_outs``).
    """

    positions: NDArray[np.float32]
    uv: NDArray[np.float32]
    colors: NDArray[np.uint8]
    triangles: NDArray[np.int32]
    object_vertices: NDArray[np.int64]
    object_triangles: NDArray[np.int64]
    texture: NDArray[np.uint8]
    triangle_counts: NDArray[np.int64] = field(init=False)
    """(k,) triangles of each object."""

    def __post_init__(self) -> None:
        n = len(self.positions)
        if self.positions.shape != (n, 3) or self.uv.shape != (n, 2) or self.colors.shape != (n, 3):
            raise ValueError(
                f"a city mesh needs (n, 3), (n, 2) and (n, 3) vertex arrays, "
                f"found {self.positions.shape}, {self.uv.shape} and {self.colors.shape}"
            )
        if self.texture.ndim != 3 or self.texture.shape[2] not in (3, 4):
            raise ValueError(f"a city mesh needs a texture (h, w, 3 or 4), found {self.texture.shape}")
        if self.object_vertices[-1] != n or self.object_triangles[-1] != len(self.triangles):
            raise ValueError(
                f"a city mesh's offsets end at its {n} vertices and {len(self.triangles)} triangles, "
                f"found {self.object_vertices[-1]} and {self.object_triangles[-1]}"
            )
        object.__setattr__(self, "triangle_counts", np.diff(self.object_triangles))
        for name in self.__slots__:
            getattr(self, name).setflags(write=False)

    @property
    def has_cut_outs(self) -> bool:
        """Whether surfaces may be clear."""
        return self.texture.shape[2] == 4


def build_city_mesh(city: City) -> CityMesh:
    """Textured triangles of all objects of ``city``: walls, roofs and, where prisms float, undersides.

    An object with a ``mesh`` of its own is drawn as that.
    """
    looks = looks_of(city.objects, plain=city.facades == "plain")
    prisms = _prisms_of(city)
    walls, roofs = _walls(prisms, looks), _roofs(prisms, looks)
    modelled = [i for i, one in enumerate(city.objects) if one.mesh is not None]
    meshed = [city.objects[i] for i in modelled]
    if all((one.mesh.textures == PAINTED).all() for one in meshed if one.mesh is not None):
        own = surfaces_of_models(meshed, np.array(modelled, dtype=np.int64), looks, None)
        return _assemble([walls, roofs, *own], len(city.objects), facades.facade_texture())
    painted = bool(len(prisms.owners)) or any(
        (one.mesh.textures == PAINTED).any() for one in meshed if one.mesh is not None
    )
    meshed, pictures = with_coarser_pictures(meshed, city.textures)
    atlas = pack_atlas(pictures, repeats_of(meshed, pictures), painted=painted)
    own = surfaces_of_models(meshed, np.array(modelled, dtype=np.int64), looks, atlas)
    for one in (walls, roofs):
        one.uv[:] *= atlas.facade_scale
    return _assemble([walls, roofs, *own], len(city.objects), atlas.texture)


class _Prisms(NamedTuple):
    """The prisms of all objects without a mesh: ``polygons`` (k,), ``heights`` (k, 2) of bottom and top, ``grounds`` (k,) the
    lowest ground at their corners, all in metres; ``owners`` (k,) are their objects.
    """

    polygons: NDArray[np.object_]
    heights: NDArray[np.float64]
    grounds: NDArray[np.float64]
    owners: NDArray[np.int64]


def _prisms_of(city: City) -> _Prisms:
    prisms = [(i, prism) for i, one in enumerate(city.objects) if one.mesh is None for prism in one.prisms]
    polygons = np.array([prism.footprint for _, prism in prisms], dtype=object)
    return _Prisms(
        polygons=polygons,
        heights=np.array([(prism.bottom, prism.top) for _, prism in prisms]).reshape(-1, 2),
        grounds=_grounds(city, polygons),
        owners=np.array([i for i, _ in prisms], dtype=np.int64),
    )


def _grounds(city: City, polygons: NDArray[np.object_]) -> NDArray[np.float64]:
    """(k,) the lowest ground at the corners of each of ``polygons``, metres."""
    if city.terrain is None or not len(polygons):
        return np.full(len(polygons), city.ground)
    return np.minimum.reduceat(*city.terrain.at_corners(shapely.get_exterior_ring(polygons)))


def mesh_of(city_mesh: CityMesh, objects: ArrayLike) -> CityMesh:
    """The mesh of some objects, in the order given: object j of the result is ``objects[j]`` (indices) of ``city_mesh``."""
    chosen = np.asarray(objects, dtype=np.int64).reshape(-1)
    vertices, vertex_offsets = _ranges(city_mesh.object_vertices, chosen)
    triangles, triangle_offsets = _ranges(city_mesh.object_triangles, chosen)
    shift = vertex_offsets[:-1] - city_mesh.object_vertices[chosen]
    moved = city_mesh.triangles[triangles] + np.repeat(shift, np.diff(triangle_offsets))[:, None]
    return CityMesh(
        positions=city_mesh.positions[vertices],
        uv=city_mesh.uv[vertices],
        colors=city_mesh.colors[vertices],
        triangles=moved.astype(np.int32),
        object_vertices=vertex_offsets,
        object_triangles=triangle_offsets,
        texture=city_mesh.texture,
    )


def triangles_of(mesh: CityMesh, objects: ArrayLike) -> NDArray[np.int32]:
    """(m, 3) the triangles of some objects, still as indices into all of the mesh's vertices."""
    rows, _ = _ranges(mesh.object_triangles, np.asarray(objects, dtype=np.int64).reshape(-1))
    return mesh.triangles[rows]


def object_boxes(mesh: CityMesh) -> NDArray[np.float64]:
    """(k, 2, 3) the lowest and the highest coordinates of each object, metres; NaN for one without vertices."""
    boxes = np.full((len(mesh.triangle_counts), 2, 3), np.nan)
    filled = np.diff(mesh.object_vertices) > 0
    if filled.any():
        starts = mesh.object_vertices[:-1][filled]
        for row, of in enumerate((np.minimum, np.maximum)):
            boxes[filled, row] = of.reduceat(mesh.positions, starts, axis=0)
    boxes.setflags(write=False)
    return boxes


# ------------------------------------------------------------------------------------------------ walls and caps


@dataclass(frozen=True, slots=True, eq=False)
class _Walls:
    """Walls along edges of footprints, from ``a`` to ``b`` (n, 2), of ``prism`` (n,), and how they look at both ends: ``u``
    (n, 2), ``blind`` (n, 2) without windows, and ``base`` (n, 2, 3), tint and light.
    """

    a: NDArray[np.float64]
    b: NDArray[np.float64]
    prism: NDArray[np.int64]
    u: NDArray[np.float64]
    blind: NDArray[np.bool_]
    base: NDArray[np.float64]


def _walls(prisms: _Prisms, looks: Looks) -> Surfaces:
    """Upright quads along every edge of every footprint; several, where a prism has more storeys than the atlas."""
    walls = _walls_along(prisms, looks)
    prism = walls.prism
    bottom, top = prisms.heights[prism].T
    ground = prisms.grounds[prism]
    floating = bottom > ground + _FLOATING
    storeys = np.maximum(1, np.rint((top - bottom) / facades.STOREY)).astype(np.int64)
    first_row = floating.astype(np.int64)  # above a door, only upper storeys
    room = facades.ROWS - 1
    pieces = np.maximum(1, -(-(storeys - (1 - first_row)) // room))

    wall = np.repeat(np.arange(len(prism)), pieces)
    piece = np.arange(len(wall)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    ground_floor = (1 - first_row)[wall]
    from_storey = np.where(piece > 0, piece * room + ground_floor, 0)
    to_storey = np.minimum((piece + 1) * room + ground_floor, storeys[wall])
    low_row = np.where(piece > 0, 1, first_row[wall])
    high_row = low_row + to_storey - from_storey
    rise = ((top - bottom) / storeys)[wall]
    # The ends are the prism's heights themselves, and both pieces at a seam compute the same height.
    low = np.where(from_storey == 0, bottom[wall], bottom[wall] + from_storey * rise)
    high = np.where(to_storey == storeys[wall], top[wall], bottom[wall] + to_storey * rise)

    owner = prisms.owners[prism[wall]]
    style = looks.style[owner]
    plain_u, plain_v = facades.blind_point(style)
    strip_top, strip_bottom = (plain_v, plain_v) if looks.plain else facades.blind_strip(style)
    v_low = [np.where(blind, strip_bottom, facades.storey_v(style, low_row)) for blind in walls.blind[wall].T]
    v_high = [np.where(blind, strip_top, facades.storey_v(style, high_row)) for blind in walls.blind[wall].T]
    ends, u, base = (walls.a[wall], walls.b[wall]), walls.u[wall], walls.base[wall]
    u = np.full_like(u, plain_u) if looks.plain else u
    corners = [
        (ends[k], z, u[:, k], v[k], base[:, k])
        for z, v, k in ((low, v_low, 0), (low, v_low, 1), (high, v_high, 1), (high, v_high, 0))
    ]
    quads = np.arange(len(wall))[:, None, None]
    return Surfaces(
        positions=_interleave([np.column_stack([xy, z]) for xy, z, *_ in corners]),
        uv=_interleave([np.column_stack([u, v]) for _, _, u, v, _ in corners]),
        colors=_interleave([tint * contact(z - ground[wall])[:, None] for _, z, _, _, tint in corners]),
        triangles=(4 * quads + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3),
        owners=np.repeat(owner, 4),
    )


def _walls_along(prisms: _Prisms, looks: Looks) -> _Walls:
    """The walls of all prisms. Whole bays fit between the ends of each that has windows.

    A wall along a cut (:mod:`mmi.city.long_objects`) is painted at each end like the facade that ends there. Nobody sees such a
    wall, except for a pixel at its rims where one part is geometry and its neighbour a texture; that pixel has to look like the
    facade.
    """
    outlines = outlines_of(prisms.polygons)
    a, b = outlines.edges
    length = np.hypot(*(b - a).T)
    long = length > 0.0
    a, b, length, ring = a[long], b[long], length[long], outlines.edge_rings[long]
    prism = outlines.polygon[ring]
    owner = prisms.owners[prism]

    blind = looks.plain | (length < _BLIND) | (_touched(a, b, np.zeros_like(prism)) >= 0)
    bays = np.where(blind, length / facades.BAY, np.maximum(1, np.rint(length / facades.BAY)))
    turn = np.arange(len(prism)) - np.searchsorted(prism, prism)  # which edge of its prism
    u_a = ((looks.bay[owner] + 3 * turn) % facades.BAYS) / facades.BAYS
    u_b = u_a + bays / facades.BAYS
    normal = np.column_stack([b[:, 1] - a[:, 1], a[:, 0] - b[:, 0], np.zeros(len(a))]) / length[:, None]
    base = looks.tint[owner] * light(normal)

    _, height = np.unique(prisms.heights @ [1.0, 1.0j], return_inverse=True)
    across = _touched(a, b, height[prism] * len(looks.whole) + looks.whole[owner])
    is_cut = (across >= 0) & (owner != owner[across])
    before, after = _neighbours(is_cut, ring)
    cut = is_cut & (before >= 0)
    each = np.arange(len(a))
    like = np.column_stack([np.where(cut, before, each), np.where(cut, after, each)])
    u = np.column_stack([np.where(cut, u_b[before], u_a), np.where(cut, u_a[after], u_b)])
    u[cut, 1] += np.rint(u[cut, 0] - u[cut, 1])  # the texture repeats, so this is the short way
    return _Walls(a, b, prism, u, blind[like], base[like])


def _touched(a: NDArray[np.float64], b: NDArray[np.float64], kind: NDArray[np.int64]) -> NDArray[np.int64]:
    """For each edge from ``a`` to ``b`` (n, 2), the place of an edge of the same ``kind`` (n,) that leads from b to a (to the
    centimetre), so that two prisms touch; -1 where there is none.
    """
    x, y = np.rint(100.0 * np.concatenate([a, b])).astype(np.int64).T
    _, points = np.unique((x << 32) + y, return_inverse=True)
    start, end = points.reshape(2, -1).astype(np.int64)
    count = len(points) + 1
    _, edges = np.unique(np.concatenate([start * count + end, end * count + start]), return_inverse=True)
    forth, back = edges.reshape(2, -1).astype(np.int64) * (kind.max(initial=0) + 1) + kind
    order = np.argsort(back, kind="stable")
    place = order[np.searchsorted(back, forth, sorter=order) % max(len(back), 1)]
    return np.where(back[place] == forth, place, -1)


def _neighbours(passed: NDArray[np.bool_], ring: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """For each edge the last before it and the first after it in its ring that are not ``passed``, (n,) both; -1 for none.

    Edges are in the order of the rings, ``ring`` (n,).
    """
    rows = np.append(np.flatnonzero(~passed), -1)
    first, end = (np.searchsorted(ring[rows[:-1]], ring, side=side) for side in ("left", "right"))
    behind = np.searchsorted(rows[:-1], np.arange(len(ring)), side="right")
    before = np.searchsorted(rows[:-1], np.arange(len(ring))) - 1
    none = first == end
    before = np.where(none, -1, np.where(before >= first, before, end - 1))
    behind = np.where(none, -1, np.where(behind < end, behind, first))
    return rows[before], rows[behind]


def _roofs(prisms: _Prisms, looks: Looks) -> Surfaces:
    """Roofs of all prisms, and after each the underside where the prism floats."""
    points, triangles, of = triangulate(prisms.polygons)
    bottom, top = prisms.heights.T
    each = np.arange(len(prisms.polygons) + 1)
    caps = np.repeat(each[:-1], np.where(bottom > prisms.grounds + _FLOATING, 2, 1))
    below = np.zeros(len(caps), dtype=bool)
    below[1:] = caps[1:] == caps[:-1]
    vertices, starts = _ranges(np.searchsorted(of, each), caps)
    rows, row_starts = _ranges(np.searchsorted(of[triangles[:, 0]], each), caps)
    cap = np.repeat(np.arange(len(caps)), np.diff(starts))
    turned = np.repeat(below, np.diff(row_starts))
    used = triangles[rows] + np.repeat(starts[:-1] - np.searchsorted(of, caps), np.diff(row_starts))[:, None]
    used[turned] = used[turned][:, ::-1]
    up, down = light(np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]))
    owner = prisms.owners[caps]
    # Roofs take half of the tint: slate is not the colour of the wall below.
    colors = (0.5 + 0.5 * looks.tint[owner]) * np.where(below[:, None], 0.6 * down, up)
    return Surfaces(
        positions=np.column_stack([points[vertices], np.where(below, bottom[caps], top[caps])[cap]]),
        uv=strip_uv(points[vertices], cap, *(v[owner] for v in facades.roof_strip(looks.style))),
        colors=colors[cap],
        triangles=used,
        owners=owner[cap],
    )


# ----------------------------------------------------------------------------------------------------- mechanics


def _interleave(corners: list[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Arrays (n, d), one a corner -> (n * corners, d), quad by quad."""
    return np.stack(corners, axis=1).reshape(-1, corners[0].shape[1])


def _ranges(offsets: NDArray[np.int64], chosen: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Indices in the chosen ranges [offsets[i], offsets[i + 1]), one after the other, and the offsets of the result."""
    firsts, ends = offsets[chosen], offsets[chosen + 1]
    return numbers_in(firsts, ends), np.concatenate([[0], np.cumsum(ends - firsts)])


def _assemble(surfaces: Sequence[Surfaces], objects: int, texture: NDArray[np.uint8]) -> CityMesh:
    """Group all vertices and triangles by object, keeping the order within one."""
    shifts = np.cumsum([0, *(len(one.positions) for one in surfaces[:-1])])
    owners = np.concatenate([one.owners for one in surfaces]).astype(np.int64)
    triangles = np.concatenate([one.triangles + shift for one, shift in zip(surfaces, shifts, strict=True)])
    triangle_owners = owners[triangles[:, 0]]
    order = np.argsort(owners, kind="stable")
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    # Narrowed before they are joined: this is where a city takes most memory.
    colors = [np.clip(np.rint(255.0 * one.colors), 0, 255).astype(np.uint8) for one in surfaces]
    bounds = np.arange(objects + 1)
    return CityMesh(
        positions=np.concatenate([one.positions for one in surfaces], dtype=np.float32, casting="same_kind")[order],
        uv=np.concatenate([one.uv for one in surfaces], dtype=np.float32, casting="same_kind")[order],
        colors=np.concatenate(colors)[order],
        triangles=place[triangles[np.argsort(triangle_owners, kind="stable")]].astype(np.int32),
        object_vertices=np.searchsorted(owners[order], bounds).astype(np.int64),
        object_triangles=np.searchsorted(np.sort(triangle_owners), bounds).astype(np.int64),
        texture=texture,
    )
