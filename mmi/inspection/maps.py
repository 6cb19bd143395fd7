"""Maps of a cell: what a build decided about each object, and the graph of visibility events behind its layers.

Every function turns values into a matplotlib Figure; nothing here computes anything that a dataset depends on. Maps are
north up, in the city's frame.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np
import shapely
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PathCollection
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from matplotlib.patches import Polygon as Region
from matplotlib.path import Path as Outline
from matplotlib.ticker import MaxNLocator
from numpy.typing import ArrayLike, NDArray
from shapely.geometry import Polygon
from shapely.geometry.base import BaseGeometry

from mmi.cells.viewing_cells import ViewingCell
from mmi.city.model import City
from mmi.foundation.camera import Camera
from mmi.inspection.figures import EMPHASIS, INK, SMALL, counted, layer_style, new_figure, plain_log_ticks, tidy
from mmi.parallax.critical_zone import critical_zone

if TYPE_CHECKING:
    from mmi.planning.plan import CellPlan  # imports OpenGL

__all__ = ["birds_eye", "event_graph_plot"]

_NEAR = "#3A3A3A"
_CULLED = "#E4E4E4"
_STREET = "#B9B9B9"


def birds_eye(city: City, plan: CellPlan, *, reach: float | None = None) -> Figure:
    """What becomes of each object as seen from one cell, from above (paper figure 5).

    The map shows everything visible, or ``reach`` metres around the cell. Critical zones (paper section 4.1) are drawn
    as their union over each layer.
    """
    selection = plan.selection
    cell = selection.cell
    footprints = np.array([one.footprint for one in city.objects], dtype=object)
    frame = _frame(cell, footprints[selection.objects], reach)
    figure = new_figure(6.6 * _aspect(frame) + 2.6, 7.2)
    axes = _map(figure.add_subplot(), frame)
    culled = np.setdiff1d(np.arange(len(footprints)), selection.objects)
    _draw_footprints(axes, _within(footprints[culled], frame), _CULLED, edge="#CFCFCF", zorder=1.0)
    streets = _draw_streets(axes, city, frame)
    zones = [_zone(cell, footprints[members]) for members in plan.layers]
    for layer, zone in enumerate(zones):
        color, _ = layer_style(layer)
        _draw_footprints(axes, [zone], color, edge="none", alpha=0.10, zorder=2.0)
        _draw_footprints(axes, [zone], "none", edge=color, alpha=0.7, width=0.6, zorder=2.1)
    _draw_footprints(axes, footprints[selection.near], _NEAR, edge="white", zorder=3.0)
    for layer, members in enumerate(plan.layers):
        color, hatch = layer_style(layer)
        _draw_footprints(axes, footprints[members], color, edge=INK, hatch=hatch, zorder=3.0)
    _draw_cell(axes, cell)
    handles: list[Patch | Line2D] = [
        _cell_handle(cell),
        Patch(facecolor=_NEAR, edgecolor="white", label=f"near, stays geometry ({len(selection.near)})"),
        *_layer_handles(plan.layers),
        Patch(facecolor="#DDE9F3", edgecolor="#8FB4D4", linewidth=0.6, label="critical zones, per layer"),
        Patch(facecolor=_CULLED, edgecolor="#CFCFCF", label=f"not visible ({len(culled)})"),
        *streets,
    ]
    _legend(figure, handles)
    objects, layers = counted(len(selection.objects), "object"), counted(len(plan.layers), "layer")
    _title(
        axes,
        cell,
        f"{objects} of {len(footprints)} visible: {len(selection.near)} near, {len(selection.far)} far in {layers}",
    )
    return figure


def event_graph_plot(city: City, plan: CellPlan, *, camera: Camera, max_error_px: float) -> Figure:
    """The graph of visibility events that was coloured to find the layers, and how its weights are distributed.

    Nodes are far objects, edges join those whose weight (the largest change of the angle between them, paper section
    4.2) exceeds ``max_error_px`` pixels of ``camera``. Angles of 80 degrees and more count as 80 degrees.
    """
    selection = plan.selection
    cell = selection.cell
    footprints = np.array([one.footprint for one in city.objects], dtype=object)
    frame = _frame(cell, footprints[selection.objects], None)
    figure = new_figure(5.6 * _aspect(frame) + 5.2, 7.0)
    grid = figure.add_gridspec(1, 2, width_ratios=(5.6 * _aspect(frame), 3.0))
    left, right = figure.add_subplot(grid[0]), figure.add_subplot(grid[1])
    _map(left, frame)
    _draw_footprints(left, _within(footprints, frame), "#F0F0F0", edge="#DDDDDD", zorder=1.0)
    _draw_cell(left, cell)
    centres = shapely.get_coordinates(shapely.centroid(footprints))
    edges = sorted(plan.graph.edges(data="weight"), key=lambda edge: (edge[2], edge[0], edge[1]))
    weights = _pixels(camera, [edge[2] for edge in edges])
    norm = LogNorm(max_error_px, max(10.0 * max_error_px, 1.0001 * float(weights.max(initial=0.0))))
    thin = min(1.0, math.sqrt(400.0 / max(len(edges), 1)))
    lines = LineCollection(
        [centres[[a, b]] for a, b, _ in edges],
        cmap="viridis_r",
        norm=norm,
        linewidths=thin * (0.4 + 1.6 * np.asarray(norm(weights))),
        alpha=0.8,
        zorder=4.0,
    )
    lines.set_array(weights)
    left.add_collection(lines, autolim=False)
    bar = figure.colorbar(lines, ax=left, location="bottom", shrink=0.7, aspect=40, pad=0.02)
    bar.set_label("weight: change of the angle (pixels)", fontsize=SMALL)
    plain_log_ticks(bar.ax.xaxis, norm.vmin or 1.0, norm.vmax or 10.0)
    for layer, members in enumerate(plan.layers):
        color, hatch = layer_style(layer)
        x, y = centres[members].T
        left.scatter(
            x,
            y,
            s=42,
            color=color,
            edgecolor=INK,
            linewidth=0.7,
            hatch=hatch if "." in hatch else 2 * hatch,
            zorder=5.0,
        )
    _title(
        left, cell, f"{counted(len(selection.far), 'far object')}, {counted(len(edges), 'edge')} above the threshold"
    )
    _weight_histogram(right, _pixels(camera, plan.weights), max_error_px)
    _legend(figure, [_cell_handle(cell), *_layer_handles(plan.layers)])
    return figure


def _frame(cell: ViewingCell, visible: NDArray[np.object_], reach: float | None) -> Polygon:
    """What a map shows: a box around the cell and everything visible, or ``reach`` metres around the cell's reference."""
    x0, y0, x1, y1 = shapely.total_bounds([Polygon(cell.corners), *visible])
    centre, half = np.array([0.5 * (x0 + x1), 0.5 * (y0 + y1)]), 0.53 * np.array([x1 - x0, y1 - y0])
    if reach is not None:
        centre, half = cell.reference[:2], np.array([reach, reach])
    half = np.maximum(half, 0.7 * half.max())
    return shapely.box(*(centre - half), *(centre + half))


def _aspect(frame: Polygon) -> float:
    """Width over height of a box."""
    x0, y0, x1, y1 = frame.bounds
    return float((x1 - x0) / (y1 - y0))


def _map(axes: Axes, frame: Polygon) -> Axes:
    """Limits, scale bar and north arrow; no ticks, since a city's coordinates tell a reader nothing."""
    x0, y0, x1, y1 = frame.bounds
    axes.set(xlim=(x0, x1), ylim=(y0, y1), aspect="equal", xticks=[], yticks=[])
    for spine in axes.spines.values():
        spine.set_color("#999999")
    _draw_scale_bar(axes)
    halo = {"boxstyle": "round,pad=0.15", "facecolor": "white", "edgecolor": "none", "alpha": 0.8}
    axes.annotate(
        "N", (0.965, 0.975), (0.965, 0.895), xycoords="axes fraction", ha="center", va="center", fontsize=9,
        bbox=halo, zorder=9.0, arrowprops={"arrowstyle": "-|>", "color": INK, "linewidth": 1.2},
    )  # fmt: skip
    return axes


def _within(footprints: Iterable[BaseGeometry], frame: Polygon) -> list[BaseGeometry]:
    """Those footprints that the map shows some of."""
    return [one for one in footprints if one.intersects(frame)]


def _draw_scale_bar(axes: Axes) -> None:
    """A bar of 1, 2 or 5 times a power of ten metres, at most a quarter of the map wide, below the map."""
    (x0, x1), (y0, y1) = axes.get_xlim(), axes.get_ylim()
    length = _round_below(0.25 * (x1 - x0))
    text = f"{length:g} m" if length < 1000.0 else f"{length / 1000.0:g} km"
    thick = 0.008 * (y1 - y0)
    y = y0 - 3.0 * thick
    for part, color in ((0, INK), (1, "white")):
        start = x0 + 0.5 * part * length
        axes.add_patch(Rectangle((start, y), 0.5 * length, thick, fc=color, ec=INK, linewidth=0.8, clip_on=False))
    axes.text(x0 + length + 1.5 * thick, y + 0.5 * thick, text, ha="left", va="center_baseline", fontsize=SMALL)


def _round_below(length: float) -> float:
    """The largest of 1, 2, 5 times a power of ten that does not exceed ``length``."""
    power = 10.0 ** math.floor(math.log10(length))
    return max(step * power for step in (1.0, 2.0, 5.0) if step * power <= length)


def _outline(geometry: BaseGeometry) -> Outline:
    """All rings of polygons as one path; holes stay open, since they run the other way round than exteriors."""
    parts = shapely.get_parts(shapely.orient_polygons(geometry))
    rings = [shapely.get_coordinates(ring) for ring in shapely.get_rings(parts)]
    codes = [np.full(len(ring), Outline.LINETO, dtype=np.uint8) for ring in rings]
    for code in codes:
        code[0], code[-1] = Outline.MOVETO, Outline.CLOSEPOLY
    return Outline(np.concatenate(rings), np.concatenate(codes))


def _draw_footprints(
    axes: Axes,
    footprints: Iterable[BaseGeometry],
    color: str,
    *,
    edge: str,
    zorder: float,
    width: float = 0.4,
    alpha: float | None = None,
    hatch: str = "",
) -> None:
    """Fill and outline polygons; the map's limits stay."""
    outlines = [_outline(one) for one in footprints if not one.is_empty]
    collection = PathCollection(
        outlines, facecolor=color, edgecolor=edge, linewidth=width, alpha=alpha, hatch=hatch, zorder=zorder
    )
    axes.add_collection(collection, autolim=False)


def _draw_streets(axes: Axes, city: City, frame: Polygon) -> list[Line2D]:
    """Centre lines, and their entry of the legend where there are any."""
    lines = [edge["geometry"] for _, _, edge in city.streets.edges(data=True) if edge["geometry"].intersects(frame)]
    collection = LineCollection([shapely.get_coordinates(line) for line in lines], colors=_STREET, linewidths=0.7)
    collection.set_zorder(1.5)
    axes.add_collection(collection, autolim=False)
    return [Line2D([], [], color=_STREET, linewidth=0.9, label="streets")] if lines else []


def _draw_cell(axes: Axes, cell: ViewingCell) -> None:
    """The cell's region with a white rim, and the reference viewpoint."""
    axes.add_patch(Region(cell.corners, closed=True, fc=INK, ec="white", linewidth=2.2, zorder=6.0))
    axes.add_patch(Region(cell.corners, closed=True, fc=INK, ec=INK, linewidth=0.8, zorder=6.1))
    axes.plot(*cell.reference[:2], marker="o", markersize=4.5, color="white", mec=INK, mew=0.8, zorder=6.2)


def _cell_handle(cell: ViewingCell) -> Line2D:
    """The cell's entry of the legend."""
    label = f"viewing cell, {cell.length:.0f} x {2.0 * cell.half_width:.1f} m"
    return Line2D([], [], color=INK, linewidth=5, marker="o", markersize=4.5, mfc="white", mec=INK, label=label)


def _layer_handles(layers: Sequence[NDArray[np.int64]]) -> list[Patch | Line2D]:
    """An entry of the legend for every layer."""
    handles: list[Patch | Line2D] = []
    for layer, members in enumerate(layers):
        color, hatch = layer_style(layer)
        handles.append(Patch(fc=color, ec=INK, linewidth=0.4, hatch=hatch, label=f"layer {layer} ({len(members)})"))
    return handles


def _legend(figure: Figure, handles: Sequence[Patch | Line2D]) -> None:
    """The legend to the right of all axes."""
    figure.legend(
        handles=list(handles), loc="outside right upper", frameon=False, fontsize=SMALL, handlelength=2.2,
        handleheight=1.1, labelspacing=0.55,
    )  # fmt: skip


def _title(axes: Axes, cell: ViewingCell, text: str) -> None:
    """Cell and street in bold, ``text`` below."""
    street = f", {cell.street}" if cell.street else ""
    title = axes.set_title(f"cell {cell.id}{street}", loc="left", fontsize=11, weight="bold", pad=18)
    title.set_parse_math(False)  # a name may hold dollar signs
    axes.annotate(
        text, (0.0, 1.0), (0, 6), xycoords="axes fraction", textcoords="offset points", fontsize=9, va="bottom"
    )


def _zone(cell: ViewingCell, footprints: Iterable[BaseGeometry]) -> BaseGeometry:
    """Union of the objects' critical zones."""
    return shapely.union_all([critical_zone(cell, one) for one in footprints])


def _pixels(camera: Camera, angles: ArrayLike) -> NDArray[np.float64]:
    """Angles (n,) in radians as pixels; those of 80 degrees and more as 80 degrees."""
    return np.array([camera.pixels_from_angle(min(angle, math.radians(80.0))) for angle in np.asarray(angles).tolist()])


def _weight_histogram(axes: Axes, weights: NDArray[np.float64], threshold: float) -> None:
    """Weights of all interacting pairs on a logarithmic axis; those beyond the threshold must be in different layers."""
    low = threshold / (100.0 if weights.min(initial=threshold) < 0.1 * threshold else 10.0)
    high = max(10.0 * threshold, float(weights.max(initial=0.0)))
    below = np.geomspace(low, threshold, 17)
    bins = np.concatenate([below, threshold * (below[1] / below[0]) ** np.arange(1, 60)])
    bins = bins[: np.searchsorted(bins, high) + 1]
    shown = np.clip(weights, bins[0], bins[-1])
    for part, color, label in (
        (shown[shown <= threshold], "#9ECAE1", "may share a layer"),
        (shown[shown > threshold], "#08519C", "kept apart"),
    ):
        axes.hist(
            part, bins=bins.tolist(), color=color, edgecolor="white", linewidth=0.3, label=f"{label} ({len(part)})"
        )
    axes.axvline(threshold, color=EMPHASIS, linewidth=1.5, label=f"threshold, {threshold:g} px")
    axes.set_xscale("log")
    axes.set_xlim(bins[0], bins[-1])
    plain_log_ticks(axes.xaxis, bins[0], bins[-1])
    axes.tick_params(labelsize=SMALL)
    axes.set_xlabel(f"weight (pixels; below {low:g} shown as {low:g})", fontsize=SMALL)
    axes.set_ylabel("pairs of far objects that interact", fontsize=SMALL)
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    tidy(axes)
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), frameon=False, fontsize=SMALL)
