"""TINs and polyhedral surfaces in WKB are read as their polygons; shapely alone reads none of them."""

from __future__ import annotations

import struct

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from mmi.reading.maps.wkb import geometries_from_wkb

HALVES = [shapely.Polygon([(0, 0), (4, 0), (4, 3)]), shapely.Polygon([(0, 0), (4, 3), (0, 3)])]
POLYHEDRAL, TIN, TRIANGLE = 15, 16, 17


def surface(kind, parts, order, part_kind=3):
    """A surface (or collection) of polygons, by its numbers."""
    mark = struct.pack("B", order == "<")
    body = b""
    for part in parts:
        xy = shapely.get_coordinates(part)
        body += mark + struct.pack(order + "III", part_kind, 1, len(xy)) + xy.astype(order + "f8").tobytes()
    return mark + struct.pack(order + "II", kind, len(parts)) + body


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize(("kind", "part"), [(TIN, TRIANGLE), (POLYHEDRAL, 3)])
def test_surfaces_are_their_polygons(kind, part, order):
    wkb = surface(kind, HALVES, order, part)
    assert shapely.from_wkb(wkb, on_invalid="ignore") is None
    (found,) = geometries_from_wkb([wkb])
    assert found.equals(shapely.MultiPolygon(HALVES))


def test_surfaces_in_collections():
    """As GDAL gives a MultiPatch of a strip and a fan, here with a line and a point between them."""
    tin = surface(TIN, HALVES, "<", TRIANGLE)
    others = [shapely.LineString([(0, 0), (1, 1)]), shapely.Point(5, 5)]
    parts = [tin, *(one.wkb for one in others), tin]
    wkb = b"\1" + struct.pack("<II", 7, len(parts)) + b"".join(parts)
    (found,) = geometries_from_wkb([wkb])
    assert [one.geom_type for one in found.geoms] == ["MultiPolygon", "LineString", "Point", "MultiPolygon"]


def test_what_shapely_reads_stays_as_it_is():
    wkb = np.array([HALVES[0].wkb, None, shapely.Point(1, 2).wkb], dtype=object)
    found = geometries_from_wkb(wkb)
    assert [None if one is None else one.wkb for one in found] == wkb.tolist()


@given(st.data())
def test_damage_is_no_geometry(data):
    wkb = bytearray(surface(TIN, HALVES, "<", TRIANGLE))
    for _ in range(data.draw(st.integers(1, 3))):
        wkb[data.draw(st.integers(0, len(wkb) - 1))] = data.draw(st.integers(0, 255))
    (found,) = geometries_from_wkb([bytes(wkb[: data.draw(st.integers(0, len(wkb)))])])
    assert found is None or found.geom_type
