"""Diagrams of a report of compare-impostors: frame times and errors of techniques, along a walk and over all views.

Every function turns values of report.json into a matplotlib Figure; the same values give the same figure, and
:mod:`mmi.inspection.figures` writes it to a file.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, FuncFormatter, MaxNLocator, NullLocator

from mmi.inspection.figures import INK, SMALL, new_figure, tidy

__all__ = ["Scored", "distributions", "errors_along_walk", "frame_times", "settling", "technique_color"]

Scored = Mapping[str, Sequence[Mapping[str, Any]]]
"""The errors of each view, as in report.json, by the name of the technique."""

_COLORS = MappingProxyType(
    {
        "full": INK,
        "visible": "#0072B2",
        "local": "#009E73",
        "single-mesh": "#E69F00",
        "multi-mesh": "#D55E00",
        "multi-mesh-dynamic": "#CC79A7",
        "image-cache": "#56B4E9",
        "ray-cast": "#7B4FA3",
        "placed-images": "#8C6D31",
    }
)
"""A technique's colour is the same everywhere (Okabe & Ito's palette without its yellow, and two more)."""
_OTHER = "#777777"


def technique_color(name: str) -> str:
    """``#rrggbb``, the same for a technique in all diagrams and tables."""
    return _COLORS.get(name, _OTHER)


def frame_times(series: Mapping[str, Mapping[str, Any]]) -> Figure:
    """Frame times of all techniques of ``series`` along the walk, and when they changed cells."""
    switching = [name for name in series if series[name]["switch"]]
    figure = new_figure(8.0, 3.4 + 0.22 * len(switching))
    grid = figure.add_gridspec(2, 1, height_ratios=(3.0, 0.22 * max(len(switching), 1)))
    axes = figure.add_subplot(grid[0])
    for name, one in series.items():
        milliseconds = np.maximum(one["frame_ms"], 1e-3)  # the axis is logarithmic
        axes.plot(one["time_s"], milliseconds, color=technique_color(name), linewidth=0.8, zorder=_order(name))
    axes.set_yscale("log")
    times = np.maximum(np.concatenate([one["frame_ms"] for one in series.values()]), 1e-3)
    low, high = 0.8 * float(times.min()), 1.25 * float(times.max())
    axes.set_ylim(low, high)
    _plain_ticks(axes.yaxis, _round_values(low, high))
    _finish(axes, "frame (ms)")
    if switching:
        marks = figure.add_subplot(grid[1], sharex=axes)
        for row, name in enumerate(switching):
            times = np.asarray(series[name]["time_s"])[series[name]["switch"]]
            marks.eventplot(times, lineoffsets=-row, linelengths=0.7, linewidths=1.0, colors=technique_color(name))
        marks.set_yticks([-row for row in range(len(switching))], switching, fontsize=SMALL)
        marks.set_ylim(-len(switching) + 0.4, 0.6)
        marks.spines[["top", "right", "left"]].set_visible(False)
        marks.tick_params(axis="y", length=0)
        marks.tick_params(axis="x", labelsize=SMALL)
        axes.tick_params(axis="x", labelbottom=False)
        axes = marks
    axes.set_xlabel("seconds along the walk" + ("; ticks: cell switches" if switching else ""), fontsize=SMALL)
    _legend(figure, series)
    return figure


def errors_along_walk(scored: Scored, *, promise_px: float | None) -> Figure:
    """Thickness and share of wrong pixels of the compared views over time, for views that have a time.

    A line marks ``promise_px``, how thick the dataset promises wrong regions to be at most; None where it promises nothing.
    """
    figure = new_figure(8.0, 5.2)
    above, below = figure.subplots(2, 1, sharex=True)
    for name, views in scored.items():
        timed = [view for view in views if view["time_s"] is not None]
        times = [view["time_s"] for view in timed]
        for axes, key, scale in ((above, "wrong_thickness_px", 1.0), (below, "wrong_share", 100.0)):
            values = [scale * view[key] for view in timed]
            axes.plot(
                times, values, ".-", color=technique_color(name), linewidth=0.9, markersize=3.0, zorder=_order(name)
            )
    if promise_px is not None:
        above.axhline(promise_px, color=INK, linestyle="--", linewidth=0.9)
        above.annotate(
            "promise",
            (1.0, promise_px),
            (3, 0),
            xycoords=("axes fraction", "data"),
            textcoords="offset points",
            va="center",
            fontsize=SMALL,
        )
    _from_zero(above, "y", max(promise_px or 0.0, _most(scored, "wrong_thickness_px")), 1.0)
    _from_zero(below, "y", 100.0 * _most(scored, "wrong_share"), 0.01)
    _finish(above, "thickness of wrong regions (px)")
    _finish(below, "wrong (% of pixels)")
    below.set_xlabel("seconds along the walk", fontsize=SMALL)
    _legend(figure, scored)
    return figure


def distributions(scored: Scored, *, promise_px: float | None) -> Figure:
    """For each thickness, and each share of wrong pixels, the share of views that have no more.

    A line marks ``promise_px``, how thick the dataset promises wrong regions to be at most; None where it promises nothing.
    """
    figure = new_figure(8.0, 3.4)
    left, right = figure.subplots(1, 2, sharey=True)
    ends = {
        "wrong_thickness_px": _from_zero(left, "x", max(promise_px or 0.0, _most(scored, "wrong_thickness_px")), 1.0),
        "wrong_share": _from_zero(right, "x", 100.0 * _most(scored, "wrong_share"), 0.01),
    }
    for axes, key, scale in ((left, "wrong_thickness_px", 1.0), (right, "wrong_share", 100.0)):
        for name, views in scored.items():
            values = scale * np.sort([view[key] for view in views])
            share = 100.0 * np.arange(len(values) + 1) / len(values)
            edges = np.concatenate([values[:1], values, [ends[key]]])
            axes.step(
                edges, [*share, 100.0], where="post", color=technique_color(name), linewidth=1.2, zorder=_order(name)
            )
    if promise_px is not None:
        left.axvline(promise_px, color=INK, linestyle="--", linewidth=0.9)
        left.annotate(
            "promise",
            (promise_px, 1.0),
            (0, 2),
            xycoords=("data", "axes fraction"),
            textcoords="offset points",
            ha="center",
            fontsize=SMALL,
        )
    left.set_ylim(0.0, 103.0)
    _finish(left, "views (%) with at most")
    _finish(right, "")
    left.set_xlabel("thickness of wrong regions (px)", fontsize=SMALL)
    right.set_xlabel("wrong (% of pixels)", fontsize=SMALL)
    _legend(figure, scored)
    return figure


def settling(scored: Scored, *, held: int) -> Figure:
    """For each number of frames up to ``held``, the share of views like the geometry then; dashed, the layers of views, if any.

    A view that was not when it was scored never counts.
    """
    figure = new_figure(8.0, 3.4)
    axes = figure.subplots()

    layers = [view["layers"] for view in next(iter(scored.values())) if view["layers"] is not None]
    end = max([held, *layers])
    if layers:
        axes.step(*_shares(layers, end), where="post", color=INK, linestyle="--", linewidth=0.9)
    for name, views in scored.items():
        edges, shares = _shares([view["frames"] for view in views], end)
        axes.step(edges, shares, where="post", color=technique_color(name), linewidth=1.2, zorder=_order(name))
    axes.set_xlim(0, end)
    axes.set_ylim(0.0, 103.0)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    _finish(axes, "views (%) alike within")
    axes.set_xlabel("frames; dashed: layers" if layers else "frames", fontsize=SMALL)
    _legend(figure, scored)
    return figure


def _shares(values: Sequence[int | None], end: int) -> tuple[list[int], list[float]]:
    """Steps from 0 to ``end``: the percentage of values that are known and no larger."""
    known = sorted(one for one in values if one is not None)
    shares = [100.0 * i / len(values) for i in range(len(known) + 1)]
    return [0, *known, end], [*shares, shares[-1]]


def _most(scored: Scored, key: str) -> float:
    return max((float(view[key]) for views in scored.values() for view in views), default=0.0)


def _order(name: str) -> float:
    """Impostors are drawn over geometry."""
    return 3.0 if name in ("full", "visible", "local") else 4.0


def _from_zero(axes: Axes, way: str, high: float, start: float) -> float:
    """Axis ``way`` ("x", "y") from 0 past ``high``: linear to ``start``, logarithmic from there, plain ticks; its end."""
    high = 1.15 * max(high, start)
    if way == "x":
        axes.set_xscale("symlog", linthresh=start, linscale=0.4)
        axes.set_xlim(0.0, high)
    else:
        axes.set_yscale("symlog", linthresh=start, linscale=0.4)
        axes.set_ylim(0.0, high)
    _plain_ticks(axes.xaxis if way == "x" else axes.yaxis, [0.0, *_round_values(start, high)])
    return high


def _round_values(low: float, high: float) -> list[float]:
    """Values from ``low`` to ``high``, above 0, that are powers of ten, or 2 and 5 times those where the range is small."""
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    steps = (1, 2, 5) if high < 500.0 * low else (1,)
    values = [float(f"{step}e{power}") for power in powers for step in steps]
    return [value for value in values if 0.999 * low <= value <= high]


def _plain_ticks(axis: Axis, values: list[float]) -> None:
    axis.set_major_locator(FixedLocator(values))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))


def _finish(axes: Axes, label: str) -> None:
    tidy(axes)
    axes.tick_params(labelsize=SMALL)
    axes.set_ylabel(label, fontsize=SMALL)


def _legend(figure: Figure, names: Iterable[str]) -> None:
    """Names of the techniques with their colours, above the diagrams."""
    handles = [Line2D([], [], color=technique_color(name), linewidth=2.5, label=name) for name in names]
    figure.legend(handles=handles, loc="outside upper center", ncols=5, fontsize=SMALL, frameon=False)
