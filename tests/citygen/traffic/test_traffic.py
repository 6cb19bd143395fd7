"""Vehicles keep to their streets and to the right, never touch, stand on the ground, and stop and go as vehicles can."""

from __future__ import annotations

from typing import NamedTuple

import networkx as nx
import numpy as np
import pytest
import shapely
from closed_meshes import is_closed, volume
from shapely.geometry import LineString, Polygon

from citygen.traffic.traffic import STEP, traffic
from citygen.traffic.vehicles import KINDS, vehicle_mesh
from mmi.city.model import City
from mmi.city.terrain import Terrain
from mmi.foundation.errors import CityError
from mmi.movers.movers_file import read_movers, write_movers


def grid(*, nodes=4, step=70.0, half_width=4.0, jitter=0.0, kind="residential", terrain=None):
    """A crooked grid of streets."""
    rng = np.random.default_rng(5)
    streets = nx.MultiGraph()
    for i in range(nodes * nodes):
        x, y = (step * np.array(divmod(i, nodes)) + rng.uniform(-jitter, jitter, 2)).tolist()
        streets.add_node(i, x=x, y=y)
    pairs = [(i, i + 1) for i in range(nodes * nodes) if i % nodes < nodes - 1]
    pairs += [(i, i + nodes) for i in range(nodes * (nodes - 1))]
    for index, (a, b) in enumerate(pairs):
        line = LineString([(streets.nodes[n]["x"], streets.nodes[n]["y"]) for n in (a, b)])
        streets.add_edge(a, b, geometry=line, kind=kind, half_width=half_width, name="", index=index)
    return City((), streets, "local", (0.0, 0.0, 0.0), "grid", terrain=terrain)


class Driven(NamedTuple):
    """Poses by step and vehicle: ``positions`` (k, n, 3), ``headings`` (k, n)."""

    kinds: np.ndarray
    times: np.ndarray
    positions: np.ndarray
    headings: np.ndarray


def driven(city, seed, *, vehicles, seconds):
    found = traffic(city, seed, vehicles=vehicles, seconds=seconds)
    assert found.crs == city.crs
    times = found.times.reshape(vehicles, -1)
    assert (times == times[0]).all()
    positions = found.positions.reshape(vehicles, -1, 3).swapaxes(0, 1)
    return Driven(found.kinds, times[0], positions, found.angles[:, 0].reshape(vehicles, -1).T)


def outlines(found, step):
    """Rectangles (n,) of all vehicles at a moment."""
    boxes = []
    for i, kind in enumerate(found.kinds.tolist()):
        c, s = np.cos(found.headings[step, i]), np.sin(found.headings[step, i])
        half = np.array([KINDS[kind].length, KINDS[kind].width]) / 2.0
        corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * half
        boxes.append(Polygon(corners @ np.array([[c, s], [-s, c]]) + found.positions[step, i, :2]))
    return np.array(boxes)


@pytest.fixture(scope="module", params=[(0.0, 20), (14.0, 60)])
def drive(request):
    jitter, vehicles = request.param
    city = grid(jitter=jitter)
    return city, driven(city, 3, vehicles=vehicles, seconds=60.0)


def test_vehicles_never_touch(drive):
    _, found = drive
    for step in range(0, len(found.times), 4):
        boxes = outlines(found, step)
        a, b = shapely.STRtree(boxes).query(boxes, predicate="intersects")
        assert (a == b).all(), (step, KINDS[found.kinds[a[a < b][0]]] if (a < b).any() else None)


def test_vehicles_never_leave_the_streets(drive):
    city, found = drive
    streets = shapely.union_all([e["geometry"].buffer(e["half_width"]) for *_, e in city.streets.edges(data=True)])
    shapely.prepare(streets)
    assert shapely.covers(streets, shapely.points(found.positions[..., :2].reshape(-1, 2))).all()
    wider = streets.buffer(2.0)  # long ones cut corners over the kerb
    for step in range(0, len(found.times), 10):
        assert shapely.covers(wider, outlines(found, step)).all()


def test_vehicles_keep_to_the_right(drive):
    """Away from junctions, the middle of the street is to the left of each."""
    city, found = drive
    lines = [edge["geometry"] for *_, edge in city.streets.edges(data=True)]
    nodes = shapely.points([(n["x"], n["y"]) for _, n in city.streets.nodes(data=True)])
    seen = 0
    for step in range(0, len(found.times), 50):
        for i in range(len(found.kinds)):
            here = shapely.points(found.positions[step, i, :2])
            if shapely.distance(nodes, here).min() < 22.0:
                continue
            line = lines[int(np.argmin(shapely.distance(lines, here)))]
            axis = shapely.get_coordinates(line.interpolate(line.project(here)))[0]
            heading = found.headings[step, i]
            to_axis = axis - found.positions[step, i, :2]
            left = np.cos(heading) * to_axis[1] - np.sin(heading) * to_axis[0]
            assert left == pytest.approx(2.0, abs=0.05)
            seen += 1
    assert seen > 50


def test_vehicles_move_like_vehicles(drive):
    """Forwards, not too fast, without jumps; most of them get somewhere, at different speeds."""
    _, found = drive
    moved = np.diff(found.positions[..., :2], axis=0)
    speed = np.linalg.norm(moved, axis=2) / STEP
    assert speed.max() < 15.0
    assert np.diff(speed, axis=0).max() * 1.0 / STEP < 1.8 + 3.5  # bends of the way shorten some steps
    assert np.abs(np.diff(found.headings, axis=0)).max() / STEP < 3.5
    forward = np.stack([np.cos(found.headings[:-1]), np.sin(found.headings[:-1])], axis=-1)
    assert (moved * forward).sum(axis=2).min() > -1e-6
    way = speed.sum(axis=0) * STEP
    assert np.median(way) > 80.0
    assert np.ptp(speed.max(axis=0)) > 1.0
    turned = np.abs(found.headings[-1] - found.headings[0])
    assert (turned > 1.0).any()


def test_vehicles_stand_on_the_terrain():
    heights = np.add.outer(np.linspace(0.0, 9.0, 13), np.linspace(0.0, 3.0, 13) ** 2)
    city = grid(terrain=Terrain((-10.0, -10.0), 20.0, heights))
    found = traffic(city, 1, vehicles=5, seconds=10.0)
    assert np.allclose(found.positions[..., 2], city.ground_at(found.positions[..., :2]))
    assert np.ptp(found.positions[..., 2]) > 0.1
    assert np.ptp(found.angles[:, 1]) > 0.01


def test_wheels_touch_a_slope():
    """On a plane that rises to both sides, all four corners below a vehicle are on it, whatever its heading."""
    rows = np.arange(13.0)
    city = grid(terrain=Terrain((-10.0, -10.0), 20.0, np.add.outer(3.0 * rows, 2.0 * rows)), jitter=14.0)
    found = traffic(city, 2, vehicles=8, seconds=6.0)
    poses = found.poses(4.0)
    corners = found.corners(poses)[:, :4]  # those with the lowest z of its own
    assert np.allclose(corners[..., 2], city.ground_at(corners), atol=1e-6)
    assert np.abs(poses[:, 2, 0]).max() > 0.1


def test_level_ground_turns_nothing():
    found = traffic(grid(jitter=14.0), 2, vehicles=8, seconds=6.0)
    assert not found.angles[:, 1:].any()


def test_the_same_seed_drives_the_same():
    city = grid()
    a, b, c = (driven(city, seed, vehicles=9, seconds=5.0) for seed in (1, 1, 2))
    assert np.array_equal(a.positions, b.positions)
    assert np.array_equal(a.headings, b.headings)
    assert not np.array_equal(a.positions, c.positions)
    assert a.positions.shape == (51, 9, 3)


def test_dead_ends_are_turned_in():
    """A lone street: vehicles come back on its other side."""
    city = grid()
    streets = nx.MultiGraph()
    streets.add_nodes_from([(0, {"x": 0.0, "y": 0.0}), (1, {"x": 90.0, "y": 0.0})])
    line = LineString([(0, 0), (90, 0)])
    streets.add_edge(0, 1, geometry=line, kind="residential", half_width=4.0, name="", index=0)
    city = City((), streets, "local", (0.0, 0.0, 0.0), "street")
    found = driven(city, 1, vehicles=3, seconds=90.0)
    assert set(np.unique(np.sign(found.positions[:, 0, 1].round(1)))) >= {-1.0, 1.0}
    assert (np.ptp(found.headings, axis=0) > 3.0).all()


def test_foot_ways_and_narrow_lanes_carry_none():
    for city in (grid(kind="footway"), grid(half_width=1.5)):
        with pytest.raises(CityError, match="found room for 0"):
            traffic(city, 1, vehicles=1, seconds=1.0)
    assert traffic(grid(kind="footway"), 1, vehicles=0, seconds=1.0).ids == ()
    with pytest.raises(CityError, match="room for 9999 vehicles expected"):
        traffic(grid(), 1, vehicles=9999, seconds=1.0)
    with pytest.raises(CityError, match="found -1"):
        traffic(grid(), 1, vehicles=-1, seconds=1.0)


def test_what_is_written_can_be_read(tmp_path):
    found = traffic(grid(), 4, vehicles=6, seconds=4.0)
    write_movers(found, tmp_path / "a.json")
    again = read_movers(tmp_path / "a.json")
    assert (again.ids, again.names) == (found.ids, found.names)
    for time in np.linspace(-1.0, 5.0, 25):
        assert np.allclose(again.poses(time), found.poses(time), atol=1e-3)
    for mine, theirs in zip(found.meshes, again.meshes, strict=True):
        assert np.allclose(mine.vertices, theirs.vertices, atol=6e-4)
        assert np.array_equal(mine.triangles, theirs.triangles)
        assert np.array_equal(mine.colors, theirs.colors)


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_vehicles_are_solid_and_as_long_as_they_say(kind):
    mesh = vehicle_mesh(kind)
    assert is_closed(mesh)
    assert volume(mesh) > 3.0
    size = np.ptp(mesh.vertices, axis=0)
    assert size[0] == pytest.approx(kind.length, abs=0.06)
    assert size[1] == pytest.approx(kind.width, abs=0.1)
    assert mesh.vertices[:, 2].min() == pytest.approx(0.0, abs=1e-9)


def test_vehicles_go_round_what_is_within_a_large_junction():
    """Four short streets around a green, each corner with a long one: nobody drives across the green."""
    streets = nx.MultiGraph()
    corners = [(0.0, 0.0), (16.0, 0.0), (16.0, 16.0), (0.0, 16.0)]
    for i, (x, y) in enumerate(corners):
        streets.add_node(i, x=x, y=y)
        streets.add_node(i + 4, x=x + (120.0 if x else -120.0), y=y)
    pairs = [(0, 1), (1, 2), (2, 3), (0, 3), (0, 4), (1, 5), (2, 6), (3, 7)]
    for index, (a, b) in enumerate(pairs):
        line = LineString([(streets.nodes[n]["x"], streets.nodes[n]["y"]) for n in ((b, a) if index % 2 else (a, b))])
        streets.add_edge(a, b, geometry=line, kind="residential", half_width=3.0, name="", index=index)
    city = City((), streets, "local", (0.0, 0.0, 0.0), "green")
    found = driven(city, 2, vehicles=8, seconds=90.0)
    places = shapely.points(found.positions[..., :2].reshape(-1, 2))
    surface = shapely.union_all([e["geometry"].buffer(e["half_width"]) for *_, e in streets.edges(data=True)])
    assert shapely.covers(surface, places).all()
    assert (np.hypot(*(found.positions[..., :2] - 8.0).T).min(axis=1) < 30.0).any()
    for step in range(0, len(found.times), 10):
        a, b = shapely.STRtree(outlines(found, step)).query(outlines(found, step), predicate="intersects")
        assert (a == b).all()


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_no_two_colours_share_a_plane(kind):
    """Where they do, which of them shows depends on rounding: it flickers, and differs between a picture and its capture."""
    mesh = vehicle_mesh(kind)
    corners = mesh.vertices[mesh.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    away = np.einsum("ij,ij->i", normals, corners[:, 0])
    shared = []
    for axis in range(3):
        flat = np.delete(corners, axis, axis=2)
        for one in np.flatnonzero(np.abs(normals[:, axis]) > 0.9):
            same = (normals @ normals[one] > 1 - 1e-6) & (np.abs(away - away[one]) < 1e-3)
            for other in np.flatnonzero(same & (mesh.colors != mesh.colors[one]).any(axis=1)):
                area = shapely.Polygon(flat[one]).intersection(shapely.Polygon(flat[other])).area
                if area > 1e-6:
                    shared.append((mesh.colors[one].tolist(), mesh.colors[other].tolist(), area))
    assert shared == []
