"""Comparisons where pictures are captured at run time: datasets without any, and windows that mirror the sun."""

import json
from dataclasses import replace
from pathlib import Path

import jsonschema
import pytest
from cities import crossroads

import viewer
from mmi.building.dataset import build_dataset
from mmi.dataset.reading import open_dataset
from mmi.walks.walk import Keyframe, Pose, Walk
from viewer.report.compare import CompareOptions, compare_views, compare_walk

SCHEMA = json.loads((Path(viewer.__file__).parent / "report" / "schemas" / "report.json").read_text())
WALK = Walk("east", (Keyframe(0.0, Pose((20.0, 0.0, 1.7), 0.2, 0.0)), Keyframe(4.0, Pose((60.0, 0.0, 1.7), -0.2, 0.0))))


@pytest.fixture(scope="module")
def bare(dataset, tmp_path_factory):
    out = tmp_path_factory.mktemp("bare") / "out"
    build_dataset(crossroads(), out, replace(dataset.manifest.parameters, pictures="none"))
    return out


def test_a_dataset_without_pictures_is_as_good_as_one_with_them(dataset, bare, tmp_path):
    """Single-mesh, which a comparison builds, is without pictures then as well."""
    options = CompareOptions(techniques=("single-mesh", "multi-mesh"), flip=False, keep=0)
    reports = [
        compare_views(path, tmp_path / name, views=6, seed=5, options=options)
        for path, name in ((dataset.path, "whole"), (bare, "bare"))
    ]
    assert open_dataset(tmp_path / "bare" / "single-mesh").manifest.parameters.pictures == "none"
    for name in ("single-mesh", "multi-mesh"):
        whole, captured = (report["techniques"][name] for report in reports)
        assert captured["psnr_db"] > whole["psnr_db"] - 0.5
        assert captured["wrong_share"] < 1.5 * whole["wrong_share"]
        assert captured["wrong_thickness_px"]["max"] <= dataset.manifest.parameters.max_error_px + 2.0 or (
            name == "single-mesh"
        )


def test_a_walk_waits_for_what_is_captured_as_for_what_is_read(bare, tmp_path):
    options = CompareOptions(techniques=("multi-mesh",), flip=False, keep=0, frames_per_second=5.0, scored=2)
    report = compare_walk(bare, tmp_path, WALK, options=options)
    jsonschema.validate(report, SCHEMA)
    loading = report["techniques"]["multi-mesh"]["loading"]
    assert loading["bytes_loaded"] > 0
    assert report["techniques"]["multi-mesh"]["ssim"] > 0.98


@pytest.mark.slow
def test_windows_that_mirror_the_sun_are_wrong_in_stored_pictures_and_right_in_captured_ones(dataset, tmp_path):
    techniques = ("full", "visible", "multi-mesh", "multi-mesh-dynamic")
    options = CompareOptions(techniques=techniques, flip=False, keep=0, settle=8)
    plain, shining = (
        compare_views(dataset.path, tmp_path / str(glint), views=6, seed=26, options=replace(options, glint=glint))
        for glint in (False, True)
    )
    for report in (plain, shining):
        jsonschema.validate(report, SCHEMA)
    assert (plain["glint"], shining["glint"]) == (False, True)
    assert shining["techniques"]["visible"]["psnr_db"] is None, "equal: the reference has it too"
    stored, captured = (
        [report["techniques"][name]["psnr_db"] for report in (plain, shining)]
        for name in ("multi-mesh", "multi-mesh-dynamic")
    )
    assert stored[1] < stored[0] - 0.05
    assert captured[1] > stored[1] + 5.0
    page = [(tmp_path / str(glint) / "report.html").read_text() for glint in (False, True)]
    assert ["windows mirror the sun" in text for text in page] == [False, True]
