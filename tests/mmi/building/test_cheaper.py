"""A cell costs no more than its visible geometry: held against datasets in which every far object is in a layer."""

from dataclasses import replace

import pytest
from cities import block, city_of
from manifests import sign_again
from model_cities import open_box

from mmi.appearance.city_mesh import build_city_mesh
from mmi.building.cheaper import cheaper_as_geometry
from mmi.building.city_costs import city_costs, triangles_as_read
from mmi.building.dataset import build_dataset
from mmi.building.planned_again import planned_again, prepared_again
from mmi.city.long_objects import cut_objects
from mmi.dataset.reading import open_dataset
from mmi.foundation.camera import Camera
from mmi.foundation.errors import DatasetError
from mmi.planning.frame_costs import FrameCosts, FrameLoad
from mmi.planning.parameters import BuildParameters
from mmi.planning.reasons import near_reasons

TRIANGLES = FrameCosts(0.0, 0.0, 0.0)
NEAR = BuildParameters(near_distance=15.0, camera=Camera(128, 128, 1.0), cell_length=40.0, costs=TRIANGLES)


def street():
    """A street with a row of many thin houses at its end on one side, and single houses far off on the other."""
    row = [block(f"row {i}", 60.0 + 2.0 * i, 20.0, 62.0 + 2.0 * i, 30.0, 8.0 + i % 3) for i in range(40)]
    single = [
        block(f"single {i}", 90.0 * i, -60.0 - 20.0 * i, 90.0 * i + 15.0, -45.0 - 20.0 * i, 9.0) for i in range(4)
    ]
    return city_of(*row, *single, lines=([(0.0, 0.0), (160.0, 0.0)],))


@pytest.fixture(scope="module")
def datasets(tmp_path_factory):
    """The street with every far object in a layer, and with what is cheaper as geometry."""
    found = []
    for geometry in ("near", "cheaper"):
        out = tmp_path_factory.mktemp(geometry) / "out"
        build_dataset(street(), out, replace(NEAR, geometry=geometry))
        found.append(open_dataset(out))
    return found


def counts_of(dataset):
    city = dataset.city()
    counts = build_city_mesh(city).triangle_counts
    return {one.id: int(count) for one, count in zip(city.objects, counts, strict=True)}


def test_what_the_manifest_says_of_frames_is_what_is_there(datasets):
    for dataset in datasets:
        counts = counts_of(dataset)
        for entry in dataset.manifest.cells:
            frame = entry.frame
            near, far = (sum(counts[name] for name in names) for names in (entry.near, entry.far))
            assert frame.geometry.triangles == near + far
            assert (frame.geometry.draws, frame.geometry.texels, frame.geometry.bytes) == (1, 0, 0)
            assert near == entry.near_triangles
            if entry.pictures:
                assert frame.layers.triangles == near + sum(one.triangles for _, one in entry.pictures)
                assert frame.layers.texels == sum(one.window[2] * one.window[3] for _, one in entry.pictures)
                assert frame.layers.bytes == sum(
                    (dataset.path / file.name).stat().st_size for file in (entry.files.glb, entry.files.exr)
                )
                assert frame.layers.draws == (near > 0) + 1


def test_layers_are_kept_that_have_fewer_triangles_than_what_is_in_them(datasets):
    whole, cheaper = datasets
    counts, kept, dropped = counts_of(whole), 0, 0
    prepared = prepared_again(whole, whole.city())
    names = [one.id for one in prepared.city.objects]
    for entry in whole.manifest.cells:
        plan = planned_again(whole, prepared, entry)
        stays = set(entry.near)
        for index, members in enumerate(plan.layers):
            shown = sum(one.triangles for _, one in entry.pictures if one.index == index)
            inside = [names[i] for i in members]
            if shown >= sum(counts[name] for name in inside):
                stays |= set(inside)
                dropped += 1
            else:
                kept += 1
        found = cheaper.cell(entry.id)
        assert set(found.near) == stays
        assert set(found.near) | set(found.far) == set(entry.near) | set(entry.far)
        assert [one.index for _, one in found.pictures if one.index >= found.layer_count] == []
    assert kept
    assert dropped


def test_no_cell_costs_more_than_its_visible_geometry(datasets):
    whole, cheaper = datasets
    assert any(one.frame.layers.cost > one.frame.geometry.cost for one in whole.manifest.cells)
    for entry in cheaper.manifest.cells:
        assert entry.near_triangles + entry.triangles <= entry.frame.geometry.triangles
        assert entry.promised_error_px == NEAR.max_error_px


def test_a_cell_whose_files_cost_too_much_is_stored_as_geometry(tmp_path, datasets):
    dear = replace(NEAR, geometry="cheaper", costs=FrameCosts(0.0, 0.0, 1e6))
    summary = build_dataset(street(), tmp_path / "out", dear)
    dataset = open_dataset(tmp_path / "out")
    for entry, by_triangles in zip(dataset.manifest.cells, datasets[1].manifest.cells, strict=True):
        assert (entry.pictures, entry.far, entry.files.exr) == ([], (), None)
        assert entry.near_triangles == entry.frame.geometry.triangles
        if by_triangles.pictures:
            assert entry.frame.layers.cost > entry.frame.geometry.cost
            assert entry.frame.layers.bytes == by_triangles.bytes, "the manifest says what was compared"
        assert (entry.displacement_px, entry.missed_px, entry.promised_error_px) == (0.0, 0.0, NEAR.max_error_px)
        assert not (tmp_path / "out" / "cells" / f"{entry.id}.exr").exists()
    assert summary.costs.as_geometry == summary.cells
    assert summary.withheld == {}


def test_all_geometry_is_promised_even_of_detailed_meshes(tmp_path):
    """Nothing is a picture, so nothing of a picture can be wrong."""
    city = street()
    first, *others = city.objects
    detailed = replace(city, objects=(replace(first, mesh=open_box()), *others))
    dear = replace(NEAR, geometry="cheaper", costs=FrameCosts(0.0, 0.0, 1e6))
    summary = build_dataset(detailed, tmp_path / "out", dear, max_cells=1)
    assert (summary.costs.as_geometry, summary.withheld) == (1, {})


def test_budgets_come_first(datasets):
    entry = next(one for one in datasets[0].manifest.cells if one.pictures)
    cheap = replace(entry.frame.geometry, triangles=500, cost=1.0)
    entry = replace(entry, frame=replace(entry.frame, geometry=cheap))
    told = replace(NEAR, geometry="cheaper")
    assert cheaper_as_geometry(told, entry)
    assert not cheaper_as_geometry(replace(told, max_triangles=499), entry)
    assert not cheaper_as_geometry(NEAR, entry)


def test_plans_are_made_again_with_what_was_cheaper(datasets):
    _, cheaper = datasets
    prepared = prepared_again(cheaper, cheaper.city())
    told = 0
    for entry in cheaper.manifest.cells:
        plan = planned_again(cheaper, prepared, entry)
        assert len(plan.layers) == entry.layer_count
        for index in plan.cheaper.tolist():
            (reason,) = near_reasons(prepared, plan, index)
            assert reason.rule == "cost"
            told += 1
    assert told


def test_a_manifest_whose_costs_do_not_add_up_is_refused(datasets, tmp_path):
    _, cheaper = datasets
    build_dataset(street(), tmp_path / "out", cheaper.manifest.parameters, max_cells=1)

    def edit(document):
        document["cells"][0]["frame"]["geometry"]["cost"] += 1.0

    sign_again(tmp_path / "out", edit)
    with pytest.raises(DatasetError, match="a frame that costs"):
        open_dataset(tmp_path / "out")


def test_costs_of_the_city_are_sums_and_means(datasets):
    dataset = datasets[1]
    cells = dataset.manifest.cells
    costs = city_costs(dataset.manifest, objects_read=44, triangles_read=440, all_metres=320.0)
    assert costs.metres == pytest.approx(160.0, abs=20.0)
    assert costs.share == pytest.approx(costs.metres / 320.0)
    assert costs.cell_bytes == sum(one.bytes for one in cells) == dataset.manifest.bytes - costs.shared_bytes
    assert costs.bytes_a_metre == pytest.approx(costs.cell_bytes / costs.metres)
    assert costs.estimated_bytes == pytest.approx(costs.shared_bytes + costs.bytes_a_metre * 320.0)
    stored = [one.near_triangles + one.triangles for one in cells]
    assert (costs.frame_triangles, costs.largest_frame) == (pytest.approx(sum(stored) / len(stored)), max(stored))
    assert costs.worst_px <= NEAR.max_error_px


def test_triangles_as_read_are_those_before_long_objects_are_cut():
    city = city_of(block("short", 0.0, 0.0, 10.0, 10.0, 9.0), block("long", 0.0, 20.0, 100.0, 30.0, 9.0))
    cut = cut_objects(city, 40.0)
    stored = len(build_city_mesh(cut).triangles)
    assert stored > 20
    assert triangles_as_read(city, stored, cut) == 2 * 10 == len(build_city_mesh(city).triangles)
    assert triangles_as_read(cut, stored, cut) == stored


def test_a_frame_of_nothing_costs_nothing():
    assert FrameLoad(0, 0).cost(FrameCosts()) == 0.0
