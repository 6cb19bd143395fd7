"""Compiled functions where their translations can be kept, and where nothing can be written."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from mmi.foundation import kernels
from mmi.foundation.kernels import kernel

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


def test_an_installation_that_cannot_be_written_and_has_no_home_works(tmp_path):
    """Also in processes that it starts. A file in place of each ``__pycache__`` keeps root out of it as well."""
    root, here = tmp_path / "installed", tmp_path / "here"
    for package in ("mmi", "viewer"):
        shutil.copytree(ROOT / package, root / package, ignore=shutil.ignore_patterns("__pycache__"))
    for folder in [root, *(one for one in root.rglob("*") if one.is_dir())]:
        (folder / "__pycache__").write_text("")
        folder.chmod(0o555)
    here.mkdir()
    (tmp_path / "script.py").write_text(SCRIPT)
    nowhere = {
        "HOME": "/dev/null/nowhere",
        "XDG_CACHE_HOME": "/dev/null/nowhere",
        "PYTHONPATH": str(root),
        "NUMBA_DEBUG_CACHE": "1",
    }
    kept = {key: one for key, one in os.environ.items() if not key.startswith(("COV", "NUMBA_CACHE"))}
    done = subprocess.run(
        [sys.executable, str(tmp_path / "script.py"), str(root)],
        capture_output=True,
        text=True,
        check=False,
        env=kept | nowhere,
        cwd=here,
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "True True\nTrue\n", "")
    assert not list(here.iterdir())
    for folder in [root, *(one for one in root.rglob("*") if one.is_dir())]:
        folder.chmod(0o755)
