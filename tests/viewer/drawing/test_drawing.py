import math
from dataclasses import replace

import numpy as np
import pytest

from mmi.appearance.ground_mesh import SKY_HORIZON, SKY_ZENITH
from mmi.capture.renderer import Capturer
from mmi.foundation.camera import level_view, view_towards
from mmi.foundation.errors import CaptureError
from viewer.cells.loaded_cell import load_cell
from viewer.drawing.opengl import is_software
from viewer.drawing.renderer import Renderer, gpu_seconds
from viewer.plan import CellKey, CellLayers, Ground, Objects, Plan, Sky

SIZE = (320, 240)
FOCAL = 277.0
WINDOW = (-160, -120, *SIZE)
CELL = "0001-01"  # in the middle of the street to the east


@pytest.fixture(scope="module")
def place(scene):
    return scene.cell(CELL)


@pytest.fixture(scope="module")
def renderer(scene):
    with Renderer(scene.mesh, scene.ground, size=SIZE, measured=True) as renderer:
        renderer.upload(load_cell(scene, CELL, measured=True))
        yield renderer


def look(place, azimuth, along=0.0, up=0.0, pitch=0.0):
    """From the reference viewpoint, or metres east of it and above."""
    eye = place.cell.reference + np.array([along, 0.0, up])
    return view_towards(eye, azimuth, pitch, focal=FOCAL, window=WINDOW)


def every_tile(scene):
    return Ground(tuple(range(len(scene.ground.triangle_counts))))


def everything(scene):
    return Plan((Objects("all", np.arange(len(scene.mesh.triangle_counts))), every_tile(scene), Sky()))


def layered(scene, place):
    layers = CellLayers(CellKey("multi-mesh", CELL), place.layers)
    return Plan((Objects("near", place.near), layers, every_tile(scene), Sky()))


def test_it_shows_the_same_objects_at_the_same_depth_as_the_capture(scene, place, renderer):
    for azimuth, pitch in ((0.3, 0.0), (2.0, 0.3), (4.0, -0.2)):
        view = look(place, azimuth, pitch=pitch)
        frame = renderer.draw(Plan(everything(scene).draws[:1]), view, measured=True)
        with Capturer(scene.mesh) as capturer:
            texture = capturer.depth_textures(np.arange(len(scene.mesh.triangle_counts)), [view])[0]
        covered = texture.coverage
        assert np.mean(frame.object_ids[covered] == texture.object_ids[covered]) > 0.999
        same = covered & (frame.object_ids == texture.object_ids)
        np.testing.assert_allclose(frame.depth[same], texture.depth[same], rtol=1e-3)
        difference = np.abs(frame.color[same].astype(int) - texture.color[same].astype(int))
        assert np.median(difference) <= 1


def test_sky_above_ground_below_up_to_the_horizon(scene, place, renderer):
    frame = renderer.draw(Plan((every_tile(scene), Sky())), look(place, 0.0), measured=True)
    assert (frame.object_ids[:119] == -1).all()
    assert (frame.object_ids[121:] == -2).all()
    assert np.isinf(frame.depth[:119]).all()
    assert frame.depth[-1, 160] == pytest.approx(1.7 * FOCAL / 119.5, rel=1e-3)
    np.testing.assert_allclose(frame.color[118, 160], SKY_HORIZON, atol=6)


def sky_color(directions):
    """The twin of the shader: sRGB of the sky towards ``directions`` (..., 3), unit vectors."""
    up = np.clip(directions[..., 2:], 0.0, 1.0) ** 0.6
    return np.array(SKY_HORIZON) * (1.0 - up) + np.array(SKY_ZENITH) * up


def test_the_sky_darkens_towards_the_zenith(place, renderer):
    seen = []
    for azimuth, pitch in ((0.0, 0.0), (2.0, 0.7), (4.0, 1.4), (5.0, -0.8)):
        view = look(place, azimuth, pitch=pitch)
        u, v = view.pixel_centres()
        rays = view.unproject(u[None, :], v[:, None], np.ones(1)) - view.eye
        expected = sky_color(rays / np.linalg.norm(rays, axis=-1, keepdims=True))
        seen.append(expected.reshape(-1, 3))
        frame = renderer.draw(Plan((Sky(),)), view, measured=True)
        np.testing.assert_allclose(frame.color, expected, atol=1.0)
    shown = np.concatenate(seen)
    assert (shown.min(axis=0) < np.array(SKY_ZENITH) + 1).all(), "the zenith was looked at"
    assert (shown.max(axis=0) == SKY_HORIZON).all()


def test_the_ground_goes_on_where_no_tiles_are_drawn(scene, place, renderer):
    with_tiles = renderer.draw(Plan((every_tile(scene), Sky())), look(place, 0.0), measured=True)
    without = renderer.draw(Plan((Ground(()), Sky())), look(place, 0.0), measured=True)
    assert np.array_equal(with_tiles.object_ids, without.object_ids)
    assert without.draws == 2


def test_what_is_culled_does_not_show(scene, place, renderer):
    """Layers and tiles chosen for a view give the picture that all of them give."""
    for azimuth in np.linspace(0.0, 6.0, 9):
        for along, pitch in ((0.0, 0.0), (15.0, 0.0), (-12.0, -0.5)):
            view = look(place, azimuth, along, pitch=pitch)
            names = place.layers_in(view)
            chosen = Plan(
                (
                    Objects("near", place.near),
                    CellLayers(CellKey("multi-mesh", CELL), names),
                    scene.ground_in(view),
                    Sky(),
                )
            )
            few, all_of_them = (renderer.draw(plan, view) for plan in (chosen, layered(scene, place)))
            assert few.draws <= all_of_them.draws
            differ = (few.color != all_of_them.color).any(axis=(1, 2))
            horizon = -FOCAL * math.tan(-pitch) + 120.0
            rows = np.flatnonzero(differ)
            assert np.all((rows >= horizon - 1.0) & (rows <= horizon + 3.5)), "the ground's details end before it does"


def test_some_layers_are_culled(place):
    kept = [len(place.layers_in(look(place, azimuth))) for azimuth in np.linspace(0.0, 6.0, 9)]
    assert 0 < np.mean(kept) < 0.7 * len(place.layers)


def test_impostors_from_the_reference_viewpoint_equal_the_geometry(scene, place, renderer):
    for azimuth in np.linspace(0.1, 2 * math.pi, 7):
        truth = renderer.draw(everything(scene), look(place, azimuth), measured=True)
        shown = renderer.draw(layered(scene, place), look(place, azimuth), measured=True)
        assert np.mean(truth.object_ids != shown.object_ids) < 0.004
        assert np.nanmax(shown.displacement, initial=0.0) * FOCAL < 0.1
        assert (truth.object_ids == -2).sum() > 0


def test_impostors_from_the_cells_ends_are_nearly_right(scene, place, renderer):
    half = 0.49 * place.cell.length
    for along in (-half, half):
        for azimuth in (0.0, math.pi, 1.2):
            view = look(place, azimuth, along)
            truth = renderer.draw(everything(scene), view, measured=True)
            shown = renderer.draw(layered(scene, place), view, measured=True)
            assert np.mean(truth.object_ids != shown.object_ids) < 0.02


def test_displacement_is_measured_where_meshes_lie_off_the_surface(scene, place, renderer):
    """Seen from far outside the cell, corners that the grid rounds off are displaced, and the measure says so."""
    views = [look(place, azimuth, -60.0) for azimuth in np.linspace(0.0, 5.0, 6)]
    frames = [renderer.draw(layered(scene, place), view, measured=True) for view in views]
    assert max(np.max(np.nan_to_num(shown.displacement)) for shown in frames) * FOCAL > 0.1
    for shown in frames:
        assert np.isnan(shown.displacement[shown.object_ids < 0]).all(), "ground and sky are no impostors"
        assert np.isnan(shown.displacement[np.isin(shown.object_ids, place.near)]).all()


def test_a_set_of_objects_draws_only_those(scene, place, renderer):
    frame = renderer.draw(Plan((Objects("two", np.array([2, 9])), Sky())), look(place, 0.3, up=60.0), measured=True)
    assert set(np.unique(frame.object_ids)) <= {-1, 2, 9}
    assert frame.triangles == scene.mesh.triangle_counts[[2, 9]].sum() + 1
    assert renderer.draw(Plan((Objects("none", np.array([], dtype=np.int64)), Sky())), look(place, 0.3)).draws == 1


def test_sets_of_objects_are_forgotten_and_made_again(scene, place, renderer):
    first = renderer.draw(everything(scene), look(place, 0.3)).color
    for i in range(80):
        renderer.draw(Plan((Objects(f"one {i}", np.array([i % 16])),)), look(place, 0.3), read=False)
    assert np.array_equal(renderer.draw(everything(scene), look(place, 0.3)).color, first)


def test_layers_come_and_go(scene, place):
    cell = CellKey("multi-mesh", CELL)
    with Renderer(scene.mesh, scene.ground, size=(64, 48)) as other:
        view = level_view(place.cell.reference, 0.0, focal=50.0, window=(-32, -24, 64, 48))
        plan = Plan((CellLayers(cell, place.layers[:3]),))
        with pytest.raises(KeyError):
            other.draw(plan, view)
        loaded = load_cell(scene, CELL)
        other.upload(loaded)
        other.upload(loaded)
        by_name = {layer.name: layer for layer in loaded.layers}
        chosen = [by_name[name] for name in place.layers[:3]]
        frame = other.draw(plan, view)
        assert frame.triangles == sum(len(layer.triangles) for layer in chosen)
        assert frame.draws == any(layer.in_order for layer in chosen) + any(
            layer.in_order < len(layer.triangles) for layer in chosen
        )
        other.evict(cell)
        other.evict(cell)
        with pytest.raises(KeyError):
            other.draw(plan, view)
        with pytest.raises(ValueError, match="measured"):
            other.draw(Plan((Sky(),)), view, measured=True)


def test_a_cell_without_layers_and_a_view_that_culls_them_all_draw_none(place, renderer):
    for cell in (CellKey("multi-mesh", CELL), CellKey("multi-mesh", "no layers")):
        assert renderer.draw(Plan((CellLayers(cell, ()), Sky())), look(place, 0.3)).draws == 1


def test_cross_fading_mixes_two_pictures(scene, place, renderer):
    one, other = everything(scene), Plan((Sky(),))
    view = look(place, 0.3)
    a, b = renderer.draw(one, view).color.astype(int), renderer.draw(other, view).color.astype(int)
    fading = Plan(one.draws, fading=other.draws, mix=0.25)
    assert np.abs(renderer.draw(fading, view).color - (0.25 * a + 0.75 * b)).max() <= 1.0
    measured = renderer.draw(fading, view, measured=True)
    assert np.abs(measured.color - (0.25 * a + 0.75 * b)).max() <= 1.0
    assert np.array_equal(measured.object_ids, renderer.draw(one, view, measured=True).object_ids)
    assert np.array_equal(renderer.draw(one, view).color, a), "nothing of it stays"


def test_the_same_plan_gives_the_same_picture(scene, place, renderer):
    first, second = (renderer.draw(layered(scene, place), look(place, 1.0)) for _ in range(2))
    assert np.array_equal(first.color, second.color)


def test_antialiasing_smooths_silhouettes_and_nothing_else(scene, place):
    """With samples, pixels along edges are mixtures; those inside surfaces stay as they are. The same for impostors."""
    view = look(place, 0.8)
    with (
        Renderer(scene.mesh, scene.ground, size=SIZE) as plain,
        Renderer(scene.mesh, scene.ground, size=SIZE, samples=4) as smooth,
    ):
        for one in (plain, smooth):
            one.upload(load_cell(scene, CELL))
        for plan in (everything(scene), layered(scene, place)):
            a, b = (one.draw(plan, view).color.astype(int) for one in (plain, smooth))
            share = np.mean(np.abs(a - b).max(axis=2) > 12)
            assert 0.001 < share < 0.1
    with pytest.raises(CaptureError, match="samples"):
        Renderer(scene.mesh, scene.ground, size=SIZE, samples=4096)


def test_time_is_told(scene, place, renderer):
    frame = renderer.draw(everything(scene), look(place, 0.3), read=False)
    assert frame.color.size == 0
    assert 0.0 < frame.seconds < 60.0
    assert (frame.gpu_seconds is None) == is_software(renderer.device)
    assert frame.gpu_seconds is None or 0.0 < frame.gpu_seconds <= 1.05 * frame.seconds
    assert renderer.device


def test_times_of_the_gpu_that_mean_nothing_are_not_told():
    card = "NVIDIA H200/PCIe/SSE2"
    assert gpu_seconds(3_000_000, seconds=0.004, device=card) == pytest.approx(0.003)
    assert gpu_seconds(2**32 - 1, seconds=0.004, device=card) is None, "a query that overflowed"
    assert gpu_seconds(0, seconds=0.004, device=card) is None
    for software in ("llvmpipe (LLVM 15.0.7, 256 bits)", "softpipe", "Mesa swrast", "Software Rasterizer"):
        assert gpu_seconds(3_000_000, seconds=0.004, device=software) is None
    assert not is_software(card)


def test_a_draw_of_no_known_kind_is_refused(place, renderer):
    with pytest.raises(AssertionError, match="unreachable"):
        renderer.draw(Plan(("a moving tram",)), look(place, 0.3))


def test_measuring_needs_ids_of_layers(scene):
    loaded = load_cell(scene, CELL)
    with (
        Renderer(scene.mesh, scene.ground, size=(32, 32), measured=True) as other,
        pytest.raises(ValueError, match="object ids expected"),
    ):
        other.upload(loaded)


def test_captured_depth_decides_between_layers(scene, place, renderer):
    """A mesh pushed off its surface by a tenth still loses and wins as the captured surface does."""
    loaded = load_cell(scene, CELL, measured=True)
    eye = place.cell.reference
    key = CellKey("pushed", CELL)
    view = look(place, 0.0)
    pushed_cell = replace(loaded, key=key)
    for layer in loaded.layers:
        positions, coordinates = layer.vertices[:, :3], layer.vertices[:, 3:]
        vertices = np.hstack([eye + 1.1 * (positions - eye), 1.1 * coordinates]).astype(np.float32)
        while not renderer.upload_layer(pushed_cell, replace(layer, vertices=vertices, in_order=0)):
            pass
    pushed = Plan((Objects("near", place.near), CellLayers(key, place.layers), every_tile(scene), Sky()))
    frames = [renderer.draw(plan, view, measured=True) for plan in (layered(scene, place), pushed)]
    assert np.mean(frames[0].object_ids != frames[1].object_ids) < 1e-3
    both = np.isfinite(frames[0].depth) & (frames[0].object_ids == frames[1].object_ids)
    np.testing.assert_allclose(frames[0].depth[both], frames[1].depth[both], rtol=2e-3)
