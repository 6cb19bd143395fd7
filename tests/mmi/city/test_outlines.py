import itertools

import numpy as np
import pytest
from shapely.geometry import Polygon, box

from mmi.city.outlines import outlines_of

YARD = Polygon([(0, 0), (9, 0), (9, 9), (0, 9)], [[(2, 2), (2, 4), (4, 4)], [(5, 5), (5, 6), (6, 6)]])


@pytest.mark.parametrize("polygons", [[YARD], [box(0, 0, 1, 2), YARD, Polygon(), box(3, 3, 4, 5)], [Polygon()], []])
def test_edges_are_those_of_a_loop_over_rings(polygons):
    expected = [
        (a, b, ring, i)
        for ring, (i, one) in enumerate(
            [(i, one) for i, shape in enumerate(polygons) if not shape.is_empty
             for one in (shape.exterior, *shape.interiors)]
        )
        for a, b in itertools.pairwise(one.coords)
    ]  # fmt: skip
    found = outlines_of(np.array(polygons, dtype=object))
    a, b = found.edges
    assert [(*pair,) for pair in zip(map(tuple, a.tolist()), map(tuple, b.tolist()), strict=True)] == [
        (one[0], one[1]) for one in expected
    ]
    assert found.edge_rings.tolist() == [one[2] for one in expected]
    assert found.polygon[found.edge_rings].tolist() == [one[3] for one in expected]
