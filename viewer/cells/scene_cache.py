"""The cache of cells for some scenes, and how many bytes a cell takes in it, told from its manifest entry."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from math import ceil

from mmi.dataset.reading import Dataset
from viewer.cells.cell_cache import CellCache, LayerStore
from viewer.cells.layer_atlas import BORDER, shelves
from viewer.cells.loaded_cell import LoadedCell, cell_bytes, load_cell
from viewer.plan import CellKey
from viewer.scene.scene import WalkScene

__all__ = ["cell_cache", "foretold_bytes"]

_VERTICES_PER_TRIANGLE = 1.5  # what small pieces of grids come to


def cell_cache(
    scenes: Mapping[str, WalkScene], store: LayerStore, *, measured: bool = False, capacity: int = 512 << 20
) -> CellCache:
    """A cache of at most ``capacity`` bytes for the cells of all ``scenes``; ``measured``: with what measuring needs."""

    def load(key: CellKey, rest: Callable[[], None]) -> LoadedCell:
        return load_cell(scenes[key.dataset], key.cell, measured=measured, rest=rest)

    @cache
    def size(key: CellKey) -> int:
        return foretold_bytes(scenes[key.dataset].dataset, key.cell, measured=measured)

    return CellCache(load, size, store, capacity=capacity)


def foretold_bytes(dataset: Dataset, cell: str, *, measured: bool) -> int:
    """Bytes that a cell takes in memory, rather more than less, from its manifest entry: before its files are read."""
    entry = dataset.cell(cell)
    sizes = [(one.window[2] + 2 * BORDER, one.window[3] + 2 * BORDER) for _, one in entry.pictures]
    vertices = ceil(_VERTICES_PER_TRIANGLE * entry.triangles)
    captured = dataset.manifest.parameters.pictures == "none"
    return cell_bytes(
        shelves(sizes)[1], vertices=vertices, triangles=entry.triangles, measured=measured, captured=captured
    )
