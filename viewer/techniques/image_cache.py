"""The three-dimensional image cache (Schaufler & Stuerzlinger 1996): a tree of boxes, whose pictures are shown again.

In each frame the tree has a cut: nearest to the root, the boxes that are seen small enough to be an image (paper equation 1);
below them, where boxes are too near, their primitives. Images of the cut that are not valid any more are captured anew (figure
4), and those within the view are drawn, with the primitives (figure 5). An image is captured from the primitives of its box,
or where these are many from images of boxes within it, which may be wrong by a part of what is allowed: the new image inherits
that (``viewer.caching.node_images``).

It needs no objects, streets or cells. Images have depth, so that they compose with near geometry and with what moves.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from hashlib import blake2b
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mmi.foundation.camera import View
from viewer.caching.atlases import Atlases
from viewer.caching.box_tree import BoxTree, box_tree
from viewer.caching.captures import Captures, captures_of, least_distances, sharpness_of
from viewer.caching.node_images import NodeImages
from viewer.caching.rules import CacheRules
from viewer.plan import Budget, Costs, Draw, Faces, ImageKey, Nailboards, Plan, Request, Sky
from viewer.scene.frustum import boxes_within_view
from viewer.scene.scene import WalkScene

__all__ = ["CacheTally", "ImageCache", "tree_of"]

_HANDED_ON = 0.7
"""The share of what images may be wrong by that others may inherit."""
_GAIN = 2.0
"""Unless it is eager, a cache shows an image where its triangles are predicted to take so many times as long as showing it,
and what capturing it takes as often as it must be, besides."""
_WORTH_COMBINING = 10.0
"""Times what a request takes by itself: a node whose primitives take no longer is captured from them."""
_FEW = 256
"""Triangles that are always drawn rather than an image of them: a draw takes as long."""
_MANY = 2000
"""Triangles of a node without an image that has a draw of its own: the set of all such nodes is another in each frame."""
_MOST_WHOLES = 1024
_WIDEST = 1.5
"""Radians that an image may be wrong by, whatever is allowed in pixels: less than a right angle."""
_LATEST = 10.0
"""An image that is wrong by more times what it may is not shown, however late others are: a leap leaves such ones behind."""


class CacheTally(NamedTuple):
    """What boxes of the cut were in ``frames``, in all: images captured from primitives (``new``) or from other images
    (``combined``), shown again (``reused``), or drawn as primitives (``impossible`` as images, or not worth one).

    ``late`` images were shown although they were not valid, because the budget had no room for others. ``kept_px`` is the
    largest error of an image that was shown, in pixels at the display's border; ``bytes`` the most that images took.
    """

    frames: int = 0
    new: int = 0
    combined: int = 0
    reused: int = 0
    impossible: int = 0
    late: int = 0
    kept_px: float = 0.0
    bytes: int = 0

    def plus(self, other: CacheTally) -> CacheTally:
        """Both together."""
        return CacheTally(
            self.frames + other.frames,
            self.new + other.new,
            self.combined + other.combined,
            self.reused + other.reused,
            self.impossible + other.impossible,
            self.late + other.late,
            max(self.kept_px, other.kept_px),
            max(self.bytes, other.bytes),
        )


@dataclass(slots=True, eq=False)
class _Frame:
    """What comes together while a frame is planned: ``left`` seconds for requests, by their ``costs``; kinds of nodes."""

    eye: NDArray[np.float64]
    costs: Costs
    worth: Costs
    left: float
    strict: bool
    requests: list[Request] = field(default_factory=list)
    new: list[int] = field(default_factory=list)
    combined: list[int] = field(default_factory=list)


def tree_of(scene: WalkScene, rules: CacheRules) -> BoxTree:
    """The tree of a scene, which all of its viewers share. Takes a few seconds for each million triangles at first."""
    key = ("box tree", rules.leaf_triangles, rules.depth)
    mesh = scene.mesh
    return scene.workshop.once(
        key,
        lambda: box_tree(mesh.positions, mesh.triangles, leaf_triangles=rules.leaf_triangles, depth=rules.depth),
    )


class ImageCache:
    """Images of boxes where they are valid, primitives elsewhere. ``owner`` is whose images they are on the GPU."""

    name = "image-cache"

    def __init__(self, scene: WalkScene, rules: CacheRules | None = None) -> None:
        self._scene, self._rules = scene, rules or CacheRules()
        self._tree = tree_of(scene, self._rules)
        self._counts = self._tree.triangle_counts
        self._leaf = self._tree.is_leaf
        self._middles = 0.5 * (self._tree.boxes[:, 0] + self._tree.boxes[:, 1])
        self._radii = 0.5 * np.linalg.norm(self._tree.boxes[:, 1] - self._tree.boxes[:, 0], axis=1)
        self._frame = 0
        self._eye: NDArray[np.float64] | None = None
        self._moved = self._step = 0.0
        self._last: tuple[float, tuple[int, int, int, int]] | None = None
        self._worth: Costs | None = None
        self._images: NodeImages
        self._atlases: Atlases
        self._least: NDArray[np.float64]
        self._direct: tuple[bytes, Faces] | None = None
        self._wholes: dict[int, Faces] = {}
        self.owner = self.name
        """Whose images they are on the GPU."""
        self.tally = CacheTally()
        """What boxes were so far."""
        self.latest = CacheTally()
        """What they were in the last frame."""
        self.kinds: dict[str, NDArray[np.int64]] = {}
        """Nodes of the last frame by kind: ``new``, ``combined``, ``reused``, ``impossible``."""

    @property
    def tree(self) -> BoxTree:
        """The boxes."""
        return self._tree

    def plan(self, view: View, *, now: float, budget: Budget) -> Plan:  # noqa: ARG002
        """Capture what is not valid any more, as far as the budget allows, and draw the cut."""
        self._frame += 1
        drops = self._look_through(view)
        self._follow(view.eye)
        if self._worth is None:  # what is worth an image does not change with what the last frames took
            self._worth = budget.costs
        frame = _Frame(view.eye, budget.costs, self._worth, budget.updates, strict=math.isinf(budget.updates))
        images, direct = self._cut(view, self._worth)
        seen = boxes_within_view(self._tree.boxes[images], view)
        wanted = images if self._rules.keep == "sphere" else images[seen]
        valid = self._images.valid(wanted, view.eye)
        self._images.used[wanted[valid]] = self._frame
        self._update(wanted[~valid], view, frame)
        shown, late, more = self._shown(images[seen], frame)
        many = self._counts[more] > _MANY
        drawn = np.concatenate([direct[boxes_within_view(self._tree.boxes[direct], view)], more[~many]])
        draws: tuple[Draw, ...] = (
            *self._images.boards(shown, self._frame),
            *self._primitives(drawn),
            *(self._whole(node) for node in more[many].tolist()),
        )
        self._count(frame, wanted[valid], np.concatenate([direct, more]), shown, late)
        return Plan((*draws, self._scene.ground_in(view), Sky()), requests=tuple(frame.requests), drops=drops)

    def _look_through(self, view: View) -> tuple[ImageKey, ...]:
        """Begin anew where another display is drawn for than before; the images that nobody needs any more then."""
        sharpness = sharpness_of(view)
        told = (view.focal, view.window)
        drops: tuple[ImageKey, ...] = ()
        if told == self._last:
            return drops
        if self._last is None or sharpness != self._images.sharpness:
            rules = self._rules
            drops = () if self._last is None else self._atlases.images
            self._images = NodeImages(self._tree.boxes, sharpness, min(rules.error_px * sharpness.pixel, _WIDEST))
            self._atlases = Atlases(self.owner, largest=rules.largest, most_bytes=rules.bytes, forget=self._images.drop)
            self._least = least_distances(self._tree.boxes, rules.largest, sharpness)
        self._last = told
        return drops

    def _follow(self, eye: NDArray[np.float64]) -> None:
        """How far the viewer goes in a frame: the shorter of the last two ways, so that a leap is none."""
        moved = 0.0 if self._eye is None else float(np.linalg.norm(eye - self._eye))
        self._step, self._moved, self._eye = min(moved, self._moved), moved, eye

    # ---------------------------------------------------------------------------------------------------- the cut

    def _cut(self, view: View, costs: Costs) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Nodes that are to be images, and nodes whose primitives are drawn: together they hold everything once."""
        tree = self._tree
        images, direct = [], []
        waiting = np.zeros(1, dtype=np.int64)
        while len(waiting):
            waiting = waiting[self._counts[waiting] > 0]
            image, ends = self._ending(waiting, view, costs)
            images.append(waiting[image])
            direct.append(waiting[ends])
            waiting = tree.children_of(waiting[~(image | ends)])
        return np.sort(np.concatenate(images)), np.sort(np.concatenate(direct))

    def _ending(
        self, nodes: NDArray[np.int64], view: View, costs: Costs
    ) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """(k,) which ``nodes`` (k,) are to be images, and which others are drawn as primitives; the rest is looked into."""
        towards = self._middles[nodes] - view.eye
        distance = np.linalg.norm(towards, axis=1)
        possible, counts = distance > self._least[nodes], self._counts[nodes]
        if self._rules.eager:
            return possible, self._leaf[nodes] & ~possible
        covers = np.abs(towards) / np.maximum(distance, 1e-9)[:, None]
        x, y, z = (self._tree.boxes[nodes, 1] - self._tree.boxes[nodes, 0]).T
        area = covers[:, 0] * y * z + covers[:, 1] * x * z + covers[:, 2] * x * y
        takes = _GAIN * costs.relief * area * (view.focal / np.maximum(distance, 1e-9)) ** 2
        captures = costs.request + costs.captured * counts
        takes += captures / np.maximum(self._lasts(distance, self._radii[nodes]) / max(self._step, 1e-9), 1.0)
        image = possible & (counts > _FEW) & (costs.triangle * counts > takes)
        return image, ~image & (self._leaf[nodes] | (counts <= _FEW))

    def _lasts(self, distance: NDArray[np.float64], radius: NDArray[np.float64]) -> NDArray[np.float64]:
        """Metres (k,), about, that a viewer may go while images of nodes of a ``radius`` at a ``distance`` (k,) stay valid.

        Points ``radius`` before and behind the middle part by 2 w radius / (distance^2 - radius^2) after w metres, of which a
        quadrilateral between them is off by half.
        """
        left = np.maximum(distance * distance - radius * radius, 0.0)
        found: NDArray[np.float64] = self._images.limit * left / np.maximum(radius, 1e-9)
        return found

    # -------------------------------------------------------------------------------------------------- capturing

    def _update(self, nodes: NDArray[np.int64], view: View, frame: _Frame) -> None:
        """Capture images of ``nodes`` (k,) anew: with a budget what is in view first, and of that what is most wrong."""
        if frame.left <= 0.0 or not len(nodes):
            return
        if not frame.strict:
            seen = boxes_within_view(self._tree.boxes[nodes], view)
            nodes = nodes[np.lexsort((nodes, -self._images.errors(nodes, view.eye), ~seen))]
        captures = captures_of(view.eye, self._tree.boxes[nodes], self._images.sharpness)
        for place, node in enumerate(nodes.tolist()):
            if frame.left <= 0.0:
                break
            self._capture(node, captures, place, frame)
        self._images.settle(np.array(frame.new + frame.combined, dtype=np.int64))

    def _capture(self, node: int, captures: Captures, place: int, frame: _Frame) -> bool:
        """Order an image of a node, and of nodes within it that it needs; whether there is one now."""
        if not captures.possible[place]:
            return False
        width, height = captures.windows[place, 2:].tolist()
        most = max(2.0 * frame.worth.relief * width * height, _WORTH_COMBINING * frame.worth.request)
        sources, rest = np.zeros(0, dtype=np.int64), np.array([node])
        generation, inherited = 0, 0.0
        costly = self._rules.eager or frame.worth.captured * int(self._counts[node]) > most
        if costly and not self._leaf[node] and self._images.may_combine:
            found = self._sources(node, frame)
            if found is None:
                return False
            sources, rest = found
        if len(sources):
            generation = 1 + int(self._images.generations[sources].max())
            inherited = float(self._images.handed_on(sources, frame.eye, self._frame).max())
        slot = self._atlases.take(node, (width, height), generation, self._images.used, self._frame)
        if slot is None:
            self._images.drop(node)
            return False
        view = View(
            captures.eye_from_world[place], self._images.sharpness.texel_focal, (*captures.windows[place].tolist(),)
        )
        draws: list[Draw] = list(self._images.boards(sources, self._frame))
        numbers = self._tree.triangles_of(rest)
        if len(numbers):
            draws.append(Faces("", numbers, captures.boxes[place]))
        request = Request(slot, view, tuple(draws))
        frame.requests.append(request)
        relief = sum(one.pixels for one in draws if isinstance(one, Nailboards))
        frame.left -= frame.costs.of_request(
            triangles=len(numbers), draws=len(draws), pixels=request.pixels, relief=relief
        )
        self._images.keep(
            node, slot, frame.eye, captures, place, inherited=inherited, generation=generation, frame=self._frame
        )
        (frame.combined if len(sources) else frame.new).append(node)
        return True

    def _sources(self, node: int, frame: _Frame) -> tuple[NDArray[np.int64], NDArray[np.int64]] | None:
        """What a node's image is drawn from: images of nodes within it, and nodes whose primitives are drawn.

        An image that there is serves where it may hand on what it is wrong by. Where there is none, a node of few enough
        primitives gets one, which serves for longer than its parent's, and others are looked into. None where the budget ends
        before all of them have one: they are there in the next frame.
        """
        sources: list[int] = []
        rest: list[int] = []
        waiting = self._tree.children_of(np.array([node]))
        limit = _HANDED_ON * self._images.limit
        costs, thrifty = frame.worth, not self._rules.eager
        while len(waiting):
            captures = captures_of(frame.eye, self._tree.boxes[waiting], self._images.sharpness)
            usable = self._images.handed_on(waiting, frame.eye, self._frame) <= limit
            self._images.used[waiting[usable]] = (
                self._frame
            )  # so that no other, nor one beside, takes their place meanwhile
            pixels = captures.windows[:, 2].astype(np.float64) * captures.windows[:, 3]
            takes = costs.captured * self._counts[waiting]
            few = thrifty & (takes <= costs.draw + costs.relief * pixels)
            small = self._leaf[waiting] | (thrifty & (takes <= _WORTH_COMBINING * costs.request))
            deeper: list[int] = []
            for place, one in enumerate(waiting.tolist()):
                if few[place]:
                    rest.append(one)
                elif usable[place]:
                    sources.append(one)
                elif not small[place]:
                    deeper.append(one)
                elif frame.left <= 0.0:
                    return None
                elif self._capture(one, captures, place, frame):
                    sources.append(one)
                else:
                    rest.append(one)
            waiting = self._tree.children_of(np.array(deeper, dtype=np.int64))
        return np.array(sources, dtype=np.int64), np.array(rest, dtype=np.int64)

    # ---------------------------------------------------------------------------------------------------- drawing

    def _shown(
        self, nodes: NDArray[np.int64], frame: _Frame
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
        """Of nodes that should be images: images to show for them, which of these are late, and nodes to draw instead.

        Without a valid image a node is drawn as what is within it; with a budget an image that is a little wrong serves too.
        """
        shown, late, drawn = [], [], []
        waiting = nodes
        while len(waiting):
            valid = self._images.valid(waiting, frame.eye)
            shown.append(waiting[valid])
            left = waiting[~valid]
            if not frame.strict:
                wrong = self._images.errors(left, frame.eye) <= _LATEST * self._images.limit
                late.append(left[wrong])
                left = left[~wrong]
            if not len(left):
                break
            ends = self._leaf[left] | (self._counts[left] <= _FEW) | ~self._images_within()[left]
            drawn.append(left[ends])
            waiting = self._tree.children_of(left[~ends])
        wrongly = np.concatenate([np.zeros(0, dtype=np.int64), *late])
        found = np.concatenate([np.zeros(0, dtype=np.int64), *shown, wrongly])
        self._images.used[found] = self._frame
        return found, wrongly, np.concatenate([np.zeros(0, dtype=np.int64), *drawn])

    def _images_within(self) -> NDArray[np.bool_]:
        """(n,) which nodes have an image, or hold one that has."""
        found = self._images.there.copy()
        levels = self._tree.levels
        for first, end in zip(levels[-2:0:-1], levels[:1:-1], strict=True):
            found[self._tree.parents[first:end][found[first:end]]] = True
        return found

    def _whole(self, node: int) -> Faces:
        """What draws all triangles of a node, which the renderer keeps: it is drawn until the node has an image."""
        if node not in self._wholes:
            if len(self._wholes) >= _MOST_WHOLES:
                self._wholes.clear()
            self._wholes[node] = Faces(f"{self.owner} node {node}", self._tree.triangles_of(node))
        return self._wholes[node]

    def _primitives(self, nodes: NDArray[np.int64]) -> tuple[Faces, ...]:
        """What draws all triangles of ``nodes``; the same nodes have the same key.

        They are in the mesh's order, each once: of surfaces that coincide, the first is seen.
        """
        if not len(nodes):
            return ()
        told = np.sort(nodes).tobytes()
        if self._direct is None or self._direct[0] != told:
            key = f"{self.owner} {blake2b(told, digest_size=8).hexdigest()}"
            self._direct = told, Faces(key, self._tree.triangles_of(nodes))
        return (self._direct[1],)

    def _count(
        self,
        frame: _Frame,
        reused: NDArray[np.int64],
        direct: NDArray[np.int64],
        shown: NDArray[np.int64],
        late: NDArray[np.int64],
    ) -> None:
        errors = self._images.errors(shown, frame.eye)
        kept = float(errors[np.isfinite(errors)].max(initial=0.0)) / self._images.sharpness.pixel
        self.kinds = {
            "new": np.array(frame.new, dtype=np.int64),
            "combined": np.array(frame.combined, dtype=np.int64),
            "reused": reused,
            "impossible": direct,
        }
        new, combined = len(frame.new), len(frame.combined)
        self.latest = CacheTally(1, new, combined, len(reused), len(direct), len(late), kept, self._atlases.bytes)
        self.tally = self.tally.plus(self.latest)
