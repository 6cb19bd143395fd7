"""What compare-impostors measured, for programs (report.json, see schemas/report.json) and for people (report.html).

The page needs no other file, no script and no network: plots and pictures are inside it. Only videos, which are large, are
read from its folder; a picture links to the PNG file that it was made from. Nothing here measures anything.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any
from urllib.parse import quote

from matplotlib.figure import Figure
from PIL import Image

from mmi.foundation.errors import DatasetError
from mmi.foundation.json_forms import readable_json
from mmi.foundation.whole_files import write_whole
from mmi.inspection.figures import counted, encoded
from viewer.report.plots import distributions, errors_along_walk, frame_times, technique_color

__all__ = ["write_report"]

_RASTERS = 2.0
"""Pixels that reference and textures may add to the promised error (DESIGN section 6)."""
_WIDTH = 1600
"""Pixels: pictures in the page are no wider."""

# Columns of a table: heading of the group, heading, way to the value in a technique's entry, how the value is written.
_ERRORS = (
    ("wrong", "% of pixels", ("wrong_share",), "percent"),
    ("holes", "% of pixels", ("hole_share",), "percent"),
    ("thickness of wrong, px", "p50", ("wrong_thickness_px", "p50"), "promised"),
    ("thickness of wrong, px", "p99", ("wrong_thickness_px", "p99"), "promised"),
    ("thickness of wrong, px", "max", ("wrong_thickness_px", "max"), "promised"),
    ("displacement, px", "p50", ("displacement_px", "p50"), "plain"),
    ("displacement, px", "p99", ("displacement_px", "p99"), "plain"),
    ("displacement, px", "max", ("displacement_px", "max"), "plain"),
    ("FLIP", "mean", ("flip", "mean"), "fourth"),
    ("FLIP", "p95", ("flip", "p95"), "fourth"),
    ("FLIP", "masked", ("flip", "masked"), "fourth"),
    ("PSNR", "dB", ("psnr_db",), "psnr"),
    ("SSIM", "", ("ssim",), "fourth"),
    ("pop, FLIP", "switches", ("pop", "switches"), "plain"),
    ("pop, FLIP", "mean", ("pop", "mean"), "fourth"),
    ("pop, FLIP", "max", ("pop", "max"), "fourth"),
)
_SPEED = (
    ("frame, ms", "p50", ("frame_ms", "p50"), "plain"),
    ("frame, ms", "p95", ("frame_ms", "p95"), "plain"),
    ("frame, ms", "p99", ("frame_ms", "p99"), "plain"),
    ("frame, ms", "max", ("frame_ms", "max"), "plain"),
    ("GPU, ms", "p50", ("gpu_ms", "p50"), "plain"),
    ("GPU, ms", "p95", ("gpu_ms", "p95"), "plain"),
    ("GPU, ms", "p99", ("gpu_ms", "p99"), "plain"),
    ("GPU, ms", "max", ("gpu_ms", "max"), "plain"),
    ("a frame", "triangles", ("triangles",), "plain"),
    ("a frame", "draws", ("draws",), "plain"),
    ("frame rate, times that of", "full", ("ratios", "full"), "times"),
    ("frame rate, times that of", "visible", ("ratios", "visible"), "times"),
    ("frame rate, times that of", "local", ("ratios", "local"), "times"),
    ("waiting for cells", "s", ("loading", "seconds_waited"), "plain"),
    ("waiting for cells", "frames", ("loading", "frames_waited"), "plain"),
    ("cells, MB", "loaded", ("loading", "bytes_loaded"), "megabytes"),
    ("cells, MB", "most in memory", ("loading", "largest_cache_bytes"), "megabytes"),
)

_STYLE = """
:root { color-scheme: light; }
body { margin: 0 auto; max-width: 78rem; padding: 1rem; background: #fff; color: #222; line-height: 1.45;
  font-family: system-ui, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif; overflow-wrap: break-word; }
h1 { font-size: 1.5rem; line-height: 1.2; margin: .5rem 0; } h2 { font-size: 1.2rem; margin: 2rem 0 .5rem; }
h3 { font-size: 1rem; margin: 1.2rem 0 .3rem; } p { max-width: 48rem; margin: .5rem 0; }
.wide { overflow-x: auto; margin: .6rem 0; }
table { border-collapse: collapse; font-size: .8125rem; font-variant-numeric: tabular-nums; white-space: nowrap; }
th, td { padding: .3rem .45rem; text-align: right; border-bottom: 1px solid #ddd; }
thead th { font-weight: 600; } thead tr:first-child th { text-align: center; }
tbody th { text-align: left; font-weight: 600; position: sticky; left: 0; background: #fff; }
.first { border-left: 1px solid #ddd; } .over { color: #a31515; font-weight: 700; }
.key { display: inline-block; width: .75rem; height: .75rem; border-radius: 2px; margin-right: .4rem; }
dl { font-size: .875rem; display: grid; grid-template-columns: max-content 1fr; gap: .2rem .8rem; }
dt { font-weight: 600; } dd { margin: 0; }
figure { margin: .6rem 0; } img, video { display: block; max-width: 100%; height: auto; }
.wide img { width: 100%; min-width: 36rem; } .plot { max-width: 60rem; } figcaption { font-size: .875rem; }
"""

_GLOSSARY = (
    ("wrong", "Pixels that show another object than the geometry; ground and sky count as objects."),
    ("holes", "Pixels where the geometry shows an object and the technique ground or sky. Holes are wrong as well."),
    (
        "thickness",
        "Diameter of the largest disc that fits into a view's wrong pixels: how wide the widest wrong region is.",
    ),
    (
        "displacement",
        "How far impostors' surfaces are drawn from where they belong: p50, p99 of views' p99, and the largest of all.",
    ),
    (
        "FLIP",
        "Perceived difference of two pictures, 0 (alike) to 1; masked: where the capture of the cell cannot have seen.",
    ),
    (
        "pop",
        "At cell switches: FLIP between the frames before and after, less that of the geometry for the same motion.",
    ),
    ("p50, p95, p99", "The value that so many per cent of all views or frames do not exceed."),
)


def write_report(report: Mapping[str, Any], folder: Path) -> tuple[Path, Path]:
    """Write ``report`` (as schemas/report.json describes it) as report.json and report.html; their paths.

    The same report and pictures give the same bytes. Pictures that ``worst`` names must be in ``folder``. Techniques stand
    in the order of ``techniques``. Raises DatasetError where a picture cannot be read or a file cannot be written, and
    ValueError for numbers that are not finite.
    """
    files = folder / "report.json", folder / "report.html"
    contents = readable_json(report), _page(report, folder).encode()
    for path, content in zip(files, contents, strict=True):
        write_whole(path, content)
    return files


def _page(report: Mapping[str, Any], folder: Path) -> str:
    """The whole HTML document."""
    title = f"Impostors of {escape(report['dataset']['name'])} against geometry"
    promise = _promise(report)
    scored = {name: views for name, views in report["scored"].items() if name != report["reference"] and views}
    plots = [_figure(distributions(scored, promise_px=promise), "Share of views whose error is at most so large")]
    if report["series"]:
        errors = _figure(
            errors_along_walk(scored, promise_px=promise),
            "Errors along the walk; the axes are logarithmic above their first mark",
        )
        plots = [
            _figure(frame_times(report["series"]), "DrawnPicture time along the walk, on a logarithmic axis"),
            errors,
            *plots,
        ]
    parts = [
        f"<h1>{title}</h1>",
        f"<p>{_summary(report)}</p>",
        "<h2>Errors</h2>",
        _table(report, _ERRORS),
        f"<p><b>multi-mesh</b> was built for an error of {_plain(promise - _RASTERS)} px and promises that no wrong region "
        f"is thicker than <b>{_plain(promise)}&nbsp;px</b> ({_plain(_RASTERS)} px for the rasters of geometry and textures); "
        'other techniques promise nothing. Larger values are <span class="over">▲ marked</span>.</p>',
        "<dl>" + "".join(f"<dt>{name}</dt><dd>{text}</dd>" for name, text in _GLOSSARY) + "</dl>",
        "<h2>Speed</h2>",
        _table(report, _SPEED),
        "<p>Times depend on the machine and what else it does; ratios within this run less so.</p>",
        "<h2>Plots</h2>",
        *plots,
        *_worst_views(report, folder),
        *_videos(report["videos"]),
    ]
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{title}</title>\n<style>{_STYLE}</style>\n</head>\n<body>\n"
        + "\n".join(parts)
        + "\n</body>\n</html>\n"
    )


def _summary(report: Mapping[str, Any]) -> str:
    """What was compared with what, where and how, in a few sentences."""
    dataset, display, walk = report["dataset"], report["display"], report["walk"]
    names = [name for name in report["techniques"] if name != report["reference"]]
    listed = " and ".join(part for part in (", ".join(names[:-1]), *names[-1:]) if part) or "nothing"
    if walk is None:
        views = f"{counted(report['views'], 'view')} sampled from its streets (seed {report['seed']})"
    else:
        path = {"tour": "a tour", "path": "a path"}.get(report["mode"], report["mode"])
        views = (
            f"{counted(report['views'], 'view')} along {path} ({walk['name']}: {counted(walk['frames'], 'frame')}, "
            f"{walk['metres']:,.0f} m in {_plain(walk['seconds'])} s, {counted(walk['legs'], 'leg')})"
        )
    size = f"{display['width']}\N{NO-BREAK SPACE}×\N{NO-BREAK SPACE}{display['height']}"
    return escape(
        f"This page compares {listed} with {report['reference']}, which draws all of the geometry, in {views}, at "
        f"{size} pixels and {_plain(display['fov_deg'])}° on {report['device']}. "
        f"The dataset {dataset['name']} has {counted(dataset['cells'], 'cell')} and was made from {dataset['source']}."
    )


def _promise(report: Mapping[str, Any]) -> float:
    """Pixels: no wrong region is to be thicker."""
    return float(report["dataset"]["max_error_px"]) + _RASTERS


def _table(report: Mapping[str, Any], columns: Sequence[tuple[str, str, tuple[str, ...], str]]) -> str:
    """Techniques in rows; groups of columns in which no technique has a value are left out."""
    entries = {name: {**entry, "ratios": report["ratios"].get(name)} for name, entry in report["techniques"].items()}
    filled = {
        group
        for group, _, way, _ in columns
        if way == ("psnr_db",) or any(_at(e, way) is not None for e in entries.values())
    }
    shown = [column for column in columns if column[0] in filled]
    groups = list(dict.fromkeys(group for group, *_ in shown))
    first = [i == 0 or shown[i][0] != shown[i - 1][0] for i in range(len(shown))]
    spans = [sum(group == one for one, *_ in shown) for group in groups]
    tops = (
        f'<th class="first" colspan="{n}" scope="colgroup">{group}</th>' for group, n in zip(groups, spans, strict=True)
    )
    rows = ["<tr><td></td>" + "".join(tops) + "</tr>"]
    heads = (f'<th{_classes(lead)} scope="col">{column[1]}</th>' for column, lead in zip(shown, first, strict=True))
    rows += ["<tr><td></td>" + "".join(heads) + "</tr></thead><tbody>"]
    for name, entry in entries.items():
        cells = [
            _written(_at(entry, way), how, _promise(report), lead)
            for (*_, way, how), lead in zip(shown, first, strict=True)
        ]
        rows.append(f'<tr><th scope="row">{_key(name)}{escape(name)}</th>{"".join(cells)}</tr>')
    return '<div class="wide"><table><thead>' + "\n".join(rows) + "</tbody></table></div>"


def _at(entry: Any, way: Iterable[str]) -> Any:  # noqa: ANN401
    """The value that ``way`` leads to; None where something on it is None."""
    for key in way:
        if entry is None:
            return None
        entry = entry[key]
    return entry


def _written(value: float | None, how: str, promise: float, first: bool) -> str:
    """A cell of a table."""
    over = how == "promised" and value is not None and value > promise
    if value is None:
        text = "identical" if how == "psnr" else "–"
    elif how == "percent":
        text = _plain(100.0 * value)
    elif how == "megabytes":
        text = _plain(value / 1e6)
    elif how in ("fourth", "psnr"):
        text = f"{value:.{4 if how == 'fourth' else 1}f}".replace("-", "−")
    else:
        text = ("▲ " if over else "") + _plain(value) + ("×" if how == "times" else "")
    return f"<td{_classes(first, over)}>{escape(text)}</td>"


def _classes(first: bool, over: bool = False) -> str:
    names = [name for name, there in (("first", first), ("over", over)) if there]
    return f' class="{" ".join(names)}"' if names else ""


def _plain(value: float) -> str:
    """A number above or equal to 0 in three digits, more where it is 1000 and above, never with an exponent."""
    if 0.0 < value < 0.001:
        return "<0.001"
    return f"{value:,.0f}" if value >= 100.0 else f"{value:.3g}"


def _key(name: str) -> str:
    return f'<span class="key" style="background:{technique_color(name)}"></span>'


def _figure(figure: Figure, caption: str) -> str:
    """A diagram as part of the page."""
    image = _image(encoded(figure), "png", caption)
    return f'<figure class="plot"><div class="wide">{image}</div><figcaption>{caption}.</figcaption></figure>'


def _image(data: bytes, kind: str, text: str) -> str:
    """An image inside the page; ``text`` is HTML."""
    return f'<img alt="{text}" src="data:image/{kind};base64,{base64.b64encode(data).decode()}">'


def _worst_views(report: Mapping[str, Any], folder: Path) -> list[str]:
    """A technique after the other, the worst view first: picture, place and numbers."""
    order = {name: place for place, name in enumerate(report["techniques"])}
    views = sorted(report["worst"], key=lambda view: (order.get(view["technique"], len(order)), view["rank"]))
    parts = ["<h2>Worst views</h2>"] if views else []
    for view in views:
        name, cell = escape(view["technique"]), view["cell"]
        place = "outside all cells" if cell is None else f"cell {escape(cell)}"
        parts.append(
            f"<h3>{_key(view['technique'])}{name}, number {view['rank']}: {place}</h3>\n"
            f'<figure><div class="wide"><a href="{_link(view["picture"])}">'
            f"{_image(_smaller(folder / view['picture']), 'jpeg', f'geometry, {name}, what is wrong')}"
            f"</a></div><figcaption>{_numbers(view, _promise(report))}</figcaption></figure>"
        )
    return parts


def _numbers(view: Mapping[str, Any], promise: float) -> str:
    """Where a view is, and how wrong."""
    thickness = f"{_plain(view['wrong_thickness_px'])} px thick"
    over = view["wrong_thickness_px"] > promise
    facts = [
        f'<span class="over">▲ {escape(thickness)}</span>' if over else escape(thickness),
        escape(f"{_plain(100.0 * view['wrong_share'])} % wrong"),
        escape(f"{_plain(100.0 * view['hole_share'])} % holes"),
        escape(f"displaced {_plain(view['displacement_px'])} px"),
    ]
    if view["flip_mean"] is not None:
        facts.append(f"FLIP {view['flip_mean']:.4f}")
    facts.append("eye at (" + ", ".join(f"{value:z.2f}" for value in view["eye"]) + ") m")
    facts.append(f"azimuth {view['azimuth_deg']:z.1f}°, pitch {view['pitch_deg']:z.1f}°")
    if view["time_s"] is not None:
        facts.append(f"{view['time_s']:.2f} s into the walk")
    return "; ".join(facts).replace("-", "−") + "."


def _smaller(path: Path) -> bytes:
    """A picture as JPEG, no wider than the page needs. Raises DatasetError where it cannot be read."""
    buffer = io.BytesIO()
    try:
        with Image.open(path) as picture:
            image = picture.convert("RGB")
    except OSError as error:
        raise DatasetError(f"{path}: a picture expected, found: {error.strerror or error}") from error
    image.thumbnail((_WIDTH, _WIDTH), Image.Resampling.LANCZOS)
    image.save(buffer, format="jpeg", quality=88, optimize=True)
    return buffer.getvalue()


def _videos(names: Sequence[str]) -> list[str]:
    """Players for videos beside the page; a browser plays animated WebP as an image."""
    parts = ["<h2>Videos</h2>"] if names else []
    for name in names:
        link = _link(name)
        player = (
            f'<img alt="{escape(name)}" loading="lazy" src="{link}">'
            if name.lower().endswith(".webp")
            else f'<video controls preload="metadata" src="{link}"></video>'
        )
        parts.append(f'<figure>{player}<figcaption><a href="{link}">{escape(name)}</a></figcaption></figure>')
    return parts


def _link(name: str) -> str:
    """A file name as the address of a file beside the page."""
    return escape("./" + quote(name))
