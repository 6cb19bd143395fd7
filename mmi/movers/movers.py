"""Objects that move: each has a shape and passes poses at given times; where it is between them is interpolated here.

A pose is a position and three angles. The object's own frame has +x ahead, +y to its left and +z up, and what stands on the
ground stands on z = 0 there. Nothing here knows what shows them, or which of them a view sees.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from mmi.city.model import TriangleMesh
from mmi.foundation.errors import ParameterError
from mmi.foundation.kernels import kernel

__all__ = ["LARGEST", "NOTHING_MOVES", "SHORTEST", "Movers", "distances", "pose_matrices"]

LARGEST = 1e7
"""The largest number of seconds, metres or radians in a pose; beyond it, differences are lost in rounding."""
SHORTEST = 1e-3
"""Seconds between two poses of an object, at least."""
_Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Movers:
    """``n`` objects with ``k`` poses in all.

    Object i is called ``ids[i]`` and looks like ``meshes[kinds[i]]``, which has the name ``names[kinds[i]]``. Its poses are
    those from ``starts[i]`` to ``starts[i + 1]`` (n + 1,): at ``times`` (k,) seconds its frame's origin is at ``positions``
    (k, 3) metres, and ``angles`` (k, 3) radians turn it: its heading counter-clockwise from +x, its pitch (the nose goes up)
    and its roll (the left side goes up), about the axes that it has then. Before its first and after its last pose it stands
    there if ``stays`` (n,), and otherwise it is not in the city.

    Positions are in the frame of a city: coordinates of ``crs`` less ``origin``. ``source`` is the file's name for messages.

    Raises ParameterError unless all of that fits: unique ids, each object with a pose, finite numbers up to 1e7, times of an
    object that grow by a millisecond or more, and shapes with triangles, of plain colours.
    """

    ids: tuple[str, ...]
    kinds: NDArray[np.int64]
    names: tuple[str, ...]
    meshes: tuple[TriangleMesh, ...]
    starts: NDArray[np.int64]
    times: _Floats
    positions: _Floats
    angles: _Floats
    stays: NDArray[np.bool_]
    crs: str = "local"
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    source: str = "movers"
    boxes: _Floats = field(init=False)
    """(n, 2, 3) the lowest and the highest corner of each object's shape in its own frame, metres."""
    reach: _Floats = field(init=False)
    """(n,) metres from the origin of each object's frame to the farthest point of its shape."""

    def __post_init__(self) -> None:
        n, k = len(self.ids), len(self.times)
        arrays = (self.kinds, self.starts, self.times, self.positions, self.angles, self.stays)
        shapes = tuple(one.shape for one in arrays)
        if shapes != ((n,), (n + 1,), (k,), (k, 3), (k, 3), (n,)):
            raise ParameterError(
                f"{self.source}: kinds (n,), starts (n + 1,), times (k,), positions (k, 3), angles (k, 3) and stays (n,) "
                f"expected for {n} objects and {k} poses, found {shapes}"
            )
        self._check_names()
        self._check_poses()
        ends = [(mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)) for mesh in self.meshes]
        object.__setattr__(self, "boxes", np.array(ends, dtype=np.float64).reshape(-1, 2, 3)[self.kinds])
        far = [float(np.linalg.norm(mesh.vertices, axis=1).max()) for mesh in self.meshes]
        object.__setattr__(self, "reach", np.array(far, dtype=np.float64)[self.kinds])
        for one in (*arrays, self.boxes, self.reach):
            one.setflags(write=False)

    def _check_names(self) -> None:
        strange = next((one for one in (*self.ids, *self.names, self.crs) if not _is_text(one)), None)
        if strange is not None:
            raise ParameterError(f"{self.source}: ids and names of whole characters expected, found {strange[:80]!r}")
        if len(set(self.ids)) < len(self.ids):
            twice = next(one for one, count in Counter(self.ids).items() if count > 1)
            raise ParameterError(f"{self.source}: object {twice[:80]}: an id of its own expected, found it twice")
        if len(self.names) != len(self.meshes) or len(set(self.names)) < len(self.names):
            raise ParameterError(f"{self.source}: a name of its own for each of {len(self.meshes)} meshes expected")
        if len(self.kinds) and not 0 <= self.kinds.min() <= self.kinds.max() < len(self.meshes):
            raise ParameterError(f"{self.source}: kinds below {len(self.meshes)} expected, found {self.kinds.max()}")
        for name, mesh in zip(self.names, self.meshes, strict=True):
            if not len(mesh.triangles) or (mesh.textures >= 0).any() or not (np.abs(mesh.vertices) <= LARGEST).all():
                raise ParameterError(
                    f"{self.source}: mesh {name}: triangles of plain colours within {LARGEST:.0f} m expected"
                )
        if len(self.origin) != 3 or not all(abs(one) <= 1e9 for one in self.origin):
            raise ParameterError(f"{self.source}: an origin of three numbers expected, found {self.origin!r}")

    def _check_poses(self) -> None:
        if self.starts[0] != 0 or self.starts[-1] != len(self.times) or (np.diff(self.starts) < 1).any():
            lone = self.ids[int(np.argmin(np.diff(self.starts)))] if self.ids else ""
            raise ParameterError(f"{self.source}: object {lone}: at least one pose expected, found none")
        for name, values in (("time", self.times), ("position", self.positions), ("angle", self.angles)):
            good = np.abs(values) <= LARGEST  # false for what is no number
            if not good.all():
                key = int(np.argmin(good.reshape(len(good), -1).all(axis=1)))
                raise ParameterError(
                    f"{self._place(key)}: {name}: numbers up to {LARGEST:.0f} expected, found {values[key].tolist()}"
                )
        late = np.diff(self.times) >= SHORTEST * (1.0 - 1e-6)
        late[self.starts[1:-1] - 1] = True
        if not late.all():
            key = int(np.argmin(late)) + 1
            raise ParameterError(
                f"{self._place(key)}: time: at least {SHORTEST:g} s after the {self.times[key - 1]:g} s of the pose before "
                f"expected, found {self.times[key]:g}"
            )

    def _place(self, key: int) -> str:
        """Whose pose a key is, for messages, which count poses from 1."""
        which = int(np.searchsorted(self.starts, key, side="right")) - 1
        return f"{self.source}: object {self.ids[which]}: pose {key - self.starts[which] + 1}"

    @property
    def span(self) -> tuple[float, float]:
        """The first and the last time of all poses, seconds; (0, 0) where nothing moves."""
        return (float(self.times.min()), float(self.times.max())) if len(self.times) else (0.0, 0.0)

    def present(self, time: float) -> NDArray[np.bool_]:
        """(n,) which objects are in the city at ``time`` (seconds)."""
        return self.stays | ((self.times[self.starts[:-1]] <= time) & (time <= self.times[self.starts[1:] - 1]))

    def places(self, time: float) -> _Floats:
        """(n, 3) where the origin of every object's frame is at ``time`` (seconds), as :meth:`poses` has it."""
        before, after, share = self._moment(time, self.starts[:-1], self.starts[1:])
        return np.asarray(self.positions[before] + share * (self.positions[after] - self.positions[before]))

    def poses(self, time: float, which: NDArray[np.int64] | None = None) -> _Floats:
        """(k, 4, 4) world_from_model of the objects ``which`` (k,) at ``time`` (seconds), there (:meth:`present`) or not.

        None stands for all. Between two poses positions move on a straight line at constant speed, and each angle the short way
        round. Before its first pose an object stands in that one, after its last one in the last.
        """
        firsts, ends = self.starts[:-1], self.starts[1:]
        if which is not None:
            firsts, ends = firsts[which], ends[which]
        before, after, share = self._moment(time, firsts, ends)
        turned = self.angles[after] - self.angles[before]
        turned -= 2.0 * np.pi * np.rint(turned / (2.0 * np.pi))
        places = self.positions[before] + share * (self.positions[after] - self.positions[before])
        return pose_matrices(places, self.angles[before] + share * turned)

    def _moment(
        self, time: float, firsts: NDArray[np.int64], ends: NDArray[np.int64]
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], _Floats]:
        """Of tracks from ``firsts`` (k,) to ``ends`` (k,): the poses before and after ``time``, and the share (k, 1) of the
        way from one to the other.
        """
        before = _last_before(self.times, firsts, ends, time)
        after = np.minimum(before + 1, ends - 1)
        spent = self.times[after] - self.times[before]
        return (
            before,
            after,
            np.clip((time - self.times[before]) / np.where(spent > 0.0, spent, 1.0), 0.0, 1.0)[:, None],
        )

    def corners(self, poses: _Floats, which: NDArray[np.int64] | None = None) -> _Floats:
        """(k, 8, 3) the corners of the boxes of ``which`` (k,) objects in the world, metres, for ``poses`` (k, 4, 4)."""
        boxes = self.boxes if which is None else self.boxes[which]
        pick = np.array([[(k >> axis) & 1 for axis in range(3)] for k in range(8)], dtype=bool)
        own = np.where(pick, boxes[:, None, 1], boxes[:, None, 0])
        return np.asarray(own @ np.swapaxes(poses[:, :3, :3], 1, 2) + poses[:, None, :3, 3])

    def in_frame(self, *, crs: str, origin: Sequence[float]) -> Movers:
        """The same objects in another frame of the same coordinate system. Raises ParameterError where that is another.

        No objects at all are at home in every frame.
        """
        if not self.ids:
            return self
        if crs != self.crs:
            raise ParameterError(
                f"{self.source}: movers in the city's coordinate system {crs} expected, found {self.crs}"
            )
        shift = np.array(self.origin) - np.array(origin, dtype=np.float64)
        x, y, z = (float(one) for one in origin)
        return self if not shift.any() else replace(self, positions=self.positions + shift, origin=(x, y, z))


def pose_matrices(positions: _Floats, angles: _Floats) -> _Floats:
    """(n, 4, 4) world_from_model for ``positions`` (n, 3) and ``angles`` (n, 3): heading, pitch and roll in radians."""
    (ch, cp, cr), (sh, sp, sr) = np.cos(angles).T, np.sin(angles).T
    matrices = np.zeros((len(positions), 4, 4))
    matrices[:, 0, 0], matrices[:, 0, 1], matrices[:, 0, 2] = ch * cp, -sh * cr - ch * sp * sr, sh * sr - ch * sp * cr
    matrices[:, 1, 0], matrices[:, 1, 1], matrices[:, 1, 2] = sh * cp, ch * cr - sh * sp * sr, -ch * sr - sh * sp * cr
    matrices[:, 2, 0], matrices[:, 2, 1], matrices[:, 2, 2] = sp, cp * sr, cp * cr
    matrices[:, :3, 3], matrices[:, 3, 3] = positions, 1.0
    return matrices


def distances(eye: _Floats, poses: _Floats, boxes: _Floats) -> _Floats:
    """(n,) metres from ``eye`` (3,) to each of ``boxes`` (n, 2, 3), which ``poses`` (n, 4, 4) move into the world; 0 inside."""
    own = ((eye - poses[:, :3, 3])[:, None, :] @ poses[:, :3, :3])[:, 0]
    return np.asarray(np.linalg.norm(np.maximum(np.maximum(boxes[:, 0] - own, own - boxes[:, 1]), 0.0), axis=1))


@kernel()
def _last_before(
    times: NDArray[np.float64], firsts: NDArray[np.int64], ends: NDArray[np.int64], time: float
) -> NDArray[np.int64]:
    """(k,) the last pose of each track that is not after ``time``, or its first, by halving."""
    found = np.empty(len(firsts), dtype=np.int64)
    for i in range(len(found)):
        low, high = firsts[i], ends[i] - 1
        while low < high:
            middle = (low + high + 1) // 2
            if times[middle] <= time:
                low = middle
            else:
                high = middle - 1
        found[i] = low
    return found


def _is_text(text: str) -> bool:
    """Whether it is not empty, and no half of a character."""
    return bool(text) and not any("\ud800" <= letter <= "\udfff" for letter in text)


NOTHING_MOVES = Movers(
    ids=(),
    kinds=np.zeros(0, dtype=np.int64),
    names=(),
    meshes=(),
    starts=np.zeros(1, dtype=np.int64),
    times=np.zeros(0),
    positions=np.zeros((0, 3)),
    angles=np.zeros((0, 3)),
    stays=np.zeros(0, dtype=bool),
)
"""No objects at all."""
