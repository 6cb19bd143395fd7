"""A weight in a script of one's own: layers by distance, without a change to the package.

Run ``python examples/a_weight_of_ones_own.py city.osm.pbf out/by-distance``, or give the function to the program:
``PYTHONPATH=examples build-impostors city.osm.pbf -o out/by-distance --weights a_weight_of_ones_own:apart``. A weight function
is told which objects of a cell are far, and says which pairs of them must not share a layer: those that weigh more than the
threshold. It has to be importable, so that worker processes find it. The manifest records its name and its version (the
module's ``__version__``), and nothing is promised of the dataset.
"""

import math
import sys
from pathlib import Path

import numpy as np
import shapely
from numpy.typing import NDArray

from mmi import BuildParameters, BuildSummary, build_dataset, read_city
from mmi.planning.weighing import FarField

__version__ = "1"

STEP = math.log(2.0)
"""Objects share a layer where one is at most twice as far away as the other."""


def apart(far: FarField) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Pairs of all objects; those weigh a right angle of which one is more than twice as far away as the other."""
    here = shapely.Point(far.cell.reference[:2])
    distances = shapely.distance([far.city.objects[i].footprint for i in far.objects], here)
    one, other = np.triu_indices(len(far.objects), 1)
    ratios = np.abs(np.log(distances[one]) - np.log(distances[other]))
    return np.column_stack([one, other]), np.where(ratios > STEP, 0.5 * math.pi, 0.0)


def main(source: Path, out: Path, *, max_cells: int | None = None, workers: int = 1) -> BuildSummary:
    city, _ = read_city(source)
    summary = build_dataset(city, out, BuildParameters(weights=apart), max_cells=max_cells, workers=workers)
    print(f"{summary.cells} cells with weights of one's own in {out}")
    return summary


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), max_cells=4)
