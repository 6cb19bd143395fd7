"""Viewing cells: the street graph cut into straight stretches, and how they neighbour each other (paper section 4).

Everything that decides where a viewer may be lives here: chords of bent streets, their split into cells, and the half
widths that keep cells out of buildings. Nothing here knows what can be seen from a cell.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass

import networkx as nx
import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import Polygon

from mmi.cells.centre_lines import (
    CHORD_TOLERANCE,
    MERGE_TOLERANCE,
    SHORT_PIECE,
    Piece,
    chords_of,
    length_of,
    pieces_along,
    split_evenly,
    streets_of,
)
from mmi.city.model import City, Prism
from mmi.city.terrain import Terrain
from mmi.foundation.errors import ParameterError

__all__ = [
    "CHORD_TOLERANCE",
    "CLEARANCE",
    "MERGE_TOLERANCE",
    "SHORT_PIECE",
    "STEEPEST",
    "CellReport",
    "ViewingCell",
    "viewing_cells",
]

CLEARANCE = 0.05
"""Metres that every cell keeps from every building."""
STEEPEST = 2.0
"""Metres that the ground may rise along a cell, unless that leaves it shorter than ``SHORT_PIECE``."""
_STEP = 0.03
"""Metres: what rises no higher above the ground is walked over indoors, as floors and rugs are."""
_NARROWEST = 0.2
"""Metres: a cell is at least this wide on either side of its axis. Where buildings leave less, the street is cut."""
_REMNANT = 0.5
"""Metres: what a cut leaves of a piece is given up where it is shorter."""
_PULLED_BACK = 1.0
"""Metres: an end that a cut moves by no more than this still meets its neighbours."""


@dataclass(frozen=True, slots=True)
class ViewingCell:
    """Where a viewer may be: within ``half_width`` of the axis from ``p`` to ``q``, eyes at heights within ``eye``.

    The region is the rectangle that the axis sweeps sideways (no caps at the ends). ``p``, ``q`` are (x, y), ``eye`` is
    (lowest, highest) in metres in the city's frame; where the ground at q is ``rise`` metres higher than at p (or lower),
    the band reaches over both ends. ``id`` names street and piece (``0017-03``), so that it stays when other streets change.
    """

    id: str
    p: tuple[float, float]
    q: tuple[float, float]
    half_width: float
    eye: tuple[float, float]
    street: str = ""
    rise: float = 0.0

    def __post_init__(self) -> None:
        if not (self.length > 0.0 and math.isfinite(self.length)):
            raise ParameterError(f"cell {self.id}: an axis of positive length expected, found {self.p} to {self.q}")
        if not (self.half_width > 0.0 and self.eye[0] <= self.eye[1]):
            raise ParameterError(
                f"cell {self.id}: a positive half width and an eye band (low, high) expected, "
                f"found {self.half_width} and {self.eye}"
            )
        if not abs(self.rise) <= self.eye[1] - self.eye[0] + 1e-9:
            raise ParameterError(
                f"cell {self.id}: an eye band that holds a rise of {self.rise} m expected, found {self.eye}"
            )

    @property
    def length(self) -> float:
        """Metres from p to q."""
        return math.hypot(self.q[0] - self.p[0], self.q[1] - self.p[1])

    @property
    def reference(self) -> NDArray[np.float64]:
        """(3,) the viewpoint from which layers are captured: the middle of the axis, at the middle of the eye band."""
        return np.array(
            [0.5 * (self.p[0] + self.q[0]), 0.5 * (self.p[1] + self.q[1]), 0.5 * (self.eye[0] + self.eye[1])]
        )

    def eye_at(self, t: float) -> tuple[float, float]:
        """The eye band (lowest, highest) at a share ``t`` of the way from p to q, where the ground rises evenly."""
        low, high = self.eye
        middle = 0.5 * (low + high) + (t - 0.5) * self.rise
        half = 0.5 * max(high - low - abs(self.rise), 0.0)
        return middle - half, middle + half

    def part(self, start: float, end: float, name: str) -> ViewingCell:
        """The cell called ``name`` between the shares ``start`` and ``end`` of the way from p to q."""
        (px, py), (qx, qy) = self.p, self.q
        p, q = ((px + t * (qx - px), py + t * (qy - py)) for t in (start, end))
        ends = np.array([self.eye_at(start), self.eye_at(end)])
        band = (float(ends[:, 0].min()), float(ends[:, 1].max()))
        return ViewingCell(name, p, q, self.half_width, band, self.street, (end - start) * self.rise)

    @property
    def corners(self) -> NDArray[np.float64]:
        """(4, 2) the region's corners, counter-clockwise, starting to the right of p."""
        p, q = np.array(self.p), np.array(self.q)
        along = (q - p) / self.length
        right = self.half_width * np.array([along[1], -along[0]])
        return np.array([p + right, q + right, q - right, p - right])


@dataclass(frozen=True, slots=True)
class CellReport:
    """What became of the streets; lengths in metres.

    ``street_length`` is that of all centre lines, ``cell_length`` that of all axes (chords, so a little shorter).
    ``cut_pieces`` straight pieces came closer to buildings than a cell may and lost ``cut_length``, the whole piece or
    a part of it. ``narrowed_cells`` are less wide than their street. ``degenerate_streets`` have no length at all.
    """

    streets: int
    street_length: float
    cells: int
    cell_length: float
    cut_pieces: int
    cut_length: float
    narrowed_cells: int
    degenerate_streets: int


def viewing_cells(
    city: City,
    *,
    max_length: float = 40.0,
    eye: tuple[float, float] = (1.5, 1.9),
    max_half_width: float | None = None,
) -> nx.Graph:
    """Cut the streets of ``city`` into cells, joined where they share a junction or a split point.

    Nodes are cell ids in the order of streets and pieces, with attribute ``cell`` (:class:`ViewingCell`);
    ``graph.graph["report"]`` is a :class:`CellReport`. Bent streets become chords within ``CHORD_TOLERANCE`` of the
    centre line (Douglas & Peucker 1973), chords longer than ``max_length`` metres are split evenly, and so are those on
    which the ground rises by more than ``STEEPEST`` metres. ``eye`` is a band of heights above the ground, metres. The
    half width is the street's, at most ``max_half_width``, and shrinks until the cell keeps ``CLEARANCE`` from every prism
    that stands on the ground (from below the eyes to above the ground). Where there is no room for ``_NARROWEST`` the
    chord gives way to the centre line, and that is cut as far as needed.

    Raises ParameterError for options without meaning, CityError for a street without width.
    """
    if not (math.isfinite(max_length) and max_length >= 1.0):
        raise ParameterError(f"a cell length of at least 1 m expected, found {max_length!r}")
    if not (0.0 <= eye[0] <= eye[1] and math.isfinite(eye[1])):
        raise ParameterError(f"eye heights (low, high) above the ground expected, found {eye!r}")
    if max_half_width is not None and not (math.isfinite(max_half_width) and max_half_width >= _NARROWEST):
        raise ParameterError(f"a half width of at least {_NARROWEST} m expected, found {max_half_width!r}")
    obstacles = shapely.STRtree(_obstacles(city, eye[1]))
    joints = itertools.count(city.streets.number_of_nodes())
    streets = streets_of(city)
    chords = [piece for street in streets if len(street.points) > 1 for piece in chords_of(street, joints)]
    chords, cut_pieces, cut_length = _clear_chords(chords, obstacles, joints)
    pieces = [part for chord in chords for part in split_evenly(chord, _parts(chord, max_length, city), joints)]

    axes = np.array([piece.chord for piece in pieces]).reshape(-1, 2, 2)
    wanted = np.array([piece.street.half_width for piece in pieces])
    if max_half_width is not None:
        wanted = np.minimum(wanted, max_half_width)
    widths = _clear_half_widths(axes, wanted, obstacles)

    bands, rises = _eye_bands(city, axes, widths, eye)

    graph = nx.Graph()
    meeting: dict[int, list[str]] = {}
    for (piece, number), width, band, rise in zip(_numbered(pieces), widths, bands, rises, strict=True):
        name = f"{piece.street.index:04d}-{number:02d}"
        (px, py), (qx, qy) = piece.chord.tolist()
        graph.add_node(name, cell=ViewingCell(name, (px, py), (qx, qy), float(width), band, piece.street.name, rise))
        for joint in dict.fromkeys((piece.start, piece.end)):
            meeting.setdefault(joint, []).append(name)
    for names in meeting.values():
        graph.add_edges_from(itertools.combinations(names, 2))
    graph.graph["report"] = CellReport(
        streets=len(streets),
        street_length=float(sum(length_of(street.points) for street in streets)),
        cells=len(pieces),
        cell_length=float(np.hypot(*(axes[:, 1] - axes[:, 0]).T).sum()),
        cut_pieces=cut_pieces,
        cut_length=cut_length,
        narrowed_cells=int(np.count_nonzero(widths < wanted)),
        degenerate_streets=sum(len(street.points) < 2 for street in streets),
    )
    return graph


def _blocked(pieces: list[Piece], obstacles: shapely.STRtree) -> dict[int, list[int]]:
    """Pieces whose chord has no room for a cell -> the obstacles that leave none."""
    chords = shapely.linestrings(np.array([piece.chord for piece in pieces]).reshape(-1, 2, 2))
    blocked: dict[int, list[int]] = {}
    pairs = obstacles.query(chords, predicate="dwithin", distance=CLEARANCE + _NARROWEST)
    for piece, obstacle in sorted(zip(*pairs.tolist(), strict=True)):
        blocked.setdefault(piece, []).append(obstacle)
    return blocked


def _clear_chords(
    chords: list[Piece], obstacles: shapely.STRtree, joints: Iterator[int]
) -> tuple[list[Piece], int, float]:
    """Chords with room for a cell everywhere, how many were cut for that, and the metres that they lost.

    A chord without room first gives way to the centre line: the chord may have cut a building's corner.
    """
    blocked = _blocked(chords, obstacles)
    straight: list[Piece] = []
    for i, piece in enumerate(chords):
        if i in blocked and len(piece.points) > 2:
            runs = [piece.points[k : k + 2] for k in range(len(piece.points) - 1)]
            straight += pieces_along(piece.street, runs, piece.start, piece.end, joints)
        else:
            straight.append(piece)
    blocked = _blocked(straight, obstacles)
    clear: list[Piece] = []
    lost = 0.0
    for i, piece in enumerate(straight):
        parts = _cut(piece, obstacles.geometries[blocked[i]], joints) if i in blocked else [piece]
        if i in blocked:
            lost += length_of(piece.chord) - sum(length_of(part.chord) for part in parts)
        clear += parts
    return clear, len(blocked), lost


def _cut(piece: Piece, obstacles: NDArray[np.object_], joints: Iterator[int]) -> list[Piece]:
    """What ``obstacles`` leave of a straight piece. Ends that were pulled back a little keep their joint."""
    a, b = piece.chord
    # A hair more room than _blocked asks for, since the buffer's arcs are polygons inside of them.
    taken = shapely.union_all(shapely.buffer(obstacles, (CLEARANCE + _NARROWEST) * 1.01))
    left = shapely.get_parts(shapely.difference(shapely.LineString([a, b]), taken))
    length = length_of(piece.chord)
    along = (b - a) / length
    spans = sorted(sorted(((shapely.get_coordinates(part) - a) @ along).tolist()) for part in left if not part.is_empty)
    parts: list[Piece] = []
    previous, joint, reach = 0.0, piece.start, _PULLED_BACK
    for low, *_, high in spans:
        if high - low < _REMNANT:
            continue
        start = joint if low - previous <= reach else next(joints)
        joint = next(joints)
        parts.append(Piece(piece.street, np.array([a + low * along, a + high * along]), start, joint))
        previous, reach = high, 2.0 * _PULLED_BACK
    if parts and length - previous <= _PULLED_BACK:
        last = parts.pop()
        parts.append(Piece(last.street, last.points, last.start, piece.end))
    return parts


def _parts(piece: Piece, max_length: float, city: City) -> int:
    """In how many equal parts a chord is cut: none too long, or too steep."""
    length = length_of(piece.chord)
    n = max(1, math.ceil(length / max_length - 1e-9))
    if city.terrain is None:
        return n
    a, b = piece.chord
    ground = city.ground_at(a + np.linspace(0.0, 1.0, max(2, math.ceil(length / 2.0)))[:, None] * (b - a))
    steepest = float(np.abs(np.diff(ground)).max()) * (len(ground) - 1)
    return max(n, min(math.ceil(steepest / STEEPEST - 1e-9), math.ceil(length / SHORT_PIECE)))


def _obstacles(city: City, eye: float) -> list[Polygon]:
    """Footprints of all prisms that stand on the ground, or less than ``eye`` metres above it; indoors not floor and rugs."""
    prisms = [prism for one in city.objects for prism in one.prisms]
    if city.terrain is None:
        foot = city.ground + (_STEP if _indoors(city, prisms) else 0.0)
        return [one.footprint for one in prisms if one.bottom < city.ground + eye and one.top > foot]
    if not prisms:
        return []
    low, high = city.terrain.range_over(shapely.bounds([one.footprint for one in prisms]))
    spans = zip(prisms, low.tolist(), high.tolist(), strict=True)
    return [one.footprint for one, lowest, highest in spans if one.bottom < highest + eye and one.top > lowest]


def _indoors(city: City, prisms: list[Prism]) -> bool:
    """Whether all streets lie on floors: prisms that the flat ground is in, just below their tops."""
    floors = [one.footprint for one in prisms if one.bottom < city.ground < one.top <= city.ground + _STEP]
    lines = [edge["geometry"] for *_, edge in city.streets.edges(data=True)]
    return bool(floors) and bool(shapely.covers(shapely.union_all(floors), lines).all())


def _eye_bands(
    city: City, axes: NDArray[np.float64], widths: NDArray[np.float64], eye: tuple[float, float]
) -> tuple[list[tuple[float, float]], list[float]]:
    """Eye bands of cells along ``axes`` (n, 2, 2), and how much higher the ground is at their second end.

    A band holds ``eye`` above the ground anywhere in the cell.
    """
    if city.terrain is None:
        return [(city.ground + eye[0], city.ground + eye[1])] * len(axes), [0.0] * len(axes)
    ends = city.ground_at(axes)
    rise = ends[:, 1] - ends[:, 0]
    if not len(axes):
        return [], []
    found = [_uneven_places(city.terrain, axis, width) for axis, width in zip(axes, widths.tolist(), strict=True)]
    counts = [len(one) for one in found]
    places, of = np.concatenate(found), np.repeat(np.arange(len(axes)), counts)
    along = axes[:, 1] - axes[:, 0]
    share = ((places - axes[of, 0]) * along[of]).sum(axis=1) / (along**2).sum(axis=1)[of]
    uneven = city.terrain.at(places) - ends[of, 0] - share * rise[of]
    starts = np.cumsum([0, *counts[:-1]])
    low = ends.mean(axis=1) + np.minimum.reduceat(uneven, starts) - 0.5 * np.abs(rise) + eye[0]
    high = ends.mean(axis=1) + np.maximum.reduceat(uneven, starts) + 0.5 * np.abs(rise) + eye[1]
    return list(zip(low.tolist(), high.tolist(), strict=True)), rise.tolist()


def _uneven_places(terrain: Terrain, axis: NDArray[np.float64], width: float) -> NDArray[np.float64]:
    """(n, 2) where the ground of the rectangle within ``width`` of ``axis`` (2, 2) may leave a plane by most.

    That is at points of the terrain's grid and on the outline: at corners, where it crosses lines of the grid, and (where
    it bends a little) in between. Inside a square of the grid, a bilinear surface has neither peak nor pit.
    """
    length = length_of(axis)
    along = (axis[1] - axis[0]) / length
    aside = np.array([-along[1], along[0]])
    corners = np.concatenate([axis - width * aside, axis[::-1] + width * aside])
    in_squares = (corners - terrain.origin) / terrain.spacing
    first, last = np.ceil(in_squares.min(axis=0)), np.floor(in_squares.max(axis=0))
    lines = [np.arange(first[k], last[k] + 1.0) for k in (0, 1)]
    grid = np.stack(np.meshgrid(*lines), axis=-1).reshape(-1, 2)
    offset = grid * terrain.spacing + terrain.origin - axis[0]
    inside = (np.abs(offset @ aside) <= width) & (offset @ along >= 0.0) & (offset @ along <= length)
    shares = np.linspace(0.0, 1.0, 9)[1:]
    places = [grid[inside]]
    for a, b in zip(in_squares, np.roll(in_squares, -1, axis=0), strict=True):
        crossings = [(lines[k] - a[k]) / (b[k] - a[k]) for k in (0, 1) if abs(b[k] - a[k]) > 1e-9]
        t = np.concatenate([shares, *crossings])
        places.append(a + t[(t >= 0.0) & (t <= 1.0), None] * (b - a))
    return np.concatenate(places) * terrain.spacing + terrain.origin


def _clear_half_widths(
    axes: NDArray[np.float64], wanted: NDArray[np.float64], obstacles: shapely.STRtree
) -> NDArray[np.float64]:
    """(n,) the largest half widths up to ``wanted`` (n,) that keep CLEARANCE from obstacles around ``axes`` (n, 2, 2).

    What lies beside the axis, lengthened by the clearance, limits the half width; what lies beyond it does not.
    """
    widths = wanted.copy()
    if not len(axes):
        return widths
    margin = CLEARANCE + 1e-6
    along = axes[:, 1] - axes[:, 0]
    along /= np.hypot(*along.T)[:, None]
    left = np.stack([-along[:, 1], along[:, 0]], axis=-1)
    side = (wanted + margin)[:, None] * left
    p, q = axes[:, 0] - margin * along, axes[:, 1] + margin * along
    strips = shapely.polygons(np.stack([p - side, q - side, q + side, p + side], axis=1))
    cells, found = obstacles.query(strips, predicate="intersects")
    order = np.lexsort((found, cells))
    cells, found = cells[order], found[order]
    beside = shapely.intersection(strips[cells], obstacles.geometries[found])
    corners, pair = shapely.get_coordinates(beside, return_index=True)
    cell = cells[pair]
    offset = np.abs(((corners - axes[cell, 0]) * left[cell]).sum(axis=1))
    np.minimum.at(widths, cell, offset - margin)
    return widths


def _numbered(pieces: list[Piece]) -> list[tuple[Piece, int]]:
    """Each piece with its number within its street."""
    numbers: dict[int, int] = {}
    numbered = []
    for piece in pieces:
        number = numbers.get(piece.street.index, 0)
        numbers[piece.street.index] = number + 1
        numbered.append((piece, number))
    return numbered
