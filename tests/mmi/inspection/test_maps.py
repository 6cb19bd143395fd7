"""Maps of a cell: what they show, checked on the figures' content, and that nothing covers anything else."""

from __future__ import annotations

import math

import networkx as nx
import numpy as np
import pytest
from matplotlib.collections import LineCollection, PathCollection
from matplotlib.colors import to_rgba
from shapely.geometry import LineString, Polygon, box

from mmi.cells.viewing_cells import ViewingCell
from mmi.city.model import City, CityObject, Prism
from mmi.foundation.camera import Camera
from mmi.inspection.figures import layer_style
from mmi.inspection.maps import birds_eye, event_graph_plot
from mmi.planning.plan import CellPlan
from mmi.visibility.selection import Selection

CAMERA = Camera(512, 512, math.radians(60.0))
T = 10.0


def plan_of(layers=2, per_layer=2, near=3, culled=5):
    """A city in rows: near objects beside the cell, a row of far objects per layer, culled ones far away."""
    footprints = [box(-20 + 14 * i, 10, -10 + 14 * i, 20) for i in range(near)]
    footprints += [
        box(40 * k, 60 + 30 * row, 40 * k + 20, 80 + 30 * row) for row in range(layers) for k in range(per_layer)
    ]
    footprints += [box(-400, 20 * i, -390, 20 * i + 10) for i in range(culled)]
    objects = tuple(CityObject(f"b{i}", (Prism(one, 0.0, 10.0),)) for i, one in enumerate(footprints))
    streets = nx.MultiGraph()
    streets.add_node(0, x=-50.0, y=0.0)
    streets.add_node(1, x=50.0, y=0.0)
    streets.add_edge(
        0, 1, geometry=LineString([(-50, 0), (50, 0)]), kind="street", half_width=3.0, name="High St", index=0
    )
    city = City(objects, streets, "EPSG:32631", (0.0, 0.0, 0.0), "rows")
    cell = ViewingCell("0000-00", (-15.0, 0.0), (15.0, 0.0), 3.0, (1.5, 1.9), "High St")
    count = near + layers * per_layer
    selection = Selection(city, cell, np.arange(count), np.arange(near))
    members = tuple(near + per_layer * row + np.arange(per_layer) for row in range(layers))
    far = selection.far
    pairs = np.array([(a, b) for a in far for b in far if a < b], dtype=np.int64).reshape(-1, 2)
    row = (pairs - near) // per_layer
    pixels = np.where(row[:, 0] == row[:, 1], 2.0, 20.0 * np.abs(row[:, 1] - row[:, 0]))
    weights = np.array([CAMERA.angle_from_pixels(one) for one in pixels])
    graph = nx.Graph()
    graph.add_nodes_from(far.tolist())
    graph.add_weighted_edges_from(
        (int(a), int(b), float(w)) for (a, b), w in zip(pairs, weights, strict=True) if w > CAMERA.angle_from_pixels(T)
    )
    return city, CellPlan(selection, pairs, weights, graph, members, None)


def labels(figure):
    return [text.get_text() for text in figure.legends[0].get_texts()]


def drawn(axes, color):
    """Outlines filled with ``color`` at full strength."""
    return [
        path
        for one in axes.collections
        if isinstance(one, PathCollection)
        and len(one.get_facecolor())
        and tuple(one.get_facecolor()[0]) == to_rgba(color)
        for path in one.get_paths()
    ]


def test_birds_eye_counts_and_colours_every_object():
    city, plan = plan_of(layers=3, per_layer=2, near=3, culled=5)
    figure = birds_eye(city, plan, reach=1000.0)
    (axes,) = figure.axes
    assert labels(figure) == [
        "viewing cell, 30 x 6.0 m", "near, stays geometry (3)", "layer 0 (2)", "layer 1 (2)", "layer 2 (2)",
        "critical zones, per layer", "not visible (5)", "streets",
    ]  # fmt: skip
    for layer, members in enumerate(plan.layers):
        corners = {tuple(path.vertices.min(axis=0)) for path in drawn(axes, layer_style(layer)[0])}
        assert corners == {city.objects[i].footprint.bounds[:2] for i in members}
    assert len(drawn(axes, "#3A3A3A")) == 3 and len(drawn(axes, "#E4E4E4")) == 5


def test_birds_eye_shows_everything_visible_or_the_reach_asked_for():
    city, plan = plan_of()
    (axes,) = birds_eye(city, plan).axes
    (x0, x1), (y0, y1) = axes.get_xlim(), axes.get_ylim()
    assert x0 < -20 and 60 < x1 and y0 < -3 and 110 < y1
    assert x0 > -390  # culled objects do not stretch the map
    (axes,) = birds_eye(city, plan, reach=50.0).axes
    assert axes.get_xlim() == (-50.0, 50.0) and axes.get_ylim() == (-50.0, 50.0)


def test_courtyards_stay_open():
    city, plan = plan_of(layers=1, per_layer=1, near=0, culled=0)
    yard = Polygon(box(0, 60, 30, 90).exterior.coords, [box(5, 65, 25, 85).exterior.coords])
    city = City((CityObject("b0", (Prism(yard, 0.0, 10.0),)),), city.streets, city.crs, city.origin, city.source)
    plan = CellPlan(
        Selection(city, plan.selection.cell, [0], []), plan.pairs, plan.weights, plan.graph, plan.layers, None
    )
    figure = birds_eye(city, plan)
    figure.canvas.draw()
    pixels = np.asarray(figure.canvas.buffer_rgba())
    wanted = 255 * np.array(to_rgba(layer_style(0)[0]))

    def shade(x, y):
        column, row = figure.axes[0].transData.transform((x, y)).round().astype(int)
        return pixels[pixels.shape[0] - row, column].astype(float)

    assert np.abs(shade(2.5, 75.0) - wanted).max() < 3
    assert np.abs(shade(15.0, 75.0) - wanted).max() > 60


def test_event_graph_draws_every_edge_in_pixels_and_every_node():
    city, plan = plan_of(layers=3)
    figure = event_graph_plot(city, plan, camera=CAMERA, max_error_px=T)
    left = figure.axes[0]
    (edges,) = [one for one in left.collections if isinstance(one, LineCollection)]
    assert len(edges.get_segments()) == plan.graph.number_of_edges() == 12
    assert np.allclose(np.sort(edges.get_array()), [20.0] * 8 + [40.0] * 4)
    nodes = np.concatenate([one.get_offsets() for one in left.collections if len(one.get_offsets()) == 2])
    assert len(nodes) == 6 and {(10.0, 70.0), (50.0, 70.0)} <= set(map(tuple, nodes.tolist()))


def test_weights_are_counted_on_the_right_side_of_the_threshold():
    city, plan = plan_of(layers=3)
    figure = event_graph_plot(city, plan, camera=CAMERA, max_error_px=T)
    right = figure.axes[1]
    assert [text.get_text() for text in right.get_legend().get_texts()] == [
        "may share a layer (3)", "kept apart (12)", "threshold, 10 px",
    ]  # fmt: skip
    for bar in right.patches:
        assert bar.get_height() == 0 or bar.get_x() >= T - 1e-9 or bar.get_x() + bar.get_width() <= T + 1e-9
    assert sum(bar.get_height() for bar in right.patches) == 15


def test_weights_beyond_a_right_angle_are_drawn():
    city, plan = plan_of()
    plan.graph.add_edge(3, 5, weight=2.0 * math.pi)
    weights = np.full(len(plan.weights), 2.0 * math.pi)
    figure = event_graph_plot(
        city,
        CellPlan(plan.selection, plan.pairs, weights, plan.graph, plan.layers, None),
        camera=CAMERA,
        max_error_px=T,
    )
    assert sum(bar.get_height() for bar in figure.axes[1].patches) == len(weights)


@pytest.mark.parametrize(
    "shape", [{}, {"layers": 21, "per_layer": 1}, {"layers": 0, "near": 0}, {"layers": 0, "culled": 0}]
)
def test_nothing_overlaps_and_nothing_is_cut(shape):
    city, plan = plan_of(**shape)
    for figure in (birds_eye(city, plan), event_graph_plot(city, plan, camera=CAMERA, max_error_px=T)):
        figure.canvas.draw()
        whole = figure.bbox
        legend = figure.legends[0].get_window_extent()
        boxes = [axes.get_tightbbox() for axes in figure.axes]
        for one in (legend, *boxes):
            assert whole.x0 <= one.x0 and one.x1 <= whole.x1 and whole.y0 <= one.y0 and one.y1 <= whole.y1
        for i, one in enumerate((legend, *boxes)):
            assert not any(one.overlaps(other) for other in (legend, *boxes)[:i])


def test_layers_look_different():
    assert len({layer_style(layer) for layer in range(28)}) == 28
