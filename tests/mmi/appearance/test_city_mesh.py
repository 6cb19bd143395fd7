from __future__ import annotations

import json
import math
from dataclasses import replace

import networkx as nx
import numpy as np
import pytest
import shapely
from cities import crossroads, real
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely.geometry import Polygon, box, shape

from mmi.appearance.city_mesh import CityMesh, build_city_mesh, mesh_of, triangles_of
from mmi.appearance.facades import BAYS, ROWS, blind_strip, roof_strip, storey_v
from mmi.city.model import City, CityObject, Prism, TriangleMesh
from mmi.city.triangulate import triangulate


def city_of(*objects: CityObject, ground: float = 0.0) -> City:
    return City(tuple(objects), nx.MultiGraph(), "EPSG:32631", (0.0, 0.0, 0.0), "test", ground)


def building(name: str, footprint: Polygon, top: float, bottom: float = 0.0) -> CityObject:
    return CityObject(name, (Prism(footprint, bottom, top),))


def corners(mesh: CityMesh) -> np.ndarray:
    """(m, 3, 3) float64"""
    return mesh.positions[mesh.triangles].astype(np.float64)


def normals(mesh: CityMesh) -> np.ndarray:
    a, b, c = corners(mesh).swapaxes(0, 1)
    cross = np.cross(b - a, c - a)
    return cross / np.linalg.norm(cross, axis=1, keepdims=True)


def volume(mesh: CityMesh, floor: float = 0.0) -> float:
    """Of the solid between the surface and ``floor``, from the divergence theorem: negative if inside out."""
    a, b, c = (corners(mesh) - [0.0, 0.0, floor]).swapaxes(0, 1)
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0)


def area(mesh: CityMesh, which: np.ndarray) -> float:
    a, b, c = corners(mesh)[which].swapaxes(0, 1)
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2.0)


def style_of(mesh: CityMesh) -> int:
    """The style of a mesh of one building, from the lowest row of texture that its windows use."""
    v = float(mesh.uv[:, 1][mesh.uv[:, 1] <= storey_v(3, 0) + 1e-6].max())
    return int(np.argmin(np.abs(storey_v(np.arange(4), 0) - v)))


def test_a_box_is_four_walls_and_a_roof():
    mesh = build_city_mesh(city_of(building("a", box(2, 3, 12, 11), 9.6)))
    assert mesh.triangle_counts.tolist() == [10]
    assert len(mesh.positions) == 20
    assert volume(mesh) == pytest.approx(10 * 8 * 9.6)
    up = normals(mesh)[:, 2]
    assert sorted(np.round(up, 12).tolist()) == [0.0] * 8 + [1.0] * 2
    assert area(mesh, up > 0.5) == pytest.approx(80)
    assert set(mesh.positions[:, 2].tolist()) == {0.0, float(np.float32(9.6))}


@given(
    radii=st.lists(st.floats(6.0, 40.0), min_size=3, max_size=14),
    hole=st.booleans(),
    bottom=st.sampled_from([0.0, 4.0]),
    height=st.floats(0.5, 130.0),
    turn=st.floats(0.0, 6.0),
)
@settings(max_examples=60, deadline=None)
def test_any_prism_is_a_solid_right_side_out(radii, hole, bottom, height, turn):
    angle = turn + 2 * math.pi * np.arange(len(radii)) / len(radii)
    ring = np.column_stack([np.cos(angle), np.sin(angle)]) * np.array(radii)[:, None]
    small = 0.9 * np.column_stack([np.cos(angle), np.sin(angle)]) if hole else None
    footprint = Polygon(ring + 100.0, [small + 100.0] if small is not None else [])
    mesh = build_city_mesh(city_of(building("x", footprint, bottom + height, bottom)))
    assert volume(mesh) == pytest.approx(footprint.area * height, rel=2e-4, abs=0.05)
    up = normals(mesh)[:, 2]
    assert area(mesh, up > 0.5) == pytest.approx(footprint.area, rel=1e-4)
    assert area(mesh, np.abs(up) < 0.5) == pytest.approx(footprint.length * height, rel=1e-4)
    # Exactly vertical walls, exactly the prism's heights, no roof that is not flat.
    z = corners(mesh)[:, :, 2]
    assert (z[up > 0.5] == np.float32(bottom + height)).all()
    assert z.min() == np.float32(bottom)
    walls = corners(mesh)[np.abs(up) < 0.5]
    assert all(len(np.unique(wall[:, :2], axis=0)) == 2 for wall in walls)


def test_facades_are_upright_and_not_mirrored():
    mesh = build_city_mesh(city_of(building("a", Polygon([(0, 0), (20, 3), (25, 17), (4, 12)]), 16.0)))
    wall = np.abs(normals(mesh)[:, 2]) < 0.5
    for normal, points, uv in zip(
        normals(mesh)[wall], corners(mesh)[wall], mesh.uv[mesh.triangles][wall].astype(float), strict=True
    ):
        right = np.cross(-normal, [0.0, 0.0, 1.0])  # of somebody outside who looks at the wall
        step, texture_step = points[1:] - points[0], uv[1:] - uv[0]
        gradient = np.linalg.solve(np.column_stack([step @ right, step[:, 2]]), texture_step)
        assert gradient[0, 0] > 0.01  # u to the right
        assert gradient[1, 1] < -1e-4  # v (down) against z
        assert np.allclose([gradient[0, 1], gradient[1, 0]], 0.0, atol=1e-6)


def test_windows_are_never_cut():
    """Walls show whole bays and whole storeys: 10 m is three bays, 8 m is two or three, 11 m is three storeys."""
    mesh = build_city_mesh(city_of(building("a", box(0, 0, 10, 6.4), 11.0)))
    style = style_of(mesh)
    quads = mesh.uv[:16].reshape(4, 4, 2).astype(float)
    widths = (quads[:, 1, 0] - quads[:, 0, 0]) * BAYS
    assert sorted(np.round(widths, 5).tolist()) == [2, 2, 3, 3]
    assert np.allclose(quads[:, 0, 0] * BAYS % 1.0, 0.0)
    assert np.allclose(quads[:, :2, 1], storey_v(style, 0))
    assert np.allclose(quads[:, 2:, 1], storey_v(style, 3))


def test_a_tower_stacks_the_atlas_without_a_second_ground_floor():
    mesh = build_city_mesh(city_of(building("tower", box(0, 0, 30, 30), 128.0)))  # 40 storeys = 12 + 11 + 11 + 6
    assert mesh.triangle_counts[0] == 4 * 4 * 2 + 2
    style = style_of(mesh)
    wall = corners(mesh)[np.abs(normals(mesh)[:, 2]) < 0.5]
    assert sorted(set(np.round(wall[:, :, 2].ravel(), 4).tolist())) == pytest.approx(
        [0.0, 12 * 3.2, 23 * 3.2, 34 * 3.2, 128]
    )
    ground_floor = mesh.positions[np.isclose(mesh.uv[:, 1], storey_v(style, 0)), 2]
    assert (ground_floor == 0.0).all()
    assert mesh.uv[:, 1].min() >= storey_v(style, ROWS) - 1e-6


def test_floating_prisms_have_no_doors_but_an_underside():
    mesh = build_city_mesh(city_of(building("bridge", box(0, 0, 12, 12), 16.4, 10.0)))
    style = style_of(build_city_mesh(city_of(building("bridge", box(0, 0, 12, 12), 6.4))))
    up = normals(mesh)[:, 2]
    assert area(mesh, up < -0.5) == pytest.approx(144)
    v = mesh.uv[mesh.triangles][np.abs(up) < 0.5][..., 1]
    assert v.max() == pytest.approx(storey_v(style, 1))
    assert v.min() == pytest.approx(storey_v(style, 3))
    resting = build_city_mesh(city_of(building("bridge", box(0, 0, 12, 12), 16.4, 10.0), ground=9.5))
    assert area(resting, normals(resting)[:, 2] < -0.5) == 0.0


def test_only_touching_walls_and_short_ones_are_blind():
    def blind(mesh: CityMesh) -> list[bool]:
        low, high = blind_strip(0)[0], blind_strip(3)[1]
        v = mesh.uv[:, 1][mesh.positions[:, 2] == 0.0].reshape(-1, 2)[:, 0]
        return ((v >= low) & (v <= high + 1e-6)).tolist()

    a, b, c = (
        building("a", box(0, 0, 10, 10), 12.0),
        building("b", box(10, 0, 22, 10), 20.0),
        building("c", box(40, 0, 41, 9), 9.0),
    )
    mesh = build_city_mesh(city_of(a, b, c))
    assert [sum(blind(mesh_of(mesh, [i]))) for i in range(3)] == [1, 1, 2]
    assert sum(blind(build_city_mesh(city_of(a)))) == 0
    stacked = CityObject("s", (Prism(box(0, 0, 9, 9), 0.0, 6.4), Prism(box(0, 0, 9, 9), 6.4, 12.8)))
    assert sum(blind(build_city_mesh(city_of(stacked)))) == 0


def test_plain_walls_have_no_windows_and_the_same_shapes_and_roofs():
    parts = (
        building("a", box(0, 0, 10, 10), 12.0),
        building("b", box(10, 0, 22, 10), 20.0),
        building("tower", box(40, 0, 60, 29), 130.0),
        building("bay", box(70, 0, 79, 9), 9.0, bottom=4.0),
    )
    painted, plain = (build_city_mesh(replace(city_of(*parts), facades=kind)) for kind in ("painted", "plain"))
    assert np.array_equal(painted.positions, plain.positions)
    assert np.array_equal(painted.triangles, plain.triangles)
    assert np.array_equal(painted.colors, plain.colors)
    walls = np.abs(normals(plain)[:, 2]) < 0.5
    assert np.array_equal(painted.uv[painted.triangles[~walls]], plain.uv[plain.triangles[~walls]])
    for i in range(len(parts)):
        mine = walls & (np.arange(len(walls)) >= plain.object_triangles[i])
        mine &= np.arange(len(walls)) < plain.object_triangles[i + 1]
        (point,) = np.unique(plain.uv[plain.triangles[mine]].reshape(-1, 2), axis=0)
        style = int(np.argmin(np.abs(np.mean(blind_strip(np.arange(4)), axis=0) - point[1])))
        top, bottom = blind_strip(style)
        assert top < point[1] < bottom  # one colour, that of the wall without windows


def test_courtyards_stay_open():
    yard = Polygon(box(0, 0, 40, 40).exterior.coords, [box(10, 10, 30, 30).exterior.coords])
    mesh = build_city_mesh(city_of(building("a", yard, 20.0)))
    roof = corners(mesh)[normals(mesh)[:, 2] > 0.5]
    assert not any(Polygon(t[:, :2]).intersects(box(11, 11, 29, 29)) for t in roof)
    facing = normals(mesh)[np.all((corners(mesh)[..., :2] >= 10) & (corners(mesh)[..., :2] <= 30), axis=(1, 2))]
    assert {tuple(n) for n in np.round(facing[np.abs(facing[:, 2]) < 0.5]).astype(int)} == {
        (1, 0, 0),
        (-1, 0, 0),
        (0, 1, 0),
        (0, -1, 0),
    }


def test_light_comes_from_the_south_west_and_streets_are_darker():
    mesh = build_city_mesh(city_of(building("a", box(0, 0, 10, 10), 15.0)))
    up = normals(mesh)
    bright = mesh.colors[mesh.triangles].astype(float).mean(axis=(1, 2))
    by_side = {tuple(np.round(n[:2]).astype(int)): b for n, b in zip(up, bright, strict=True) if abs(n[2]) < 0.5}
    assert by_side[(0, -1)] > by_side[(-1, 0)] > by_side[(1, 0)] == by_side[(0, 1)]
    wall = mesh.uv[:, 1] <= storey_v(3, 0) + 1e-6
    low, high = (mesh.colors[wall & (mesh.positions[:, 2] == z)].astype(float).mean() for z in (0.0, 15.0))
    assert low < 0.85 * high


def test_looks_depend_on_the_object_alone():
    a, b = building("way/1", box(0, 0, 10, 10), 12.0), building("way/2", box(50, 50, 60, 61), 12.0)
    alone = build_city_mesh(city_of(a))
    both = mesh_of(build_city_mesh(city_of(b, a)), [1])
    for name in ("positions", "uv", "colors", "triangles"):
        assert np.array_equal(getattr(alone, name), getattr(both, name)), name
    many = build_city_mesh(city_of(*(building(f"way/{i}", box(i * 20, 0, i * 20 + 10, 10), 12.0) for i in range(60))))
    styles = {style_of(mesh_of(many, [i])) for i in range(60)}
    tints = {tuple(mesh_of(many, [i]).colors.max(axis=0)) for i in range(60)}
    assert len(styles) >= 3
    assert len(tints) >= 20


def test_tall_buildings_are_not_town_houses():
    many = build_city_mesh(city_of(*(building(f"way/{i}", box(i * 50, 0, i * 50 + 30, 30), 90.0) for i in range(40))))
    assert {style_of(mesh_of(many, [i])) for i in range(40)} == {1, 2, 3}


def test_mesh_of_gathers_objects_in_the_order_given():
    objects = [building(str(i), box(20 * i, 0, 20 * i + 5 + i, 10), 5.0 + 9 * i) for i in range(8)]
    whole = build_city_mesh(city_of(*objects))
    some = mesh_of(whole, [6, 2, 3])
    for place, i in enumerate([6, 2, 3]):
        mine = slice(some.object_triangles[place], some.object_triangles[place + 1])
        theirs = slice(whole.object_triangles[i], whole.object_triangles[i + 1])
        for name in ("positions", "uv", "colors"):
            got, expected = getattr(some, name)[some.triangles[mine]], getattr(whole, name)[whole.triangles[theirs]]
            assert np.array_equal(got, expected)
        owned = some.triangles[mine]
        assert some.object_vertices[place] <= owned.min() <= owned.max() < some.object_vertices[place + 1]
    assert some.texture is whole.texture
    assert mesh_of(whole, []).triangles.shape == (0, 3)
    assert np.array_equal(mesh_of(whole, np.arange(8)).triangles, whole.triangles)


def test_a_mesh_of_its_own_is_drawn_instead_of_the_prisms():
    vertices = np.array([[0, 0, 0], [6, 0, 0], [3, 5, 0], [3, 2, 8.0]])
    faces = np.array([[0, 1, 3], [1, 2, 3], [2, 0, 3], [1, 0, 2], [0, 0, 1]])  # the last has no area
    spire = CityObject(
        "spire", (Prism(Polygon([(0, 0), (6, 0), (3, 5)]), 0.0, 8.0),), TriangleMesh(vertices, faces.astype(np.int32))
    )
    mesh = build_city_mesh(city_of(building("a", box(20, 0, 30, 10), 9.0), spire))
    part = mesh_of(mesh, [1])
    assert part.positions.shape == (12, 3)
    assert np.array_equal(corners(part), vertices[faces[:4]].astype(np.float32))
    colors = part.colors.reshape(4, 3, 3)
    assert colors[0, 0].sum() > colors[1, 0].sum()  # south before north-east
    v = part.uv.reshape(4, 3, 2)[..., 1]
    # Walls have storeys from the object's foot on, two and a half of them.
    style = int(np.argmin(np.abs(v[0].max() - storey_v(np.arange(4), 0))))
    assert v[:3].max() == pytest.approx(storey_v(style, 0), abs=1e-6)
    assert v[:3].min() == pytest.approx(storey_v(style, 2), abs=1e-6)
    assert ((v[3] >= roof_strip(0)[0]) & (v[3] <= roof_strip(3)[1] + 1e-6)).all()


def test_texture_coordinates_of_roofs_stay_in_their_strip():
    mesh = build_city_mesh(city_of(*(building(str(i), box(0, 0, 3 + 40 * i, 200 - 30 * i), 10.0) for i in range(6))))
    roof = mesh.triangles[normals(mesh)[:, 2] > 0.5]
    v = mesh.uv[roof][..., 1]
    top, bottom = roof_strip(np.arange(4))
    inside = (v[..., None] >= top - 1e-6) & (v[..., None] <= bottom + 1e-6)
    assert inside.all(axis=1).any(axis=1).all()


def test_an_empty_city_has_an_empty_mesh():
    mesh = build_city_mesh(city_of())
    assert mesh.positions.shape == (0, 3)
    assert mesh.triangle_counts.shape == (0,)


def test_triangulation_fills_the_polygon():
    polygon = Polygon([(0, 0), (9, 0), (9, 9), (5, 4), (0, 9)], [[(1, 1), (2, 1), (2, 2)], [(6, 1), (7, 1), (7, 2)]])
    polygons = [box(20, 0, 30, 10), polygon, polygon.reverse(), box(-5, 0, -1, 1e5)]
    points, triangles, of = triangulate(polygons)
    assert of.tolist() == sorted(of.tolist())
    assert (of[triangles] == of[triangles[:, :1]]).all()
    for i, one in enumerate(polygons):
        parts = [Polygon(points[t]) for t in triangles[of[triangles[:, 0]] == i]]
        assert all(part.exterior.is_ccw for part in parts)
        assert shapely.union_all(parts).symmetric_difference(one).area == pytest.approx(0.0, abs=1e-9)
        assert sum(part.area for part in parts) == pytest.approx(one.area)


def test_triangulating_nothing():
    assert [len(one) for one in triangulate([])] == [0, 0, 0]


def test_wrong_offsets_are_refused():
    mesh = build_city_mesh(city_of(building("a", box(0, 0, 5, 5), 5.0)))
    with pytest.raises(ValueError, match="offsets end at"):
        CityMesh(
            mesh.positions, mesh.uv, mesh.colors, mesh.triangles, np.array([0, 3]), mesh.object_triangles, mesh.texture
        )
    with pytest.raises(ValueError, match="needs"):
        CityMesh(
            mesh.positions,
            mesh.uv[:-1],
            mesh.colors,
            mesh.triangles,
            mesh.object_vertices,
            mesh.object_triangles,
            mesh.texture,
        )


def test_a_real_district_is_whole():
    path = real("paris_9e/derived_buildings.geojson")
    objects: dict[str, CityObject] = {}
    for feature in json.loads(path.read_text())["features"]:
        polygons = shapely.get_parts(shapely.make_valid(shape(feature["geometry"])))
        polygons = [
            shapely.transform(p, lambda xy: xy - (452300.0, 5414000.0)) for p in polygons if p.geom_type == "Polygon"
        ]
        if polygons:
            name, top = feature["properties"]["osm_id"], float(feature["properties"]["height_m"] or 18.0)
            objects[name] = CityObject(name, tuple(Prism(p, 0.0, top) for p in polygons))
    mesh = build_city_mesh(city_of(*objects.values()))
    assert len(mesh.triangle_counts) == len(objects) > 700
    for i, one in enumerate(objects.values()):
        expected = sum(prism.footprint.area * prism.top for prism in one.prisms)
        assert volume(mesh_of(mesh, [i])) == pytest.approx(expected, rel=2e-3, abs=1.0), one.id


def test_triangles_of_some_objects_are_those_of_their_own_meshes():
    mesh = build_city_mesh(crossroads())
    for chosen in ([3], [7, 2, 2], []):
        corners = mesh.positions[triangles_of(mesh, chosen)]
        part = mesh_of(mesh, chosen)
        assert np.array_equal(corners, part.positions[part.triangles])
