"""A city as everything else sees it: objects made of prisms, and a street graph, in one local metric frame.

World frame: metres, Z up, right-handed, a projected CRS less a recorded origin. Nothing here reads files (``mmi.io`` does)
and nothing here knows about cells or images.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import networkx as nx
import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import LineString, Polygon
from shapely.geometry.base import BaseGeometry

from mmi.errors import CityError

__all__ = ["City", "CityObject", "Prism", "TriangleMesh"]


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
        if not isinstance(self.footprint, Polygon) or self.footprint.is_empty or not self.footprint.is_valid:
            raise CityError(f"a prism needs a valid non-empty polygon, found {shapely.to_wkt(self.footprint, 2)[:120]}")
        if not (np.isfinite(self.bottom) and np.isfinite(self.top) and self.bottom < self.top):
            raise CityError(f"a prism needs finite bottom < top, found bottom {self.bottom!r}, top {self.top!r}")
        object.__setattr__(self, "footprint", shapely.orient_polygons(shapely.force_2d(self.footprint)))


@dataclass(frozen=True, slots=True, eq=False)
class TriangleMesh:
    """A surface that is drawn instead of the extruded prisms: ``vertices`` (n, 3) float64, ``triangles`` (m, 3) int32."""

    vertices: NDArray[np.float64]
    triangles: NDArray[np.int32]

    def __post_init__(self) -> None:
        vertices = np.ascontiguousarray(self.vertices, dtype=np.float64)
        triangles = np.ascontiguousarray(self.triangles, dtype=np.int32)
        if vertices.ndim != 2 or vertices.shape[1] != 3 or not np.isfinite(vertices).all():
            raise CityError(f"a mesh needs finite vertices of shape (n, 3), found shape {vertices.shape}")
        if triangles.ndim != 2 or triangles.shape[1] != 3:
            raise CityError(f"a mesh needs triangles of shape (m, 3), found {triangles.shape}")
        if triangles.size and not (0 <= triangles.min() and triangles.max() < len(vertices)):
            raise CityError(f"mesh triangles need indices in [0, {len(vertices)}), found up to {triangles.max()}")
        vertices.setflags(write=False)
        triangles.setflags(write=False)
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "triangles", triangles)


@dataclass(frozen=True, slots=True, eq=False)
class CityObject:
    """A building, or a block of touching buildings: what layers are made of.

    ``prisms`` bound the object: no point of it lies outside them. Where ``opaque``, they are also what it hides others
    with; an object drawn as ``mesh`` is opaque only if its prisms lie inside the mesh as well. ``id`` is unique in its
    city and stable between readings of the same file (``way/123``), so that a dataset can tell what changed.
    """

    id: str
    prisms: tuple[Prism, ...]
    mesh: TriangleMesh | None = None
    opaque: bool = True
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
    """Objects and streets in one local metric frame.

    ``streets`` is a multigraph: nodes are junctions and ends (attributes ``x``, ``y``), edges are streets between them
    with attributes ``geometry`` (LineString from the lower-numbered node to the other, or as keyed; metres), ``kind``
    (OpenStreetMap highway value, or ``"street"``), ``half_width`` (metres) and ``name`` (may be empty). Edges carry a
    unique integer attribute ``index``, numbered in reading order.

    ``crs`` is what pyproj understands (``"EPSG:32635"``), ``origin`` was subtracted from its coordinates. ``source`` is
    the name of the file (no folders). ``ground`` is the height of the flat ground, metres.
    """

    objects: tuple[CityObject, ...]
    streets: nx.MultiGraph
    crs: str
    origin: tuple[float, float, float]
    source: str
    ground: float = 0.0

    def __post_init__(self) -> None:
        seen: set[str] = set()
        for one in self.objects:
            if one.id in seen:
                raise CityError(f"{self.source}: object ids must be unique, found {one.id} twice")
            seen.add(one.id)
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

    def index(self) -> dict[str, int]:
        """Object id -> its place in ``objects``."""
        return {one.id: i for i, one in enumerate(self.objects)}
