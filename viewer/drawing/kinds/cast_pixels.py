"""Single pixels whose surfaces a technique has found itself: what the renderer adds is their colour, from the city's texture.

A pixel is a point of that size. Where the pixel's middle sees the surface at the same place, it has the colour that geometry
drawn there has: the same texture, filtered at the same level, times the same tint; and the same depth.
"""

from __future__ import annotations

from typing import Any

import moderngl
import numpy as np

from viewer.drawing.kinds.lines import ink_bytes
from viewer.drawing.programs import Program, Programs
from viewer.drawing.style import Ink
from viewer.plan import CAST_PIXEL, CastPixels

__all__ = ["CastPixelsDrawer"]

_VERTEX = """
in uvec2 pixel; in float along; in vec2 uv; in float level; in vec4 color; in int object;
uniform vec2 size;
flat out vec2 at; flat out float lod; flat out vec3 tint; flat out int which; flat out float depth;
void main() {
    at = uv; lod = level; tint = color.rgb; which = object; depth = along;
    vec4 clipped = project(vec3(0.0, 0.0, -along));
    vec2 middle = 2.0 * (vec2(pixel) + 0.5) / size - 1.0;
    gl_Position = vec4(middle.x * along, -sign(projection.y) * middle.y * along, clipped.z, along);
}
"""
_FRAGMENT = """
uniform sampler2D picture;
#ifdef TINTED
uniform vec4 ink;
#endif
flat in vec2 at; flat in float lod; flat in vec3 tint; flat in int which; flat in float depth;
void main() {
    color_out = vec4(textureLod(picture, at, lod).rgb * tint, 1.0);
#ifdef TINTED
    color_out.rgb = tinted(color_out.rgb, ink);
#endif
#ifdef MEASURED
    id_out = which; surface_out = vec2(depth, -1.0);
#endif
}
"""
_LAYOUT = ("2u2 1f 2f 1f 4f1 1i", "pixel", "along", "uv", "level", "color")
_UNMEASURED = ("2u2 1f 2f 1f 4f1 x4", *_LAYOUT[1:])
_ROOM = 1 << 14
"""Pixels for which there is room at first."""


class CastPixelsDrawer:
    """Draws :class:`viewer.plan.CastPixels` with ``texture``, the city's."""

    def __init__(self, programs: Programs, texture: Any) -> None:  # noqa: ANN401
        self._context, self._texture = programs.context, texture
        self._make = programs.make
        self._programs = {False: programs.make(_VERTEX, _FRAGMENT)}
        self._room = 0
        self._samples: Any = None
        self._arrays: dict[tuple[bool, bool], Any] = {}

    def draw(self, draw: CastPixels, size: tuple[int, int], *, measured: bool, ink: Ink | None = None) -> list[int]:
        """Draw all pixels of a picture of ``size`` with one call, tinted with ``ink`` if there is one; it has no triangles."""
        count = len(draw.samples)
        if not count:
            return []
        self._make_room(count)
        self._samples.orphan()
        self._samples.write(np.ascontiguousarray(draw.samples, dtype=CAST_PIXEL).view(np.uint8))
        told = {"size": np.array(size, dtype="<f4").tobytes()}
        if ink is not None:
            told["ink"] = ink_bytes(ink)
        self._program(ink is not None, measured).set(told)
        self._texture.use(0)
        self._array(ink is not None, measured).render(moderngl.POINTS, vertices=count)
        return [0]

    def _program(self, tinted: bool, measured: bool) -> Program:
        if tinted not in self._programs:
            self._programs[tinted] = self._make(_VERTEX, _FRAGMENT, flags=("TINTED",))
        return self._programs[tinted][measured]

    def _array(self, tinted: bool, measured: bool) -> Any:  # noqa: ANN401
        if (tinted, measured) not in self._arrays:
            layout = (*_LAYOUT, "object") if measured else _UNMEASURED
            program = self._program(tinted, measured).program
            self._arrays[tinted, measured] = self._context.vertex_array(program, [(self._samples, *layout)])
        return self._arrays[tinted, measured]

    def _make_room(self, count: int) -> None:
        """Have room for so many pixels."""
        if self._room >= count:
            return
        if self._samples is not None:
            for thing in (*self._arrays.values(), self._samples):
                thing.release()
        self._arrays.clear()
        self._room = max(_ROOM, 1 << (count - 1).bit_length())
        self._samples = self._context.buffer(reserve=self._room * CAST_PIXEL.itemsize, dynamic=True)
