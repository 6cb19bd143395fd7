"""``place-images`` as a program: what it says, what it refuses in one line, and walks with what it wrote."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from placed_models import blocks, towers

import viewer
from citygen.cli import citygen
from mmi.dataset.city_files import city_glb
from viewer.placed import solutions
from viewer.programs.compare_impostors import compare_impostors
from viewer.programs.place_images import place_images
from viewer.programs.view_impostors import view_impostors

SCHEMA = json.loads((Path(viewer.__file__).parent / "report" / "schemas" / "report.json").read_text())
OPTIONS = ("--budget", "2000", "--optimize", "1400", "--display", "96x72", "--octree-depth", "4", "--pictures", "5")


def run(program, *arguments):
    with pytest.raises(SystemExit) as ended:
        program([str(one) for one in arguments])
    return ended.value.code


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    """A model as a file; what is read of it is not quite what was written, names and grounds of objects for instance."""
    path = tmp_path_factory.mktemp("model") / "towers.glb"
    path.write_bytes(city_glb(towers())[0])
    return path


@pytest.fixture(scope="module")
def folder(model, tmp_path_factory):
    path = tmp_path_factory.mktemp("placed") / "out"
    assert run(place_images, model, "-o", path, *OPTIONS, "--workers", "1", "--quiet") == 0
    return path


def test_it_says_what_it_made_and_that_the_budget_is_kept(model, folder, capsys):
    assert run(place_images, model, "-o", folder, *OPTIONS, "--workers", "1", "--check", "200") == 0
    out = capsys.readouterr().out
    assert "(0 made now)" in out
    of_all, of_some = out.strip().splitlines()[-2:]
    assert of_all.startswith("budget kept: at most ") and of_all.endswith(" points, which are all")
    assert of_some.startswith("budget kept: at most ") and " of 2,000 triangles in 200 views" in of_some
    assert str(folder / "manifest.json") in out


def test_a_model_needs_no_streets_for_cars(tmp_path, capsys):
    """A room has footways alone, which none of the options asks for."""
    assert run(citygen, "living-room", "-o", tmp_path / "room.json") == 0
    assert run(place_images, tmp_path / "room.json", "-o", tmp_path / "out", "--budget", "18000", "--quiet") == 0
    assert (tmp_path / "out" / "manifest.json").exists(), capsys.readouterr().err


def test_what_is_hidden_is_said_in_the_manifest(model, folder, tmp_path):
    options = (*OPTIONS[:-1], "1", "--heights", "1.5,1.9", "--hidden", "--workers", "1", "--quiet")
    assert run(place_images, model, "-o", tmp_path / "out", *options, "--check", "100") == 0
    told, before = (json.loads((path / "manifest.json").read_text()) for path in (tmp_path / "out", folder))
    assert told["hidden"] and not before["hidden"]


@pytest.mark.parametrize(
    ("other", "said"),
    [
        (("--budget", "2100"), "--budget 2000 expected, which the images there were made with, found --budget 2100;"),
        (
            ("--optimize", "1300"),
            "--optimize 1400 expected, which the images there were made with, found --optimize 1300;",
        ),
        (
            ("--display", "90x72"),
            "--display 96x72 expected, which the images there were made with, found --display 90x72;",
        ),
        (("--fov", "61"), "--fov 60 expected, which the images there were made with, found --fov 61;"),
        (("--pitch", "5"), "--pitch 0 expected, which the images there were made with, found --pitch 5;"),
        (
            ("--octree-depth", "5"),
            "--octree-depth 4 expected, which the images there were made with, found --octree-depth 5;",
        ),
        (
            ("--weights", "0.4,0.6,0.2,0.8"),
            "--weights 0.4,0.6,0.1,0.9 expected, which the images there were made with, found ",
        ),
        (
            ("--hidden", "--pictures", "9"),
            "--pictures 5, no --hidden expected, which the images there were made with, found ",
        ),
    ],
)
def test_an_option_that_is_forgotten_is_told_and_nothing_is_replaced(model, folder, capsys, other, said):
    before = {one: one.stat().st_mtime_ns for one in (folder / "images").iterdir()}
    assert run(place_images, model, "-o", folder, *OPTIONS, *other, "--workers", "1", "--quiet") == 2
    line = capsys.readouterr().err.strip().splitlines()[-1]
    assert said in line and line.endswith("; nothing was changed; with --replace they are made anew")
    assert {one: one.stat().st_mtime_ns for one in (folder / "images").iterdir()} == before
    assert (folder / "manifest.json").exists()


def test_a_folder_of_another_model_is_kept(folder, tmp_path, capsys):
    (tmp_path / "others.glb").write_bytes(city_glb(blocks())[0])
    assert run(place_images, tmp_path / "others.glb", "-o", folder, *OPTIONS, "--workers", "1", "--quiet") == 2
    said = "towers.glb, read as it was then expected, which the images there were made with, found others.glb, or other tri"
    assert said in capsys.readouterr().err


def test_a_model_within_the_budget_needs_no_images_whatever_lies_on_top_of_each_other(tmp_path, capsys):
    """Both triangles of a cube's side have the same bounds, and no division parts them."""
    corners = "".join(f"v {n & 1} {n >> 1 & 1} {n >> 2}\n" for n in range(8))
    sides = "f 1 3 4 2\nf 5 6 8 7\nf 1 2 6 5\nf 3 7 8 4\nf 1 5 7 3\nf 2 4 8 6\n"
    (tmp_path / "small.obj").write_text(corners + sides)
    options = ("--display", "96x72", "--workers", "1", "--check", "50")
    assert run(place_images, tmp_path / "small.obj", "-o", tmp_path / "out", "--budget", "12", *options) == 0
    assert "0 images (0 made now)" in (said := capsys.readouterr().out)
    assert "as the whole model is within the budget" in said and "of 12 triangles in 50 views" in said


def test_milliseconds_are_triangles_and_stand_in_the_manifest(model, folder, tmp_path):
    same = tmp_path / "out"
    shutil.copytree(folder, same)
    options = ("--budget-ms", "10", "--costs", "2,3000,2", *OPTIONS[2:])  # 6 ms for triangles
    assert run(place_images, model, "-o", same, *options, "--workers", "1", "--quiet") == 0
    told, before = (json.loads((path / "manifest.json").read_text()) for path in (same, folder))
    assert told.pop("frame_ms") == {"ms": 10.0, "fixed": 2.0, "million": 3000.0, "image": 2.0}
    assert before.pop("frame_ms") is None
    assert told == before


def test_its_json_is_json(model, folder, capsys):
    assert run(place_images, model, "-o", folder, *OPTIONS, "--workers", "1", "--check", "50", "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert told["checked"]["kept"] is True
    assert told["checked"]["most_triangles_of_ranges"] == told["most_triangles"]
    assert told["checked"]["ranges_over_budget"] == 0 < told["checked"]["ranges"]
    assert told["most_triangles"] <= told["budget"] == 2000
    assert told["made"] == 0 < told["images"]


def test_a_broken_budget_is_exit_status_1(model, folder, capsys, monkeypatch):
    monkeypatch.setattr(solutions.Solutions, "serving", lambda *_: -1)
    assert run(place_images, model, "-o", folder, *OPTIONS, "--workers", "1", "--check", "100", "--quiet") == 1
    out = capsys.readouterr().out.strip().splitlines()
    assert out[-2].startswith("budget kept: ") and out[-1].startswith("budget BROKEN in ")


def test_an_image_that_serves_no_direction_is_exit_status_1(model, folder, tmp_path, capsys):
    """Its checksums are right and its images are there, but those of one point are never shown."""
    spoilt = tmp_path / "out"
    shutil.copytree(folder, spoilt)
    found = solutions.solutions_from((spoilt / "solutions.bin").read_bytes(), "solutions")
    number = next(n for n, one in enumerate(found.points) if one.images)
    one = found.points[number]
    points = [*found.points]
    points[number] = replace(one, serving=np.full(len(one.serving), -1, dtype=np.int32))
    told = {name: getattr(found, name) for name in ("source", "model", "camera", "pictures", "rules", "grid")}
    (spoilt / "solutions.bin").write_bytes(solutions.solutions_to_bytes(solutions.solutions_of(**told, points=points)))
    assert run(place_images, model, "-o", spoilt, *OPTIONS, "--workers", "1", "--check", "1", "--quiet") == 1
    assert capsys.readouterr().out.splitlines()[-2].startswith("budget BROKEN in ")


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--budget", "0"), "--budget: 2 to "),
        (("--budget", "50", "--optimize", "60"), "--optimize: 1 to 50 expected, found 60"),
        (("--budget", "50", "--check", "0"), "--check: 1 to "),
        (("--budget", "50", "--costs", "1,2,3"), "--budget-ms, --costs: both or neither expected"),
        (("--budget-ms", "5", "--costs", "1,2"), "three numbers of milliseconds (2,30,8) expected"),
        (("--budget-ms", "5", "--costs", "2,30,8"), "--budget-ms, --costs: ms: more than 10, as a frame with"),
        (("--budget", "50", "--workers", "0"), "--workers: 1 to "),
        (("--budget", "50", "--pitch", "90"), "--pitch: 0 to 90 degrees expected"),
        (("--budget", "50", "--octree-depth", "11"), "--octree-depth: a number from 1 to 10 expected, found 11"),
        (("--budget", "50", "--pitch", "80"), "--pitch: views that stay below 87 degrees expected, found up to"),
        (("--budget", "50", "--fov", "10"), "--fov: the tangent of half an angle of view, from 0.2 to 20, expected"),
        (("--budget", "50", "--seed", "-1"), "--seed: 0 to "),
        (("--budget-ms", "1e6", "--costs", "0,0.001,1"), "--budget-ms, --costs: triangles: 2 to "),
        (("--budget", "50", "--fov", "200"), "--display, --fov: "),
        (("--budget", "50", "--weights", "1,2"), "four numbers from 0 to 1"),
        (("--budget", "50", "--heights", "2,1"), "two heights, the lower first"),
        (("--budget", "4", "--display", "96x72"), "a larger budget is needed"),
    ],
)
def test_a_mistake_is_one_line(model, tmp_path, capsys, options, said):
    assert run(place_images, model, "-o", tmp_path / "out", *options, "--quiet") == 2
    line = capsys.readouterr().err.strip().splitlines()[-1]
    assert line.startswith("place-images: error: ") and said in line


def test_a_folder_of_something_else_is_refused(model, tmp_path, capsys):
    (tmp_path / "mine.txt").write_text("mine")
    assert run(place_images, model, "-o", tmp_path, *OPTIONS, "--quiet") == 2
    assert "found other files (mine.txt); nothing was changed" in capsys.readouterr().err


@pytest.mark.parametrize("warp", ["software", "points"])
def test_walks_with_it_are_compared(model, folder, tmp_path, warp):
    arguments = ("--techniques", "full,placed-images", "--placed", folder, "--warp", warp, "--quiet")
    assert run(compare_impostors, model, "-o", tmp_path / "out", "--views", "6", *arguments) == 0
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    jsonschema.validate(report, SCHEMA)
    assert report["display"]["width"] == 96  # that of the images
    found = report["techniques"]["placed-images"]["placed"]
    assert found["warp"] == warp
    assert found["over_budget"] == 0 and found["most_triangles"] <= found["budget"] == 2000
    assert report["techniques"]["full"]["placed"] is None


def test_without_a_folder_or_with_one_of_another_model_it_is_one_line(model, folder, tmp_path, capsys, dataset):
    arguments = ("-o", tmp_path / "out", "--views", "1", "--techniques", "full,placed-images", "--quiet")
    assert run(compare_impostors, model, *arguments) == 2
    assert (
        "--placed: a folder that place-images wrote expected for placed-images, found none" in capsys.readouterr().err
    )
    assert run(compare_impostors, model, *arguments, "--warp", "points") == 2
    assert "expected for placed-images, found none" in capsys.readouterr().err
    others = ("-o", tmp_path / "out", "--techniques", "full", "--quiet", "--warp", "points")
    assert run(compare_impostors, model, *others) == 2
    assert "--warp: placed-images among --techniques expected" in capsys.readouterr().err
    assert run(view_impostors, dataset.path, "--warp", "points") == 2
    assert "--warp: a folder that place-images wrote (--placed) expected, found none" in capsys.readouterr().err
    assert run(compare_impostors, dataset.path, *arguments, "--placed", folder) == 2
    assert "as it is now expected, found those for" in capsys.readouterr().err
    assert run(compare_impostors, model, *arguments, "--placed", tmp_path) == 2
    assert "a folder that place-images wrote expected" in capsys.readouterr().err
