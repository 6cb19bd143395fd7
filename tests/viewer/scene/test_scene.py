"""What is walked through: a city as it was read is the same as the dataset that is built of it, but for impostors."""

import math
from dataclasses import fields, replace

import numpy as np
import pytest
from cities import block, city_of, crossroads, streets
from moving import movers_of

from mmi.appearance.city_mesh import CityMesh
from mmi.building.dataset import build_dataset
from mmi.city.terrain import Terrain
from mmi.dataset.reading import open_dataset
from mmi.foundation.camera import Camera
from mmi.foundation.errors import ParameterError
from mmi.planning.parameters import BuildParameters
from viewer.drawing.renderer import Renderer
from viewer.plan import Budget
from viewer.scene.scene import open_scene, scene_of_city
from viewer.techniques.catalogue import make_technique
from viewer.walks.random_views import random_views
from viewer.walks.tour import tour

CAMERA = Camera(160, 120, math.radians(75.0))


def hilly():
    """A long row of houses and a tower on a hillside, along two streets that meet."""
    terrain = Terrain((-300.0, -300.0), 50.0, np.linspace(0.0, 9.0, 169).reshape(13, 13))
    row, tower = block("row", -60.0, 8.0, 60.0, 20.0, 15.0), block("tower", 20.0, -30.0, 30.0, -9.0, 40.0)
    return replace(
        city_of(row, tower), streets=streets([(-60.0, 0.0), (10.0, 0.0)], [(10.0, 0.0), (10.0, -60.0)]), terrain=terrain
    )


@pytest.fixture(scope="module", params=["crossroads", "hilly"])
def both(request, tmp_path_factory):
    """The city's scene and that of its dataset, for the same display."""
    city = crossroads() if request.param == "crossroads" else hilly()
    folder = tmp_path_factory.mktemp("scene") / "built"
    build_dataset(city, folder, BuildParameters(max_error_px=20.0, pictures="none"))
    return scene_of_city(city, name="multi-mesh", camera=CAMERA), open_scene(
        open_dataset(folder), name="multi-mesh", camera=CAMERA
    )


def test_geometry_and_cells_are_those_of_the_dataset(both):
    city, dataset = both
    for mesh in ("mesh", "ground"):
        for one in fields(CityMesh):
            np.testing.assert_array_equal(
                getattr(getattr(city, mesh), one.name), getattr(getattr(dataset, mesh), one.name)
            )
    np.testing.assert_array_equal(city.boxes, dataset.boxes)
    np.testing.assert_array_equal(city.tiles, dataset.tiles)
    assert city.whereabouts.cells == dataset.whereabouts.cells
    assert city.whereabouts.adjacency == dataset.whereabouts.adjacency
    assert any(city.whereabouts.adjacency.values())
    assert city.objects == dataset.objects
    assert (city.source, city.ground_height) == (dataset.source, dataset.ground_height)


def test_views_and_tours_are_those_of_the_dataset(both):
    one, other = (random_views(scene.whereabouts.cells, 20, seed=3, terrain=scene.terrain) for scene in both)
    assert one == other
    one, other = (tour(scene.whereabouts.cells, scene.whereabouts.adjacency, metres=80.0, seed=2) for scene in both)
    assert one == other


def test_pictures_are_those_of_the_dataset_pixel_for_pixel(both):
    drawn = []
    for scene in both:
        full = make_technique("full", {"multi-mesh": scene})
        poses = random_views(scene.whereabouts.cells, 4, seed=8, terrain=scene.terrain)
        with Renderer(scene.mesh, scene.ground, size=(CAMERA.width, CAMERA.height), measured=True) as renderer:
            views = [pose.view(scene.camera) for _, pose in poses]
            drawn.append(
                [renderer.draw(full.plan(view, now=0.0, budget=Budget()), view, measured=True) for view in views]
            )
    for one, other in zip(*drawn, strict=True):
        np.testing.assert_array_equal(one.color, other.color)
        np.testing.assert_array_equal(one.depth, other.depth)
        np.testing.assert_array_equal(one.object_ids, other.object_ids)
        assert len(np.unique(one.color)) > 10


def test_without_a_dataset_everything_is_near_and_there_is_nothing_else(both):
    city, _ = both
    place = city.cell(city.whereabouts.cells[0].id)
    assert place.near.tolist() == place.visible.tolist() == list(range(len(city.objects)))
    assert place.layers == place.layers_in(random_views([place.cell], 1, seed=1)[0][1].view(CAMERA)) == ()
    with pytest.raises(ParameterError, match=r"one of .* cells expected, found 'none'"):
        city.cell("none")
    for name in ("dataset", "parameters"):
        with pytest.raises(ParameterError, match="made: a dataset expected, which build-impostors makes of it"):
            getattr(city, name)


def test_long_objects_are_cut_as_builds_cut_them_or_not_at_all():
    assert sorted(scene_of_city(hilly(), name="x", camera=CAMERA).objects) == ["row#0", "row#1", "row#2", "tower"]
    assert sorted(scene_of_city(hilly(), name="x", camera=CAMERA, longest_object=None).objects) == ["row", "tower"]


def test_movers_are_put_into_the_frame_of_the_city():
    movers = movers_of([[(0.0, 5.0, 2.0, 0.0, 0.0)]], crs="EPSG:32631")
    scene = scene_of_city(replace(crossroads(), origin=(100.0, 0.0, 0.0)), name="x", camera=CAMERA, movers=movers)
    expected = movers.in_frame(crs="EPSG:32631", origin=(100.0, 0.0, 0.0))
    assert scene.movers.ids == expected.ids
    assert scene.skyline is not None
    with pytest.raises(ParameterError, match="EPSG:25832"):
        scene_of_city(
            crossroads(), name="x", camera=CAMERA, movers=movers_of([[(0.0, 5.0, 2.0, 0.0, 0.0)]], crs="EPSG:25832")
        )


def test_a_city_whose_streets_have_no_room_has_nothing_to_walk_through():
    full = city_of(block("all", -30.0, -30.0, 30.0, 30.0, 10.0))
    with pytest.raises(ParameterError, match="made: streets with room for a viewing cell expected, found none"):
        scene_of_city(full, name="x", camera=CAMERA)


def test_another_display_than_the_one_built_for_is_that_of_the_scene(dataset, scene):
    other = open_scene(dataset, name="multi-mesh", camera=CAMERA)
    assert (other.camera, other.parameters.camera) == (CAMERA, scene.camera)
    assert open_scene(dataset, name="again", like=other).camera == CAMERA
