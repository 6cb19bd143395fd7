"""Ground: a plane comes back as that plane from triangles, points and rasters, and spikes, gaps and nonsense do no harm."""

from __future__ import annotations

import numpy as np
import pytest
import rasterio
import shapely
from cities import real
from city_files import geojson
from hypothesis import given, settings
from hypothesis import strategies as st

from mmi.city.model import TriangleMesh
from mmi.foundation.errors import CityError
from mmi.reading.ground.ground import ground_of_model
from mmi.reading.ground.relief import (
    VOID,
    choose_spacing,
    read_relief_points,
    terrain_from_points,
    terrain_from_triangles,
)
from mmi.reading.report import Ledger

BOUNDS = (100.0, 200.0, 223.0, 290.0)


def plane(at):
    at = np.asarray(at)
    return 5.0 + 0.1 * at[..., 0] - 0.2 * at[..., 1]


def inside(n=200, seed=1):
    rng = np.random.default_rng(seed)
    return rng.uniform(BOUNDS[:2], BOUNDS[2:], (n, 2))


def with_plane(xy):
    return np.column_stack([xy, plane(xy)])


def test_spacing_is_5_m_or_what_512_squares_need():
    assert choose_spacing((0.0, 0.0, 300.0, 2000.0)) == 5.0
    assert choose_spacing((0.0, 0.0, 300.0, 5120.0)) == 10.0


@pytest.mark.parametrize("spacing", [5.0, 7.3, 200.0])
def test_triangles_of_a_plane_are_that_plane(spacing):
    corners = with_plane(np.array([(0.0, 0.0), (700.0, 0.0), (700.0, 700.0), (0.0, 700.0)]))
    terrain = terrain_from_triangles(corners, [(0, 1, 2), (2, 0, 3)], bounds=BOUNDS, spacing=spacing)
    x0, y0, x1, y1 = terrain.bounds
    assert (x0, y0) == BOUNDS[:2]
    assert x1 >= BOUNDS[2] > x1 - spacing
    assert y1 >= BOUNDS[3] > y1 - spacing
    at = inside()
    np.testing.assert_allclose(terrain.at(at), plane(at), atol=1e-8)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6))
def test_a_fine_surface_of_a_plane_is_that_plane_whichever_way_triangles_are_wound(seed):
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.linspace(90, 240, 21), np.linspace(190, 300, 19))
    xy = np.column_stack([x.ravel(), y.ravel()]) + rng.uniform(-1.5, 1.5, (x.size, 2))
    q = (np.arange(18)[:, None] * 21 + np.arange(20)).ravel()
    triangles = np.concatenate([np.column_stack([q, q + 1, q + 21]), np.column_stack([q + 1, q + 22, q + 21])])
    triangles = rng.permutation(triangles)
    triangles[::2] = triangles[::2, ::-1]
    terrain = terrain_from_triangles(with_plane(xy), triangles, bounds=BOUNDS, spacing=5.0)
    at = inside()
    np.testing.assert_allclose(terrain.at(at), plane(at), atol=1e-8)


def test_the_topmost_triangle_counts_and_holes_take_the_nearest_height():
    low = [(100, 200, 1), (300, 200, 1), (300, 400, 1), (100, 400, 1)]
    high = [(150, 220, 9), (190, 220, 9), (190, 260, 9), (150, 260, 9)]
    faces = [(0, 1, 2), (0, 2, 3), (4, 5, 6), (4, 6, 7)]
    terrain = terrain_from_triangles(low + high, faces, bounds=BOUNDS, spacing=5.0)
    assert terrain.at((170.0, 240.0)) == 9.0
    assert terrain.at((120.0, 280.0)) == 1.0
    alone = terrain_from_triangles(low + high, faces[2:], bounds=BOUNDS, spacing=5.0)
    assert (alone.heights == 9.0).all()
    tiny = terrain_from_triangles(
        [(101, 201, 3), (102, 201, 3), (101, 202, 3)], [(0, 1, 2)], bounds=BOUNDS, spacing=5.0
    )
    assert (tiny.heights == 3.0).all()
    with pytest.raises(CityError, match="triangles"):
        terrain_from_triangles(low, np.empty((0, 3), int), bounds=BOUNDS, spacing=5.0)
    with pytest.raises(CityError, match="bounds"):
        terrain_from_triangles(low, faces[:2], bounds=(1, 1, 1, 2), spacing=5.0)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10**6))
def test_points_of_a_plane_are_that_plane(seed):
    rng = np.random.default_rng(seed)
    xy = rng.uniform((50.0, 150.0), (280.0, 350.0), (400, 2))
    around = [(50.0, 150.0), (280.0, 150.0), (280.0, 350.0), (50.0, 350.0)]
    terrain, spikes = terrain_from_points(with_plane(np.concatenate([xy, around])), bounds=BOUNDS, spacing=5.0)
    at = inside()
    np.testing.assert_allclose(terrain.at(at), plane(at), atol=1e-6)
    assert spikes == 0


def test_very_many_points_of_a_plane_are_nearly_that_plane():
    rng = np.random.default_rng(5)
    xy = rng.uniform(BOUNDS[:2], BOUNDS[2:], (300_000, 2))
    terrain, spikes = terrain_from_points(with_plane(xy), bounds=BOUNDS, spacing=5.0)
    at = inside()
    np.testing.assert_allclose(terrain.at(at), plane(at), atol=0.05)
    assert spikes == 0


def test_spikes_are_dropped_and_counted_and_hills_are_not():
    x, y = np.meshgrid(np.arange(90.0, 240.0, 6.0), np.arange(190.0, 300.0, 6.0))
    hill = 25.0 * np.exp(-((x - 160) ** 2 + (y - 245) ** 2) / 900.0)
    points = np.column_stack([x.ravel(), y.ravel(), hill.ravel()])
    assert terrain_from_points(points, bounds=BOUNDS, spacing=5.0)[1] == 0
    spoilt = points.copy()
    spoilt[[40, 200, 333], 2] += (80.0, -300.0, 5000.0)
    terrain, spikes = terrain_from_points(spoilt, bounds=BOUNDS, spacing=5.0)
    assert spikes == 3
    clean, _ = terrain_from_points(points, bounds=BOUNDS, spacing=5.0)
    assert np.abs(terrain.heights - clean.heights).max() < 4.0


def test_few_points_points_on_a_line_and_no_points():
    terrain, _ = terrain_from_points([(150.0, 240.0, 7.0)], bounds=BOUNDS, spacing=5.0)
    assert (terrain.heights == 7.0).all()
    line = np.column_stack([np.linspace(100, 220, 9), np.full(9, 240.0), np.arange(9.0)])
    terrain, _ = terrain_from_points(line, bounds=BOUNDS, spacing=5.0)
    assert terrain.at((220.0, 205.0)) == 8.0
    with pytest.raises(CityError, match="points"):
        terrain_from_points([(np.nan, 0.0, 0.0)], bounds=BOUNDS, spacing=5.0)


def test_heights_come_from_z_or_from_a_column(tmp_path):
    at = [(100.0, 200.0), (110.0, 200.0), (100.0, 210.0)]
    column = [(shapely.Point(x, y), {"Id": 7, "ELEVATION": 10.0 + i}) for i, (x, y) in enumerate(at)]
    points, crs = read_relief_points(geojson(tmp_path / "c.geojson", column, crs="EPSG:32632"), Ledger())
    assert points.tolist() == [[100.0, 200.0, 10.0], [110.0, 200.0, 11.0], [100.0, 210.0, 12.0]]
    assert crs is not None
    assert crs.to_epsg() == 32632
    own = [(shapely.Point(x, y, 5.0), {"height": 1.0}) for x, y in at]
    points, _ = read_relief_points(geojson(tmp_path / "z.geojson", own, crs="EPSG:32632"), Ledger())
    assert (points[:, 2] == 5.0).all()


def test_contour_lines_give_their_corners(tmp_path):
    lines = [(shapely.LineString([(0, h), (50, h), (100, h)]), {"elev": float(h)}) for h in (10, 20)]
    points, _ = read_relief_points(geojson(tmp_path / "c.geojson", lines, crs="EPSG:32632"), Ledger())
    assert points.shape == (6, 3)
    assert (points[:, 1] == points[:, 2]).all()


def raster(path, values, *, nodata=-9999.0, crs="EPSG:32632", unit=None):
    transform = rasterio.Affine(10.0, 0.0, 500000.0, 0.0, -10.0, 5000000.0)
    profile = {"driver": "GTiff", "height": values.shape[0], "width": values.shape[1], "count": 1, "dtype": "float32"}
    with rasterio.open(path, "w", **profile, crs=crs, transform=transform, nodata=nodata) as file:
        file.write(values.astype("float32"), 1)
        if unit is not None:
            file.units = [unit]
    return path


def test_a_raster_gives_the_middles_of_its_cells_without_nodata(tmp_path):
    values = np.arange(12.0).reshape(3, 4)
    values[0, 0] = -9999.0
    ledger = Ledger()
    points, crs = read_relief_points(raster(tmp_path / "r.tif", values), ledger)
    assert len(points) == 11
    assert points[0].tolist() == [500015.0, 4999995.0, 1.0]
    assert points[-1].tolist() == [500035.0, 4999975.0, 11.0]
    assert crs is not None
    assert crs.to_epsg() == 32632
    assert ledger.count("left out", "cell of the ground: no data") == 1


@pytest.mark.parametrize("void", [-9999.0, -32768.0, -3.4e38, 32767.0, 1e20])
def test_voids_without_a_declared_value_are_left_out(tmp_path, void):
    values = np.arange(12.0).reshape(3, 4)
    values[1, 2] = void
    ledger = Ledger()
    points, _ = read_relief_points(raster(tmp_path / "r.tif", values, nodata=None), ledger)
    assert sorted(points[:, 2].tolist()) == [0, 1, 2, 3, 4, 5, 7, 8, 9, 10, 11]
    assert ledger.count("left out", VOID.format("cell")) == ledger.count("left out") == 1
    at = [(shapely.Point(x, 0), {"height": h}) for x, h in enumerate((5.0, void, 6.0))]
    points, _ = read_relief_points(geojson(tmp_path / "c.geojson", at, crs="EPSG:32632"), ledger)
    assert points[:, 2].tolist() == [5.0, 6.0]
    assert ledger.count("left out", VOID.format("point")) == 1


@pytest.mark.parametrize("height", [-430.0, -1412.0, 8849.0, 29_032.0])
def test_the_lowest_and_the_highest_ground_are_no_voids(tmp_path, height):
    ledger = Ledger()
    points, _ = read_relief_points(raster(tmp_path / "r.tif", np.full((2, 2), height), nodata=None), ledger)
    assert (points[:, 2] == height).all()
    assert ledger.count("left out") == 0


@pytest.mark.parametrize("triangles", [True, False])
def test_voids_in_the_ground_of_a_model(triangles):
    """A slope of 10 %, in which one corner of the middle has no height."""
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(0.0, 101.0, 10.0), np.arange(0.0, 101.0, 10.0)))
    points = np.column_stack([x, y, 0.1 * x])
    points[60, 2] = -9999.0
    corners = np.array(
        [(i, i + 1, i + 12) for i in range(109) if i % 11 < 10]
        + [(i, i + 12, i + 11) for i in range(109) if i % 11 < 10]
    )
    mesh = TriangleMesh(points, corners if triangles else np.empty((0, 3), dtype=np.int32))
    ledger = Ledger()
    terrain = ground_of_model(mesh, lambda one: one, (0.0, 0.0, 100.0, 100.0), ledger)
    inside = np.array([(20.0, 20.0), (50.0, 50.0), (80.0, 20.0)])
    assert terrain.at(inside) == pytest.approx(0.1 * inside[:, 0], abs=1.0)
    assert ledger.count("left out", VOID.format("triangle" if triangles else "point")) == (6 if triangles else 1)


@pytest.mark.parametrize(
    ("crs", "unit", "told", "metres"),
    [
        ("EPSG:32632", None, None, 100.0),
        ("EPSG:32632", None, "ft", 30.48),
        ("EPSG:32632", "m", None, 100.0),
        ("EPSG:32632", "ft", None, 30.48),
        ("EPSG:32632", "US survey foot", None, 30.48),
        ("EPSG:32632", "feet", "m", 100.0),
        ("EPSG:2263+6360", None, None, 30.48),  # plan and heights in feet
        ("EPSG:2263+5703", None, None, 100.0),  # heights in metres over a plan in feet
        ("EPSG:32618+6360", "m", None, 100.0),  # the raster's own unit goes before
    ],
)
def test_rasters_in_feet(tmp_path, crs, unit, told, metres):
    ledger = Ledger()
    file = raster(tmp_path / "r.tif", np.full((2, 3), 100.0), crs=crs, unit=unit)
    points, _ = read_relief_points(file, ledger, unit=told)
    assert points[:, 2] == pytest.approx(metres, abs=1e-9)
    assert (points[:, 1] > 4_999_000).all()
    said = sum(one.what.startswith("heights of the ground in feet, as the file says") for one in noted(ledger))
    assert said == (told is None and metres != 100.0)
    assert not ledger.report(source="", crs="", origin=(0.0, 0.0, 0.0)).warnings


def noted(ledger):
    return ledger.report(source="", crs="", origin=(0.0, 0.0, 0.0)).noted


def test_a_plan_in_feet_makes_heights_in_feet_likely(tmp_path):
    ledger = Ledger()
    points, _ = read_relief_points(raster(tmp_path / "r.tif", np.full((2, 2), 7.0), crs="EPSG:2263"), ledger)
    assert (points[:, 2] == 7.0).all()
    (warning,) = ledger.report(source="", crs="", origin=(0.0, 0.0, 0.0)).warnings
    assert warning.endswith("r.tif: heights are taken as metres, though its plan is in feet: --terrain-unit ft, or m")
    ledger = Ledger()
    points, _ = read_relief_points(tmp_path / "r.tif", ledger, unit="ft")
    assert points[:, 2] == pytest.approx(7.0 * 0.3048)
    assert not ledger.report(source="", crs="", origin=(0.0, 0.0, 0.0)).warnings


@pytest.mark.parametrize("column", ["elev_ft", "Height (ft)", "CONTOUR_FEET", "height_ft"])
def test_columns_of_ground_that_say_feet(tmp_path, column):
    at = [(shapely.Point(x, 0), {column: 50.0 + x}) for x in range(3)]
    ledger = Ledger()
    file = geojson(tmp_path / "c.geojson", at, crs="EPSG:32632")
    points, _ = read_relief_points(file, ledger)
    assert points[:, 2] == pytest.approx(np.array([50.0, 51.0, 52.0]) * 0.3048)
    assert f"heights of the ground in feet, as the file says (column {column}: feet)" in [
        one.what for one in noted(ledger)
    ]
    assert read_relief_points(file, ledger, unit="m")[0][:, 2].tolist() == [50.0, 51.0, 52.0]


def test_voids_are_told_in_the_units_of_the_file(tmp_path):
    """-1450 ft is ground by the Dead Sea; -9999 is none, and 0.3048 times it neither."""
    values = np.array([[-1410.0, -9999.0, -32768.0, 29_000.0]])
    points, _ = read_relief_points(raster(tmp_path / "r.tif", values, nodata=None, unit="ft"), Ledger())
    assert points[:, 2] == pytest.approx(np.array([-1410.0, 29_000.0]) * 0.3048)


def test_a_large_raster_is_decimated(tmp_path):
    y, x = np.indices((2000, 2100))
    ledger = Ledger()
    points, _ = read_relief_points(raster(tmp_path / "r.tif", 0.1 * x + 0.2 * y), ledger)
    assert 500_000 < len(points) <= 2_000_000
    assert ledger.count("noted") == 1
    expected = 0.01 * (points[:, 0] - 500005.0) - 0.02 * (points[:, 1] - 4999995.0)
    assert np.abs(points[:, 2] - expected).max() < 0.31


def test_files_without_heights_are_refused_in_one_line(tmp_path):
    flat = geojson(tmp_path / "flat.geojson", [(shapely.Point(0, 0), {"name": "a"})], crs="EPSG:32632")
    broken, empty = tmp_path / "broken.tif", tmp_path / "empty.tif"
    broken.write_bytes(b"II*\0nonsense")
    raster(empty, np.full((2, 2), -9999.0))
    void = geojson(tmp_path / "void.geojson", [(shapely.Point(0, 0), {"height": -9999.0})], crs="EPSG:32632")
    text = tmp_path / "x.txt"
    text.write_text("hello")
    for path, what in (
        (flat, "column of heights.*name"),
        (broken, "raster"),
        (empty, "no cell"),
        (void, "found only values such as -9999"),
        (text, "contour lines with heights"),
    ):
        with pytest.raises(CityError, match=what) as caught:
            read_relief_points(path, Ledger())
        assert str(path) in str(caught.value)
        assert "\n" not in str(caught.value)


def test_lorient_and_zug():
    points, crs = read_relief_points(real("lorient") / "dem.geojson", Ledger())
    assert crs is not None
    assert crs.to_epsg() == 2154
    assert (len(points), points[:, 2].min(), points[:, 2].max()) == (1362, -1.79, pytest.approx(33.2))
    bounds = (*points[:, :2].min(axis=0), *points[:, :2].max(axis=0))
    terrain, spikes = terrain_from_points(points, bounds=bounds, spacing=choose_spacing(bounds))
    assert spikes == 0
    assert np.abs(terrain.at(points) - points[:, 2]).max() < 0.5
    points, crs = read_relief_points(real("dirty_zug_cea") / "topography" / "terrain.tif", Ledger())
    assert crs is not None
    assert crs.to_epsg() == 32732
    assert points.shape == (27 * 31, 3)


@pytest.mark.parametrize(("height", "left_out"), [(9999.0, 6), (80.0, 0)])
def test_spikes_in_the_ground_of_a_model(height, left_out):
    """A void within the range of plausible heights; a tower of rock is none."""
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(0.0, 101.0, 10.0), np.arange(0.0, 101.0, 10.0)))
    points = np.column_stack([x, y, 0.1 * x])
    points[60, 2] = height
    corners = [one for i in range(109) if i % 11 < 10 for one in ((i, i + 1, i + 12), (i, i + 12, i + 11))]
    # Every triangle has corners of its own, as those of CityGML have.
    mesh = TriangleMesh(points[np.ravel(corners)], np.arange(3 * len(corners)).reshape(-1, 3))
    ledger = Ledger()
    terrain = ground_of_model(mesh, lambda one: one, (0.0, 0.0, 100.0, 100.0), ledger)
    assert terrain.at(np.array([points[60, :2]])) == pytest.approx(5.0 if left_out else height, abs=1.0)
    assert ledger.count("left out", "triangle of the ground: at a spike") == left_out
