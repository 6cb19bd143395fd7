"""Order between layers: what is drawn as it is must win and lose against other layers as the captured surfaces do."""

import math
from dataclasses import replace

import numpy as np
import pytest

from mmi.capture.layer_values import DepthTexture
from mmi.cells.viewing_cells import ViewingCell
from mmi.city.terrain import Terrain
from mmi.foundation.camera import level_view
from mmi.meshing.grid_mesh import grid_mesh
from mmi.meshing.ordering import CapturedLayer, out_of_order
from mmi.parallax.from_anywhere import viewers_of

ANGLE = 10.0 / 443.0


def looking(azimuth=0.0, left=-48, width=96):
    return level_view(np.array([3.0, -2.0, 1.7]), azimuth, focal=100.0, window=(left, -32, width, 48))


def plane(view, nearness=0.02, across=1e-4, down=-5e-5):
    """A slanted wall: 1/z is linear in the picture."""
    u, v = np.meshgrid(*view.pixel_centres())
    return 1.0 / (nearness + across * u + down * v)


def captured(layer, view, depth):
    ids = np.where(np.isfinite(depth), 0, -1).astype(np.int32)
    texture = DepthTexture(view, np.zeros((*depth.shape, 3), np.uint8), depth.astype(np.float32), ids)
    cell = view.eye + [[x, y, 0.0] for x in (-20.0, 20.0) for y in (-3.0, 3.0)]
    x, y, z = view.eye
    region = ViewingCell("", (x - 20.0, y), (x + 20.0, y), 3.0, (z, z))
    mesh = grid_mesh(texture, viewpoints=cell, tolerance=0.5 * ANGLE, viewers=viewers_of(region, view), widest=math.pi)
    return CapturedLayer(layer, view, mesh, texture.depth)


def flagged(*pictures, eye_height=0.0, terrain=None):
    return out_of_order(pictures, max_angle=ANGLE, eye_height=eye_height, terrain=terrain)


def texels_of(picture, rows):
    """(h, w) depth of the mesh, and whether a triangle of ``rows`` covers the texel, by brute force."""
    height, width = picture.depth.shape
    corners = picture.mesh.uv.astype(float) * [width, height]
    nearness = 1.0 / picture.view.project(picture.mesh.vertices.astype(float))[:, 2]
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    mesh, chosen = np.full((height, width), np.nan), np.zeros((height, width), bool)
    for number, triangle in enumerate(picture.mesh.triangles):
        a, b, c = corners[triangle]
        p, q = np.linalg.inv(np.column_stack([b - a, c - a])) @ np.stack([x - a[0], y - a[1]]).reshape(2, -1)
        inside = ((p >= -1e-9) & (q >= -1e-9) & (p + q <= 1 + 1e-9)).reshape(height, width)
        w = nearness[triangle]
        mesh[inside] = 1.0 / (w[0] + p * (w[1] - w[0]) + q * (w[2] - w[0])).reshape(height, width)[inside]
        chosen |= inside & rows[number]
    return mesh, chosen


def test_a_plane_is_drawn_as_it_is():
    view = looking()
    other = captured(1, view, np.where(np.arange(96) > 40, plane(view, 0.01), np.inf))
    flags = flagged(captured(0, view, plane(view)), other)
    assert not flags[0].any()


def test_a_step_does_no_harm_where_nothing_is_in_between():
    view = looking()
    depth = plane(view)
    depth[:, 50:] *= 2.0
    for distant in (0.002, 0.1):
        flags = flagged(captured(0, view, depth), captured(1, view, plane(view, distant, 0.0, 0.0)))
        assert not flags[0].any()
    same_layer = captured(0, view, plane(view, 0.014, 0.0, 0.0))
    assert not flagged(captured(0, view, depth), same_layer)[0].any()


def test_a_step_around_another_layers_surface_needs_captured_depths_there_and_only_there():
    view = looking()
    depth = np.full((48, 96), 40.0)
    depth[:, 50:] = 80.0
    between = np.full((48, 96), np.inf)
    between[:, 46:56] = 60.0
    one, other = captured(0, view, depth), captured(1, view, between)
    flags = flagged(one, other)
    assert 0 < flags[0].sum() < 0.6 * len(flags[0])
    assert not flags[1].any()
    middles = (one.mesh.uv[:, 0] * 96)[one.mesh.triangles[flags[0]]].mean(axis=1)
    assert np.abs(middles - 50.0).max() < 32.0
    aside = looking(math.pi / 2.0)
    assert not flagged(one, captured(1, aside, between))[0].any(), "it is elsewhere in the panorama"


def test_so_does_a_step_around_a_near_object_and_not_one_elsewhere():
    view = looking()
    depth = plane(view)
    depth[:, 50:] *= 2.0
    stepped = captured(0, view, depth)
    u, v = np.meshgrid(*view.pixel_centres())

    def quad(nearness):
        corners = view.unproject(u, v, 1.0 / np.full(u.shape, nearness))[[0, 0, -1, -1], [0, -1, 0, -1]] - view.eye
        return corners[[[0, 2, 3], [0, 3, 1]]]

    between, before = (
        out_of_order([stepped], max_angle=ANGLE, eye_height=0.0, solids=quad(nearness))[0] for nearness in (0.014, 0.1)
    )
    assert between.any() and not before.any()


def test_what_the_next_sector_sees_counts_too():
    """The same direction, seen through two level views that are turned against each other."""
    view, turned = looking(0.0, left=16, width=64), looking(-math.radians(45.0), left=-80, width=64)
    depth = np.full((48, 64), 40.0)
    depth[:, 30:] = 80.0
    between = np.full((48, 64), 55.0)
    assert flagged(captured(0, view, depth), captured(1, turned, between))[0].any()


def test_the_ground_comes_between_a_mesh_and_the_foot_of_a_wall():
    """A mesh from 40 m on the left to 80 m on the right, where there is a wall 40 m away up to the middle."""
    for top, sinks in ((-32, True), (-60, False)):  # with the horizon in the picture, and all above it
        view = level_view(np.array([3.0, -2.0, 1.7]), 0.0, focal=100.0, window=(-48, top, 96, 48))
        depth = np.full((48, 96), 40.0, dtype=np.float32)
        depth[:, 50:] = 80.0
        one = replace(captured(0, view, plane(view, 0.01875, -1.3e-4, 0.0)), depth=depth)
        assert not flagged(one)[0].any()
        flags = flagged(one, eye_height=1.7)[0]
        assert flags.any() == sinks
        below = (one.mesh.uv[:, 1] * 48 + top)[one.mesh.triangles[flags]].max(axis=1)
        assert (below > 0.0).all(), "only below the horizon"


@pytest.mark.parametrize(
    ("azimuth", "height", "sinks"), [(0.0, 30.0, True), (0.0, 2.0, False), (2.5, 30.0, False), (-2.2, 30.0, False)]
)
def test_so_does_a_hill_behind_the_wall(azimuth, height, sinks):
    """The same, above the horizon, where the ground rises to ``height`` between 45 m and 60 m in a direction."""
    view = level_view(np.array([3.0, -2.0, 1.7]), 0.0, focal=100.0, window=(-48, -60, 96, 48))
    depth = np.full((48, 96), 40.0, dtype=np.float32)
    depth[:, 50:] = 80.0
    one = replace(captured(0, view, plane(view, 0.01875, -1.3e-4, 0.0)), depth=depth)
    x, y = np.meshgrid(*[5.0 * np.arange(-40, 41)] * 2)
    along = (x - 3.0) * math.cos(azimuth) + (y + 2.0) * math.sin(azimuth)
    terrain = Terrain((-200.0, -200.0), 5.0, height * np.clip((along - 45.0) / 15.0, 0.0, 1.0))
    flags = flagged(one, eye_height=1.7, terrain=terrain)[0]
    assert flags.any() == sinks
    highest = (one.mesh.uv[:, 1] * 48 - 60.0)[one.mesh.triangles[flags]].max(axis=1)
    steepest = (height - 1.7) / 57.0  # of what the hill can hide
    assert (-highest / 100.0 <= steepest + 0.1).all()


@pytest.mark.parametrize("seed", range(12))
def test_drawn_order_is_captured_order(seed):
    """Random steps in three layers: at every texel, what is drawn is ordered as what was captured."""
    rng = np.random.default_rng(seed)
    view = looking(rng.uniform(-3.0, 3.0))
    pictures = []
    for layer in range(3):
        depth = plane(view, rng.uniform(0.008, 0.03), rng.uniform(-6e-5, 6e-5), rng.uniform(-3e-5, 3e-5))
        for _ in range(3):
            left, top, width, height = rng.integers(0, [80, 30, 40, 40])
            part = np.s_[top : top + height + 4, left : left + width + 4]
            depth[part] = np.inf if rng.random() < 0.3 else depth[part] * rng.uniform(0.6, 1.6)
        pictures.append(captured(layer, view, depth))
    drawn = []
    for one, flags in zip(pictures, flagged(*pictures), strict=True):
        mesh, exact = texels_of(one, flags)
        drawn.append(np.where(exact, one.depth, mesh))
    wrong = total = 0
    for i in range(3):
        for j in range(i):
            both = np.isfinite(pictures[i].depth) & np.isfinite(pictures[j].depth)
            truth = pictures[i].depth[both] - pictures[j].depth[both]
            shown = drawn[i][both] - drawn[j][both]
            clear = np.abs(truth) > 2e-3 * pictures[i].depth[both]
            wrong += np.count_nonzero(np.sign(truth[clear]) != np.sign(shown[clear]))
            total += clear.sum()
    assert total > 1000
    assert wrong == 0


def test_nothing_is_asked_of_a_cell_without_layers():
    assert flagged() == []
