"""The bound on hills and for houses under real roofs: what an impostor shows, against rays at everything that is drawn.

In the spirit of ``test_bound``: cells are built, views of walkers anywhere in them are drawn twice without OpenGL, and no wrong
region is thicker than T + 2 px. Here geometry is triangles (meshes, prisms and the ground, which both pictures have).
"""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hills import Drawn, eyes_in, hilly_city, terraces
from test_bound import CAMERA, Picture, draw_layers

from mmi.building.cell import build_cell
from mmi.capture.renderer import Capturer
from mmi.cells.viewing_cells import viewing_cells
from mmi.foundation.camera import level_view
from mmi.foundation.thickness import thickness
from mmi.planning.parameters import BuildParameters
from mmi.planning.plan import prepare_city
from viewer.walks.random_views import random_views
from viewer.walks.tour import tour


def compare(drawn, near, impostor, view):
    """One view of all geometry, and of the near objects, the ground and the layers."""
    u, v = (one.ravel() for one in np.meshgrid(*view.pixel_centres()))
    rays = np.column_stack([u / view.focal, -v / view.focal, np.full(len(u), -1.0)]) @ view.eye_from_world[:3, :3]
    origins = np.broadcast_to(view.eye, rays.shape)
    shape = (view.window[3], view.window[2])
    truth = drawn.cast(origins, rays)[1].reshape(shape)
    best, shown = (one.reshape(shape) for one in near.cast(origins, rays))
    return Picture(truth, shown, draw_layers(impostor, view, best, shown))


def worst(city, cell, impostor, *, views, seed):
    """The largest thickness (px) of a wrong region over random views of walkers, and where it was found."""
    rng = np.random.default_rng(seed)
    drawn, near = Drawn(city), Drawn(city, impostor.near)
    thickest, where = 0.0, ""
    for eye in eyes_in(cell, city.terrain, views, rng):
        one = city.objects[rng.choice(impostor.far)].footprint.representative_point()
        azimuth = math.atan2(one.y - eye[1], one.x - eye[0]) + rng.uniform(-0.35, 0.35)
        view = level_view(eye, azimuth, focal=CAMERA.focal, window=CAMERA.window)
        picture = compare(drawn, near, impostor, view)
        wrong = picture.truth != picture.shown
        if (thick := thickness(wrong)) > thickest:
            pairs, counts = np.unique(
                np.stack([picture.truth[wrong], picture.shown[wrong]]), axis=1, return_counts=True
            )
            of = ", ".join(
                f"{a} shown as {b}: {n}" for (a, b), n in zip(pairs.T.tolist(), counts.tolist(), strict=True) if n > 20
            )
            thickest, where = (
                thick,
                f"{thick:g} px from {np.round(eye, 3).tolist()}, {math.degrees(azimuth):.2f} ({of})",
            )
    return thickest, where


def holds(city, cell, threshold, *, views, seed=0):
    parameters = BuildParameters(max_error_px=threshold, camera=CAMERA, near_distance=4.0)
    scene = prepare_city(city, parameters)
    with Capturer(scene.mesh) as capturer:
        impostor = build_cell(scene, cell, capturer)
    assert impostor.far.size > 3  # there is something to hold for
    thickest, where = worst(city, cell, impostor, views=views, seed=seed)
    assert thickest <= threshold + 2.0, where
    return impostor


@pytest.mark.parametrize("make", [hilly_city, terraces])
def test_it_holds_on_hills_and_for_real_roofs(make):
    city = make(0)
    graph = viewing_cells(city)
    holds(city, graph.nodes[list(graph)[1]]["cell"], 5.0, views=2)


@pytest.mark.slow
def test_it_holds_for_a_pitched_roof_close_by():
    """A house 9 m from the reference: 18 x 7 px of its roof would not be in the capture, so the house has to be near."""
    city = terraces(1)
    holds(city, viewing_cells(city).nodes["0000-05"]["cell"], 2.0, views=8, seed=1)


def cells_on(seed):
    """All cells of a hilly city whose streets run along slopes as well as up and down, and their neighbours."""
    city = hilly_city(seed, count=1, steep=0.4)
    graph = viewing_cells(city)
    neighbours = {name: list(graph[name]) for name in graph}
    return city.terrain, [cell for _, cell in graph.nodes(data="cell")], neighbours


@pytest.mark.parametrize("seed", range(3))
def test_random_views_on_hills_lie_in_bands_and_above_the_ground(seed):
    terrain, cells, _ = cells_on(seed)
    by_id = {cell.id: cell for cell in cells}
    views = random_views(cells, 300, seed=seed, terrain=terrain)
    eyes = np.array([pose.eye for _, pose in views])
    bands = np.array([by_id[name].eye for name, _ in views])
    assert (bands[:, 0] <= eyes[:, 2]).all()
    assert (eyes[:, 2] <= bands[:, 1]).all()
    above = eyes[:, 2] - terrain.at(eyes)
    assert above.min() >= 1.0 - 1e-9
    assert above.max() > 1.9
    for (name, _), eye in zip(views, eyes, strict=True):
        cell = by_id[name]
        along = np.subtract(cell.q, cell.p) / cell.length
        share = float((eye[:2] - cell.p) @ along) / cell.length
        low, high = cell.eye_at(share)
        assert low - 1e-9 <= eye[2] <= high + 1e-9
    assert random_views(cells, 20, seed=seed, terrain=terrain) == random_views(cells, 20, seed=seed, terrain=terrain)


@pytest.mark.parametrize("seed", range(3))
def test_tours_follow_the_ground(seed):
    terrain, cells, neighbours = cells_on(seed)
    walk = tour(cells, neighbours, metres=180.0, seed=seed)
    eyes = np.array([frame.pose.eye for frame in walk.keyframes])
    fine = np.concatenate([a + np.linspace(0.0, 1.0, 9)[:, None] * (b - a) for a, b in itertools.pairwise(eyes)])
    above = fine[:, 2] - terrain.at(fine)
    uneven = max(0.5 * (cell.eye[1] - cell.eye[0] - abs(cell.rise)) for cell in cells)
    assert 1.7 - uneven - 0.1 <= above.min()
    assert above.max() <= 1.7 + uneven + 0.1
    assert above.min() > 0.8
    assert np.ptp(eyes[:, 2]) > 1.5
