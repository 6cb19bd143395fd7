"""Folders of placed images: the same bytes by one process or two, and after having been stopped; and what is refused."""

from dataclasses import replace

import pytest
from placed_models import RULES, model_of, placed, towers

from mmi.foundation.errors import DatasetError, ParameterError
from viewer.making.checking import check_views
from viewer.placed.folder import open_placed, placing_folder


@pytest.fixture(scope="module")
def model():
    return model_of(towers())


@pytest.fixture(scope="module")
def summary(model, tmp_path_factory):
    return placed(model, tmp_path_factory.mktemp("placed") / "towers")


def files(path):
    return {one.relative_to(path).as_posix(): one.read_bytes() for one in sorted(path.rglob("*")) if one.is_file()}


def test_a_folder_has_what_its_manifest_says(summary):
    folder = open_placed(summary.folder.path)
    assert summary.images == summary.made == len(folder.solutions.images) > 20
    assert folder.solutions.rules == RULES
    assert summary.largest_count <= RULES.budget < summary.triangles
    for number in range(0, summary.images, 7):
        assert folder.image(number).view.window == folder.solutions.view(number).window


def test_two_processes_make_the_same_bytes(model, summary, tmp_path):
    placed(model, tmp_path / "two", workers=2)
    assert files(tmp_path / "two") == files(summary.folder.path)


def test_what_was_stopped_goes_on_and_comes_to_the_same_bytes(model, summary, tmp_path):
    def stop(_done, _total, name):
        if name == "image 9":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        placed(model, tmp_path / "one", progress=stop)
    with pytest.raises(DatasetError, match="not finished: run the same command again"):
        open_placed(tmp_path / "one")
    (tmp_path / "one" / "images" / "000003-0123456789ab.ldi.part-99").write_bytes(b"half an image")
    (tmp_path / "one" / ".meshes-killed").mkdir()
    (tmp_path / "one" / ".meshes-killed" / "objects-uv.npy").write_bytes(b"")
    again = placed(model, tmp_path / "one")
    assert again.made == again.images - 10
    assert "grid" not in again.stages
    assert files(tmp_path / "one") == files(summary.folder.path)
    assert placed(model, tmp_path / "one").made == 0


def test_a_damaged_image_is_told_and_made_again(model, tmp_path):
    placed(model, tmp_path / "one")
    folder = open_placed(tmp_path / "one")
    data = bytearray(folder.file(2).read_bytes())
    data[len(data) // 2] ^= 1
    folder.file(2).write_bytes(data)
    with pytest.raises(DatasetError, match=r"000002-.*damaged"):
        folder.image(2)
    folder.file(4).write_bytes(folder.file(3).read_bytes())
    with pytest.raises(DatasetError, match="image 4 expected, found another"):
        folder.image(4)
    folder.file(5).unlink()
    with pytest.raises(DatasetError, match="run place-images again"):
        folder.image(5)
    assert placed(model, tmp_path / "one").made == 2  # the third is whole, for all that can be told without its view
    assert open_placed(tmp_path / "one").image(2).view.window == folder.solutions.view(2).window


def test_other_rules_replace_what_is_there_where_that_is_said(model, summary, tmp_path):
    placed(model, tmp_path / "one")
    said = "--pictures 5 expected, which the images there were made with, found --pictures 1; nothing was changed"
    with pytest.raises(ParameterError, match=said):
        placed(model, tmp_path / "one", pictures=1)
    assert files(tmp_path / "one") == files(summary.folder.path)
    fewer = placed(model, tmp_path / "one", pictures=1, replacing=True)
    assert fewer.made == fewer.images
    assert len(list((tmp_path / "one" / "images").iterdir())) == fewer.images
    assert open_placed(tmp_path / "one").solutions.pictures == 1


def test_what_was_stopped_is_not_replaced_unasked_either(model, tmp_path):
    """Its points took as long as those of a finished folder."""

    def stop(_done, _total, name):
        if name == "image 3":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        placed(model, tmp_path / "one", progress=stop)
    before = files(tmp_path / "one")
    with pytest.raises(
        ParameterError, match=r"no --heights expected, .* found --heights 1\.5,1\.9; nothing was changed"
    ):
        placed(model, tmp_path / "one", heights=(1.5, 1.9))
    assert files(tmp_path / "one") == before
    again = placed(model, tmp_path / "one")
    assert again.made == again.images - 4


def test_the_name_of_the_models_file_makes_no_difference(model, summary, tmp_path):
    placed(model, tmp_path / "one")
    moved = replace(model, city=replace(model.city, source="renamed.glb"))
    assert placed(moved, tmp_path / "one").made == 0
    assert files(tmp_path / "one") == files(summary.folder.path)


def test_a_folder_stopped_on_its_way_to_other_rules_is_not_finished(model, tmp_path):
    """Its manifest would say that the images of one picture are those of five."""
    placed(model, tmp_path / "one")

    def stop(_done, _total, name):
        if name == "image 3":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        placed(model, tmp_path / "one", pictures=1, replacing=True, progress=stop)
    with pytest.raises(DatasetError, match="not finished: run the same command again"):
        open_placed(tmp_path / "one")
    again = placed(model, tmp_path / "one", pictures=1)
    assert again.made == again.images - 4
    assert open_placed(tmp_path / "one").solutions.pictures == 1


def test_a_folder_of_something_else_is_refused_and_left_alone(model, tmp_path):
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(DatasetError, match=r"found other files \(mine.txt\); nothing was changed"):
        placed(model, tmp_path)
    assert [one.name for one in tmp_path.iterdir()] == ["mine.txt"]
    with pytest.raises(DatasetError, match="found a file"):
        placed(model, tmp_path / "mine.txt")
    with placing_folder(tmp_path / "busy"), pytest.raises(DatasetError, match="another place-images is writing here"):
        placed(model, tmp_path / "busy")


def test_what_has_no_meaning_is_refused(model, tmp_path):
    for options in ({"pictures": 4}, {"workers": 0}):
        with pytest.raises(ParameterError, match=f"^{next(iter(options))}: "):
            placed(model, tmp_path / "none", **options)
    assert not (tmp_path / "none").exists()


def test_random_views_keep_to_the_budget_and_are_drawn_as_counted(model, summary):
    found = check_views(summary.folder, model, views=400)
    assert found.kept and found.drawn == 400
    assert found.tally.image > 40
    assert found.tally.most <= RULES.budget


def test_a_view_over_the_budget_is_told(model, summary, monkeypatch):
    monkeypatch.setattr(type(summary.folder.solutions), "serving", lambda *_: -1)
    found = check_views(summary.folder, model, views=100)
    assert not found.kept
    assert found.tally.over > 0
