"""The program ``place-images``: options in, one line for every mistake, exit status 0, 1 (a budget not kept), 2 or 130."""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from mmi.foundation.camera import Camera
from mmi.foundation.errors import ParameterError
from mmi.foundation.processes import usable_cores
from mmi.programs.city_arguments import CITY_FILES, add_reading_arguments, read_options, refuse_reading_arguments
from mmi.programs.city_told import print_warnings
from mmi.programs.command_line import Parser, ProgressBar, numbers_option, path_option, run_program, size_option
from mmi.reading.read_options import ReadOptions

if TYPE_CHECKING:
    from rich.console import Console

    from viewer.making.checking import Checked
    from viewer.making.place_images import PlacingSummary
    from viewer.placing.grid_check import GridChecked
    from viewer.placing.rules import FrameBudget, PlacingRules

__all__ = ["place_images"]

_READING = ReadOptions(network="all")
"""How models are read where nobody says otherwise: whatever their streets are, since none are needed."""

_PICTURES = (1, 5, 9)
_MOST_WORKERS = 64
_EXAMPLE = """\
examples:
  place-images examples/helsinki/helsinki.osm.pbf -o out/placed --budget 20000
  place-images pipes.json -o out/pipes --budget 150000 --optimize 90000 --workers 2
  place-images pipes.json -o out/pipes --budget 150000 --optimize 90000 --check 10000
  compare-impostors pipes.json -o out/comparison --techniques full,placed-images --placed out/pipes

The same command goes on where it was stopped.
"""


def place_images(arguments: Sequence[str] | None = None) -> NoReturn:
    """``place-images MODEL -o OUT --budget P``: images instead of what is too much to draw, for every place and direction."""
    parser = Parser(
        prog="place-images",
        description="Place layered depth images in a model, so that no level view of a display, from wherever and whichever "
        "way it looks, draws more triangles than a budget (Aliaga & Lastra 1999).",
        epilog=_EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "source", type=path_option, metavar="MODEL", help="a dataset of build-impostors, or a model: " + CITY_FILES
    )
    parser.add_argument("-o", "--output", type=path_option, required=True, metavar="OUT", help="folder of the images")
    budget = parser.add_argument_group("the budget")
    either = budget.add_mutually_exclusive_group(required=True)
    either.add_argument(
        "--budget",
        type=int,
        metavar="P",
        help="triangles of the model that a view draws at most; ground and images are besides",
    )
    either.add_argument(
        "--budget-ms",
        type=float,
        metavar="MS",
        help="or milliseconds that a frame may take: P is the triangles for which --costs leave time",
    )
    budget.add_argument(
        "--costs",
        type=_costs,
        metavar="FIXED,MILLION,IMAGE",
        help="what a frame takes as such, for a million triangles and for an image, milliseconds, where it is walked; the "
        "manifest has them",
    )
    budget.add_argument(
        "--optimize",
        type=int,
        metavar="P",
        help="triangles that are left where an image is chosen: with fewer there are fewer images at a point, and more points "
        "(default: the budget less 6 %% of the model, or half of the budget; all of it for a model that is within it)",
    )
    display = parser.add_argument_group("the display")
    display.add_argument(
        "--display", type=size_option, default=(512, 384), metavar="WxH", help="pixels (default: 512x384)"
    )
    display.add_argument("--fov", type=float, default=60.0, metavar="DEG", help="across the display (default: 60)")
    display.add_argument(
        "--pitch",
        type=float,
        default=0.0,
        metavar="DEG",
        help="how far views may be turned up and down (default: 0, as in the paper)",
    )
    display.add_argument(
        "--heights",
        type=_heights,
        metavar="LOW,HIGH",
        help="of viewers' eyes, metres in the model's frame: the fewer, the fewer images are needed (default: anywhere around "
        "the model)",
    )
    how = parser.add_argument_group("how")
    how.add_argument(
        "--hidden",
        action="store_true",
        help="in a city: do not count, and do not draw, cells that solid buildings surely hide from all viewers whom a point "
        "serves; with --heights it takes fewer images",
    )
    how.add_argument(
        "--pictures",
        type=int,
        choices=_PICTURES,
        default=9,
        help="that an image is made of: more of them see more of what the first does not (default: %(default)s)",
    )
    how.add_argument(
        "--octree-depth",
        dest="depth",
        type=int,
        default=5,
        metavar="N",
        help="levels of the octree whose cells are drawn or left out (default: %(default)s)",
    )
    how.add_argument(
        "--weights",
        type=_weights,
        default=(0.4, 0.6, 0.1, 0.9),
        metavar="C,B,B1,B2",
        help="of the cost-benefit function: few triangles left, benefit, a small image, a far one (default: 0.4,0.6,0.1,0.9)",
    )
    add_reading_arguments(parser, _READING)
    work = parser.add_argument_group("the work")
    work.add_argument("--workers", type=int, metavar="N", help="processes (default: one a core)")
    work.add_argument(
        "--check",
        type=int,
        metavar="N",
        help="when all is there: count the triangles of views in all directions from all points, and of N random views; exit "
        "status 1 where one draws more than the budget",
    )
    work.add_argument(
        "--replace",
        action="store_true",
        help="images that OUT has for other options, or for another model, may go (default: that is an error)",
    )
    work.add_argument("--seed", type=int, default=1, metavar="S", help="of these views (default: %(default)s)")
    work.add_argument(
        "--json", action="store_true", help="the result as JSON on standard output, and nothing else there"
    )
    work.add_argument("--quiet", action="store_true", help="no progress, no tables")
    run_program(parser, arguments, _place, kept="what was finished is kept, the same command goes on from there")


def _place(options: argparse.Namespace) -> None:
    frame = _frame(options)
    triangles = options.budget if frame is None else frame.triangles
    cores = usable_cores()
    workers = options.workers if options.workers is not None else cores
    for name, value, least, most in (
        ("workers", workers, 1, max(_MOST_WORKERS, cores)),
        ("budget" if frame is None else "budget-ms, --costs: triangles", triangles, 2, 1 << 40),
        ("check", 1 if options.check is None else options.check, 1, 10**9),
        ("seed", options.seed, 0, 1 << 63),
        ("optimize", 1 if options.optimize is None else options.optimize, 1, triangles),
    ):
        if not least <= value <= most:
            raise ParameterError(f"--{name}: {least:,} to {most:,} expected, found {value:,}")
    if not 0.0 <= options.pitch < 90.0:
        raise ParameterError(f"--pitch: 0 to 90 degrees expected, found {options.pitch:g}")
    width, height = options.display
    try:
        camera = Camera(width, height, math.radians(options.fov))
    except ParameterError as error:
        raise ParameterError(f"--display, --fov: {error}") from None
    rules = _rules(options, triangles, camera)
    is_dataset = (options.source / "manifest.json").exists()
    if is_dataset:
        refuse_reading_arguments(
            options, f"the dataset {options.source}, whose city was read when it was built", _READING
        )
    reading = None if is_dataset else read_options(options)

    from rich.console import Console

    from mmi.planning.parameters import BuildParameters
    from viewer.making.checking import check_directions, check_views
    from viewer.making.models import read_model
    from viewer.making.place_images import place_images as place

    longest = None if options.objects == "blocks" else BuildParameters().longest_object
    talk = Console(stderr=options.json, quiet=options.quiet, highlight=False, markup=False, emoji=False)
    with ProgressBar("steps of reading", quiet=options.quiet) as advance:
        model = read_model(options.source, reading, longest_object=longest, progress=advance)
    if options.optimize is None:
        count = len(model.mesh.triangles)
        rules = replace(
            rules, target=triangles if count <= triangles else max(triangles - round(0.06 * count), triangles // 2)
        )
    with _words_of_options(), ProgressBar("images", quiet=options.quiet) as advance:
        summary = place(
            model,
            options.output,
            camera=camera,
            rules=rules,
            heights=options.heights,
            hidden=options.hidden,
            pictures=options.pictures,
            workers=workers,
            frame=frame,
            replacing=options.replace,
            progress=advance,
        )
    with suppress(SystemExit):  # rich leaves when nobody reads its output any more (| head)
        if model.report is not None:
            print_warnings(talk, model.report)
        _print_summary(talk, summary, options.output)
    checked = None
    if options.check is not None:
        with ProgressBar("views", quiet=options.quiet) as advance:
            views = check_views(summary.folder, model, views=options.check, seed=options.seed, progress=advance)
        with ProgressBar("points", quiet=options.quiet) as advance:
            checked = check_directions(summary.folder, model, progress=advance), views
        if not options.json:
            print(_said_of_all(checked[0]), _said(views), sep="\n")
    if options.json:
        print(json.dumps(_as_dict(summary, checked), indent=1))
    if checked is not None and not all(one.kept for one in checked):
        raise SystemExit(1)


_OPTIONS = (
    ("target: ", "--optimize: "),
    ("depth: ", "--octree-depth: "),
    ("pitch: ", "--pitch: "),
    ("across: ", "--fov: "),
    ("up: ", "--display, --fov: "),
    ("a view, ", "--fov, --pitch: a view, "),
)
"""How errors begin that rules and the grid raise, and how these begin for who has said options."""


@contextmanager
def _words_of_options() -> Iterator[None]:
    """Errors of rules, for the block, begin with the option that they are about."""
    try:
        yield
    except ParameterError as error:
        text = str(error)
        for begin, option in _OPTIONS:
            if text.startswith(begin):
                raise ParameterError(option + text.removeprefix(begin)) from None
        raise


def _rules(options: argparse.Namespace, triangles: int, camera: Camera) -> PlacingRules:
    """What options say; without one of what is left, all of the budget."""
    from viewer.placing.rules import PlacingRules, fov_of

    cost, benefit, small, far = options.weights
    with _words_of_options():
        return PlacingRules(
            triangles,
            triangles if options.optimize is None else options.optimize,
            fov_of(camera),
            depth=options.depth,
            pitch=math.radians(options.pitch),
            cost=cost,
            benefit=benefit,
            small=small,
            far=far,
        )


def _costs(text: str) -> list[float]:
    return numbers_option(text, 3, "three numbers of milliseconds (2,30,8)")


def _frame(options: argparse.Namespace) -> FrameBudget | None:
    """What milliseconds were said."""
    from viewer.placing.rules import FrameBudget

    if (options.budget_ms is None) != (options.costs is None):
        raise ParameterError("--budget-ms, --costs: both or neither expected, found one of them")
    if options.budget_ms is None:
        return None
    try:
        return FrameBudget(options.budget_ms, *options.costs)
    except ParameterError as error:
        raise ParameterError(f"--budget-ms, --costs: {error}") from None


def _weights(text: str) -> list[float]:
    found = numbers_option(text, 4, "four numbers from 0 to 1 (0.4,0.6,0.1,0.9)")
    if not all(0.0 <= one <= 1.0 for one in found):
        raise argparse.ArgumentTypeError(f"four numbers from 0 to 1 (0.4,0.6,0.1,0.9) expected, found {text!r}")
    return found


def _heights(text: str) -> tuple[float, float]:
    low, high = numbers_option(text, 2, "two heights, the lower first (1.5,1.9),")
    if not low < high:
        raise argparse.ArgumentTypeError(f"two heights, the lower first (1.5,1.9), expected, found {text!r}")
    return low, high


def _print_summary(talk: Console, summary: PlacingSummary, out: Path) -> None:
    budget = summary.folder.solutions.rules.budget
    share = summary.largest_count / budget
    spent = ", ".join(f"{stage} {seconds:.0f} s" for stage, seconds in summary.stages.items())
    mean = summary.bytes / max(summary.images, 1)
    needless = ", as the whole model is within the budget" if summary.triangles <= budget and not summary.images else ""
    talk.print(
        f"\n{summary.triangles:,} triangles in {summary.cells:,} cells; {summary.points:,} points with {summary.images:,} "
        f"images ({summary.made:,} made now), {summary.bytes / 1e6:.1f} MB, {mean / 1e3:.0f} kB each{needless}\n"
        f"no view draws more than {summary.largest_count:,} triangles ({100 * share:.1f} % of the budget)\n"
        f"{spent}; {summary.workers} workers, {summary.peak_memory_bytes / 1e6:.0f} MB of memory\n{out / 'manifest.json'}",
        soft_wrap=True,
    )


def _said_of_all(checked: GridChecked) -> str:
    """One line for people."""
    where = f"{checked.ranges:,} ranges of directions from {checked.points:,} points, which are all"
    if checked.kept:
        return f"budget kept: at most {checked.most:,} of {checked.budget:,} triangles in {where}"
    return f"budget BROKEN in {checked.over:,} of {where}: up to {checked.most:,} triangles, not {checked.budget:,}"


def _said(checked: Checked) -> str:
    """One line for people."""
    if checked.kept:
        return (
            f"budget kept: at most {checked.tally.most:,} of {checked.budget:,} triangles in {checked.views:,} views; "
            f"{checked.drawn:,} of them were drawn and counted"
        )
    return (
        f"budget BROKEN in {checked.tally.over:,} of {checked.views:,} views: up to {checked.tally.most:,} triangles, where "
        f"{checked.budget:,} are allowed; {checked.tally.outside:,} views had no point"
    )


def _as_dict(summary: PlacingSummary, checked: tuple[GridChecked, Checked] | None) -> dict[str, Any]:
    return {
        "triangles": summary.triangles,
        "cells": summary.cells,
        "points": summary.points,
        "images": summary.images,
        "made": summary.made,
        "bytes": summary.bytes,
        "budget": summary.folder.solutions.rules.budget,
        "most_triangles": summary.largest_count,
        "seconds": summary.stages,
        "workers": summary.workers,
        "peak_memory_bytes": summary.peak_memory_bytes,
        "checked": None
        if checked is None
        else {
            "ranges": checked[0].ranges,
            "most_triangles_of_ranges": checked[0].most,
            "ranges_over_budget": checked[0].over,
            "views": checked[1].views,
            "drawn": checked[1].drawn,
            "most_triangles": checked[1].tally.most,
            "over_budget": checked[1].tally.over,
            "kept": all(one.kept for one in checked),
        },
    }
