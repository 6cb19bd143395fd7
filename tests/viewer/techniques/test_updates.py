"""What a view shows of boxes, and what a capture covers, against points of the boxes projected one by one."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mmi.foundation.camera import view_towards
from mmi.validity.layers import layer_parallax
from viewer.plan import RELIEF_QUAD, ImageKey, ReliefPart
from viewer.techniques.updates import CapturedLayer, _join, bounds_in, capture_window, cell_units, spans_of

WINDOW = (-128, -96, 256, 192)
FOCAL = 220.0


def view_from(eye, azimuth, pitch=0.0):
    return view_towards(np.array(eye, dtype=float), azimuth, pitch, focal=FOCAL, window=WINDOW)


@st.composite
def box_sets(draw):
    rng = np.random.default_rng(draw(st.integers(0, 10**6)))
    count = draw(st.integers(1, 6))
    low = rng.uniform([-60.0, -60.0, -5.0], [60.0, 60.0, 20.0], (count, 3))
    return np.stack([low, low + rng.uniform(0.5, 25.0, (count, 3))], axis=1)


def points_of(boxes, rng, each=200):
    t = rng.uniform(size=(len(boxes), each, 3))
    corners = rng.integers(0, 2, (len(boxes), each, 3)).astype(float)
    t = np.where(rng.uniform(size=(len(boxes), each, 1)) < 0.3, corners, t)
    return boxes[:, None, 0] + t * (boxes[:, None, 1] - boxes[:, None, 0])


@settings(deadline=None)
@given(box_sets(), st.floats(-3.1, 3.1), st.floats(-0.7, 0.7), st.integers(0, 99))
def test_bounds_hold_every_point_in_front_of_the_eye(boxes, azimuth, pitch, seed):
    view = view_from((1.0, 2.0, 1.7), azimuth, pitch)
    bounds = bounds_in(view, boxes)
    seen = view.project(points_of(boxes, np.random.default_rng(seed)))
    for (left, top, right, bottom), some in zip(bounds, seen, strict=True):
        u, v = some[some[:, 2] > 0.1, :2].T
        if np.isnan(left):
            assert not u.size
            continue
        assert (u >= left - 1e-6).all() and (u <= right + 1e-6).all()
        assert (v >= top - 1e-6).all() and (v <= bottom + 1e-6).all()


@settings(deadline=None)
@given(box_sets(), st.floats(-3.1, 3.1), st.integers(0, 40), st.integers(0, 99))
def test_a_window_and_its_spans_hold_all_that_the_view_shows(boxes, azimuth, margin, seed):
    view = view_from((1.0, 2.0, 1.7), azimuth)
    bounds = bounds_in(view, boxes)
    place = capture_window(view, bounds, margin=margin)
    u, v, depth = np.moveaxis(view.project(points_of(boxes, np.random.default_rng(seed))), -1, 0)
    left, top, width, height = view.window
    inside = depth > 0.1
    inside &= (u >= left - margin) & (u < left + width + margin) & (v >= top - margin) & (v < top + height + margin)
    if place is None:
        assert not inside.any()
        return
    x, y, w, h = place.window
    assert ((u[inside] >= x) & (u[inside] <= x + w) & (v[inside] >= y) & (v[inside] <= y + h)).all()
    if place.whole:
        assert inside.all()
    spans = spans_of(view.cropped(place.window), bounds)
    assert spans.shape == (-(-w // RELIEF_QUAD), 2) and (spans >= 0).all() and (spans <= h).all()
    column = np.minimum(((u[inside] - x) // RELIEF_QUAD).astype(int), len(spans) - 1)
    assert ((v[inside] - y >= spans[column, 0]) & (v[inside] - y <= spans[column, 1])).all()


def test_boxes_on_either_side_of_a_view_are_not_in_it():
    """The box around both is; to take its part of the view for something to capture ended the frame with an error."""
    view = view_from((0.0, 0.0, 1.7), 0.0)
    beside = np.array([[[20.0, 40.0, 0.0], [22.0, 44.0, 6.0]], [[20.0, -44.0, 0.0], [22.0, -40.0, 6.0]]])
    bounds = bounds_in(view, beside)
    assert bounds[:, 0].min() < WINDOW[0] and bounds[:, 2].max() > WINDOW[0] + WINDOW[2]
    assert capture_window(view, bounds, margin=0) is None
    assert capture_window(view, bounds, margin=600) is not None
    one_more = np.concatenate([beside, [[[20.0, -1.0, 0.0], [22.0, 1.0, 6.0]]]])
    assert capture_window(view, bounds_in(view, one_more), margin=0) is not None


def captured(view, boxes, margin):
    place = capture_window(view, bounds_in(view, boxes), margin=margin)
    if place is None:
        return None
    part = ReliefPart(view.cropped(place.window), (0, 0), 10.0)
    nearest = np.linalg.norm(np.clip(view.eye, boxes[:, 0], boxes[:, 1]) - view.eye, axis=1).min()
    return CapturedLayer(ImageKey("test", "one"), part, place, layer_parallax(view.eye, boxes), float(nearest))


@settings(deadline=None)
@given(
    box_sets(),
    st.floats(-3.1, 3.1),
    st.floats(-0.3, 0.3),
    st.tuples(st.floats(-2.0, 2.0), st.floats(-2.0, 2.0)),
    st.integers(0, 64),
    st.integers(0, 99),
)
def test_what_covers_a_view_has_every_point_that_it_shows(boxes, azimuth, turn, step, margin, seed):
    before = view_from((1.0, 2.0, 1.7), azimuth)
    after = view_from((1.0 + step[0], 2.0 + step[1], 1.7), azimuth + turn)
    layer = captured(before, boxes, margin)
    if layer is None or not layer.covers(after):
        return
    points = points_of(boxes, np.random.default_rng(seed)).reshape(-1, 3)
    u, v, depth = after.project(points).T
    left, top, width, height = after.window
    shown = (depth > 0.1) & (u >= left) & (u < left + width) & (v >= top) & (v < top + height)
    x, y, w, h = layer.place.window
    u, v, depth = before.project(points[shown]).T
    assert (depth > 0.0).all()
    assert ((u >= x - 1e-6) & (u <= x + w + 1e-6) & (v >= y - 1e-6) & (v <= y + h + 1e-6)).all()


def covers_plainly(layer, view):
    """``CapturedLayer.covers`` with arrays."""
    if layer.place.whole:
        return True
    left, top, width, height = view.window
    x, y, w, h = layer.place.window
    if layer.aligned(view):
        low, high = np.array([left, top], dtype=float), np.array([left + width, top + height], dtype=float)
    else:
        u = left + width * np.array([0.0, 0.5, 1.0, 1.0, 1.0, 0.5, 0.0, 0.0])
        v = top + height * np.array([0.0, 0.0, 0.0, 0.5, 1.0, 1.0, 1.0, 0.5])
        rays = np.stack([u / view.focal, -v / view.focal, -np.ones(8)], axis=1)
        turned = rays @ view.eye_from_world[:3, :3] @ layer.view.eye_from_world[:3, :3].T
        if (turned[:, 2] > -1e-3).any():
            return False
        at = layer.view.focal * turned[:, :2] / -turned[:, 2:] * np.array([1.0, -1.0])
        moved = float(np.linalg.norm(view.eye - layer.view.eye))
        edge = float(np.hypot(at, layer.view.focal).max()) / layer.view.focal
        shift = layer.view.focal * edge * edge * moved / max(layer.depth - moved, 1e-3)
        low, high = at.min(axis=0) - shift, at.max(axis=0) + shift
    low, high = np.maximum(low, layer.place.bounds[:2]), np.minimum(high, layer.place.bounds[2:])
    if (low >= high).any():
        return True
    return bool(low[0] >= x and low[1] >= y and high[0] <= x + w and high[1] <= y + h)


@settings(deadline=None)
@given(
    box_sets(),
    st.floats(-3.1, 3.1),
    st.one_of(st.floats(-0.3, 0.3), st.floats(-3.1, 3.1)),
    st.floats(-0.5, 0.5),
    st.tuples(st.floats(-2.0, 2.0), st.floats(-2.0, 2.0)),
    st.integers(0, 64),
)
def test_what_is_compiled_says_the_same_of_what_is_covered(boxes, azimuth, turn, pitch, step, margin):
    before = view_from((1.0, 2.0, 1.7), azimuth)
    after = view_from((1.0 + step[0], 2.0 + step[1], 1.7), azimuth + turn, pitch)
    layer = captured(before, boxes, margin)
    for view in (before, after) if layer is not None else ():
        assert layer.covers(view) == covers_plainly(layer, view)


def test_a_capture_covers_its_own_view_and_small_turns_within_its_margin():
    boxes = np.array([[[20.0, -40.0, 0.0], [30.0, 40.0, 15.0]]])  # wider than the view
    view = view_from((0.0, 0.0, 1.7), 0.0)
    assert captured(view, boxes, 0).covers(view)
    assert not captured(view, boxes, 0).covers(view_from((0.0, 0.0, 1.7), 0.05))
    assert captured(view, boxes, 32).covers(view_from((0.0, 0.0, 1.7), 0.05))
    assert not captured(view, boxes, 32).covers(view_from((0.0, 0.0, 1.7), 0.3))
    assert not captured(view, boxes, 32).covers(view_from((0.0, 0.0, 1.7), math.pi))
    small = np.array([[[20.0, -1.0, 0.0], [30.0, 1.0, 3.0]]])
    assert captured(view, small, 0).covers(view_from((0.0, 0.0, 1.7), 0.3)), "it is whole"


@pytest.mark.parametrize("name", ["0001-01", "0000-02", "0003-03"])
def test_every_far_object_is_in_one_unit_of_its_sector_and_its_layer(scene, dataset, name):
    entry, cell = dataset.cell(name), cell_units(scene, name)
    place = {scene.objects[one]: i for i, one in enumerate(entry.far)}
    found = []
    for unit, (first, last) in zip(cell.units, itertools.pairwise(cell.starts), strict=True):
        drawn = np.concatenate([piece.draw.objects for piece in unit.pieces])
        assert sorted(np.concatenate([piece.rows for piece in unit.pieces]).tolist()) == list(range(len(unit.boxes)))
        assert sum(piece.triangles for piece in unit.pieces) == scene.mesh.triangle_counts[drawn].sum()
        for piece in unit.pieces:
            np.testing.assert_array_equal(unit.boxes[piece.rows], scene.boxes[piece.draw.objects])
        np.testing.assert_array_equal(cell.boxes[first:last], unit.boxes)
        found += drawn.tolist()
        for one in drawn:
            x, y, _ = scene.boxes[one].mean(axis=0) - entry.reference
            sector = round(math.atan2(y, x) / (2.0 * math.pi / len(entry.layers))) % len(entry.layers)
            listed = {picture.index for _, picture in entry.pictures if place[one] in picture.objects}
            own_sector, own_layer = unit.name[1:].split(".l")
            assert int(own_sector) == sector
            assert not listed or int(own_layer) in listed
    assert sorted(found) == sorted(place)
    assert len({piece.draw.key for unit in cell.units for piece in unit.pieces}) == sum(
        len(one.pieces) for one in cell.units
    )


def test_owners_of_a_stored_picture_have_all_that_it_shows(scene, dataset):
    entry, cell = dataset.cell("0001-01"), cell_units(scene, "0001-01")
    assert set(cell.owners) == {one.name for _, one in entry.pictures}
    for _, one in entry.pictures:
        owned = {
            int(i) for unit in cell.owners[one.name] for piece in cell.units[unit].pieces for i in piece.draw.objects
        }
        assert {scene.objects[entry.far[place]] for place in one.objects} <= owned


def test_what_no_stored_picture_shows_joins_the_layer_that_is_about_as_far():
    layer, sector = np.array([0, 1, -1, -1, -1, 0]), np.array([0, 0, 0, 0, 1, 2])
    _join(layer, sector, np.array([50.0, 200.0, 190.0, 60.0, 70.0, 80.0]), np.ones(6, dtype=bool))
    assert layer.tolist() == [0, 1, 1, 0, -1, 0]


@pytest.mark.parametrize("name", ["0001-01", "0000-02"])
def test_boxes_of_objects_hold_their_vertices(scene, name):
    mesh = scene.mesh
    for one, (first, last) in enumerate(zip(mesh.object_vertices[:-1], mesh.object_vertices[1:], strict=True)):
        points = mesh.positions[first:last]
        np.testing.assert_allclose(scene.boxes[one], [points.min(axis=0), points.max(axis=0)])
    assert cell_units(scene, name).units
