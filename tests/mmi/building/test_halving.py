import math
from dataclasses import replace

import numpy as np
import pytest
from cities import crossroads

from mmi.building.dataset import build_dataset
from mmi.building.halving import SHORTEST, exceeded, halves, whole_of, with_halves_joined
from mmi.cells.viewing_cells import ViewingCell
from mmi.dataset.reading import open_dataset
from mmi.foundation.camera import Camera
from mmi.foundation.errors import ParameterError
from mmi.planning.parameters import BuildParameters

PARAMETERS = BuildParameters(near_distance=30.0, camera=Camera(128, 128, 1.0), cell_length=80.0, max_error_px=2.0)


def test_halves_cover_a_cell_and_stop_in_time():
    cell = ViewingCell("0003-01", (0.0, 0.0), (30.0, 40.0), 3.0, (1.5, 1.9), "street")
    one, other = halves(cell)
    assert (one.p, one.q, other.p, other.q) == (cell.p, (15.0, 20.0), (15.0, 20.0), cell.q)
    assert (one.id, other.id, whole_of("0003-01ab")) == ("0003-01a", "0003-01b", "0003-01")
    assert {one.half_width, other.half_width} == {cell.half_width} and one.eye == cell.eye
    parts = [cell]
    while any(halves(part) for part in parts):
        parts = [half for part in parts for half in (halves(part) or (part,))]
    assert all(SHORTEST <= part.length < 2.0 * SHORTEST for part in parts)
    assert math.isclose(sum(part.length for part in parts), cell.length)


def test_only_what_is_asked_for_and_exceeded_is_named():
    assert exceeded(BuildParameters(), layers=99, triangles=10**9, stored_bytes=10**12) == {}
    parameters = BuildParameters(max_layers=3, max_bytes=1000)
    assert exceeded(parameters, layers=3, triangles=10**9, stored_bytes=1000) == {}
    assert exceeded(parameters, layers=4, stored_bytes=1001) == {"layers": (4, 3), "bytes": (1001, 1000)}


def test_parts_that_meet_become_neighbours(tmp_path):
    build_dataset(crossroads(), tmp_path, PARAMETERS, max_cells=1)
    made = open_dataset(tmp_path).manifest.cells[0]

    def entry(name, start, end, *neighbours):
        return replace(made, id=name, axis=((start, 0.0), (end, 0.0)), neighbours=neighbours)

    whole = [entry("a-0", 0, 40, "a-1"), entry("a-1", 40, 80, "a-0", "a-2")]
    assert with_halves_joined(whole) == whole
    cut = [entry("x-0", 0, 20, "x-1"), entry("x-1a", 20, 30, "x-0", "x-2"), entry("x-1b", 30, 40, "x-0", "x-2")]
    found = {one.id: list(one.neighbours) for one in with_halves_joined([*cut, entry("x-2", 40, 60, "x-1")])}
    assert found == {"x-0": ["x-1a"], "x-1a": ["x-0", "x-1b"], "x-1b": ["x-1a", "x-2"], "x-2": ["x-1b"]}


@pytest.mark.parametrize("budget", [{"max_layers": 0}, {"max_triangles": -1}, {"max_bytes": 0}])
def test_budgets_without_meaning_are_refused(budget):
    with pytest.raises(ParameterError, match="1 or more"):
        BuildParameters(**budget)


def test_cells_over_budget_are_cut_until_they_keep_it_or_are_named(tmp_path):
    cells = ["0000-00", "0000-01"]
    free = build_dataset(crossroads(), tmp_path / "free", PARAMETERS, cells=cells)
    sizes = [one.bytes for one in open_dataset(tmp_path / "free").manifest.cells]
    assert free.cut == 0 and free.over_budget == {}
    limit = int(0.95 * max(sizes))
    tight = replace(PARAMETERS, max_bytes=limit)
    summary = build_dataset(crossroads(), tmp_path / "tight", tight, cells=cells)
    entries = open_dataset(tmp_path / "tight").manifest.cells
    assert summary.cut > 0 and summary.cells == len(entries) > len(cells)
    over = {one.id for one in entries if one.bytes > limit}
    assert set(summary.over_budget) == over
    for one in entries:
        length = math.dist(*one.axis)
        assert one.bytes <= limit or length < 2.0 * SHORTEST
    total = sum(math.dist(*one.axis) for one in entries)
    whole = sum(math.dist(*one.axis) for one in open_dataset(tmp_path / "free").manifest.cells)
    assert np.isclose(total, whole)
    again = build_dataset(crossroads(), tmp_path / "tight", tight, cells=cells)
    assert again.built == 0 and again.complete == len(cells) and again.cells == summary.cells
    assert open_dataset(tmp_path / "tight").manifest.cells == entries
