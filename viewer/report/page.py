"""What compare-impostors measured, for programs (report.json, see schemas/report.json) and for people (report.html).

The page needs no other file, no script and no network: plots and pictures are inside it. Only videos, which are large, are
read from its folder; a picture links to the PNG file that it was made from. Nothing here measures anything.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping, Sequence
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
from viewer.report.plots import distributions, errors_along_walk, frame_times, settling
from viewer.report.tables import (
    BOXES,
    LIKENESS,
    LOADING,
    MOVERS,
    PLACED,
    RAYS,
    TIMES,
    UPDATES,
    WRONG,
    glossary,
    key,
    plain,
    table,
)

__all__ = ["write_report"]

_WIDTH = 1600
"""Pictures in the page are at most this many pixels wide."""

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
td.note { text-align: left; color: #666; } .first { border-left: 1px solid #ddd; } .over { color: #a31515; font-weight: 700; }
.key { display: inline-block; width: .75rem; height: .75rem; border-radius: 2px; margin-right: .4rem; }
dl { font-size: .875rem; display: grid; grid-template-columns: max-content 1fr; gap: .2rem .8rem; }
dt { font-weight: 600; } dd { margin: 0; }
figure { margin: .6rem 0; } img, video { display: block; max-width: 100%; height: auto; }
.wide img { width: 100%; min-width: 36rem; } .plot { max-width: 60rem; } figcaption { font-size: .875rem; }
.narrow { display: none; } @media (max-width: 44rem) { .narrow { display: block; color: #666; font-size: .875rem; } }
"""


def write_report(report: Mapping[str, Any], folder: Path) -> tuple[Path, Path]:
    """Write ``report`` (as schemas/report.json describes it) as report.json and report.html. Returns their paths.

    The same report and pictures give the same bytes. Pictures that ``worst`` names must be in ``folder``. Techniques stand
    in the order of ``techniques``. Raises DatasetError where a picture cannot be read or a file cannot be written, and
    ValueError for numbers that are not finite.
    """
    files = folder / "report.json", folder / "report.html"
    contents = readable_json(report), _page(report, folder).encode("utf-8", errors="backslashreplace")
    for path, content in zip(files, contents, strict=True):
        write_whole(path, content)
    return files


def _page(report: Mapping[str, Any], folder: Path) -> str:
    """The whole HTML document."""
    source = report["source"]
    name, promise = escape(source["name"]), source["promised_px"]
    title = (
        f"Impostors of {name} against geometry"
        if source["kind"] == "dataset"
        else f"{name}, techniques against geometry"
    )
    scored = {name: views for name, views in report["scored"].items() if views}
    plots = []
    if report["series"]:
        plots.append(_figure(frame_times(report["series"]), "Frame times along the walk, on a logarithmic axis"))
    if report["series"] and scored:
        plots.append(
            _figure(
                errors_along_walk(scored, promise_px=promise),
                "Errors along the walk; the axes are logarithmic above their first mark",
            )
        )
    if scored:
        plots.append(
            _figure(distributions(scored, promise_px=promise), "The share of views whose error is at most so large")
        )
    held = (report["held_frames"] or 1) > 1
    if held and scored:
        plots.append(
            _figure(
                settling(scored, held=report["held_frames"]),
                "The share of views that were like the geometry after so many frames"
                + ("; dashed: that have at most so many layers" if source["kind"] == "dataset" else ""),
            )
        )
    parts = [
        f"<h1>{title}</h1>",
        f"<p>{_summary(report)}</p>",
        *([] if report["verdict"] is None else [_verdict(report["verdict"])]),
        '<p class="narrow">Tables and pictures are wider than this window: move them sideways.</p>',
        "<h2>Errors</h2>",
        table(report, WRONG),
        table(report, LIKENESS),
        *([f"<p>{_promise(report)}</p>"] if source["kind"] == "dataset" else []),
        table(report, UPDATES),
        glossary(report, (*WRONG, *LIKENESS, *UPDATES)),
        "<h2>Speed</h2>",
        table(report, TIMES),
        table(report, LOADING),
        table(report, RAYS),
        *_casting(report),
        table(report, BOXES),
        table(report, PLACED),
        table(report, MOVERS),
        glossary(report, (*LOADING, *RAYS, *BOXES, *PLACED, *MOVERS)),
        f"<p>{_times(report) if held else ''}Times depend on the machine and on what else it does; ratios within this run do "
        "so less.</p>",
        *(["<h2>Plots</h2>", *plots] if plots else []),
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
    source, display, walk = report["source"], report["display"], report["walk"]
    names = [name for name in report["techniques"] if name != report["reference"]]
    listed = " and ".join(part for part in (", ".join(names[:-1]), *names[-1:]) if part) or "nothing"
    if walk is None:
        views = f"{counted(report['views'], 'view')} sampled from its streets (seed {report['seed']})"
    else:
        path = {"tour": "a tour", "path": "a path"}.get(report["mode"], report["mode"])
        views = (
            f"{counted(report['views'], 'view')} along {path} ({walk['name']}: {counted(walk['frames'], 'frame')}, "
            f"{walk['metres']:,.0f} m in {plain(walk['seconds'])} s, {counted(walk['legs'], 'leg')})"
        )
    if (report["held_frames"] or 1) > 1:
        views += f", each of them held for {report['held_frames']:,} frames before it is scored"
    if report["movers"] is not None:
        views += f", among {counted(report['movers']['objects'], 'moving object')} ({report['movers']['source']})"
    if report["budget_ms"] is not None:
        views += f", with at most {plain(report['budget_ms'])} ms of a frame for updates and rays"
    if report.get("glint"):
        views += ", while windows mirror the sun,"
    made = (
        f"The dataset {source['name']} has {counted(source['cells'], 'cell')} and was made from {source['city']}."
        if source["kind"] == "dataset"
        else f"The city {source['name']} was drawn as it was read, without a dataset; its streets have "
        f"{counted(source['cells'], 'cell')}, in which views are taken."
    )
    return escape(
        f"This page compares {listed} with {report['reference']}, which draws all of the geometry, in {views}, at "
        f"{_screen(display)} on {report['device']}. {made}"
    )


def _screen(display: Mapping[str, Any]) -> str:
    """A display in words."""
    size = f"{display['width']}\N{NO-BREAK SPACE}×\N{NO-BREAK SPACE}{display['height']}"
    return f"{size} pixels and {plain(display['fov_deg'])}°"


def _times(report: Mapping[str, Any]) -> str:
    """Which frames of held views were timed, as HTML."""
    return (
        f"Each view was held for {report['held_frames']:,} frames, and the times of all of them count, those in which images "
        "were captured included. "
    )


def _casting(report: Mapping[str, Any]) -> list[str]:
    """By which rules rays were cast, as HTML; nothing where none were."""
    rules = next((one["rays"] for one in report["techniques"].values() if one.get("rays") is not None), None)
    if rules is None:
        return []
    most = "" if rules["most"] is None else f", at most {counted(rules['most'], 'ray')} a frame"
    known = {"bound": "a bound for all that is far", "hits": "a measurement of each surface that was hit"}[
        rules["reuse"]
    ]
    return [
        f"<p>Rays find what is farther away than {plain(rules['near_field_m'])} m ({rules['caster']}{most}). What was cast "
        f"before is shown again while it is off by {plain(rules['reuse_error_px'])} px at most ({known}).</p>"
    ]


def _verdict(verdict: Mapping[str, Any]) -> str:
    """Whether the promise was kept, as HTML."""
    line = escape(verdict["line"])
    return f"<p><b>{line[0].upper()}{line[1:]}.</b></p>"


def _promise(report: Mapping[str, Any]) -> str:
    """What the dataset promises, as HTML."""
    source = report["source"]
    promise, threshold, built_for = source["promised_px"], source["max_error_px"], source["built_for"]
    built = f"<b>multi-mesh</b> was built for an error of {plain(built_for['max_error_px'])} px"
    screen = {name: built_for[name] for name in ("width", "height", "fov_deg")}
    other = screen != report["display"]
    if other:
        built += f" of another display, {_screen(screen)}, which is {plain(threshold)} px in the middle of this one"
    if not source["promising_cells"]:
        return (
            f"{built}, but none of the cells promises to keep to it: manifest.json says of each cell why. Other techniques "
            "promise nothing either."
        )
    if promise is None:
        return (
            f"{built}. Nothing is promised of how thick wrong regions are on this one, which sees farther aside, up or down, "
            "where pixels are finer: surfaces are to be displaced by no more than that angle. Other techniques promise nothing."
        )
    promising, cells = source["promising_cells"], source["cells"]
    where = (
        ""
        if promising == cells
        else f" in {promising:,} of the {counted(cells, 'cell')}; it promises nothing in the others"
    )
    return (
        f"{built}{', ' if other else ' '}and promises that no wrong region is thicker than "
        f"<b>{plain(promise)}&nbsp;px</b> ({plain(promise - threshold)} px for the rasters of geometry and textures){where}. "
        'Other techniques promise nothing. Larger values are <span class="over">▲ marked</span>.'
    )


def _figure(figure: Figure, caption: str) -> str:
    """A diagram as part of the page."""
    image = _image(encoded(figure), "png", caption)
    return f'<figure class="plot"><div class="wide">{image}</div><figcaption>{caption}.</figcaption></figure>'


def _image(data: bytes, kind: str, text: str) -> str:
    """An image inside the page; ``text`` is HTML."""
    return f'<img alt="{text}" src="data:image/{kind};base64,{base64.b64encode(data).decode()}">'


def _worst_views(report: Mapping[str, Any], folder: Path) -> list[str]:
    """The worst views with picture, place and numbers: techniques with layers first, and of each the worst view first."""
    names = sorted(report["techniques"], key=lambda name: not report["techniques"][name]["layered"])
    order = {name: place for place, name in enumerate(names)}
    views = sorted(report["worst"], key=lambda view: (order.get(view["technique"], len(order)), view["rank"]))
    parts = ["<h2>Worst views</h2>"] if views else []
    for view in views:
        name, cell = escape(view["technique"]), view["cell"]
        place = "outside all cells" if cell is None else f"cell {escape(cell)}"
        parts.append(
            f"<h3>{key(view['technique'])}{name}, number {view['rank']}: {place}</h3>\n"
            f'<figure><div class="wide"><a href="{_link(view["picture"])}">'
            f"{_image(_smaller(folder / view['picture']), 'jpeg', f'geometry, {name}, what is wrong')}"
            f"</a></div><figcaption>{_numbers(view, report['source']['promised_px'])}</figcaption></figure>"
        )
    return parts


def _numbers(view: Mapping[str, Any], promise: float | None) -> str:
    """Where a view is, and how wrong."""
    thickness = f"{plain(view['wrong_thickness_px'])} px thick"
    over = promise is not None and view["wrong_thickness_px"] > promise
    facts = [
        f'<span class="over">▲ {escape(thickness)}</span>' if over else escape(thickness),
        escape(f"{plain(100.0 * view['wrong_share'])} % wrong"),
        escape(f"{plain(100.0 * view['hole_share'])} % holes"),
        escape(f"displaced {plain(view['displacement_px'])} px"),
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
