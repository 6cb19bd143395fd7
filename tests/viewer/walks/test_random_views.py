import math

import numpy as np
import pytest
import shapely

from mmi.foundation.errors import ParameterError
from mmi.parallax.critical_zone import cell_region
from viewer.walks.random_views import random_views


def test_views_lie_anywhere_in_cells_and_nowhere_else(scene):
    cells = {cell.id: cell for cell in scene.whereabouts.cells}
    views = random_views(scene.whereabouts.cells, 400, seed=3)
    assert len(views) == 400
    assert {name for name, _ in views} == set(cells)
    assert [name for name, _ in views] == sorted(name for name, _ in views)
    along = []
    for name, pose in views:
        cell = cells[name]
        assert shapely.distance(shapely.Point(pose.eye[:2]), cell_region(cell)) < 1e-9
        assert cell.eye[0] <= pose.eye[2] <= cell.eye[1]
        assert math.dist(pose.eye, cell.reference) > 0.0, "never where layers were captured"
        assert pose.pitch == 0.0
        along.append(math.dist(pose.eye[:2], cell.p) / math.hypot(cell.length, cell.half_width))
    assert np.histogram(along, bins=4, range=(0.0, 1.0))[0].min() > 60
    assert np.histogram([pose.azimuth for _, pose in views], bins=4, range=(-math.pi, math.pi))[0].min() > 60


def test_a_seed_decides(scene):
    first, again, other = (random_views(scene.whereabouts.cells, 20, seed=seed) for seed in (1, 1, 2))
    assert first == again
    assert first != other


def test_no_cells_and_no_views_are_refused(scene):
    with pytest.raises(ParameterError, match="cells"):
        random_views((), 5, seed=1)
    with pytest.raises(ParameterError, match="1 to 100000 views"):
        random_views(scene.whereabouts.cells, 0, seed=1)
