"""The program ``compare-impostors``, which writes a report. Every mistake gets one line; it exits with status 0, 2 or 130."""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Final, NoReturn

from mmi.foundation.camera import Camera
from mmi.foundation.errors import CityError, ParameterError
from mmi.foundation.processes import usable_cores
from mmi.foundation.whole_files import real_path
from mmi.programs.city_arguments import CITY_FILES, add_reading_arguments, read_options, refuse_reading_arguments
from mmi.programs.city_told import print_warnings
from mmi.programs.command_line import (
    Parser,
    ProgressBar,
    names_option,
    path_option,
    run_program,
    size_option,
)
from viewer.programs.comparison_told import print_comparison
from viewer.programs.technique_arguments import (
    add_cache_arguments,
    add_cast_arguments,
    add_placed_arguments,
    cache_rules,
    cast_rules,
    placed_rules,
)

if TYPE_CHECKING:
    from mmi.city.model import City
    from mmi.reading.read_city import CityReport
    from mmi.walks.walk import Walk
    from viewer.scene.scene import WalkScene

__all__ = ["compare_impostors"]

_TECHNIQUES = "full,visible,local,single-mesh,multi-mesh"
_MORE = ("multi-mesh-dynamic", "ray-cast", "image-cache", "placed-images")
_OF_CITIES = "full,ray-cast,image-cache"
"""What is compared where a city is drawn as it was read."""
_DISPLAY = (512, 512)
_FOV = 60.0
"""What a city is drawn for, if nobody says: what build-impostors builds for."""
_TOUR_METRES = 300.0
_VIEWS = 50
_MOVERS_ERROR = 1.0
_MOVERS_VALIDITY: Final = "predictive"

_EXAMPLE = """\
examples:
  compare-impostors out/helsinki -o out/comparison                        50 random views inside cells
  compare-impostors out/helsinki -o out/comparison --views 500 --seed 2 --techniques single-mesh,multi-mesh
  compare-impostors out/helsinki -o out/held --settle 16 --budget-ms 5 --techniques full,multi-mesh,multi-mesh-dynamic
  compare-impostors out/helsinki -o out/tour --tour 400 --video           walk 400 m, and film it
  compare-impostors out/helsinki -o out/walk --path walk.json
  compare-impostors out/helsinki -o out/traffic --tour 100 --movers out/helsinki.traffic.json --video
  compare-impostors out/helsinki -o out/mine --techniques full,multi-mesh,my_module:my_technique
  compare-impostors out/helsinki -o out/wide --display 1920x1080          pictures of another display than it was built for
  compare-impostors examples/helsinki/helsinki.osm.pbf -o out/city --techniques full,ray-cast
                                                                          a city as it is, without a dataset

Open DIR/report.html; DIR/report.json has the same figures, and DIR/worst the worst views.
"""


def compare_impostors(arguments: Sequence[str] | None = None) -> NoReturn:
    """``compare-impostors OUT|CITY -o DIR``: how wrong and how fast techniques are, next to the geometry."""
    parser = Parser(
        prog="compare-impostors",
        description="Draw views of a dataset with several techniques and with the geometry, and report how they differ: "
        "holes, wrong surfaces and how thick they are, displacement, FLIP, PSNR, SSIM, frame times.",
        epilog=_EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "source",
        type=path_option,
        metavar="OUT|CITY",
        help="folder that build-impostors wrote; or a city, for techniques that need no impostors: " + CITY_FILES,
    )
    parser.add_argument("-o", "--output", type=path_option, required=True, metavar="DIR", help="folder for the report")
    where = parser.add_argument_group("from where").add_mutually_exclusive_group()
    where.add_argument(
        "--views",
        type=int,
        metavar="N",
        help=f"from random views inside cells (this is the default, with N = {_VIEWS})",
    )
    where.add_argument(
        "--path", type=path_option, metavar="FILE", help="along a recorded walk (JSON, schemas/walk.json)"
    )
    where.add_argument(
        "--tour",
        type=float,
        nargs="?",
        const=_TOUR_METRES,
        metavar="METRES",
        help=f"along a walk that is made for the streets (default length: {_TOUR_METRES:g} m)",
    )
    parser.add_argument(
        "--seed", type=int, default=1, metavar="S", help="seed of random views and tours (default: %(default)s)"
    )
    parser.add_argument(
        "--techniques",
        type=names_option,
        metavar="A,B,...",
        help=f"default: {_TECHNIQUES}; for a CITY {_OF_CITIES}, which need no dataset; there are also {_MORE[0]} and "
        f"{_MORE[2]}, whose views want to be held (--settle), {_MORE[1]}, and {_MORE[3]} (--placed); package.module:function "
        "is a technique of your own (a function of the scene, in a module that can be imported or is in the current folder)",
    )
    add_reading_arguments(parser)
    display = parser.add_argument_group("the display")
    display.add_argument(
        "--display",
        type=size_option,
        metavar="WxH",
        help="pixels (default: what the dataset was built for, or placed images; "
        f"{_DISPLAY[0]}x{_DISPLAY[1]} for a CITY)",
    )
    display.add_argument(
        "--fov",
        type=float,
        metavar="DEG",
        help=f"across the display (default: what the dataset was built for; {_FOV:g} for a CITY)",
    )
    frames = parser.add_argument_group("frames")
    frames.add_argument(
        "--fps",
        type=float,
        default=30.0,
        metavar="N",
        help="frames a second of walks and of views that are held (default: 30)",
    )
    frames.add_argument(
        "--settle",
        type=int,
        metavar="N",
        help="hold each random view for N frames, all of which are timed, and score the last one (default: 1); what a "
        "technique captures at run time comes into the picture in these frames",
    )
    frames.add_argument(
        "--budget-ms",
        type=float,
        default=math.inf,
        metavar="MS",
        help="milliseconds of each frame that captures at run time, and rays, may take at most; 0 forbids them (default: "
        "what is left of the frame)",
    )
    frames.add_argument(
        "--glint",
        action="store_true",
        help="let windows of painted facades mirror a low sun: stored pictures cannot show that, those captured at run time do",
    )
    walks = parser.add_argument_group("walks")
    walks.add_argument("--speed", type=float, default=5.0, metavar="M/S", help="speed of a tour (default: %(default)g)")
    walks.add_argument(
        "--scored", type=int, default=60, metavar="N", help="views of a walk that are measured (default: %(default)s)"
    )
    walks.add_argument(
        "--fade",
        type=float,
        default=0.0,
        metavar="SECONDS",
        help="cross-fade where the viewer comes into another cell (default: none)",
    )
    walks.add_argument(
        "--save-path", type=path_option, metavar="FILE", help="write the tour into a file, to walk it again with --path"
    )
    walks.add_argument(
        "--video", nargs="?", const="mp4", choices=("mp4", "webp"), help="film the walk, techniques side by side"
    )
    add_cast_arguments(parser)
    add_cache_arguments(parser)
    add_placed_arguments(parser)
    movers = parser.add_argument_group("what moves")
    movers.add_argument(
        "--movers",
        type=path_option,
        metavar="FILE",
        help="objects that move (JSON, schemas/movers.json; citygen traffic)",
    )
    movers.add_argument(
        "--movers-error",
        type=float,
        metavar="PX",
        help=f"pixels that images of them may be wrong by (default: {_MOVERS_ERROR:g})",
    )
    movers.add_argument(
        "--movers-validity",
        choices=("predictive", "common"),
        help="keep an image for as many frames as are predicted, or as long as it is not wrong now "
        f"(default: {_MOVERS_VALIDITY})",
    )
    movers.add_argument(
        "--movers-time",
        type=float,
        metavar="SECONDS",
        help="the time at which they stand in random views (default: 0); on a walk they move",
    )
    work = parser.add_argument_group("the work")
    work.add_argument(
        "--antialias",
        type=int,
        default=0,
        metavar="SAMPLES",
        help="samples in each pixel of timed frames (default: none)",
    )
    work.add_argument("--cache", type=float, default=512.0, metavar="MB", help="memory for cells (default: 512)")
    work.add_argument(
        "--worst", type=int, default=6, metavar="N", help="worst views to show of each technique (default: 6)"
    )
    work.add_argument("--no-flip", action="store_true", help="leave out FLIP, which takes most of the time")
    work.add_argument(
        "--json", action="store_true", help="print the report as JSON, and nothing else, on standard output"
    )
    work.add_argument(
        "--check",
        action="store_true",
        help="end with exit status 1 unless multi-mesh keeps what the dataset promises in all views that were compared",
    )
    work.add_argument("--quiet", action="store_true", help="print no progress and no table")
    run_program(parser, arguments, _compare, kept="no report was written, cells built for single-mesh are kept")


def _compare(options: argparse.Namespace) -> None:
    walking = options.path is not None or options.tour is not None
    for name, given in (("--video", options.video is not None), ("--save-path", options.save_path is not None)):
        if given and not walking:
            raise ParameterError(f"{name}: a walk expected (--path or --tour), found views")
    if options.settle is not None and walking:
        raise ParameterError("--settle: views to hold expected (--views), found a walk")
    if options.save_path is not None and options.tour is None:
        raise ParameterError("--save-path: a tour to save expected (--tour)")

    if not 1.0 <= options.cache <= 1e6:
        raise ParameterError(f"--cache: 1 to 1000000 MB expected, found {options.cache:g}")

    city_of = None if _is_dataset(options.source) else options.source
    if options.check and (city_of is not None or "multi-mesh" not in _techniques(options.techniques, of_city=False)):
        found = f"the city {options.source}" if city_of is not None else ", ".join(options.techniques)
        raise ParameterError(f"--check: a dataset's promise of multi-mesh to check expected, found {found}")
    if city_of is None:
        refuse_reading_arguments(options, f"the dataset {options.source}, whose city was read when it was built")
    else:
        reading = read_options(options)
        written = real_path(options.output)
        if city_of.is_dir() and real_path(city_of) in (written, *written.parents):
            raise ParameterError(f"{options.output}: a folder outside of {city_of} expected")

    from mmi.movers.movers import NOTHING_MOVES
    from mmi.movers.movers_file import read_movers
    from mmi.planning.parameters import BuildParameters
    from mmi.reading.read_city import read_city
    from mmi.walks.walk import read_walk, write_walk
    from viewer.report.compare import CompareOptions, compare_views, compare_walk
    from viewer.techniques.catalogue import refuse_without_dataset
    from viewer.techniques.virtual_frames import FrameRules
    from viewer.walks.tour import tour

    techniques = tuple(_techniques(options.techniques, of_city=city_of is not None))
    rays, images = cast_rules(options, techniques), cache_rules(options, techniques)
    placed = placed_rules(options, techniques)
    moving = NOTHING_MOVES if options.movers is None else read_movers(options.movers)
    try:
        chosen = CompareOptions(
            techniques=techniques,
            rays=rays,
            images=images,
            placed=placed,
            frames_per_second=options.fps,
            settle=1 if options.settle is None else options.settle,
            budget_ms=options.budget_ms,
            glint=options.glint,
            fade=options.fade,
            samples=options.antialias,
            cache=round(1e6 * options.cache),
            scored=options.scored,
            keep=options.worst,
            flip=not options.no_flip,
            video=options.video,
            workers=usable_cores(),
            movers=moving,
            mover_frames=FrameRules(
                limit_px=_MOVERS_ERROR if options.movers_error is None else options.movers_error,
                calculation=options.movers_validity or _MOVERS_VALIDITY,
            ),
            movers_time=0.0 if options.movers_time is None else options.movers_time,
            camera=_camera(options, of_city=city_of is not None),
            longest_object=None if options.objects == "blocks" else BuildParameters().longest_object,
        )
        if city_of is not None:
            refuse_without_dataset(chosen.entries, str(city_of))
    except ParameterError as error:
        name, colon, rest = str(error).partition(":")
        names = {"frames_per_second": "fps", "budget_ms": "budget-ms", "samples": "antialias", "keep": "worst"}
        names |= {"limit_px": "movers-error", "movers_time": "movers-time", "camera": "display, --fov"}
        option = name if name.startswith("--") else f"--{names.get(name, name)}"
        raise ParameterError(f"{option}{colon}{rest}") from None
    _check_movers(options, walking=walking)
    path = read_walk(options.path) if options.path is not None else None

    def made(scene: WalkScene) -> Walk:
        places = scene.whereabouts
        walk = tour(places.cells, places.adjacency, metres=options.tour, speed=options.speed, seed=options.seed)
        if options.save_path is not None:
            write_walk(walk, options.save_path)
        return walk

    source: Path | City = options.source
    read: CityReport | None = None
    if city_of is not None:
        with ProgressBar("steps of reading", quiet=options.quiet) as tell:
            try:
                source, read = read_city(city_of, reading, progress=tell)
            except CityError as error:
                raise CityError(
                    f"{error}; or a dataset, which has a manifest.json" if city_of.is_dir() else error
                ) from None
    with ProgressBar("comparison", quiet=options.quiet) as tell:
        if path is not None or options.tour is not None:
            report = compare_walk(
                source,
                options.output,
                path if path is not None else made,
                mode="path" if path is not None else "tour",
                options=chosen,
                progress=tell,
            )
        else:
            views = _VIEWS if options.views is None else options.views
            report = compare_views(
                source, options.output, views=views, seed=options.seed, options=chosen, progress=tell
            )
    if read is not None:
        _print_reading(read, options)
    if options.json:
        print(json.dumps(report, indent=1))
    elif not options.quiet:
        with suppress(SystemExit):  # rich leaves when nobody reads its output any more (| head)
            print_comparison(report, options.output)
    if options.check and not report["verdict"]["kept"]:
        raise SystemExit(1)


def _is_dataset(path: Path) -> bool:
    """Whether a path is a dataset's folder, be it one that a build did not finish."""
    return any((path / name).exists() for name in ("manifest.json", "cells"))


def _techniques(names: list[str] | None, *, of_city: bool) -> list[str]:
    return names_option(_OF_CITIES if of_city else _TECHNIQUES) if names is None else names


def _camera(options: argparse.Namespace, *, of_city: bool) -> Camera | None:
    """The display that was asked for; None where none was. What is not said is as usual, or as placed images want it."""
    if options.display is None and options.fov is None and options.folder is None:
        return None
    size, fov = _DISPLAY, math.radians(_FOV)
    if options.folder is not None:
        from viewer.placed.folder import open_placed

        placed_for = open_placed(options.folder).solutions.camera
        size, fov = (placed_for.width, placed_for.height), placed_for.fov
    elif not of_city and None in (options.display, options.fov):
        from mmi.dataset.reading import open_dataset

        built_for = open_dataset(options.source).manifest.parameters.camera
        size, fov = (built_for.width, built_for.height), built_for.fov
    width, height = size if options.display is None else options.display
    try:
        return Camera(width, height, fov if options.fov is None else math.radians(options.fov))
    except ParameterError as error:
        raise ParameterError(f"--display, --fov: {error}") from None


def _print_reading(report: CityReport, options: argparse.Namespace) -> None:
    """The warnings of a city that was read, as a build gives them."""
    from rich.console import Console

    with suppress(SystemExit):  # rich leaves when nobody reads its output any more (| head)
        print_warnings(
            Console(stderr=options.json, quiet=options.quiet, highlight=False, markup=False, emoji=False), report
        )


def _check_movers(options: argparse.Namespace, *, walking: bool) -> None:
    """Options of what moves mean something only where something moves, and a time only where it stands still."""
    for name in ("movers_error", "movers_validity", "movers_time"):
        if getattr(options, name) is not None and options.movers is None:
            raise ParameterError(f"--{name.replace('_', '-')}: objects that move expected (--movers FILE), found none")
    if options.movers_time is not None and walking:
        raise ParameterError("--movers-time: views expected (--views), found a walk, on which objects move")
