"""Solutions as bytes: they come back as they were, and what is damaged or lies is one line."""

import dataclasses
import hashlib
import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from placed_models import CAMERA, RULES, model_of, towers

from mmi.foundation.errors import DatasetError
from viewer.placed.solutions import print_of, solutions_from, solutions_of, solutions_to_bytes
from viewer.placing.model_cells import cells_for
from viewer.placing.placements import placements_at
from viewer.placing.refining import solution_grid
from viewer.placing.solution_grid import domain_of


@pytest.fixture(scope="module")
def solutions():
    model = model_of(towers())
    cells = cells_for(model.mesh.positions, model.mesh.triangles, RULES)
    grid = solution_grid(cells, RULES, domain_of(cells))
    points = [placements_at(point, needs, cells, RULES) for point, needs in zip(grid.points, grid.needs(), strict=True)]
    return solutions_of(
        source="made",
        model=print_of(model.mesh),
        camera=CAMERA,
        pictures=5,
        rules=RULES,
        grid=grid,
        points=points,
    )


def test_they_come_back_as_they_were(solutions):
    data = solutions_to_bytes(solutions)
    found = solutions_from(data, "here")
    assert solutions_to_bytes(found) == data
    assert (found.rules, found.camera, found.model) == (solutions.rules, solutions.camera, solutions.model)
    rng = np.random.default_rng(1)
    for _ in range(300):
        eye, yaw = rng.uniform(*solutions.grid.domain), rng.uniform(-4.0, 4.0)
        point = solutions.grid.closest(eye, yaw)
        assert found.grid.closest(eye, yaw) == point
        assert found.serving(point, yaw) == solutions.serving(point, yaw)
    for number, image in enumerate(found.images):
        np.testing.assert_array_equal(image.placement.cells, solutions.images[number].placement.cells)


@pytest.fixture(scope="module")
def bits(solutions):
    """(n, 7) of what is hidden from each point's viewers."""
    return np.random.default_rng(3).integers(0, 256, (len(solutions.points), 7)).astype(np.uint8)


@pytest.fixture(scope="module")
def hiding(solutions, bits):
    points = [dataclasses.replace(one, hidden=own) for one, own in zip(solutions.points, bits, strict=True)]
    return dataclasses.replace(solutions, points=tuple(points), occluders="those")


def test_what_is_hidden_comes_back(solutions, hiding, bits):
    found = solutions_from(solutions_to_bytes(hiding), "here")
    assert found.occluders == "those"
    np.testing.assert_array_equal([one.hidden for one in found.points], bits)
    np.testing.assert_array_equal(found.points[4].hides(50), [bits[4, n >> 3] >> (7 - (n & 7)) & 1 for n in range(50)])
    assert not solutions.points[4].hides(50).any()


def test_an_image_s_view_holds_its_window(solutions):
    for number, image in enumerate(solutions.images):
        left, bottom, right, top = (CAMERA.focal * one for one in image.placement.window)
        x, y, width, height = solutions.view(number).window
        assert x <= left - 1.0 and right + 1.0 <= x + width
        assert y <= -top - 1.0 and -bottom + 1.0 <= y + height


def signed(data):
    return data + hashlib.sha256(data).digest()


@settings(max_examples=150, deadline=None)
@given(st.data())
def test_what_is_damaged_is_one_line_even_where_its_checksum_holds(solutions, hiding, data):
    whole = bytearray(solutions_to_bytes(hiding if data.draw(st.booleans()) else solutions)[:-32])
    for _ in range(data.draw(st.integers(1, 3))):
        place = data.draw(st.integers(0, 1500) | st.integers(0, len(whole) - 1))
        whole[place % len(whole)] = data.draw(st.integers(0, 255))
    cut = data.draw(st.none() | st.integers(0, len(whole)))
    with pytest.raises(DatasetError, match=r"^here: [^\n]+$"):
        solutions_from(bytes(whole[:cut]) + b"\0" * 32, "here")
    try:
        found = solutions_from(signed(bytes(whole[:cut])), "here")
    except DatasetError as error:
        assert str(error).startswith("here: ") and "\n" not in str(error)
    else:
        solutions_to_bytes(found)


@pytest.mark.parametrize("camera", ["[NaN, 72, 1.0]", "[1.5, 72, 1.0]", "[96, true, 1.0]", f"[{10**400}, 72, 1.0]"])
def test_a_display_that_is_none_is_one_line(solutions, camera):
    """Its views are made later, where nobody expects bad numbers."""
    whole = solutions_to_bytes(solutions)[:-32]
    length = int.from_bytes(whole[8:12], "little")
    told = json.loads(whole[12 : 12 + length])
    header = json.dumps({**told, "camera": "CAMERA"}).replace('"CAMERA"', camera).encode()
    bad = signed(whole[:8] + len(header).to_bytes(4, "little") + header + whole[12 + length :])
    with pytest.raises(DatasetError, match=r"^here: .*(camera|a display).* expected"):
        solutions_from(bad, "here")
