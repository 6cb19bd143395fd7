"""Comparisons of a small dataset, from end to end."""

import json
from dataclasses import replace
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from cities import crossroads
from moving import block, movers_of
from PIL import Image
from techniques_drawn import OF_DATASETS

import viewer
from mmi.building.dataset import build_dataset
from mmi.foundation.errors import DatasetError, ParameterError
from mmi.walks.walk import Keyframe, Pose, Walk
from viewer.drawing.opengl import is_software
from viewer.measuring.summary import ERRORS
from viewer.report.compare import CompareOptions, compare_views, compare_walk
from viewer.techniques.virtual_frames import FrameRules

SCHEMA = json.loads((Path(viewer.__file__).parent / "report" / "schemas" / "report.json").read_text())
WALK = Walk("east", (Keyframe(0.0, Pose((20.0, 0.0, 1.7), 0.2, 0.0)), Keyframe(4.0, Pose((60.0, 0.0, 1.7), -0.2, 0.0))))


@pytest.fixture(scope="module")
def views(dataset, tmp_path_factory):
    out = tmp_path_factory.mktemp("views")
    return out, compare_views(
        dataset.path, out, views=6, seed=5, options=CompareOptions(techniques=tuple(OF_DATASETS), keep=2)
    )


@pytest.fixture(scope="module")
def walked(dataset, tmp_path_factory):
    out = tmp_path_factory.mktemp("walk")
    options = CompareOptions(
        techniques=tuple(OF_DATASETS), frames_per_second=5.0, scored=4, keep=1, video="webp", fade=0.0
    )
    told = []
    report = compare_walk(dataset.path, out, WALK, options=options, progress=lambda *what: told.append(what))
    return out, report, told


def test_the_report_is_written_and_keeps_its_schema(views, walked):
    for out, report, *_ in (views, walked):
        jsonschema.validate(report, SCHEMA)
        assert json.loads((out / "report.json").read_text()) == report
        page = (out / "report.html").read_text()
        assert all(name in page for name in OF_DATASETS)
        for worst in report["worst"]:
            with Image.open(out / worst["picture"]) as picture:
                assert picture.size[0] > 3 * report["display"]["width"] - 1


def test_geometry_has_no_errors_and_local_geometry_lacks_what_is_far(views, dataset):
    techniques = views[1]["techniques"]
    assert techniques["visible"]["wrong_share"] == techniques["visible"]["flip"]["mean"] == 0.0
    assert techniques["visible"]["psnr_db"] is None
    assert techniques["local"]["hole_share"] > 10 * techniques["multi-mesh"]["hole_share"]
    assert techniques["local"]["displacement_px"]["max"] == 0.0
    assert techniques["multi-mesh"]["wrong_thickness_px"]["max"] < dataset.manifest.parameters.max_error_px + 2.0
    assert techniques["multi-mesh"]["ssim"] > 0.98


def test_the_reference_is_not_compared_with_itself(dataset, tmp_path, monkeypatch, views, walked):
    for _, report, *_ in (views, walked):
        full = report["techniques"]["full"]
        assert {full[key] for key in (*ERRORS, "pop", "loading")} == {None}
        assert full["frame_ms"]["p50"] > 0.0
        assert set(report["scored"]) == set(OF_DATASETS) - {"full"}
    monkeypatch.setattr("viewer.measuring.judge.view_errors", None)  # nothing is compared
    alone = CompareOptions(techniques=("full",), frames_per_second=2.0)
    for report in (
        compare_views(dataset.path, tmp_path, views=1, options=alone),
        compare_walk(dataset.path, tmp_path, WALK, options=alone),
    ):
        jsonschema.validate(report, SCHEMA)
        assert report["scored"] == {}
        assert "what the others are compared with" not in (tmp_path / "report.html").read_text()


def test_times_of_the_gpu_are_left_out_where_there_is_none(views, walked):
    for out, report, *_ in (views, walked):
        for one in report["techniques"].values():
            assert (one["gpu_ms"] is None) == is_software(report["device"])
        assert ("GPU, ms" in (out / "report.html").read_text()) == (not is_software(report["device"]))


def test_what_was_built_without_a_bound_promises_nothing(tmp_path):
    from cities import crossroads

    from mmi.building.dataset import build_dataset
    from mmi.planning.parameters import BuildParameters

    parameters = BuildParameters(weights="critical-zone", max_error_px=5.0)
    build_dataset(crossroads(), tmp_path / "unbounded", parameters, cells=["0000-00"])
    options = CompareOptions(techniques=("multi-mesh",), flip=False, keep=0)
    report = compare_views(tmp_path / "unbounded", tmp_path / "out", views=1, options=options)
    assert report["source"]["promised_px"] is None
    assert report["source"]["max_error_px"] == 5.0
    assert report["source"]["promising_cells"] == 0
    assert "none of the cells promises" in (tmp_path / "out" / "report.html").read_text()


def test_what_was_built_with_a_bound_promises_two_pixels_more(views):
    assert views[1]["source"]["promised_px"] == views[1]["source"]["max_error_px"] + 2.0
    assert 0 < views[1]["source"]["promising_cells"] <= views[1]["source"]["cells"]


def test_the_same_views_score_the_same(views, dataset, tmp_path):
    """In other processes, and without single-mesh, which was built beside the first report."""
    options = CompareOptions(techniques=("multi-mesh",), keep=0, workers=2)
    again = compare_views(dataset.path, tmp_path, views=6, seed=5, options=options)
    one, other = (report["techniques"]["multi-mesh"] for report in (views[1], again))
    for key in ("hole_share", "wrong_share", "wrong_thickness_px", "displacement_px", "flip", "psnr_db", "ssim"):
        assert one[key] == pytest.approx(other[key])
    assert again["worst"] == []
    assert again["ratios"]["multi-mesh"] == {"full": None, "visible": None, "local": None}


def test_worst_views_are_the_thickest_errors_and_the_pictures_show_them(views):
    out, report = views
    scores = {name: [one["wrong_thickness_px"] for one in some] for name, some in report["scored"].items()}
    for name in ("local", "multi-mesh"):
        worst = [one for one in report["worst"] if one["technique"] == name]
        assert [one["wrong_thickness_px"] for one in worst] == sorted(scores[name], reverse=True)[: len(worst)]
    local = next(one for one in report["worst"] if one["technique"] == "local")
    with Image.open(out / local["picture"]) as picture:
        panel = np.asarray(picture.convert("RGB")).astype(int)
    pixels = report["display"]["width"] * report["display"]["height"]
    magenta = (np.abs(panel - [255, 0, 255]).max(axis=2) < 10).sum()
    assert magenta == pytest.approx(local["hole_share"] * pixels, rel=0.1)


def test_a_walk_is_told_frame_by_frame(walked):
    out, report, told = walked
    frames = report["walk"]["frames"]
    assert frames == 21
    assert report["walk"]["metres"] == pytest.approx(40.0, rel=0.01)
    for series in report["series"].values():
        assert len(series["frame_ms"]) == len(series["cell"]) == frames
        assert min(series["frame_ms"]) > 0.0
    switches = report["series"]["multi-mesh"]["switch"]
    assert len(switches) == 1
    assert report["techniques"]["multi-mesh"]["pop"]["switches"] == 1
    assert abs(report["techniques"]["multi-mesh"]["pop"]["max"]) < 0.05
    assert report["techniques"]["full"]["pop"] is None
    assert len(report["scored"]["multi-mesh"]) == 4
    assert report["videos"] == ["walk.webp"]
    with Image.open(out / "walk.webp") as film:
        assert film.n_frames == frames
    assert {what for *_, what in told} >= {"frames timed", "frames scored", "cells of single-mesh"}
    timed = [done for done, _, what in told if what == "frames timed"]
    assert timed == [*range(len(OF_DATASETS) * frames), len(OF_DATASETS) * frames]


def test_what_moves_is_compared_in_every_technique(dataset, tmp_path):
    tracks = [[(0.0, 120, -3, 0, 180), (9.0, 30, -3, 0, 180)], [(0.0, 80, 2, 0, 0)], [(0.0, 140, 80, 0, 0)]]
    movers = movers_of(tracks, crs="EPSG:32631", mesh=block(high=(2.0, 1.0, 2.5)))
    rules = FrameRules(thrifty=False)
    options = CompareOptions(
        techniques=("full", "local", "multi-mesh"),
        frames_per_second=5.0,
        scored=3,
        flip=False,
        movers=movers,
        mover_frames=rules,
        video="webp",
    )
    report = compare_walk(dataset.path, tmp_path / "walk", WALK, options=options)
    jsonschema.validate(report, SCHEMA)
    assert report["movers"] == {
        "source": "movers",
        "objects": 3,
        "max_error_px": 1.0,
        "calculation": "predictive",
        "time_s": None,
    }
    found = {name: one["movers"] for name, one in report["techniques"].items()}
    for name in ("full", "local"):
        assert found[name]["geometry"] > 0.8
        assert found[name]["captured"] == found[name]["reused"] == 0.0
        assert found[name]["valid_frames"] is None
    assert found["multi-mesh"]["hidden"] > 0.2
    assert found["full"]["hidden"] == 0.0
    assert found["local"]["hidden"] == found["multi-mesh"]["hidden"]
    sums = [sum(found[name][key] for key in ("geometry", "captured", "reused", "hidden")) for name in found]
    assert sums == pytest.approx([sums[0]] * 3)
    assert found["multi-mesh"]["reused"] > 0.2
    assert report["techniques"]["multi-mesh"]["wrong_thickness_px"]["max"] < 7.0
    views = replace(options, video=None, settle=3, movers_time=4.0)
    report = compare_views(dataset.path, tmp_path / "views", views=3, seed=2, options=views)
    jsonschema.validate(report, SCHEMA)
    assert report["movers"]["time_s"] == 4.0
    assert report["techniques"]["multi-mesh"]["settling"]["unsettled"] == 0


def test_movers_of_another_coordinate_system_are_refused(dataset, tmp_path):
    options = CompareOptions(movers=movers_of([[(0.0, 0, 0, 0, 0)]], crs="EPSG:3879"))
    with pytest.raises(ParameterError, match="coordinate system EPSG:32631 expected, found EPSG:3879"):
        compare_views(dataset.path, tmp_path / "out", views=1, options=options)
    assert not (tmp_path / "out").exists()


def test_what_loading_took_is_told(walked):
    loading = walked[1]["techniques"]["multi-mesh"]["loading"]
    assert loading["bytes_loaded"] > 0
    assert loading["largest_cache_bytes"] <= loading["bytes_loaded"]
    assert walked[1]["techniques"]["local"]["loading"] is None


@pytest.mark.parametrize(
    ("changed", "named"),
    [
        ({"techniques": ("magic",)}, "techniques"),
        ({"techniques": ()}, "techniques"),
        ({"techniques": ("full", "full")}, "techniques"),
        ({"frames_per_second": float("nan")}, "frames_per_second"),
        ({"fade": -1.0}, "fade"),
        ({"cache": 0}, "cache"),
        ({"scored": 0}, "scored"),
        ({"settle": 0}, "settle"),
        ({"budget_ms": -1.0}, "budget_ms"),
        ({"budget_ms": float("nan")}, "budget_ms"),
    ],
)
def test_options_without_meaning_are_refused(changed, named):
    with pytest.raises(ParameterError, match=named):
        CompareOptions(**changed)


def test_no_dataset_and_a_report_inside_of_one_are_refused(dataset, tmp_path):
    with pytest.raises(DatasetError, match="nothing"):
        compare_views(tmp_path / "missing", tmp_path / "out", views=1)
    with pytest.raises(ParameterError, match="outside"):
        compare_views(dataset.path, dataset.path / "report", views=1)
    assert not (dataset.path / "report").exists()


def test_the_baseline_is_not_compared_with_itself_nor_built_over_what_is_compared(single, dataset, tmp_path):
    with pytest.raises(ParameterError, match="single"):
        compare_views(single.dataset.path, tmp_path / "out", views=1)
    (tmp_path / "single-mesh").symlink_to(dataset.path)
    with pytest.raises(ParameterError, match="outside"):
        compare_views(tmp_path / "single-mesh", tmp_path, views=1)


def test_a_city_whose_objects_are_all_near_is_compared(dataset, tmp_path):
    """Cells without a single layer."""
    parameters = replace(dataset.manifest.parameters, near_distance=1000.0)
    build_dataset(crossroads(), tmp_path / "near", parameters, cells=["0000-00"])
    options = CompareOptions(techniques=("local", "single-mesh", "multi-mesh"), flip=False)
    report = compare_views(tmp_path / "near", tmp_path / "out", views=2, options=options)
    assert report["techniques"]["multi-mesh"]["wrong_share"] == 0.0


def test_a_fade_pops_less_than_a_switch(dataset, tmp_path):
    """Where cells differ by much: with an error four times as large, and nothing but the nearest walls as geometry."""
    parameters = replace(dataset.manifest.parameters, max_error_px=20.0, near_distance=5.0)
    build_dataset(crossroads(), tmp_path / "coarse", parameters, cells=["0001-00", "0001-01", "0001-02"])
    pops = []
    for fade in (0.0, 0.5):
        options = CompareOptions(techniques=("multi-mesh",), frames_per_second=10.0, scored=1, keep=0, fade=fade)
        report = compare_walk(tmp_path / "coarse", tmp_path / f"{fade}", WALK, options=options)
        pops.append(report["techniques"]["multi-mesh"]["pop"]["max"])
    assert pops[0] > pops[1] >= -0.01
