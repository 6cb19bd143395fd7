"""Captured images on quadrilaterals whose pixels have the depths that were captured (Schaufler 1997, "Nailboards").

A relief of the same image would put every point where it is; a quadrilateral costs two triangles and no look into the image
for each of its corners, and what it is wrong by is known from its box (``mmi.validity.images``). The depth of a pixel is that
of the surface point which its texel captured, along the ray on which it was captured, so that the z-buffer composes boards
with each other and with all else, as if they were what they show.
"""

from __future__ import annotations

from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from mmi.foundation.camera import View
from viewer.drawing.images import Images
from viewer.drawing.programs import InkedArrays, InkedProgram, Programs
from viewer.drawing.style import Ink
from viewer.plan import Nailboards

__all__ = ["NailboardsDrawer"]

_NUMBERS = 20
"""Numbers of a board that the shaders need."""
_VERTEX = """
in vec4 x, y, z;   // rows of the eye's frame from the capture's
in vec4 seen;      // focal, left, top, depth of the quadrilateral
in vec4 part;      // corner and size in the image
out vec2 texel;    // in the part
out vec3 here;     // in the eye's frame
flat out vec4 place;
flat out vec3 eyes;  // where it was captured from, in the eye's frame
flat out float stands;
void main() {
    texel = part.zw * vec2(gl_VertexID & 1, gl_VertexID >> 1);
    vec4 p = vec4((seen.y + texel.x) / seen.x * seen.w, -(seen.z + texel.y) / seen.x * seen.w, -seen.w, 1.0);
    here = vec3(dot(x, p), dot(y, p), dot(z, p));
    eyes = vec3(x.w, y.w, z.w); place = part; stands = seen.w;
    gl_Position = project(here);
}
"""
_FRAGMENT = """
uniform sampler2D picture;
uniform sampler2D depths;
in vec2 texel; in vec3 here;
flat in vec4 place; flat in vec3 eyes; flat in float stands;
#ifdef TINTED
uniform vec4 ink;
#endif
#ifdef MEASURED
uniform isampler2D ids;
#endif
void main() {
    vec2 at = clamp(texel, vec2(0.5), place.zw - 0.5) + place.xy;
    vec4 color = texture(picture, at / vec2(textureSize(picture, 0)));
    if (color.a < 0.5) discard;
    ivec2 first = ivec2(floor(at - 0.5)), covered = ivec2(at);
    float captured = texelFetch(depths, covered, 0).r;
    float closest = captured > 0.0 ? 0.0 : 1e9;  // at silhouettes the texel itself may be clear
    for (int k = 0; k < 4 && captured <= 0.0; ++k) {
        ivec2 other = clamp(first + ivec2(k & 1, k >> 1), ivec2(place.xy), ivec2(place.xy + place.zw) - 1);
        vec2 off = vec2(other) + 0.5 - at;
        float depth = texelFetch(depths, other, 0).r;
        if (depth > 0.0 && dot(off, off) < closest) { closest = dot(off, off); covered = other; }
    }
    if (captured <= 0.0) captured = texelFetch(depths, covered, 0).r;
    vec3 surface = captured > 0.0 ? eyes + captured / stands * (here - eyes) : here;
    float shown = max(-surface.z, clip.x);
    gl_FragDepth = (clip.y - clip.y * clip.x / shown) / (clip.y - clip.x);
    color.rgb /= color.a;
#ifdef TINTED
    color.rgb = tinted(color.rgb, ink);
#endif
#ifdef COVERAGE
    color_out = vec4(color.rgb, clamp((color.a - 0.5) / max(fwidth(color.a), 1e-4) + 0.5, 0.0, 1.0));
    if (color_out.a <= 0.0) discard;
#else
    color_out = vec4(color.rgb, 1.0);
#endif
#ifdef MEASURED
    id_out = texelFetch(ids, covered, 0).r;
    vec3 a = normalize(here), b = normalize(surface);
    surface_out = vec2(shown, atan(length(cross(a, b)), dot(a, b)));
#endif
}
"""


class NailboardsDrawer:
    """Draws :class:`viewer.plan.Nailboards` of images that were captured."""

    def __init__(self, programs: Programs, images: Images) -> None:
        self._context, self._images, self._covering = programs.context, images, programs.covering
        self._program = InkedProgram(programs, _VERTEX, _FRAGMENT)
        self._boards: Any = None
        self._arrays = InkedArrays(self._program, ())

    def draw(self, draw: Nailboards, view: View, *, measured: bool, inks: tuple[Ink, Ink] | None = None) -> list[int]:
        """Draw all boards of an image with one call, or with ``inks`` those that are fresh and the others, tinted.

        Raises KeyError where nothing was captured into the image.
        """
        if not len(draw.depths):
            return []
        image = self._images[draw.image]
        for unit, texture in enumerate((image.color, image.depth, image.ids)):
            texture.use(unit)
        rows = _rows(draw, view)
        if inks is None:
            return self._render(rows, measured=measured)
        fresh, others = inks
        counts = self._render(rows[draw.fresh], measured=measured, ink=fresh)
        return counts + self._render(rows[~draw.fresh], measured=measured, ink=others)

    def _render(self, rows: NDArray[np.float32], *, measured: bool, ink: Ink | None = None) -> list[int]:
        if not len(rows):
            return []
        if self._boards is None or self._boards.size < rows.nbytes:
            self._arrays.release()
            if self._boards is not None:
                self._boards.release()
            self._boards = self._context.buffer(reserve=2 * rows.nbytes, dynamic=True)
            layout = (self._boards, "4f 4f 4f 4f 4f/i", "x", "y", "z", "seen", "part")
            self._arrays = InkedArrays(self._program, [layout])
        self._boards.orphan()
        self._boards.write(rows)
        array = self._arrays.ready(ink, measured=measured)
        with self._covering(measured=measured):
            array.render(moderngl.TRIANGLE_STRIP, vertices=4, instances=len(rows))
        return [2 * len(rows)]


def _rows(draw: Nailboards, view: View) -> NDArray[np.float32]:
    """(n, 20) what the shaders need to know of each board; differences of places are taken in double precision."""
    rows = np.empty((len(draw.depths), _NUMBERS), dtype="<f4")
    turned, shift = draw.captures[:, :3, :3], draw.captures[:, :3, 3]
    world_from_capture = np.swapaxes(turned, 1, 2)
    eyes = -np.einsum("nij,nj->ni", world_from_capture, shift) - view.eye
    now = view.eye_from_world[:3, :3]
    frames = np.concatenate([now @ world_from_capture, (eyes @ now.T)[:, :, None]], axis=2)
    rows[:, :12] = frames.reshape(-1, 12)
    rows[:, 12], rows[:, 13:15], rows[:, 15] = draw.focal, draw.windows[:, :2], draw.depths
    rows[:, 16:18], rows[:, 18:] = draw.corners, draw.windows[:, 2:]
    return rows
