"""Files that models refer to: found beside the model however the exporter wrote it, and never anywhere else."""

from __future__ import annotations

import pytest

from mmi.reading.pictures import contained_path, file_beside
from mmi.reading.report import Ledger

NOTE = "file found beside the model by its name"


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "model" / "tex").mkdir(parents=True)
    for name in ("wall.png", "tex/roof.png", "tex/wall.png", "a b.png"):
        (tmp_path / "model" / name).write_bytes(name.encode())
    (tmp_path / "secret.png").write_bytes(b"secret")
    return tmp_path / "model"


@pytest.mark.parametrize(
    ("reference", "found", "noted"),
    [
        ("wall.png", "wall.png", False),
        ("./wall.png", "wall.png", False),
        ("tex/wall.png", "tex/wall.png", False),
        (r"tex\wall.png", "tex/wall.png", False),
        ('"wall.png"', "wall.png", False),
        ("'tex/roof.png'", "tex/roof.png", False),
        ("a%20b.png", "a b.png", False),
        ("file:///home/user/a%20b.png", "a b.png", True),
        ("Wall.PNG", "wall.png", True),
        ("TEX/Wall.png", "tex/wall.png", True),
        ("/home/user/models/wall.png", "wall.png", True),
        ("/home/user/tex/wall.png", "tex/wall.png", True),
        ("../textures/wall.png", "wall.png", True),
        ("../tex/roof.png", "tex/roof.png", True),
        (r"C:\models\wall.png", "wall.png", True),
        (r"C:\models\tex\roof.png", "tex/roof.png", True),
    ],
)
def test_references_of_all_kinds(folder, reference, found, noted):
    ledger = Ledger()
    file = file_beside(folder, reference, ledger)
    assert file is not None
    assert file.read_bytes() == found.encode()
    assert ledger.count("repaired", NOTE) == noted


@pytest.mark.parametrize(
    "reference",
    ["../secret.png", "tex/../../secret.png", "%2e%2e/secret.png", "/etc/passwd", "roof.png", "", ".", "..", "tex", "/", "\0",
     "x" * 5000, "link.png", "linked/secret.png", "LINK.png", "https://example.org/wall.png"],
)  # fmt: skip
def test_nothing_outside_the_folder_is_found(folder, reference):
    (folder / "link.png").symlink_to(folder.parent / "secret.png")
    (folder / "linked").symlink_to(folder.parent)
    ledger = Ledger()
    assert file_beside(folder, reference, ledger) is None
    assert ledger.count("repaired") == 0


def test_other_folders_go_before_other_cases(folder):
    (folder / "WALL2.png").write_bytes(b"other case")
    (folder / "tex" / "wall2.png").write_bytes(b"as it is written")
    file = file_beside(folder, "wall2.png", Ledger(), also=("appearances", "tex"))
    assert file is not None
    assert file.read_bytes() == b"as it is written"


def test_links_that_loop_are_no_pictures(folder):
    (folder / "loop.png").symlink_to("loop.png")
    (folder / "one").symlink_to("two")
    (folder / "two").symlink_to("one")
    for reference in ("loop.png", "one/wall2.png", "LOOP.png", "one"):
        ledger = Ledger()
        assert file_beside(folder, reference, ledger) is None
        assert ledger.count("repaired") == 0
        assert not contained_path(folder, reference, folder / "a.gltf").exists()
