"""Compiled functions where their translations can be kept, and where nothing can be written."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from cities import crossroads

from mmi.foundation import kernels
from mmi.foundation.kernels import kernel
from mmi.writing.cityjson_writer import write_cityjson

ROOT = Path(__file__).resolve().parents[3]


def doubled(x):
    return 2.0 * x


def test_a_kernel_computes_what_the_function_does():
    compiled = kernel()(doubled)
    assert compiled(3.0) == compiled.py_func(3.0) == 6.0
    assert compiled.__name__ == "doubled"


def divided(x, y):
    return x / y


def divided_or_refused(x, y):
    return x / y


def test_the_error_model_is_the_one_that_was_asked_for():
    assert kernel(error_model="numpy")(divided)(1.0, 0.0) == float("inf")
    with pytest.raises(ZeroDivisionError):
        kernel()(divided_or_refused)(1.0, 0.0)


def test_numba_is_not_asked_to_make_a_folder_called_tilde(monkeypatch, tmp_path):
    """That is where it would keep things for a user who has no home, as containers with ``--user`` start one."""
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(Path, "home", lambda: _fail())
    monkeypatch.setattr(kernels, "_is_writable", lambda _: False)
    monkeypatch.setattr(kernels.config, "CACHE_DIR", "")
    monkeypatch.chdir(tmp_path)
    assert kernel()(doubled)(3.0) == 6.0
    assert not list(tmp_path.iterdir())


def _fail():
    raise RuntimeError("Could not determine home directory.")


SCRIPT = """
import importlib, sys
from multiprocessing import get_context
from pathlib import Path

def found(root):
    for path in sorted(Path(root).rglob("*.py")):
        if "@kernel(" in path.read_text():
            importlib.import_module(".".join(path.relative_to(root).with_suffix("").parts))
    from mmi.foundation import ray_chords
    assert ray_chords.__file__.startswith(root), "the copy is what is tested"
    return ray_chords.may_exceed(0.001, 10.0, 20.0, 3.0)

if __name__ == "__main__":
    root = sys.argv[1]
    print(len([name for name in sys.modules if name.startswith("mmi.")]) == 0, found(root))
    with get_context("spawn").Pool(1) as pool:
        print(pool.apply(found, (root,)))
"""


@pytest.fixture
def installed(tmp_path):
    """A copy of the packages in which nothing can be written. A file in place of each ``__pycache__`` keeps root out too."""
    root = tmp_path / "installed"
    for package in ("mmi", "viewer"):
        shutil.copytree(ROOT / package, root / package, ignore=shutil.ignore_patterns("__pycache__"))
    folders = [root, *(one for one in root.rglob("*") if one.is_dir())]
    for folder in folders:
        (folder / "__pycache__").write_text("")
        folder.chmod(0o555)
    yield root
    for folder in folders:
        folder.chmod(0o755)


def run_without_a_home(root, here, *arguments):
    """(status, output, errors) of Python in the empty folder ``here``, where nothing is left."""
    here.mkdir()
    nowhere = {
        "HOME": "/dev/null/nowhere",
        "XDG_CACHE_HOME": "/dev/null/nowhere",
        "PYTHONPATH": str(root),
        "NUMBA_DEBUG_CACHE": "1",
    }
    kept = {key: one for key, one in os.environ.items() if not key.startswith(("COV", "NUMBA_CACHE"))}
    done = subprocess.run(
        [sys.executable, *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
        env=kept | nowhere,
        cwd=here,
    )
    assert not list(here.iterdir())
    return done.returncode, done.stdout, done.stderr


def test_an_installation_that_cannot_be_written_and_has_no_home_works(installed, tmp_path):
    """Also in processes that it starts."""
    (tmp_path / "script.py").write_text(SCRIPT)
    found = run_without_a_home(installed, tmp_path / "here", tmp_path / "script.py", installed)
    assert found == (0, "True True\nTrue\n", "")


@pytest.mark.slow
def test_it_builds_and_compares_a_cell(installed, tmp_path):
    """Every function is compiled anew, in each process."""
    write_cityjson(crossroads(), tmp_path / "city.json")
    few = ["--display", "64x64", "--near-distance", "20", "--max-cells", "1", "--workers", "1", "--quiet"]
    views = ["--views", "1", "--techniques", "full,multi-mesh", "--no-flip", "--worst", "1", "--quiet"]
    for number, (module, arguments) in enumerate(
        (
            ("mmi.programs.build_impostors", [tmp_path / "city.json", "-o", tmp_path / "out", *few]),
            ("viewer.programs.compare_impostors", [tmp_path / "out", "-o", tmp_path / "report", *views]),
        )
    ):
        name = module.rpartition(".")[2]
        start = f"import {module} as program; assert program.__file__.startswith({str(installed)!r}); program.{name}()"
        found = run_without_a_home(installed, tmp_path / f"here{number}", "-c", start, *arguments)
        assert found == (0, "", "")
    assert json.loads((tmp_path / "report" / "report.json").read_text())["views"] == 1
