from __future__ import annotations

import networkx as nx
import numpy as np
import pytest
import shapely
from shapely.geometry import LineString, Point, Polygon, box

from mmi.city import City, CityObject, Prism
from mmi.ground import SKY_HORIZON, SKY_ZENITH, ground_mesh, sky_color


def crossroads(ground: float = 0.0) -> City:
    streets = nx.MultiGraph()
    for i, (x, y) in enumerate([(100, 0), (0, 100), (-100, 0), (0, -100)]):
        streets.add_edge(
            0, i + 1, geometry=LineString([(0, 0), (x, y)]), half_width=4.0, kind="street", name="", index=i
        )
    house = CityObject("a", (Prism(box(20, 20, 60, 50), ground, ground + 12.0),))
    return City((house,), streets, "EPSG:32631", (0.0, 0.0, 0.0), "test", ground)


def color_at(mesh, x: float, y: float) -> tuple[int, int, int]:
    polygons = [Polygon(t) for t in mesh.positions[mesh.triangles][:, :, :2]]
    hits = [i for i, polygon in enumerate(polygons) if polygon.contains(Point(x, y))]
    assert len(hits) == 1
    return tuple(mesh.colors[mesh.triangles[hits[0], 0]].tolist())


def test_the_ground_is_covered_once_and_faces_up():
    mesh = ground_mesh(crossroads(2.0), margin=50.0)
    assert (mesh.positions[:, 2] == 2.0).all()
    a, b, c = mesh.positions[mesh.triangles].astype(float)[..., :2].swapaxes(0, 1)
    area = 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    assert (area >= 0.0).all()
    assert area.sum() == pytest.approx(300.0**2, rel=1e-6)
    whole = shapely.union_all(
        [Polygon(t) for t in mesh.positions[mesh.triangles][:, :, :2].astype(float)], grid_size=1e-3
    )
    assert whole.area == pytest.approx(300.0**2, rel=1e-5)
    assert mesh.triangle_counts.tolist() == [len(mesh.triangles)]


def test_streets_have_kerbs_pavements_and_grass_beyond():
    mesh = ground_mesh(crossroads(), margin=50.0)
    road, kerb, pavement, grass = (color_at(mesh, 80.1, y) for y in (1.03, 4.12, 6.01, -60.2))
    assert len({road, kerb, pavement, grass}) == 4
    assert sum(road) < sum(grass) < sum(kerb)
    assert color_at(mesh, 40.3, 35.2) == pavement  # below the house
    assert color_at(mesh, 65.1, 35.2) == pavement  # around it
    assert color_at(mesh, 90.1, 90.2) == grass


def test_a_city_without_streets_has_ground():
    house = CityObject("a", (Prism(box(0, 0, 10, 10), 0.0, 12.0),))
    mesh = ground_mesh(City((house,), nx.MultiGraph(), "EPSG:32631", (0.0, 0.0, 0.0), "test"), margin=30.0)
    low, high = mesh.positions.min(axis=0), mesh.positions.max(axis=0)
    assert (low[:2] == -30.0).all()
    assert (high[:2] == 40.0).all()


def test_the_sky_darkens_towards_the_zenith():
    sky = sky_color([[1.0, 0.0, 0.0], [0.0, 0.6, 0.8], [0.0, 0.0, 1.0], [0.0, 0.6, -0.8]])
    assert sky.dtype == np.uint8
    assert tuple(sky[0]) == tuple(sky[3]) == SKY_HORIZON
    assert tuple(sky[2]) == SKY_ZENITH
    assert SKY_ZENITH[0] < sky[1, 0] < SKY_HORIZON[0]
