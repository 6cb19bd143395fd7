"""Textured meshes on the GPU: a vertex buffer for each, and an index buffer for each set of objects that is drawn together.

With ``GLINT``, panes of painted facades mirror a low sun: what a pixel shows depends on the eye, as nothing else here does. A
mirror on an upright wall shows the sun at the height at which it stands, so that one above the roofs would be seen in the
uppermost windows of near houses only.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from mmi.appearance.city_mesh import CityMesh, triangles_of
from mmi.appearance.facades import glass_of
from mmi.appearance.shading import SUN
from viewer.drawing.kinds.lines import LineProgram
from viewer.drawing.programs import Program, Programs
from viewer.drawing.style import Ink

__all__ = ["GROUND_ID", "DrawnMesh", "MeshProgram", "Triangles"]

GROUND_ID = -2
"""The object that pixels of the ground show in measured pictures."""
_MOST_TRIANGLES = 6_000_000
"""Sets of objects are kept as index buffers while they have no more triangles together, of 12 bytes each. A walk meets a new
set in every cell, and one that captures layers again some for each layer, of few triangles."""
_MOST_SETS = 1024
_GLINT_HEIGHT = math.radians(6.0)
"""How high the sun that panes mirror stands, in the direction of the sun that lights the city."""
_VERTEX = """
in vec3 position; in vec2 uv; in vec3 color; in int object;
out vec2 at; out vec3 tint; flat out int which; out float depth;
#ifdef GLINT
out vec3 ray;          // from the eye, in the city's frame
#endif
void main() {
#ifdef GLINT
    ray = position - eye;
#endif
    vec3 p = eye_from_world * (position - eye);
    at = uv; tint = color; which = object; depth = -p.z;
    gl_Position = project(p);
}
"""
_FRAGMENT = """
uniform sampler2D picture;
in vec2 at; in vec3 tint; flat in int which; in float depth;
#ifdef GLINT
in vec3 ray;
uniform vec3 low_sun;  // towards it
const float SHARPNESS = 40.0;  // half as bright 11 degrees off
const vec3 GLOW = vec3(1.0, 0.86, 0.55);
#endif
void main() {
    vec4 texel = texture(picture, at, -0.75);
    color_out = vec4(texel.rgb * tint, 1.0);
#ifdef GLINT
    vec3 mirrored = reflect(normalize(ray), normalize(cross(dFdx(ray), dFdy(ray))));  // whichever way the normal points
    color_out.rgb = min(color_out.rgb + texel.a * pow(max(dot(mirrored, low_sun), 0.0), SHARPNESS) * GLOW, vec3(1.0));
#endif
#ifdef MEASURED
    id_out = which; surface_out = vec2(depth, -1.0);
#endif
}
"""


@dataclass(frozen=True, slots=True, eq=False)
class Triangles:
    """Some triangles on the GPU. ``arrays`` has a vertex array for measured pictures (true) and one for the others."""

    count: int
    arrays: Mapping[bool, Any]
    indices: Any

    def release(self) -> None:
        """Free it."""
        for thing in (*self.arrays.values(), self.indices):
            thing.release()


@dataclass(frozen=True, slots=True, eq=False)
class MeshProgram:
    """A program that draws meshes, made once; with ``glint`` one that lets panes of facades mirror the sun."""

    programs: Mapping[bool, Program]
    glint: bool

    @classmethod
    def made_by(cls, programs: Programs, *, glint: bool = False) -> MeshProgram:
        """Compile the program."""
        made = programs.make(_VERTEX, _FRAGMENT, flags=("GLINT",) if glint else ())
        along = SUN[:2] / np.linalg.norm(SUN[:2]) * math.cos(_GLINT_HEIGHT)
        low_sun = np.array([*along, math.sin(_GLINT_HEIGHT)], dtype="<f4")
        for one in made.values():
            one.set({"low_sun": low_sun.tobytes()})
        return cls(made, glint)


class DrawnMesh:
    """A mesh whose vertices and texture are on the GPU. ``ids`` (n,) say which object each vertex counts as when measured."""

    def __init__(self, context: Any, program: MeshProgram, mesh: CityMesh, ids: NDArray[np.int64]) -> None:  # noqa: ANN401
        self._context, self._programs, self._mesh = context, program.programs, mesh
        layout = np.dtype([("position", "<f4", 3), ("uv", "<f4", 2), ("color", "u1", 4), ("object", "<i4")])
        vertices = np.zeros(len(mesh.positions), dtype=layout)
        vertices["position"], vertices["uv"] = mesh.positions, mesh.uv
        vertices["color"][:, :3], vertices["object"] = mesh.colors, ids
        self._vertices = context.buffer(vertices.tobytes())
        texture = np.dstack([mesh.texture, glass_of(mesh.texture)]) if program.glint else mesh.texture
        self.texture = self._upload_texture(texture)
        """With mipmaps; it repeats."""
        self._sets: dict[object, Triangles] = {}
        self._held = 0

    def draw(self, key: object, objects: NDArray[np.int64], *, measured: bool) -> list[int]:
        """Draw some ``objects`` (n,) of the mesh. The same ``key`` means the same objects: their indices are kept for it, but
        for an empty key.
        """
        some = self._kept(key, objects) if key != "" else self._triangles(triangles_of(self._mesh, objects))
        if some.count:
            self.texture.use(0)
            some.arrays[measured].render()
        if key == "":
            some.release()
        return [some.count] if some.count else []

    def draw_lines(
        self, key: object, objects: NDArray[np.int64], program: LineProgram, *, ink: Ink, measured: bool
    ) -> None:
        """Draw the edges of some ``objects`` (n,), as :meth:`draw` has them."""
        some = self._kept(key, objects) if key != "" else self._triangles(triangles_of(self._mesh, objects))
        if some.count:
            program.draw((self._vertices, "3f 16x"), some.indices, ink, measured=measured)
        if key == "":
            some.release()

    def _kept(self, key: object, objects: NDArray[np.int64]) -> Triangles:
        """Triangles of some objects, made when first drawn and kept until enough others were drawn more recently."""
        found = self._sets.pop(key, None)
        if found is None:
            found = self._triangles(triangles_of(self._mesh, objects))
            self._held += found.count
            while self._sets and (self._held > _MOST_TRIANGLES or len(self._sets) >= _MOST_SETS):
                oldest = self._sets.pop(next(iter(self._sets)))
                self._held -= oldest.count
                oldest.release()
        self._sets[key] = found
        return found

    def _triangles(self, triangles: NDArray[np.int32]) -> Triangles:
        if not len(triangles):
            return Triangles(0, {}, self._context.buffer(reserve=4))
        indices = self._context.buffer(np.ascontiguousarray(triangles, dtype="<i4").tobytes())
        arrays = {}
        for mode, program in self._programs.items():
            layout = ["3f 2f 3f1 x1 1i" if mode else "3f 2f 3f1 x1 x4", "position", "uv", "color"]
            if mode:
                layout.append("object")
            arrays[mode] = self._context.vertex_array(program.program, [(self._vertices, *layout)], indices)
        return Triangles(len(triangles), arrays, indices)

    def _upload_texture(self, pixels: NDArray[np.uint8]) -> Any:  # noqa: ANN401
        texture = self._context.texture(
            pixels.shape[1::-1], pixels.shape[2], np.ascontiguousarray(pixels).tobytes(), alignment=1
        )
        texture.build_mipmaps()
        texture.filter = (moderngl.LINEAR_MIPMAP_LINEAR, moderngl.LINEAR)
        texture.repeat_x = texture.repeat_y = True
        return texture
