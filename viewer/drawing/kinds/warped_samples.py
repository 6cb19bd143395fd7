"""Layered images that the renderer warps: each sample is a point, composed with all else by depth (section 4).

A sample is a patch of a plane (:mod:`viewer.layered.layered_image`), which in the view is a quadrilateral. A point is drawn
for it that is as large as what pixels it may cover, and each of these asks whether its middle is in the patch, and how deep
that is there. So pixels show the same patches as :mod:`viewer.layered.warping` paints, but where two are as deep as each
other; cracks are not closed afterwards. A point is one vertex, where the quadrilateral itself would take four.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import moderngl
import numpy as np
from numpy.typing import NDArray

from mmi.foundation.camera import View
from viewer.computed import WarpedSamples
from viewer.drawing.programs import InkedArrays, InkedProgram, Programs
from viewer.drawing.style import Ink
from viewer.layered.layered_image import HALF
from viewer.layered.warping import MEET, between

__all__ = ["WarpedSamplesDrawer"]

_MOST_BYTES = 256 << 20
"""Images are kept while their samples take no more together; the one that is drawn always is."""
_SAMPLE = np.dtype([("pixel", "<u2", 2), ("near", "<f4"), ("slope", "<f4", 2), ("reach", "u1", 4), ("color", "u1", 4)])
_LAYOUT = (("2u2 1f 2f 4f1 4f1", "pixel", "near", "slope", "reach", "color"), ("1i", "object"))
_PROGRAM_POINT_SIZE = 0x8642
_VERTEX = """
in uvec2 pixel; in float near; in vec2 slope; in vec4 reach; in vec4 color;
#ifdef MEASURED
in int object;
flat out int which;
#endif
uniform mat4x3 moved;       // a pixel's column and row, 1, and 1 / depth, to those of the view, by its depth
uniform vec2 size;          // of the view
uniform float most;         // pixels of the largest point that OpenGL draws
flat out vec2 middle;       // of the point
flat out vec4 across, down, here;  // how far a pixel is within the patch's four borders: by column, by row, at the middle
flat out vec3 plane;        // 1 / depth: by column, by row, at the middle
flat out vec3 paint;
void main() {
    gl_Position = vec4(2.0, 2.0, 2.0, 1.0); gl_PointSize = 1.0;  // out of sight
    vec3 h = moved * vec4(vec2(pixel) + 0.5, 1.0, near);
    vec3 a = moved[0] + slope.x * moved[3], b = moved[1] + slope.y * moved[3];
    vec4 reaches = reach * (255.0 * 0.5 / HALF) + MEET;
    vec2 low = vec2(1e9), high = vec2(-1e9);
    float least = 1e9;
    for (int k = 0; k < 4; ++k) {
        vec3 corner = h + ((k & 1) == 0 ? -reaches.x : reaches.y) * a + ((k & 2) == 0 ? -reaches.z : reaches.w) * b;
        least = min(least, corner.z);
        low = min(low, corner.xy / corner.z); high = max(high, corner.xy / corner.z);
    }
    vec2 first = max(ceil(low - 0.5), vec2(0.0)), end = min(floor(high - 0.5) + 1.0, size);
    if (!(least > 0.0) || !all(lessThan(first, end))) return;
    float side = min(max(end.x - first.x, end.y - first.y), most);
    middle = max(min(first, size - side), vec2(0.0)) + 0.5 * side;  // or OpenGL would leave out those at the picture's border
    h.xy -= middle * h.z; a.xy -= middle * a.z; b.xy -= middle * b.z;
    vec3 hb = cross(h, b), ah = cross(a, h), ba = cross(b, a);
    float volume = dot(h, ba);
    if (abs(volume) < 1e-20) return;
    hb /= volume; ah /= volume; ba /= volume;
    across = vec4(reaches.x * ba.x + hb.x, reaches.y * ba.x - hb.x, reaches.z * ba.x + ah.x, reaches.w * ba.x - ah.x);
    down = vec4(reaches.x * ba.y + hb.y, reaches.y * ba.y - hb.y, reaches.z * ba.y + ah.y, reaches.w * ba.y - ah.y);
    here = vec4(reaches.x * ba.z + hb.z, reaches.y * ba.z - hb.z, reaches.z * ba.z + ah.z, reaches.w * ba.z - ah.z);
    plane = near * ba + slope.x * hb + slope.y * ah;
    paint = color.rgb;
#ifdef MEASURED
    which = object;
#endif
    vec2 at = middle / size * 2.0 - 1.0;
    gl_Position = vec4(at.x, -sign(projection.y) * at.y, 0.0, 1.0);
    gl_PointSize = side;
}
"""
_FRAGMENT = """
uniform vec2 size;
flat in vec2 middle; flat in vec4 across, down, here; flat in vec3 plane; flat in vec3 paint;
#ifdef TINTED
uniform vec4 ink;
#endif
#ifdef MEASURED
flat in int which;
#endif
void main() {
    vec2 off = vec2(gl_FragCoord.x, projection.y > 0.0 ? size.y - gl_FragCoord.y : gl_FragCoord.y) - middle;
    float near = plane.x * off.x + plane.y * off.y + plane.z;
    if (any(lessThan(across * off.x + down * off.y + here, vec4(0.0))) || near <= 0.0) discard;
    color_out = vec4(paint, 1.0);
    gl_FragDepth = (clip.y - clip.y * clip.x * min(near, 1.0 / clip.x)) / (clip.y - clip.x);
#ifdef TINTED
    color_out.rgb = tinted(color_out.rgb, ink);
#endif
#ifdef MEASURED
    id_out = which; surface_out = vec2(1.0 / near, -1.0);
#endif
}
"""
_NUMBERS = f"\nconst float HALF = {HALF:.1f}, MEET = {MEET};\n"


class _Kept(NamedTuple):
    """An image's samples on the GPU: ``buffers`` of ``bytes`` together."""

    arrays: InkedArrays
    buffers: tuple[Any, ...]
    bytes: int

    def release(self) -> None:
        for thing in (self.arrays, *self.buffers):
            thing.release()


class WarpedSamplesDrawer:
    """Draws :class:`viewer.computed.WarpedSamples`, whose samples are brought to the GPU when they are first drawn."""

    def __init__(self, programs: Programs) -> None:
        self._context = programs.context
        self._program = InkedProgram(programs, _NUMBERS + _VERTEX, _FRAGMENT)
        self._most = np.array(self._context.info["GL_POINT_SIZE_RANGE"][1], dtype="<f4").tobytes()
        self._kept: dict[str, _Kept] = {}

    def draw(self, draw: WarpedSamples, view: View, *, measured: bool, ink: Ink | None = None) -> list[int]:
        """Draw all samples with one call, tinted with ``ink`` if there is one: no triangles."""
        count = len(draw.depths)
        if not count:
            return []
        told = {
            "moved": between(draw.view, view).T.astype("<f4").tobytes(),
            "size": np.array(view.window[2:], dtype="<f4").tobytes(),
            "most": self._most,
        }
        array = self._image(draw).arrays.ready(ink, measured=measured, told=told)
        self._context.enable_direct(_PROGRAM_POINT_SIZE)
        array.render(moderngl.POINTS, vertices=count)
        self._context.disable_direct(_PROGRAM_POINT_SIZE)
        return [0]

    def _image(self, draw: WarpedSamples) -> _Kept:
        """An image's samples, brought when first drawn and kept until enough others were drawn more recently."""
        found = self._kept.pop(draw.key, None)
        if found is None:
            parts = [np.ascontiguousarray(part) for part in _samples(draw)]
            buffers = tuple(self._context.buffer(part) for part in parts)
            layout = [(buffer, *rest) for buffer, rest in zip(buffers, _LAYOUT, strict=True)]
            found = _Kept(InkedArrays(self._program, layout), buffers, sum(part.nbytes for part in parts))
            held = found.bytes + sum(one.bytes for one in self._kept.values())
            while self._kept and held > _MOST_BYTES:
                oldest = self._kept.pop(next(iter(self._kept)))
                held -= oldest.bytes
                oldest.release()
        self._kept[draw.key] = found
        return found


def _samples(draw: WarpedSamples) -> tuple[NDArray[np.void], NDArray[np.int32]]:
    """(m,) of ``_SAMPLE``, and the objects (m,): what the GPU needs to know of an image."""
    width = draw.view.window[2]
    pixels = np.repeat(np.arange(len(draw.starts) - 1), np.diff(draw.starts))
    found = np.zeros(len(draw.depths), dtype=_SAMPLE)
    found["pixel"][:, 0], found["pixel"][:, 1] = pixels % width, pixels // width
    found["near"], found["slope"], found["reach"] = 1.0 / draw.depths, draw.slopes, draw.reaches
    found["color"][:, :3] = draw.colors
    return found, draw.objects
