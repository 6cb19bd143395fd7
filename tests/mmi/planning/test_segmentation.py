"""Near and far by distance and by triangle budget, on a row of houses along a street."""

import networkx as nx
import numpy as np
import pytest
from shapely.geometry import box

from mmi.cells.viewing_cells import ViewingCell
from mmi.city.model import City, CityObject, Prism
from mmi.foundation.errors import ParameterError
from mmi.planning.segmentation import near_by_distance, near_by_slope, near_by_triangles
from mmi.visibility.selection import Selection, chain, everything

CELL = ViewingCell("c", (0.0, 0.0), (20.0, 0.0), 3.0, (1.5, 1.9))
# Metres from the rectangle |y| <= 3, 0 <= x <= 20:          40        0 (touching)       12            5 (corner: 3, 4)
PLACES = [box(60, 0, 70, 5), box(5, 3, 10, 8), box(5, -25, 10, -15), box(23, 7, 30, 9)]


@pytest.fixture
def city():
    objects = tuple(CityObject(f"way/{i}", (Prism(place, 0.0, 9.0),)) for i, place in enumerate(PLACES))
    return City(objects, nx.MultiGraph(), "EPSG:32631", (0.0, 0.0, 0.0), "row")


@pytest.mark.parametrize(
    ("distance", "near"),
    [(0.0, [1]), (4.99, [1]), (5.0, [1, 3]), (12.0, [1, 2, 3]), (39.0, [1, 2, 3]), (1e4, [0, 1, 2, 3])],
)
def test_distance_is_measured_to_the_rectangle(city, distance, near):
    selection = near_by_distance(distance)(everything(city, CELL))
    assert selection.near.tolist() == near
    assert np.union1d(selection.near, selection.far).tolist() == [0, 1, 2, 3]


@pytest.mark.parametrize(
    ("budget", "near"), [(0, []), (9, []), (10, [1]), (29, [1]), (30, [1, 3]), (70, [1, 2, 3]), (100, [0, 1, 2, 3])]
)
def test_nearest_objects_come_first_within_the_budget(city, budget, near):
    selection = near_by_triangles(budget, [30, 10, 40, 20])(everything(city, CELL))
    assert selection.near.tolist() == near


def test_an_object_that_does_not_fit_ends_the_near_geometry(city):
    # Object 3 (second nearest) is too large; the farther ones would fit, but must not overtake it.
    assert near_by_triangles(50, [1, 10, 1, 1000])(everything(city, CELL)).near.tolist() == [1]


@pytest.mark.parametrize(
    ("slope", "near"), [(1.51, [1]), (1.49, [1, 3]), (0.63, [1, 3]), (0.62, [1, 2, 3]), (0.18, [0, 1, 2, 3])]
)
def test_what_rises_too_steeply_is_near(city, slope, near):
    # All reach 7.5 m above the lower eye: slopes 7.5 / 40, unbounded, 7.5 / 12 and 7.5 / 5.
    assert near_by_slope(slope)(everything(city, CELL)).near.tolist() == near


def test_only_selected_objects_count_and_near_ones_stay_near(city):
    start = Selection(city, CELL, np.array([0, 2, 3]), np.array([0]))
    assert near_by_distance(6.0)(start).near.tolist() == [0, 3]
    assert near_by_triangles(20, [30, 10, 40, 20])(start).near.tolist() == [0, 3]
    both = chain(near_by_distance(6.0), near_by_distance(20.0))(everything(city, CELL))
    assert both.near.tolist() == [1, 2, 3]


def test_nothing_selected(city):
    nothing = Selection(city, CELL, np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64))
    assert near_by_distance(50.0)(nothing).near.size == 0
    assert near_by_triangles(50, [1, 1, 1, 1])(nothing).near.size == 0


@pytest.mark.parametrize("distance", [-1.0, float("nan"), float("inf")])
def test_nonsense_distance(distance):
    with pytest.raises(ParameterError, match="near distance"):
        near_by_distance(distance)


@pytest.mark.parametrize("slope", [0.0, -1.0, float("nan")])
def test_nonsense_slope(slope):
    with pytest.raises(ParameterError, match="steepest slope"):
        near_by_slope(slope)


def test_nonsense_budget_and_counts(city):
    with pytest.raises(ParameterError, match="triangle budget"):
        near_by_triangles(-1, [1])
    with pytest.raises(ValueError, match="one triangle count per object"):
        near_by_triangles(1, [1, 2])(everything(city, CELL))
