"""What a program says of the city that it read: a table of what was found, and the warnings, a line each."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mmi.foundation.errors import one_line

if TYPE_CHECKING:
    from rich.console import Console

    from mmi.reading.read_city import CityReport

__all__ = ["print_city_report", "print_warnings"]


def print_city_report(talk: Console, report: CityReport) -> None:
    """Print the account of everything that was read."""
    from rich.table import Table

    table = Table(title=one_line(f"{report.source}, {report.crs}"), title_justify="left", box=None, pad_edge=False)
    for heading in ("", "what", "count", ""):
        table.add_column(heading, justify="right" if heading == "count" else "left", overflow="fold")
    last = ""
    for section, what, count, detail in report.rows():
        if section != "warning":
            table.add_row("" if section == last else section, one_line(what), count, one_line(detail))
        last = section
    talk.print(table)
    print_warnings(talk, report)


def print_warnings(talk: Console, report: CityReport) -> None:
    """Print what whoever has read the files should know, a line each."""
    for warning in report.warnings:
        talk.print(one_line(f"warning: {warning}"), soft_wrap=True)
