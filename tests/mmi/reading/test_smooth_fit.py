"""The ground through the feet of buildings: planes, valleys, wrong feet, streets on a slope, and what is said of it."""

import numpy as np
import pytest
import shapely

from mmi.city.terrain import Terrain
from mmi.reading.ground.ground import ground_of_buildings
from mmi.reading.ground.smooth_fit import fitted_ground
from mmi.reading.report import Ledger
from tests.cities import block

EXTENT = 400.0
NO_STREETS = np.empty(0, dtype=object)


def buildings(rng, number):
    middles, halves = rng.uniform(0.0, EXTENT, (number, 2)), rng.uniform(4.0, 8.0, (number, 2))
    return shapely.box(*(middles - halves).T, *(middles + halves).T)


def feet_on(outlines, height):
    """The lowest ground at the corners of each box, as a level floor that nowhere hangs has it."""
    corners = shapely.get_coordinates(outlines)
    return height(corners).reshape(len(outlines), -1).min(axis=1)


def fitted(outlines, feet, streets=NO_STREETS):
    return fitted_ground(outlines, feet, bounds=(-30.0, -30.0, EXTENT + 30.0, EXTENT + 30.0), streets=streets)


def plane(points):
    return 100.0 + 0.06 * points[:, 0] - 0.03 * points[:, 1]


def inner(rng, number=400):
    return rng.uniform(0.1 * EXTENT, 0.9 * EXTENT, (number, 2))


@pytest.mark.parametrize("seed", range(3))
def test_an_inclined_plane_is_found_though_one_foot_in_twenty_is_wrong(seed):
    rng = np.random.default_rng(seed)
    outlines = buildings(rng, 300)
    feet = feet_on(outlines, plane) + rng.normal(0.0, 0.02, 300)
    wrong = rng.random(300) < 0.05
    feet[wrong] += rng.choice([-6.0, -3.0, 15.0, 50.0], wrong.sum())
    fit = fitted(outlines, feet)
    places = inner(rng)
    assert np.abs(fit.terrain.at(places) - plane(places)).max() < 0.06
    assert fit.wrong.tolist() == wrong.tolist()
    assert np.abs(fit.misfits[~wrong]).max() < 0.3


def test_a_valley_is_followed():
    rng = np.random.default_rng(4)

    def valley(points):
        return 10.0 * (1.0 - np.cos(2.0 * np.pi * (points[:, 0] / EXTENT - 0.5)))

    outlines = buildings(rng, 400)
    fit = fitted(outlines, feet_on(outlines, valley))
    places = inner(rng)
    assert np.abs(fit.terrain.at(places) - valley(places)).max() < 1.0
    assert np.median(np.abs(fit.terrain.at(places) - valley(places))) < 0.15


def test_no_ground_is_higher_or_lower_than_the_feet():
    rng = np.random.default_rng(5)
    outlines = buildings(rng, 60)
    feet = rng.uniform(0.0, 4.0, 60) + 0.05 * shapely.get_x(shapely.centroid(outlines))
    fit = fitted(outlines, feet)
    sound = feet[~fit.wrong]
    assert sound.min() <= fit.terrain.heights.min() and fit.terrain.heights.max() <= sound.max()


def test_a_street_along_a_slope_is_level_across():
    """Two rows of houses, 1 m apart in height, on both sides of a street: the slope is under the houses."""
    x = np.arange(10.0, EXTENT - 10.0, 14.0)
    low, high = (shapely.box(x - 6.0, y, x + 6.0, y + 12.0) for y in (182.0, 206.0))
    outlines = np.concatenate([low, high])
    feet = np.repeat([20.0, 21.0], len(x))
    street = shapely.linestrings([[(0.0, 200.0), (EXTENT, 200.0)]])
    along = np.linspace(50.0, EXTENT - 50.0, 60)

    def tilt(fit):
        edges = [fit.terrain.at(np.column_stack([along, np.full(60, 200.0 + aside)])) for aside in (-3.0, 3.0)]
        return np.abs(edges[1] - edges[0]) / 6.0

    before, after = tilt(fitted(outlines, feet)), tilt(fitted(outlines, feet, np.asarray(street)))
    assert after.max() < 0.6 * before.max() and after.max() < 0.03


@pytest.mark.parametrize("number", [1, 2, 3])
def test_few_feet(number):
    outlines = shapely.box(
        *np.array([(50.0, 50.0, 60.0, 60.0), (200.0, 90.0, 212.0, 99.0), (300.0, 300.0, 310.0, 312.0)]).T
    )
    feet = np.array([3.0, 5.0, 8.0])[:number]
    fit = fitted(outlines[:number], feet)
    assert np.isfinite(fit.terrain.heights).all()
    assert np.abs(fit.misfits).max() < 1.0


def test_many_feet_take_a_grid_of_bounded_size():
    rng = np.random.default_rng(6)
    middles = rng.uniform(0.0, 20_000.0, (5000, 2))
    outlines = shapely.box(*(middles - 5.0).T, *(middles + 5.0).T)
    fit = fitted_ground(outlines, plane(middles), bounds=(0.0, 0.0, 20_000.0, 20_000.0), streets=NO_STREETS)
    assert max(fit.terrain.heights.shape) <= 161
    assert np.median(np.abs(fit.terrain.at(middles) - plane(middles))) < 1.0


def hillside(rng, number=80):
    """Houses on a plane, of which one has a basement."""
    objects = []
    for k, (x, y) in enumerate(rng.uniform(0.0, EXTENT, (number, 2))):
        foot = float(plane(np.array([[x, y - 0.0], [x, y + 10.0]])).min())
        foot -= 5.0 if k == 7 else 0.0
        objects.append(block(f"b{k}", x, y, x + 10.0, y + 10.0, foot + 9.0, bottom=foot))
    return objects


def test_what_is_said_of_a_guessed_ground():
    ledger = Ledger()
    ground = ground_of_buildings(hillside(np.random.default_rng(7)), [], (0.0, 0.0, EXTENT, EXTENT), ledger)
    assert isinstance(ground, Terrain)
    report = ledger.report(source="", crs="local", origin=(0.0, 0.0, 0.0))
    (warning,) = report.warnings
    assert "--terrain FILE" in warning and "of 80 buildings" in warning and "1 is taken to be wrong" in warning
    (noted,) = report.noted
    assert noted.examples == ("b7",)


def test_one_basement_leaves_its_neighbours_standing():
    objects = hillside(np.random.default_rng(8))
    ledger = Ledger()
    ground_of_buildings(objects, [], (0.0, 0.0, EXTENT, EXTENT), ledger)
    assert ledger.count("inferred", "ground from the feet of the buildings") == len(objects)
