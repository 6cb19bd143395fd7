"""Triangles that a picture may show: pictures stay what they are, to the bit, and what is hidden is left out."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from placed_models import model_of, towers

from mmi.appearance.city_mesh import CityMesh
from mmi.foundation.camera import view_towards
from viewer.drawing.programs import NEAR
from viewer.drawing.renderer import Renderer
from viewer.making.shown_triangles import may_show
from viewer.plan import Faces, ImageKey, Plan, Request, Slot

WINDOW = (-40, -30, 80, 61)
KEY = ImageKey("test", "picture")
OURS = settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def look(eye=(0.0, 0.0, 0.0), azimuth=0.0, *, window=WINDOW):
    return view_towards(np.asarray(eye, dtype=float), azimuth, 0.0, focal=60.0, window=window)


def mesh_of(corners, *, clear=False):
    """Triangles (m, 3, 3), each an object of its own; with ``clear`` half of each is."""
    count = len(corners)
    texture = np.full((8, 8, 4 if clear else 3), 255, np.uint8)
    if clear:
        texture[:, :4, 3] = 0
    starts = np.arange(count + 1)
    return CityMesh(
        positions=corners.reshape(-1, 3).astype(np.float32),
        uv=np.tile(np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]], np.float32), (count, 1)),
        colors=np.random.default_rng(0).integers(0, 256, (3 * count, 3), dtype=np.uint8),
        triangles=np.arange(3 * count, dtype=np.int32).reshape(-1, 3),
        object_vertices=3 * starts,
        object_triangles=starts,
        texture=texture,
    )


def seen(mesh):
    return np.ascontiguousarray(mesh.positions[mesh.triangles].T)


def drawn(renderer, view, faces):
    size = view.window[2:]
    renderer.execute(Plan((), requests=(Request(Slot(KEY, size), view, (Faces("", faces.astype(np.int32)),)),)))
    return renderer.image(KEY)


def soup(rng, count):
    """Triangles of all sizes around the axis, also slivers, some before the near plane and behind the eye."""
    middles = np.column_stack([rng.uniform(-3.0, 60.0, count), rng.uniform(-25.0, 25.0, (count, 2))])
    sizes = np.exp(rng.uniform(np.log(0.01), np.log(30.0), count))
    corners = middles[:, None] + sizes[:, None, None] * rng.uniform(-0.5, 0.5, (count, 3, 3))
    slivers = rng.random(count) < 0.2
    corners[slivers, 2] = corners[slivers, 1] + rng.normal(size=(slivers.sum(), 3)) * 1e-3
    return corners


def assert_same(renderer, mesh, view, solid=None):
    shown = may_show(seen(mesh), view, nearest=NEAR, solid=solid)
    everything = np.arange(len(mesh.triangles))
    for truth, found in zip(drawn(renderer, view, everything), drawn(renderer, view, everything[shown]), strict=True):
        np.testing.assert_array_equal(found, truth)
    return shown


@OURS
@given(st.integers(0, 2**32 - 1), st.sampled_from([1.0, 300.0, 20_000.0]))
def test_pictures_of_them_are_those_of_all(seed, far):
    rng = np.random.default_rng(seed)
    at = far * rng.uniform(-1.0, 1.0, 3)
    mesh = mesh_of(soup(rng, 400) + at)
    with Renderer(mesh, model_of(towers()).ground, size=(16, 16), measured=True) as renderer:
        shown = assert_same(renderer, mesh, look(at))
        assert shown.mean() < 0.9
        assert_same(renderer, mesh, look(at + np.array([3.0, 1.0, -2.0]), 0.3, window=(-90, 3, 150, 20)))


def test_what_is_clear_in_places_hides_nothing():
    rng = np.random.default_rng(1)
    mesh = mesh_of(soup(rng, 400), clear=True)
    with Renderer(mesh, model_of(towers()).ground, size=(16, 16), measured=True) as renderer:
        assert_same(renderer, mesh, look(), np.zeros(len(mesh.triangles), bool))


@pytest.fixture(scope="module")
def model():
    return model_of(towers())


def test_of_a_model_most_are_left_out(model):
    mesh = model.mesh
    with Renderer(mesh, model.ground, size=(16, 16), measured=True) as renderer:
        for azimuth in (1.4, 1.57, 1.8):
            shown = assert_same(renderer, mesh, look((0.0, -70.0, 3.0), azimuth))
            everything = drawn(renderer, look((0.0, -70.0, 3.0), azimuth), np.arange(len(shown)))
            assert len(np.unique(everything.object_ids)) > 5
            assert shown.mean() < 0.35


def test_what_is_behind_a_wall_or_between_middles_is_left_out():
    wall = np.array([[(10.0, 2.0, -2.0), (10.0, -2.0, -2.0), (10.0, 2.0, 2.0)]])
    wall = np.concatenate([wall, np.array([[(10.0, -2.0, -2.0), (10.0, -2.0, 2.0), (10.0, 2.0, 2.0)]])])
    small = np.array([[(0.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0)]])
    places = ((20.0, 2.0, -2.0), (9.0, 2.0, -2.0), (20.0, 6.0, 0.0))
    behind, before, beside = (small + np.array(place) for place in places)
    between = 1e-3 * small + np.array([12.0, 4.0, 0.0])  # where four pixels meet
    corners = np.concatenate([wall, behind, before, beside, between])
    shown = may_show(np.ascontiguousarray(corners.astype(np.float32).T), look(), nearest=NEAR)
    assert shown.tolist() == [True, True, False, True, True, False]
    turned = np.concatenate([wall[:, ::-1], behind])  # seen from behind a wall is taken to hide nothing
    assert may_show(np.ascontiguousarray(turned.astype(np.float32).T), look(), nearest=NEAR).all()
    assert may_show(np.empty((3, 3, 0), np.float32), look(), nearest=NEAR).shape == (0,)
