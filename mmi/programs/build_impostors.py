"""The program ``build-impostors``: options in, one line for every mistake, exit status 0, 2 or 130."""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, astuple
from typing import TYPE_CHECKING, NoReturn

from mmi.foundation.camera import Camera
from mmi.foundation.errors import ParameterError
from mmi.foundation.processes import usable_cores
from mmi.planning.choices import LAYERINGS, WEIGHTS, Choice
from mmi.planning.frame_costs import FrameCosts
from mmi.planning.parameters import GEOMETRIES, PICTURES, VISIBILITIES, BuildParameters
from mmi.programs.city_arguments import add_city_arguments, read_options
from mmi.programs.city_told import print_city_report
from mmi.programs.command_line import (
    Parser,
    ProgressBar,
    names_option,
    numbers_option,
    path_option,
    run_program,
    size_option,
)
from mmi.programs.presets import PRESETS, resolve

if TYPE_CHECKING:
    pass

__all__ = ["build_impostors"]

_MOST_WORKERS = 64
"""Or as many as there are cores; each holds the city, some hundred megabytes."""

_EXAMPLE = """\
examples:
  build-impostors examples/helsinki/helsinki.osm.pbf -o out/helsinki --max-cells 24
  build-impostors examples/helsinki/helsinki.osm.pbf -o out/around --around 24.9384,60.1672 --radius 120
  build-impostors buildings.shp --streets roads.shp -o out/town --display 1920x1080 --max-error 5

The same command resumes a build that was stopped, and after a change of the city rebuilds what the change touches.
"""


def build_impostors(arguments: Sequence[str] | None = None) -> NoReturn:
    """``build-impostors CITY -o OUT``: a dataset of multi-mesh impostors from a city."""
    parser = _build_parser()
    run_program(parser, arguments, _build, kept="what was finished is kept, the same command goes on from there")


# ----------------------------------------------------------------------------------------------- build-impostors


def _build_parser() -> Parser:
    parser = Parser(
        prog="build-impostors",
        description="Turn a city into multi-mesh impostors: for each stretch of street, nearby buildings as geometry and "
        "the rest as a few layers of textured depth meshes, in one folder.",
        epilog=_EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    default = BuildParameters()
    add_city_arguments(parser)
    parser.add_argument("-o", "--output", type=path_option, required=True, metavar="OUT", help="folder of the dataset")

    quality = parser.add_argument_group("the error, and the display that it refers to")
    quality.add_argument(
        "--for",
        dest="preset",
        choices=[one.name for one in PRESETS],
        help="display, error and budgets in one word; other options say otherwise. "
        + "; ".join(f"{one.name}: {one.words()}" for one in PRESETS),
    )
    quality.add_argument("--max-error", type=float, metavar="PX", help=f"pixels (default: {default.max_error_px:g})")
    quality.add_argument("--display", type=size_option, metavar="WxH", help="pixels (default: 512x512)")
    quality.add_argument("--fov", type=float, metavar="DEG", help="across the display (default: 60)")

    budget = parser.add_argument_group(
        "budgets of a cell",
        "A cell that exceeds one is cut in halves, down to 5 m: shorter cells need less for the same error.",
    )
    budget.add_argument("--max-layers", type=int, metavar="N")
    budget.add_argument("--max-triangles", type=int, metavar="N", help="of near objects and layers together")
    budget.add_argument("--max-bytes", type=int, metavar="N", help="of its files")

    method = parser.add_argument_group("how")
    method.add_argument("--visibility", choices=VISIBILITIES, default=default.visibility, help="default: %(default)s")
    method.add_argument(
        "--weights",
        default=default.weights,
        metavar="NAME",
        help=f"{_named(WEIGHTS)}, or a function of your own as package.module:function; only same-ray keeps the bound on the "
        "error (default: %(default)s)",
    )
    method.add_argument(
        "--layering",
        default=default.layering,
        metavar="NAME",
        help=f"{_named(LAYERINGS)} (one layer for all), or a function of your own; the last two keep no bound on the error "
        "(default: %(default)s)",
    )
    method.add_argument(
        "--longest-object",
        type=float,
        metavar="M",
        help="cut longer objects by vertical planes, so that what is far of them can be far; 0 cuts none (default: "
        f"{default.longest_object:g}, 0 with --objects blocks)",
    )
    near = method.add_mutually_exclusive_group()
    near.add_argument(
        "--near-distance",
        type=float,
        default=default.near_distance,
        metavar="M",
        help="objects nearer than this stay geometry (default: %(default)g)",
    )
    near.add_argument("--near-triangles", type=int, metavar="N", help="or: the nearest, up to so many triangles")
    method.add_argument(
        "--geometry",
        choices=GEOMETRIES,
        default="cheaper",
        help="what stays geometry: near objects alone, or also what costs less than its layers, whole cells too (default: "
        "%(default)s)",
    )
    method.add_argument(
        "--costs",
        type=_costs,
        metavar="D,T,B",
        help="what is compared then: how many triangles a draw, a thousand texels and a thousand bytes of a cell are worth "
        f"(default: {','.join(f'{value:g}' for value in astuple(default.costs))})",
    )
    method.add_argument(
        "--landmark",
        type=_landmark,
        action="append",
        default=[],
        metavar="ID=FACTOR",
        help="multiply the weights of this object (again for more)",
    )
    method.add_argument(
        "--cell-length",
        type=float,
        default=default.cell_length,
        metavar="M",
        help="longest cell (default: %(default)g)",
    )
    method.add_argument(
        "--eye", type=_band, default=default.eye, metavar="LOW,HIGH", help="eye heights, metres (default: 1.5,1.9)"
    )
    method.add_argument(
        "--sectors", type=int, default=default.sectors, metavar="N", help="views around (default: %(default)s)"
    )
    method.add_argument(
        "--quad",
        type=int,
        default=default.quad,
        metavar="TEXELS",
        help="pictures are cut to whole squares of this side (default: %(default)s)",
    )
    method.add_argument(
        "--pictures",
        choices=PICTURES,
        default=default.pictures,
        help="none stores meshes alone, a part of the bytes: viewers draw the pictures when they enter a cell (default: "
        "%(default)s)",
    )
    method.add_argument(
        "--texture-quality",
        type=int,
        default=default.texture_quality,
        metavar="Q",
        help="of stored pictures, 1 to 100: WebP, 100 is lossless (default: %(default)s)",
    )
    method.add_argument(
        "--supersample",
        type=int,
        default=default.supersample,
        metavar="N",
        help="1, 3 or 5 colour samples a side (default: 1)",
    )

    which = parser.add_argument_group("which cells", "All of the city, unless one of these says otherwise.")
    some = which.add_mutually_exclusive_group()
    some.add_argument(
        "--around",
        type=_place,
        metavar="LON,LAT|OBJECT",
        help="those around a place that can be walked to from there: degrees (metres x,y in the frame of a city without "
        "coordinate system), or the id of an object (way/123)",
    )
    some.add_argument(
        "--along", type=path_option, metavar="FILE", help="those that a recorded walk passes (JSON, schemas/walk.json)"
    )
    some.add_argument("--max-cells", type=int, metavar="N", help="N cells spread over the city, to measure it")
    some.add_argument("--cells", type=names_option, metavar="IDS", help="only these (0017-00,0017-01)")
    which.add_argument(
        "--radius",
        type=float,
        metavar="M",
        help="with --around: how near cells come to the place, in metres (default: 100)",
    )
    work = parser.add_argument_group("the work")
    work.add_argument("--workers", type=int, metavar="N", help="processes (default: one a core)")
    work.add_argument(
        "--json", action="store_true", help="the report as JSON on standard output, and nothing else there"
    )
    work.add_argument("--quiet", action="store_true", help="no progress, no tables")
    return parser


def _named(table: tuple[Choice, ...]) -> str:
    return ", ".join(one.name for one in table)


def _build(options: argparse.Namespace) -> None:
    parameters = _parameters(options)
    reading = read_options(options)
    cores = usable_cores()
    workers = options.workers if options.workers is not None else cores
    if not 1 <= workers <= max(_MOST_WORKERS, cores):
        raise ParameterError(f"--workers: 1 to {max(_MOST_WORKERS, cores)} processes expected, found {workers}")
    if options.max_cells is not None and options.max_cells < 1:
        raise ParameterError(f"--max-cells: a number of at least 1 expected, found {options.max_cells}")
    if options.radius is not None and options.around is None:
        raise ParameterError("--radius: a place to go with it expected (--around), found none")
    if options.radius is not None and not 0.0 < options.radius < math.inf:
        raise ParameterError(f"--radius: metres above 0 expected, found {options.radius:g}")

    from rich.console import Console

    from mmi.building.cell_choice import RADIUS, choose_cells
    from mmi.building.dataset import build_dataset
    from mmi.dataset.folder import make_folder
    from mmi.programs.build_told import print_cells, print_summary
    from mmi.reading.read_city import read_city
    from mmi.walks.walk import read_walk

    walk = None if options.along is None else read_walk(options.along)
    talk = Console(stderr=options.json, quiet=options.quiet, highlight=False, markup=False, emoji=False)
    with ProgressBar("steps of reading", quiet=options.quiet) as advance:
        city, report = read_city(options.city, reading, progress=advance)
    # Whoever mistypes an option gets one line, not a table before it.
    chosen = choose_cells(
        city,
        parameters,
        cells=options.cells,
        max_cells=options.max_cells,
        around=options.around,
        radius=RADIUS if options.radius is None else options.radius,
        along=walk,
    )
    make_folder(options.output)
    with suppress(SystemExit):  # rich leaves when nobody reads its output any more (| head): the build goes on
        print_city_report(talk, report)
        print_cells(talk, chosen, parameters)
    with ProgressBar("cells", quiet=options.quiet) as advance:
        summary = build_dataset(
            city,
            options.output,
            parameters,
            cells=chosen,
            workers=workers,
            progress=advance,
        )
    with suppress(SystemExit):
        print_summary(talk, summary, options.output, parameters, source=options.city)
    if options.json:
        print(json.dumps({"city": report.as_dict(), "build": asdict(summary)}, indent=1))


def _parameters(options: argparse.Namespace) -> BuildParameters:
    """The options as parameters; what is wrong with one is said by its option's name."""
    resolve(options)
    if options.costs is not None and options.geometry == "near":
        raise ParameterError("--costs: --geometry cheaper expected, which compares them, found near")
    width, height = options.display
    try:
        return BuildParameters(
            max_error_px=options.max_error,
            camera=Camera(width, height, math.radians(options.fov)),
            near_distance=options.near_distance,
            near_triangles=options.near_triangles,
            longest_object=_longest(options),
            visibility=options.visibility,
            weights=options.weights,
            layering=options.layering,
            landmarks=tuple(sorted(options.landmark)),
            max_layers=options.max_layers,
            max_triangles=options.max_triangles,
            max_bytes=options.max_bytes,
            sectors=options.sectors,
            quad=options.quad,
            supersample=options.supersample,
            texture_quality=options.texture_quality,
            pictures=options.pictures,
            cell_length=options.cell_length,
            eye=options.eye,
            geometry=options.geometry,
            costs=BuildParameters().costs if options.costs is None else options.costs,
        )
    except ParameterError as error:
        name, colon, rest = str(error).partition(":")
        if name in BuildParameters.__slots__:
            name = {"max_error_px": "--max-error", "camera": "--display, --fov"}.get(
                name, f"--{name.replace('_', '-')}"
            )
        raise ParameterError(f"{name}{colon}{rest}") from None


def _longest(options: argparse.Namespace) -> float | None:
    if options.longest_object is None:
        return None if options.objects == "blocks" else BuildParameters().longest_object
    return options.longest_object or None


# ------------------------------------------------------------------------------------------------- option values


def _band(text: str) -> tuple[float, ...]:
    return tuple(numbers_option(text, 2, "lowest,highest eye height in metres"))


def _costs(text: str) -> FrameCosts:
    numbers = numbers_option(text, 3, "triangles for a draw, a thousand texels, a thousand bytes")
    try:
        return FrameCosts(*numbers)
    except ParameterError as error:
        raise argparse.ArgumentTypeError(str(error).removeprefix("costs: ")) from None


def _place(text: str) -> tuple[float, float] | str:
    """Two numbers are a place, anything else is an object's id."""
    with suppress(argparse.ArgumentTypeError):
        x, y = numbers_option(text, 2, "longitude,latitude")
        return x, y
    if not text:
        raise argparse.ArgumentTypeError("LON,LAT or the id of an object expected, found nothing")
    return text


def _landmark(text: str) -> tuple[str, float]:
    name, _, factor = text.rpartition("=")
    try:
        if name:
            return name, float(factor)
    except ValueError:
        pass
    raise argparse.ArgumentTypeError(f"ID=FACTOR expected, such as way/123=4, found {text!r}")
