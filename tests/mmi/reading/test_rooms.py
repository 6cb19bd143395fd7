"""Rooms: paths inside of a model, over its floor, are walked; in what is solid, or out of doors, they are what they were."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
import shapely
from city_files import geojson
from hypothesis import given
from hypothesis import strategies as st
from shapely.geometry import LineString

from citygen.scenes.living_room import living_room
from citygen.scenes.paths import footways
from mmi.cells.viewing_cells import viewing_cells
from mmi.city.model import City, CityObject, Prism, TriangleMesh
from mmi.foundation.errors import CityError
from mmi.reading.ground.rooms import CLEAR, floor_below, opened
from mmi.reading.read_city import read_city
from mmi.reading.read_options import ReadOptions
from mmi.writing.cityjson_writer import write_cityjson
from mmi.writing.gltf_writer import write_glb
from viewer.walks.random_views import random_views

QUADS = ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7))
SHELL = [((0, 0, -0.2, 10, 8, 3), True), ((0.2, 0.2, 0, 9.8, 7.8, 2.8), False)]
PILLAR = [((4, 3, 0, 4.5, 5, 2.8), True)]


def boxes_mesh(boxes):
    """One mesh of boxes (x0, y0, z0, x1, y1, z1), each facing outwards (True) or, as a cave, inwards."""
    points, triangles = [], []
    for (x0, y0, z0, x1, y1, z1), outwards in boxes:
        shift = len(points)
        points += [(x, y, z) for z in (z0, z1) for x, y in ((x0, y0), (x1, y0), (x1, y1), (x0, y1))]
        for a, b, c, d in QUADS:
            both = [(a, b, c), (a, c, d)]
            triangles += [[shift + k for k in (one if outwards else one[::-1])] for one in both]
    return TriangleMesh(np.array(points, dtype=float), np.array(triangles, dtype=np.int32))


def model(name, *boxes):
    """An object that is bounded by one prism."""
    mesh = boxes_mesh(boxes)
    (x0, y0, z0), (x1, y1, z1) = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    return CityObject(name, (Prism(shapely.box(x0, y0, x1, y1), z0, z1),), mesh)


def read_with_path(tmp_path, boxes, *points, **options):
    """The city of one mesh of ``boxes``, read from an OBJ, with a footway through ``points``."""
    mesh = boxes_mesh(boxes)
    lines = ["o room", *(f"v {x} {y} {z}" for x, y, z in mesh.vertices)]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in mesh.triangles]
    (tmp_path / "room.obj").write_text("\n".join(lines) + "\n")
    paths = geojson(tmp_path / "paths.geojson", [(LineString(points), {"highway": "footway", "width": "0.6"})])
    # Without a coordinate system GeoJSON is taken for degrees, unless it cannot be.
    return read_city(tmp_path / "room.obj", ReadOptions(streets=paths, up="z", **options))


def moved(boxes, shift=900.0):
    return [((x0 + shift, y0, z0, x1 + shift, y1, z1), out) for (x0, y0, z0, x1, y1, z1), out in boxes]


def walked(city):
    """Spans in x of the streets, in the file's frame."""
    spans = [edge["geometry"].bounds for *_, edge in city.streets.edges(data=True)]
    return sorted((x0 + city.origin[0], x1 + city.origin[0]) for x0, _, x1, _ in spans)


@pytest.fixture(scope="module", params=[(write_cityjson, ".json"), (write_glb, ".glb")], ids=["json", "glb"])
def rooms(request, tmp_path_factory):
    write, suffix = request.param
    made = living_room(3)
    path = tmp_path_factory.mktemp("room") / f"room{suffix}"
    write(made, path)
    return made, *read_city(path)


def test_the_living_room_keeps_its_paths_and_stays_as_it_is(rooms):
    made, city, report = rooms
    assert "indoors: paths over a floor of the model" in [one.what for one in report.noted]
    drawn, read = ([edge["geometry"] for *_, edge in one.streets.edges(data=True)] for one in (made, city))
    assert len(drawn) == len(read) == 7
    assert all(min(line.hausdorff_distance(other) for other in read) < 0.002 for line in drawn)
    assert city.terrain is None
    assert -0.02 < city.ground < 0.0
    before = {one.id: (one.base, one.top) for one in made.objects}
    assert set(before) == {one.id for one in city.objects}
    for one in city.objects:  # books stay in their shelf, the lamp and the ceiling above the table
        assert (one.mesh.vertices[:, 2].min(), one.mesh.vertices[:, 2].max()) == pytest.approx(before[one.id], abs=2e-3)


def test_views_of_the_living_room_are_inside_of_it(rooms):
    _, city, _ = rooms
    cells = [data["cell"] for _, data in viewing_cells(city).nodes(data=True)]
    eyes = np.array([pose.eye for _, pose in random_views(cells, n=200, seed=1)])
    assert (eyes > (0.05, 0.05, 1.4)).all()
    assert (eyes < (7.95, 5.95, 2.0)).all()
    solid = [p.footprint for one in city.objects for p in one.prisms if p.bottom < 1.9 and p.top > 0.1]
    assert not shapely.intersects(shapely.union_all(solid), shapely.points(eyes[:, :2])).any()


def test_a_path_in_a_shell_is_cut_at_its_walls_and_pillars(tmp_path):
    city, _ = read_with_path(tmp_path, moved([*SHELL, *PILLAR]), (900.05, 4), (909, 4))
    spans = walked(city)
    # The wall is 20 cm thick and hollow in plan: what lies within it is too short to stay.
    assert spans == pytest.approx(np.array([(900.2, 904.0), (904.5, 909.0)]), abs=0.05)
    (one,) = city.objects
    ends = [one.base, *sorted(prism.bottom for prism in one.prisms), *(prism.top for prism in one.prisms)]
    assert (min(ends), max(ends)) == (-0.2, 3.0)
    for corner in one.mesh.vertices:
        at = shapely.Point(corner[:2])
        assert any(p.footprint.distance(at) < 1e-3 and p.bottom <= corner[2] <= p.top for p in one.prisms)
    cells = [data["cell"] for _, data in viewing_cells(city).nodes(data=True)]
    assert min(cell.half_width for cell in cells) > 0.25


def test_a_solid_block_is_no_room(tmp_path):
    with pytest.raises(CityError, match=r"no streets left for --network walk: .* 1 inside buildings"):
        read_with_path(tmp_path, moved(SHELL[:1]), (901, 4), (909, 4), network="walk")


def test_a_path_that_leaves_the_model_is_a_street():
    shell = model("shell", *SHELL)
    inside, across = LineString([(1, 4), (9, 4)]), LineString([(5, 4), (12, 4)])
    assert floor_below([shell], [inside]) == pytest.approx(-0.01)
    assert floor_below([shell], [inside, across]) is None
    assert floor_below([shell], [across]) is None
    assert floor_below([shell], []) is None
    assert floor_below([shell], [LineString([(50, 50), (60, 50)])]) is None


def test_only_hollow_objects_are_opened():
    shell, block = model("shell", *SHELL), model("block", ((3, 3, 0, 4, 5, 2.5), True))
    path = LineString([(1, 4), (9, 4)])
    open_shell, same_block = opened([shell, block], [path], -0.01)
    assert same_block.prisms == block.prisms
    height = 0.5 * sum(CLEAR)
    walls = shapely.union_all([p.footprint for p in open_shell.prisms if p.bottom < height < p.top])
    assert walls.area < 0.5 * shell.footprint.area
    assert not walls.intersects(path)
    assert walls.intersects(LineString([(1, 4), (11, 4)]))


@pytest.mark.parametrize("floored", [True, False])
def test_rugs_are_stepped_over_on_floors_only(floored):
    """Out of doors nothing changes: there a cell ends at whatever rises above the ground."""
    rug = model("rug", ((4, 2, 0.001, 6, 6, 0.015), True))
    floor = model("floor", ((0, 0, -0.2, 10, 8, 0), True))
    city = City(
        objects=(rug, floor) if floored else (rug,),
        streets=footways([(1, 4), (9, 4)], [(0, 1, ())], half_width=0.5),
        crs="local",
        origin=(0.0, 0.0, 0.0),
        source="rug",
        ground=-0.01 if floored else 0.0,
    )
    cells = [data["cell"] for _, data in viewing_cells(city).nodes(data=True)]
    assert len(cells) == (1 if floored else 2)
    assert sum(cell.length for cell in cells) == pytest.approx(8.0 if floored else 5.5, abs=0.02)


@given(st.lists(st.tuples(st.integers(-20, 60), st.integers(1, 30)), min_size=1, max_size=6))
def test_the_floor_is_where_solids_leave_room(spans):
    """Oracle: the union of solid heights, and the lowest gap of it that is high enough."""
    objects = [model(f"slab{i}", ((0, 0, z, 4, 4, z + h), True)) for i, (z, h) in enumerate(spans)]
    solid = shapely.union_all([LineString([(z, 0), (z + h, 0)]) for z, h in spans])
    parts = sorted(one.bounds[::2] for one in shapely.get_parts(shapely.line_merge(solid)))
    gaps = [below[1] for below, above in pairwise(parts) if above[0] - below[1] >= CLEAR[1]]
    found = floor_below(objects, [LineString([(1.1, 1.3), (2.7, 2.2)])])
    assert found == (pytest.approx(gaps[0] - 0.01) if gaps else None)
