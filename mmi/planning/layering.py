"""Objects to layers: the graph of visibility events and its colouring (paper section 4.2, figure 4).

A node is a far object, an edge a pair whose visibility events are too important for one mesh. A layer is a set of
objects without an edge between any two of them; as few layers as possible is graph colouring, which only heuristics
solve in useful time. Several are here: the paper's, which keeps layers compact in the image, and greedy colourings. The
baseline that the paper compares itself with (section 6.1) is here too: all objects in a single layer, whatever happens
between them (Sillion, Drettakis, Bodelet 1997).

How much of the image a layer takes is measured on the panorama around the reference viewpoint: each object has a *box*
(azimuth from, azimuth to, slope from, slope to), where azimuths are radians counter-clockwise from +X, the interval
starts in [-pi, pi) and may run past pi, and slope is height over horizontal distance, relative to the eye.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import networkx as nx
import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray
from shapely.geometry import Point
from shapely.geometry.base import BaseGeometry

from mmi.city.model import CityObject
from mmi.foundation.errors import ParameterError
from mmi.foundation.kernels import kernel
from mmi.planning.choices import LAYERINGS, Choice, blaming, choose, function_of

__all__ = [
    "Layers",
    "assign_layers",
    "boxes_of",
    "event_graph",
    "layer_area",
    "layers_best",
    "layers_dsatur",
    "layers_greedy",
    "layers_incremental",
    "layers_largest_first",
    "layers_single",
    "layers_smallest_last",
    "panorama_boxes",
]

_TRIED = ("incremental", "largest-first", "smallest-last", "dsatur")
"""The colourings that "best" tries; benchmarks/layers.py compares them with an exact colouring."""
_CLOSEST = 1e-3
"""Metres: slopes are measured as if nothing were closer to the eye than this."""

Layers = list[NDArray[np.int64]]


def event_graph(
    nodes: NDArray[np.int64],
    pairs: NDArray[np.int64],
    weights: NDArray[np.float64],
    *,
    threshold: float,
    factors: Mapping[int, float] | None = None,
) -> nx.Graph:
    """The graph of visibility events that one mesh must not swallow (paper section 4.2).

    ``nodes`` (n,) are the objects (any distinct integers), ``pairs`` (m, 2) indices into ``nodes``, ``weights`` (m,) the
    pairs' weights in radians. ``factors`` raise the weights of all pairs of an object (key: as in ``nodes``; a pair of
    two such objects gets both factors). An edge joins each pair that weighs more than ``threshold`` radians then, with
    that as attribute ``weight``. Nodes keep their order, edges are in lexicographic order of it.

    Raises ParameterError for a factor below 1 (it would void the bound) or a negative threshold.
    """
    if not threshold >= 0.0:
        raise ParameterError(f"the error threshold needs to be 0 or more, found {threshold!r}")
    raised = np.ones(len(nodes))
    for node, factor in (factors or {}).items():
        if not (math.isfinite(factor) and factor >= 1.0):
            raise ParameterError(f"a landmark factor needs to be 1 or more, found {factor!r} for object {node}")
        raised[nodes == node] = factor
    importance = weights * raised[pairs].prod(axis=1)
    above = importance > threshold
    ends, importance = np.sort(pairs[above], axis=1), importance[above]
    order = np.lexsort((ends[:, 1], ends[:, 0]))
    graph = nx.Graph()
    graph.add_nodes_from(int(node) for node in nodes)
    for (a, b), weight in zip(ends[order], importance[order], strict=True):
        graph.add_edge(int(nodes[a]), int(nodes[b]), weight=float(weight))
    return graph


def assign_layers(
    graph: nx.Graph, boxes: NDArray[np.float64], *, strategy: str | Choice = "best"
) -> tuple[NDArray[np.int64], ...]:
    """The graph's nodes divided into layers: sorted arrays, the layer with the smallest node first.

    ``boxes`` (n, 4) are the nodes' boxes in the panorama, in the graph's node order. ``strategy`` is a layering of
    :data:`mmi.planning.choices.LAYERINGS` or a function of one's own, which takes graph and boxes and returns arrays of nodes.

    Raises ParameterError for an unknown strategy, and where a function of one's own fails or does not put each node into one
    layer.
    """
    chosen = strategy if isinstance(strategy, Choice) else choose(LAYERINGS, strategy, what="layering")
    with blaming(chosen, what="layering"):
        layers = [np.asarray(layer) for layer in function_of(chosen)(graph, boxes)]
        nodes = np.sort(np.concatenate([np.empty(0, dtype=np.int64), *layers])).tolist()
    if nodes != sorted(graph):
        raise ParameterError(
            f"layering {chosen.name}: each of {len(graph)} objects in one layer expected, found {len(set(nodes))} in "
            f"{len(layers)} layers, {len(nodes)} entries"
        )
    filled = (np.sort(layer.astype(np.int64)) for layer in layers if layer.size)
    return tuple(sorted(filled, key=lambda layer: int(layer[0])))


def layers_best(graph: nx.Graph, boxes: NDArray[np.float64]) -> tuple[NDArray[np.int64], ...]:
    """Of the other colourings, the one with the fewest layers, then the smallest total area of the layers' boxes."""
    candidates = [assign_layers(graph, boxes, strategy=name) for name in _TRIED]
    row = {node: i for i, node in enumerate(graph)}

    def cost(layers: tuple[NDArray[np.int64], ...]) -> tuple[int, float]:
        # Areas that differ by rounding are equal: turning the city must not decide.
        area = sum(layer_area(boxes[[row[int(node)] for node in layer]]) for layer in layers)
        return len(layers), round(area, 9)

    return min(candidates, key=cost)


def layers_single(graph: nx.Graph, boxes: NDArray[np.float64]) -> Layers:  # noqa: ARG001
    """One layer of all nodes, whatever the edges; none where there are no nodes."""
    return [np.array(graph, dtype=np.int64)] if len(graph) else []


def layers_largest_first(graph: nx.Graph, boxes: NDArray[np.float64]) -> Layers:  # noqa: ARG001
    """:func:`layers_greedy` with nodes of most neighbours first."""
    return layers_greedy(graph, "largest-first")


def layers_smallest_last(graph: nx.Graph, boxes: NDArray[np.float64]) -> Layers:  # noqa: ARG001
    """:func:`layers_greedy` after Matula and Beck."""
    return layers_greedy(graph, "smallest-last")


def layers_dsatur(graph: nx.Graph, boxes: NDArray[np.float64]) -> Layers:  # noqa: ARG001
    """:func:`layers_greedy` after Brelaz."""
    return layers_greedy(graph, "dsatur")


def layers_incremental(graph: nx.Graph, boxes: NDArray[np.float64], *, order: Sequence[int] | None = None) -> Layers:
    """The paper's algorithm (section 4.2), one node at a time, in the graph's order or in ``order``.

    A node goes into an existing layer that holds no neighbour of it, the one whose box is smallest with the node in it
    (the older among equals), or else into a new layer. ``boxes`` (n, 4) are in the graph's node order.
    """
    row = {node: i for i, node in enumerate(graph)}
    arcs = _Arcs(*_on_one_turn(boxes[:, :2]))
    by_start, layer_of = np.argsort(arcs.starts), np.full(len(row), -1, dtype=np.int64)
    layers: list[list[int]] = []
    for node in graph if order is None else order:
        at = row[node]
        taken = {int(layer_of[row[other]]) for other in graph[node]}
        areas = _areas_with(at, len(layers), layer_of, by_start, arcs, boxes)
        options = [(round(area, 9), i) for i, area in enumerate(areas.tolist()) if i not in taken]
        if options:
            _, chosen = min(options)
            layers[chosen].append(node)
        else:
            chosen = len(layers)
            layers.append([node])
        layer_of[at] = chosen
    return [np.array(layer, dtype=np.int64) for layer in layers]


def layers_greedy(graph: nx.Graph, strategy: str) -> Layers:
    """Each node in turn gets the first layer that holds no neighbour of it.

    ``largest-first``: nodes of most neighbours first. ``smallest-last`` (Matula, Beck 1983): last the node of fewest
    neighbours, before it the one of fewest among the others, and so on. ``dsatur`` (Brelaz 1979): next the node whose
    neighbours are in most layers, of those one of most neighbours. Ties go by the graph's order. The colourings are
    those of ``networkx.greedy_color``, smallest-last but for ties, in a fraction of the time.
    """
    nodes = np.array(graph, dtype=np.int64)
    joined = nx.to_numpy_array(graph, weight=None, dtype=np.bool_)
    degrees = joined.sum(axis=1)
    if strategy == "dsatur":
        colors = _saturated(joined, degrees)
    elif strategy == "largest-first":
        colors = _first_free(joined, np.argsort(-degrees, kind="stable"))
    else:
        colors = _first_free(joined, _smallest_last(joined, degrees))
    return [nodes[colors == color] for color in range(colors.max(initial=-1) + 1)]


@kernel()
def _first_free(joined: NDArray[np.bool_], order: NDArray[np.int64]) -> NDArray[np.int64]:
    """(n,) colours, given in ``order`` (n,)."""
    colors = np.full(len(order), -1, dtype=np.int64)
    taken = np.full(len(order) + 1, -1, dtype=np.int64)  # by the colour: for whom
    for node in order:
        for other in range(len(order)):
            if joined[node, other] and colors[other] >= 0:
                taken[colors[other]] = node
        color = 0
        while taken[color] == node:
            color += 1
        colors[node] = color
    return colors


@kernel()
def _smallest_last(joined: NDArray[np.bool_], degrees: NDArray[np.int64]) -> NDArray[np.int64]:
    """(n,) the order in which to colour."""
    n = len(degrees)
    left, order = degrees.copy(), np.empty(n, dtype=np.int64)
    for place in range(n - 1, -1, -1):
        smallest = np.argmin(left)
        order[place] = smallest
        left[smallest] = n  # more than any
        for other in range(n):
            if joined[smallest, other] and left[other] < n:
                left[other] -= 1
    return order


@kernel()
def _saturated(joined: NDArray[np.bool_], degrees: NDArray[np.int64]) -> NDArray[np.int64]:
    """(n,) colours."""
    n = len(degrees)
    colors, seen = np.full(n, -1, dtype=np.int64), np.zeros((n, n + 1), dtype=np.bool_)
    saturation = np.zeros(n, dtype=np.int64)
    for _ in range(n):
        node = -1
        for i in range(n):
            if colors[i] < 0 and (
                node < 0
                or saturation[i] > saturation[node]
                or (saturation[i] == saturation[node] and degrees[i] > degrees[node])
            ):
                node = i
        color = 0
        while seen[node, color]:
            color += 1
        colors[node] = color
        for other in range(n):
            if joined[node, other] and not seen[other, color]:
                seen[other, color] = True
                saturation[other] += 1
    return colors


# Boxes in the panorama -------------------------------------------------------------------------------------------------


def layer_area(boxes: NDArray[np.float64]) -> float:
    """Area (radians x slope) of the smallest box around ``boxes`` (n, 4), n > 0."""
    return float(_cover(boxes[:, :2])[1] * (boxes[:, 3].max() - boxes[:, 2].min()))


def panorama_boxes(
    eye: ArrayLike, footprints: Sequence[BaseGeometry], bottoms: ArrayLike, tops: ArrayLike
) -> NDArray[np.float64]:
    """(n, 4) each object's box as seen from ``eye`` (3,): what the extruded ``footprints`` (metres) cannot reach out of.

    ``bottoms`` and ``tops`` (n,) are heights in metres. An object that surrounds the eye gets all azimuths.
    """
    x, y, z = (float(value) for value in np.asarray(eye, dtype=np.float64))
    boxes = np.empty((len(footprints), 4))
    if not len(footprints):
        return boxes
    parts, owner = shapely.get_parts(list(footprints), return_index=True)
    rings = shapely.get_exterior_ring(parts)
    offsets = shapely.get_coordinates(rings) - (x, y)
    arcs = _ring_arcs(offsets, np.cumsum(shapely.get_num_coordinates(rings)))
    starts = np.searchsorted(owner, np.arange(len(footprints) + 1))
    for i in range(len(footprints)):
        start, width = _cover(arcs[starts[i] : starts[i + 1]])
        boxes[i, :2] = start, start + width
    coordinates, of = shapely.get_coordinates(list(footprints), return_index=True)
    farthest = np.zeros(len(footprints))
    np.maximum.at(farthest, of, np.hypot(coordinates[:, 0] - x, coordinates[:, 1] - y))
    nearest = shapely.distance(list(footprints), Point(x, y))
    down, up = np.asarray(bottoms) - z, np.asarray(tops) - z
    boxes[:, 2] = down / np.maximum(np.where(down < 0.0, nearest, farthest), _CLOSEST)
    boxes[:, 3] = up / np.maximum(np.where(up > 0.0, nearest, farthest), _CLOSEST)
    return boxes


def boxes_of(eye: ArrayLike, objects: Sequence[CityObject]) -> NDArray[np.float64]:
    """(n, 4) the boxes of some objects of a city (:func:`panorama_boxes`)."""
    bottoms, tops = [one.base for one in objects], [one.top for one in objects]
    return panorama_boxes(eye, [one.footprint for one in objects], bottoms, tops)


@kernel(error_model="numpy")
def _ring_arcs(offsets: NDArray[np.float64], ring_ends: NDArray[np.int64]) -> NDArray[np.float64]:
    """(r, 2) the azimuths that each ring covers, walked around it; ``offsets`` are coordinates relative to the eye."""
    arcs = np.empty((len(ring_ends), 2))
    begin = 0
    for ring in range(len(ring_ends)):
        x, y = offsets[begin]
        azimuth = math.atan2(y, x)
        least, most = azimuth, azimuth
        for k in range(begin + 1, ring_ends[ring]):
            x1, y1 = offsets[k]
            azimuth += math.atan2(x * y1 - y * x1, x * x1 + y * y1)
            least, most = min(least, azimuth), max(most, azimuth)
            x, y = x1, y1
        arcs[ring] = least, most
        begin = ring_ends[ring]
    return arcs


@kernel(error_model="numpy")
def _on_one_turn(arcs: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The starts (n,) of ``arcs`` (n, 2) moved into [-pi, pi), and the ends (n,) as far behind them as before."""
    turn = 2.0 * math.pi
    starts = arcs[:, 0] - turn * np.floor((arcs[:, 0] + math.pi) / turn)
    return starts, starts + (arcs[:, 1] - arcs[:, 0])


@kernel(error_model="numpy")
def _cover(arcs: NDArray[np.float64]) -> tuple[float, float]:
    """The shortest arc that covers ``arcs`` (n, 2): its start in [-pi, pi) and its width, at most 2 pi."""
    turn = 2.0 * math.pi
    starts, ends = _on_one_turn(arcs)
    reach = ends.max() - turn
    widest, start = 0.0, -math.pi
    for i in np.argsort(starts):
        if starts[i] - reach > widest:
            widest, start = starts[i] - reach, starts[i]
        reach = max(reach, ends[i])
    return start, turn - widest


class _Arcs(NamedTuple):
    """Arcs of azimuth: ``starts`` (n,) in [-pi, pi) and ``ends`` (n,), radians."""

    starts: NDArray[np.float64]
    ends: NDArray[np.float64]


@kernel(error_model="numpy")
def _areas_with(
    node: int,
    count: int,
    layer_of: NDArray[np.int64],
    by_start: NDArray[np.int64],
    arcs: _Arcs,
    boxes: NDArray[np.float64],
) -> NDArray[np.float64]:
    """(count,) the area of each layer's box (:func:`layer_area`) with ``node`` in it, all in one walk around the panorama.

    ``layer_of`` (n,): the layers of nodes, -1 for none; ``by_start`` (n,): nodes in the order of where their arcs start.
    """
    turn = 2.0 * math.pi
    reach, widest = np.full(count, arcs.ends[node] - turn), np.zeros(count)
    low, high = np.full(count, boxes[node, 2]), np.full(count, boxes[node, 3])
    for i in range(len(layer_of)):
        layer = layer_of[i]
        if layer >= 0:
            reach[layer] = max(reach[layer], arcs.ends[i] - turn)
            low[layer], high[layer] = min(low[layer], boxes[i, 2]), max(high[layer], boxes[i, 3])
    for i in by_start:
        if i != node and layer_of[i] < 0:
            continue
        for layer in range(count) if i == node else range(layer_of[i], layer_of[i] + 1):
            widest[layer] = max(widest[layer], arcs.starts[i] - reach[layer])
            reach[layer] = max(reach[layer], arcs.ends[i])
    return (turn - widest) * (high - low)
