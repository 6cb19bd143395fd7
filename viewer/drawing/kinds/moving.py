"""Geometry of objects that move: a call for each shape that shows, for all objects of that shape.

The light on a surface depends on how it stands (``mmi.appearance.shading``), so that it is worked out for each frame and not
baked into colours, as that of the city is. Positions go to OpenGL relative to the eye, since float32 does not hold a city's.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mmi.appearance.shading import SKY_GAIN, SKY_SHARES, SKYLIGHT, SUN, SUNLIGHT
from mmi.city.model import TriangleMesh
from mmi.foundation.camera import View
from mmi.movers.movers import Movers
from viewer.drawing.programs import MODES, Programs
from viewer.plan import Moving

__all__ = ["MovingDrawer"]

_VERTEX = """
uniform vec3 sunlight; uniform vec3 skylight; uniform vec2 sky_shares;
in vec3 position; in vec3 normal; in vec3 color;
in vec4 x_from_model; in vec4 y_from_model; in vec4 z_from_model;  // rows of the eye's frame from the object's
in vec3 sun; in vec3 up;                                           // in the object's frame
in int object;
out vec3 tint; flat out int which; out float depth;
void main() {
    vec4 own = vec4(position, 1.0);
    vec3 p = vec3(dot(x_from_model, own), dot(y_from_model, own), dot(z_from_model, own));
    vec3 light = sunlight * max(dot(normal, sun), 0.0) + skylight * (sky_shares.x + sky_shares.y * dot(normal, up));
    tint = color * min(light, vec3(1.0)); which = object; depth = -p.z;
    gl_Position = project(p);
}
"""
_FRAGMENT = """
in vec3 tint; flat in int which; in float depth;
void main() {
    color_out = vec4(tint, 1.0);
#ifdef MEASURED
    id_out = which; surface_out = vec2(depth, -1.0);
#endif
}
"""
_CORNER = np.dtype([("position", "<f4", 3), ("normal", "<f4", 3), ("color", "u1", 4)])
_INSTANCE = np.dtype([("rows", "<f4", (3, 4)), ("sun", "<f4", 3), ("up", "<f4", 3), ("object", "<i4")])
_ROWS = ("x_from_model", "y_from_model", "z_from_model", "sun", "up")


@dataclass(slots=True, eq=False)
class _Shape:
    """A shape on the GPU, with room for how ``room`` objects of it stand."""

    corners: Any
    indices: Any
    triangles: int
    room: int = 0
    instances: Any = None
    arrays: dict[bool, Any] | None = None


class MovingDrawer:
    """Draws :class:`viewer.plan.Moving` of ``movers``, whose ids in measured pictures begin at ``first``."""

    def __init__(self, programs: Programs, movers: Movers, *, first: int) -> None:
        self._context, self._movers, self._first = programs.context, movers, first
        self._programs = programs.make(_VERTEX, _FRAGMENT)
        told = {"sunlight": SUNLIGHT, "skylight": SKYLIGHT * SKY_GAIN, "sky_shares": np.array(SKY_SHARES)}
        for mode in MODES:
            self._programs[mode].set({name: value.astype("<f4").tobytes() for name, value in told.items()})
        self._shapes = [self._shape(mesh) for mesh in movers.meshes]

    def draw(self, draw: Moving, view: View, *, measured: bool) -> list[int]:
        """Draw all objects, with a call for each shape. Raises IndexError for objects that there are not."""
        kinds = self._movers.kinds[draw.which]
        instances = np.zeros(len(kinds), dtype=_INSTANCE)
        instances["rows"] = (view.eye_from_world @ draw.poses)[:, :3]
        instances["sun"], instances["up"] = SUN @ draw.poses[:, :3, :3], draw.poses[:, 2, :3]
        instances["object"] = self._first + draw.which
        counts = []
        for kind in np.unique(kinds).tolist():
            shape, some = self._shapes[kind], instances[kinds == kind]
            self._make_room(shape, len(some))
            assert shape.arrays is not None
            shape.instances.orphan()
            shape.instances.write(some.tobytes())
            shape.arrays[measured].render(instances=len(some))
            counts.append(shape.triangles * len(some))
        return counts

    def _shape(self, mesh: TriangleMesh) -> _Shape:
        corners, indices = _corners(mesh)
        return _Shape(
            self._context.buffer(corners.tobytes()), self._context.buffer(indices.tobytes()), len(indices) // 3
        )

    def _make_room(self, shape: _Shape, count: int) -> None:
        """Have room for so many objects."""
        if shape.room >= count:
            return
        if shape.arrays is not None:
            for thing in (*shape.arrays.values(), shape.instances):
                thing.release()
        shape.room = 1 << max(count - 1, 15).bit_length()
        shape.instances = self._context.buffer(reserve=shape.room * _INSTANCE.itemsize, dynamic=True)
        shape.arrays = {}
        for mode in MODES:
            corners = (shape.corners, "3f 3f 3f1 x1", "position", "normal", "color")
            objects = [shape.instances, "4f 4f 4f 3f 3f 1i/i" if mode else "4f 4f 4f 3f 3f x4/i", *_ROWS]
            shape.arrays[mode] = self._context.vertex_array(
                self._programs[mode].program, [corners, (*objects, "object") if mode else tuple(objects)], shape.indices
            )


def _corners(mesh: TriangleMesh) -> tuple[NDArray[np.void], NDArray[np.int32]]:
    """Corners that are unlike each other, and triangles as their places; those of triangles without an area have no normal."""
    points = mesh.vertices[mesh.triangles]
    normals = np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0])
    size = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.divide(normals, size, out=np.zeros_like(normals), where=size > 1e-12)
    every = np.zeros((len(points), 3), dtype=_CORNER)
    every["position"], every["normal"] = points, normals[:, None]
    every["color"][..., :3] = mesh.colors[:, None]
    found, places = np.unique(every.reshape(-1).view("V" + str(_CORNER.itemsize)), return_inverse=True)
    return found.view(_CORNER), places.astype("<i4")
