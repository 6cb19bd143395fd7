"""Pictures, a church, and the scenes of other papers: what they promise of sizes and counts, and that they are sound."""

from __future__ import annotations

import networkx as nx
import numpy as np
import pytest
import shapely
from closed_meshes import is_closed, outside_prisms, points_in_core, prism_volume, volume, winding
from shapely.geometry import LineString, Point

from citygen.buildings.church import church
from citygen.scenes.forest import TREES, forest
from citygen.scenes.living_room import living_room
from citygen.scenes.pipes import PIECES, pipes
from citygen.shapes import textures
from citygen.shapes.solids import box as solid_box
from citygen.shapes.solids import compacted, extrusion, lathe, tube
from mmi.foundation.errors import CityError


@pytest.fixture(scope="module")
def pictures():
    return textures.city_textures(3)


@pytest.fixture(scope="module")
def wood():
    return forest(2)


@pytest.fixture(scope="module")
def room():
    return living_room(2)


@pytest.fixture(scope="module")
def plant():
    return pipes(2)


def check_scene(city):
    """Objects in their prisms, cores in their objects, and a walkable graph."""
    for one in city.objects:
        assert outside_prisms(one) == 0
        assert one.mesh.textures.max() < len(city.textures)
    assert nx.is_connected(city.streets)
    indices = [edge["index"] for *_, edge in city.streets.edges(data=True)]
    assert sorted(indices) == list(range(len(indices)))
    for a, b, edge in city.streets.edges(data=True):
        low, high = city.streets.nodes[min(a, b)], city.streets.nodes[max(a, b)]
        line = edge["geometry"]
        assert isinstance(line, LineString)
        assert line.coords[0] == (low["x"], low["y"])
        assert line.coords[-1] == (high["x"], high["y"])
        assert edge["kind"] == "footway"
        assert edge["half_width"] > 0.0


# ------------------------------------------------------------------------------------------------------------ pictures


def test_there_are_34_pictures_of_handy_sizes(pictures):
    assert len(pictures) == len(textures.NAMES) == 34
    assert tuple(one.name for one in pictures) == textures.NAMES
    for one in pictures:
        height, width, _ = one.image.shape
        assert height & (height - 1) == 0 == width & (width - 1)
        assert width <= 512
        assert height <= 1024
        assert one.image.std() > 2.0


def test_lookups_name_every_picture_once():
    tables = [textures.FACADES, textures.GROUNDS]
    used = [i for table in tables for group in table.values() for i in group]
    used += [*textures.WALLS.values(), *textures.ROOFS.values()]
    used += [textures.PANES, textures.DOORS, textures.SHUTTER, textures.TRIM, textures.RAILING]
    assert sorted(used) == list(range(34))
    assert textures.NAMES[textures.FACADES["brick"][1]] == "facade-brick-1"
    with pytest.raises(TypeError):
        textures.WALLS["brick"] = 3


def test_facades_have_no_seam_sideways(pictures):
    """Across the seam neighbouring columns differ no more than elsewhere at the edges of bays."""
    for group in (*textures.FACADES.values(), *textures.GROUNDS.values()):
        for i in group:
            image = pictures[i].image.astype(np.float64)
            steps = np.abs(image - np.roll(image, 1, axis=1)).mean(axis=(0, 2))
            assert steps[0] <= 1.5 * steps[64::64].max() + 1.0


def test_pictures_are_repeatable(pictures):
    again = textures.city_textures(3)
    assert all(np.array_equal(a.image, b.image) for a, b in zip(pictures, again, strict=True))


# -------------------------------------------------------------------------------------------------------------- shapes


def test_solids_have_the_volume_of_their_formulas():
    cylinder = compacted(lathe([(0, 0), (2, 0), (2, 5), (0, 5)], 200))
    assert volume(cylinder) == pytest.approx(np.pi * 4.0 * 5.0, rel=1e-3)
    assert volume(compacted(solid_box((0, 0, 0), (2, 3, 4)))) == pytest.approx(24.0)
    assert volume(compacted(extrusion([(0, 0), (4, 0), (0, 3)], 1.0, 3.0))) == pytest.approx(12.0)
    bend = np.linspace(0.0, 0.5 * np.pi, 60)
    path = np.column_stack([10.0 * np.cos(bend), 10.0 * np.sin(bend), np.zeros(60)])
    pipe = compacted(tube(path, 0.5, 60))
    assert volume(pipe) == pytest.approx(np.pi * 0.25 * 10.0 * 0.5 * np.pi, rel=5e-3)
    for mesh in (cylinder, pipe):
        assert is_closed(mesh)


# -------------------------------------------------------------------------------------------------------------- church


@pytest.mark.parametrize("detail", range(4))
def test_the_church_is_solid(detail):
    one = church("c", (100.0, 40.0), base=3.0, height=80.0, heading=0.7, detail=detail, rng=np.random.default_rng(1))
    assert is_closed(one.mesh)
    assert outside_prisms(one) == 0
    assert one.base == pytest.approx(3.0, abs=1e-3)
    assert one.top == pytest.approx(83.0, abs=1e-3)
    inside = points_in_core(one, 1, np.random.default_rng(2))
    assert len(inside) > 15
    assert (winding(one.mesh, inside) > 0.99).all()
    assert max(map(prism_volume, one.core)) < volume(one.mesh)
    corners = np.array(one.footprint.minimum_rotated_rectangle.exterior.coords)
    sides = np.sort(np.hypot(*np.diff(corners[:3], axis=0).T))
    assert sides == pytest.approx([41.0, 60.0], abs=2.0)
    assert one.footprint.contains(Point(100.0, 40.0))


def test_the_church_refines():
    counts = [
        len(church("c", (0, 0), base=0, height=80, heading=0, detail=d, rng=np.random.default_rng(1)).mesh.triangles)
        for d in range(4)
    ]
    assert counts == sorted(counts)
    assert 2000 <= counts[0] <= 6000
    assert 20000 <= counts[3] <= 35000


def test_the_church_turns_about_its_centre():
    a = church("c", (5, 6), base=0, height=80, heading=0.0, detail=0, rng=np.random.default_rng(1)).mesh
    b = church("c", (5, 6), base=0, height=80, heading=np.pi / 2, detail=0, rng=np.random.default_rng(1)).mesh
    turned = (a.vertices[:, :2] - (5, 6)) @ np.array([[0, 1], [-1, 0]]) + (5, 6)
    assert np.allclose(b.vertices[:, :2], turned)
    with pytest.raises(CityError, match="found 9"):
        church("c", (0, 0), base=0, height=80, heading=0, detail=9, rng=np.random.default_rng(1))


# -------------------------------------------------------------------------------------------------------------- scenes


def test_a_hundred_trees_stand_clear_of_the_path(wood):
    assert len(wood.objects) == TREES == 100
    assert sum(len(one.mesh.triangles) for one in wood.objects) == 105_000
    check_scene(wood)
    path = shapely.union_all([edge["geometry"] for *_, edge in wood.streets.edges(data=True)])
    for one in wood.objects:
        assert one.core == ()
        low = one.mesh.vertices[one.mesh.vertices[:, 2] < 0.2]
        assert path.distance(Point(low[:, :2].mean(axis=0))) > 2.5
        assert 8.0 < one.height < 28.0


def test_the_room_is_furnished(room):
    check_scene(room)
    by_id = {one.id: one for one in room.objects}
    assert len([name for name in by_id if name.startswith("book/")]) > 150
    leaves = [name for name in by_id if name.startswith("plant/")]
    assert all(is_closed(one.mesh) for one in room.objects if one.id not in leaves)
    inside = by_id["shelf"].footprint
    assert all(inside.covers(one.footprint.buffer(-1e-3)) for name, one in by_id.items() if name.startswith("book/"))
    table = by_id["table"].footprint
    assert sum(table.intersects(one.footprint) for name, one in by_id.items() if name.startswith("chair/")) == 6
    for wall in ("wall/south", "wall/north", "floor"):
        points = points_in_core(by_id[wall], 5, np.random.default_rng(1))
        assert (winding(by_id[wall].mesh, points) > 0.99).all()


def test_the_path_through_the_room_is_free(room):
    """Nobody walks through the table, the sofa or the shelf."""
    path = shapely.union_all([edge["geometry"] for *_, edge in room.streets.edges(data=True)])
    for one in room.objects:
        if one.id.split("/")[0] in {"sofa", "shelf", "sideboard", "table", "wall", "armchair", "plant", "chair"}:
            assert one.footprint.distance(path) > 0.0, one.id


def test_the_plant_has_a_million_triangles(plant):
    assert len(plant.objects) == np.prod(PIECES) == 1000
    assert sum(len(one.mesh.triangles) for one in plant.objects) == 1_000_000
    kinds = {tuple(np.sort(np.ptp(one.mesh.vertices, axis=0)).round(3)): one for one in plant.objects}
    assert len(kinds) == 3
    for one in kinds.values():
        assert is_closed(one.mesh)
        assert volume(one.mesh) > 0.0
        assert outside_prisms(one) == 0
    assert plant.objects[0].mesh.uv.shape == (1000, 3, 2)
    for a, b in ((0, 7), (3, 400)):
        assert plant.objects[a].footprint != plant.objects[b].footprint
    aisles = shapely.union_all([edge["geometry"].buffer(0.8) for *_, edge in plant.streets.edges(data=True)])
    assert not any(aisles.intersects(one.footprint) for one in plant.objects)
    assert nx.is_connected(plant.streets)


def test_scenes_are_repeatable(wood):
    again, other = forest(2), forest(3)
    assert np.array_equal(wood.objects[50].mesh.vertices, again.objects[50].mesh.vertices)
    assert not np.array_equal(wood.objects[50].mesh.vertices, other.objects[50].mesh.vertices)


def test_the_floor_of_the_room_is_above_the_plain_around_it(room):
    """Of two surfaces in one plane a renderer shows the one here and the other there."""
    floor = next(one for one in room.objects if one.id == "floor")
    assert floor.mesh.vertices[:, 2].max() > room.ground + 0.005
