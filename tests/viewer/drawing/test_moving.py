"""Geometry of objects that move: the same pixels, depths and light as the same shape has where it stands in the city."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from moving import block, movers_of
from shapely.geometry import box

from mmi.appearance.city_mesh import build_city_mesh
from mmi.city.model import City, CityObject, Prism, TriangleMesh
from mmi.foundation.camera import view_towards
from mmi.foundation.thickness import thickness
from mmi.movers.movers import Movers
from viewer.drawing.renderer import Renderer
from viewer.plan import ImageKey, Moving, Objects, Plan, Relief, ReliefPart, Request, Sky, Slot

SIZE = (320, 240)
WINDOW = (-160, -120, *SIZE)
COLORS = np.array(
    [[200, 40, 40], [40, 200, 40], [40, 40, 200], [200, 200, 40], [250, 250, 250], [90, 90, 90]], np.uint8
)
TRACKS = [[(0.0, 8, 1, 0, 30)], [(0.0, 14, -3, 1, -100, 20, 40)], [(0.0, 500_000, 3, 0, 10)], [(0.0, 30, 2, 0, 80)]]


@pytest.fixture(scope="module")
def movers():
    shape = block()
    return movers_of(
        TRACKS, mesh=TriangleMesh(shape.vertices, shape.triangles, shape.textures, np.repeat(COLORS, 2, axis=0))
    )


@pytest.fixture(scope="module")
def renderer(scene, movers):
    with Renderer(scene.mesh, scene.ground, size=SIZE, measured=True, movers=movers) as renderer:
        yield renderer


def look(x=0.0, azimuth=0.0, pitch=0.0):
    return view_towards(np.array([x, 0.0, 2.0]), azimuth, pitch, focal=277.0, window=WINDOW)


def some(movers, *which):
    places = np.array(which, dtype=np.int64)
    return Moving(places, movers.poses(0.0)[places])


@pytest.mark.parametrize("which", [(0,), (1,), (0, 1, 3)])
@pytest.mark.parametrize(("azimuth", "pitch"), [(0.0, 0.0), (0.2, -0.1)])
def test_it_looks_as_if_it_stood_there(scene, renderer, movers, which, azimuth, pitch):
    """The city's own mesh of the same triangles is the oracle: pixels, depths, colours and so the light."""
    objects = []
    for i in which:
        pose, mesh = movers.poses(0.0)[i], movers.meshes[0]
        vertices = mesh.vertices @ pose[:3, :3].T + pose[:3, 3]
        standing = TriangleMesh(vertices, mesh.triangles, mesh.textures, mesh.colors)
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        around = Prism(box(*low[:2], *high[:2]), low[2], high[2])
        objects.append(CityObject(movers.ids[i], (around,), standing))
    city = City(tuple(objects), scene.dataset.city().streets, "local", (0.0, 0.0, 0.0), "standing")
    with Renderer(build_city_mesh(city), scene.ground, size=SIZE, measured=True) as other:
        truth = other.draw(
            Plan((Objects("all", np.arange(len(objects))), Sky())), look(azimuth=azimuth, pitch=pitch), measured=True
        )
    found = renderer.draw(Plan((some(movers, *which), Sky())), look(azimuth=azimuth, pitch=pitch), measured=True)
    ids = np.where(truth.object_ids >= 0, len(scene.mesh.triangle_counts) + np.array(which)[truth.object_ids], -1)
    assert (ids >= 0).sum() > 500
    assert np.array_equal(found.object_ids, ids)
    assert np.allclose(found.depth[ids >= 0], truth.depth[ids >= 0], rtol=1e-5)
    assert np.abs(found.color.astype(int) - truth.color).max() <= 1
    assert len(np.unique(found.color[ids >= 0], axis=0)) >= 2


def test_far_from_the_origin_nothing_shakes(renderer, movers):
    """Half a million metres away float32 has steps of 3 cm; seen from nearby all is where it is near the origin."""
    near = renderer.draw(Plan((some(movers, 0), Sky())), look(), measured=True)
    poses = movers.poses(0.0)[:1].copy()
    poses[:, 0, 3] += 500_000.0
    far = renderer.draw(Plan((Moving(np.array([0]), poses), Sky())), look(x=500_000.0), measured=True)
    assert np.array_equal(near.object_ids, far.object_ids)
    assert np.array_equal(near.color, far.color)


def test_they_hide_and_are_hidden_by_depth(scene, renderer, movers):
    """In whichever order they are drawn."""
    first = len(scene.mesh.triangle_counts)
    one = renderer.draw(Plan((some(movers, 0, 3), Sky())), look(), measured=True)
    other = renderer.draw(Plan((some(movers, 3), some(movers, 0), Sky())), look(), measured=True)
    assert np.array_equal(one.object_ids, other.object_ids)
    hidden = renderer.draw(Plan((some(movers, 3), Sky())), look(), measured=True)
    behind = (hidden.object_ids == first + 3) & (one.object_ids == first)
    assert behind.any() and (one.depth[behind] < hidden.depth[behind]).all()


def test_one_call_for_each_shape(scene, movers):
    two = replace(
        movers, names=("a", "b"), meshes=(movers.meshes[0], block(color=(1, 2, 3))), kinds=np.array([0, 1, 0, 1])
    )
    assert isinstance(two, Movers)
    with Renderer(scene.mesh, scene.ground, size=SIZE, movers=two) as renderer:
        drawn = renderer.draw(Plan((some(two, 0, 1, 2, 3),)), look(), read=False)
        assert (drawn.draws, drawn.triangles) == (2, 48)
        drawn = renderer.draw(Plan((some(two, 0, 2),)), look(), read=False)
        assert (drawn.draws, drawn.triangles) == (1, 24)
        assert renderer.draw(Plan((some(two),)), look(), read=False).draws == 0


def test_more_objects_than_there_was_room_for(scene):
    """A hundred in one place are drawn after one was."""
    first = len(scene.mesh.triangle_counts)
    many = movers_of([TRACKS[0]] * 100)
    with Renderer(scene.mesh, scene.ground, size=SIZE, measured=True, movers=many) as renderer:
        one = renderer.draw(Plan((some(many, 99), Sky())), look(), measured=True)
        all_of_them = renderer.draw(Plan((some(many, *range(100)), Sky())), look(), measured=True)
    assert set(np.unique(one.object_ids)) == {-1, first + 99}
    assert np.array_equal(all_of_them.object_ids >= 0, one.object_ids >= 0)
    assert all_of_them.triangles == 1200 + 1


def test_a_captured_one_moves_with_its_picture(scene, renderer, movers):
    """Its relief, moved as it moved, covers what its geometry covers there, but for a rim."""
    view, key = look(), ImageKey("test", "mover")
    u, v, _ = view.project(movers.corners(movers.poses(0.0))[3]).T
    left, top = int(np.floor(u.min())) - 2, int(np.floor(v.min())) - 2
    window = (left, top, int(np.ceil(u.max())) + 2 - left, int(np.ceil(v.max())) + 2 - top)
    captured = view.cropped(window)
    then = movers.poses(0.0)[3]
    now = then.copy()
    now[:3, 3] += (0.5, -1.0, 0.2)
    truth = renderer.draw(Plan((Moving(np.array([3]), now[None]), Sky())), view, measured=True)
    relief = Relief(key, (ReliefPart(captured, (5, 9), 30.0, now @ np.linalg.inv(then)),))
    request = Request(Slot(key, (64, 64), (5, 9)), captured, (some(movers, 3),))
    found = renderer.draw(Plan((relief, Sky()), requests=(request,)), view, measured=True)
    mover = len(scene.mesh.triangle_counts) + 3
    wrong = (found.object_ids == mover) != (truth.object_ids == mover)
    assert (truth.object_ids == mover).sum() > 300
    assert thickness(wrong) <= 2.0
    both = (found.object_ids == mover) & (truth.object_ids == mover)
    assert np.abs(found.depth[both] - truth.depth[both]).max() < 1.0
    unmoved = renderer.draw(Plan((Relief(key, (ReliefPart(captured, (5, 9), 30.0),)), Sky())), view, measured=True)
    assert thickness((unmoved.object_ids == mover) != (truth.object_ids == mover)) > 5.0
