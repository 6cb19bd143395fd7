"""Small city files for tests: OpenStreetMap XML and GeoJSON, written from metres around a place on the earth."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

LON, LAT = 9.0, 48.0
"""Where the metres (0, 0) of ``OsmFile`` and ``degrees`` lie: on the central meridian of UTM zone 32."""


def degrees(geometry: BaseGeometry, *, lon: float = LON, lat: float = LAT) -> BaseGeometry:
    """Metres east and north of a place as longitude and latitude (good to 0.5 % over a kilometre)."""
    per_degree = 111_320.0
    scale = np.array([1 / (per_degree * math.cos(math.radians(lat))), 1 / per_degree])
    return shapely.transform(geometry, lambda xy: xy * scale + (lon, lat))


def geojson(
    path: Path, features: Iterable[tuple[BaseGeometry | None, dict[str, object]]], *, crs: str | None = None
) -> Path:
    """Write (geometry, properties) features; ``crs`` such as ``EPSG:32632`` becomes the old CRS member."""
    document: dict[str, object] = {"type": "FeatureCollection"}
    if crs is not None:
        document["crs"] = {"type": "name", "properties": {"name": f"urn:ogc:def:crs:{crs.replace(':', '::')}"}}
    document["features"] = [
        {
            "type": "Feature",
            "properties": properties,
            "geometry": None if one is None else shapely.geometry.mapping(one),
        }
        for one, properties in features
    ]
    path.write_text(json.dumps(document))
    return path


class OsmFile:
    """OpenStreetMap XML in the making. Points in metres are nodes; equal points are one node."""

    def __init__(self) -> None:
        self._nodes: dict[tuple[float, float], int] = {}
        self._missing: set[int] = set()
        self._ways: list[str] = []
        self._relations: list[str] = []

    def node(self, x: float, y: float) -> int:
        return self._nodes.setdefault((x, y), len(self._nodes) + 1)

    def lose_node(self, x: float, y: float) -> None:
        """Refer to the node, but leave it out of the file."""
        self._missing.add(self.node(x, y))

    def way(self, number: int, points: Sequence[tuple[float, float]], **tags: str) -> None:
        refs = "".join(f'<nd ref="{self.node(*point)}"/>' for point in points)
        self._ways.append(f'<way id="{number}" version="1">{refs}{_tags(tags)}</way>')

    def box(self, number: int, x0: float, y0: float, x1: float, y1: float, **tags: str) -> None:
        self.way(number, [(x0, y0), (x1, y0), (x1, y1), (x0, y1), (x0, y0)], **tags)

    def relation(
        self, number: int, members: Sequence[tuple[int, str]], areas: Sequence[tuple[int, str]] = (), **tags: str
    ) -> None:
        """Members are ways; ``areas`` are members that are relations."""
        both = [("way", *member) for member in members] + [("relation", *area) for area in areas]
        refs = "".join(f'<member type="{kind}" ref="{ref}" role="{role}"/>' for kind, ref, role in both)
        self._relations.append(f'<relation id="{number}" version="1">{refs}{_tags(tags)}</relation>')

    def write(self, path: Path, *, ways_first: bool = False) -> Path:
        lines = []
        for (x, y), number in self._nodes.items():
            if number not in self._missing:
                place = degrees(shapely.Point(x, y))
                lines.append(f'<node id="{number}" version="1" lon="{place.x:.9f}" lat="{place.y:.9f}"/>')
        body = [*self._relations, *self._ways, *lines] if ways_first else [*lines, *self._ways, *self._relations]
        path.write_text('<osm version="0.6">\n' + "\n".join(body) + "\n</osm>\n")
        return path


def _tags(tags: dict[str, str]) -> str:
    """``building__part="yes"`` is building:part=yes."""
    return "".join(f"<tag k={quoteattr(k.replace('__', ':'))} v={quoteattr(v)}/>" for k, v in tags.items())
