import numpy as np

from viewer.drawing.backdrop import backdrop


def test_it_lies_just_below_the_ground_and_far_around_it_in_its_mean_colour(scene):
    plain = backdrop(scene.ground)
    low, high = scene.ground.positions.min(axis=0), scene.ground.positions.max(axis=0)
    assert (plain.positions[:, :2].min(axis=0) < low[:2] - 5000.0).all()
    assert (plain.positions[:, :2].max(axis=0) > high[:2] + 5000.0).all()
    assert (plain.positions[:, 2] < low[2]).all()
    assert (plain.positions[:, 2] > low[2] - 0.2).all()
    corners = plain.positions[plain.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (normals[:, 2] > 0.0).all(), "seen from above"
    assert (plain.colors >= scene.ground.colors.min(axis=0)).all()
    assert (plain.colors <= scene.ground.colors.max(axis=0)).all()
