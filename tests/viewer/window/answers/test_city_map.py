"""The map: outlines against the city's footprints, cells against the manifest, and never more than it may be."""

import json
from dataclasses import replace

import numpy as np
import pytest
import shapely
from shapely.geometry import Point, Polygon

import viewer.window.answers.city_map as module
from mmi.city.model import CityObject, Prism
from viewer.window.answers.city_map import CityMap


@pytest.fixture(scope="module")
def city(dataset):
    return dataset.city()


def plain(told):
    """What a page gets."""
    return json.loads(json.dumps(told, allow_nan=False))


def polygon(rings):
    """One part with its holes: the first ring and those within it."""
    outer, *others = [Polygon(ring) for ring in rings]
    return outer.difference(shapely.union_all(others)) if others else outer


def test_footprints_are_the_citys_with_their_courtyards(scene, city):
    told = plain(CityMap(scene, city).told((0.0, 0.0)))
    assert told["whole"]
    found = {one["id"]: polygon(one["rings"]) for one in told["footprints"]}
    assert found.keys() == {one.id for one in city.objects}
    for one in city.objects:
        assert found[one.id].symmetric_difference(one.footprint).area < 0.02 * one.footprint.area
    assert len(next(one for one in told["footprints"] if one["id"] == "block/13")["rings"]) == 2
    x0, y0, x1, y1 = told["bounds"]
    assert (x0, y0) <= (-150.0, -150.0) and (x1, y1) >= (150.0, 150.0)


def test_outlines_are_simplified_and_stay_within_half_a_metre(scene, city):
    round_one = Polygon(Point(0.0, 0.0).buffer(30.0, quad_segs=64).exterior)
    objects = (*city.objects[1:], CityObject(city.objects[0].id, (Prism(round_one, 0.0, 9.0),)))
    told = CityMap(scene, replace(city, objects=objects)).told((0.0, 0.0))
    (ring,) = next(one["rings"] for one in told["footprints"] if one["id"] == city.objects[0].id)
    assert len(ring) < 40
    assert Polygon(ring).hausdorff_distance(round_one) < 0.6


def test_each_cell_is_told_as_the_manifest_has_it(scene, city):
    told = plain(CityMap(scene, city).told((0.0, 0.0)))
    entries = {entry.id: entry for entry in scene.dataset.manifest.cells}
    assert {cell["id"] for cell in told["cells"]} == entries.keys()
    unseen = 0
    for cell in told["cells"]:
        entry = entries[cell["id"]]
        np.testing.assert_allclose(cell["axis"], entry.axis, atol=0.06)
        assert cell["near"] == list(entry.near)
        assert sorted([*cell["layers"], *cell["unseen"]]) == sorted(entry.far)
        for _, one in entry.pictures:
            for place in one.objects:
                assert cell["layers"][entry.far[place]] in {
                    other.index for _, other in entry.pictures if place in other.objects
                }
        unseen += len(cell["unseen"])
    assert sum(len(cell["layers"]) for cell in told["cells"]) > 0


def test_a_metropolis_is_told_around_the_viewer_and_no_more_than_that(scene, city, monkeypatch):
    monkeypatch.setattr(module, "_MOST_POINTS", 22)
    monkeypatch.setattr(module, "_MOST_CELLS", 7)
    monkeypatch.setattr(module, "_MOST_ENTRIES", 40)
    made = CityMap(scene, city)
    for around in ((140.0, 0.0), (0.0, -150.0)):
        told = made.told(around)
        assert not told["whole"]
        assert sum(len(ring) + 1 for one in told["footprints"] for ring in one["rings"]) <= 22
        shown = {one["id"] for one in told["footprints"]}
        away = {one.id: one.footprint.centroid.distance(Point(around)) for one in city.objects}
        assert max(away[one] for one in shown) <= min(away[one] for one in away.keys() - shown)
        assert len(told["cells"]) == 7
        references = {entry.id: Point(entry.reference[:2]) for entry in scene.dataset.manifest.cells}
        order = [references[cell["id"]].distance(Point(around)) for cell in told["cells"]]
        assert order == sorted(order)
        entries = [
            len(cell["near"]) + len(cell["layers"]) + len(cell["unseen"]) for cell in told["cells"] if "near" in cell
        ]
        assert 0 < len(entries) < 7 and sum(entries) <= 40
    assert made.told((140.0, 0.0)) != made.told((0.0, -150.0))


def test_what_is_whole_is_worked_out_once(scene, city):
    made = CityMap(scene, city)
    assert made.told((0.0, 0.0)) is made.told((90.0, 9.0))
