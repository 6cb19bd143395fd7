"""Styles: what is tinted, what stays alone, and where lines are; the picture without a style is as it was."""

import math
from dataclasses import replace

import numpy as np
import pytest

from mmi.appearance.layer_colors import LAYER_COLORS
from mmi.foundation.camera import level_view
from viewer.cells.loaded_cell import load_cell
from viewer.drawing.renderer import Renderer
from viewer.drawing.style import (
    PLAIN,
    Style,
    fresh_parts,
    layer_ink,
    layer_names,
    narrowed,
)
from viewer.plan import (
    CellKey,
    CellLayers,
    Ground,
    ImageKey,
    Objects,
    Plan,
    Relief,
    ReliefPart,
    Request,
    Sky,
    Slot,
)

SIZE = (320, 240)
WINDOW = (-160, -120, *SIZE)
CELL = "0001-01"
KEY = CellKey("multi-mesh", CELL)
AZIMUTHS = (0.3, 1.9, 3.4, 5.0)


@pytest.fixture(scope="module")
def place(scene):
    return scene.cell(CELL)


@pytest.fixture(scope="module")
def loaded(scene):
    return load_cell(scene, CELL, measured=True)


@pytest.fixture(scope="module")
def renderer(scene, loaded):
    with Renderer(scene.mesh, scene.ground, size=SIZE, measured=True) as renderer:
        renderer.upload(loaded)
        yield renderer


def look(place, azimuth):
    return level_view(place.cell.reference + np.array([3.0, 0.2, 0.0]), azimuth, focal=277.0, window=WINDOW)


def layered(scene, place):
    every = Ground(tuple(range(len(scene.ground.triangle_counts))))
    return Plan((Objects("near", place.near), CellLayers(KEY, place.layers), every, Sky()))


def of_layers(frame):
    """Pixels that show an impostor: nothing else has a displacement."""
    return np.isfinite(frame.displacement)


def rgb(text):
    return np.array(list(bytes.fromhex(text[1:])), dtype=float)


def test_tint_changes_the_pixels_of_layers_and_no_others(scene, place, renderer):
    tinted = 0
    for azimuth in AZIMUTHS:
        view = look(place, azimuth)
        plain = renderer.draw(layered(scene, place), view, measured=True)
        frame = renderer.draw(layered(scene, place), view, measured=True, style=Style(tint=True))
        np.testing.assert_array_equal(frame.object_ids, plain.object_ids)
        np.testing.assert_array_equal(frame.depth, plain.depth)
        changed = (frame.color != plain.color).any(axis=2)
        assert not (changed & ~of_layers(plain)).any()
        assert changed[of_layers(plain)].mean() > 0.95 if of_layers(plain).any() else True
        tinted += int(changed.sum())
        unmeasured = renderer.draw(layered(scene, place), view, style=Style(tint=True))
        assert np.mean((unmeasured.color != frame.color).any(axis=2)) < 0.01
    assert tinted > 500


def test_each_layer_has_its_own_colour(place, renderer):
    """A layer's pixels are its picture mixed with its colour: 60 parts of 100."""
    indices = {int(name.split(".")[1][1:]) for name in place.layers}
    assert len(indices) > 1
    seen = set()
    for index in sorted(indices):
        names = tuple(name for name in place.layers if int(name.split(".")[1][1:]) == index)
        assert layer_names(place.layers, index) == set(names)
        for azimuth in AZIMUTHS:
            plan = Plan((CellLayers(KEY, names), Sky()))
            plain, frame = (
                renderer.draw(plan, look(place, azimuth), measured=True, style=style)
                for style in (PLAIN, Style(tint=True))
            )
            shown = of_layers(plain)
            expected = 0.4 * plain.color[shown] + 0.6 * rgb(LAYER_COLORS[index])
            np.testing.assert_allclose(frame.color[shown], expected, atol=2.0)
            seen |= {index} if shown.any() else set()
    assert seen == indices


def test_a_layer_alone_stands_before_the_sky(scene, place, renderer):
    some = layer_names(place.layers, 0)
    assert 0 < len(some) < len(place.layers)
    for azimuth in AZIMUTHS:
        view = look(place, azimuth)
        frame = renderer.draw(layered(scene, place), view, measured=True, style=Style(alone=some))
        only = renderer.draw(
            Plan((CellLayers(KEY, tuple(n for n in place.layers if n in some)), Sky())), view, measured=True
        )
        for found, expected in ((frame.color, only.color), (frame.object_ids, only.object_ids)):
            np.testing.assert_array_equal(found, expected)
        assert set(np.unique(frame.object_ids)) <= {-1, *place.visible} - set(place.near)


def test_a_style_does_not_linger(scene, place, renderer):
    view = look(place, AZIMUTHS[2])
    before = renderer.draw(layered(scene, place), view)
    for style in (Style(tint=True), Style(wireframe=True), Style(alone=frozenset())):
        styled = renderer.draw(layered(scene, place), view, style=style)
        assert not np.array_equal(styled.color, before.color)
    after = renderer.draw(layered(scene, place), view)
    np.testing.assert_array_equal(after.color, before.color)


def line_pixels(view, vertices, triangles):
    """The oracle: pixels that the edges of triangles go through, from points along them; edges that cross the eye's plane
    are left out.
    """
    found = np.zeros(SIZE[::-1], dtype=bool)
    for a, b in np.unique(np.sort(np.concatenate([triangles[:, [i, (i + 1) % 3]] for i in range(3)]), axis=1), axis=0):
        ends = vertices[[a, b]].astype(float)
        at = view.project(ends[0] + np.linspace(0.0, 1.0, 800)[:, None] * (ends[1] - ends[0]))
        if (at[:, 2] > 0.2).all():
            column = np.floor(at[:, 0] - WINDOW[0]).astype(int)
            row = np.floor(at[:, 1] - WINDOW[1]).astype(int)
            inside = (column >= 0) & (column < SIZE[0]) & (row >= 0) & (row < SIZE[1])
            found[row[inside], column[inside]] = True
    return found


def grown(mask):
    padded = np.pad(mask, 1)
    height, width = mask.shape
    return np.any([padded[i : i + height, j : j + width] for i in range(3) for j in range(3)], axis=0)


def test_lines_of_layers_are_the_projected_edges_of_their_meshes(place, loaded, renderer):
    """All lines lie on edges, in the layer's colour; and edges of the outermost layers, which nothing hides, are all there."""
    lines = 0
    for layer in loaded.layers:
        azimuth = 2.0 * math.pi / 6.0 * int(layer.name[1])
        view = look(place, azimuth)
        plan = Plan((CellLayers(KEY, (layer.name,)), Sky()))
        frame = renderer.draw(plan, view, style=Style(wireframe=True))
        paint = 0.85 * np.array(layer_ink(layer.name)[:3]) + 0.15 * 255.0
        drawn = np.abs(frame.color - paint).max(axis=2) < 3.0
        expected = line_pixels(view, layer.vertices[:, :3], layer.triangles)
        assert not (drawn & ~grown(expected)).any()
        silhouette = expected & ~grown(line_interior(view, layer))
        assert grown(drawn)[silhouette].all()
        lines += int(drawn.sum())
    assert lines > 500


def line_interior(view, layer):
    """Pixels of edges that the layer's own surface may hide: those in front of which, or on which, another triangle is."""
    found = np.zeros(SIZE[::-1], dtype=bool)
    at = view.project(layer.vertices[:, :3].astype(float))
    x, y = np.meshgrid(np.arange(SIZE[0]) + WINDOW[0] + 0.5, np.arange(SIZE[1]) + WINDOW[1] + 0.5)
    for corners in at[layer.triangles]:
        if not (corners[:, 2] > 0.2).all():
            continue
        (ax, ay), (bx, by), (cx, cy) = corners[:, :2]
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if abs(area) < 1e-9:
            continue
        u = ((x - ax) * (cy - ay) - (y - ay) * (cx - ax)) / area
        v = ((bx - ax) * (y - ay) - (by - ay) * (x - ax)) / area
        found |= (u > 0.0) & (v > 0.0) & (u + v < 1.0)
    return found


def test_lines_of_near_geometry_are_the_projected_edges_of_its_triangles(scene, place, renderer):
    view = look(place, AZIMUTHS[0])
    plan = Plan((Objects("near", place.near), Sky()))
    frame = renderer.draw(plan, view, style=Style(wireframe=True))
    drawn = (frame.color >= 228).all(axis=2)
    starts = scene.mesh.object_triangles
    triangles = np.concatenate([scene.mesh.triangles[starts[i] : starts[i + 1]] for i in place.near])
    assert drawn.sum() > 50
    crossing = (
        (view.project(scene.mesh.positions[triangles.ravel()].astype(float))[:, 2] < 0.2).reshape(-1, 3).any(axis=1)
    )
    expected = grown(line_pixels(view, scene.mesh.positions, triangles[~crossing]))
    near_the_eye = line_pixels_of_crossing(view, scene.mesh.positions, triangles[crossing])
    assert not (drawn & ~expected & ~grown(near_the_eye)).any()


def line_pixels_of_crossing(view, vertices, triangles):
    """As :func:`line_pixels`, of edges whose ends may lie behind the eye: only the part before it."""
    found = np.zeros(SIZE[::-1], dtype=bool)
    for corners in vertices[triangles].astype(float):
        for i in range(3):
            a, b = corners[i], corners[(i + 1) % 3]
            at = view.project(a + np.linspace(0.0, 1.0, 4000)[:, None] * (b - a))
            at = at[at[:, 2] > 0.1]
            column, row = np.floor(at[:, 0] - WINDOW[0]).astype(int), np.floor(at[:, 1] - WINDOW[1]).astype(int)
            inside = (column >= 0) & (column < SIZE[0]) & (row >= 0) & (row < SIZE[1])
            found[row[inside], column[inside]] = True
    return found


def test_lines_leave_what_is_measured_and_counted(scene, place, renderer):
    view = look(place, AZIMUTHS[1])
    plain, lined = (
        renderer.draw(layered(scene, place), view, measured=True, style=style)
        for style in (PLAIN, Style(wireframe=True))
    )
    for name in ("object_ids", "depth", "displacement"):
        np.testing.assert_array_equal(getattr(plain, name), getattr(lined, name))
    assert (lined.triangles, lined.draws) == (plain.triangles, plain.draws)


def captured(place, view, *, again):
    """A plan that shows a captured picture of the far objects, and captures it in this frame or, ``again``, has before."""
    image = ImageKey("test", "s0.l0 1")
    far = Objects("", np.setdiff1d(place.visible, place.near))
    request = Request(Slot(image, SIZE), view, (far,))
    return Plan((Relief(image, (ReliefPart(view, (0, 0), 100.0),)), Sky()), requests=() if again else (request,))


def test_captured_pictures_are_tinted_by_when_they_were_captured(place, renderer):
    view = look(place, AZIMUTHS[2])
    plain = renderer.draw(captured(place, view, again=False), view, measured=True)
    shown = of_layers(plain)
    assert shown.any()
    light, dark = (
        renderer.draw(captured(place, view, again=again), view, measured=True, style=Style(tint=True)).color
        for again in (False, True)
    )
    for frame, ink in ((light, 255.0), (dark, 0.0)):
        np.testing.assert_array_equal(frame[~shown], plain.color[~shown])
        exact = np.abs(frame - (0.4 * plain.color + 0.6 * ink)).max(axis=2) < 2.0
        assert 0.6 < exact[shown].mean() < 0.95, "the rest is stripes"


def test_lines_of_captured_pictures_are_their_grids(place, renderer):
    view = look(place, AZIMUTHS[2])
    renderer.draw(captured(place, view, again=False), view)
    plain = renderer.draw(captured(place, view, again=True), view, measured=True)
    lined = renderer.draw(captured(place, view, again=True), view, style=Style(wireframe=True))
    lines = (np.abs(lined.color - 140.0).max(axis=2) < 2.0) & of_layers(plain)
    shown = of_layers(plain).sum(axis=0)
    columns = np.flatnonzero((shown > 8) & (lines.sum(axis=0) > 0.7 * shown))
    assert len(columns) > 3
    assert set((columns % 16).tolist()) <= {0, 15}, "upright lines are a quad of 16 texels apart"


def test_parts_are_fresh_where_a_request_meets_their_place():
    view = level_view(np.zeros(3), 0.0, focal=100.0, window=(-8, -8, 16, 16))
    image = ImageKey("test", "movers")
    parts = tuple(ReliefPart(view, corner, 1.0) for corner in ((0, 0), (16, 0), (16, 16)))
    relief = Relief(image, parts)
    strip = Request(Slot(image, (64, 64), (20, 4)), view.cropped((0, 0, 4, 4)), ())
    elsewhere = Request(Slot(ImageKey("test", "other"), (64, 64)), view, ())
    fresh, rest = fresh_parts(relief, (strip, elsewhere))
    assert fresh.parts == parts[1:2]
    assert rest.parts == (parts[0], parts[2])


def test_narrowed_plans_keep_requests_and_the_sky(scene, place):
    view = look(place, 0.0)
    part = (ReliefPart(view, (0, 0), 1.0),)
    one, all_of_them = (Relief(ImageKey("multi-mesh-dynamic", name), part) for name in ("s0.l1 7", "view 7"))
    request = Request(Slot(one.image, SIZE), view, ())
    plan = Plan((*layered(scene, place).draws, one, all_of_them), requests=(request,))
    found = narrowed(plan, Style(alone=frozenset({"s0.l1", "s2.l1"})))
    assert found.requests == plan.requests
    layers, sky, relief = found.draws
    assert set(layers.names) <= {"s0.l1", "s2.l1"}
    assert (sky, relief) == (Sky(), one)
    assert narrowed(plan, Style(tint=True)) is plan
    assert narrowed(replace(plan, fading=plan.draws), Style(alone=frozenset())).fading[-1] == Sky()


def test_all_of_the_first_layers_have_inks_of_their_own():
    assert len({layer_ink(f"s0.l{layer}") for layer in range(28)}) == 28
    assert layer_ink("s3.l2.1") == layer_ink("s0.l2")
    with pytest.raises(ValueError, match="found 'near'"):
        layer_ink("near")
