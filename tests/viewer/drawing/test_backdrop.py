import numpy as np
import pytest

from mmi.foundation.camera import view_towards
from viewer.drawing import backdrop as module
from viewer.drawing.backdrop import backdrop
from viewer.drawing.renderer import Renderer
from viewer.plan import Ground, Plan, Sky


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


@pytest.mark.parametrize(("height", "pitch"), [(25.0, -0.35), (40.0, -0.5), (1.7, 0.0), (150.0, -0.7)])
def test_streets_show_from_above(scene, monkeypatch, height, pitch):
    """The picture is that with a backdrop so far below that nothing of it can come before the ground."""
    tiles = Ground(tuple(range(len(scene.ground.triangle_counts))))
    view = view_towards(np.array([-100.0, 5.0, height]), 0.1, pitch, focal=443.0, window=(-256, -256, 512, 512))
    pictures = []
    for below in (module._BELOW, 1.0):
        monkeypatch.setattr(module, "_BELOW", below)
        with Renderer(scene.mesh, scene.ground, size=(512, 512)) as renderer:
            pictures.append(renderer.draw(Plan((tiles, Sky())), view).color.astype(int))
    near = slice(256 + int(443.0 * np.tan(-pitch)) - 512, None)  # below the horizon, where the ground ends somewhere
    differs = np.abs(pictures[0] - pictures[1]).max(axis=2)[near] > 8
    assert differs.mean() < 0.02
