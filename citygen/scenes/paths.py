"""Paths on foot through small scenes, as street graphs."""

from __future__ import annotations

from collections.abc import Sequence

import networkx as nx
import numpy as np
from numpy.typing import ArrayLike
from shapely.geometry import LineString

__all__ = ["footways"]


def footways(
    nodes: Sequence[tuple[float, float]], ways: Sequence[tuple[int, int, ArrayLike]], *, half_width: float
) -> nx.MultiGraph:
    """A street graph of footways: ``nodes`` (x, y), ``ways`` (node, node, points between them (k, 2)), metres."""
    graph = nx.MultiGraph()
    for i, (x, y) in enumerate(nodes):
        graph.add_node(i, x=float(x), y=float(y))
    for index, (a, b, between) in enumerate(ways):
        low, high = min(a, b), max(a, b)
        inner = np.asarray(between, dtype=np.float64).reshape(-1, 2)[:: 1 if a < b else -1]
        line = LineString([nodes[low], *inner.tolist(), nodes[high]])
        graph.add_edge(low, high, geometry=line, kind="footway", half_width=half_width, name="", index=index)
    return graph
