"""Techniques by name: the datasets that they need, and the cache that their cells come from.

full, visible, local      geometry only                                     (viewer.geometry)
multi-mesh                the dataset that is compared                      (viewer.layered)
single-mesh               the same city and parameters, one layer a view; built where it is not there yet
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

from mmi.dataset import Dataset, open_dataset
from mmi.errors import ParameterError
from mmi.farm import build_dataset
from viewer.atlas import BORDER, shelves
from viewer.geometry import CellGeometry, FullGeometry
from viewer.layered import LayeredImpostors
from viewer.loaded import LoadedCell, load_cell
from viewer.scene import Scene, open_scene
from viewer.streaming import CellCache, LayerStore
from viewer.technique import CellKey, Technique

__all__ = ["LAYERED", "TECHNIQUES", "cell_cache", "make_technique", "single_mesh_scene"]

LAYERED = ("single-mesh", "multi-mesh")
TECHNIQUES = ("full", "visible", "local", *LAYERED)

_TEXEL_BYTES = 4 + 4  # colour with coverage, depth
_ID_BYTES = 4
_TRIANGLE_BYTES = 12 + 36  # three indices; a vertex and a half, which small pieces of grids come to


def single_mesh_scene(
    scene: Scene,
    folder: Path,
    cells: Sequence[str],
    *,
    workers: int = 1,
    progress: Callable[[int, int, str], None] | None = None,
) -> Scene:
    """The baseline of the paper: ``cells`` of ``scene`` built again in ``folder`` with one layer a view, or found there.

    Raises DatasetError where ``folder`` holds something else, CaptureError where OpenGL fails.
    """
    parameters = replace(scene.parameters, layering="single")
    city = scene.dataset.city()
    build_dataset(city, folder, parameters, cells=sorted(set(cells)), workers=workers, progress=progress)
    return open_scene(open_dataset(folder), name="single-mesh", like=scene)


def make_technique(name: str, scenes: Mapping[str, Scene], *, fade: float = 0.0) -> Technique:
    """A fresh technique, which knows of no viewer yet. ``scenes``: ``multi-mesh``, and ``single-mesh`` where that is asked for.

    Raises ParameterError for an unknown name.
    """
    main = scenes["multi-mesh"]
    match name:
        case "full":
            return FullGeometry(main)
        case "visible" | "local":
            return CellGeometry(main, name)
        case "single-mesh" | "multi-mesh":
            return LayeredImpostors(scenes[name], fade=fade)
    raise ParameterError(f"technique {name!r}: one of {', '.join(TECHNIQUES)} expected")


def cell_cache(
    scenes: Mapping[str, Scene], store: LayerStore, *, measured: bool = False, capacity: int = 512 << 20
) -> CellCache:
    """A cache of at most ``capacity`` bytes for the cells of all ``scenes``; ``measured``: with what measuring needs."""

    def load(key: CellKey, rest: Callable[[], None]) -> LoadedCell:
        return load_cell(scenes[key.dataset], key.cell, measured=measured, rest=rest)

    @cache
    def size(key: CellKey) -> int:
        return _foretold(scenes[key.dataset].dataset, key.cell, measured)

    return CellCache(load, size, store, capacity=capacity)


def _foretold(dataset: Dataset, cell: str, measured: bool) -> int:
    """Bytes that a cell takes in memory, rather more than less, from its manifest entry."""
    entry = dataset.cell(cell)
    sizes = [
        (one["window"][2] + 2 * BORDER, one["window"][3] + 2 * BORDER) for sector in entry["layers"] for one in sector
    ]
    width, height = shelves(sizes)[1]
    texel = _TEXEL_BYTES + (_ID_BYTES if measured else 0)
    return texel * width * height + _TRIANGLE_BYTES * int(entry["triangles"])
