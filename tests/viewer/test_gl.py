import math

import numpy as np
import pytest
from cities import cell_along_x, crossroads

from mmi.build import build_cell, prepare_scene
from mmi.camera import level_view
from mmi.capture import Capturer
from mmi.ground import SKY_HORIZON, ground_mesh
from mmi.parameters import BuildParameters
from viewer.gl import Renderer
from viewer.technique import CellLayers, Ground, Objects, Plan, Sky

SIZE = (320, 240)
FOCAL = 277.0


@pytest.fixture(scope="module")
def scene():
    return prepare_scene(crossroads(), BuildParameters(near_distance=30.0))


@pytest.fixture(scope="module")
def impostor(scene):
    with Capturer(scene.mesh) as capturer:
        return build_cell(scene, cell_along_x(), capturer)


@pytest.fixture(scope="module")
def renderer(scene, impostor):
    with Renderer(scene.mesh, ground_mesh(scene.city, margin=100.0), size=SIZE, measured=True) as renderer:
        renderer.upload("made", impostor)
        yield renderer


def look(azimuth, x=0.0, y=0.0, z=1.7):
    return level_view(np.array([x, y, z]), azimuth, focal=FOCAL, window=(-160, -120, *SIZE))


def everything(scene):
    return Plan((Sky(), Ground(), Objects("all", np.arange(len(scene.city.objects)))))


def layered(impostor):
    names = tuple(layer.name for layer in impostor.layers)
    return Plan((Sky(), Ground(), Objects("near", impostor.near), CellLayers("made", impostor.cell.id, names)))


def test_it_shows_the_same_objects_at_the_same_depth_as_the_capture(scene, renderer):
    for azimuth in (0.3, 2.0, 4.0):
        frame = renderer.draw(Plan(everything(scene).draws[2:]), look(azimuth), measured=True)
        with Capturer(scene.mesh) as capturer:
            texture = capturer.depth_textures(np.arange(len(scene.city.objects)), [look(azimuth)])[0]
        covered = texture.coverage
        assert np.mean(frame.object_ids[covered] == texture.object_ids[covered]) > 0.999
        same = covered & (frame.object_ids == texture.object_ids)
        np.testing.assert_allclose(frame.depth[same], texture.depth[same], rtol=1e-3)
        difference = np.abs(frame.color[same].astype(int) - texture.color[same].astype(int))
        assert np.median(difference) <= 1


def test_sky_above_ground_below(renderer):
    frame = renderer.draw(Plan((Sky(), Ground())), look(0.0), measured=True)
    assert (frame.object_ids[:115] == -1).all()
    assert (frame.object_ids[130:] == -2).all()
    assert np.isinf(frame.depth[:115]).all()
    assert frame.depth[-1, 160] == pytest.approx(1.7 * FOCAL / 119.5, rel=1e-3)
    np.testing.assert_allclose(frame.color[118, 160], SKY_HORIZON, atol=6)


def test_impostors_from_the_reference_viewpoint_equal_the_geometry(scene, impostor, renderer):
    for azimuth in np.linspace(0.1, 2 * math.pi, 7):
        truth = renderer.draw(everything(scene), look(azimuth), measured=True)
        shown = renderer.draw(layered(impostor), look(azimuth), measured=True)
        assert np.mean(truth.object_ids != shown.object_ids) < 0.004
        assert shown.displacement.max() * FOCAL < 0.1
        assert (truth.object_ids == -2).sum() > 0


def test_impostors_from_the_cells_ends_are_nearly_right(scene, impostor, renderer):
    for x in (-19.0, 19.0):
        for azimuth in (0.0, math.pi, 1.2):
            truth = renderer.draw(everything(scene), look(azimuth, x=x), measured=True)
            shown = renderer.draw(layered(impostor), look(azimuth, x=x), measured=True)
            assert np.mean(truth.object_ids != shown.object_ids) < 0.02


def test_displacement_is_measured_where_meshes_lie_off_the_surface(impostor, renderer):
    """Seen from far outside the cell, corners that the grid rounds off are displaced, and the measure says so."""
    shown = renderer.draw(layered(impostor), look(0.0, x=-60.0), measured=True)
    assert shown.displacement.max() * FOCAL > 0.1


def test_a_set_of_objects_draws_only_those(scene, renderer):
    frame = renderer.draw(Plan((Sky(), Objects("two", np.array([2, 9])))), look(0.3, z=60.0), measured=True)
    assert set(np.unique(frame.object_ids)) <= {-1, 2, 9}
    assert frame.triangles == scene.mesh.triangle_counts[[2, 9]].sum() + 1


def test_layers_come_and_go(scene, impostor):
    with Renderer(scene.mesh, ground_mesh(scene.city, margin=50.0), size=(64, 48)) as other:
        view = level_view(np.zeros(3), 0.0, focal=50.0, window=(-32, -24, 64, 48))
        with pytest.raises(KeyError):
            other.draw(layered(impostor), view)
        other.upload("made", impostor)
        assert other.holds("made", impostor.cell.id)
        assert other.draw(layered(impostor), view).draws == 3 + len(impostor.layers)
        other.evict("made", impostor.cell.id)
        assert not other.holds("made", impostor.cell.id)
        with pytest.raises(ValueError, match="measured"):
            other.draw(Plan((Sky(),)), view, measured=True)


def test_cross_fading_mixes_two_pictures(scene, renderer):
    one, other = everything(scene), Plan((Sky(),))
    a, b = renderer.draw(one, look(0.3)).color.astype(int), renderer.draw(other, look(0.3)).color.astype(int)
    mixed = renderer.draw(Plan(one.draws, fading=other.draws, mix=0.25), look(0.3)).color.astype(int)
    assert np.abs(mixed - (0.25 * a + 0.75 * b)).max() <= 1.0


def test_the_same_plan_gives_the_same_picture(impostor, renderer):
    first, second = (renderer.draw(layered(impostor), look(1.0)) for _ in range(2))
    assert np.array_equal(first.color, second.color)
