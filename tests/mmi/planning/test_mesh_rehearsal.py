"""What layers of detailed meshes will be found to miss, against rays cast at all triangles by brute force."""

import math

import numpy as np
import pytest
from cities import cell_along_x, city_of
from hills import _cast, terraces, triangles_of_object, triangles_of_prism
from shapely.geometry import box

from mmi.appearance.city_mesh import build_city_mesh
from mmi.cells.viewing_cells import viewing_cells
from mmi.city.model import CityObject, Prism, TriangleMesh
from mmi.foundation.thickness import thickness
from mmi.planning.mesh_rehearsal import rehearse_meshes
from mmi.planning.parameters import BuildParameters
from mmi.planning.plan import plan_cell, prepare_city
from mmi.visibility.visible_walls import around

PIXEL = 0.012
CELL = cell_along_x(40.0, 3.0)


def meshed(name, hull, *solids):
    """An object within the prism ``hull`` that is drawn as the prisms ``solids``."""
    corners = np.concatenate([triangles_of_prism(one) for one in solids])
    mesh = TriangleMesh(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3))
    return CityObject(name, (hull,), mesh)


def fork(name, x0, y0):
    """A comb of a house: wings run away from a front that hides them, inside one simple prism."""
    hull = Prism(box(x0, y0, x0 + 20.0, y0 + 30.0), 0.0, 15.0)
    front = Prism(box(x0, y0, x0 + 12.0, y0 + 2.0), 0.0, 15.0)
    tower = Prism(box(x0 + 6.0, y0 + 26.0, x0 + 20.0, y0 + 30.0), 0.0, 15.0)
    return meshed(name, hull, front, tower)


def rehearsed(city, layers, limit, cell=CELL):
    return rehearse_meshes(
        cell, build_city_mesh(city), np.arange(len(city.objects)), layers, pixel=(PIXEL, PIXEL), limit=limit
    )


class Rays:
    """Casts at the triangles of some objects; names them by their place among those of the city's mesh."""

    def __init__(self, mesh, objects):
        ranges = [np.arange(*mesh.object_triangles[i : i + 2]) for i in objects]
        self.names = np.concatenate([np.empty(0, dtype=np.int64), *ranges])
        self.corners = mesh.positions[mesh.triangles[self.names]].astype(float)
        middle = self.corners.mean(axis=1)
        reach = np.linalg.norm(self.corners - middle[:, None], axis=2).max(axis=1)
        self.spheres = np.column_stack([middle, reach])

    def cast(self, eye, rays):
        origins = np.ascontiguousarray(np.broadcast_to(eye, rays.shape))
        starts = np.arange(len(self.names) + 1)
        return _cast(origins, np.ascontiguousarray(rays), self.corners, starts, self.spheres, self.names)


def missed(city, layers, eye, cell, rows):
    """(columns, rows) bool: what layers miss from ``eye``, told slowly and plainly."""
    mesh = build_city_mesh(city)
    owner = np.repeat(np.arange(len(city.objects)), mesh.triangle_counts)
    corners = mesh.positions[mesh.triangles].astype(float)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    columns = math.ceil(2.0 * math.pi / PIXEL)
    turn = 2.0 * math.pi / columns

    def rays_at(c, r):
        return np.stack([np.cos((c + 0.5) * turn), np.sin((c + 0.5) * turn), (r + 0.5) * PIXEL], axis=-1)

    c, r = (one.ravel() for one in np.meshgrid(np.arange(columns), np.arange(*rows), indexing="ij"))
    rays = rays_at(c, r)
    far, triangle = Rays(mesh, range(len(city.objects))).cast(eye, rays)
    lost = np.zeros(len(rays), dtype=bool)
    for members in layers:
        capture = Rays(mesh, members)
        index = np.flatnonzero((triangle >= 0) & np.isin(owner[triangle], members))
        offset = far[index, None] * rays[index]
        point = eye + offset - cell.reference
        away = np.linalg.norm(offset, axis=1)
        column = np.floor(np.arctan2(point[:, 1], point[:, 0]) / turn)
        row = np.floor(point[:, 2] / np.hypot(*point[:, :2].T) / PIXEL)
        has = np.zeros(len(index), dtype=bool)
        for dc in (-1, 0, 1):
            for dr in (-1, 0, 1):
                texels = rays_at(column + dc, row + dr)
                depth, other = capture.cast(cell.reference, texels)
                hit = other >= 0
                step = np.where(hit, depth, 0.0)[:, None] * texels - point
                mine = normals[triangle[index]]
                flat = np.abs((mine * normals[other]).sum(axis=1)) >= 0.98
                flat &= np.abs((mine * step).sum(axis=1)) <= away * turn
                along = (step * offset).sum(axis=1) / away
                across = np.sqrt(np.maximum((step**2).sum(axis=1) - along**2, 0.0))
                close = across <= turn * np.maximum(away + along, 0.0)
                has |= hit & ((other == triangle[index]) | ((owner[other] == owner[triangle[index]]) & (flat | close)))
        lost[index] = ~has
    return lost.reshape(columns, -1)


def thickest(city, layers, cell=CELL):
    """The thickest region from all viewpoints that are rehearsed; where nothing is missed, the seam of the picture is."""
    found = 0.0
    for spot in around(cell.corners, 8):
        for height in cell.eye:
            region = missed(city, layers, np.array([*spot, height]), cell, (-40, 80))
            free = np.flatnonzero(~region.any(axis=1))
            found = max(found, thickness(np.roll(region, -int(free[0]), axis=0)))
    return found


@pytest.mark.parametrize("places", [[(-6.0, 30.0)], [(-10.0, -62.0), (-4.0, 40.0)]])
def test_what_is_missed_is_what_rays_tell(places):
    city = city_of(*(fork(f"fork/{i}", *place) for i, place in enumerate(places)))
    layers = (np.arange(len(city.objects)),)
    true = thickest(city, layers)
    assert true > 4.0
    found = rehearsed(city, layers, 1.2 * true)
    assert found.demoted.size == 0
    assert found.thickness == pytest.approx(true, abs=0.5)
    found = rehearsed(city, layers, 0.9 * true)
    assert found.demoted.size
    left = (np.setdiff1d(layers[0], found.demoted),)
    assert thickest(city, left) <= max(0.9 * true, 0.0) + 0.5


def test_a_solid_block_is_all_in_its_picture():
    hull = Prism(box(40.0, 20.0, 60.0, 50.0), 0.0, 15.0)
    city = city_of(meshed("block", hull, hull))
    found = rehearsed(city, (np.array([0]),), 8.0)
    assert found.demoted.size == 0 and found.thickness == 6.0


def test_what_others_hide_is_not_missed():
    """A wall before the comb, of the near objects: what the comb's layer misses behind it does not matter."""
    wall = Prism(box(-100.0, 8.0, 100.0, 9.0), 0.0, 40.0)
    city = city_of(fork("fork", -6.0, 30.0), CityObject("wall", (wall,)))
    assert rehearsed(city, (np.array([0]),), 2.0).demoted.size == 0
    assert rehearsed(city_of(fork("fork", -6.0, 30.0)), (np.array([0]),), 2.0).demoted.tolist() == [0]


def test_what_hides_another_of_its_layer_shows_it_again_when_it_is_near():
    """Two plates, one before the other: one of them near is enough, or each in a layer of its own."""
    front = Prism(box(-6.0, 30.0, 6.0, 31.0), 0.0, 12.0)
    back = Prism(box(-8.0, 60.0, 8.0, 61.0), 0.0, 12.0)
    city = city_of(meshed("front", front, front), meshed("back", back, back))
    assert rehearsed(city, (np.array([0]), np.array([1])), 2.0).demoted.size == 0
    assert rehearsed(city, (np.array([0, 1]),), 2.0).demoted.tolist() == [1]


def test_no_far_objects_miss_nothing():
    city = city_of(fork("fork", -6.0, 30.0))
    found = rehearsed(city, (), 5.0)
    assert found.demoted.size == 0 and found.thickness == 0.0


def test_a_plan_with_meshes_in_sight_is_rehearsed_with_them():
    """A house under a pitched roof 9 m from the reference: much of its roof is hidden from there by its eaves."""
    city = terraces(1)
    cell = viewing_cells(city).nodes["0000-05"]["cell"]
    assert any(len(triangles_of_object(one)) for one in city.objects if one.mesh is not None)
    plan = plan_cell(prepare_city(city, BuildParameters(max_error_px=2.0, near_distance=4.0)), cell)
    assert plan.detailed
    assert plan.missed is not None and plan.missed <= 2.0
