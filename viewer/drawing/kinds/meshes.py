"""Textured meshes on the GPU: a vertex buffer for each, and an index buffer for each set of objects that is drawn together.

With ``CUT_OUTS``, where a mesh has any, what is clear (``mmi.appearance.cut_outs``) is not drawn. Triangles whose part of the
texture has no clear texel are told from others, or from afar what lies beside it would cut holes into them.

With ``CLIPPED``, nothing is drawn outside of a box.

With ``GLINT``, panes of painted facades mirror a low sun: what a pixel shows depends on the eye, as nothing else here does. A
mirror on an upright wall shows the sun at the height at which it stands, so that one above the roofs would be seen in the
uppermost windows of near houses only.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from mmi.appearance.city_mesh import CityMesh, triangles_of
from mmi.appearance.cut_outs import clear_blocks, cut_out_triangles, texture_levels
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
_UNITS = (0, 4)
"""Texture units of the picture and of panes, where they are not in the picture's alpha."""
_PASSED_OVER = MappingProxyType({"solid": "x1", "object": "x4"})
"""The bytes of a vertex that not every program takes."""
_GLINT_HEIGHT = math.radians(6.0)
"""How high the sun that panes mirror stands, in the direction of the sun that lights the city."""
_VERTEX = """
in vec3 position; in vec2 uv; in vec3 color; in int object;
#ifdef CUT_OUTS
in float solid;        // 1 where no texel is clear
flat out float whole;
#endif
out vec2 at; out vec3 tint; flat out int which; out float depth;
#ifdef GLINT
out vec3 ray;          // from the eye, in the city's frame
#endif
#ifdef CLIPPED
uniform vec3 low, high;  // the box, from the eye
out float gl_ClipDistance[6];
#endif
void main() {
#ifdef CLIPPED
    vec3 above = position - eye - low, below = high - (position - eye);
    gl_ClipDistance[0] = above.x; gl_ClipDistance[1] = above.y; gl_ClipDistance[2] = above.z;
    gl_ClipDistance[3] = below.x; gl_ClipDistance[4] = below.y; gl_ClipDistance[5] = below.z;
#endif
#ifdef GLINT
    ray = position - eye;
#endif
#ifdef CUT_OUTS
    whole = solid;
#endif
    vec3 p = eye_from_world * (position - eye);
    at = uv; tint = color; which = object; depth = -p.z;
    gl_Position = project(p);
}
"""
_FRAGMENT = """
uniform sampler2D picture;
in vec2 at; in vec3 tint; flat in int which; in float depth;
#ifdef CUT_OUTS
flat in float whole;
#endif
#ifdef GLINT
#ifdef CUT_OUTS
uniform sampler2D panes;
#endif
in vec3 ray;
uniform vec3 low_sun;  // towards it
const float SHARPNESS = 40.0;  // half as bright 11 degrees off
const vec3 GLOW = vec3(1.0, 0.86, 0.55);
#endif
void main() {
    vec4 texel = texture(picture, at, -0.75);
    color_out = vec4(texel.rgb * tint, 1.0);
#ifdef CUT_OUTS
    float alpha = max(texel.a, whole);
#ifdef COVERAGE
    color_out.a = clamp((alpha - 0.5) / max(fwidth(alpha), 1e-4) + 0.5, 0.0, 1.0);
    if (color_out.a <= 0.0) discard;
#else
    if (alpha < 0.5) discard;
#endif
#endif
#ifdef GLINT
#ifdef CUT_OUTS
    float glass = texture(panes, at, -0.75).r;
#else
    float glass = texel.a;
#endif
    vec3 mirrored = reflect(normalize(ray), normalize(cross(dFdx(ray), dFdy(ray))));  // whichever way the normal points
    color_out.rgb = min(color_out.rgb + glass * pow(max(dot(mirrored, low_sun), 0.0), SHARPNESS) * GLOW, vec3(1.0));
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
    """A program that draws meshes, made once; with ``glint`` one that lets panes of facades mirror the sun, with ``cut_outs``
    one for meshes that have some.
    """

    programs: Mapping[bool, Program]
    covering: Callable[..., AbstractContextManager[None]]
    glint: bool
    cut_outs: bool

    @classmethod
    def made_by(
        cls, programs: Programs, *, glint: bool = False, cut_outs: bool = False, clipped: bool = False
    ) -> MeshProgram:
        """Compile the program; a ``clipped`` one draws what is between its uniforms ``low`` and ``high``."""
        wanted = (("GLINT", glint), ("CUT_OUTS", cut_outs), ("CLIPPED", clipped))
        flags = [flag for flag, one in wanted if one]
        made = programs.make(_VERTEX, _FRAGMENT, flags=flags)
        along = SUN[:2] / np.linalg.norm(SUN[:2]) * math.cos(_GLINT_HEIGHT)
        low_sun = np.array([*along, math.sin(_GLINT_HEIGHT)], dtype="<f4")
        for one in made.values():
            one.set({"low_sun": low_sun.tobytes()})
        covering = programs.covering if cut_outs else lambda *, measured: nullcontext()  # noqa: ARG005
        return cls(made, covering, glint, cut_outs)


class DrawnMesh:
    """A mesh whose vertices and texture are on the GPU. ``ids`` (n,) say which object each vertex counts as when measured.

    Raises ValueError where only one of mesh and program has cut-outs.
    """

    def __init__(self, context: Any, program: MeshProgram, mesh: CityMesh, ids: NDArray[np.int64]) -> None:  # noqa: ANN401
        if mesh.has_cut_outs != program.cut_outs:
            raise ValueError(f"a program with cut-outs ({mesh.has_cut_outs}) as in the mesh expected, found the other")
        self._context, self._programs, self._mesh = context, program.programs, mesh
        self._covering = program.covering
        layout = np.dtype(
            [("position", "<f4", 3), ("uv", "<f4", 2), ("color", "u1", 3), ("solid", "u1"), ("object", "<i4")]
        )
        vertices = np.zeros(len(mesh.positions), dtype=layout)
        vertices["position"], vertices["uv"] = mesh.positions, mesh.uv
        vertices["color"], vertices["solid"], vertices["object"] = mesh.colors, 255, ids
        vertices["solid"][mesh.triangles[cut_out_triangles(clear_blocks(mesh.texture), mesh.uv, mesh.triangles)]] = 0
        self._vertices = context.buffer(vertices.tobytes())
        self._textures = [self._upload_texture(one) for one in _textures(mesh.texture, program)]
        self.texture = self._textures[0]
        """The picture, with mipmaps; it repeats."""
        self._sets: dict[object, Triangles] = {}
        self._held = 0

    def draw(self, key: object, objects: NDArray[np.int64], *, measured: bool) -> list[int]:
        """Draw some ``objects`` (n,) of the mesh. The same ``key`` means the same objects: their indices are kept for it, but
        for an empty key.
        """
        return self._draw(key, lambda: triangles_of(self._mesh, objects), self._programs, measured=measured)

    def draw_faces(
        self, key: object, faces: NDArray[np.int32], *, measured: bool, program: MeshProgram | None = None
    ) -> list[int]:
        """Draw some ``faces`` (n,) of the mesh, by their numbers, as :meth:`draw` has objects; through another ``program``,
        with what that was told, they are not kept.
        """
        programs = self._programs if program is None else program.programs
        return self._draw(
            key if program is None else "", lambda: self._mesh.triangles[faces], programs, measured=measured
        )

    def _draw(
        self,
        key: object,
        gather: Callable[[], NDArray[np.int32]],
        programs: Mapping[bool, Program],
        *,
        measured: bool,
    ) -> list[int]:
        some = self._kept(key, gather) if key != "" else self._triangles(gather(), {measured: programs[measured]})
        if some.count:
            for unit, texture in zip(_UNITS, self._textures, strict=False):
                texture.use(unit)
            with self._covering(measured=measured):
                some.arrays[measured].render()
        if key == "":
            some.release()
        return [some.count] if some.count else []

    def draw_lines(
        self, key: object, objects: NDArray[np.int64], program: LineProgram, *, ink: Ink, measured: bool
    ) -> None:
        """Draw the edges of some ``objects`` (n,), as :meth:`draw` has them."""

        def gather() -> NDArray[np.int32]:
            return triangles_of(self._mesh, objects)

        some = self._kept(key, gather) if key != "" else self._triangles(gather(), {})
        if some.count:
            program.draw((self._vertices, "3f 16x"), some.indices, ink, measured=measured)
        if key == "":
            some.release()

    def _kept(self, key: object, gather: Callable[[], NDArray[np.int32]]) -> Triangles:
        """Triangles of a set, made when first drawn and kept until enough others were drawn more recently."""
        found = self._sets.pop(key, None)
        if found is None:
            found = self._triangles(gather(), self._programs)
            self._held += found.count
            while self._sets and (self._held > _MOST_TRIANGLES or len(self._sets) >= _MOST_SETS):
                oldest = self._sets.pop(next(iter(self._sets)))
                self._held -= oldest.count
                oldest.release()
        self._sets[key] = found
        return found

    def _triangles(self, triangles: NDArray[np.int32], programs: Mapping[bool, Program]) -> Triangles:
        if not len(triangles):
            return Triangles(0, {}, self._context.buffer(reserve=4))
        indices = self._context.buffer(np.ascontiguousarray(triangles, dtype="<i4").tobytes())
        arrays = {}
        for mode, program in programs.items():
            # What the compiled program does not use is passed over.
            parts = {"position": "3f", "uv": "2f", "color": "3f1", "solid": "1f1", "object": "1i"}
            used = [name for name in parts if name in program.program]
            layout = [" ".join(parts[one] if one in used else _PASSED_OVER[one] for one in parts), *used]
            arrays[mode] = self._context.vertex_array(program.program, [(self._vertices, *layout)], indices)
        return Triangles(len(triangles), arrays, indices)

    def _upload_texture(self, levels: Sequence[NDArray[np.uint8]]) -> Any:  # noqa: ANN401
        """With the ``levels`` given, the finest first, or those that OpenGL makes of it where there is no other."""
        pixels = levels[0]
        texture = self._context.texture(
            pixels.shape[1::-1], pixels.shape[2], np.ascontiguousarray(pixels).tobytes(), alignment=1
        )
        texture.build_mipmaps()
        for k, level in enumerate(levels[1:], 1):
            texture.write(np.ascontiguousarray(level).tobytes(), level=k, alignment=1)
        texture.filter = (moderngl.LINEAR_MIPMAP_LINEAR, moderngl.LINEAR)
        texture.repeat_x = texture.repeat_y = True
        return texture


def _textures(texture: NDArray[np.uint8], program: MeshProgram) -> list[list[NDArray[np.uint8]]]:
    """The levels of the textures that ``program`` draws a mesh with; the finest only where OpenGL makes the others."""
    if texture.shape[2] == 4:
        panes = [[glass_of(texture)[..., None]]] if program.glint else []
        return [texture_levels(texture), *panes]
    return [[np.dstack([texture, glass_of(texture)]) if program.glint else texture]]
