"""Captured images as reliefs: regular grids whose vertex shader reads the captured depths (paper section 5.5).

The paper keeps 8 bits of depth with a texture, sub-samples it into a grid and lets the mesh stand for the surface. Here the
depths are the float32 that the capture wrote, at every texel: they never leave the GPU, so that fewer bits would save little,
and each fragment takes the depth of the very point that its texel captured. So the grid decides where a point appears, and
its texel's depth what it hides. A node of the grid has the mean inverse depth of the texels around it, since that is linear
in planes, or where there are none, of the nearest ones that a few samples find.

The grid is bent to between the highest and the lowest that was captured in each of its columns, as far as that is known, since
drawing nothing takes as long as drawing something.

Silhouettes are those of coverage, which is filtered and reaches a tenth of a texel farther than it is likely to be: between two
houses that touch and were captured in different pictures, fewer holes show than between stored ones. Seen from where it was
captured a texel is a pixel, and nothing is filtered.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from mmi.foundation.camera import View
from viewer.drawing.images import Images
from viewer.drawing.kinds.lines import LINES
from viewer.drawing.programs import MODES, Program, Programs, ink_bytes
from viewer.drawing.style import Ink
from viewer.plan import RELIEF_QUAD, Relief, ReliefPart

__all__ = ["ReliefsDrawer"]

_TEXELS = 5
"""Texels of four numbers that say where a part is; those of its spans come after them."""
_MOST_GRIDS = 64
_TINTED = "TINTED"
_VERTEX = """
uniform sampler2D depths;  // captured, along the axis; 0 where nothing is
uniform sampler2D parts;   // a row each: three rows of the eye's frame from the capture's, focal left top filling, corner size,
                           // and for each two nodes of a row where their columns begin and end
uniform ivec2 grid;        // columns and rows
out vec3 at;               // texel coordinates in the part times depth in the capture, and that: linear in space
out vec3 here;             // in the eye's frame
flat out vec4 place;       // corner and size in the image
flat out vec3 eyes;        // where it was captured from, in the eye's frame
const ivec2 AROUND[8] = ivec2[8](ivec2(1, 0), ivec2(-1, 0), ivec2(0, 1), ivec2(0, -1),
                                 ivec2(1, 1), ivec2(-1, 1), ivec2(1, -1), ivec2(-1, -1));
float nearness(ivec2 texel, ivec2 size, ivec2 corner) {
    if (any(lessThan(texel, ivec2(0))) || any(greaterThanEqual(texel, size))) return 0.0;
    float depth = texelFetch(depths, corner + texel, 0).r;
    return depth > 0.0 ? 1.0 / depth : 0.0;
}
void main() {
    vec4 x = texelFetch(parts, ivec2(0, gl_InstanceID), 0), y = texelFetch(parts, ivec2(1, gl_InstanceID), 0);
    vec4 z = texelFetch(parts, ivec2(2, gl_InstanceID), 0), seen = texelFetch(parts, ivec2(3, gl_InstanceID), 0);
    place = texelFetch(parts, ivec2(4, gl_InstanceID), 0);
    eyes = vec3(x.w, y.w, z.w);
    ivec2 corner = ivec2(place.xy), size = ivec2(place.zw);
    int column = gl_VertexID % (grid.x + 1), row = gl_VertexID / (grid.x + 1);
    vec4 pair = texelFetch(parts, ivec2(5 + column / 2, gl_InstanceID), 0);
    vec2 span = (column & 1) == 0 ? pair.xy : pair.zw;
    ivec2 node = ivec2(min(QUAD * column, size.x), int(span.x + floor((span.y - span.x) * float(row) / float(grid.y) + 0.5)));
    float sum = 0.0, count = 0.0;
    for (int k = 0; k < 4; ++k) {
        float one = nearness(node - ivec2(k & 1, k >> 1), size, corner);
        sum += one; count += sign(one);
    }
    for (int reach = 2; reach <= QUAD && count == 0.0; reach *= 2)
        for (int k = 0; k < 8; ++k) {
            float one = nearness(node + reach * AROUND[k], size, corner);
            sum += one; count += sign(one);
        }
    float depth = count > 0.0 ? count / sum : seen.w;
    vec2 texel = vec2(node);
    vec4 p = vec4((seen.y + texel.x) / seen.x * depth, -(seen.z + texel.y) / seen.x * depth, -depth, 1.0);
    at = vec3(texel * depth, depth);
    here = vec3(dot(x, p), dot(y, p), dot(z, p));
#ifdef LINES
    gl_Position = project_line(here);
#else
    gl_Position = project(here);
#endif
}
"""
_FRAGMENT = """
uniform sampler2D picture;
uniform sampler2D depths;
in vec3 at; in vec3 here;
flat in vec4 place; flat in vec3 eyes;
#if defined(TINTED) || defined(LINES)
uniform vec4 ink;
#endif
#ifdef MEASURED
uniform isampler2D ids;
#endif
const float LEAST = 0.4;  // of coverage
void main() {
    vec2 texel = clamp(at.xy / at.z, vec2(0.5), place.zw - 0.5) + place.xy;
    ivec2 nearest = ivec2(texel);
    vec4 color = texture(picture, texel / vec2(textureSize(picture, 0)));
    float captured = texelFetch(depths, nearest, 0).r;
    if (color.a < LEAST) discard;
#ifdef LINES
    color_out = vec4(ink.rgb, 1.0);
#else
    float stretch = captured > 0.0 ? captured / at.z : 1.0;  // the filter reaches half a texel beyond the silhouette
    vec3 surface = eyes + stretch * (here - eyes);
    float shown = max(-surface.z, clip.x);
    gl_FragDepth = (clip.y - clip.y * clip.x / shown) / (clip.y - clip.x);
#ifdef TINTED
    color.rgb = tinted(color.rgb / color.a, ink) * color.a;
#endif
#ifdef COVERAGE
    color_out = vec4(color.rgb / color.a, clamp((color.a - 0.5) / max(fwidth(color.a), 1e-4) + 0.5, 0.0, 1.0));
    if (color_out.a <= 0.0) discard;
#else
    color_out = vec4(color.rgb / color.a, 1.0);
#endif
#ifdef MEASURED
    float closest = captured > 0.0 ? 0.0 : 1e9;
    ivec2 covered = nearest;
    for (int k = 0; k < 9; ++k) {
        ivec2 other = clamp(nearest + ivec2(k % 3, k / 3) - 1, ivec2(place.xy), ivec2(place.xy + place.zw) - 1);
        vec2 off = vec2(other) + 0.5 - texel;
        if (dot(off, off) < closest && texelFetch(depths, other, 0).r > 0.0) { closest = dot(off, off); covered = other; }
    }
    id_out = texelFetch(ids, covered, 0).r;
    vec3 a = normalize(here), b = normalize(surface);
    surface_out = vec2(shown, atan(length(cross(a, b)), dot(a, b)));
#endif
#endif
}
"""


_VERTEX_OF_QUADS = _VERTEX.replace("QUAD", str(RELIEF_QUAD))


class ReliefsDrawer:
    """Draws :class:`viewer.plan.Relief` of images that were captured."""

    def __init__(self, programs: Programs, images: Images) -> None:
        self._context, self._images, self._covering = programs.context, images, programs.covering
        self._make = programs.make
        self._programs = programs.make(_VERTEX_OF_QUADS, _FRAGMENT)
        self._styled: dict[str, Mapping[bool, Program]] = {}
        self._grids: dict[tuple[int, int], tuple[Any, dict[bool, Any]]] = {}
        self._parts: Any = None

    def draw(self, draw: Relief, view: View, *, measured: bool, ink: Ink | None = None) -> list[int]:
        """Draw all parts with one call, tinted with ``ink`` if there is one. Raises KeyError where nothing was captured into
        the image.
        """
        if not draw.parts:
            return []
        columns, rows = self._told_where(draw, view)
        if ink is None:
            self._programs[measured].set(_grid_size(columns, rows))
            with self._covering(measured=measured):
                self._grid(columns, rows)[measured].render(moderngl.TRIANGLES, instances=len(draw.parts))
        else:
            with self._covering(measured=measured):
                self._render_styled(_TINTED, columns, rows, draw, ink, measured=measured)
        return [2 * columns * rows * len(draw.parts)]

    def draw_lines(self, draw: Relief, view: View, *, ink: Ink, measured: bool) -> None:
        """Draw the grids of all parts where something was captured. Raises KeyError as :meth:`draw` does."""
        if draw.parts:
            columns, rows = self._told_where(draw, view)
            self._render_styled(LINES, columns, rows, draw, ink, measured=measured)

    def _render_styled(self, flag: str, columns: int, rows: int, draw: Relief, ink: Ink, *, measured: bool) -> None:
        if flag not in self._styled:
            self._styled[flag] = self._make(_VERTEX_OF_QUADS, _FRAGMENT, flags=(flag,), measures=flag != LINES)
        program = self._styled[flag][measured]
        program.set({**_grid_size(columns, rows), "ink": ink_bytes(ink)})
        self._grid(columns, rows)
        array = self._context.vertex_array(program.program, [], self._grids[columns, rows][0], index_element_size=4)
        array.render(moderngl.TRIANGLES, instances=len(draw.parts))
        array.release()

    def _told_where(self, draw: Relief, view: View) -> tuple[int, int]:
        """Tell the programs' textures what is drawn; columns and rows of the grid that all parts share."""
        image = self._images[draw.image]
        columns, rows = np.max([part.grid for part in draw.parts], axis=0).tolist()
        for unit, texture in enumerate((image.color, image.depth, image.ids, self._told(draw, view, columns))):
            texture.use(unit)
        return columns, rows

    def _told(self, draw: Relief, view: View, columns: int) -> Any:  # noqa: ANN401
        """The texture that says where the parts are, which have at most so many ``columns``."""
        width, height = _TEXELS + columns // 2 + 1, len(draw.parts)
        if self._parts is None or self._parts.width < width or self._parts.height < height:
            if self._parts is not None:
                self._parts.release()
            self._parts = self._context.texture((2 * width, 2 * height), 4, dtype="f4")
            self._parts.filter = (moderngl.NEAREST, moderngl.NEAREST)
        values = np.zeros((height, 4 * width), dtype="<f4")
        values[:, : 4 * _TEXELS] = _rows(draw.parts, view)
        values[:, 4 * _TEXELS + 1 :: 2] = np.array([part.view.window[3] for part in draw.parts])[:, None]  # all of it
        for row, part in zip(values, draw.parts, strict=True):
            if part.spans is not None:
                spans = _node_spans(part.spans)
                row[4 * _TEXELS : 4 * _TEXELS + spans.size] = spans.ravel()
                row[4 * _TEXELS + spans.size :] = np.resize(spans[-1], 4 * width - 4 * _TEXELS - spans.size)
        self._parts.write(values.tobytes(), viewport=(0, 0, width, height))
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


def _grid_size(columns: int, rows: int) -> dict[str, bytes]:
    return {"grid": np.array([columns, rows], dtype="i4").tobytes()}


def _rows(parts: Sequence[ReliefPart], view: View) -> NDArray[np.float64]:
    """(n, 20) what the shaders need to know of each part, of all at once: there may be hundreds."""
    rows = np.empty((len(parts), 4 * _TEXELS))
    captures = np.array([part.view.eye_from_world for part in parts])
    world_from_capture = np.tile(np.eye(4), (len(parts), 1, 1))
    world_from_capture[:, :3, :3] = np.swapaxes(captures[:, :3, :3], 1, 2)
    world_from_capture[:, :3, 3] = -(world_from_capture[:, :3, :3] @ captures[:, :3, 3:])[..., 0]
    for i, part in enumerate(parts):
        left, top, width, height = part.view.window
        rows[i, 12:] = part.view.focal, left, top, part.filling, *part.corner, width, height
        if part.moved is not None:
            world_from_capture[i] = part.moved @ world_from_capture[i]
    rows[:, :12] = (view.eye_from_world @ world_from_capture)[:, :3].reshape(-1, 12)
    return rows


def _node_spans(spans: NDArray[np.int64]) -> NDArray[np.int64]:
    """(columns + 1, 2) where columns of nodes begin and end: as far as either of the two columns of quads beside them."""
    nodes = np.pad(spans, ((1, 1), (0, 0)), mode="edge")
    return np.column_stack([np.minimum(nodes[:-1, 0], nodes[1:, 0]), np.maximum(nodes[:-1, 1], nodes[1:, 1])])


def _grid_triangles(columns: int, rows: int) -> NDArray[np.int32]:
    """(2 * columns * rows, 3) corners as node numbers, row by row."""
    i, j = np.meshgrid(np.arange(columns), np.arange(rows))
    first = (j * (columns + 1) + i).ravel()
    below = first + columns + 1
    quads = [first, below, first + 1, first + 1, below, below + 1]
    return np.stack(quads, axis=1).reshape(-1, 3).astype("<i4")
