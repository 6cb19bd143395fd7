"""Motion: speeds, headings, heights and limits, on a plain without walls and beside one."""

import math

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from mmi.walks.walk import Pose
from viewer.scene.walls import RADIUS, Walls
from viewer.window.commands import Held
from viewer.window.motion import EYE_HEIGHT, LONGEST, STEEPEST, Walker, moved

SHARE = st.floats(-1.0, 1.0)
HELD = st.builds(Held, SHARE, SHARE, SHARE, SHARE, SHARE)


class Plain:
    """Level ground at ``height``, a slope in x, and walls where there are any."""

    def __init__(self, *polygons, height=0.0, slope=0.0):
        self.height, self.slope = height, slope
        self.walls = Walls(np.array(polygons, dtype=object))

    def ground(self, point):
        return self.height + self.slope * point[0]

    def slide(self, start, end):
        return self.walls.slide(start, end)

    def freed(self, point):
        return self.walls.freed(point)


def standing(x=0.0, y=0.0, azimuth=0.0, pitch=0.0, z=EYE_HEIGHT):
    return Walker(Pose((x, y, z), azimuth, pitch))


def walked(walker, held, surface, seconds, fast=False, fly=False):
    for _ in range(round(seconds / 0.02)):
        walker = moved(walker, held, (0.0, 0.0), 0.02, surface, fast=fast, fly=fly)
    return walker


@pytest.mark.parametrize(
    ("held", "direction"),
    [
        (Held(forward=1.0), (1.0, 0.0)),
        (Held(forward=-1.0), (-1.0, 0.0)),
        (Held(right=1.0), (0.0, -1.0)),
        (Held(right=-1.0), (0.0, 1.0)),
    ],
)
@pytest.mark.parametrize("azimuth", [0.0, 1.0, -2.5])
def test_directions(held, direction, azimuth):
    x, y, _ = walked(standing(azimuth=azimuth), held, Plain(), 2.0).pose.eye
    cos, sin = math.cos(azimuth), math.sin(azimuth)
    wanted = (cos * direction[0] - sin * direction[1], sin * direction[0] + cos * direction[1])
    assert np.allclose(np.array([x, y]) / math.hypot(x, y), wanted)
    assert 7.0 < math.hypot(x, y) < 8.0  # 4 m/s for 2 s, less the start


def test_who_runs_is_faster_and_diagonals_are_not():
    plain = Plain()
    slow, fast = (walked(standing(), Held(forward=1.0), plain, 1.0, fast=one).pose.eye[0] for one in (False, True))
    assert fast == pytest.approx(3.0 * slow)
    assert math.hypot(*walked(standing(), Held(1.0, 1.0), plain, 1.0).pose.eye[:2]) == pytest.approx(slow)


def test_turning_left_counts_up():
    walker = moved(standing(), Held(turn=1.0, tilt=1.0), (0.0, 0.0), 0.1, Plain())
    assert walker.pose.azimuth > 0.0
    assert walker.pose.pitch > 0.0
    walker = moved(standing(azimuth=3.0), Held(), (0.5, -0.25), 0.0, Plain())
    assert walker.pose.azimuth == pytest.approx(3.5 - math.tau)
    assert walker.pose.pitch == pytest.approx(-0.25)


def test_it_comes_to_a_stand_and_then_is_exactly_still():
    plain = Plain()
    walker = walked(standing(), Held(forward=1.0), plain, 1.0)
    walker = walked(walker, Held(), plain, 2.0)
    assert not walker.moves
    assert moved(walker, Held(), (0.0, 0.0), 0.1, plain) == walker


def test_the_eye_follows_the_ground():
    walker = walked(standing(), Held(forward=1.0), Plain(slope=0.2), 3.0)
    assert walker.pose.eye[0] > 10.0
    assert walker.pose.eye[2] == pytest.approx(0.2 * walker.pose.eye[0] + EYE_HEIGHT)


def test_who_ends_a_flight_comes_down_to_the_ground():
    walker = walked(standing(z=40.0), Held(), Plain(height=5.0), 3.0)
    assert walker.pose.eye[2] == pytest.approx(5.0 + EYE_HEIGHT)
    assert moved(standing(z=40.0), Held(), (0.0, 0.0), 0.02, Plain()).pose.eye[2] > 30.0  # not at once


def test_flight_goes_where_one_looks_and_through_walls():
    wall = shapely.box(5.0, -100.0, 6.0, 100.0)
    x, y, z = walked(standing(pitch=0.5), Held(forward=1.0), Plain(wall), 1.0, fly=True).pose.eye
    assert x > 6.0
    assert y == pytest.approx(0.0)
    assert (z - EYE_HEIGHT) / x == pytest.approx(math.tan(0.5))
    assert walked(standing(), Held(up=-1.0), Plain(), 1.0, fly=True).pose.eye[2] < 0.0


def test_on_foot_a_wall_stops_and_lets_slide():
    wall = Plain(shapely.box(5.0, -100.0, 6.0, 100.0))
    assert walked(standing(), Held(forward=1.0), wall, 5.0).pose.eye[0] == pytest.approx(5.0 - RADIUS, abs=1e-3)
    x, y, _ = walked(standing(azimuth=0.5), Held(forward=1.0), wall, 5.0).pose.eye
    assert x == pytest.approx(5.0 - RADIUS, abs=1e-3)
    assert y > 8.0


def test_who_lands_in_a_building_is_put_outside():
    walker = moved(standing(x=5.5, z=2.0), Held(), (0.0, 0.0), 0.02, Plain(shapely.box(5.0, -100.0, 6.0, 100.0)))
    assert walker.pose.eye[0] < 5.0 - RADIUS or walker.pose.eye[0] > 6.0 + RADIUS


@given(HELD, st.tuples(st.floats(-100.0, 100.0), st.floats(-100.0, 100.0)), st.floats(-1.0, 1e6), st.booleans())
def test_whatever_is_held_the_viewer_stays_in_bounds(held, turned, seconds, fly):
    walker = standing(x=1.0)
    after = moved(walker, held, turned, seconds, Plain(), fast=True, fly=fly)
    assert math.dist(after.pose.eye, walker.pose.eye) <= 60.0 * LONGEST + 1e-9
    assert abs(after.pose.pitch) <= STEEPEST
    assert abs(after.pose.azimuth) <= math.pi
    assert all(map(math.isfinite, (*after.pose.eye, *after.velocity)))
