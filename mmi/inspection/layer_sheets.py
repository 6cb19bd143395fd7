"""Plots of what a build made: the layers of a sector as pictures, and how big the cells of a dataset are."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, MaxNLocator, StrMethodFormatter
from numpy.typing import ArrayLike, NDArray

from mmi.capture.layer_values import Layer
from mmi.inspection.figures import EMPHASIS, INK, SMALL, counted, new_figure, plain_log_ticks, tidy

__all__ = ["dataset_histograms", "layer_sheet"]

_COLUMN = 2.7
"""Inches that a picture may be wide."""
_TALLEST = 2.2
"""Inches that a picture may be high."""
_ABOVE, _BELOW, _LEFT, _BETWEEN = 0.24, 0.34, 0.75, 0.5
"""Inches around a picture for its text and its ticks."""
_TOP = 0.6
"""Inches above all pictures for the title and the columns' headings."""
_TEXEL = 1.0 / 36.0
"""Inches that a texel may be large."""


def layer_sheet(layers: Sequence[Layer], *, title: str = "") -> Figure:
    """The layers of one sector, a row each: captured colour, depth in metres, and the mesh over the dimmed picture.

    ``layers`` are those of one sector, at least one. Axes are texels from the picture's principal
    point, u to the right and v down. Raises ValueError for layers of several sectors or none.
    """
    sectors = sorted({one.sector for one in layers})
    if len(sectors) != 1:
        raise ValueError(f"the layers of one sector expected, found sectors {sectors}")
    scales = [_scale(one) for one in layers]
    windows = [one.texture.view.window for one in layers]
    rows = [scale * window[3] + _ABOVE + _BELOW for window, scale in zip(windows, scales, strict=True)]
    wide, high = _LEFT + 3.0 * _COLUMN + 2.0 * _BETWEEN + 0.2, _TOP + sum(rows) + 0.8
    figure = new_figure(wide, high, arrange=False)

    def add(left: float, top: float, width: float, height: float) -> Axes:
        """Axes at inches from the figure's upper left corner."""
        return figure.add_axes((left / wide, 1.0 - (top + height) / high, width / wide, height / high))

    grid = []
    for i, (scale, window) in enumerate(zip(scales, windows, strict=True)):
        top = _TOP + sum(rows[:i]) + _ABOVE
        lefts = [_LEFT + j * (_COLUMN + _BETWEEN) for j in range(3)]
        grid.append([add(left, top, scale * window[2], scale * window[3]) for left in lefts])
    finite = np.concatenate([one.texture.depth[one.texture.coverage] for one in layers])
    nearest, farthest = float(finite.min(initial=np.inf)), float(finite.max(initial=0.0))
    norm = LogNorm(nearest, max(farthest, 1.01 * nearest)) if finite.size else LogNorm(1.0, 10.0)
    for row, one, scale in zip(grid, layers, scales, strict=True):
        _layer_row(row, one, norm, scale)
    for axes, text in zip(grid[0], ("colour where covered", "depth", "mesh"), strict=True):
        axes.annotate(text, (0.0, 1.0), (0, 20), xycoords="axes fraction", textcoords="offset points", weight="bold")
    for axes in grid[-1]:
        axes.annotate(
            "u, v (texels)",
            (0.0, 0.0),
            (0, -20),
            xycoords="axes fraction",
            textcoords="offset points",
            va="top",
            fontsize=7,
        )
    scale_of_depth = add(_LEFT, high - 0.62, wide - _LEFT - 0.2, 0.12)
    bar = figure.colorbar(grid[0][1].images[-1], cax=scale_of_depth, orientation="horizontal")
    bar.set_label("depth along the line of sight (m)", fontsize=SMALL)
    plain_log_ticks(bar.ax.xaxis, norm.vmin or 1.0, norm.vmax or 10.0)
    if title:
        figure.suptitle(
            title, fontsize=11, x=0.01, y=1.0 - 0.12 / high, ha="left", va="top", weight="bold", parse_math=False
        )
    return figure


def dataset_histograms(
    *,
    layers_per_view: ArrayLike,
    cell_bytes: ArrayLike,
    near_objects: ArrayLike,
    visible_objects: ArrayLike,
    triangles: ArrayLike,
    title: str = "",
) -> Figure:
    """How big the cells of a dataset are; each argument is a number per cell, ``layers_per_view`` one per cell and sector."""
    figure = new_figure(11.0, 6.4)
    grid = figure.add_gridspec(2, 3)
    panels = [figure.add_subplot(grid[i, j]) for i in range(2) for j in range(3)]
    kilobytes = np.asarray(cell_bytes, dtype=np.float64) / 1000.0
    for axes, values, what, unit in (
        (panels[0], layers_per_view, "layers per view", "views"),
        (panels[1], visible_objects, "visible objects per cell", "cells"),
        (panels[2], near_objects, "near objects per cell", "cells"),
        (panels[3], triangles, "layer triangles per cell", "cells"),
        (panels[4], kilobytes, "kB per cell", "cells"),
    ):
        _histogram(axes, np.asarray(values, dtype=np.float64), what, unit)
    _running_total(panels[5], kilobytes)
    if title:
        figure.suptitle(title, fontsize=11, x=0.01, ha="left", weight="bold", parse_math=False)
    return figure


def _scale(layer: Layer) -> float:
    """Inches a texel, so that a layer's picture fits its column and small windows are not blown up."""
    _, _, width, height = layer.texture.view.window
    return min(_COLUMN / width, _TALLEST / height, _TEXEL)


def _layer_row(row: Sequence[Axes], one: Layer, norm: LogNorm, scale: float) -> None:
    """Colour, depth and mesh of one layer, ``scale`` inches a texel."""
    texture = one.texture
    left, top, width, height = texture.view.window
    extent = (left, left + width, top + height, top)
    covered = texture.coverage
    square = max(2, round(0.07 / scale))
    tiles = (np.arange(height)[:, None] // square + np.arange(width) // square) % 2
    paper = np.repeat(np.where(tiles == 0, 255, 226).astype(np.uint8)[..., None], 3, axis=2)
    color = np.where(covered[..., None], texture.color, paper)
    pale = (255 - (255 - color.astype(np.uint16)) * 2 // 5).astype(np.uint8)
    row[0].imshow(color, extent=extent, interpolation="antialiased")
    row[1].imshow(
        np.ma.masked_where(~covered, texture.depth), extent=extent, norm=norm, cmap="viridis_r", interpolation="nearest"
    )
    row[1].set_facecolor("#EEEEEE")
    row[2].imshow(pale, extent=extent, interpolation="antialiased")
    corners = one.mesh.uv * [width, height] + [left, top]
    sides = np.sort(one.mesh.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    wires = LineCollection(list(corners[np.unique(sides, axis=0)]), colors="#08306B", linewidths=0.35)
    row[2].add_collection(wires, autolim=False)
    depth = texture.depth[covered]
    between = f"{depth.min():.0f} to {depth.max():.0f} m" if depth.size else "nothing covered"
    piece = f", piece {one.piece + 1}" if one.piece else ""
    texts = (
        f"layer {one.index}{piece}: {counted(len(one.objects), 'object')}, {width} x {height} texels",
        f"{between}, {covered.mean():.0%} covered",
        counted(len(one.mesh.triangles), "triangle"),
    )
    for axes, text in zip(row, texts, strict=True):
        axes.set_title(text, loc="left", fontsize=SMALL, pad=4)
        axes.tick_params(labelsize=7)
        few = scale * width < 1.0  # inches: no room for two labels
        axes.xaxis.set_major_locator(FixedLocator([left]) if few else MaxNLocator(min(6, int(2.0 * scale * width))))
        axes.yaxis.set_major_locator(MaxNLocator(int(np.clip(scale * height / 0.3, 1, 4)), integer=True))
        for spine in axes.spines.values():
            spine.set_color("#999999")


def _histogram(axes: Axes, values: NDArray[np.float64], what: str, unit: str) -> None:
    """Counts of ``values``, whole numbers in bins of whole numbers, with median and largest."""
    whole = bool(values.size) and bool((values == np.round(values)).all())
    low, high = (float(values.min()), float(values.max())) if values.size else (0.0, 1.0)
    if whole:
        step = max(1, math.ceil((high - low + 1) / 30))
        bins = np.arange(low, high + step + 1, step) - 0.5
    else:
        bins = np.linspace(low, max(high, low + 1e-9), 31)
    axes.hist(values, bins=bins.tolist(), color="#6BAED6", edgecolor="white", linewidth=0.4)
    if values.size:
        median = float(np.median(values))
        axes.axvline(median, color=EMPHASIS, linewidth=1.5)
        text = f"median {_figure_text(median)}, largest {_figure_text(high)}"
        axes.set_title(text, loc="left", fontsize=SMALL, color=INK)
    axes.set_xlabel(what, fontsize=9)
    axes.set_ylabel(unit, fontsize=9)
    axes.yaxis.set_major_locator(MaxNLocator(5, integer=True))
    axes.xaxis.set_major_locator(MaxNLocator(6, integer=whole))
    axes.xaxis.set_major_formatter(StrMethodFormatter("{x:,g}"))
    axes.tick_params(labelsize=SMALL)
    tidy(axes)


def _running_total(axes: Axes, kilobytes: NDArray[np.float64]) -> None:
    """How the dataset's bytes add up over its cells, largest first."""
    total = np.concatenate([[0.0], np.cumsum(np.sort(kilobytes)[::-1])]) / 1000.0
    axes.plot(np.arange(len(total)), total, color="#2171B5", linewidth=1.8)
    axes.set_xlim(0, max(len(total) - 1, 1))
    axes.set_ylim(bottom=0.0)
    axes.set_xlabel("cells, largest first", fontsize=9)
    axes.set_ylabel("MB in all", fontsize=9)
    axes.set_title(f"{_figure_text(total[-1])} MB in {counted(len(kilobytes), 'cell')}", loc="left", fontsize=SMALL)
    axes.xaxis.set_major_locator(MaxNLocator(5, integer=True))
    axes.tick_params(labelsize=SMALL)
    tidy(axes)


def _figure_text(value: float) -> str:
    """A number with three digits that count, thousands apart."""
    return f"{value:,.0f}" if abs(value) >= 100.0 else f"{value:.3g}"
