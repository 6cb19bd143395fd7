"""Layer sheets and histograms, checked on the figures' content."""

from __future__ import annotations

import math

import numpy as np
import pytest
from matplotlib.collections import LineCollection

from mmi.capture.layer_values import DepthTexture, Layer
from mmi.cells.viewing_cells import ViewingCell
from mmi.foundation.camera import level_view
from mmi.inspection.layer_sheets import dataset_histograms, layer_sheet
from mmi.meshing.grid_mesh import grid_mesh
from mmi.parallax.from_anywhere import viewers_of


def layer_of(index, *, sector=0, width=128, height=64, near=50.0):
    """A wall whose depth grows to the right, covering the middle of its window."""
    view = level_view(np.array([0.0, 0.0, 1.7]), 0.0, focal=400.0, window=(-32, -48, width, height))
    color = np.full((height, width, 3), (200, 40, 40), dtype=np.uint8)
    depth = np.full((height, width), np.inf, dtype=np.float32)
    inner = (slice(height // 4, -height // 4), slice(width // 4, -width // 4))
    depth[inner] = np.linspace(near, near + 30.0, width)[inner[1]]
    ids = np.where(np.isfinite(depth), index, -1).astype(np.int32)
    texture = DepthTexture(view, color, depth, ids)
    aside = view.eye + np.array([[0.0, -20.0, 0.0], [0.0, 20.0, 0.0]])
    viewers = viewers_of(ViewingCell("", (0.0, -20.0), (0.0, 20.0), 1.0, (1.7, 1.7)), view)
    mesh = grid_mesh(texture, viewpoints=aside, tolerance=0.01, viewers=viewers, widest=math.pi)
    return Layer(index, sector, 0, np.array([index]), texture, mesh, 0.0)


def test_a_row_shows_colour_depth_and_mesh_of_its_layer():
    layers = [layer_of(0), layer_of(2, near=90.0)]
    figure = layer_sheet(layers, title="cell")
    *panels, bar = figure.axes
    assert len(panels) == 6
    assert [panels[i].get_title(loc="left") for i in (0, 1, 3, 4)] == [
        "layer 0: 1 object, 128 x 64 texels", "58 to 72 m, 25% covered",
        "layer 2: 1 object, 128 x 64 texels", "98 to 112 m, 25% covered",
    ]  # fmt: skip
    color, depth = (np.ma.asarray(panels[i].images[0].get_array()) for i in (0, 1))
    covered = layers[0].texture.coverage
    assert (color[covered] == (200, 40, 40)).all()
    uncovered = color[~covered]
    assert (uncovered[:, 0] == uncovered[:, 1]).all() and set(np.unique(uncovered)) == {226, 255}
    assert (np.ma.getmaskarray(depth) == ~covered).all()
    assert panels[1].images[0].norm is panels[4].images[0].norm  # one colour bar serves all rows
    assert bar.get_xlabel() == "depth along the line of sight (m)"


def test_wires_are_the_edges_of_the_mesh_in_texels():
    one = layer_of(0)
    axes = layer_sheet([one]).axes[2]
    (wires,) = [c for c in axes.collections if isinstance(c, LineCollection)]
    edges = {frozenset(pair) for a, b, c in one.mesh.triangles.tolist() for pair in ((a, b), (b, c), (c, a))}
    assert len(wires.get_segments()) == len(edges)
    corners = np.concatenate(wires.get_segments())
    used = one.mesh.uv[np.unique(one.mesh.triangles)] * [128, 64] + [-32, -48]
    assert corners.min(axis=0) == pytest.approx(used.min(axis=0)) and corners.max(axis=0) == pytest.approx(
        used.max(axis=0)
    )
    assert axes.get_xlim() == (-32, 96) and axes.get_ylim() == (16, -48)


@pytest.mark.parametrize("sizes", [[(16, 64)], [(16, 256), (1024, 16)], [(768, 64)] * 9])
def test_nothing_overlaps_and_nothing_is_cut(sizes):
    figure = layer_sheet([layer_of(i, width=w, height=h) for i, (w, h) in enumerate(sizes)], title="cell 0000-00")
    figure.canvas.draw()
    boxes = [axes.get_tightbbox() for axes in figure.axes]
    for i, one in enumerate(boxes):
        assert figure.bbox.x0 <= one.x0 and one.x1 <= figure.bbox.x1
        assert figure.bbox.y0 <= one.y0 and one.y1 <= figure.bbox.y1
        assert not any(one.overlaps(other) for other in boxes[:i])


def test_layers_of_several_sectors_are_refused():
    with pytest.raises(ValueError, match=r"one sector expected, found sectors \[0, 1\]"):
        layer_sheet([layer_of(0), layer_of(1, sector=1)])
    with pytest.raises(ValueError, match="found sectors"):
        layer_sheet([])


def histograms(n):
    whole = np.arange(n)
    return dataset_histograms(
        layers_per_view=np.repeat(whole % 5, 6),
        cell_bytes=1000.0 * (whole + 1),
        near_objects=whole % 7,
        visible_objects=whole + 100,
        triangles=13 * whole,
        title="city",
    )


def test_histograms_count_everything_once():
    panels = histograms(90).axes
    counts = [sum(bar.get_height() for bar in axes.patches) for axes in panels]
    assert counts == [540, 90, 90, 90, 90, 0]
    assert [bar.get_height() for bar in panels[0].patches] == [108] * 5  # a bar for each whole number
    assert panels[0].get_title(loc="left") == "median 2, largest 4"
    assert panels[4].get_xlabel() == "kB per cell"
    assert panels[5].get_title(loc="left") == "4.09 MB in 90 cells"
    total = panels[5].lines[0].get_ydata()
    assert total[1] == pytest.approx(0.090) and total[-1] == pytest.approx(4.095)


@pytest.mark.parametrize("n", [0, 1])
def test_histograms_of_hardly_anything(n):
    histograms(n).canvas.draw()
