"""The tables of a report, techniques in rows, and the terms that their columns need explained."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any, Literal

from viewer.report.plots import technique_color

__all__ = [
    "BOXES",
    "LIKENESS",
    "LOADING",
    "MOVERS",
    "PLACED",
    "RAYS",
    "TIMES",
    "UPDATES",
    "WRONG",
    "Column",
    "glossary",
    "key",
    "plain",
    "table",
]

_How = Literal["plain", "percent", "fourth", "psnr", "promised", "megabytes", "times", "captured"]


@dataclass(frozen=True, slots=True)
class Column:
    """A column: the heading of its group, its own, the way to its value in a technique's entry, how the value is written.

    ``of_reference``: the reference has such a value as well.
    """

    group: str
    heading: str
    way: tuple[str, ...]
    how: _How = "plain"
    of_reference: bool = False


# Each table is narrow enough for a window of 1000 pixels.
WRONG = (
    Column("wrong", "% of pixels", ("wrong_share",), "percent"),
    Column("holes", "% of pixels", ("hole_share",), "percent"),
    Column("thickness of wrong, px", "p50", ("wrong_thickness_px", "p50"), "promised"),
    Column("thickness of wrong, px", "p99", ("wrong_thickness_px", "p99"), "promised"),
    Column("thickness of wrong, px", "max", ("wrong_thickness_px", "max"), "promised"),
    Column("displacement, px", "p50", ("displacement_px", "p50")),
    Column("displacement, px", "p99", ("displacement_px", "p99")),
    Column("displacement, px", "max", ("displacement_px", "max")),
)
LIKENESS = (
    Column("FLIP", "mean", ("flip", "mean"), "fourth"),
    Column("FLIP", "p95", ("flip", "p95"), "fourth"),
    Column("FLIP", "masked", ("flip", "masked"), "fourth"),
    Column("PSNR, dB", "mean", ("psnr_db",), "psnr"),
    Column("PSNR, dB", "worst", ("psnr_worst_db",), "psnr"),
    Column("SSIM", "", ("ssim",), "fourth"),
    Column("pop, FLIP", "switches", ("pop", "switches")),
    Column("pop, FLIP", "mean", ("pop", "mean"), "fourth"),
    Column("pop, FLIP", "max", ("pop", "max"), "fourth"),
)
UPDATES = (
    Column("like the geometry after, frames", "p50", ("settling", "alike_frames", "p50")),
    Column("like the geometry after, frames", "p99", ("settling", "alike_frames", "p99")),
    Column("like the geometry after, frames", "max", ("settling", "alike_frames", "max")),
    Column("views like the geometry", "not", ("settling", "unlike")),
    Column("views like the geometry", "later than layers", ("settling", "later_than_layers")),
    Column("settled after, frames", "p50", ("settling", "settled_frames", "p50")),
    Column("settled after, frames", "p99", ("settling", "settled_frames", "p99")),
    Column("settled after, frames", "max", ("settling", "settled_frames", "max")),
    Column("views that settled", "not", ("settling", "unsettled")),
    Column("layers of a view", "p50", ("settling", "layers", "p50")),
    Column("layers of a view", "max", ("settling", "layers", "max")),
    Column("pop of updates, FLIP", "frames", ("update_pop", "frames")),
    Column("pop of updates, FLIP", "mean", ("update_pop", "mean"), "fourth"),
    Column("pop of updates, FLIP", "max", ("update_pop", "max"), "fourth"),
)
TIMES = (
    Column("frame, ms", "p50", ("frame_ms", "p50"), of_reference=True),
    Column("frame, ms", "p95", ("frame_ms", "p95"), of_reference=True),
    Column("frame, ms", "p99", ("frame_ms", "p99"), of_reference=True),
    Column("frame, ms", "max", ("frame_ms", "max"), of_reference=True),
    Column("GPU, ms", "p50", ("gpu_ms", "p50"), of_reference=True),
    Column("GPU, ms", "p95", ("gpu_ms", "p95"), of_reference=True),
    Column("GPU, ms", "p99", ("gpu_ms", "p99"), of_reference=True),
    Column("GPU, ms", "max", ("gpu_ms", "max"), of_reference=True),
    Column("frame rate, times that of", "full", ("ratios", "full"), "times", of_reference=True),
    Column("frame rate, times that of", "visible", ("ratios", "visible"), "times", of_reference=True),
    Column("frame rate, times that of", "local", ("ratios", "local"), "times", of_reference=True),
)
LOADING = (
    Column("a frame", "triangles", ("triangles",), of_reference=True),
    Column("a frame", "draws", ("draws",), of_reference=True),
    Column("captured a frame", "requests", ("requests",), "captured", of_reference=True),
    Column("captured a frame", "pixels", ("captured_pixels",), "captured", of_reference=True),
    Column("late", "% of frames", ("late_share",), "percent", of_reference=True),
    Column("waiting for cells", "s", ("loading", "seconds_waited"), of_reference=True),
    Column("waiting for cells", "frames", ("loading", "frames_waited"), of_reference=True),
    Column("cells, MB", "loaded", ("loading", "bytes_loaded"), "megabytes", of_reference=True),
    Column("cells, MB", "most in memory", ("loading", "largest_cache_bytes"), "megabytes", of_reference=True),
)
MOVERS = (
    Column("movers a frame, as", "geometry", ("movers", "geometry"), of_reference=True),
    Column("movers a frame, as", "images, new", ("movers", "captured"), of_reference=True),
    Column("movers a frame, as", "images, kept", ("movers", "reused"), of_reference=True),
    Column("movers a frame, as", "hidden", ("movers", "hidden"), of_reference=True),
    Column("images of movers", "frames valid", ("movers", "valid_frames"), of_reference=True),
)
RAYS = (
    Column("pixels of a frame, %", "covered", ("rays", "covered_share"), "percent"),
    Column("pixels of a frame, %", "sky", ("rays", "sky_share"), "percent"),
    Column("pixels of a frame, %", "cast before", ("rays", "reused_share"), "percent"),
    Column("pixels of a frame, %", "cast, hit", ("rays", "hit_share"), "percent"),
    Column("pixels of a frame, %", "cast, missed", ("rays", "missed_share"), "percent"),
    Column("pixels of a frame, %", "late", ("rays", "late_share"), "percent"),
    Column("pixels of a frame, %", "unknown", ("rays", "unknown_share"), "percent"),
    Column("rays", "a frame", ("rays", "cast")),
    Column("rays", "kept error, px", ("rays", "kept_px")),
)
BOXES = (
    Column("boxes a frame, as", "images, new", ("boxes", "new")),
    Column("boxes a frame, as", "images, combined", ("boxes", "combined")),
    Column("boxes a frame, as", "images, kept", ("boxes", "reused")),
    Column("boxes a frame, as", "geometry", ("boxes", "impossible")),
    Column("images of boxes", "late", ("boxes", "late")),
    Column("images of boxes", "kept error, px", ("boxes", "kept_px")),
    Column("images of boxes", "MB", ("boxes", "bytes"), "megabytes"),
)
PLACED = (
    Column("frames, %", "with an image", ("placed", "image_share"), "percent"),
    Column("frames, %", "outside", ("placed", "outside_share"), "percent"),
    Column("frames, %", "tilted", ("placed", "tilted_share"), "percent"),
    Column("triangles of the model", "at most", ("placed", "most_triangles")),
    Column("triangles of the model", "budget", ("placed", "budget")),
    Column("triangles of the model", "frames over it", ("placed", "over_budget")),
    Column("samples", "warped a frame", ("placed", "samples")),
)
_TERMS = (
    (
        "wrong",
        "wrong",
        "The share of pixels that show another object than the geometry does; ground and sky count as objects.",
    ),
    (
        "holes",
        "holes",
        "The share of pixels where the geometry shows an object and the technique shows ground or sky. They are wrong as well.",
    ),
    (
        "thickness of wrong, px",
        "thickness",
        "The diameter of the largest disc that fits into a view's wrong pixels: how wide its widest wrong region is.",
    ),
    (
        "displacement, px",
        "displacement",
        "How far the surfaces of impostors are drawn from where they belong. Each view counts with the 99th percentile of its "
        "pixels in p50 and p99, and max is the largest of all pixels of all views.",
    ),
    (
        "FLIP",
        "FLIP",
        "The difference that people perceive between two pictures, from 0 (alike) to 1. Masked: only where the picture shows "
        "what the capture of the cell cannot have seen.",
    ),
    (
        "PSNR, dB",
        "PSNR, SSIM",
        "The peak signal-to-noise ratio and the structural similarity of two pictures (1 where they are alike).",
    ),
    (
        "like the geometry after, frames",
        "like the geometry",
        "A view is like the geometry where its PSNR is at least 40 dB and no wrong region is thicker than 2 px. "
        "Frames count that come before.",
    ),
    (
        "settled after, frames",
        "settled",
        "A view has settled when the technique captures nothing for it any more, though it had the time, and draws the same "
        "frame after frame.",
    ),
    (
        "layers of a view",
        "layers",
        "How many layers multi-mesh draws in the view. A technique that captures one in each frame is done after so many.",
    ),
    (
        "pop, FLIP",
        "pop",
        "FLIP between the frames before and after the viewer comes into another cell, less that of the geometry for the same "
        "motion.",
    ),
    (
        "pop of updates, FLIP",
        "pop of updates",
        "FLIP between a frame in which something is captured and the frame before, less that of the geometry for the same "
        "motion.",
    ),
    (
        "late",
        "late",
        "The share of frames that take more than 1.1 times as long as they should, which is one over the frames a second.",
    ),
    (
        "captured a frame",
        "captured",
        "What is drawn into images at run time, to be shown in later frames as well. Triangles and draws have it as well.",
    ),
    (
        "movers a frame, as",
        "movers",
        "Objects that move and are within the view: means over frames. All techniques but full leave out those that buildings "
        "surely hide. The image of one is captured, moves with it, and is kept for as many frames as it is valid.",
    ),
    (
        "pixels of a frame, %",
        "rays",
        "What is near covers a pixel; or it is above the horizon of all that is far; or it shows what was cast before; or a "
        "ray is cast. Late pixels show what may be off by more than it should, unknown ones nothing, for want of rays. The "
        "kept error is the largest with which something was shown again.",
    ),
    (
        "boxes a frame, as",
        "boxes",
        "Boxes around the viewer that hold the whole city once: means over frames. Images are captured from geometry (new) or "
        "from images of boxes within (combined), or shown as they were captured before (kept). A late one was shown though it "
        "was not valid, for want of time. The kept error is the largest that a point of a shown image may have, in pixels of "
        "the display's border.",
    ),
    (
        "frames, %",
        "placed images",
        "A frame shows the image of the grid's point behind the viewer, where its triangles are more than the budget. Frames "
        "from outside of the grid, and those that are tilted or show more than images were placed for, are drawn as geometry "
        "and do not count among the others.",
    ),
)
"""The group of columns, the term, and what it means."""
_QUANTILES = ("p50, p95, p99", "The value that 50, 95 or 99 per cent of all views or frames do not exceed.")


def table(report: Mapping[str, Any], columns: Sequence[Column]) -> str:
    """The table as HTML. Groups of columns in which no technique has a value are left out; empty where all are.

    What only the others have is one cell for the reference, which says so.
    """
    entries = _entries(report)
    shown = _shown(report, columns)
    if not shown:
        return ""
    groups = list(dict.fromkeys(column.group for column in shown))
    first = [i == 0 or shown[i].group != shown[i - 1].group for i in range(len(shown))]
    spans = [sum(column.group == group for column in shown) for group in groups]
    tops = (
        f'<th class="first" colspan="{n}" scope="colgroup">{group}</th>' for group, n in zip(groups, spans, strict=True)
    )
    rows = ["<tr><td></td>" + "".join(tops) + "</tr>"]
    heads = (
        f'<th{_classes(lead)} scope="col">{column.heading}</th>' for column, lead in zip(shown, first, strict=True)
    )
    rows += ["<tr><td></td>" + "".join(heads) + "</tr></thead><tbody>"]
    promise = report["source"]["promised_px"]
    for name, entry in entries.items():
        if name == report["reference"] and not any(column.of_reference for column in shown):
            cells = [f'<td class="first note" colspan="{len(shown)}">what the others are compared with</td>']
        else:
            cells = [
                _cell(_at(entry, column.way), column.how, promise, lead)
                for column, lead in zip(shown, first, strict=True)
            ]
        rows.append(f'<tr><th scope="row">{key(name)}{escape(name)}</th>{"".join(cells)}</tr>')
    return '<div class="wide"><table><thead>' + "\n".join(rows) + "</tbody></table></div>"


def glossary(report: Mapping[str, Any], columns: Sequence[Column]) -> str:
    """What the terms mean that these columns, as far as they are shown, are headed by; a list in HTML."""
    shown = _shown(report, columns)
    groups = {column.group for column in shown}
    terms = [(term, text) for group, term, text in _TERMS if group in groups]
    if any(column.heading in ("p50", "p95", "p99") for column in shown):
        terms.append(_QUANTILES)
    return "<dl>" + "".join(f"<dt>{term}</dt><dd>{text}</dd>" for term, text in terms) + "</dl>" if terms else ""


def plain(value: float) -> str:
    """A number above or equal to 0 in three digits, more where it is 1000 and above, never with an exponent."""
    if 0.0 < value < 0.001:
        return "<0.001"
    return f"{value:,.0f}" if value >= 100.0 else f"{value:.3g}"


def key(name: str) -> str:
    """A square in the technique's colour, as HTML."""
    return f'<span class="key" style="background:{technique_color(name)}"></span>'


def _entries(report: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    return {name: {**entry, "ratios": report["ratios"].get(name)} for name, entry in report["techniques"].items()}


def _shown(report: Mapping[str, Any], columns: Sequence[Column]) -> list[Column]:
    """The columns of groups in which a technique has a value.

    Views that are identical have no PSNR, and are shown. Where no technique captures anything, that is not shown.
    """
    entries = _entries(report)
    compared = any(name != report["reference"] for name in entries)

    def filled(column: Column) -> bool:
        values = [_at(entry, column.way) for entry in entries.values()]
        if column.how == "captured":
            return any(values)
        return (column.how == "psnr" and compared) or any(value is not None for value in values)

    groups = {column.group for column in columns if filled(column)}
    return [column for column in columns if column.group in groups]


def _at(entry: Any, way: Iterable[str]) -> Any:  # noqa: ANN401
    """The value that ``way`` leads to; None where something on it is None."""
    for step in way:
        if entry is None:
            return None
        entry = entry[step]
    return entry


def _cell(value: float | None, how: _How, promise: float | None, first: bool) -> str:
    over = how == "promised" and value is not None and promise is not None and value > promise
    if value is None:
        text = "identical" if how == "psnr" else "–"
    elif how == "percent":
        text = plain(100.0 * value)
    elif how == "megabytes":
        text = plain(value / 1e6)
    elif how in ("fourth", "psnr"):
        text = f"{value:.{4 if how == 'fourth' else 1}f}".replace("-", "−")
    else:
        text = ("▲ " if over else "") + plain(value) + ("×" if how == "times" else "")
    return f"<td{_classes(first, over)}>{escape(text)}</td>"


def _classes(first: bool, over: bool = False) -> str:
    names = [name for name, there in (("first", first), ("over", over)) if there]
    return f' class="{" ".join(names)}"' if names else ""
