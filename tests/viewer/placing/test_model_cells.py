"""Cells of a model: every triangle in one, boxes that are tight, and errors of one line."""

import numpy as np
import pytest
from clustered_triangles import clusters

from mmi.foundation.errors import ParameterError
from viewer.placing.model_cells import model_cells


def test_every_triangle_is_in_one_cell_whose_box_fits():
    positions, triangles = clusters()
    cells = model_cells(positions, triangles, depth=4, most=100)
    assert np.array_equal(np.sort(cells.triangles), np.arange(len(triangles)))
    assert cells.counts.sum() == len(triangles)
    assert 1 <= cells.counts.min() <= cells.counts.max() <= 100
    for n in range(len(cells.counts)):
        own = cells.triangles[cells.starts[n] : cells.starts[n + 1]]
        assert (np.diff(own) > 0).all()
        corners = positions[triangles[own]].reshape(-1, 3)
        assert np.array_equal(cells.boxes[n], [corners.min(axis=0), corners.max(axis=0)])
    corners = positions[triangles].reshape(-1, 3)
    assert np.array_equal(cells.bounds, [corners.min(axis=0), corners.max(axis=0)])


def test_large_triangles_do_not_blow_up_small_cells():
    positions, triangles = clusters()
    cells = model_cells(positions, triangles, depth=5, most=1000)
    edge = np.ptp(cells.bounds, axis=0).max()
    sides = np.ptp(cells.boxes, axis=1).max(axis=1)
    assert (sides[sides <= edge / 2] <= 2.0 * edge / 2**5).mean() > 0.95
    floor = [
        n for n in range(len(sides)) if len(triangles) - 1 in cells.triangles[cells.starts[n] : cells.starts[n + 1]]
    ]
    assert cells.counts[floor].sum() <= 2


def test_a_node_holds_what_is_as_small_as_it_and_has_its_middle_in_it():
    """The plain definition, one triangle after the other."""
    rng = np.random.default_rng(5)
    middles, size = rng.uniform(0.0, 32.0, size=(400, 3)), 2.0 ** rng.uniform(-4.0, 4.0, size=(400, 1, 1))
    positions = (middles[:, None] + size * rng.uniform(-0.5, 0.5, size=(400, 3, 3))).reshape(-1, 3)
    triangles = np.arange(1200).reshape(-1, 3)
    cells = model_cells(positions, triangles, depth=4, most=400)
    low, high = positions[triangles].min(axis=1), positions[triangles].max(axis=1)
    origin, edge = low.min(axis=0), (high - low.min(axis=0)).max()
    nodes = []
    for one, other in zip(low, high, strict=True):
        depth = max(k for k in range(5) if k == 0 or edge / 2**k >= (other - one).max())
        place = np.minimum(((one + other) / 2 - origin) / edge * 2**depth, 2**depth - 1).astype(int)
        nodes.append((depth, *place.tolist()))
    of = np.empty(400, dtype=int)
    of[cells.triangles] = np.repeat(np.arange(len(cells.counts)), cells.counts)
    assert len(set(zip(nodes, of.tolist(), strict=True))) == len(set(nodes)) == len(cells.counts)


@pytest.mark.parametrize(
    ("positions", "triangles", "told"),
    [
        (np.zeros((3, 3)), np.zeros((0, 3), dtype=int), "some triangles expected, found none"),
        (np.array([[0.0, 0, 0], [np.nan, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]]), "finite corners expected"),
        (
            np.eye(3),
            np.repeat([[0, 1, 2]], 11, axis=0),
            "at most 10 triangles: expected, found 11 on top of each other near",
        ),
    ],
)
def test_what_has_no_cells(positions, triangles, told):
    with pytest.raises(ParameterError, match=told):
        model_cells(positions, triangles, depth=5, most=10)


def test_the_same_model_has_the_same_cells():
    one, other = (model_cells(*clusters(), depth=5, most=70) for _ in range(2))
    assert all(np.array_equal(getattr(one, name), getattr(other, name)) for name in one.__slots__)
