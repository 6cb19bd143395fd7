"""What is left out of a capture: texels of walls below the lowest that may be seen, and nothing else."""

import math

import numpy as np
import pytest
from cities import block, cell_along_x, city_of
from hills import triangles_of_prism
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles import viewpoints_within
from shapely.geometry import Polygon, box
from solids import CELLS, SOLIDS, Solids, city_from

from mmi.capture.layer_values import DepthTexture
from mmi.capture.unseen import seen_of_meshes, without_unseen
from mmi.city.model import CityObject, Prism, TriangleMesh
from mmi.foundation.camera import level_view
from mmi.visibility.horizon import horizon_visible, prepare_horizon
from mmi.visibility.selection import WallVisibility
from mmi.visibility.walls import walls_of

EYE = np.array([0.0, 0.0, 1.7])
VIEW = level_view(EYE, 0.5 * math.pi, focal=100.0, window=(-64, -64, 128, 80))


def captured(city, objects=None, view=VIEW):
    """A depth texture cast by rays; texels' objects and depths are those of their centres."""
    u, v = (one.ravel() for one in np.meshgrid(*view.pixel_centres()))
    rays = np.column_stack([u / view.focal, -v / view.focal, np.full(len(u), -1.0)]) @ view.eye_from_world[:3, :3]
    depth, ids = Solids(city, objects).cast(np.broadcast_to(view.eye, rays.shape), rays)
    shape = (view.window[3], view.window[2])
    depth, ids = np.where(ids >= 0, depth, np.inf).reshape(shape), ids.reshape(shape)
    color = np.random.default_rng(0).integers(0, 255, (*shape, 3)).astype(np.uint8)
    return DepthTexture(view, color, depth.astype(np.float32), ids.astype(np.int32))


def visibility_of(city, lowest):
    """``lowest`` as given, or the same for all walls."""
    walls = walls_of(city)
    lowest = np.broadcast_to(np.asarray(lowest, dtype=np.float64), (len(walls.a),)).copy()
    return walls, WallVisibility(lowest, np.full(len(lowest), 2**64 - 1, dtype=np.uint64), 64)


def heights(view=VIEW):
    """(h, w) per metre of depth: height above the eye of the texels' centres."""
    return np.broadcast_to(-view.pixel_centres()[1][:, None] / view.focal, (view.window[3], view.window[2]))


class TestWall:
    CITY = city_of(block("wall", -15.0, 50.0, 15.0, 60.0, 20.0))

    @pytest.mark.parametrize("lowest", [1.0, 5.0, 5.26, 12.34])
    def test_exactly_the_texels_go_that_are_a_texel_or_more_below(self, lowest):
        whole = captured(self.CITY)
        left = without_unseen(whole, *visibility_of(self.CITY, lowest))
        z = 1.7 + 50.0 * heights()
        assert np.array_equal(left.coverage, whole.coverage & (z + 50.0 / 100.0 >= lowest))
        assert np.count_nonzero(left.coverage) < np.count_nonzero(whole.coverage)

    def test_what_stays_is_unchanged(self):
        whole = captured(self.CITY)
        left = without_unseen(whole, *visibility_of(self.CITY, 7.0))
        assert left.view is whole.view
        np.testing.assert_array_equal(left.color, whole.color)
        np.testing.assert_array_equal(left.depth[left.coverage], whole.depth[left.coverage])
        np.testing.assert_array_equal(left.object_ids[left.coverage], whole.object_ids[left.coverage])
        assert np.all(np.isinf(left.depth[~left.coverage]))

    def test_a_wall_that_nothing_hides_stays_and_one_that_is_hidden_goes(self):
        whole = captured(self.CITY)
        np.testing.assert_array_equal(without_unseen(whole, *visibility_of(self.CITY, -np.inf)).depth, whole.depth)
        assert not without_unseen(whole, *visibility_of(self.CITY, np.inf)).coverage.any()

    def test_only_the_walls_of_the_object_itself_count(self):
        """Another object's wall in the same place, visible to the ground, saves nothing; nor does a hidden one take."""
        city = city_of(block("wall", -15.0, 50.0, 15.0, 60.0, 20.0), block("before", -15.0, 40.0, 15.0, 50.0, 10.0))
        whole = captured(city, [0])
        walls, _ = visibility_of(city, 0.0)
        lowest = np.where(np.arange(len(walls.a)) < walls.first[1], 10.0, -np.inf)
        left = without_unseen(whole, *visibility_of(city, lowest))
        assert np.array_equal(left.coverage, whole.coverage & (1.7 + 50.0 * heights() + 0.5 >= 10.0))

    def test_slanted_and_turned(self):
        """A wall at an angle, seen by a view that is not along an axis: by the world's heights all the same."""
        shape = Polygon([(-20.0, 40.0), (25.0, 70.0), (20.0, 80.0), (-25.0, 50.0)])
        city = city_of(CityObject("slanted", (Prism(shape, 0.0, 25.0),)))
        view = level_view(np.array([3.0, -2.0, 1.6]), 1.4, focal=137.0, window=(-90, -70, 160, 90))
        whole = captured(city, view=view)
        left = without_unseen(whole, *visibility_of(city, 8.0))
        depth = np.where(whole.coverage, whole.depth, 0.0)
        z = 1.6 + depth * heights(view)
        np.testing.assert_array_equal(left.coverage, whole.coverage & (z + depth / 137.0 >= 8.0))


class TestRoofs:
    def test_a_roof_stays_whatever_is_said_of_walls(self):
        city = city_of(block("flat", -15.0, 30.0, 15.0, 80.0, 6.0))
        view = level_view(np.array([0.0, 0.0, 30.0]), 0.5 * math.pi, focal=100.0, window=(-64, 0, 128, 100))
        whole = captured(city, view=view)
        left = without_unseen(whole, *visibility_of(city, np.inf))
        u, v = np.meshgrid(*view.pixel_centres())
        x, y, z = np.moveaxis(view.unproject(u, v, np.where(whole.coverage, whole.depth, 1.0).astype(float)), -1, 0)
        near_wall = np.minimum.reduce([np.abs(x + 15), np.abs(x - 15), np.abs(y - 30), np.abs(y - 80)])
        roof = whole.coverage & (np.abs(z - 6.0) < 0.01)
        assert np.count_nonzero(roof) > 1000
        assert left.coverage[roof & (near_wall > 0.2)].all()
        assert not left.coverage[whole.coverage & ~roof & (z < 5.0)].any()  # the topmost texels may be the roof's edge

    def test_undersides_stay(self):
        city = city_of(block("bridge", -15.0, 30.0, 15.0, 80.0, 12.0, bottom=9.0))
        whole = captured(city)
        left = without_unseen(whole, *visibility_of(city, np.inf))
        depth = np.where(whole.coverage, whole.depth, 0.0).astype(float)
        x = depth * VIEW.pixel_centres()[0] / VIEW.focal
        under = whole.coverage & (np.abs(1.7 + depth * heights() - 9.0) < 0.01) & (np.abs(x) < 14.8)
        under &= (depth > 30.2) & (depth < 79.8)
        assert np.count_nonzero(under) > 300
        assert left.coverage[under].all()


class TestNearTwoWalls:
    def city(self):
        """Two prisms of one object, the second stands 2 cm behind the first's front: both walls are near each point."""
        first = Prism(Polygon([(-15, 50), (15, 50), (15, 60), (-15, 60)]), 0.0, 20.0)
        second = Prism(Polygon([(-15, 50.02), (15, 50.02), (15, 60), (-15, 60)]), 0.0, 20.0)
        return city_of(CityObject("both", (first, second)))

    @pytest.mark.parametrize("lower", ["first", "second"])
    def test_the_lower_one_counts(self, lower):
        city = self.city()
        walls = walls_of(city)
        front = (walls.a[:, 1] == 50.0) & (walls.b[:, 1] == 50.0)
        behind = (walls.a[:, 1] == 50.02) & (walls.b[:, 1] == 50.02)
        lowest = np.full(len(walls.a), np.inf)
        lowest[front], lowest[behind] = (4.0, 12.0) if lower == "first" else (12.0, 4.0)
        whole = captured(city)
        left = without_unseen(whole, *visibility_of(city, lowest))
        middle = np.zeros_like(whole.coverage)
        middle[:, 40:90] = True
        expected = whole.coverage & (1.7 + 50.0 * heights() + 0.5 >= 4.0)
        np.testing.assert_array_equal(left.coverage[middle], expected[middle])

    def test_at_a_corner_the_wall_around_it_saves_what_is_near(self):
        city = city_of(block("wall", -15.0, 50.0, 15.0, 60.0, 20.0))
        walls = walls_of(city)
        side = (walls.a[:, 0] == 15.0) & (walls.b[:, 0] == 15.0)
        left = without_unseen(captured(city), *visibility_of(city, np.where(side, -np.inf, np.inf)))
        # Within 0.05 m and a thousandth of the distance of x = 15: no texel but perhaps the last (0.5 m a texel).
        columns = np.flatnonzero(left.coverage.any(axis=0))
        assert np.all(columns >= 64 + math.floor(100.0 * 14.9 / 50.0) - 1)


@settings(max_examples=40, deadline=None)
@given(st.lists(SOLIDS, min_size=2, max_size=8), CELLS, st.integers(0, 5))
def test_nothing_that_a_ray_sees_is_left_out(solids, cell, sector):
    """A texel that goes shows a point that no viewpoint of the cell sees, and none within the texel above it."""
    city = city_from(solids, cell, clearance=4.0)
    if not city.objects:
        return
    view = level_view(cell.reference, sector * math.pi / 3.0, focal=60.0, window=(-40, -60, 80, 80))
    seen = horizon_visible(prepare_horizon(city), cell)[1]
    for one in range(len(city.objects)):
        whole = captured(city, [one], view)
        gone = whole.coverage & ~without_unseen(whole, walls_of(city), seen).coverage
        if not gone.any():
            continue
        u, v = np.meshgrid(*view.pixel_centres())
        points = view.unproject(u[gone], v[gone], whole.depth[gone].astype(float) * (1.0 - 1e-5))
        rng = np.random.default_rng(1)
        eyes = viewpoints_within(cell, 60, rng)
        eyes[:4, :2], eyes[:, 2] = cell.corners, cell.eye[1]
        for eye in eyes:
            assert not Solids(city).clear(np.broadcast_to(eye, points.shape), points).any()


def test_a_low_house_in_front_takes_the_foot_of_a_tall_one_from_its_layer():
    city = city_of(block("low", -200.0, 20.0, 200.0, 40.0, 8.0), block("tall", -10.0, 50.0, 10.0, 60.0, 60.0))
    cell = cell_along_x(20.0, 3.0)
    view = level_view(cell.reference, 0.5 * math.pi, focal=200.0, window=(-64, -160, 128, 192))
    whole = captured(city, [1], view)
    left = without_unseen(whole, walls_of(city), horizon_visible(prepare_horizon(city), cell)[1])
    z = cell.reference[2] + 50.0 * heights(view)
    exact = 1.9 + (8.0 - 1.9) * 53.0 / 23.0
    assert left.coverage[whole.coverage & (z > exact)].all()
    assert not left.coverage[z < 0.75 * exact].any()


def behind_a_low_house(solid):
    """A mesh that fills ``solid`` of a prism 40 m deep, behind a low house along the street."""
    hull = Prism(box(-10.0, 50.0, 10.0, 90.0), 0.0, 30.0)
    corners = triangles_of_prism(solid)
    mesh = TriangleMesh(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3))
    return city_of(block("low", -200.0, 20.0, 200.0, 40.0, 8.0), CityObject("mesh", (hull,), mesh))


@pytest.mark.parametrize("back", [90.0, 70.0])
def test_of_a_mesh_what_stands_at_the_back_of_its_prism_stays(back):
    """A tower whose front is 10 cm before the back wall of its prism, which nobody sees, or in the middle of it."""
    tower = Prism(box(-10.0, back - 0.1, 10.0, back), 0.0, 30.0)
    city, cell = behind_a_low_house(tower), cell_along_x(20.0, 3.0)
    walls, seen = walls_of(city), horizon_visible(prepare_horizon(city), cell)[1]
    view = level_view(cell.reference, 0.5 * math.pi, focal=200.0, window=(-64, -160, 128, 192))
    tall = city_of(
        *(CityObject(name, (prism,)) for name, prism in (("low", city.objects[0].prisms[0]), ("tower", tower)))
    )
    whole = captured(tall, [1], view)
    z = cell.reference[2] + (back - 0.1) * heights(view)
    exact = (
        1.9 + (8.0 - 1.9) * (back + 2.9) / 23.0
    )  # what the highest eye at the far side of the cell sees over the low house
    shown = whole.coverage & (z > exact)
    assert shown.any()
    left = without_unseen(whole, walls, seen_of_meshes(city, cell, np.array([1]), walls, seen))
    assert left.coverage[shown].all()
    assert (back < 90.0) == bool(without_unseen(whole, walls, seen).coverage[shown].all())


def test_of_a_mesh_what_a_house_before_it_hides_goes_as_for_prisms():
    hull = Prism(box(-10.0, 50.0, 10.0, 90.0), 0.0, 30.0)
    city, cell = behind_a_low_house(hull), cell_along_x(20.0, 3.0)
    walls, seen = walls_of(city), horizon_visible(prepare_horizon(city), cell)[1]
    meshes = seen_of_meshes(city, cell, np.array([0, 1]), walls, seen)
    front = (walls.a[:, 1] == 50.0) & (walls.b[:, 1] == 50.0)
    assert 8.0 < seen.lowest[front] < 20.0
    assert meshes.lowest[front] == seen.lowest[front]
    low = slice(walls.first[0], walls.first[1])
    np.testing.assert_array_equal(meshes.lowest[low], seen.lowest[low])
    back = (walls.a[:, 1] == 90.0) & (walls.b[:, 1] == 90.0)
    assert seen.lowest[back] == np.inf
    assert meshes.lowest[back] == seen.lowest[front]
