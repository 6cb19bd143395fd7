"""The program ``view-impostors``, which shows a dataset in a browser. A mistake gets one line, and exit status 2."""

from __future__ import annotations

import argparse
import os
import signal
import sys
import threading
import webbrowser
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import NoReturn

from mmi.foundation.errors import ParameterError
from mmi.programs.command_line import Parser, names_option, path_option, run_program
from viewer.programs.technique_arguments import add_warp_argument

__all__ = ["view_impostors"]

_EXAMPLE = """\
examples:
  view-impostors out/helsinki                          opens a page in your browser; Ctrl-C ends it
  view-impostors out/helsinki --window                 the same in a window of its own, which ends it
  view-impostors out/helsinki --port 8080 --no-browser
  view-impostors out/helsinki --techniques full,multi-mesh,my_module:my_technique
  view-impostors out/helsinki --host 0.0.0.0           for other machines; prints the address with the token they need

On another machine over SSH: start it there with --port 8080 --no-browser, run
  ssh -L 8080:127.0.0.1:8080 THE_MACHINE
here, and open http://127.0.0.1:8080/.
"""


def view_impostors(arguments: Sequence[str] | None = None) -> NoReturn:
    """``view-impostors OUT``: walk through a dataset, and compare techniques, in a browser's page."""
    parser = Parser(
        prog="view-impostors",
        description="Walk through a dataset and compare what techniques draw, in a page of your browser: two of them side by "
        "side or under a swipe, what differs, layers, wireframes, a map, frame times. The first line of output is the page's "
        "address.",
        epilog=_EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("dataset", type=path_option, metavar="OUT", help="folder that build-impostors wrote")
    parser.add_argument(
        "--techniques",
        type=names_option,
        metavar="A,B,...",
        help="what the page offers (default: all that the dataset has); package.module:function is a technique of your own",
    )
    parser.add_argument(
        "--placed",
        type=path_option,
        metavar="DIR",
        help="what place-images wrote for the dataset: offers placed-images",
    )
    add_warp_argument(parser)
    parser.add_argument("--cache", type=float, default=512.0, metavar="MB", help="memory for cells (default: 512)")
    server = parser.add_argument_group("the page")
    server.add_argument(
        "--host",
        default="127.0.0.1",
        metavar="NAME",
        help="address to listen at (default: this machine only); any other demands a token, which is part of the address that "
        "is printed",
    )
    server.add_argument("--port", type=int, default=0, metavar="N", help="port to listen at (default: any free one)")
    server.add_argument(
        "--token",
        metavar="TEXT",
        help="token that the page demands (default: none on this machine only, else a random one)",
    )
    where = server.add_mutually_exclusive_group()
    where.add_argument("--no-browser", action="store_true", help="print the address and open no browser")
    where.add_argument(
        "--window",
        action="store_true",
        help="show the page in a window of its own, by an installed Chromium, Chrome, Edge or Brave; the program ends when it "
        "is closed",
    )
    run_program(parser, arguments, _view, kept="the viewer was ended")


def _view(options: argparse.Namespace) -> None:
    if not 1.0 <= options.cache <= 1e6:
        raise ParameterError(f"--cache: 1 to 1000000 MB expected, found {options.cache:g}")
    try:
        from viewer.serving.desktop import find_browser, has_screen, show_window
        from viewer.serving.server import ServerOptions, ServerThread, serve
    except ImportError as error:
        raise ParameterError(
            f'{error.name}: a package of the viewer expected; pip install "multi-mesh-impostors[viewer]" brings it'
        ) from None
    from viewer.window.look import Look
    from viewer.window.options import StudioOptions
    from viewer.window.studio import Studio

    try:
        chosen = ServerOptions(host=options.host, port=options.port, token=options.token)
    except ParameterError as error:
        raise ParameterError(f"--{error}") from None
    if options.warp is not None and options.placed is None:
        raise ParameterError("--warp: a folder that place-images wrote (--placed) expected, found none")
    wanted = StudioOptions(cache=round(1e6 * options.cache), placed=options.placed, warp=options.warp or "software")
    if options.techniques is not None:
        left, right = options.techniques[0], options.techniques[-1]
        wanted = replace(wanted, techniques=tuple(options.techniques), look=Look(left=left, right=right))

    def started(address: str) -> None:
        print(address, flush=True)
        print("Ctrl-C ends the viewer.", file=sys.stderr, flush=True)
        if not options.no_browser and has_screen(os.environ):
            threading.Thread(target=webbrowser.open, args=(address,), daemon=True).start()

    with _all_signals_end_it_as_ctrl_c_does():
        studio = Studio(options.dataset, wanted)
        if not options.window:
            serve(studio, chosen, started=started)
            return
        try:
            find_browser()
            with studio, ServerThread(studio, chosen) as address:
                print(address, flush=True)
                show_window(address)
        except ParameterError as error:
            raise ParameterError(f"--window: {error}") from None


@contextmanager
def _all_signals_end_it_as_ctrl_c_does() -> Iterator[None]:
    """Being told to end, or losing the terminal, takes films, windows and profiles along as Ctrl-C does.

    What whoever started the program has set for a signal stays (``nohup``).
    """
    numbers = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
    ours = [one for one in numbers if signal.getsignal(one) == signal.SIG_DFL]
    for one in ours:
        signal.signal(one, lambda *_: signal.raise_signal(signal.SIGINT))
    try:
        yield
    finally:
        for one in ours:
            signal.signal(one, signal.SIG_DFL)
