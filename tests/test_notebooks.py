"""The notebooks run as they stand, cell by cell, beside a running event loop as in a kernel, and do what they say.

Jupyter is a hundred megabytes and not needed for that: the cells are plain Python, and a cell shows the value of its last line.
"""

import ast
import asyncio
import json
import re
import shutil
from pathlib import Path
from urllib.request import urlopen

import numpy as np
import pytest
from cities import HELSINKI
from PIL import Image

from mmi.dataset.reading import open_dataset

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
NOTEBOOKS = sorted(EXAMPLES.glob("*.ipynb"))


def cells_of(path):
    return json.loads(path.read_text(encoding="utf-8"))["cells"]


def run_cell(source, names):
    """Execute a cell's code; returns the value of its last line where that is an expression."""
    tree = ast.parse(source)
    last = ast.Expression(tree.body.pop().value) if isinstance(tree.body[-1], ast.Expr) else None
    exec(compile(tree, "cell", "exec"), names)
    return None if last is None else eval(compile(last, "cell", "eval"), names)


async def run_notebook(path):
    """What the cells of code show, by their ids, and their names."""
    names = {"__name__": "__main__"}
    shown = {one["id"]: run_cell("".join(one["source"]), names) for one in cells_of(path) if one["cell_type"] == "code"}
    return shown, names


@pytest.mark.slow
def test_a_first_look_builds_looks_compares_and_opens_the_viewer(tmp_path, monkeypatch, capsys):
    (tmp_path / "examples" / "helsinki").mkdir(parents=True)
    shutil.copy(HELSINKI, tmp_path / "examples" / "helsinki")
    monkeypatch.chdir(tmp_path / "examples")  # where Jupyter runs it
    shown, names = asyncio.run(run_notebook(EXAMPLES / "a_first_look.ipynb"))
    with names["shown"]:
        dataset = open_dataset(tmp_path / "out" / "notebook")
        assert 2 <= len(dataset.manifest.cells) <= 8
        assert all(set(cell.neighbours) & {one.id for one in dataset.manifest.cells} for cell in dataset.manifest.cells)

        assert isinstance(shown["look"], Image.Image)
        layer = np.asarray(shown["look"])
        assert layer.shape[2] == 4 and set(np.unique(layer[..., 3])) == {0, 255}
        assert layer[layer[..., 3] == 255].std() > 10.0

        told = capsys.readouterr().out
        wrong = {
            name: float(share) for name, share in re.findall(r"^(\S+) +([\d.]+)% of the pixels", told, re.MULTILINE)
        }
        assert wrong["multi-mesh"] < 0.5 < wrong["local"]

        address = re.search(r'src="([^"]+)"', shown["walk"]._repr_html_())[1]
        with urlopen(address, timeout=5.0) as answer:
            assert answer.status == 200
    assert list((tmp_path / "examples").iterdir()) == [tmp_path / "examples" / "helsinki"], "nothing is left there"


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.name)
def test_a_notebook_is_kept_without_what_it_showed(path):
    cells = cells_of(path)
    assert len({one["id"] for one in cells}) == len(cells)
    code = [one for one in cells if one["cell_type"] == "code"]
    assert all(one["outputs"] == [] and one["execution_count"] is None for one in code)
    assert not any(re.search(r"^[%!?]", "".join(one["source"]), re.MULTILINE) for one in code), "plain Python"


def test_there_is_a_notebook():
    assert NOTEBOOKS
