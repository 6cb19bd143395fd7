"""Impostor layers of cells: their pictures in one atlas a cell, their texture projected from where it was captured.

All layers of a cell that a view may show are two draws: triangles as they are, and those that need captured depths
(``mmi.meshing.ordering``). For the latter (``CAPTURED_DEPTH``) each fragment takes the depth of the surface point that its
texel captured, as this view sees it.

Pictures that the dataset does not hold are in an image that requests captured into (``CAPTURED``): premultiplied, with nothing
beyond silhouettes. They also show what nobody in the cell can see (``mmi.capture.unseen``), which the mesh does not follow, so
that all their triangles need captured depths. They have no rims (``mmi.capture.rims``). Instead their coverage reaches a
quarter of a texel farther: that closes most of the gaps, and more would show around every silhouette.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from mmi.foundation.camera import View
from mmi.foundation.errors import CaptureError
from viewer.cells.loaded_cell import LoadedCell, LoadedLayer, StoredPicture, cell_image
from viewer.drawing.images import Images
from viewer.drawing.kinds.lines import LineProgram
from viewer.drawing.kinds.meshes import Triangles
from viewer.drawing.programs import Program, Programs
from viewer.drawing.style import layer_ink
from viewer.plan import CellKey, CellLayers, ImageKey

__all__ = ["LayersDrawer"]

_MOST_VIEWS = 16
"""Sets of layers that a cell keeps as index buffers; a viewer who turns around meets a new one every few degrees."""
_VERTEX_BYTES = 24
_LAYOUT = ("3f 3f", "position", "texture_from_capture")
_PLAIN: tuple[str, ...] = ()
_DEEP, _CAPTURED = ("CAPTURED_DEPTH",), ("CAPTURED_DEPTH", "CAPTURED")
_VERTEX = """
in vec3 position;
in vec3 texture_from_capture;  // texture coordinates times depth in the capture, and that: linear in space, so projective
uniform vec3 captured_from;
#ifdef CAPTURED
uniform vec2 share;            // of the image's room that its pictures take
#endif
out vec3 at;
#ifdef TINTED
in vec4 ink;
flat out vec4 tint;
#endif
#if defined(MEASURED) || defined(CAPTURED_DEPTH)
out float depth;
#endif
#ifdef MEASURED
out vec3 world;                // relative to the capture's eye
#endif
void main() {
    vec3 p = eye_from_world * (position - eye);
    at = texture_from_capture;
#ifdef TINTED
    tint = ink;
#endif
#ifdef CAPTURED
    at.xy *= share;
#endif
#if defined(MEASURED) || defined(CAPTURED_DEPTH)
    depth = -p.z;
#endif
#ifdef MEASURED
    world = position - captured_from;
#endif
    gl_Position = project(p);
}
"""
_FRAGMENT = """
uniform sampler2D picture;
in vec3 at;
#ifdef TINTED
flat in vec4 tint;
#endif
#if defined(MEASURED) || defined(CAPTURED_DEPTH)
in float depth;
uniform sampler2D depths;
uniform float ahead;           // how far the capture's eye is ahead of the viewer, along the axis
#endif
#ifdef MEASURED
in vec3 world;
uniform isampler2D ids;
uniform vec3 viewer;           // relative to the capture's eye
#endif
#ifdef CAPTURED
const float LEAST = 0.25;      // of coverage
#else
const float LEAST = 0.5;
#endif
void main() {
    vec2 uv = at.xy / at.z;
    vec4 color = texture(picture, uv);
#ifdef CAPTURED
    color.rgb /= max(color.a, LEAST);
#endif
#ifdef TINTED
    color.rgb = tinted(color.rgb, tint);
#endif
#ifdef COVERAGE
    float sharp = clamp((color.a - 0.5) / max(fwidth(color.a), 1e-4) + 0.5, 0.0, 1.0);
#ifdef CAPTURED
    if (color.a < LEAST) discard;
#endif
    if (sharp <= 0.0) discard;
    color_out = vec4(color.rgb, sharp);
#else
    if (color.a < LEAST) discard;
    color_out = vec4(color.rgb, 1.0);
#endif
#if defined(MEASURED) || defined(CAPTURED_DEPTH)
    ivec2 size = textureSize(depths, 0);
    ivec2 nearest = clamp(ivec2(floor(uv * vec2(size))), ivec2(0), size - 1);
    float captured_depth = texelFetch(depths, nearest, 0).r;
#ifdef CAPTURED
    if (captured_depth <= 0.0) {  // the filter reaches half a texel beyond the silhouette
        float closest = 1e9;
        ivec2 middle = nearest;
        for (int k = 0; k < 9; ++k) {
            ivec2 other = clamp(middle + ivec2(k % 3, k / 3) - 1, ivec2(0), size - 1);
            float one = texelFetch(depths, other, 0).r;
            vec2 off = vec2(other) + 0.5 - uv * vec2(size);
            if (one > 0.0 && dot(off, off) < closest) { closest = dot(off, off); captured_depth = one; nearest = other; }
        }
        if (captured_depth <= 0.0) captured_depth = at.z;
    }
#else
    if (isinf(captured_depth)) captured_depth = at.z;
#endif
    float stretch = captured_depth / max(at.z, 1e-6);  // the captured point, on one ray from the capture's eye
    float shown_depth = depth;
#endif
#ifdef CAPTURED_DEPTH
    shown_depth = max(ahead + stretch * (depth - ahead), clip.x);
    gl_FragDepth = (clip.y - clip.y * clip.x / shown_depth) / (clip.y - clip.x);
#endif
#ifdef MEASURED
    int id = texelFetch(ids, nearest, 0).r;
    for (int k = 0; k < 9 && id < 0; ++k) {  // the filter reaches half a texel beyond the silhouette
        ivec2 other = clamp(nearest + ivec2(k % 3, k / 3) - 1, ivec2(0), size - 1);
        id = texelFetch(ids, other, 0).r;
    }
    id_out = id;
    vec3 a = normalize(world - viewer), b = normalize(world * stretch - viewer);
    surface_out = vec2(shown_depth, id < 0 ? -1.0 : atan(length(cross(a, b)), dot(a, b)));
#endif
}
"""


@dataclass(frozen=True, slots=True, eq=False)
class _CellOnGpu:
    """A cell's layers on the GPU: their atlas and vertices; of each layer that is there its triangles, as indices into all.

    The atlas is ``textures``, or the ``image`` that pictures are captured into, and then there are none.
    ``sets`` are the triangles of layers that were drawn together: those drawn as they are, and those that need captured depths.
    """

    eye: NDArray[np.float64]
    textures: tuple[Any, ...]
    image: ImageKey | None
    size: tuple[int, int]
    vertices: Any
    first_vertex: Mapping[str, int]
    triangles: dict[str, tuple[NDArray[np.int32], NDArray[np.int32]]]
    sets: dict[tuple[str, ...], tuple[Triangles, Triangles]]

    def release(self) -> None:
        """Free it."""
        for pair in self.sets.values():
            for some in pair:
                some.release()
        for thing in (*self.textures, self.vertices):
            thing.release()


class LayersDrawer:
    """Draws :class:`viewer.plan.CellLayers`, of cells that were uploaded; ``measured`` keeps object ids of layers as well."""

    def __init__(self, programs: Programs, images: Images, *, measured: bool) -> None:
        self._context, self._covering, self._measured = programs.context, programs.covering, measured
        self._images = images
        plain, deep, captured = (programs.make(_VERTEX, _FRAGMENT, flags=flags) for flags in (_PLAIN, _DEEP, _CAPTURED))
        self._programs = {False: (plain, deep), True: (captured, captured)}
        self._tinted: dict[bool, tuple[Mapping[bool, Program], Mapping[bool, Program]]] = {}
        self._inks: dict[CellKey, Any] = {}
        self._make = programs.make
        self._cells: dict[CellKey, _CellOnGpu] = {}
        self._rooms: dict[CellKey, list[Any]] = {}  # of cells that still make room

    def upload_layer(self, cell: LoadedCell, layer: LoadedLayer) -> bool:
        """Bring one of a cell's layers to the GPU, as :meth:`viewer.drawing.renderer.Renderer.upload_layer` says."""
        there = self._cells.get(cell.key)
        if there is None:
            self._make_room(cell)
            return False
        if layer.name not in there.triangles:
            self._fill(there, layer)
        return True

    def evict(self, cell: CellKey) -> None:
        """Free a cell's layers; nothing where they are not there."""
        for texture in self._rooms.pop(cell, ()):
            texture.release()
        if cell in self._inks:
            self._inks.pop(cell).release()
        if cell in self._cells:
            self._cells.pop(cell).release()
        self._images.drop(cell_image(cell))

    def draw(self, draw: CellLayers, view: View, *, measured: bool, tint: bool = False) -> list[int]:
        """Draw the layers with at most two calls, tinted if asked. Raises KeyError where a layer was not uploaded."""
        if not draw.names:
            return []
        cell = self._cells[draw.cell]
        sets = self._kept_set(cell, draw.names)
        share, textures = (1.0, 1.0), cell.textures
        if cell.image is not None:
            image = self._images[cell.image]
            textures = (image.color, image.depth, image.ids)
            share = (cell.size[0] / image.room[0], cell.size[1] / image.room[1])
        for unit, texture in enumerate(textures):
            texture.use(unit)
        values = {
            "captured_from": cell.eye.astype("f4").tobytes(),
            "viewer": (view.eye - cell.eye).astype("f4").tobytes(),
            "ahead": np.float32(view.project(cell.eye[None])[0, 2]).tobytes(),
            "share": np.array(share, dtype="f4").tobytes(),
        }
        counts = []
        programs = (self._tints() if tint else self._programs)[cell.image is not None]
        with self._covering(measured=measured):
            for program, some in zip(programs, sets, strict=True):
                if some.count:
                    program[measured].set(values)
                    if tint:
                        self._render_tinted(draw.cell, program[measured], some)
                    else:
                        some.arrays[measured].render()
                    counts.append(some.count)
        return counts

    def draw_lines(self, draw: CellLayers, program: LineProgram, *, measured: bool) -> None:
        """Draw the edges of the layers' meshes in the layers' colours. Raises KeyError where a layer was not uploaded."""
        if draw.names:
            cell = self._cells[draw.cell]
            for some in self._kept_set(cell, draw.names):
                if some.count:
                    vertices = (cell.vertices, "3f 12x")
                    program.draw_inked(vertices, some.indices, self._ink_of(draw.cell), measured=measured)

    def _tints(self) -> Mapping[bool, tuple[Mapping[bool, Program], Mapping[bool, Program]]]:
        """The programs as :attr:`_programs` has them, which tint; made when first asked for."""
        if not self._tinted:
            plain, deep, captured = (
                self._make(_VERTEX, _FRAGMENT, flags=(*flags, "TINTED")) for flags in (_PLAIN, _DEEP, _CAPTURED)
            )
            self._tinted |= {False: (plain, deep), True: (captured, captured)}
        return self._tinted

    def _render_tinted(self, key: CellKey, program: Program, some: Triangles) -> None:
        layout = [(self._cells[key].vertices, *_LAYOUT), (self._ink_of(key), "4f1", "ink")]
        array = self._context.vertex_array(program.program, layout, some.indices)
        array.render()
        array.release()

    def _ink_of(self, key: CellKey) -> Any:  # noqa: ANN401
        """The inks of a cell's vertices, each that of its layer; made when first asked for."""
        if key not in self._inks:
            cell = self._cells[key]
            starts = [*cell.first_vertex.values(), cell.vertices.size // _VERTEX_BYTES]
            inks = np.array([layer_ink(name) for name in cell.first_vertex], dtype=np.uint8).reshape(-1, 4)
            self._inks[key] = self._context.buffer(np.repeat(inks, np.diff(starts), axis=0).tobytes() or b"none")
        return self._inks[key]

    def _kept_set(self, cell: _CellOnGpu, names: tuple[str, ...]) -> tuple[Triangles, Triangles]:
        """Triangles of some layers of a cell, made when first drawn and kept while few others are."""
        if names not in cell.sets:
            if len(cell.sets) >= _MOST_VIEWS:
                for some in cell.sets.pop(next(iter(cell.sets))):
                    some.release()
            cell.sets[names] = self._layer_set(cell, names)
        return cell.sets[names]

    def _layer_set(self, cell: _CellOnGpu, names: tuple[str, ...]) -> tuple[Triangles, Triangles]:
        """Triangles of some layers of a cell, in this order. Raises KeyError where one is not there."""
        parts = [cell.triangles[name] for name in names]
        layout = [(cell.vertices, *_LAYOUT)]
        sets = []
        for k, programs in enumerate(self._programs[cell.image is not None]):
            triangles = np.concatenate([np.empty((0, 3), dtype=np.int32), *(part[k] for part in parts)])
            indices = self._context.buffer(np.ascontiguousarray(triangles, dtype="<i4").tobytes() or b"none")
            arrays = {
                mode: self._context.vertex_array(program.program, layout, indices)
                for mode, program in programs.items()
                if len(triangles)
            }
            sets.append(Triangles(len(triangles), arrays, indices))
        return sets[0], sets[1]

    def _make_room(self, cell: LoadedCell) -> None:
        """Make the next texture for the layers of a cell, or their image; after the last one, the rest of the room for them."""
        if cell.image is not None:
            if self._images.reserve(cell.image, cell.size):
                self._begin(cell, ())
            return
        limit = self._context.info["GL_MAX_TEXTURE_SIZE"]
        if max(cell.size) > limit:
            raise CaptureError(
                f"OpenGL here has textures of at most {limit} texels a side, and a cell needs {cell.size}"
            )
        kinds = [(4, "f1", moderngl.LINEAR), (1, "f4", moderngl.NEAREST)]
        if self._measured:
            kinds.append((1, "i4", moderngl.NEAREST))
        textures = self._rooms.setdefault(cell.key, [])
        components, dtype, smoothing = kinds[len(textures)]
        texture = self._context.texture(cell.size, components, dtype=dtype, alignment=1)
        texture.filter = (smoothing, smoothing)  # texels are about as large as pixels: no mipmaps
        texture.repeat_x = texture.repeat_y = False
        textures.append(texture)
        if len(textures) == len(kinds):
            self._begin(cell, tuple(self._rooms.pop(cell.key)))

    def _begin(self, cell: LoadedCell, textures: tuple[Any, ...]) -> None:
        """Make room for the vertices of a cell whose pictures have room."""
        counts = [len(layer.vertices) for layer in cell.layers]
        first = dict(zip((layer.name for layer in cell.layers), np.cumsum([0, *counts]).tolist(), strict=False))
        vertices = self._context.buffer(reserve=max(sum(counts), 1) * _VERTEX_BYTES)
        self._cells[cell.key] = _CellOnGpu(cell.eye, textures, cell.image, cell.size, vertices, first, {}, {})

    def _fill(self, cell: _CellOnGpu, layer: LoadedLayer) -> None:
        """Put a layer where there is room for it."""
        picture = layer.picture
        if isinstance(picture, StoredPicture):
            if self._measured and picture.object_ids is None:
                raise ValueError(f"layer {layer.name}: object ids expected for measuring, found none")
            place = (*layer.corner, *picture.depth.shape[::-1])
            for texture, values in zip(
                cell.textures, (picture.pixels, picture.depth, picture.object_ids), strict=False
            ):
                texture.write(np.ascontiguousarray(values).tobytes(), viewport=place, alignment=1)
        first = cell.first_vertex[layer.name]
        cell.vertices.write(layer.vertices.astype("<f4").tobytes(), offset=first * _VERTEX_BYTES)
        triangles = layer.triangles + np.int32(first)
        in_order = layer.in_order if cell.image is None else 0
        cell.triangles[layer.name] = triangles[:in_order], triangles[in_order:]
