"""For how many whole frames an image stays valid, where the viewer moves, and the object with its image too.

An image that moves with its object is wrong by what it would be if neither moved and the viewer were elsewhere: at the
relative viewpoint, into which the object's movement is undone (Duckstein, figures 5 and 6). So movement only changes how
far that viewpoint may come in a frame. The paper's equation (5) takes the first step for all; where an object turns, later
steps are longer. What is here holds for every frame until the last that it promises.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = [
    "MANY",
    "frames_at_equal_steps",
    "frames_left",
    "frames_within_limits",
    "left_behind_angle",
    "relative_viewpoint",
    "viewpoint_step",
]

MANY = 1 << 31
"""Frames that stand for no end."""


def frames_left(distance: ArrayLike, relative_steps: ArrayLike) -> NDArray[np.int64]:
    """Whole frames (n,) in which steps of at most ``relative_steps`` metres stay within ``distance``: equation (4)."""
    way, step = np.broadcast_arrays(np.asarray(distance, np.float64), np.asarray(relative_steps, np.float64))
    frames = np.divide(way, step, out=np.full(way.shape, float(MANY)), where=(step > 0.0) & np.isfinite(way))
    return np.minimum(np.floor(frames), MANY).astype(np.int64)


def relative_viewpoint(moved: ArrayLike, eye: ArrayLike) -> NDArray[np.float64]:
    """Where ``eye`` (..., 3) is from an object before it was ``moved`` (..., 4, 4): a rotation and a translation, undone."""
    matrix = np.asarray(moved, dtype=np.float64)
    back = np.asarray(eye, dtype=np.float64) - matrix[..., :3, 3]
    return np.asarray(np.einsum("...ji,...j->...i", matrix[..., :3, :3], back))


def viewpoint_step(moved: ArrayLike, eye: ArrayLike, step: ArrayLike, frame: ArrayLike) -> NDArray[np.float64]:
    """Metres (n,) that the relative viewpoint makes in ``frame`` (the first is 1), when every frame is like the last.

    In each, objects are ``moved`` (n, 4, 4) once more, and the viewer, first at ``eye`` (3,), goes on by ``step`` (3,). With
    M for ``moved``, the relative viewpoints M^-k (e + k s) and M^-(k-1) (e + (k-1) s) are as far apart as M^-1 (e + k s) and
    e + (k-1) s. Frame 1 is the denominator of equation (5).
    """
    count = np.asarray(frame, dtype=np.float64)[..., None]
    pace = np.asarray(step, dtype=np.float64)
    before = np.asarray(eye, dtype=np.float64) + (count - 1.0) * pace
    return np.asarray(np.linalg.norm(relative_viewpoint(moved, before + pace) - before, axis=-1))


def frames_at_equal_steps(
    distance: ArrayLike, moved: ArrayLike, eye: ArrayLike, step: ArrayLike, *, most: int = MANY
) -> NDArray[np.int64]:
    """Whole frames (n,), at most ``most``, in which relative viewpoints stay within ``distance``, when every frame is alike.

    Arguments are those of :func:`viewpoint_step`. The offset whose length is the step in frame k is linear in k, so the length
    is convex, and the first n together are at most n times the mean of the first and the n-th. Where the steps are equal, that
    is equation (5). A viewer that drives along with an object gains from it, as in the paper.
    """
    first = viewpoint_step(moved, eye, step, 1)

    def reached(frames: NDArray[np.int64]) -> NDArray[np.float64]:
        return np.asarray(frames * 0.5 * (first + viewpoint_step(moved, eye, step, frames)))

    return _most_frames(np.asarray(distance, dtype=np.float64), first.shape, reached, most)


def frames_within_limits(
    distance: ArrayLike, *, speed: ArrayLike, turn: ArrayLike = 0.0, arm: ArrayLike = 0.0, most: int = MANY
) -> NDArray[np.int64]:
    """Whole frames (n,), at most ``most``, in which relative viewpoints stay within ``distance``, however things move.

    In a frame, viewer and object together move by ``speed`` metres at most, and the object turns by ``turn`` radians at most
    around a point of its own that is ``arm`` metres from where its image was captured. After n frames the viewer has moved
    relative to that point by n ``speed``, and the object turned by n ``turn``, which is a chord of 2 arm sin(n turn / 2).
    """
    swift, turned, far = (np.asarray(one, dtype=np.float64) for one in (speed, turn, arm))

    def reached(frames: NDArray[np.int64]) -> NDArray[np.float64]:
        return np.asarray(frames * swift + 2.0 * far * np.sin(0.5 * np.minimum(frames * turned, math.pi)))

    shape = np.broadcast_shapes(np.shape(distance), swift.shape, turned.shape, far.shape)
    return _most_frames(np.asarray(distance, dtype=np.float64), shape, reached, most)


def left_behind_angle(eye: ArrayLike, boxes: ArrayLike, moved: ArrayLike) -> NDArray[np.float64]:
    """Radians (n,) to add to an error angle where ``boxes`` (n, 2, 3) were ``moved`` (n, 4, 4) and their images were not.

    What a point moves by is linear in the point, so corners move farthest, by m. Seen from ``eye``, both ends of that way are
    at least the box's distance less m away.
    """
    matrix, both, viewer = (np.asarray(one, dtype=np.float64) for one in (moved, boxes, eye))
    most = np.zeros(len(both))
    for i, j, k in np.ndindex(2, 2, 2):
        corner = np.stack((both[:, i, 0], both[:, j, 1], both[:, k, 2]), axis=-1)
        after = np.einsum("nij,nj->ni", matrix[:, :3, :3], corner) + matrix[:, :3, 3]
        most = np.maximum(most, np.linalg.norm(after - corner, axis=-1))
    outside = np.maximum(np.maximum(both[:, 0] - viewer, viewer - both[:, 1]), 0.0)
    left = np.linalg.norm(outside, axis=-1) - most
    half = np.divide(0.5 * most, left, out=np.ones(len(most)), where=left > 0.0)
    return np.where(most > 0.0, 2.0 * np.arcsin(np.minimum(half, 1.0)), 0.0)


def _most_frames(
    distance: NDArray[np.float64],
    shape: tuple[int, ...],
    reached: Callable[[NDArray[np.int64]], NDArray[np.float64]],
    most: int,
) -> NDArray[np.int64]:
    """The last frame by whose bound ``reached`` is within ``distance``, by halving: any that is found keeps its promise."""
    whole = np.broadcast_shapes(distance.shape, shape)
    low, high = np.zeros(whole, dtype=np.int64), np.full(whole, most + 1, dtype=np.int64)
    while np.any(high - low > 1):
        middle = (low + high) // 2
        kept = reached(middle) <= distance
        low, high = np.where(kept, middle, low), np.where(kept, high, middle)
    return low
