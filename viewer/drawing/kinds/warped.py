"""Whole pictures that a technique has warped itself: the renderer sees to it that they hide all else, and it them, by depth."""

from __future__ import annotations

from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from viewer.computed import WarpedPicture
from viewer.drawing.programs import SCREEN_VERTEX, InkedArrays, InkedProgram, Programs
from viewer.drawing.style import Ink

__all__ = ["WarpedDrawer"]

_FRAGMENT = """
uniform sampler2D picture;
uniform sampler2D depths;
uniform isampler2D ids;
#ifdef TINTED
uniform vec4 ink;
#endif
void main() {
    ivec2 size = textureSize(depths, 0), at = ivec2(gl_FragCoord.xy);
    if (projection.y > 0.0) at.y = size.y - 1 - at.y;  // the top row comes first
    float depth = texelFetch(depths, at, 0).r;
    if (isinf(depth)) discard;
    color_out = vec4(texelFetch(picture, at, 0).rgb, 1.0);
    gl_FragDepth = (clip.y - clip.y * clip.x / max(depth, clip.x)) / (clip.y - clip.x);
#ifdef TINTED
    color_out.rgb = tinted(color_out.rgb, ink);
#endif
#ifdef MEASURED
    id_out = texelFetch(ids, at, 0).r; surface_out = vec2(depth, -1.0);
#endif
}
"""


class WarpedDrawer:
    """Draws :class:`viewer.computed.WarpedPicture`: a triangle over the whole picture."""

    def __init__(self, programs: Programs) -> None:
        self._context = programs.context
        self._arrays = InkedArrays(InkedProgram(programs, SCREEN_VERTEX, _FRAGMENT), ())
        self._textures: tuple[Any, ...] = ()

    def draw(self, draw: WarpedPicture, *, measured: bool, ink: Ink | None = None) -> list[int]:
        """Draw a picture that is as large as the one that is drawn into, tinted with ``ink`` if there is one."""
        height, width = draw.depth.shape
        if not self._textures or self._textures[0].size != (width, height):
            self._make_room(width, height)
        pictures: tuple[NDArray[Any], ...] = (draw.color, draw.depth, draw.objects)
        for unit, (texture, values) in enumerate(zip(self._textures, pictures, strict=True)):
            texture.write(np.ascontiguousarray(values))
            texture.use(unit)
        self._arrays.ready(ink, measured=measured).render(moderngl.TRIANGLES, vertices=3)
        return [1]

    def _make_room(self, width: int, height: int) -> None:
        for texture in self._textures:
            texture.release()
        self._textures = tuple(
            self._context.texture((width, height), components, dtype=dtype, alignment=1)
            for components, dtype in ((3, "f1"), (1, "f4"), (1, "i4"))
        )
        for texture in self._textures:
            texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
