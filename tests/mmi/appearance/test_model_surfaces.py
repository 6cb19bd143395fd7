"""What meshes look like when they are drawn: pictures upright and not mirrored, plain colours, painted walls."""

from __future__ import annotations

import math
from dataclasses import replace

import networkx as nx
import numpy as np
import pytest
from cities import block
from model_cities import BOX_TRIANGLES, box_corners, model_city
from shapely.geometry import box

from mmi.appearance.city_mesh import build_city_mesh, mesh_of
from mmi.appearance.facades import BAY, BAYS, ROWS, STOREY, blind_strip, roof_strip, storey_v
from mmi.appearance.shading import light
from mmi.capture.renderer import Capturer
from mmi.city.model import PAINTED, PLAIN, City, CityObject, Prism, Texture, TriangleMesh
from mmi.foundation.camera import level_view, view_towards

NORTH = np.array([[0.0, 1.0, 0.0]])
SOUTH = -NORTH
UP = np.array([[0.0, 0.0, 1.0]])


def city_of(*objects, textures=()):
    return City(objects, nx.MultiGraph(), "EPSG:32631", (0.0, 0.0, 0.0), "test", textures=textures)


def quad(corners, uv, *, texture=0, color=(255, 255, 255)):
    """A mesh of two triangles: ``corners`` (4, 3) counter-clockwise, ``uv`` (4, 2)."""
    halves = np.array([[0, 1, 2], [0, 2, 3]])
    uv = None if uv is None else np.array(uv, dtype=float)[halves]
    return TriangleMesh(np.array(corners, dtype=float), halves, [texture] * 2, [color] * 2, uv)


def wall(uv, **options):
    """10 x 10 m, 20 m north of the origin, facing it: the lower left corner first."""
    return quad([(-5, 20, 0), (5, 20, 0), (5, 20, 10), (-5, 20, 10)], uv, **options)


def object_of(mesh, name="mesh"):
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    return CityObject(name, (Prism(box(*(low[:2] - 0.1), *(high[:2] + 0.1)), low[2], high[2] + 0.1),), mesh)


def four_fields(side=64):
    """Red upper left, green upper right, blue lower left, white lower right."""
    image = np.full((side, side, 3), 255, dtype=np.uint8)
    half = side // 2
    image[:half, :half], image[:half, half:], image[half:, :half] = (200, 0, 0), (0, 200, 0), (0, 0, 200)
    return Texture("fields", image)


def seen(city, *, eye=(0.0, 0.0, 5.0), azimuth=0.5 * math.pi, pitch=None):
    """A picture of 100 x 100 pixels, 10 a metre at 20 m, from the origin to the north."""
    options = {"focal": 200.0, "window": (-50, -50, 100, 100)}
    at = np.array(eye)
    view = level_view(at, azimuth, **options) if pitch is None else view_towards(at, azimuth, pitch, **options)
    with Capturer(build_city_mesh(city)) as capturer:
        return capturer.depth_textures(np.arange(len(city.objects)), [view])[0]


def fields_of(texture):
    """Colours in the middle of the four quarters: upper left, upper right, lower left, lower right."""
    return np.array([texture.color[row, column] for row in (25, 75) for column in (25, 75)]).astype(float)


UNIT = [(0, 0), (1, 0), (1, 1), (0, 1)]
FIELDS = np.array([(200, 0, 0), (0, 200, 0), (0, 0, 200), (255, 255, 255)], dtype=float)


def test_a_picture_on_a_wall_is_upright_and_not_mirrored():
    texture = seen(city_of(object_of(wall(UNIT)), textures=(four_fields(),)))
    assert (texture.object_ids == 0).all()
    assert fields_of(texture) == pytest.approx(FIELDS * (0.5 + 0.5 * light(SOUTH)), abs=1.5)


def test_pictures_have_half_of_the_light_and_the_tint_of_their_triangles():
    city = city_of(object_of(wall(UNIT, color=(255, 128, 51))), textures=(four_fields(),))
    expected = FIELDS * (0.5 + 0.5 * light(SOUTH)) * np.array([1.0, 128 / 255, 0.2])
    assert fields_of(seen(city)) == pytest.approx(expected, abs=2.0)


def test_plain_triangles_have_their_own_colour_in_the_light():
    """Whatever pictures and paintings there are beside them."""
    mesh = wall(None, texture=PLAIN, color=(180, 90, 30))
    for more in ((), (block("house", 100, 100, 110, 110, 9.0),)):
        for textures in ((), (four_fields(),)):
            texture = seen(city_of(object_of(mesh), *more, textures=textures))
            assert (texture.object_ids == 0).all()
            assert texture.color.reshape(-1, 3).astype(float) == pytest.approx(
                np.tile(np.array([180, 90, 30]) * light(SOUTH), (10_000, 1)), abs=1.0
            )


@pytest.mark.parametrize("shift", [(0, 0), (3, -7), (-40, 100)])
def test_pictures_repeat(shift):
    """A quad of two and a half by one and a half pictures, from anywhere in the plane of textures."""
    low = np.array(shift, dtype=float)
    uv = low + np.array([(0, 0), (2.5, 0), (2.5, 1.5), (0, 1.5)])
    texture = seen(city_of(object_of(wall(uv)), textures=(four_fields(128),)))
    row, column = np.mgrid[2:100, 1:100] + 0.5
    u, v = 2.5 * column / 100 % 1.0, 1.5 * (1.0 - row / 100) % 1.0
    expected = FIELDS[np.where(v > 0.5, 0, 2) + (u > 0.5)] * (0.5 + 0.5 * light(SOUTH))
    away = np.minimum(np.abs(2 * u - np.round(2 * u)), np.abs(2 * v - np.round(2 * v)))  # from where colours change
    shown = texture.color[2:, 1:].astype(float)
    assert np.abs(shown - expected).max(axis=2)[away > 0.15].max() < 8.0
    assert (away > 0.15).mean() > 0.3


def test_repeated_more_often_than_copies_have_room_it_is_cut_and_looks_the_same():
    """1000 texels stand once in the atlas: nine repetitions a side are cut."""
    mesh = wall([(0.25, 0.5), (9.25, 0.5), (9.25, 9.5), (0.25, 9.5)])
    city = city_of(object_of(mesh), textures=(four_fields(1000),))
    built = build_city_mesh(city)
    assert built.triangle_counts[0] > 100
    corners = built.positions[built.triangles].astype(float)
    edges = corners[:, 1:] - corners[:, :1]
    assert 0.5 * np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1).sum() == pytest.approx(100.0)
    texture = seen(city)
    assert (texture.object_ids == 0).all()
    assert texture.depth == pytest.approx(20.0, abs=1e-3)
    row, column = np.mgrid[:100, :100] + 0.5
    u, v = (0.25 + 0.09 * column) % 1.0, (0.5 + 9.0 - 0.09 * row) % 1.0
    expected = FIELDS[np.where(v > 0.5, 0, 2) + (u > 0.5)] * (0.5 + 0.5 * light(SOUTH))
    away = np.minimum(np.abs(2 * u - np.round(2 * u)), np.abs(2 * v - np.round(2 * v)))
    inner = away > 0.3
    assert np.median(np.abs(texture.color - expected).max(axis=2)[inner]) < 10.0
    assert np.quantile(np.abs(texture.color - expected).max(axis=2)[inner], 0.97) < 40.0


def test_a_roof_seen_from_above_has_its_picture_the_way_it_is_put_on():
    """u to the east, v to the north; from above and looking north, east is right and north is up."""
    roof = quad([(-5, 15, 0), (5, 15, 0), (5, 25, 0), (-5, 25, 0)], UNIT)
    texture = seen(city_of(object_of(roof), textures=(four_fields(),)), eye=(0.0, 0.0, 20.0), pitch=-math.pi / 4)
    colors = texture.color[[40, 40, 60, 60], [40, 60, 40, 60]].astype(float)
    assert colors == pytest.approx(FIELDS * (0.5 + 0.5 * light(UP)), abs=2.0)


def test_every_object_gets_its_own_pictures():
    city = model_city()
    mesh = build_city_mesh(city)
    assert len(mesh.triangle_counts) == len(city.objects)
    for i, one in enumerate(city.objects):
        part = mesh_of(mesh, [i])
        corners = part.positions[part.triangles].astype(float)
        if one.mesh is None:
            continue
        edges = corners[:, 1:] - corners[:, :1]
        area = 0.5 * np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1).sum()
        own = one.mesh.vertices[one.mesh.triangles]
        sides = own[:, 1:] - own[:, :1]
        assert area == pytest.approx(0.5 * np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1).sum(), rel=1e-5)
    rows, columns = mesh.texture.shape[:2]
    part = mesh_of(mesh, [3])  # plain red: all of it shows the white patch
    texels = mesh.texture[(part.uv[:, 1] * rows).astype(int), (part.uv[:, 0] * columns).astype(int)]
    assert (texels == 255).all()


# Painted


def painted_house(x0=0.0, y0=0.0, *, wide=12.8, deep=9.6, tall=12.8, foot=0.0, digits=None):
    corners = box_corners(x0, y0, foot, x0 + wide, y0 + deep, foot + tall)
    corners = corners if digits is None else np.round(corners, digits)
    return TriangleMesh(corners, BOX_TRIANGLES)


def gradients(mesh):
    """Of each triangle: its unit normal, and how uv changes a metre to the right and a metre up, seen from outside."""
    corners = mesh.positions[mesh.triangles].astype(float)
    uv = mesh.uv[mesh.triangles].astype(float)
    edges = corners[:, 1:] - corners[:, :1]
    normal = np.cross(edges[:, 0], edges[:, 1])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    for n, step, change in zip(normal, edges, uv[:, 1:] - uv[:, :1], strict=True):
        right = np.cross([0.0, 0.0, 1.0], n)
        if abs(n[2]) < 0.5:
            yield n, *np.linalg.solve(np.column_stack([step @ right, step[:, 2]]), change)


@pytest.mark.parametrize("textures", [(), (four_fields(),)])
@pytest.mark.parametrize("foot", [0.0, 37.5])
def test_painted_walls_have_storeys_upright(textures, foot):
    """Four storeys of 3.2 m from the house's foot on, bays of 3.2 m, also in an atlas with pictures."""
    pictured = (object_of(wall(UNIT)),) if textures else ()
    house = object_of(painted_house(foot=foot), "house")
    city = city_of(house, *pictured, textures=textures)
    whole = build_city_mesh(city)
    part = mesh_of(whole, [0])
    scale = np.array([512.0, 4096.0]) / whole.texture.shape[1::-1]
    walls = list(gradients(part))
    assert len(walls) == 8
    row = float(storey_v(0, 0) - storey_v(0, 1))
    for _, to_the_right, up in walls:
        assert to_the_right / scale == pytest.approx([1.0 / (BAYS * BAY), 0.0], abs=1e-4)
        assert up / scale == pytest.approx([0.0, -row / STOREY], abs=1e-4)
    v = part.uv[part.triangles][..., 1].astype(float) / scale[1]
    z = part.positions[part.triangles][..., 2]
    steep = np.ptp(z, axis=1) > 0
    style = int(np.argmin(np.abs(v[steep].max() - storey_v(np.arange(4), 0))))
    assert v[steep][z[steep] == foot] == pytest.approx(float(storey_v(style, 0)), abs=1e-5)
    assert v[steep][z[steep] > foot] == pytest.approx(float(storey_v(style, 4)), abs=1e-5)
    low, high = roof_strip(np.arange(4))
    assert ((v[~steep][..., None] >= low - 1e-5) & (v[~steep][..., None] <= high + 1e-5)).all(axis=1).any(axis=1).all()


def test_the_two_halves_of_a_wall_fit_together_far_from_the_origin():
    """Corners rounded to millimetres turn the halves of a wall a little; windows must not jump where they meet."""
    turn = math.radians(33.0)
    c, s = math.cos(turn), math.sin(turn)
    plain = painted_house(0.0, 0.0, wide=7.0, tall=300.0)
    turned = plain.vertices @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) + [8000.0, -6000.0, 0.0]
    leaning = np.round(turned + np.random.default_rng(3).uniform(-0.01, 0.01, turned.shape), 3)
    mesh = build_city_mesh(city_of(object_of(TriangleMesh(leaning, BOX_TRIANGLES))))
    corners = {}
    for triangle in range(4, 12):
        side = triangle // 2
        for point, uv in zip(mesh.positions[3 * triangle :][:3].tolist(), mesh.uv[3 * triangle :][:3], strict=True):
            corners.setdefault((side, *point), []).append(uv)
    shared = [uvs for uvs in corners.values() if len(uvs) == 2]
    assert len(shared) == 8
    for one, other in shared:
        assert np.abs((one - other) * (512.0, 4096.0)).max() < 1.0  # texels


def test_a_tower_of_more_storeys_than_the_texture_has_stretches_them():
    mesh = build_city_mesh(city_of(object_of(painted_house(tall=96.0))))
    steep = np.ptp(mesh.positions[mesh.triangles][..., 2], axis=1) > 0
    v = mesh.uv[mesh.triangles][steep][..., 1]
    style = int(np.argmin(np.abs(v.max() - storey_v(np.arange(4), 0))))
    assert v.min() == pytest.approx(float(storey_v(style, ROWS)), abs=1e-5)


def test_narrow_painted_walls_have_no_windows():
    mesh = build_city_mesh(city_of(object_of(painted_house(deep=1.0))))
    corners = mesh.positions[mesh.triangles]
    narrow = (np.ptp(corners[..., 0], axis=1) == 0) & (np.ptp(corners[..., 2], axis=1) > 0)
    assert narrow.sum() == 4
    v = mesh.uv[mesh.triangles][narrow][..., 1]
    low, high = blind_strip(np.arange(4))
    assert ((v[..., None] >= low - 1e-6) & (v[..., None] <= high + 1e-6)).all(axis=(0, 1)).sum() == 1


def test_the_same_house_looks_the_same_with_and_without_pictures_elsewhere():
    """Painted walls and houses of prisms, captured: the atlas of pictures shows what the facades alone show."""
    house = CityObject("painted", (Prism(box(-6, 20, -0.2, 28), 0.0, 9.7),), painted_house(-6.0, 20.0, wide=5.8))
    prism = block("prism", 0.2, 20.0, 6.0, 28.0, 9.6)
    picture = object_of(quad([(900, 0, 0), (910, 0, 0), (910, 0, 9), (900, 0, 9)], UNIT), "far away")
    alone = seen(city_of(house, prism))
    both = seen(city_of(house, prism, picture, textures=(four_fields(),)))
    assert np.array_equal(alone.object_ids, both.object_ids)
    difference = np.abs(alone.color.astype(int) - both.color)[alone.object_ids >= 0]
    assert np.quantile(difference, 0.99) <= 6


def test_only_what_refers_to_it_changes_with_a_texture():
    painted = object_of(TriangleMesh(box_corners(0, 0, 0, 9, 9, 9), BOX_TRIANGLES, np.full(12, PAINTED)))
    assert build_city_mesh(city_of(painted, textures=(four_fields(),))).texture.shape == (4096, 512, 3)


def test_plain_facades_leave_pictures_and_colours_alone():
    city = model_city()
    painted, plain = (build_city_mesh(replace(city, facades=kind)) for kind in ("painted", "plain"))
    assert np.array_equal(painted.positions, plain.positions)
    differ = (painted.uv != plain.uv).any(axis=1)
    rows = np.repeat(np.arange(len(city.objects)), np.diff(plain.object_vertices))
    has_own = [one.mesh is not None and not (one.mesh.textures == PAINTED).any() for one in city.objects]
    assert any(has_own)
    assert not differ[np.array(has_own)[rows]].any()
    invented = [i for i, one in enumerate(city.objects) if one.mesh is None or (one.mesh.textures == PAINTED).any()]
    assert {0, 1} <= set(rows[differ].tolist()) <= set(invented)


def test_a_plain_wall_of_a_mesh_is_of_one_calm_colour():
    corners = [(-5, 20, 0), (5, 20, 0), (5, 20, 10), (-5, 20, 10)]
    mesh = quad(corners, None, texture=PAINTED)
    city = city_of(object_of(mesh))
    images = [seen(replace(city, facades=kind)).color.astype(float) for kind in ("painted", "plain")]
    middle = [image[10:90, 10:90, :3].reshape(-1, 3) for image in images]
    assert middle[0].std(axis=0).max() > 20.0  # windows
    assert middle[1].std(axis=0).max() < 12.0  # the shade at its foot, and rain
