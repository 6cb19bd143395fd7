"""The images that boxes of a tree have at the moment: from where, how wrong they are now, and where they are on the GPU.

An image of generation 0 is drawn from primitives, one of generation g from images of generations below. It inherits what they
were wrong by when it was captured, and half a texel's diagonal, since it samples their texels anew. Generations have atlases of
their own: what is captured never samples the picture that it is drawn into.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mmi.validity.images import Flat, error_angle, safe_distance
from viewer.caching.captures import Captures, Sharpness
from viewer.plan import ImageKey, Nailboards, Slot

__all__ = ["GENERATIONS", "NodeImages"]

GENERATIONS = 3
"""Images of the last are combined no further."""
_SAMPLED = math.sqrt(0.5)
"""Texels that sampling them anew adds to what an image is wrong by."""
_FLICKERING = 0.5
"""An image that is shown at less than this share of its size would flicker."""


class NodeImages:
    """Of all ``boxes`` (n, 2, 3) of a tree; ``limit`` is what an image may be wrong by, radians."""

    def __init__(self, boxes: NDArray[np.float64], sharpness: Sharpness, limit: float) -> None:
        n = len(boxes)
        self.sharpness, self.limit = sharpness, limit
        self._middles = 0.5 * (boxes[:, 0] + boxes[:, 1])
        self._images: list[ImageKey] = []
        self._atlas = np.full(n, -1, dtype=np.int64)
        self._captures, self._shown = np.zeros((n, 4, 4)), np.zeros((n, 2, 3))
        self._windows, self._corners = np.zeros((n, 4), dtype=np.int64), np.zeros((n, 2), dtype=np.int64)
        self._eyes, self._depths, self._distances = np.zeros((n, 3)), np.zeros(n), np.zeros(n)
        self._safe, self._inherited = np.zeros(n), np.zeros(n)
        self.generations = np.zeros(n, dtype=np.int64)
        """(n,) of each node's image."""
        self.captured = np.full(n, -1, dtype=np.int64)
        """(n,) the frame in which each node's image was captured; -1 for none."""
        self.used = np.full(n, -1, dtype=np.int64)
        """(n,) the frame in which each node's image was last needed."""

    @property
    def there(self) -> NDArray[np.bool_]:
        """(n,) which nodes have an image."""
        return self._atlas >= 0

    @property
    def may_combine(self) -> bool:
        """Whether an image may be drawn from others at all: it inherits part of a texel even of those captured from there."""
        return _SAMPLED / self.sharpness.texel_focal <= self.limit

    def keep(
        self,
        node: int,
        slot: Slot,
        eye: NDArray[np.float64],
        captures: Captures,
        place: int,
        *,
        inherited: float,
        generation: int,
        frame: int,
    ) -> None:
        """A node has the image in ``slot``, captured as the one at ``place`` of ``captures``."""
        if slot.image not in self._images:
            self._images.append(slot.image)
        self._atlas[node] = self._images.index(slot.image)
        self._captures[node], self._windows[node] = captures.eye_from_world[place], captures.windows[place]
        self._corners[node], self._depths[node] = slot.corner, captures.depths[place]
        self._shown[node], self._eyes[node] = captures.boxes[place], eye
        self._distances[node] = np.linalg.norm(self._middles[node] - eye)
        self._inherited[node], self.generations[node] = inherited, generation
        self.captured[node] = self.used[node] = frame
        self._safe[node] = 0.0

    def settle(self, nodes: NDArray[np.int64]) -> None:
        """Find out for how far the viewer may go whichever way while images of ``nodes`` (k,), just captured, stay valid."""
        self._safe[nodes] = safe_distance(
            self._eyes[nodes],
            self._shown[nodes],
            Flat(distance=self._depths[nodes]),
            self.limit,
            inherited=self._inherited[nodes],
        )

    def handed_on(self, nodes: NDArray[np.int64], eye: NDArray[np.float64], frame: int) -> NDArray[np.float64]:
        """Radians (k,) that an image inherits which is drawn from that of one of ``nodes`` (k,): what that is wrong by, and
        half the diagonal of a texel as it is seen now. Infinite where there is none, or it is of the last generation.
        """
        found = self._inherited[nodes].copy()
        before = np.flatnonzero(self.captured[nodes] != frame)  # the others are captured from here
        found[before] = self.errors(nodes[before], eye)
        found[(self._atlas[nodes] < 0) | (self.generations[nodes] >= GENERATIONS - 1)] = np.inf
        return found + _SAMPLED / self.sharpness.texel_focal * self._scales(nodes, eye)

    def _scales(self, nodes: NDArray[np.int64], eye: NDArray[np.float64]) -> NDArray[np.float64]:
        """(k,) by how much larger than when they were captured images of ``nodes`` (k,) are seen from ``eye`` (3,)."""
        distances = np.linalg.norm(self._middles[nodes] - eye, axis=1)
        scales: NDArray[np.float64] = self._distances[nodes] / np.maximum(distances, 1e-12)
        return scales

    def drop(self, node: int) -> None:
        """A node has no image any more."""
        self._atlas[node], self.captured[node] = -1, -1

    def errors(self, nodes: NDArray[np.int64], eye: NDArray[np.float64]) -> NDArray[np.float64]:
        """Radians (k,) by which images of ``nodes`` (k,) are wrong at most, from ``eye`` (3,); infinite without an image, and
        where its texels would show or flicker.
        """
        found = np.full(len(nodes), np.inf)
        there = self._atlas[nodes] >= 0
        some = nodes[there]
        if not len(some):
            return found
        scale = self._scales(some, eye)
        errors = error_angle(
            eye, self._eyes[some], self._shown[some], Flat(distance=self._depths[some]), inherited=self._inherited[some]
        )
        found[there] = np.where((scale <= self.sharpness.finer) & (scale >= _FLICKERING), errors, np.inf)
        return found

    def valid(self, nodes: NDArray[np.int64], eye: NDArray[np.float64]) -> NDArray[np.bool_]:
        """(k,) which of ``nodes`` (k,) have an image that may be shown from ``eye`` (3,).

        Near where they were captured they may whatever the way there; only beyond is it asked what they are wrong by.
        """
        found = self._atlas[nodes] >= 0
        scale = self._scales(nodes, eye)
        found &= (scale <= self.sharpness.finer) & (scale >= _FLICKERING)
        away = np.linalg.norm(self._eyes[nodes] - eye, axis=1)
        beyond = np.flatnonzero(found & (away > self._safe[nodes]))
        found[beyond] = self.errors(nodes[beyond], eye) <= self.limit
        return found

    def boards(self, nodes: NDArray[np.int64], frame: int) -> tuple[Nailboards, ...]:
        """What shows images of ``nodes`` (k,), those of an atlas together. Raises KeyError for a node that has none."""
        if (self._atlas[nodes] < 0).any():
            raise KeyError(f"nodes that have images expected, found {nodes[self._atlas[nodes] < 0][0]} among them")
        found = []
        for number in np.unique(self._atlas[nodes]).tolist():
            some = nodes[self._atlas[nodes] == number]
            found.append(
                Nailboards(
                    image=self._images[number],
                    focal=self.sharpness.texel_focal,
                    captures=self._captures[some],
                    windows=self._windows[some],
                    corners=self._corners[some],
                    depths=self._depths[some],
                    fresh=self.captured[some] == frame,
                )
            )
        return tuple(found)
