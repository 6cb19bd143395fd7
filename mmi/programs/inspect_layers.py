"""The program ``inspect-layers``: a dataset in, plots of what was done and why out."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from typing import NoReturn

from mmi.foundation.errors import one_line
from mmi.programs.command_line import Parser, ProgressBar, path_option, run_program

__all__ = ["inspect_layers"]

_EXAMPLE = """\
example:
  inspect-layers out/helsinki -o out/plots
  inspect-layers out/helsinki --cell 0017-00 --format svg -o out/plots
"""


def inspect_layers(arguments: Sequence[str] | None = None) -> NoReturn:
    """``inspect-layers OUT -o DIR``: pictures of what was built, and why."""
    parser = Parser(
        prog="inspect-layers",
        description="Plots of a dataset: bird's-eye view and event graph of cells, their layers, and histograms.",
        epilog=_EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("dataset", type=path_option, metavar="OUT", help="folder that build-impostors wrote")
    parser.add_argument(
        "-o", "--output", type=path_option, required=True, metavar="DIR", help="folder for the pictures"
    )
    parser.add_argument(
        "--cell", action="append", metavar="ID", help="a cell to plot (again for more; default: one typical)"
    )
    parser.add_argument(
        "--format",
        choices=("png", "svg", "pdf"),
        default="png",
        help="what the pictures are written as (default: %(default)s)",
    )
    parser.add_argument(
        "--own-functions",
        action="store_true",
        help="import the weights, layering and near stage of a dataset that was built with functions of one's own",
    )
    parser.add_argument("--json", action="store_true", help="list the files written as JSON on standard output")
    run_program(parser, arguments, _inspect, kept="the pictures so far are kept")


def _inspect(options: argparse.Namespace) -> None:
    from mmi.dataset.reading import open_dataset
    from mmi.inspection.inspect import inspect_dataset

    dataset = open_dataset(options.dataset)
    with ProgressBar("pictures") as advance:
        written = inspect_dataset(
            dataset,
            options.output,
            cells=options.cell,
            format=options.format,
            own_functions=options.own_functions,
            progress=advance,
        )
    if options.json:
        print(json.dumps([str(path) for path in written], indent=1))
    else:
        for path in written:
            print(one_line(str(path)))
