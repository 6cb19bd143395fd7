"""Street networks as plain arrays: the value that every network becomes, its street graph, and the two kinds laid out as grids.

Networks that grow by cutting (radial and hill towns) are made in ``citygen.streets.subdivision``. All are planar: streets
meet only at junctions.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import networkx as nx
import numpy as np
import shapely
from numpy.typing import NDArray

from mmi.foundation.errors import CityError

__all__ = ["Network", "faces", "lattice_network", "manhattan_network", "street_graph"]

_TURN = np.deg2rad(29.0)
"""Manhattan's avenues point this far east of north."""


@dataclass(frozen=True, slots=True, eq=False)
class Network:
    """``m`` streets between ``n`` junctions: a planar graph with curved edges.

    ``nodes`` (n, 2) metres; ``ends`` (m, 2) places in ``nodes``; ``lines`` (m,) LineStrings from the first end to the second;
    ``kinds`` (m,) OpenStreetMap highway values; ``half_widths`` (m,) metres of carriageway; ``names`` (m,).
    """

    nodes: NDArray[np.float64]
    ends: NDArray[np.int64]
    lines: NDArray[np.object_]
    kinds: NDArray[np.str_]
    half_widths: NDArray[np.float64]
    names: NDArray[np.str_]

    def __post_init__(self) -> None:
        m = len(self.lines)
        shapes = [self.ends.shape, self.kinds.shape, self.half_widths.shape, self.names.shape]
        if shapes != [(m, 2), (m,), (m,), (m,)] or self.nodes.shape[1:] != (2,):
            raise CityError(
                f"a network of {m} streets needs ends (m, 2), kinds, half widths, names (m,), found {shapes}"
            )
        if m and not (self.half_widths > 0.0).all():
            raise CityError(f"streets need positive half widths, found {self.half_widths.min()}")
        for array in (self.nodes, self.ends, self.lines, self.kinds, self.half_widths, self.names):
            array.setflags(write=False)


def street_graph(network: Network) -> nx.MultiGraph:
    """The graph that ``mmi.city.model.City.streets`` is."""
    graph = nx.MultiGraph()
    graph.add_nodes_from((i, {"x": x, "y": y}) for i, (x, y) in enumerate(network.nodes.tolist()))
    turned = network.ends[:, 0] > network.ends[:, 1]
    lines = np.where(turned, shapely.reverse(network.lines), network.lines)
    graph.add_edges_from(
        (a, b, {"geometry": line, "kind": kind, "half_width": width, "name": name, "index": index})
        for index, ((a, b), line, kind, width, name) in enumerate(
            zip(
                np.sort(network.ends, axis=1).tolist(),
                lines,
                network.kinds.tolist(),
                network.half_widths.tolist(),
                network.names.tolist(),
                strict=True,
            )
        )
    )
    return graph


def faces(network: Network) -> NDArray[np.object_]:
    """(f,) Polygons: what the streets enclose, sorted from south to north, then west to east."""
    found = shapely.get_parts(shapely.polygonize(network.lines))
    x, y = shapely.get_coordinates(shapely.centroid(found)).T if len(found) else np.zeros((2, 0))
    return np.asarray(found[np.lexsort((x, y))])


# ------------------------------------------------------------------------------------------------------------ Manhattan


def manhattan_network(rng: np.random.Generator, *, avenues: int = 6, streets: int = 25) -> Network:
    """A grid of blocks of some 80 x 270 m, a diagonal that meets an avenue every few streets, and some missing links."""
    # Columns lie 270 m and half an avenue on either side apart, rows 80 m less a street.
    avenue_widths = rng.choice([9.0, 12.0], avenues)
    wide = np.zeros(streets, dtype=bool)
    wide[rng.integers(3, 6) :: 8] = True
    street_widths = np.where(wide, 9.0, 5.0)
    x = _spread(270.0 * rng.uniform(0.94, 1.06, avenues - 1), avenue_widths, pavement=5.0)
    y = _spread(62.0 * rng.uniform(0.97, 1.03, streets - 1), street_widths, pavement=4.0)
    number = np.arange(avenues * streets).reshape(streets, avenues)
    nodes = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2).tolist()

    diagonal = _diagonal(rng, x, streets)
    keep = _links(rng, streets, avenues) | wide[:, None]
    ends: list[tuple[int, int]] = []
    kinds: list[str] = []
    widths: list[float] = []
    names: list[str] = []

    def add(a: int, b: int, kind: str, width: float, name: str) -> None:
        ends.append((a, b))
        kinds.append(kind)
        widths.append(width)
        names.append(name)

    broadway: list[int] = []
    for j in range(streets):
        kind = "secondary" if wide[j] else "residential"
        name = f"{'East' if j % 2 else 'West'} {_ordinal(j + 14)} Street"
        at = diagonal[j]
        column = int(np.searchsorted(x, at, side="right")) - 1
        on_node = bool(np.isclose(x, at).any())
        if on_node:
            broadway.append(int(number[j, int(np.argmin(np.abs(x - at)))]))
        elif 0 <= column < avenues - 1:
            broadway.append(len(nodes))
            nodes.append([at, y[j]])
        for i in range(avenues - 1):
            a, b = int(number[j, i]), int(number[j, i + 1])
            if not on_node and i == column:
                add(a, broadway[-1], kind, street_widths[j], name)
                add(broadway[-1], b, kind, street_widths[j], name)
            elif keep[j, i]:
                add(a, b, kind, street_widths[j], name)
    for i in range(avenues):
        for j in range(streets - 1):
            add(int(number[j, i]), int(number[j + 1, i]), "primary", avenue_widths[i], f"{_ordinal(i + 5)} Avenue")
    for a, b in pairwise(broadway):
        add(a, b, "primary", 8.0, "Broadway")
    middle = np.array([x.mean(), y.mean()])
    cos, sin = np.cos(-_TURN), np.sin(-_TURN)
    turned = (np.array(nodes) - middle) @ np.array([[cos, sin], [-sin, cos]])
    return _straight(turned, np.array(ends), np.array(kinds), np.array(widths), np.array(names))


def _spread(gaps: NDArray[np.float64], half_widths: NDArray[np.float64], *, pavement: float) -> NDArray[np.float64]:
    """Where the axes lie when blocks ``gaps`` wide are between them."""
    steps = gaps + half_widths[:-1] + half_widths[1:] + 2.0 * pavement
    return np.concatenate([[0.0], np.cumsum(steps)])


def _diagonal(rng: np.random.Generator, x: NDArray[np.float64], streets: int) -> NDArray[np.float64]:
    """(streets,) where the diagonal crosses each street: it passes an avenue only where a street does, too."""
    step = rng.uniform(34.0, 42.0)
    at = x[-1] - 0.25 * (x[-1] - x[-2]) - step * np.arange(streets)
    for avenue in x:
        nearest = int(np.argmin(np.abs(at - avenue)))
        if abs(at[nearest] - avenue) <= step:
            at[nearest] = avenue
    # What is left of the first avenue is not drawn; the end of the diagonal lies on it or on the last street.
    return np.where(at < x[0] - 1e-9, -np.inf, at)


def _links(rng: np.random.Generator, streets: int, avenues: int) -> NDArray[np.bool_]:
    """(streets, avenues - 1): which links of streets between avenues exist. Some superblocks, and a park."""
    keep = np.ones((streets, avenues - 1), dtype=bool)
    low = int(rng.integers(streets // 2, streets - 9))
    column = int(rng.integers(2, avenues - 1)) if avenues > 3 else 0
    keep[low + 1 : low + 5, column] = False  # the park: five blocks in one
    loose = rng.random(keep.shape) < 0.04
    loose[[0, -1]] = False
    loose[1:] &= ~loose[:-1]
    keep &= ~loose
    return keep


def _ordinal(n: int) -> str:
    return f"{n}{'th' if 10 <= n % 100 <= 20 else {1: 'st', 2: 'nd', 3: 'rd'}.get(n % 10, 'th')}"


# ----------------------------------------------------------------------------------------------------------- metropolis


def lattice_network(
    rng: np.random.Generator, *, columns: int, rows: int, spacing: tuple[float, float] = (118.0, 84.0)
) -> Network:
    """A bent grid of ``columns`` x ``rows`` blocks with boulevards every few streets; one street in eleven is missing.

    ``spacing`` is the mean distance of streets, metres. Made of whole arrays: a hundred thousand blocks take seconds.
    """
    x = np.concatenate([[0.0], np.cumsum(spacing[0] * rng.uniform(0.8, 1.25, columns))])
    y = np.concatenate([[0.0], np.cumsum(spacing[1] * rng.uniform(0.85, 1.2, rows))])
    nodes = _bend(rng, np.stack(np.meshgrid(x - x[-1] / 2.0, y - y[-1] / 2.0), axis=-1))
    number = np.arange((rows + 1) * (columns + 1)).reshape(rows + 1, columns + 1)
    across = np.stack([number[:, :-1], number[:, 1:]], axis=-1)
    upward = np.stack([number[:-1], number[1:]], axis=-1)

    # The street between blocks (j - 1, i) and (j, i) may be missing where no other of the four blocks around misses one.
    j, i = np.indices((rows + 1, columns))
    missing = ((i + 2 * j) % 5 == 0) & (rng.random(i.shape) < 0.45) & (j > 0) & (j < rows) & (j % 6 != 0)
    ends = np.concatenate([across[~missing], upward.reshape(-1, 2)])
    line = np.concatenate([j[~missing], np.broadcast_to(np.arange(columns + 1), upward.shape[:2]).reshape(-1)])
    is_across = np.arange(len(ends)) < (~missing).sum()
    grand, main = line % 12 == 0, line % 6 == 0
    kinds = np.select([grand, main], ["primary", "secondary"], "residential")
    widths = np.select([grand, main], [10.0, 6.5], 4.0)
    names = np.where(
        is_across,
        np.char.add(np.where(main, "Boulevard ", "Street "), line.astype(str)),
        np.char.add("Avenue ", line.astype(str)),
    )
    return _straight(nodes.reshape(-1, 2), ends, kinds, widths, names)


def _bend(rng: np.random.Generator, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points (..., 2) moved by long waves: nothing is folded, because no wave shears by more than a tenth."""
    moved = points.copy()
    for length in (4000.0, 1900.0, 900.0):
        angle, phase = rng.uniform(0.0, 2.0 * np.pi, 2)
        along = np.array([np.cos(angle), np.sin(angle)])
        shift = 0.10 * length / (2.0 * np.pi) * np.sin(2.0 * np.pi * points @ along / length + phase)
        moved += shift[..., None] * np.array([-along[1], along[0]])
    return moved


def _straight(
    nodes: NDArray[np.float64],
    ends: NDArray[np.int64],
    kinds: NDArray[np.str_],
    half_widths: NDArray[np.float64],
    names: NDArray[np.str_],
) -> Network:
    nodes = np.round(nodes, 3)
    used, ends = np.unique(ends, return_inverse=True)
    nodes, ends = nodes[used], ends.reshape(-1, 2)
    lines = np.asarray(shapely.linestrings(nodes[ends]))
    return Network(nodes, ends, lines, kinds, np.asarray(half_widths, dtype=np.float64), names)
