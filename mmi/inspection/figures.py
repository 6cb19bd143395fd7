"""What all plots share: figures without pyplot's global state, files of them, the layers' colours, and a few habits.

Plots are functions from values to a Figure; writing one to a file is a step of its own.
"""

from __future__ import annotations

import io
import math
import warnings
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import FixedLocator, FuncFormatter, MaxNLocator, NullLocator

from mmi.appearance.layer_colors import layer_color
from mmi.foundation.errors import ParameterError
from mmi.foundation.whole_files import write_whole

__all__ = [
    "EMPHASIS",
    "INK",
    "PICTURE_FORMATS",
    "SMALL",
    "counted",
    "encoded",
    "layer_style",
    "new_figure",
    "plain_log_ticks",
    "save",
    "tidy",
]

INK = "#222222"
"""Outlines and marks."""
EMPHASIS = "#D55E00"
"""The one line in a diagram that matters."""
SMALL = 8.0
"""Font size of all but titles, points."""

PICTURE_FORMATS = ("png", "svg", "pdf")
"""What a figure can be written as."""

# Hatches tell the rounds of the palette apart.
_HATCHES = ("", "////", "....", "xxxx")
_DPI = 150


def layer_style(layer: int) -> tuple[str, str]:
    """(colour, hatch) of a layer; all of the first 28 differ."""
    color, number = layer_color(layer)
    return color, _HATCHES[number % len(_HATCHES)]


def encoded(figure: Figure, picture_format: str = "png") -> bytes:
    """``figure`` as a file of one of ``PICTURE_FORMATS``; the same figure gives the same bytes. Raises ParameterError.

    SVG has its text as outlines, so that it looks the same everywhere; PDF carries its fonts. Neither holds a date.
    """
    if picture_format not in PICTURE_FORMATS:
        raise ParameterError(f"format: {', '.join(PICTURE_FORMATS)} expected, found {picture_format!r}")
    nothing = {"png": ("Software",), "svg": ("Date", "Creator"), "pdf": ("CreationDate", "Creator", "Producer")}
    file = io.BytesIO()
    with (
        warnings.catch_warnings(),
        # Ids inside an SVG are random without a salt.
        mpl.rc_context({"svg.hashsalt": "multi-mesh impostors", "svg.fonttype": "path", "pdf.fonttype": 42}),
    ):
        # Streets have names in all of the world's scripts.
        warnings.filterwarnings("ignore", "Glyph .* missing from")
        figure.savefig(file, format=picture_format, dpi=_DPI, metadata=dict.fromkeys(nothing[picture_format]))
    return file.getvalue()


def save(figure: Figure, path: Path) -> None:
    """Write ``figure`` whole or not at all, in the format that the name of ``path`` ends with.

    Raises ParameterError for other endings than ``PICTURE_FORMATS``, DatasetError where the file cannot be written.
    """
    write_whole(path, encoded(figure, path.suffix.removeprefix(".")))


def new_figure(width: float, height: float, *, arrange: bool = True) -> Figure:
    """An empty figure of inches, drawn by Agg. Axes are arranged when it is drawn, or stay where they are put (faster)."""
    layout = ConstrainedLayoutEngine(w_pad=0.1, h_pad=0.1) if arrange else None
    figure = Figure(figsize=(width, height), dpi=_DPI, layout=layout)
    FigureCanvasAgg(figure)
    return figure


def counted(n: int, noun: str) -> str:
    """``1 layer``, ``2 layers``."""
    return f"{n} {noun}" if n == 1 else f"{n} {noun}s"


def plain_log_ticks(axis: Axis, low: float, high: float) -> None:
    """Ticks of a logarithmic axis at 1, 2 and 5 times powers of ten, fewer or more as there is room; without exponents."""
    powers = 10.0 ** np.arange(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    steps = [1.0, 2.0, 5.0] if high < 50.0 * low else [1.0]
    ticks = np.multiply.outer(powers, steps).ravel()
    ticks = ticks[(ticks >= 0.999 * low) & (ticks <= 1.001 * high)]
    if len(ticks) < 3:
        ticks = np.asarray(MaxNLocator(6, steps=[1, 2, 5, 10]).tick_values(low, high))
        ticks = ticks[(ticks >= low) & (ticks <= high)]
    axis.set_major_locator(FixedLocator(ticks))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.3g}"))
    axis.set_tick_params(labelsize=SMALL)


def tidy(axes: Axes) -> None:
    """No box around a diagram, and a light grid behind it."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(axis="y", color="#E6E6E6", linewidth=0.6)
    axes.set_axisbelow(True)
