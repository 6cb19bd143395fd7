"""Footprints with a height: prisms whose volume is area times height, and the attributes that tell it."""

from __future__ import annotations

import numpy as np
import pytest

from mmi.reading.city_models.extruded import height_from_attributes, prism_of_rings
from mmi.reading.city_models.faces import triangulate_faces

SQUARE = np.array([(0, 0, 5.0), (10, 0, 5.0), (10, 10, 5.0), (0, 10, 5.0)])
YARD = np.array([(2, 2, 5.0), (6, 2, 5.0), (6, 5, 5.0), (2, 5, 5.0)])


def volume_and_holes(points, faces):
    """Volume within the faces, and how many directed edges have no opposite."""
    rings = [ring for face in faces for ring in face]
    corners = np.concatenate([points[ring] for ring in rings])
    triangles, _ = triangulate_faces(corners, np.array([*map(len, rings)]), np.array([*map(len, faces)]))
    a, b, c = np.moveaxis(corners[triangles] - points[0], 1, 0)
    edges = [(r[k - 1], r[k]) for r in rings for k in range(len(r))]
    return float((a * np.cross(b, c)).sum() / 6.0), len(set(edges) - {(q, p) for p, q in edges})


@pytest.mark.parametrize("outer", [SQUARE, SQUARE[::-1], SQUARE[[0, 1, 1, 2, 3, 0]]])
@pytest.mark.parametrize("yard", [None, YARD, YARD[::-1], YARD[:2]])
def test_prisms_are_closed_and_look_outwards(outer, yard):
    points, faces = prism_of_rings([outer] if yard is None else [outer, yard], 7.0)
    area = 100.0 - (12.0 if yard is not None and len(yard) > 2 else 0.0)
    assert volume_and_holes(points, faces) == (pytest.approx(7.0 * area), 0)
    assert (points[:, 2].min(), points[:, 2].max()) == (5.0, 12.0)


def test_prisms_stand_on_the_lowest_point_and_hang_from_the_highest():
    slope = SQUARE + np.array([(0, 0, 0), (0, 0, 0), (0, 0, 2), (0, 0, 2)])
    for roof, span in ((False, (5.0, 9.0)), (True, (3.0, 7.0))):
        points, _ = prism_of_rings([slope], 4.0, roof=roof)
        assert (points[:, 2].min(), points[:, 2].max()) == span


def test_a_line_is_no_footprint():
    points, faces = prism_of_rings([SQUARE[[0, 1, 0]]], 4.0)
    assert (len(points), faces) == (0, [])


@pytest.mark.parametrize(
    ("attributes", "height", "source"),
    [
        ({"measuredHeight": 12.5}, 12.5, "measuredHeight"),
        ({"measuredHeight": "12,5"}, 12.5, "measuredHeight"),
        ({"measuredHeight": {"value": 40, "uom": "ft"}}, 12.192, "measuredHeight"),
        ({"measuredHeight": {"value": 12.5}}, 12.5, "measuredHeight"),
        ({"measuredHeight": {"value": 12.5, "uom": "#m"}}, 12.5, "measuredHeight"),
        ({"measuredHeight": {"value": 40, "uom": "urn:ogc:def:uom:UCUM::[ft_i]"}}, 12.192, "measuredHeight"),
        ({"height_ft": 40}, 12.192, "height_ft"),
        ({"Height_m": 9}, 9.0, "Height_m"),
        ({"storeysAboveGround": 3}, 9.6, "storeysAboveGround x 3.2 m"),
        ({"storeysAboveGround": 3, "measuredHeight": 8}, 8.0, "measuredHeight"),
        ({"storeysAboveGround": 3, "measuredHeight": -9999}, 9.6, "storeysAboveGround x 3.2 m"),
        ({"measuredHeight": 1e9}, None, ""),
        ({"measuredHeight": True}, None, ""),
        ({"measuredHeight": [3]}, None, ""),
        ({"measuredHeight": None, "roofType": 1000}, None, ""),
        ({"measuredHeight": float("nan")}, None, ""),
        ({}, None, ""),
    ],
)
def test_heights_in_attributes(attributes, height, source):
    found = height_from_attributes(attributes)
    assert found == (None if height is None else (pytest.approx(height), source))
