"""Rims: what touches shows a texel beyond a layer's silhouette, where it is; other silhouettes stay as they are."""

import math

import numpy as np
import pytest
from cities import block, city_of
from hypothesis import given, settings
from hypothesis import strategies as st

from mmi.appearance.city_mesh import build_city_mesh
from mmi.capture.layer_values import DepthTexture
from mmi.capture.renderer import Capturer
from mmi.capture.rims import touching, with_rims
from mmi.foundation.camera import level_view

VIEW = level_view(np.array([0.0, 0.0, 1.7]), 0.3, focal=100.0, window=(-20, -15, 40, 30))
TOUCH = np.array([[3, 5], [4, 5]])
VIEWPOINTS = VIEW.eye + np.array([[x, y, 0.0] for x in (-3.0, 3.0) for y in (-1.0, 1.0)])
LIMITS = {"viewpoints": VIEWPOINTS, "tolerance": 0.02}
U, V = np.meshgrid(*VIEW.pixel_centres())


def picture(one, depth, where, color=100):
    """A surface of object ``one``, where it is seen."""
    ids = np.where(where, one, -1).astype(np.int32)
    shade = np.broadcast_to(np.where(where, color, 7)[..., None], (*ids.shape, 3)).astype(np.uint8)
    return DepthTexture(VIEW, shade.copy(), np.where(where, depth, np.inf).astype(np.float32), ids)


def wall(nearness=0.02, across=3e-4):
    """1/z is linear in the picture."""
    return 1.0 / (nearness + across * U)


def column(k):
    return np.arange(40)[None, :] == k


LEFT = np.broadcast_to(np.arange(40) < 20, (30, 40))


def seen_apart(place, one, other):
    """Radians between two points of a texel's ray, from the worst of the viewpoints."""
    u, v = (float(array[place]) for array in (U, V))
    rays = [VIEW.unproject(np.array([u]), np.array([v]), np.array([1.0 / w]))[0] - VIEWPOINTS for w in (one, other)]
    a, b = (ray / np.linalg.norm(ray, axis=1, keepdims=True) for ray in rays)
    return float(np.arccos(np.clip((a * b).sum(axis=1), -1.0, 1.0)).max())


def plain_rims(ours, theirs, pairs):
    """The twin of the compiled loop: one texel after the other, in words."""
    color, depth, ids = ours.color.copy(), ours.depth.copy(), ours.object_ids.copy()

    def nearness(texture, place):
        return 1.0 / float(texture.depth[place])

    def object_at(texture, place):
        inside = 0 <= place[0] < depth.shape[0] and 0 <= place[1] < depth.shape[1]
        return int(texture.object_ids[place]) if inside else -1

    for place in zip(*np.nonzero(theirs.coverage), strict=True):
        for step in ((0, 1), (0, -1), (1, 0), (-1, 0)):
            covered, behind, across = (tuple(np.add(place, np.multiply(k, step)).tolist()) for k in (1, 2, -1))
            one, here = object_at(ours, covered), object_at(ours, place)
            if one < 0 or here not in (-1, one):
                continue
            if here == one and depth[place] <= 1.001 * theirs.depth[place]:
                continue
            if (one, object_at(theirs, place)) not in pairs:
                continue
            our, their = nearness(ours, covered), nearness(theirs, place)
            our_slope = our - nearness(ours, behind) if object_at(ours, behind) == one else None
            same = object_at(theirs, across) == object_at(theirs, place)
            their_slope = their - nearness(theirs, across) if same else None
            if our_slope is not None and abs(our_slope) > 0.05 * our:
                our_slope = None
            if their_slope is not None and abs(their_slope) > 0.05 * their:
                their_slope = None
            if our_slope is None:
                our_slope = -their_slope if their_slope is not None else 0.0
            if their_slope is None:
                their_slope = -our_slope
            meets = abs(their + 0.5 * their_slope - our - 0.5 * our_slope) <= 0.01 * their
            if meets and seen_apart(place, their, our + our_slope) <= LIMITS["tolerance"]:
                color[place], depth[place], ids[place] = (
                    theirs.color[place],
                    theirs.depth[place],
                    theirs.object_ids[place],
                )
                break
            if here < 0 and (meets or their > our + our_slope):
                color[place], depth[place], ids[place] = ours.color[covered], 1.0 / (our + our_slope), one
    return color, depth, ids


def test_a_wall_that_goes_on_is_shown_a_texel_farther():
    ours, theirs = picture(3, wall(), LEFT), picture(5, wall(), ~LEFT, color=200)
    found = with_rims(ours, theirs, TOUCH, **LIMITS)
    rim = found.object_ids != ours.object_ids
    assert (rim == column(20)).all()
    for name in ("color", "depth", "object_ids"):
        assert np.array_equal(getattr(found, name)[rim], getattr(theirs, name)[rim])
        assert np.array_equal(getattr(found, name)[~rim], getattr(ours, name)[~rim])


def test_so_is_one_that_turns_at_the_corner():
    # 1/z has the same value between columns 19 and 20, where U is 0, and another slope.
    found = with_rims(picture(3, wall(across=3e-4), LEFT), picture(5, wall(across=-9e-4), ~LEFT), TOUCH, **LIMITS)
    assert (np.isfinite(found.depth) == (LEFT | column(20))).all()
    assert np.allclose(found.depth[:, 20], wall(across=-9e-4)[:, 20])


def test_one_that_turns_far_away_is_continued_instead():
    """A mesh would have to bend by more than the tolerance within a texel."""
    ours, theirs = picture(3, wall(across=3e-4), LEFT), picture(5, wall(across=-9e-4), ~LEFT)
    found = with_rims(ours, theirs, TOUCH, viewpoints=VIEWPOINTS, tolerance=1e-4)
    assert (found.object_ids[:, 20] == 3).all()
    assert np.allclose(found.depth[:, 20], wall(across=3e-4)[:, 20], rtol=1e-4)
    close = VIEW.eye + 40.0 * (VIEWPOINTS - VIEW.eye) / 3.0  # the wall is 50 m away
    assert (with_rims(ours, theirs, TOUCH, viewpoints=close, tolerance=1e-3).object_ids[:, 20] == 3).all()


def test_a_wall_goes_on_behind_what_stands_in_front_of_its_end():
    ours = picture(3, wall(), LEFT)
    found = with_rims(ours, picture(5, 0.5 * wall(), ~LEFT, color=200), TOUCH, **LIMITS)
    rim = found.object_ids != ours.object_ids
    assert (rim == column(20)).all()
    assert np.allclose(found.depth[rim], wall()[rim], rtol=1e-3)
    assert (found.object_ids[rim] == 3).all()
    assert (found.color[rim] == 100).all()


@pytest.mark.parametrize(
    "theirs",
    [picture(5, 1.2 * wall(), ~LEFT), picture(5, wall(), ~LEFT & ~column(20)), picture(5, wall(), np.zeros_like(LEFT))],
    ids=["behind", "apart", "nothing"],
)
def test_other_silhouettes_stay(theirs):
    ours = picture(3, wall(), LEFT)
    found = with_rims(ours, theirs, TOUCH, **LIMITS)
    assert np.array_equal(found.object_ids, ours.object_ids)
    assert np.array_equal(found.depth, ours.depth)


@pytest.mark.parametrize("factor", [1.0, 0.5])
def test_what_does_not_touch_makes_no_rim(factor):
    ours = picture(3, wall(), LEFT)
    found = with_rims(ours, picture(6, factor * wall(), ~LEFT), TOUCH, **LIMITS)
    assert np.array_equal(found.object_ids, ours.object_ids)


def test_a_wing_behind_does_not_tell_how_a_wall_goes_on():
    """Of the last two columns, one shows the wall and one a wing of the same house far behind it."""
    far = np.where(column(18), 3.0, 1.0) * wall()
    found = with_rims(picture(3, far, LEFT), picture(5, wall(), ~LEFT), TOUCH, **LIMITS)
    assert (found.object_ids[:, 20] == 5).all()


@pytest.mark.parametrize(("owner", "gives_way"), [(3, True), (4, False)], ids=["its own", "another's"])
def test_only_an_objects_own_farther_surface_gives_way(owner, gives_way):
    depth = np.where(LEFT, wall(), 1.5 * wall())
    ids = np.where(LEFT, 3, owner).astype(np.int32)
    ours = DepthTexture(VIEW, np.zeros((30, 40, 3), np.uint8), depth.astype(np.float32), ids)
    for factor in (1.0, 0.5):
        found = with_rims(ours, picture(5, factor * wall(), ~LEFT), TOUCH, **LIMITS)
        rim = (found.object_ids == 5).any()
        assert rim == (gives_way and factor == 1.0)


def test_views_must_be_the_same():
    other = level_view(np.array([0.0, 0.0, 1.7]), 0.3, focal=100.0, window=(-10, -15, 20, 30))
    texture = DepthTexture(
        other, np.zeros((30, 20, 3), np.uint8), np.full((30, 20), np.inf, np.float32), np.full((30, 20), -1, np.int32)
    )
    with pytest.raises(ValueError, match="one window expected"):
        with_rims(picture(3, wall(), LEFT), texture, TOUCH, **LIMITS)


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=25, deadline=None)
def test_random_pictures_get_the_rim_that_plain_python_finds(seed):
    rng = np.random.default_rng(seed)

    def some(first):
        blocks = np.kron(rng.integers(-1, 2, (10, 10)), np.ones((3, 4), dtype=np.int64))
        ids = np.where(blocks >= 0, first + blocks, -1).astype(np.int32)
        slope, near = rng.choice([0.0, 2e-4, 2e-3], size=3), rng.choice([0.0, 1e-4, 1e-2], size=3)
        nearness = 0.02 + slope[blocks + 1] * (U - V) + near[blocks + 1]
        depth = np.where(ids >= 0, 1.0 / np.maximum(nearness, 1e-3), np.inf).astype(np.float32)
        return DepthTexture(VIEW, rng.integers(0, 255, (30, 40, 3), dtype=np.uint8), depth, ids)

    ours, theirs = some(0), some(10)
    pairs = [(0, 10), (1, 10), (1, 11)]
    found, (color, depth, ids) = with_rims(ours, theirs, np.array(pairs), **LIMITS), plain_rims(ours, theirs, pairs)
    assert np.array_equal(found.object_ids, ids)
    assert np.array_equal(found.color, color)
    assert np.allclose(found.depth, depth, rtol=1e-6)


def test_touching_is_what_distance_says():
    rng = np.random.default_rng(3)
    corners = rng.integers(0, 30, (40, 2)).astype(float)
    city = city_of(*(block(f"{i}", x, y, x + 4 + 0.04 * (i % 3), y + 3, 9.0) for i, (x, y) in enumerate(corners)))
    chosen = np.array([i for i in range(40) if i % 4])
    found = {tuple(pair) for pair in touching(city, chosen).tolist()}
    prints = [one.footprint for one in city.objects]
    assert found == {(i, j) for i in chosen for j in chosen if i != j and prints[i].distance(prints[j]) <= 0.05}
    assert touching(city, chosen[:0]).shape == (0, 2)


@pytest.mark.parametrize("eye", [(0.0, 0.0, 1.7), (-30.0, 5.0, 1.7), (14.0, -4.0, 11.0)])
def test_a_rim_is_what_all_together_show_there(eye):
    """Three houses of a row, of which the middle one is in a layer: its rim is what a picture of all of them shows there."""
    city = city_of(
        block("low", -20, 30, 0, 40, 6.0), block("middle", 0, 30, 17, 42, 9.0), block("high", 17, 30, 30, 39, 12.0)
    )
    azimuth = math.atan2(30.0 - eye[1], 8.0 - eye[0])
    view = level_view(np.array(eye), azimuth, focal=220.0, window=(-128, -128, 256, 256))
    with Capturer(build_city_mesh(city)) as capturer:
        ours, theirs, both = (capturer.depth_textures(np.array(some), [view])[0] for some in ([1], [0, 2], [0, 1, 2]))
    found = with_rims(ours, theirs, touching(city, np.arange(3)), **LIMITS)
    rim = (found.object_ids != ours.object_ids) | (found.depth != ours.depth)
    shown = rim & (found.object_ids != 1)
    assert shown.sum() > 20
    assert np.array_equal(found.object_ids[shown], both.object_ids[shown])
    assert np.allclose(found.depth[shown], both.depth[shown], rtol=1e-5)
    # All that it covers now and together they would not has been hidden by the others: a texel behind them.
    beyond = rim & ~shown
    assert (theirs.depth[beyond] < found.depth[beyond]).all()
    # Next to what it covers, only sky and what is farther than it is left.
    padded = np.pad(ours.coverage, 1)
    beside = padded[1:-1, :-2] | padded[1:-1, 2:] | padded[:-2, 1:-1] | padded[2:, 1:-1]
    left = beside & ~found.coverage & theirs.coverage
    assert (theirs.depth[left] > 1.005 * found.depth[beside & ours.coverage].min()).all()
