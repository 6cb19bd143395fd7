"""A city as everything else sees it: objects made of prisms or meshes, a street graph, the ground, in one local metric frame.

World frame: metres, Z up, right-handed, a projected CRS less a recorded origin. Nothing here reads files
(``mmi.reading.read_city`` does) and nothing here knows about cells or images.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import networkx as nx
import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray
from shapely.geometry import LineString, Polygon
from shapely.geometry.base import BaseGeometry

from mmi.city.facade_kinds import FACADE_KINDS
from mmi.city.terrain import Terrain
from mmi.foundation.errors import CityError

__all__ = ["PAINTED", "PLAIN", "City", "CityObject", "Prism", "Texture", "TriangleMesh"]

PLAIN = -1
"""In ``TriangleMesh.textures``: a triangle of its own colour."""
PAINTED = -2
"""In ``TriangleMesh.textures``: a triangle without looks of its own, which gets a wall or roof of
``mmi.appearance.facades``.
"""


@dataclass(frozen=True, slots=True, eq=False)
class Prism:
    """A vertical solid: a footprint extruded from ``bottom`` to ``top``.

    ``footprint`` is a valid, non-empty polygon (holes are courtyards) in metres, exterior counter-clockwise and holes
    clockwise (it is turned that way here). ``bottom`` < ``top`` are heights in metres in the city's frame.
    """

    footprint: Polygon
    bottom: float
    top: float

    def __post_init__(self) -> None:
        if not isinstance(self.footprint, Polygon):
            raise CityError(f"a prism needs a polygon, found {self.footprint!r}")
        (plan,) = _plans([self.footprint], [self.bottom], [self.top])
        object.__setattr__(self, "footprint", plan)

    @classmethod
    def each(cls, footprints: Sequence[Polygon], bottoms: Sequence[float], tops: Sequence[float]) -> list[Prism]:
        """A prism for each footprint (n,), bottom (n,) and top (n,); many at once take a fifth of the time of one by one.

        Raises CityError for the first that is none.
        """
        prisms = []
        for plan, bottom, top in zip(_plans(footprints, bottoms, tops), bottoms, tops, strict=True):
            prism = object.__new__(cls)
            for name, value in (("footprint", plan), ("bottom", bottom), ("top", top)):
                object.__setattr__(prism, name, value)
            prisms.append(prism)
        return prisms


def _plans(footprints: Sequence[Polygon], bottoms: Sequence[float], tops: Sequence[float]) -> list[Polygon]:
    """The footprints (n,) of prisms as they should be. Raises CityError for the first that does not make one."""
    shapes = np.empty(len(footprints), dtype=object)
    shapes[:] = footprints
    sound = (shapely.get_type_id(shapes) == 3) & ~shapely.is_empty(shapes) & shapely.is_valid(shapes)
    if not sound.all():
        found = shapely.to_wkt(shapes[np.argmin(sound)], 2)
        raise CityError(f"a prism needs a valid non-empty polygon, found {str(found)[:120]}")
    low, high = np.asarray(bottoms, dtype=np.float64), np.asarray(tops, dtype=np.float64)
    upright = np.isfinite(low) & np.isfinite(high) & (low < high)
    if not upright.all():
        i = int(np.argmin(upright))
        raise CityError(f"a prism needs finite bottom < top, found bottom {bottoms[i]!r}, top {tops[i]!r}")
    # A wall of no length would have no direction.
    return list(shapely.orient_polygons(shapely.remove_repeated_points(shapely.force_2d(shapes))))


@dataclass(frozen=True, slots=True, eq=False)
class Texture:
    """A picture that meshes are covered with: ``image`` (h, w, 3) uint8 sRGB, top row first; ``name`` for files.

    A cut-out (leaves, railings) has a fourth channel: where that is below 128, a surface shows what is behind it.
    """

    name: str
    image: NDArray[np.uint8]

    def __post_init__(self) -> None:
        image = np.ascontiguousarray(self.image)
        if image.ndim != 3 or image.shape[2] not in (3, 4) or image.dtype != np.uint8 or image.size == 0:
            raise CityError(
                f"texture {self.name}: (h, w, 3 or 4) uint8 expected, found {image.dtype} of shape {image.shape}"
            )
        image.setflags(write=False)
        object.__setattr__(self, "image", image)

    @property
    def is_cut_out(self) -> bool:
        """Whether it may have clear texels."""
        return self.image.shape[2] == 4


@dataclass(frozen=True, slots=True, eq=False)
class TriangleMesh:
    """A surface that is drawn instead of the extruded prisms, counter-clockwise from outside.

    ``vertices`` (n, 3) float64 metres, ``triangles`` (m, 3) int32. Each triangle has a place in ``City.textures``, ``PLAIN``
    or ``PAINTED`` (``textures`` (m,) int32, by default all ``PAINTED``), a colour that multiplies its texture (``colors``
    (m, 3) uint8 sRGB, by default white), and texture coordinates of its corners (``uv`` (m, 3, 2) float32, by default 0: u
    right and v *up*, (0, 0) the picture's lower left corner; pictures repeat).
    """

    vertices: NDArray[np.float64]
    triangles: NDArray[np.int32]
    textures: NDArray[np.int32] = None  # type: ignore[assignment]
    colors: NDArray[np.uint8] = None  # type: ignore[assignment]
    uv: NDArray[np.float32] = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        vertices = np.ascontiguousarray(self.vertices, dtype=np.float64)
        triangles = np.ascontiguousarray(self.triangles, dtype=np.int32)
        if vertices.ndim != 2 or vertices.shape[1] != 3 or not np.isfinite(vertices).all():
            raise CityError(f"a mesh needs finite vertices of shape (n, 3), found shape {vertices.shape}")
        if triangles.ndim != 2 or triangles.shape[1] != 3:
            raise CityError(f"a mesh needs triangles of shape (m, 3), found {triangles.shape}")
        if triangles.size and not (0 <= triangles.min() and triangles.max() < len(vertices)):
            raise CityError(f"mesh triangles need indices in [0, {len(vertices)}), found up to {triangles.max()}")
        m = len(triangles)
        textures = np.full(m, PAINTED) if self.textures is None else self.textures
        colors = np.full((m, 3), 255) if self.colors is None else self.colors
        uv = np.zeros((m, 3, 2)) if self.uv is None else self.uv
        textures = np.ascontiguousarray(textures, dtype=np.int32)
        colors = np.ascontiguousarray(colors, dtype=np.uint8)
        uv = np.ascontiguousarray(uv, dtype=np.float32)
        shapes = [textures.shape, colors.shape, uv.shape]
        if shapes != [(m,), (m, 3), (m, 3, 2)] or not np.isfinite(uv).all():
            raise CityError(
                f"a mesh of {m} triangles needs textures (m,), colors (m, 3) and finite uv (m, 3, 2), found {shapes}"
            )
        arrays: tuple[NDArray[Any], ...] = (vertices, triangles, textures, colors, uv)
        for name, array in zip(self.__slots__, arrays, strict=True):
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    def picked(self, places: NDArray[np.intp]) -> TriangleMesh:
        """The triangles at ``places`` (k,), in that order, with the vertices that they need."""
        used, corners = np.unique(self.triangles[places], return_inverse=True)
        return TriangleMesh(
            self.vertices[used],
            corners.reshape(-1, 3).astype(np.int32),
            self.textures[places],
            self.colors[places],
            self.uv[places],
        )


@dataclass(frozen=True, slots=True, eq=False)
class CityObject:
    """A building, or a block of touching buildings: what layers are made of.

    ``prisms`` bound the object: no point of it lies outside them. ``core`` are prisms that lie inside it, or that its walls
    enclose together with those of what touches it (None: its prisms, and nothing for an object drawn as ``mesh``), see
    ``occluders``. ``id`` is unique in its city and stable
    between readings of the same file (``way/123``), so that a dataset can tell what changed. ``part_of`` is the id of the
    object that this one was cut from (:mod:`mmi.city.long_objects`).
    """

    id: str
    prisms: tuple[Prism, ...]
    mesh: TriangleMesh | None = None
    core: tuple[Prism, ...] | None = None
    part_of: str | None = None
    footprint: BaseGeometry = field(init=False)
    """Union of the prisms' footprints: Polygon or MultiPolygon, metres."""

    def __post_init__(self) -> None:
        if not self.id:
            raise CityError("a city object needs a non-empty id")
        if not self.prisms:
            raise CityError(f"object {self.id}: at least one prism expected, found none")
        footprints = [prism.footprint for prism in self.prisms]
        object.__setattr__(self, "footprint", footprints[0] if len(footprints) == 1 else shapely.union_all(footprints))

    @property
    def occluders(self) -> tuple[Prism, ...]:
        """What it surely hides others with."""
        if self.core is not None:
            return self.core
        return self.prisms if self.mesh is None else ()

    @property
    def base(self) -> float:
        """Height of its lowest point, metres."""
        return min(prism.bottom for prism in self.prisms)

    @property
    def top(self) -> float:
        """Height of its highest point, metres."""
        return max(prism.top for prism in self.prisms)

    @property
    def height(self) -> float:
        """Metres from its lowest to its highest point."""
        return self.top - self.base


@dataclass(frozen=True, slots=True, eq=False)
class City:
    """Objects, streets and ground in one local metric frame.

    ``streets`` is a multigraph: nodes are junctions and ends (attributes ``x``, ``y``), edges are streets between them
    with attributes ``geometry`` (LineString from the lower-numbered node to the other, or as keyed; metres), ``kind``
    (OpenStreetMap highway value, or ``"street"``), ``half_width`` (metres) and ``name`` (may be empty). Edges carry a
    unique integer attribute ``index``, numbered in reading order.

    ``crs`` is what pyproj understands (``"EPSG:32635"``), ``origin`` was subtracted from its coordinates. ``source`` is
    the name of the file (no folders). ``ground`` is the height of the flat ground, metres; with a ``terrain``, that of its
    lowest point. ``textures`` are what meshes refer to. ``facades``, one of ``FACADE_KINDS``, is how walls look that have no
    looks of their own.
    """

    objects: tuple[CityObject, ...]
    streets: nx.MultiGraph
    crs: str
    origin: tuple[float, float, float]
    source: str
    ground: float = 0.0
    terrain: Terrain | None = None
    textures: tuple[Texture, ...] = ()
    facades: str = "painted"

    def __post_init__(self) -> None:
        if self.facades not in FACADE_KINDS:
            raise CityError(f"{self.source}: facades {' or '.join(FACADE_KINDS)} expected, found {self.facades!r}")
        if self.terrain is not None:
            object.__setattr__(self, "ground", float(self.terrain.heights.min()))
        seen: set[str] = set()
        for one in self.objects:
            if one.id in seen:
                raise CityError(f"{self.source}: object ids must be unique, found {one.id} twice")
            seen.add(one.id)
            if one.mesh is not None and one.mesh.textures.max(initial=-1) >= len(self.textures):
                raise CityError(
                    f"{self.source}: object {one.id} refers to texture {one.mesh.textures.max()} of {len(self.textures)}"
                )
        for a, b, edge in self.streets.edges(data=True):
            if not isinstance(edge.get("geometry"), LineString):
                raise CityError(f"{self.source}: street {a}-{b} needs a LineString as geometry")

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """(min x, min y, max x, max y) of all objects and streets, metres."""
        shapes = [one.footprint for one in self.objects]
        shapes += [edge["geometry"] for _, _, edge in self.streets.edges(data=True)]
        if not shapes:
            raise CityError(f"{self.source}: an empty city has no bounds")
        x0, y0, x1, y1 = shapely.total_bounds(shapes)
        return float(x0), float(y0), float(x1), float(y1)

    def ground_at(self, points: ArrayLike) -> NDArray[np.float64]:
        """Height of the ground (...), metres, at ``points`` (..., 2 or more: x, y first)."""
        points = np.asarray(points, dtype=np.float64)
        return np.full(points.shape[:-1], self.ground) if self.terrain is None else self.terrain.at(points)

    def index(self) -> dict[str, int]:
        """Object id -> its place in ``objects``."""
        return {one.id: i for i, one in enumerate(self.objects)}
