"""Which objects a viewing cell may see: the conservative horizon sweep.

Conservative for every point of the cell, by four steps that each lose nothing.

1. *From the region to its outline.* Take a line of sight from inside the cell and step back along it, at the same
   height, to where it enters the cell's rectangle. What hides its target from there also hides it from the inside: it
   stands between the inside and the target (nothing in the rectangle counts as occluder), and stepping back raises the
   line of sight over it. So viewpoints on the outline suffice.
2. *From the outline to samples* (Wonka, Wimmer, Schmalstieg 2000). Shrink occluders by e: what a shrunken occluder hides
   from a sample, the whole one hides from everything within e of the sample, because the line of sight moves by at most
   e. What is shrunk is the *union* of the solids, at a few heights: touching buildings leave no gap.
3. *To the top of the eye band.* Occluders are solid down to the ground and higher than the eye, so an eye lower down
   sees a subset.
4. *To columns of azimuth*, see :mod:`mmi.visibility.horizon_sweep`.

Occluders are prisms inside objects (``CityObject.occluders``) that stand on the ground, each with its height rounded down
to a level. Those that the cell's rectangle cuts into (streets through buildings) hide nothing from that cell, with all of the
mesh that they lie in: inside it there may be no wall between them, nor a roof. The ground is taken to hide what is below it and
nothing else, hills or not: a line of sight that would pass under an occluder is under the ground there.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from shapely.geometry import Polygon

from mmi.cells.viewing_cells import ViewingCell
from mmi.city.model import City, Prism
from mmi.foundation.errors import ParameterError
from mmi.visibility.cell_outline import TOUCH, footprints_met, sample_viewpoints
from mmi.visibility.horizon_sweep import BINS, Rings, pack_rings, sweep
from mmi.visibility.selection import Extractor, Selection, WallVisibility, narrowed

__all__ = ["PreparedHorizon", "horizon_extractor", "horizon_of_boxes", "horizon_visible", "prepare_horizon"]

_TOLERANCE = 0.05
"""Metres that shrunken occluders give up beyond the asked distance, to be simplified by as much and still lie inside."""


_SLOPING_GAP = 0.5
"""Metres that a prism's base on a slope may be above the ground and still stand on it: models and their ground seldom agree to
the centimetre."""

_BESIDE = 0.05
"""Metres: prisms this close to a solid may have edges that it covers."""

_WIDER = 0.01
"""Metres that boxes are larger than they are: they may have no width, and corners of triangles are rounded."""

_CANDIDATES = 512
"""Levels are chosen among at most so many heights; time and memory grow with the square of this number."""


@dataclass(frozen=True, slots=True, eq=False)
class PreparedHorizon:
    """A city prepared for :func:`horizon_visible`.

    ``shrink`` metres; ``columns`` in the panorama. ``occluders`` and the ``blocks`` (b,) that they are the rings of are
    the shrunken unions, level by level, each at its greatest height only. ``occludees`` are the rings of all prisms,
    ``owners`` (r,) their objects. ``prisms`` (p,) are all footprints, ``prism_objects`` (p,) their objects, ``solids`` (s,)
    the footprints of what occludes; those of one mesh, in parts or not, have the same of ``meshes`` (s,). ``covered`` (e,)
    is how high each edge of ``occludees`` is covered by what touches it. What is looked for are ``sought`` objects, or boxes
    in their place (:func:`horizon_of_boxes`).
    """

    city: City
    shrink: float
    columns: int
    blocks: NDArray[np.object_]
    block_heights: NDArray[np.float64]
    occluders: Rings
    occludees: Rings
    owners: NDArray[np.int64]
    prisms: shapely.STRtree
    prism_objects: NDArray[np.int64]
    solids: shapely.STRtree
    meshes: NDArray[np.int64]
    covered: NDArray[np.float64]
    sought: int


def prepare_horizon(city: City, *, shrink: float = 1.5, columns: int = 2048, levels: int = 12) -> PreparedHorizon:
    """Shrinks the city's occluders by ``shrink`` metres, at no more than ``levels`` heights; once a city.

    A smaller ``shrink`` gives smaller visible sets and needs more viewpoints; ``columns`` is the panorama's resolution.
    Raises ParameterError for values that have no meaning.
    """
    if not (shrink > 0.0 and math.isfinite(shrink)):
        raise ParameterError(f"occluders shrink by a positive distance, found {shrink}")
    if columns < 8 or levels < 1:
        raise ParameterError(f"at least 8 columns and 1 level expected, found {columns} and {levels}")
    footprints, _, tops, objects = _prism_table([one.prisms for one in city.objects])
    solids, bottoms, solid_tops, hiding = _prism_table([one.occluders for one in city.objects])
    standing = _standing(city, solids, bottoms)
    solids, solid_tops = solids[standing], solid_tops[standing]
    heights = _levels(solid_tops, levels)
    blocks, block_heights = _shrink(solids, solid_tops, heights, shrink)
    occludees = pack_rings(footprints, tops)
    return PreparedHorizon(
        city=city,
        shrink=shrink,
        columns=columns,
        blocks=blocks,
        block_heights=block_heights,
        occluders=pack_rings(blocks, block_heights),
        occludees=occludees,
        owners=objects[occludees.owners],
        prisms=shapely.STRtree(footprints),
        prism_objects=objects,
        solids=shapely.STRtree(solids),
        meshes=_meshes(city, hiding[standing]),
        covered=_covered(occludees, pack_rings(solids, solid_tops)),
        sought=len(city.objects),
    )


def horizon_of_boxes(scene: PreparedHorizon, boxes: NDArray[np.float64]) -> PreparedHorizon:
    """``scene`` with ``boxes`` (n, 2, 3), metres, in the place of its objects: what is found are indices into these.

    They hide nothing, what hides are the city's occluders; each is taken to reach down to the ground.
    """
    low, high = boxes[:, 0] - _WIDER, boxes[:, 1] + _WIDER
    rectangles = shapely.box(low[:, 0], low[:, 1], high[:, 0], high[:, 1])
    occludees = pack_rings(rectangles, high[:, 2])
    return replace(
        scene,
        occludees=occludees,
        owners=occludees.owners,
        prisms=shapely.STRtree(rectangles),
        prism_objects=np.arange(len(boxes)),
        covered=np.full(len(occludees.xy), -np.inf),
        sought=len(boxes),
    )


def _prism_table(
    prisms: Sequence[tuple[Prism, ...]],
) -> tuple[NDArray[np.object_], NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
    """Footprints, bottoms, tops (p,) of the ``prisms`` of each object, and their objects (p,)."""
    every = [(prism, i) for i, own in enumerate(prisms) for prism in own]
    return (
        np.array([prism.footprint for prism, _ in every], dtype=object),
        np.array([prism.bottom for prism, _ in every], dtype=np.float64),
        np.array([prism.top for prism, _ in every], dtype=np.float64),
        np.array([i for _, i in every], dtype=np.int64),
    )


def _standing(city: City, footprints: NDArray[np.object_], bottoms: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which prisms (p,) leave nothing between them and the ground."""
    if city.terrain is None or not len(footprints):
        return bottoms <= city.ground + TOUCH
    # A line of sight that passes below a base has passed below it on the outline: only there does the ground matter.
    return np.asarray(bottoms <= city.terrain.under(footprints)[0] + _SLOPING_GAP)


def _meshes(city: City, objects: NDArray[np.int64]) -> NDArray[np.int64]:
    """(s,) a number for each of the ``objects`` (s,) that solids are of: the same only for parts of one mesh."""
    names: dict[str, int] = {}
    found = len(city.objects) + np.arange(len(objects))
    for k, i in enumerate(objects.tolist()):
        one = city.objects[i]
        if one.mesh is not None:
            found[k] = names.setdefault(one.part_of or one.id, i)
    return found


def _covered(rings: Rings, solids: Rings) -> NDArray[np.float64]:
    """(e,) for each edge of ``rings``, the height of the solid that has the same edge the other way round; -inf where none has.

    Edges are the same where they agree to the centimetre. What touches with a part of a longer edge is not looked at.
    """
    xy = np.rint(100.0 * np.concatenate([rings.xy, solids.xy])).astype(np.int64)
    _, names = np.unique(xy, axis=0, return_inverse=True)
    own, other = np.split(names.reshape(-1).astype(np.int64), [len(rings.xy)])
    count = len(xy) + 1
    keys = other * count + other[_following(solids)]
    order = np.argsort(keys, kind="stable")
    keys, heights = keys[order], np.repeat(solids.heights, np.diff(solids.starts))[order]
    wanted = own[_following(rings)] * count + own
    covered = np.full(len(own), -np.inf)
    first, last = np.searchsorted(keys, wanted, side="left"), np.searchsorted(keys, wanted, side="right")
    while (more := first < last).any():  # mostly one, at most
        covered[more] = np.maximum(covered[more], heights[first[more]])
        first = first + more
    return covered


def _following(rings: Rings) -> NDArray[np.int64]:
    """(n,) the vertex that follows each one on its ring."""
    after = np.arange(1, len(rings.xy) + 1)
    after[rings.starts[1:] - 1] = rings.starts[:-1]
    return after


def _levels(tops: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """At most ``count`` of ``tops``, sorted: those that leave the smallest sum of heights lost by rounding down.

    Of more than ``_CANDIDATES`` different tops, evenly spaced ones are candidates.
    """
    values, weights = np.unique(tops, return_counts=True)
    if len(values) <= count:
        return values
    if len(values) > _CANDIDATES:
        values = np.unique(np.quantile(values, np.linspace(0.0, 1.0, _CANDIDATES), method="lower"))
        weights = np.bincount(np.searchsorted(values, tops, side="right") - 1, minlength=len(values))
    # best[j]: the smallest loss of values[j:] when j is a level and k more levels may follow
    after = np.concatenate([np.cumsum((weights * values)[::-1])[::-1], [0.0]])
    number = np.concatenate([np.cumsum(weights[::-1])[::-1], [0]])
    # loss[i, j]: values[i:j] rounded down to values[i]
    loss = (after[:-1, None] - after[None, :]) - values[:, None] * (number[:-1, None] - number[None, :])
    loss[np.tril_indices(len(values), 0, len(values) + 1)] = np.inf
    best = loss[:, -1]
    choices = []
    for _ in range(count - 1):
        total = loss + np.append(best, 0.0)[None, :]
        choices.append(np.argmin(total, axis=1))
        best = np.take_along_axis(total, choices[-1][:, None], axis=1)[:, 0]
    chosen = [0]
    for choice in reversed(choices):
        following = int(choice[chosen[-1]])
        if following == len(values):
            break
        chosen.append(following)
    return values[chosen]


def _shrink(
    footprints: NDArray[np.object_], tops: NDArray[np.float64], heights: NDArray[np.float64], distance: float
) -> tuple[NDArray[np.object_], NDArray[np.float64]]:
    """Polygons (b,) and which of ``heights``, sorted, each has (b,), lowest first.

    They lie inside the union of those ``footprints`` (p,) whose ``tops`` (p,) are no lower, at least ``distance`` metres
    from its outline. Mitred corners lie farther from the outline than round ones, never nearer. What does not touch
    shrinks apart; and where a height adds nothing to what touches, the polygons are those of a greater height, and left
    out.
    """
    level = np.searchsorted(heights, tops, side="right") - 1
    one, other = shapely.STRtree(footprints).query(footprints, predicate="intersects")
    unions: list[shapely.Geometry] = []
    levels: list[int] = []
    for lowest in range(len(heights)):
        both = (level[one] >= lowest) & (level[other] >= lowest)
        links = coo_array((both[both], (one[both], other[both])), shape=(len(level), len(level)))
        _, group = connected_components(links, directed=False)
        members = np.flatnonzero((level >= lowest) & np.isin(group, group[level == lowest]))
        members = members[np.argsort(group[members], kind="stable")]
        starts = np.flatnonzero(np.diff(group[members], prepend=-1))
        parts = np.split(footprints[members], starts[1:])
        unions += [part[0] if len(part) == 1 else shapely.union_all(part) for part in parts]
        levels += [lowest] * len(parts)
    # Unions leave edges of no length to speak of, which have no direction to mitre.
    outlines = shapely.simplify(np.array(unions, dtype=object), 5e-4)
    with np.errstate(divide="ignore", invalid="ignore"):  # GEOS divides by the length of what vanishes
        shrunken = shapely.buffer(outlines, -(distance + _TOLERANCE), join_style="mitre")
    inner, of = shapely.get_parts(shrunken, return_index=True)
    polygons, kept = _polygons(shapely.simplify(inner, 0.9 * _TOLERANCE))
    return polygons, heights[np.array(levels, dtype=np.int64)[of[kept]]]


def _polygons(shapes: NDArray[np.object_]) -> tuple[NDArray[np.object_], NDArray[np.int64]]:
    """The non-empty polygons among the parts of ``shapes``, and the place of the shape that each is a part of."""
    parts, of = shapely.get_parts(shapes, return_index=True)
    filled = (shapely.get_type_id(parts) == 3) & ~shapely.is_empty(parts)
    return parts[filled], of[filled]


def horizon_visible(scene: PreparedHorizon, cell: ViewingCell) -> tuple[NDArray[np.int64], WallVisibility]:
    """Sorted indices into ``city.objects`` (or boxes) of all that may be seen from somewhere in ``cell``, and maybe some more.

    Also returns how low and from where their walls may be seen, which is conservative as well.
    """
    region = Polygon(cell.corners)
    seen = np.zeros(scene.sought, dtype=bool)
    seen[scene.prism_objects[footprints_met(scene.prisms, region)]] = True
    cutting = scene.solids.query(region.buffer(-TOUCH, join_style="mitre"), predicate="intersects")
    covered = scene.covered
    if len(cutting):
        cutting = np.flatnonzero(np.isin(scene.meshes, scene.meshes[cutting]))
        covered = _uncovered(scene, cutting)
    occluders = _occluders_without(scene, cutting)
    nearest_first = np.lexsort([-occluders.heights, _gap(occluders.boxes, region.bounds)])
    viewpoints = sample_viewpoints(cell, reach=scene.shrink)
    lowest, bits = sweep(
        viewpoints,
        occluders,
        nearest_first,
        scene.occludees,
        scene.owners,
        seen,
        columns=scene.columns,
        reach=scene.shrink,
    )
    return np.flatnonzero(seen), WallVisibility(np.maximum(lowest, covered), bits, min(len(viewpoints), BINS))


def _uncovered(scene: PreparedHorizon, cutting: NDArray[np.int64]) -> NDArray[np.float64]:
    """(e,) ``covered`` for a viewer inside of the solids ``cutting`` (k,), who sees the walls that they touch."""
    solids = scene.solids.geometries[cutting]
    beside = np.isin(scene.occludees.owners, scene.prisms.query(solids, predicate="dwithin", distance=_BESIDE)[1])
    return np.where(np.repeat(beside, np.diff(scene.occludees.starts)), -np.inf, scene.covered)


def _gap(boxes: NDArray[np.float64], box: tuple[float, float, float, float]) -> NDArray[np.float64]:
    """(r,) metres between ``box`` and each of ``boxes`` (r, 4)."""
    x0, y0, x1, y1 = box
    dx = np.maximum(np.maximum(boxes[:, 0] - x1, x0 - boxes[:, 2]), 0.0)
    dy = np.maximum(np.maximum(boxes[:, 1] - y1, y0 - boxes[:, 3]), 0.0)
    return np.hypot(dx, dy)


def _occluders_without(scene: PreparedHorizon, solids: NDArray[np.int64]) -> Rings:
    """The occluders as they would be without ``solids``: what is left is as far from them as from any outline."""
    if not len(solids):
        return scene.occluders
    margin = scene.shrink + _TOLERANCE
    hole = shapely.union_all(shapely.buffer(scene.solids.geometries[np.sort(solids)], margin, join_style="mitre"))
    shapely.prepare(hole)
    cut = shapely.intersects(hole, scene.blocks)
    pieces, of = _polygons(shapely.difference(scene.blocks[cut], hole))
    return pack_rings(
        np.concatenate([scene.blocks[~cut], pieces]),
        np.concatenate([scene.block_heights[~cut], scene.block_heights[cut][of]]),
    )


def horizon_extractor(scene: PreparedHorizon) -> Extractor:
    """Narrows a selection of the scene's city to what :func:`horizon_visible` finds."""

    def extract(selection: Selection) -> Selection:
        if selection.city is not scene.city:
            raise ValueError(f"horizon of {scene.city.source} used for a selection of {selection.city.source}")
        visible, wall_visibility = horizon_visible(scene, selection.cell)
        return replace(narrowed(selection, visible), wall_visibility=wall_visibility)

    return extract
