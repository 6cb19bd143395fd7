"""A cell's files as readers see them: pictures from the glTF alone, depths from the EXR, the city with its ground in tiles."""

import hashlib
import io
import shutil
from dataclasses import replace

import numpy as np
import OpenEXR
import pytest
from cities import block, city_of, crossroads
from manifests import with_first_cell, with_first_picture
from PIL import Image
from rasters import psnr

from mmi.appearance.city_mesh import build_city_mesh, object_boxes, triangles_of
from mmi.appearance.ground_mesh import ground_mesh
from mmi.building.cell import build_cell
from mmi.building.dataset import build_dataset
from mmi.capture.layer_values import GridMesh, LayerPicture
from mmi.capture.renderer import Capturer
from mmi.cells.viewing_cells import viewing_cells
from mmi.dataset.cell_files import read_depths, read_impostor, read_pictures
from mmi.dataset.city_files import city_glb, read_city_mesh
from mmi.dataset.glb import GlbContents, GlbImage, glb_bytes, read_glb
from mmi.dataset.reading import Dataset, open_dataset
from mmi.foundation.camera import Camera
from mmi.foundation.errors import DatasetError
from mmi.meshing.displacement import displacement
from mmi.meshing.ordering import CapturedLayer, out_of_order
from mmi.parallax.from_anywhere import viewers_of
from mmi.planning.parameters import BuildParameters
from mmi.planning.plan import prepare_city

PARAMETERS = BuildParameters(near_distance=30.0, camera=Camera(128, 128, 1.0), cell_length=80.0, longest_object=None)


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    out = tmp_path_factory.mktemp("dataset") / "out"
    build_dataset(crossroads(), out, PARAMETERS, max_cells=2)
    return open_dataset(out)


@pytest.fixture
def cell(built):
    return built.manifest.cells[0].id


def same_mesh(one, other):
    return all(np.array_equal(getattr(one, name), getattr(other, name)) for name in ("vertices", "uv", "triangles"))


def nearly_same_vertices(one, other):
    """But for the steps that texture coordinates are stored in."""
    return np.array_equal(one.vertices, other.vertices) and np.abs(one.uv - other.uv).max() <= 0.5 / 65535 + 1e-7


def test_pictures_and_depths_are_what_was_captured(built, cell):
    scene = prepare_city(crossroads(), PARAMETERS)
    with Capturer(scene.mesh) as capturer:
        captured = build_cell(scene, built.cell(cell).viewing_cell, capturer)
    pictures, depths = read_pictures(built, cell), read_depths(built, cell)
    named = {layer.name: layer for layer in captured.layers}
    assert [one.name for one in pictures] == [one.name for k in built.cell(cell).layers for one in k]
    assert set(named) == set(depths) == {one.name for one in pictures}
    place = np.zeros(len(scene.city.objects) + 1, dtype=np.uint32)
    place[captured.far] = np.arange(len(captured.far)) + 1
    for picture in pictures:
        layer, (depth, places) = named[picture.name], depths[picture.name]
        assert (picture.index, picture.sector, picture.piece) == (layer.index, layer.sector, layer.piece)
        assert (picture.view.focal, picture.view.window) == (layer.texture.view.focal, layer.texture.view.window)
        np.testing.assert_allclose(picture.view.eye_from_world, layer.texture.view.eye_from_world, atol=1e-12)
        assert psnr(picture.pixels[..., :3], layer.texture.color) > 30.0
        assert np.array_equal(picture.pixels[..., 3], np.where(layer.texture.coverage, 255, 0))
        assert nearly_same_vertices(picture.mesh, layer.mesh)
        assert depth.dtype == np.float32
        assert np.array_equal(depth, layer.texture.depth.astype(np.float16).astype(np.float32))
        np.testing.assert_allclose(depth, layer.texture.depth, rtol=2.0**-11)  # infinite where nothing is
        assert np.array_equal(places, place[layer.texture.object_ids])
        assert not picture.pixels.flags.writeable


@pytest.mark.parametrize(("quality", "at_least"), [(100, np.inf), (95, 34.0), (20, 20.0)])
def test_pictures_are_as_good_as_asked_for_and_coverage_always_is(tmp_path, built, cell, quality, at_least):
    """100 is lossless, also what nobody sees beyond silhouettes: filtering reaches there."""
    parameters = replace(PARAMETERS, texture_quality=quality)
    build_dataset(crossroads(), tmp_path / "out", parameters, cells=[cell])
    scene = prepare_city(crossroads(), parameters)
    with Capturer(scene.mesh) as capturer:
        captured = {one.name: one.texture for one in build_cell(scene, built.cell(cell).viewing_cell, capturer).layers}
    dataset = open_dataset(tmp_path / "out")
    pictures = read_pictures(dataset, cell)
    assert len(pictures) > 2
    for picture in pictures:
        texture = captured[picture.name]
        assert psnr(picture.pixels[..., :3], texture.color) >= at_least
        assert np.array_equal(picture.pixels[..., 3], np.where(texture.coverage, 255, 0))
    sizes = [one.cell(cell).files.glb.bytes for one in (dataset, built)]
    assert (sizes[0] > sizes[1]) == (quality > PARAMETERS.texture_quality)


def test_the_exr_holds_depth_and_ids_for_other_programs(built, cell):
    """Half floats and whole numbers, in the capture's own pixel coordinates; colour is in the glTF."""
    parts = OpenEXR.File(str(built.path / "cells" / f"{cell}.exr"), separate_channels=True).parts
    pictures = {one.name: one for one in read_pictures(built, cell)}
    assert {part.name() for part in parts} == set(pictures)
    for part in parts:
        left, top, width, height = pictures[part.name()].view.window
        assert {name: one.pixels.dtype for name, one in part.channels.items()} == {"Z": np.float16, "id": np.uint32}
        low, high = part.header["dataWindow"]
        assert (*low, *high) == (left, top, left + width - 1, top + height - 1)
        assert part.header["focal"] == pytest.approx(pictures[part.name()].view.focal)
        assert np.array_equal(np.isfinite(part.channels["Z"].pixels), part.channels["id"].pixels > 0)


def test_the_manifest_says_how_far_meshes_displace_texels(built, cell):
    scene, least = prepare_city(crossroads(), PARAMETERS), 0.25 * PARAMETERS.max_angle
    with Capturer(scene.mesh) as capturer:
        captured = build_cell(scene, built.cell(cell).viewing_cell, capturer)
    worst = max(
        displacement(one.texture, one.mesh, viewers_of(captured.cell, one.texture.view), least=least)
        for one in captured.layers
    )
    assert built.cell(cell).displacement_px == pytest.approx(PARAMETERS.camera.pixels_from_angle(worst))
    assert 0.0 < built.cell(cell).displacement_px
    assert built.cell(cell).largest_weight_px <= built.cell(cell).promised_error_px == PARAMETERS.max_error_px


def test_triangles_that_need_captured_depths_come_last(built, cell):
    scene = prepare_city(crossroads(), PARAMETERS)
    with Capturer(scene.mesh) as capturer:
        captured = build_cell(scene, built.cell(cell).viewing_cell, capturer)
    eye = captured.cell.reference
    late = out_of_order(
        [CapturedLayer(one.index, one.texture.view, one.mesh, one.texture.depth) for one in captured.layers],
        max_angle=PARAMETERS.max_angle,
        eye_height=eye[2],
        solids=scene.mesh.positions[triangles_of(scene.mesh, captured.near)] - eye,
    )
    flags = {layer.name: flag for layer, flag in zip(captured.layers, late, strict=True)}
    triangles = {layer.name: layer.mesh.triangles for layer in captured.layers}
    pictures = read_pictures(built, cell)
    for one in pictures:
        flag, all_of_it = flags[one.name], triangles[one.name]
        assert one.in_order == np.count_nonzero(~flag)
        assert np.array_equal(one.mesh.triangles, np.concatenate([all_of_it[~flag], all_of_it[flag]]))
    assert 0 < sum(one.in_order for one in pictures) < sum(len(one.mesh.triangles) for one in pictures)


def test_an_impostor_is_its_pictures_and_depths(built, cell):
    city = built.city()
    pictures, depths = read_pictures(built, cell), read_depths(built, cell)
    impostor = read_impostor(built, cell, city)
    assert len(impostor.layers) == len(pictures) > 2
    for layer, picture in zip(impostor.layers, pictures, strict=True):
        assert layer.name == picture.name
        assert np.array_equal(layer.texture.color, picture.pixels[..., :3])
        assert np.array_equal(layer.texture.coverage, picture.pixels[..., 3] == 255)
        assert np.array_equal(layer.texture.depth, depths[picture.name][0])
        assert same_mesh(layer.mesh, picture.mesh)


def test_the_manifest_says_between_which_depths_meshes_lie(built, cell):
    pictures = read_pictures(built, cell)
    described = [one for layers in built.cell(cell).layers for one in layers]
    for picture, one in zip(pictures, described, strict=True):
        depth = picture.view.project(picture.mesh.vertices.astype(float))[:, 2]
        assert one.depth == pytest.approx([depth.min(), depth.max()], rel=1e-9)
        assert 0.0 < one.depth[0] <= one.depth[1]


def test_a_cell_without_layers_has_no_pictures(tmp_path):
    build_dataset(crossroads(), tmp_path / "out", replace(PARAMETERS, near_distance=1000.0), max_cells=1)
    dataset = open_dataset(tmp_path / "out")
    name = dataset.manifest.cells[0].id
    assert read_pictures(dataset, name) == ()
    assert read_depths(dataset, name) == {}
    assert read_impostor(dataset, name, dataset.city()).layers == ()
    with pytest.raises(DatasetError, match="no cell 'x'"):
        read_pictures(dataset, "x")


@pytest.fixture
def copied(built, tmp_path):
    """A dataset whose files a test may damage."""
    return open_dataset(shutil.copytree(built.path, tmp_path / "out"))


@pytest.mark.parametrize(
    ("suffix", "read", "spared"), [("glb", read_pictures, read_depths), ("exr", read_depths, read_pictures)]
)
@pytest.mark.parametrize("damage", ["missing", "short", "other"])
def test_a_missing_or_damaged_file_is_named_and_the_other_is_not_read(copied, suffix, read, spared, damage):
    cell = copied.manifest.cells[0].id
    path = copied.path / "cells" / f"{cell}.{suffix}"
    data = path.read_bytes()
    path.unlink()
    if damage != "missing":
        path.write_bytes(data[:-9] if damage == "short" else data[:-1] + bytes([data[-1] ^ 1]))
    expected = rf"{cell}\.{suffix}: " + ("cannot be read" if damage == "missing" else r"\d+ bytes .*found \d+")
    with pytest.raises(DatasetError, match=expected):
        read(copied, cell)
    with pytest.raises(DatasetError, match=expected):
        read_impostor(copied, cell, copied.city())
    assert len(spared(copied, cell)) > 2


@pytest.mark.parametrize(
    "fields",
    [
        {"index": 9},
        {"index": 7},
        {"piece": 3},
        {"focal": 10.0},
        {"window": (0, 0, 16, 16)},
        {"window": (0, 0, -1, 16)},
        {"triangles": 1, "in_order": 0},
    ],
)  # fmt: skip
def test_a_picture_that_the_manifest_does_not_describe_is_refused(copied, fields):
    cell = copied.manifest.cells[0].id
    with pytest.raises(DatasetError, match=rf"{cell}\.glb: the layers that the manifest describes expected"):
        read_pictures(with_first_picture(copied, **fields), cell)
    with pytest.raises(DatasetError, match=rf"{cell}\.glb: the layers"):
        read_impostor(with_first_picture(copied, **fields), cell, copied.city())


def png(pixels):
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "PNG")
    return GlbImage(buffer.getvalue())


@pytest.mark.parametrize("what", ["size", "no alpha", "no picture", "nodes"])
def test_a_file_of_other_layers_is_refused(copied, what):
    """As if a build had gone wrong: the checksum holds."""
    entry = copied.manifest.cells[0]
    cell, path = entry.id, copied.path / "cells" / f"{entry.id}.glb"
    scene = read_glb(path)
    nodes, images = list(scene.nodes), list(scene.images)
    height, width = read_pictures(copied, cell)[0].pixels.shape[:2]
    if what == "nodes":
        nodes = [replace(one, name=one.name + "x") for one in nodes]
    elif what == "no picture":
        images[0] = GlbImage(b"\x89PNG\r\n\x1a\n and no more")
    else:
        bands = 4 if what == "size" else 3
        images[0] = png(np.zeros((height + (bands == 4), width, bands), dtype=np.uint8))
    data = glb_bytes(GlbContents(tuple(nodes), tuple(images)))
    path.write_bytes(data)
    file = replace(entry.files.glb, bytes=len(data), sha256=hashlib.sha256(data).hexdigest())
    other = with_first_cell(copied, files=replace(entry.files, glb=file))
    with pytest.raises(DatasetError, match=rf"{cell}\.glb: the layers that the manifest describes expected"):
        read_pictures(other, cell)


def test_depths_of_another_size_or_of_objects_that_are_not_listed_are_refused(copied):
    entry = copied.manifest.cells[0]
    for changed in (with_first_picture(copied, window=(0, 0, 8, 8)), with_first_picture(copied, index=9)):
        with pytest.raises(DatasetError, match=r"\.exr: the layers that the manifest describes"):
            read_depths(changed, entry.id)
    one_object = tuple(tuple(replace(one, objects=(0,)) for one in sector) for sector in entry.layers)
    fewer = with_first_cell(copied, far=entry.far[:1], near=(), layers=one_object)
    with pytest.raises(DatasetError, match=r"\.exr: the layers that the manifest describes"):
        read_depths(fewer, entry.id)


def test_a_picture_is_as_large_as_its_window(built, cell):
    one = read_pictures(built, cell)[0]
    mesh = GridMesh(np.zeros((3, 3), np.float32), np.zeros((3, 2), np.float32), np.array([[0, 1, 2]], np.int32))
    for pixels in (one.pixels[1:], one.pixels[..., :3], one.pixels.astype(np.float32)):
        with pytest.raises(ValueError, match=r"a picture of .* bytes for window .* expected, found"):
            LayerPicture("s0.l0", 0, 0, 0, one.view, pixels.copy(), mesh, 1)


def test_rims_keep_the_ids_of_near_objects(tmp_path):
    city = city_of(*(block(f"house {k}", x, 12.0, x + 10.0, 22.0, 9.0) for k, x in enumerate(range(-80, 80, 10))))
    build_dataset(city, tmp_path / "row", BuildParameters(camera=PARAMETERS.camera, near_distance=20.0))
    dataset = open_dataset(tmp_path / "row")
    (entry,) = dataset.manifest.cells
    impostor = read_impostor(dataset, entry.id, dataset.city())
    shown = {int(i) for layer in impostor.layers for i in np.unique(layer.texture.object_ids[layer.texture.coverage])}
    assert shown & set(impostor.near.tolist())
    assert {int(i) for layer in impostor.layers for i in layer.objects} <= set(impostor.far.tolist())


# The city's geometry


def test_the_city_is_read_with_its_ground_in_tiles(built):
    mesh, ground = read_city_mesh(built)
    expected, tiles = build_city_mesh(crossroads()), ground_mesh(crossroads(), margin=300.0)
    assert len(object_boxes(tiles)) > 9
    for found, made in ((mesh, expected), (ground, tiles)):
        for name in ("positions", "uv", "colors", "triangles", "object_vertices", "object_triangles", "texture"):
            assert np.array_equal(getattr(found, name), getattr(made, name)), name
    assert np.array_equal(object_boxes(ground), object_boxes(tiles))


def test_an_object_may_be_called_like_the_ground(tmp_path):
    city = city_of(block("ground/0", -10.0, 20.0, 10.0, 35.0, 12.0), block("ground", -30.0, 60.0, 30.0, 90.0, 40.0))
    names = [node.name for node in read_glb(city_glb(city)[0]).nodes]
    assert names[:3] == ["ground/0", "ground", "ground/0"]
    build_dataset(city, tmp_path / "out", PARAMETERS)
    mesh, ground = read_city_mesh(open_dataset(tmp_path / "out"))
    assert np.array_equal(mesh.positions, build_city_mesh(city).positions)
    assert len(ground.triangle_counts) == len(names) - 2


def test_a_city_without_ground_is_refused(built):
    city = replace(built.manifest.city, objects=10**6)
    with pytest.raises(DatasetError, match=r"city\.glb: objects, ground and two textures expected"):
        read_city_mesh(Dataset(built.path, replace(built.manifest, city=city)))


# One layer for all


def test_a_single_layer_holds_every_far_object(built, cell, tmp_path):
    paper = replace(PARAMETERS, weights="critical-zone")  # which takes several layers here
    single = replace(paper, layering="single")
    for name, parameters in (("several", paper), ("out", single)):
        build_dataset(crossroads(), tmp_path / name, parameters, cells=[cell])
    layered, dataset = open_dataset(tmp_path / "several"), open_dataset(tmp_path / "out")
    one, several = dataset.cell(cell), layered.cell(cell)
    assert (one.near, one.far) == (several.near, several.far)
    assert {layer.index for k in several.layers for layer in k} > {0}
    assert {layer.index for k in one.layers for layer in k} == {0}
    assert one.promised_error_px is None and several.promised_error_px is None
    assert built.cell(cell).promised_error_px == PARAMETERS.max_error_px
    assert one.largest_weight_px > single.max_error_px >= several.largest_weight_px
    impostor = read_impostor(dataset, cell, dataset.city())
    shown, of_several = (
        {int(i) for layer in one.layers for i in layer.objects}
        for one in (impostor, read_impostor(layered, cell, layered.city()))
    )
    assert 1 < len(shown)
    assert shown <= of_several  # what is hidden from the reference viewpoint is in none of its pictures


def test_a_single_layer_may_hold_more_objects_than_one_pass_can_tell_apart():
    houses = []
    for row in range(20):  # each row is seen over those in front of it
        x, y = np.arange(20) * 8.0 - 80.0, 60.0 + 8.0 * row
        houses += [block(f"{row}/{i}", x[i], y, x[i] + 5.0, y + 5.0, 3.0 + 2.0 * row) for i in range(20)]
    scene = prepare_city(city_of(*houses), replace(PARAMETERS, layering="single", near_distance=30.0))
    graph = viewing_cells(scene.city, max_length=80.0, eye=(1.5, 1.9))
    with Capturer(scene.mesh) as capturer:
        impostor = build_cell(scene, graph.nodes[next(iter(graph))]["cell"], capturer)
    assert len(impostor.far) > 255
    assert {layer.index for layer in impostor.layers} == {0}
    shown = np.unique(np.concatenate([layer.objects for layer in impostor.layers]))
    assert len(shown) > 255
