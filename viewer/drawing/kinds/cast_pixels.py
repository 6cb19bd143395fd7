"""Single pixels whose surfaces a technique has found itself: what the renderer adds is their colour, from the city's texture.

Where the pixel's middle sees the surface at the same place, it has the colour that geometry drawn there has: the same texture,
filtered at the same level, times the same tint; and the same depth.

Pixels come in flocks. They are sorted into tiles of the picture, each of them a square that reads what its pixels show from two
textures, because a point for each pixel takes several times as long.
"""

from __future__ import annotations

from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from mmi.foundation.kernels import kernel
from viewer.drawing.programs import InkedArrays, InkedProgram, Programs
from viewer.drawing.style import Ink

__all__ = ["CastPixelsDrawer"]

_TILE = 16
"""Pixels of a side of a tile."""
_ACROSS = 16
"""Tiles in a row of the textures, whose pixels stand one after the other."""
_VERTEX = """
in uvec2 tile;
uniform vec2 size;
flat out ivec2 first; flat out int slot;
void main() {
    first = ivec2(tile) * TILE; slot = gl_InstanceID;
    vec2 corner = min(vec2(first) + TILE * vec2(gl_VertexID & 1, gl_VertexID >> 1), size) / size * 2.0 - 1.0;
    gl_Position = vec4(corner.x, -sign(projection.y) * corner.y, 0.0, 1.0);
}
"""
_FRAGMENT = """
uniform sampler2D picture;
uniform sampler2D depths;  // texture coordinates, level, depth; no depth where the pixel is none of them
uniform isampler2D ids;    // object, tint
uniform vec2 size;
#ifdef TINTED
uniform vec4 ink;
#endif
flat in ivec2 first; flat in int slot;
void main() {
    float row = projection.y > 0.0 ? size.y - gl_FragCoord.y : gl_FragCoord.y;
    ivec2 place = ivec2(gl_FragCoord.x, row) - first;
    ivec2 texel = ivec2((slot % ACROSS) * TILE * TILE + place.y * TILE + place.x, slot / ACROSS);
    vec4 known = texelFetch(depths, texel, 0);
    if (known.w <= 0.0) discard;
    ivec2 other = texelFetch(ids, texel, 0).rg;
    vec3 tint = vec3(other.g & 255, (other.g >> 8) & 255, (other.g >> 16) & 255) / 255.0;
    color_out = vec4(textureLod(picture, known.xy, known.z).rgb * tint, 1.0);
    gl_FragDepth = (clip.y - clip.y * clip.x / known.w) / (clip.y - clip.x);
#ifdef TINTED
    color_out.rgb = tinted(color_out.rgb, ink);
#endif
#ifdef MEASURED
    id_out = other.r; surface_out = vec2(known.w, -1.0);
#endif
}
"""
_NUMBERS = f"\nconst int TILE = {_TILE}, ACROSS = {_ACROSS};\n"


class CastPixelsDrawer:
    """Draws :class:`viewer.computed.CastPixels` with ``texture``, the city's."""

    def __init__(self, programs: Programs, texture: Any) -> None:  # noqa: ANN401
        self._context, self._texture = programs.context, texture
        self._program = InkedProgram(programs, _NUMBERS + _VERTEX, _NUMBERS + _FRAGMENT)
        self._rows = 0
        self._textures: tuple[Any, Any] = (None, None)
        self._kept = np.empty((0, 4), dtype=np.float32), np.empty((0, 2), dtype=np.int32)
        self._tiles: Any = None
        self._arrays = InkedArrays(self._program, ())

    def draw(
        self, samples: NDArray[np.void], size: tuple[int, int], *, measured: bool, ink: Ink | None = None
    ) -> list[int]:
        """Draw pixels (n,) of a picture of ``size`` in a call, tinted with ``ink`` if there is one: two triangles a tile."""
        if not len(samples):
            return []
        columns = -(-size[0] // _TILE)
        slots = np.full(columns * -(-size[1] // _TILE), -1, dtype=np.int32)
        count = _slots(samples["pixel"], columns, slots)
        rows = -(-count // _ACROSS)
        self._make_room(rows)
        end = rows * _ACROSS * _TILE * _TILE
        casts, others = self._kept[0][:end], self._kept[1][:end]
        casts[:, 3] = 0.0  # none of them
        _sort(samples["pixel"], samples, samples["uv"], samples["tint"], columns, slots, casts, others)
        for unit, (texture, values) in enumerate(zip(self._textures, (casts, others), strict=True), 1):
            texture.write(values, viewport=(0, 0, _ACROSS * _TILE * _TILE, rows))
            texture.use(unit)
        used = np.flatnonzero(slots >= 0)
        tiles = np.empty((count, 2), dtype="<u2")
        tiles[slots[used]] = np.column_stack([used % columns, used // columns])
        self._tiles.write(tiles)
        self._texture.use(0)
        array = self._arrays.ready(ink, measured=measured, told={"size": np.array(size, dtype="<f4").tobytes()})
        array.render(moderngl.TRIANGLE_STRIP, vertices=4, instances=count)
        return [2 * count]

    def _make_room(self, rows: int) -> None:
        """Have room for so many rows of tiles."""
        if self._rows >= rows:
            return
        if self._rows:
            for thing in (self._arrays, *self._textures, self._tiles):
                thing.release()
        self._rows = 1 << max(rows - 1, 15).bit_length()
        size = (_ACROSS * _TILE * _TILE, self._rows)
        self._textures = self._context.texture(size, 4, dtype="f4"), self._context.texture(size, 2, dtype="i4")
        for texture in self._textures:
            texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        count = size[0] * size[1]
        self._kept = np.empty((count, 4), dtype=np.float32), np.empty((count, 2), dtype=np.int32)
        self._tiles = self._context.buffer(reserve=4 * self._rows * _ACROSS, dynamic=True)
        self._arrays = InkedArrays(self._program, [(self._tiles, "2u2/i", "tile")])


@kernel(error_model="numpy", nogil=True)
def _slots(pixel: NDArray[np.uint16], columns: int, slots: NDArray[np.int32]) -> int:
    """Give each tile that has one of the pixels a slot, in ``slots`` of tiles, -1 for none; how many have one."""
    count = 0
    for k in range(len(pixel)):
        tile = pixel[k, 1] // _TILE * columns + pixel[k, 0] // _TILE
        if slots[tile] < 0:
            slots[tile] = count
            count += 1
    return count


@kernel(error_model="numpy", nogil=True)
def _sort(
    pixel: NDArray[np.uint16],
    samples: NDArray[np.void],
    uv: NDArray[np.float32],
    tint: NDArray[np.uint8],
    columns: int,
    slots: NDArray[np.int32],
    casts: NDArray[np.float32],
    others: NDArray[np.int32],
) -> None:
    """Put each sample into its tile's place of both textures; ``slots`` are those of all tiles."""
    for k in range(len(pixel)):
        x, y = pixel[k, 0] % _TILE, pixel[k, 1] % _TILE
        tile = pixel[k, 1] // _TILE * columns + pixel[k, 0] // _TILE
        place = slots[tile] * _TILE * _TILE + y * _TILE + x
        casts[place, 0], casts[place, 1] = uv[k, 0], uv[k, 1]
        casts[place, 2], casts[place, 3] = samples[k].level, samples[k].depth
        others[place, 0] = samples[k].object
        others[place, 1] = tint[k, 0] | (tint[k, 1] << 8) | (tint[k, 2] << 16)
