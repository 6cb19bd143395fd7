"""Whatever happens on the way, a file is the old one, the new one, or not there."""

from __future__ import annotations

import os
import resource

import pytest

from mmi.dataset.folder import DatasetFolder
from mmi.foundation.errors import CityError, DatasetError
from mmi.foundation.whole_files import is_leftover, real_path, whole_file, whole_path, write_whole
from mmi.inspection.figures import new_figure, save


def names(folder):
    return sorted(path.name for path in folder.rglob("*"))


def test_a_file_appears_when_it_is_whole(tmp_path):
    path = tmp_path / "new" / "file.bin"
    with whole_file(path) as file:
        file.write(b"one, ")
        file.flush()
        assert not path.exists()
        (beside,) = path.parent.iterdir()
        assert is_leftover(beside)
        file.write(b"two")
    assert path.read_bytes() == b"one, two"
    assert names(tmp_path) == ["file.bin", "new"]
    write_whole(path, b"three")
    assert path.read_bytes() == b"three"


@pytest.mark.parametrize("failure", [KeyboardInterrupt, ValueError, MemoryError, SystemExit])
def test_whatever_is_raised_the_older_file_stays(tmp_path, failure):
    path = tmp_path / "file.bin"
    path.write_bytes(b"older")
    with pytest.raises(failure), whole_file(path) as file:
        file.write(b"newer")
        raise failure
    with pytest.raises(failure), whole_path(path) as temporary:
        temporary.write_bytes(b"newer")
        raise failure

    def write(temporary):
        temporary.write_bytes(b"newer")
        raise failure

    with pytest.raises(failure):
        DatasetFolder(tmp_path).write_with("file.bin", write)
    assert names(tmp_path) == ["file.bin"]
    assert path.read_bytes() == b"older"


def test_a_picture_that_is_not_finished_leaves_the_older_one(tmp_path):
    path = tmp_path / "map.png"
    save(new_figure(1.0, 1.0), path)
    before = path.read_bytes()
    figure, drawn = new_figure(1.0, 1.0), []

    class Broken:
        """What fails when it is drawn: in the middle of writing, as it were."""

        def __call__(self, renderer):
            drawn.append(renderer)
            raise KeyboardInterrupt

    figure.draw = Broken()
    with pytest.raises(KeyboardInterrupt):
        save(figure, path)
    assert drawn
    assert path.read_bytes() == before
    assert names(tmp_path) == ["map.png"]


def test_a_full_disk_leaves_no_half_picture(tmp_path):
    """A limit on file sizes stands in for the disk."""
    path = tmp_path / "map.png"
    save(new_figure(1.0, 1.0), path)
    before = path.read_bytes()
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (len(before) // 2, limits[1]))
    try:
        with pytest.raises(DatasetError, match=r"map\.png: a writable file expected, found: File too large"):
            save(new_figure(2.0, 2.0), path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert path.read_bytes() == before
    assert names(tmp_path) == ["map.png"]


def test_errors_are_of_the_kind_that_was_asked_for(tmp_path):
    (tmp_path / "file").write_text("no folder")
    for kind in (CityError, DatasetError):
        with pytest.raises(kind, match=r"file/x: a writable file expected, found: (File exists|Not a directory)"):
            write_whole(tmp_path / "file" / "x", b"", error=kind)


def test_a_dataset_does_not_come_back_to_a_folder_that_is_gone(tmp_path):
    with pytest.raises(DatasetError, match=r"a\.glb: cannot be written \(No such file or directory\)"):
        DatasetFolder(tmp_path).write("cells/a.glb", b"data")
    assert names(tmp_path) == []


def test_leftovers_are_known_by_their_names(tmp_path):
    with whole_path(tmp_path / "build.json") as temporary:
        temporary.write_bytes(b"")
        assert is_leftover(temporary)
        assert is_leftover(temporary, "build.json")
        assert not is_leftover(temporary, "manifest.json")
        assert str(os.getpid()) in temporary.name
    for name in ("build.json", "a.part", "a.part-", "a.part-one", "part-1"):
        assert not is_leftover(tmp_path / name)


def test_a_real_path_is_where_links_lead_as_far_as_they_do(tmp_path):
    (tmp_path / "folder").mkdir()
    (tmp_path / "link").symlink_to("folder")
    (tmp_path / "loop").symlink_to("loop")
    assert real_path(tmp_path / "link" / "a") == tmp_path.resolve() / "folder" / "a"
    assert real_path(tmp_path / "loop" / "a") == tmp_path.resolve() / "loop" / "a"
