"""Cities that benchmarks lay out: copies are where they should be, and are what they are copies of."""

import numpy as np
import pytest

from benchmarks.large_cities import Copy, chosen_copies, laid_out, put_together
from mmi.appearance.city_mesh import object_boxes


def test_copies_are_the_objects_moved_and_nothing_else(scene):
    mesh = scene.mesh
    count = len(mesh.triangle_counts)
    some = np.arange(0, count, 2)
    made = put_together(mesh, [Copy(np.zeros(2), np.arange(count)), Copy(np.array([1000.0, -500.0]), some)])
    assert made.triangle_counts.tolist() == [*mesh.triangle_counts.tolist(), *mesh.triangle_counts[some].tolist()]
    for row, (one, shift) in enumerate([*((i, 0.0) for i in range(count)), *((i, 1.0) for i in some)]):
        there = slice(*made.object_triangles[row : row + 2])
        source = slice(*mesh.object_triangles[one : one + 2])
        found, asked = made.positions[made.triangles[there]], mesh.positions[mesh.triangles[source]]
        assert np.allclose(found, asked + shift * np.array([1000.0, -500.0, 0.0]), atol=1e-3)
        assert (made.uv[made.triangles[there]] == mesh.uv[mesh.triangles[source]]).all()


@pytest.mark.parametrize("times", [0.3, 1.0, 7.5])
def test_a_city_is_a_disc_of_as_many_triangles_as_asked(scene, times):
    counts, boxes = scene.mesh.triangle_counts, scene.boxes
    asked = int(times * counts.sum())
    middle = np.array([10.0, 5.0])
    copies = chosen_copies(boxes, counts, asked, middle)
    got = sum(int(counts[one.objects].sum()) for one in copies)
    assert asked <= got < asked + counts.max()
    middles = boxes[:, :, :2].mean(axis=1)
    away = [np.linalg.norm(middles[one.objects] + one.shift - middle, axis=1) for one in copies]
    farthest = max(float(some.max()) for some in away)
    for one in copies:  # whatever is left out is farther away than what is there
        left = np.setdiff1d(np.arange(len(counts)), one.objects)
        assert (np.linalg.norm(middles[left] + one.shift - middle, axis=1) >= farthest - 1e-6).all()
    assert (copies[0].shift == 0.0).all()


def test_a_scene_of_it_has_boxes_and_tiles_of_what_it_draws(scene):
    made = laid_out(scene, 3 * len(scene.mesh.triangles), middle=np.zeros(2))
    assert np.array_equal(made.boxes, object_boxes(made.mesh), equal_nan=True)
    assert np.array_equal(made.tiles, object_boxes(made.ground))
    assert len({(*low[:2],) for low in made.tiles[:, 0].round(2).tolist()}) == len(made.tiles) > 1
    assert made.whereabouts is scene.whereabouts
    assert made.workshop is not scene.workshop
