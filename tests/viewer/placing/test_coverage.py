"""How far a lattice point is at most that serves a viewer: no viewer is farther, and some nearly are."""

import math

import numpy as np
import pytest

from viewer.placing.coverage import lattice_for, reach
from viewer.placing.rules import Fov

USUAL = Fov(math.tan(math.radians(30.0)), 0.75 * math.tan(math.radians(30.0)))
FOVS = (USUAL, Fov(USUAL.across, USUAL.across), Fov(1.0, 0.75), Fov(0.5, 0.3))


def farthest_served(lattice, fov, radius, count, seed, height=math.inf):
    """The greatest distance from random eyes, with random yaws, to the nearest point in the reverse pyramid: a plain search."""
    rng = np.random.default_rng(seed)
    top = 5.0 * lattice.layer if height == math.inf else height
    worst = 0.0
    numbers = lattice.within(np.array([-2.0, -2.0, -top]) - radius, np.array([2.0, 2.0, top]) + radius)
    places = lattice.places(numbers)
    for _ in range(count):
        middle, yaws = rng.uniform([-1.5, -1.5, -top + 0.1], [1.5, 1.5, top - 0.1]), rng.uniform(0.0, 7.0, size=400)
        eyes = np.clip(middle + rng.uniform(-0.1, 0.1, size=(400, 3)), -9.0, [9.0, 9.0, top])
        near = places[np.linalg.norm(places - middle, axis=1) <= radius + 0.2]
        x, y, z = np.moveaxis(eyes[:, None] - near, -1, 0)
        cos, sin = np.cos(yaws)[:, None], np.sin(yaws)[:, None]
        ahead = cos * x + sin * y
        serves = (np.abs(z) <= fov.up * ahead) & (np.abs(cos * y - sin * x) <= fov.across * ahead)
        worst = max(worst, np.sqrt(np.where(serves, x * x + y * y + z * z, np.inf).min(axis=1)).max())
    return worst


@pytest.mark.parametrize("fov", FOVS)
def test_no_viewer_is_farther_from_a_point(fov):
    lattice = lattice_for(fov)
    bound = reach(lattice, fov)
    assert 0.9 * bound < farthest_served(lattice, fov, bound, 100, seed=1) <= bound


def test_no_viewer_near_a_layer_is_farther_from_a_point():
    lattice = lattice_for(USUAL)
    bound = reach(lattice, USUAL, height=0.15)
    assert 0.9 * bound < farthest_served(lattice, USUAL, bound, 100, seed=2, height=0.15) <= bound
    assert bound <= reach(lattice, USUAL)


@pytest.mark.slow
@pytest.mark.parametrize("fov", FOVS)
def test_no_viewer_of_a_million_is_farther(fov):
    lattice = lattice_for(fov)
    bound = reach(lattice, fov)
    worst = farthest_served(lattice, fov, bound, 2500, seed=3)
    print(f"{fov}: proven {bound:.3f}, found {worst:.3f}")
    assert 0.94 * bound < worst <= bound


def test_the_points_are_layers_of_triangles():
    lattice = lattice_for(USUAL)
    places = lattice.places(lattice.within(-4.0 * np.ones(3), 4.0 * np.ones(3)))
    assert len(np.unique(np.round(places, 6), axis=0)) == len(places)
    layer = places[places[:, 2] == 0.0]
    apart = np.linalg.norm(layer[:, None] - layer, axis=2)
    inner = np.linalg.norm(layer, axis=1) < 2.0
    assert (((apart > 0.5) & (apart < 1.0 + 1e-9)).sum(axis=1)[inner] == 6).all()
    above = places[np.isclose(places[:, 2], lattice.layer)]
    flat = np.linalg.norm(layer[inner][:, None, :2] - above[:, :2], axis=2)
    assert np.allclose(np.sort(flat, axis=1)[:, :3], 1.0 / math.sqrt(3.0))


def test_all_points_of_a_box_are_found():
    lattice = lattice_for(USUAL)
    low, high = np.array([-1.3, 0.2, -2.1]), np.array([0.4, 3.3, 1.2])
    every = np.stack(np.meshgrid(*[np.arange(-12, 13)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    places = lattice.places(every)
    expected = every[((places >= low) & (places <= high)).all(axis=1)]
    assert {tuple(one) for one in lattice.within(low, high).tolist()} == {tuple(one) for one in expected.tolist()}
