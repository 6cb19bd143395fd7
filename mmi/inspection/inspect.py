"""Pictures of a dataset: what its build decided for a cell and why, what it captured, and how big all cells are.

The dataset holds what a cell shows, not the graph of visibility events behind it. That is planned again from the stored
city and parameters and held against the manifest, so that no picture shows a plan that the dataset was not built from.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from matplotlib.figure import Figure

from mmi.building.cell import capture_layers
from mmi.building.planned_again import planned_again, prepared_again
from mmi.capture.layer_values import Layer
from mmi.dataset.cell_files import read_impostor
from mmi.dataset.manifest import CellEntry
from mmi.dataset.reading import Dataset
from mmi.foundation.errors import DatasetError, ParameterError
from mmi.inspection.figures import PICTURE_FORMATS, counted, save
from mmi.inspection.layer_sheets import dataset_histograms, layer_sheet
from mmi.inspection.maps import birds_eye, event_graph_plot
from mmi.planning.plan import PreparedCity

if TYPE_CHECKING:
    from mmi.capture.renderer import Capturer

__all__ = ["inspect_dataset", "typical_cell"]

_COMPASS = ("east", "northeast", "north", "northwest", "west", "southwest", "south", "southeast")


def inspect_dataset(
    dataset: Dataset,
    output: Path,
    *,
    cells: Sequence[str] | None = None,
    format: str = "png",  # noqa: A002 - matplotlib's word for it
    own_functions: bool = False,
    progress: Callable[[int, int, str], None] | None = None,
) -> list[Path]:
    """Draw ``cells``, by default the :func:`typical_cell`, into folder ``output``; the files written, in order.

    For each cell ``ID-map.png`` (bird's-eye view, paper figure 5), ``ID-graph.png`` (visibility events and their weights)
    and ``ID-sector-K.png`` for each sector K that has layers; then ``histograms.png`` over all cells of the dataset;
    other endings for other formats (``png``, ``svg``, ``pdf``). The same dataset gives the same bytes.
    A dataset built with functions from outside the package is planned again only with ``own_functions``, as that imports
    what its manifest names. Layers of a dataset without pictures are captured again. ``progress`` is called with (pictures
    done, pictures in all, the last one's name).

    Raises ParameterError for an unknown format; DatasetError when there is no such cell or none at all, when the dataset
    is damaged or was built by another version, or when ``output`` cannot be written; CaptureError where visibility by
    item buffer, or what has to be captured again, finds no OpenGL.
    """
    if format not in PICTURE_FORMATS:
        raise ParameterError(f"format: {', '.join(PICTURE_FORMATS)} expected, found {format!r}")
    named = dataset.manifest.parameters.own_functions
    if named and not own_functions:
        raise DatasetError(
            f"{dataset.path / 'manifest.json'}: choices of this package expected, found {', '.join(named)}; plotting imports "
            "them, which runs their code: allow it with --own-functions, or own_functions=True, if you trust the dataset"
        )
    chosen = dict.fromkeys([typical_cell(dataset)] if cells is None else cells)
    entries = [dataset.cell(cell) for cell in chosen]
    total = sum(2 + sum(bool(sector) for sector in entry.layers) for entry in entries) + 1
    histograms = _histograms(dataset)
    output = Path(output)
    try:
        output.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DatasetError(
            f"{output}: a folder for the pictures expected, cannot be made ({error.strerror})"
        ) from error
    written: list[Path] = []

    def write(name: str, figure: Figure) -> None:
        written.append(output / f"{name}.{format}")
        save(figure, written[-1])
        if progress is not None:
            progress(len(written), total, name)

    for name, figure in _cell_pictures(dataset, entries):
        write(name, figure)
    write("histograms", histograms)
    return written


def typical_cell(dataset: Dataset) -> str:
    """The cell in the middle, by number of layers and then of far objects, of those that have any.

    Raises DatasetError when the dataset has no cells.
    """
    sizes = sorted((one.layer_count, len(one.far), one.id) for one in dataset.manifest.cells)
    if not sizes:
        raise DatasetError(f"{dataset.path}: a dataset with cells expected, found none; build some")
    sizes = [one for one in sizes if one[0] > 0] or sizes
    return sizes[len(sizes) // 2][2]


def _cell_pictures(dataset: Dataset, entries: Sequence[CellEntry]) -> Iterator[tuple[str, Figure]]:
    """(name, figure) of every picture of the cells with these entries of the manifest, one after the other."""
    city = dataset.city()
    prepared = prepared_again(dataset, city)
    parameters = prepared.parameters
    with _capturer(prepared) as capturer:
        for entry in entries:
            cell = entry.id
            identify = None if capturer is None else capturer.identify
            plan = planned_again(dataset, prepared, entry, identify=identify)
            yield f"{cell}-map", birds_eye(city, plan)
            yield (
                f"{cell}-graph",
                event_graph_plot(city, plan, camera=parameters.camera, max_error_px=parameters.max_error_px),
            )
            shown: Sequence[Layer]
            if parameters.pictures == "none" and capturer is not None:
                shown = sorted(
                    capture_layers(prepared, plan, capturer), key=lambda one: (one.sector, one.index, one.piece)
                )
            else:
                shown = read_impostor(dataset, cell, city).layers
            street = f", {entry.street}" if entry.street else ""
            for sector in sorted({layer.sector for layer in shown}):
                layers = [layer for layer in shown if layer.sector == sector]
                looking = _COMPASS[round(8.0 * sector / parameters.sectors) % 8]
                number = counted(len({one.index for one in layers}), "layer")
                title = f"cell {cell}{street}: {number} of sector {sector}, looking {looking}"
                yield f"{cell}-sector-{sector}", layer_sheet(layers, title=title)


def _histograms(dataset: Dataset) -> Figure:
    cells, display = dataset.manifest.cells, dataset.manifest.parameters.camera
    promised = [one.promised_error_px for one in cells if one.promised_error_px is not None]
    shown_at = f"at {display.width} x {display.height}"
    return dataset_histograms(
        layers_per_view=[len({layer.index for layer in sector}) for one in cells for sector in one.layers],
        cell_bytes=[one.bytes for one in cells],
        near_objects=[len(one.near) for one in cells],
        visible_objects=[len(one.near) + len(one.far) for one in cells],
        triangles=[one.triangles for one in cells],
        title=f"{Path(dataset.manifest.city.source).name}: {counted(len(cells), 'cell')}, "
        f"{_promise(promised, len(cells), shown_at)}",
    )


def _promise(promised: Sequence[float], cells: int, shown_at: str) -> str:
    """What is promised of the error, in words: ``promised`` are the pixels of those of all ``cells`` that promise any."""
    if not promised:
        return f"no bound on the error {shown_at}"
    bound = f"at most {max(promised):g} px of error {shown_at}"
    return bound if len(promised) == cells else f"{bound}, promised for {len(promised)} of them"


@contextmanager
def _capturer(prepared: PreparedCity) -> Iterator[Capturer | None]:
    """What draws item buffers and captures layers, where it is needed; nothing loads OpenGL where it is not."""
    if prepared.visible is not None and prepared.parameters.pictures == "all":
        yield None
        return
    from mmi.capture.renderer import Capturer

    with Capturer(prepared.mesh) as capturer:
        yield capturer
