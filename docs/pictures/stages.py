"""Pictures of the first two stages, which ``inspect-layers`` does not plot: viewing cells, and what one of them can see.

python docs/pictures/stages.py examples/helsinki/helsinki.osm.pbf cells.png visibility.png
"""

import sys
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from shapely.geometry.base import BaseGeometry

from mmi import City, ViewingCell, read_city, viewing_cells
from mmi.visibility.horizon import horizon_extractor, prepare_horizon
from mmi.visibility.selection import everything

HIDDEN, VISIBLE, EDGE = "#e3e3e3", "#56b4e9", "#9a9a9a"
CELLS = ("#e69f00", "#0072b2", "#009e73", "#cc79a7")


def outlines(shapes: list[BaseGeometry]) -> list[np.ndarray]:
    """The outer rings of some footprints."""
    return [
        np.array(part.exterior.coords)
        for shape in shapes
        for part in getattr(shape, "geoms", [shape])
        if part.area > 0.0
    ]


def draw(axes: Axes, shapes: list[BaseGeometry], color: str, edge: str = EDGE) -> None:
    axes.add_collection(PolyCollection(outlines(shapes), facecolors=color, edgecolors=edge, linewidths=0.5))


def map_around(axes: Axes, cell: ViewingCell, reach: float, *, west: float = 0.0) -> None:
    x, y, _ = cell.reference
    x -= west
    axes.set(xlim=(x - reach, x + reach), ylim=(y - 0.7 * reach, y + 0.7 * reach), aspect="equal", xticks=[], yticks=[])


def picture_of_cells(city: City, cells: list[ViewingCell], middle: ViewingCell, path: Path) -> None:
    """Every cell of a neighbourhood, with the viewpoint that its layers are captured from."""
    figure, axes = plt.subplots(figsize=(9, 6.3), layout="constrained")
    draw(axes, [one.footprint for one in city.objects], HIDDEN)
    for k, cell in enumerate(cells):
        axes.fill(*cell.corners.T, color=CELLS[k % len(CELLS)], alpha=0.75, linewidth=0)
        axes.plot(*cell.reference[:2], "k.", ms=2.5)
    map_around(axes, middle, 200.0)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def picture_of_visibility(city: City, cell: ViewingCell, path: Path) -> int:
    """What can be seen from anywhere in a cell, and what is hidden from all of it; returns how many objects can be seen."""
    seen = set(horizon_extractor(prepare_horizon(city))(everything(city, cell)).objects.tolist())
    figure, axes = plt.subplots(figsize=(9, 6.3), layout="constrained")
    draw(axes, [one.footprint for k, one in enumerate(city.objects) if k not in seen], HIDDEN)
    draw(axes, [one.footprint for k, one in enumerate(city.objects) if k in seen], VISIBLE, "#33627d")
    axes.fill(*cell.corners.T, color="#d55e00", linewidth=0)
    axes.annotate(
        f"cell {cell.id}, {cell.street}",
        cell.reference[:2],
        (16, 6),
        textcoords="offset points",
        color="#a04000",
        backgroundcolor="white",
    )
    map_around(axes, cell, 460.0, west=150.0)
    figure.savefig(path, dpi=110)
    plt.close(figure)
    return len(seen)


def main(source: Path, cells_picture: Path, visibility_picture: Path, *, name: str = "0355-00") -> None:
    city, _ = read_city(source)
    graph = viewing_cells(city)
    cells = [graph.nodes[one]["cell"] for one in sorted(graph)]
    chosen = next((cell for cell in cells if cell.id == name), cells[0])
    picture_of_cells(city, cells, chosen, cells_picture)
    seen = picture_of_visibility(city, chosen, visibility_picture)
    print(f"{len(cells)} cells; from {chosen.id} in {chosen.street}, {seen} of {len(city.objects)} objects can be seen")


if __name__ == "__main__":
    main(*(Path(argument) for argument in sys.argv[1:4]))
