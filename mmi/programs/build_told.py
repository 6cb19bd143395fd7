"""What ``build-impostors`` says of a build: what became of the streets, what was made, and what the city costs."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

from mmi.foundation.errors import one_line
from mmi.programs.presets import too_coarse

if TYPE_CHECKING:
    from rich.console import Console

    from mmi.building.cell_choice import CellChoice
    from mmi.building.city_costs import CityCosts
    from mmi.building.dataset import BuildSummary
    from mmi.cells.viewing_cells import CellReport
    from mmi.planning.parameters import BuildParameters

__all__ = ["print_cells", "print_summary"]

_ALL = 0.999
"""Of all cells, by length: where so much is built, nothing is estimated."""


def print_cells(talk: Console, chosen: CellChoice, parameters: BuildParameters) -> None:
    """What became of the streets, which cells were chosen, and whether the threshold will be seen: a line each."""
    cells: CellReport = chosen.graph.graph["report"]
    text = f"{cells.cells} viewing cells on {cells.street_length / 1000.0:.1f} km of streets"
    if cells.narrowed_cells:
        text += f", {cells.narrowed_cells} narrower than their street, to keep clear of buildings"
    if cells.cut_pieces:
        text += f"; {cells.cut_length:.0f} m in {cells.cut_pieces} places have no room for a cell"
    if cells.degenerate_streets:
        text += f"; {cells.degenerate_streets} streets without length left out"
    talk.print(text, soft_wrap=True)
    if len(chosen.names) < cells.cells:
        text = f"{_cells(len(chosen.names))} chosen"
        if chosen.apart:
            text += (
                f"; {chosen.apart} more are as near to the place, but cannot be walked to from there through such cells"
            )
        talk.print(text, soft_wrap=True)
    note = too_coarse(parameters)
    if note is not None:
        talk.print(note, soft_wrap=True)


_MOST_CELLS = 5
"""Cells over budget that are named one by one."""


def print_summary(
    talk: Console, summary: BuildSummary, out: Path, parameters: BuildParameters, *, source: Path
) -> None:
    """Print what a build did, and what the city costs now; ``source`` is what it was read from."""
    if summary.parts:
        talk.print(f"{summary.parts} parts of objects longer than {parameters.longest_object:g} m")
    made = [f"{_cells(summary.built)} built"]
    if summary.complete:
        made.append(f"{summary.complete} were complete")
    if summary.unchanged:
        made.append(f"{summary.unchanged} see nothing that has changed")
    talk.print(f"{', '.join(made)}, in {summary.seconds:.1f} s with {summary.workers} worker(s)", end="")
    if summary.built:
        pace = summary.built / summary.seconds
        talk.print(f" ({pace:.1f} cells/s)" if pace >= 1.0 else f" ({1.0 / pace:.1f} s a cell)", end="")
    talk.print(f"; peak memory {summary.peak_memory_bytes / 1e6:.0f} MB")
    talk.print(f"{one_line(str(out))}: {_cells(summary.cells)}, {summary.bytes / 1e6:.1f} MB", soft_wrap=True)
    if summary.cells:
        _print_costs(talk, summary.costs, parameters, source)
    if summary.removed:
        talk.print(
            f"{_cells(summary.removed)} of an earlier build removed: built with other options, or of another city"
        )
    if summary.cut:
        talk.print(f"{_cells(summary.cut)} cut in halves to keep the budgets")
    for cell, costs in list(summary.over_budget.items())[:_MOST_CELLS]:
        text = ", ".join(f"{cost} {name} of {limit}" for name, (cost, limit) in costs.items())
        talk.print(f"cell {cell} exceeds its budget: {text}", soft_wrap=True)
    if summary.over_budget:
        talk.print(
            f"{_cells(len(summary.over_budget))} too short to be cut further: raise --max-error or the budget, or lower "
            "--display; --objects, --near-distance and --texture-quality decide what a cell costs, too",
            soft_wrap=True,
        )
    if summary.withheld:
        talk.print(
            f"no bound of the error is promised for {len(summary.withheld)} of {_cells(summary.cells)}:", soft_wrap=True
        )
        for why, number in Counter(summary.withheld.values()).most_common(_MOST_CELLS):
            name = next(cell for cell, reason in summary.withheld.items() if reason == why)
            where = f"cell {name}" if number == 1 else f"{_cells(number)}, such as {name}"
            talk.print(f"  {where}: {why}", soft_wrap=True)


def _print_costs(talk: Console, costs: CityCosts, parameters: BuildParameters, source: Path) -> None:
    """The city as it was read, as it is stored, and as it is drawn: a table."""
    from rich.table import Table

    table = Table(title="what the city costs", title_justify="left", box=None, pad_edge=False)
    for heading in ("", "triangles", "MB", ""):
        table.add_column(heading, justify="right" if heading else "left", overflow="fold")
    size = f"{source.stat().st_size / 1e6:.1f}" if source.is_file() else ""
    cut = f", {costs.objects - costs.objects_read:,} by cuts" if costs.objects > costs.objects_read else ""
    shared, cells = f"{costs.shared_bytes / 1e6:.1f}", f"{costs.cell_bytes / 1e6:.1f}"
    a_metre = f"{costs.bytes_a_metre / 1e3:.1f} kB a metre of street"
    near = f"{costs.frame_near:,.0f} near; at most {costs.largest_frame:,}"
    table.add_row("as read", f"{costs.triangles_read:,}", size, f"{costs.objects_read:,} objects")
    table.add_row("stored: objects, ground", f"{costs.triangles:,}", shared, f"{costs.objects:,} objects{cut}")
    table.add_row(f"stored: {_cells(costs.cells)}", f"{costs.layer_triangles:,}", cells, a_metre)
    if costs.share < _ALL:
        layers = f"{costs.layer_triangles / costs.share:,.0f}"
        all_cells = f"{costs.estimated_bytes / 1e6 - costs.shared_bytes / 1e6:,.0f}"
        table.add_row("all cells, estimated", layers, all_cells, f"of {costs.all_metres / 1e3:.1f} km")
    table.add_row("a frame, as stored", f"{costs.frame_triangles:,.0f}", "", near)
    table.add_row("a frame, as geometry", f"{costs.geometry_triangles:,.0f}", "", "all that can be seen from a cell")
    talk.print(table)
    if costs.as_geometry:
        share = f"{costs.as_geometry / costs.cells:.0%}"
        talk.print(
            f"{_cells(costs.as_geometry)} of {costs.cells} ({share}) stay geometry: nothing would cost less in a layer",
            soft_wrap=True,
        )
    if costs.worst_px is not None and parameters.bounded:
        talk.print(
            f"worst error of any cell, by its own figures: {costs.worst_px:.1f} px of {parameters.max_error_px:g} px"
        )


def _cells(count: int) -> str:
    return f"{count} cell" if count == 1 else f"{count} cells"
