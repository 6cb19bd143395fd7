"""Some of a city's viewing cells: spread over it, around a place, or along a path. Who is in which cell, ``whereabouts`` says.

Cells are chosen on the map alone; what can be seen from them makes no difference.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import networkx as nx
import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from mmi.cells.whereabouts import HYSTERESIS, Whereabouts
from mmi.foundation.errors import ParameterError

__all__ = ["Surroundings", "along", "around", "spread"]


@dataclass(frozen=True, slots=True)
class Surroundings:
    """The cells around a place: the ``names`` of those that can be walked to, in the graph's order.

    ``start`` is the one nearest to the place. ``apart`` cells are as near as these, and cannot be walked to through such cells.
    """

    start: str
    names: tuple[str, ...]
    apart: int


def around(graph: nx.Graph, place: BaseGeometry, radius: float) -> Surroundings:
    """The cells of ``graph`` whose rectangles come within ``radius`` metres of ``place`` and that are connected there.

    The start is the cell nearest to ``place``; of several that reach it, the one whose axis is nearest; of equals the first.
    From there the others are reached from neighbour to neighbour, through cells within ``radius`` alone. ``graph`` is as
    :func:`~mmi.cells.viewing_cells.viewing_cells` returns it, ``place`` a shape in the city's frame.

    Raises ParameterError for a radius that is no positive number, and where no cell is within it.
    """
    if not (math.isfinite(radius) and radius > 0.0):
        raise ParameterError(f"a radius of more than 0 m expected, found {radius!r}")
    names = list(graph)
    away = shapely.distance(_regions(graph), place)
    if not len(away) or away.min() > radius:
        nearest = f", the nearest is {away.min():.0f} m away" if len(away) else ""
        raise ParameterError(f"a street within {radius:g} m expected, found none{nearest}")
    reach = np.flatnonzero(away <= away.min() + 1e-9)
    cells = [graph.nodes[names[i]]["cell"] for i in reach.tolist()]
    axes = shapely.linestrings([[cell.p, cell.q] for cell in cells])
    start = names[int(reach[np.argmin(np.round(shapely.distance(axes, place), 9))])]
    close = [name for name, metres in zip(names, away.tolist(), strict=True) if metres <= radius]
    connected = nx.node_connected_component(graph.subgraph(close), start)
    return Surroundings(start, tuple(name for name in close if name in connected), len(close) - len(connected))


def along(graph: nx.Graph, path: NDArray[np.float64]) -> tuple[str, ...]:
    """The cells of ``graph`` that a viewer may be in who passes the points ``path`` (n, 2), in the graph's order.

    These are the cells that :meth:`~mmi.cells.whereabouts.Whereabouts.cell_at` names at some point of it. A viewer's own cell
    lags behind, by ``HYSTERESIS``, but each cell that it enters is named at the point where it enters it. So it is the same
    in these cells as in all, however many points it passes over in each of its frames, and wherever it starts.

    Raises ParameterError where no point is in a cell, or within ``HYSTERESIS`` of one.
    """
    regions = _regions(graph)
    if not len(regions) or not len(path):
        raise ParameterError(f"cells and points expected, found {len(regions)} and {len(path)}")
    points = shapely.points(path)
    tree = shapely.STRtree(regions)
    _, away = tree.query_nearest(points, all_matches=False, return_distance=True)
    if away.min() > HYSTERESIS:
        raise ParameterError(
            f"a path along the streets expected, found one that stays {away.min():.0f} m away from them"
        )
    # Only cells that are as near to the path as any point's nearest are asked at each point.
    near = np.unique(tree.query(shapely.multipoints(points), predicate="dwithin", distance=away.max() + 1e-6))
    names = list(graph)
    whereabouts = Whereabouts(tuple(graph.nodes[names[i]]["cell"] for i in near.tolist()), {})
    found = {whereabouts.cell_at(point, current=None) for point in path}
    return tuple(name for name in names if name in found)


def spread(graph: nx.Graph, n: int) -> list[str]:
    """``n`` cells of ``graph`` spread over the city, or all if there are fewer: ids in the order of choice.

    Cells are lined up along a Z-order curve through their middles (Morton 1966) and taken in van der Corput's order
    (1935): any number of them is even over the city, dense where its streets are, and the first k of ``spread(graph, n)``
    are ``spread(graph, k)``. Raises ParameterError unless n is positive.
    """
    if n < 1:
        raise ParameterError(f"at least one cell expected, found {n}")
    names = list(graph)
    if not names:
        return []
    middles = np.array([graph.nodes[name]["cell"].reference[:2] for name in names])
    extent = max(float(np.ptp(middles, axis=0).max()), 1e-9)
    steps = np.minimum(((middles - middles.min(axis=0)) / extent * 1024).astype(np.int64), 1023)
    curve = sum((steps[:, axis] >> bit & 1) << (2 * bit + axis) for axis in (0, 1) for bit in range(10))
    line = np.argsort(curve, kind="stable")
    bits = max(len(names) - 1, 1).bit_length()
    reversed_bits = (int(f"{i:0{bits}b}"[::-1], 2) for i in range(1 << bits))
    return [names[line[place]] for place in reversed_bits if place < len(names)][:n]


def _regions(graph: nx.Graph) -> NDArray[np.object_]:
    """(n,) the cells' rectangles."""
    corners = [cell.corners for _, cell in graph.nodes(data="cell")]
    return np.asarray(shapely.polygons(np.array(corners).reshape(-1, 4, 2)), dtype=object)
