"""Captured images as reliefs: regular grids whose vertex shader reads the captured depths (paper section 5.5).

The paper keeps 8 bits of depth with a texture, sub-samples it into a grid and lets the mesh stand for the surface. Here the
depths are the float32 that the capture wrote, at every texel: they never leave the GPU, so that fewer bits would save little,
and each fragment takes the depth of the very point that its texel captured. So the grid decides where a point appears, and
its texel's depth what it hides. A node of the grid has the mean inverse depth of the texels around it, since that is linear
in planes, or where there are none, of the nearest ones that a few samples find.

Silhouettes are those of coverage, which is filtered and so reaches half a texel farther than it is likely to be: between two
houses that touch and were captured in different pictures, no background shows. Seen from where it was captured a texel is a
pixel, and nothing is filtered.
"""

from __future__ import annotations

from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from mmi.foundation.camera import View
from viewer.drawing.images import Images
from viewer.drawing.programs import MODES, Programs
from viewer.plan import Relief, ReliefPart

__all__ = ["QUAD", "ReliefsDrawer", "relief_triangles"]

QUAD = 8
"""Texels from node to node of the grid."""
_ROWS = 5
"""Texels of four numbers that say what the shaders need to know of a part."""
_SAMPLE_ALPHA_TO_COVERAGE = 0x809E
_MOST_GRIDS = 64
_COMMON = """
uniform sampler2D depths;  // captured, along the axis; 0 where nothing is
uniform sampler2D parts;   // a row each: three rows of the eye's frame from the capture's, focal left top filling, corner size
"""
_VERTEX = (
    _COMMON
    + """
uniform int columns;
out vec3 at;               // texel coordinates in the part times depth in the capture, and that: linear in space
out vec3 here;             // in the eye's frame
flat out int part;
const ivec2 AROUND[8] = ivec2[8](ivec2(1, 0), ivec2(-1, 0), ivec2(0, 1), ivec2(0, -1),
                                 ivec2(1, 1), ivec2(-1, 1), ivec2(1, -1), ivec2(-1, -1));
float nearness(ivec2 texel, ivec2 size, ivec2 corner) {
    if (any(lessThan(texel, ivec2(0))) || any(greaterThanEqual(texel, size))) return 0.0;
    float depth = texelFetch(depths, corner + texel, 0).r;
    return depth > 0.0 ? 1.0 / depth : 0.0;
}
void main() {
    part = gl_InstanceID;
    vec4 seen = texelFetch(parts, ivec2(3, part), 0), place = texelFetch(parts, ivec2(4, part), 0);
    ivec2 corner = ivec2(place.xy), size = ivec2(place.zw);
    ivec2 node = min(QUAD * ivec2(gl_VertexID % columns, gl_VertexID / columns), size);
    float sum = 0.0, count = 0.0;
    for (int k = 0; k < 4; ++k) {
        float one = nearness(node - ivec2(k & 1, k >> 1), size, corner);
        sum += one; count += sign(one);
    }
    for (int reach = 2; reach <= QUAD && count == 0.0; reach += 2)
        for (int k = 0; k < 8; ++k) {
            float one = nearness(node + reach * AROUND[k], size, corner);
            sum += one; count += sign(one);
        }
    float depth = count > 0.0 ? count / sum : seen.w;
    vec2 texel = vec2(node);
    vec4 p = vec4((seen.y + texel.x) / seen.x * depth, -(seen.z + texel.y) / seen.x * depth, -depth, 1.0);
    at = vec3(texel * depth, depth);
    here = vec3(dot(texelFetch(parts, ivec2(0, part), 0), p), dot(texelFetch(parts, ivec2(1, part), 0), p),
                dot(texelFetch(parts, ivec2(2, part), 0), p));
    gl_Position = project(here);
}
"""
)
_FRAGMENT = (
    _COMMON
    + """
uniform sampler2D picture;
in vec3 at; in vec3 here; flat in int part;
#ifdef MEASURED
uniform isampler2D ids;
#endif
const float LEAST = 0.0625;  // of coverage
void main() {
    vec4 place = texelFetch(parts, ivec2(4, part), 0);
    ivec2 corner = ivec2(place.xy), size = ivec2(place.zw);
    vec2 texel = clamp(at.xy / at.z, vec2(0.5), vec2(size) - 0.5);
    vec4 color = texture(picture, (vec2(corner) + texel) / vec2(textureSize(picture, 0)));
    if (color.a < LEAST) discard;
    color.rgb /= color.a;
    ivec2 nearest = min(ivec2(texel), size - 1);
    float captured = texelFetch(depths, corner + nearest, 0).r;
    if (captured <= 0.0) {  // the filter reaches half a texel beyond the silhouette
        float closest = 1e9;
        ivec2 middle = nearest;
        for (int k = 0; k < 9; ++k) {
            ivec2 other = clamp(middle + ivec2(k % 3, k / 3) - 1, ivec2(0), size - 1);
            float depth = texelFetch(depths, corner + other, 0).r;
            vec2 off = vec2(other) + 0.5 - texel;
            if (depth > 0.0 && dot(off, off) < closest) { closest = dot(off, off); captured = depth; nearest = other; }
        }
        if (captured <= 0.0) discard;
    }
    vec3 eyes = vec3(texelFetch(parts, ivec2(0, part), 0).w, texelFetch(parts, ivec2(1, part), 0).w,
                     texelFetch(parts, ivec2(2, part), 0).w);  // the capture's eye
    vec3 surface = eyes + captured / at.z * (here - eyes);
    float shown = max(-surface.z, clip.x);
    gl_FragDepth = (clip.y - clip.y * clip.x / shown) / (clip.y - clip.x);
#ifdef COVERAGE
    color_out = vec4(color.rgb, clamp((color.a - 0.5) / max(fwidth(color.a), 1e-4) + 0.5, 0.0, 1.0));
    if (color_out.a <= 0.0) discard;
#else
    color_out = vec4(color.rgb, 1.0);
#endif
#ifdef MEASURED
    id_out = texelFetch(ids, corner + nearest, 0).r;
    vec3 a = normalize(here), b = normalize(surface);
    surface_out = vec2(shown, atan(length(cross(a, b)), dot(a, b)));
#endif
}
"""
)


class ReliefsDrawer:
    """Draws :class:`viewer.plan.Relief` of images that were captured."""

    def __init__(self, programs: Programs, images: Images) -> None:
        self._context, self._images, self._smooth = programs.context, images, programs.smooth
        vertex = _VERTEX.replace("QUAD", str(QUAD))
        self._programs = programs.make(vertex, _FRAGMENT)
        self._grids: dict[tuple[int, int], tuple[Any, dict[bool, Any]]] = {}
        self._parts: Any = None

    def draw(self, draw: Relief, view: View, *, measured: bool) -> list[int]:
        """Draw all parts with one call. Raises KeyError where nothing was captured into the image."""
        if not draw.parts:
            return []
        image = self._images[draw.image]
        for unit, texture in enumerate((image.color, image.depth, image.ids, self._told(draw, view))):
            texture.use(unit)
        sizes = np.array([part.view.window[2:] for part in draw.parts])
        columns, rows = (-(-sizes.max(axis=0) // QUAD)).tolist()
        if self._smooth(measured):
            self._context.enable_direct(_SAMPLE_ALPHA_TO_COVERAGE)
        self._programs[measured].set({"columns": np.int32(columns + 1).tobytes()})
        self._grid(columns, rows)[measured].render(moderngl.TRIANGLES, instances=len(draw.parts))
        if self._smooth(measured):
            self._context.disable_direct(_SAMPLE_ALPHA_TO_COVERAGE)
        return [2 * columns * rows * len(draw.parts)]

    def _told(self, draw: Relief, view: View) -> Any:  # noqa: ANN401
        """The texture that says where the parts are."""
        values = np.array([_row(part, view) for part in draw.parts], dtype="<f4")
        if self._parts is None or self._parts.height < len(values):
            if self._parts is not None:
                self._parts.release()
            self._parts = self._context.texture((_ROWS, 2 * len(values)), 4, dtype="f4")
            self._parts.filter = (moderngl.NEAREST, moderngl.NEAREST)
        self._parts.write(values.tobytes(), viewport=(0, 0, _ROWS, len(values)))
        return self._parts

    def _grid(self, columns: int, rows: int) -> dict[bool, Any]:
        """Vertex arrays of a grid of so many quads; its nodes are told from their number."""
        found = self._grids.pop((columns, rows), None)
        if found is None:
            if len(self._grids) >= _MOST_GRIDS:
                indices, arrays = self._grids.pop(next(iter(self._grids)))
                for thing in (*arrays.values(), indices):
                    thing.release()
            indices = self._context.buffer(_grid_triangles(columns, rows).tobytes())
            arrays = {
                mode: self._context.vertex_array(self._programs[mode].program, [], indices, index_element_size=4)
                for mode in MODES
            }
            found = (indices, arrays)
        self._grids[columns, rows] = found
        return found[1]


def relief_triangles(size: tuple[int, int]) -> int:
    """The triangles of a part of ``size`` (width, height)."""
    return 2 * -(-size[0] // QUAD) * -(-size[1] // QUAD)


def _row(part: ReliefPart, view: View) -> NDArray[np.float64]:
    """(20,) what the shaders need to know of a part."""
    world_from_capture = part.view.world_from_eye if part.moved is None else part.moved @ part.view.world_from_eye
    eye_from_capture = view.eye_from_world @ world_from_capture
    left, top, width, height = part.view.window
    return np.concatenate(
        [eye_from_capture[:3].ravel(), [part.view.focal, left, top, part.filling], [*part.corner, width, height]]
    )


def _grid_triangles(columns: int, rows: int) -> NDArray[np.int32]:
    """(2 * columns * rows, 3) corners as node numbers, row by row."""
    i, j = np.meshgrid(np.arange(columns), np.arange(rows))
    first = (j * (columns + 1) + i).ravel()
    below = first + columns + 1
    quads = [first, below, first + 1, first + 1, below, below + 1]
    return np.stack(quads, axis=1).reshape(-1, 3).astype("<i4")
