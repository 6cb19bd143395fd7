"""Plots in a script of one's own: a cell's map as it comes, and a figure around the project's values, for a paper.

Run ``python examples/plots_of_ones_own.py out/helsinki map.svg layers.pdf``. Plots are functions that return matplotlib
figures; ``save`` writes one as PNG, SVG or PDF, the same bytes each time.
"""

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from mmi import Layer, open_dataset, plan_cell, prepare_city, read_impostor, typical_cell
from mmi.inspection.figures import layer_style, new_figure, save
from mmi.inspection.maps import birds_eye


def depths_of_layers(layers: Sequence[Layer]) -> Figure:
    """How deep each layer of a cell reaches: a bar from its nearest to its farthest texel."""
    figure = new_figure(5.0, 2.5)
    axes = figure.add_subplot()
    for index in sorted({layer.index for layer in layers}):
        depth = np.concatenate([one.texture.depth[one.texture.coverage] for one in layers if one.index == index])
        color, hatch = layer_style(index)
        axes.barh(f"layer {index}", depth.max() - depth.min(), left=depth.min(), color=color, hatch=hatch)
    axes.set(xscale="log", xlabel="depth along the line of sight (m)")
    return figure


def main(folder: Path, map_file: Path, depths_file: Path) -> tuple[Figure, Figure]:
    dataset = open_dataset(folder)
    city = dataset.city()
    impostor = read_impostor(dataset, typical_cell(dataset), city)
    # A dataset holds no graph of visibility events: the cell is planned again.
    prepared = prepare_city(city, dataset.manifest.parameters)
    birds = birds_eye(city, plan_cell(prepared, impostor.cell), reach=250.0)
    birds.axes[0].plot(*impostor.cell.reference[:2], "r+", markersize=14)  # a figure is yours to draw on
    depths = depths_of_layers(impostor.layers)
    save(birds, map_file)
    save(depths, depths_file)
    return birds, depths


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
