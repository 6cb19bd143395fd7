import math

import numpy as np
import pytest
import shapely
from cities import block, cell_along_x, city_of, crossroads, two_blocks
from rasters import bilinear, draw, psnr

from mmi.appearance.city_mesh import build_city_mesh
from mmi.building.cell import build_cell
from mmi.capture.renderer import Capturer
from mmi.foundation.camera import level_view
from mmi.foundation.errors import CaptureError
from mmi.planning.parameters import BuildParameters
from mmi.planning.plan import prepare_city

NORTH = math.pi / 2


def _looking_north(city, objects, *, supersample=1, size=256, eye=(0.0, 0.0, 1.7)):
    view = level_view(np.array(eye), NORTH, focal=220.0, window=(-size // 2, -size // 2, size, size))
    with Capturer(build_city_mesh(city)) as capturer:
        return capturer.depth_textures(np.array(objects), [view], supersample=supersample)[0]


def test_the_nearer_house_hides_the_farther_and_depth_is_along_the_axis():
    texture = _looking_north(two_blocks(), [0, 1])
    assert texture.object_ids[120, 128] == 0
    assert texture.depth[120, 128] == pytest.approx(60.0, abs=1e-3)
    assert texture.object_ids[80, 128] == 1
    assert texture.depth[80, 128] == pytest.approx(120.0, abs=1e-3)
    assert texture.object_ids[0, 0] == -1


def test_only_the_objects_asked_for_are_there():
    texture = _looking_north(two_blocks(), [1])
    assert texture.depth[120, 128] == pytest.approx(120.0, abs=1e-3)
    assert set(np.unique(texture.object_ids)) == {-1, 1}


def test_coverage_is_finite_depth():
    texture = _looking_north(crossroads(), range(16))
    assert np.array_equal(texture.coverage, np.isfinite(texture.depth))


def test_pictures_are_not_mirrored_and_not_upside_down():
    city = city_of(block("left", -30.0, 60.0, -10.0, 70.0, 30.0), block("right", 10.0, 60.0, 30.0, 70.0, 10.0))
    ids = _looking_north(city, [0, 1]).object_ids
    rows, columns = np.nonzero(ids == 0)
    assert columns.max() < 128
    assert rows.min() < np.nonzero(ids == 1)[0].min()
    assert np.nonzero(ids == 1)[1].min() >= 128


def test_silhouettes_are_where_projection_says():
    city = city_of(block("a", -11.3, 60.0, 9.7, 70.0, 17.0))
    rows, columns = np.nonzero(_looking_north(city, [0]).coverage)
    assert columns.min() == math.ceil(128 - 220 * 11.3 / 60 - 0.5)
    assert columns.max() == math.ceil(128 + 220 * 9.7 / 60 - 0.5) - 1
    assert rows.min() == math.ceil(128 - 220 * 15.3 / 60 - 0.5)


def test_depth_unprojects_onto_walls_and_roofs_within_a_centimetre():
    city = crossroads()
    view = level_view(np.array([3.0, -2.0, 45.0]), 1.0, focal=443.0, window=(-256, -100, 512, 400))
    far = np.array([i for i, one in enumerate(city.objects) if one.footprint.distance(shapely.Point(3, -2)) > 40.0])
    with Capturer(build_city_mesh(city)) as capturer:
        texture = capturer.depth_textures(far, [view])[0]
    u, v = np.meshgrid(*view.pixel_centres())
    seen = texture.coverage
    points = view.unproject(u[seen], v[seen], texture.depth[seen].astype(float))
    off = np.empty(len(points))
    for i in far:
        mine = texture.object_ids[seen] == i
        one, these = city.objects[i], points[mine]
        to_wall = shapely.distance(one.footprint.boundary, shapely.points(these[:, :2]))
        above = np.maximum(these[:, 2] - one.top, 0.0)
        to_roof = np.where(
            shapely.contains_xy(one.footprint, these[:, 0], these[:, 1]), np.abs(these[:, 2] - one.top), np.inf
        )
        off[mine] = np.minimum(np.hypot(to_wall, above), to_roof)
    roofs = np.isclose(points[:, 2], [city.objects[i].top for i in texture.object_ids[seen]], atol=1e-3)
    assert roofs.sum() > 1000
    assert (~roofs).sum() > 1000
    assert off.max() < 0.01


def test_the_item_buffer_agrees_with_the_capture():
    city = crossroads()
    view = level_view(np.array([0.0, 0.0, 1.7]), 0.3, focal=220.0, window=(-128, -128, 256, 256))
    objects = np.array([2, 3, 5, 7, 11, 13])
    with Capturer(build_city_mesh(city)) as capturer:
        ids = capturer.identify(objects, view)
        assert np.array_equal(ids, capturer.depth_textures(objects, [view])[0].object_ids)
        assert (capturer.identify(np.empty(0, dtype=np.int64), view) == -1).all()


def test_a_layer_of_many_objects_takes_several_passes_and_shows_them_all():
    corners = [((i % 30) * 5.0 - 75.0, 60.0 + i // 30 * 5.0, 3.0 + i // 30) for i in range(600)]
    objects = [block(f"{i}", x, y, x + 4.0, y + 4.0, top) for i, (x, y, top) in enumerate(corners)]
    texture = _looking_north(city_of(*objects), range(600), size=512, eye=(0.0, 0.0, 40.0))
    assert len(np.unique(texture.object_ids)) > 500


def test_supersampling_keeps_depth_and_ids_and_mixes_no_two_objects():
    city = crossroads()
    one, many = _looking_north(city, range(16)), _looking_north(city, range(16), supersample=3)
    assert np.mean(one.object_ids == many.object_ids) > 0.999
    same = one.coverage & many.coverage & (one.object_ids == many.object_ids)
    np.testing.assert_allclose(one.depth[same], many.depth[same], rtol=2e-4)
    assert not many.color[~many.coverage].any()  # the background is black: a mixture with it would show
    assert many.color[many.coverage].any(axis=1).mean() > 0.95
    with pytest.raises(CaptureError):
        _looking_north(city, [0], supersample=2)


def test_layers_seen_from_the_reference_viewpoint_are_the_captured_pictures():
    city = crossroads()
    scene = prepare_city(city, BuildParameters(near_distance=30.0))
    with Capturer(scene.mesh) as capturer:
        impostor = build_cell(scene, cell_along_x(), capturer)
    assert len(impostor.layers) >= 6
    for layer in impostor.layers:
        texture, mesh = layer.texture, layer.mesh
        left, top, width, height = texture.view.window
        projected = texture.view.project(mesh.vertices.astype(float))
        _, uv = draw(projected, mesh.uv.astype(float), mesh.triangles, left, top, width, height)
        shown = bilinear(texture.color, np.nan_to_num(uv))
        covered = texture.coverage
        assert not np.isnan(uv[covered]).any()
        assert psnr(shown[covered], texture.color[covered]) >= 30.0  # interpolated coordinates are a texel off at most


def test_near_geometry_and_layers_together_show_every_visible_object():
    """Nothing is lost between near and far: around the panorama, the nearest hits of geometry are near or in a layer."""
    city = crossroads()
    scene = prepare_city(city, BuildParameters(near_distance=30.0))
    cell = cell_along_x()
    with Capturer(scene.mesh) as capturer:
        impostor = build_cell(scene, cell, capturer)
        for sector in range(6):
            view = level_view(
                cell.reference, sector * math.pi / 3, focal=256 * math.sqrt(3), window=(-256, -256, 512, 512)
            )
            truth = capturer.identify(np.arange(len(city.objects)), view)
            mine = [layer for layer in impostor.layers if layer.sector == sector]
            best = np.full(truth.shape, np.inf)
            ids = np.full(truth.shape, -1)
            near = capturer.depth_textures(impostor.near, [view])[0] if impostor.near.size else None
            for depth, shown in [(near.depth, near.object_ids)] if near else []:
                ids = np.where(depth < best, shown, ids)
                best = np.minimum(best, depth)
            u, v = np.meshgrid(*view.pixel_centres())
            for layer in mine:
                scale = layer.texture.view.focal / view.focal
                left, top, width, height = layer.texture.view.window
                j, i = np.floor(u * scale).astype(int) - left, np.floor(v * scale).astype(int) - top
                inside = (i >= 0) & (i < height) & (j >= 0) & (j < width)
                depth = np.full(truth.shape, np.inf)
                depth[inside] = layer.texture.depth[i[inside], j[inside]]
                shown = np.full(truth.shape, -1)
                shown[inside] = layer.texture.object_ids[i[inside], j[inside]]
                ids = np.where(depth < best, shown, ids)
                best = np.minimum(best, depth)
            assert np.mean(ids == truth) > 0.995
