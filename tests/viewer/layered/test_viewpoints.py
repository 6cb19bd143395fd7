import numpy as np
import pytest
from placed_pictures import view_at

from viewer.layered.viewpoints import COUNTS, construction_views, window_around

BOX = np.array([(x, y, z) for x in (10.0, 30.0) for y in (-5.0, 4.0) for z in (-3.0, 6.0)])


def eyes(count, *, depth=10.0, radius=20.0, arrangement="figure 11"):
    return np.array(
        [one.eye for one in construction_views(view_at(), depth, radius, count, BOX, arrangement=arrangement)]
    )


def test_viewpoints_are_half_way_to_the_edges_and_mirrored():
    found = eyes(9)  # the window of 48 x 36 pixels at a focal length of 40 is 12 m x 9 m at 10 m
    ahead = [(5.0, 3.0, 0.0), (5.0, -3.0, 0.0), (5.0, 0.0, 2.25), (5.0, 0.0, -2.25)]
    assert found[:5] == pytest.approx(np.array([(0.0, 0.0, 0.0), *ahead]), abs=1e-12)
    assert found[5:] == pytest.approx(-np.array(ahead), abs=1e-12)
    for count in COUNTS:
        assert eyes(count) == pytest.approx(found[:count])


@pytest.mark.parametrize("arrangement", ["figure 11", "ahead"])
@pytest.mark.parametrize("radius", [1.0, 4.0, 9.0])
def test_none_is_farther_than_the_radius(radius, arrangement):
    found = eyes(9, radius=radius, arrangement=arrangement)
    assert np.linalg.norm(found, axis=1).max() <= radius + 1e-9


def test_ahead_all_viewpoints_are_where_eyes_may_be():
    found = eyes(9, radius=9.0, arrangement="ahead")[1:]
    u, v, depth = np.moveaxis(view_at().project(found), -1, 0)
    assert (depth > 0.0).all()
    assert (abs(u) <= 24.0 + 1e-9).all()
    assert (abs(v) <= 18.0 + 1e-9).all()


def test_windows_cover_what_is_captured():
    for view in construction_views(view_at(), 10.0, 20.0, 9, BOX)[1:]:
        left, top, width, height = view.window
        u, v, depth = np.moveaxis(view.project(BOX), -1, 0)
        assert (depth > 0.0).all()
        assert u.min() >= left > u.min() - 1.0
        assert v.min() >= top > v.min() - 1.0
        assert u.max() <= left + width < u.max() + 1.0
        assert v.max() <= top + height < v.max() + 1.0


def test_windows_end_where_nobody_looks():
    left, top, width, height = window_around(view_at((20.0, 0.0, 0.0)), BOX)
    assert (left, top, width, height) == (-80, -80, 160, 160)


def test_other_numbers_of_pictures_are_refused():
    with pytest.raises(ValueError, match="1, 5 or 9 pictures expected, found 4"):
        construction_views(view_at(), 10.0, 5.0, 4, BOX)
