"""Draws plans, with moderngl: the only module of the viewer that touches OpenGL (DESIGN section 5).

Headless through EGL, in software (Mesa) or on a GPU. The city's geometry is one vertex buffer; a set of objects is an index
buffer, one draw. All layers of a cell that a view may show are two draws: triangles as they are, and those that need captured
depths (``mmi.meshing.ordering``), their texture projected from where it was captured. A measured picture also has, per
pixel, the object, its depth, and by what angle an impostor's surface is displaced from the one that was captured (DESIGN
section 6).
"""

from __future__ import annotations

import ctypes
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from types import TracebackType
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from mmi.appearance.city_mesh import CityMesh, triangles_of
from mmi.appearance.ground_mesh import SKY_HORIZON, SKY_ZENITH
from mmi.foundation.camera import View
from mmi.foundation.errors import CaptureError
from viewer.cells.loaded_cell import LoadedCell, LoadedLayer
from viewer.drawing.backdrop import backdrop
from viewer.drawing.buffers import CellBuffers, MeshBuffers, Program, Triangles
from viewer.drawing.drawn_picture import DrawnPicture
from viewer.drawing.shaders import KINDS, program_source
from viewer.drawing.thread_turns import turns_after
from viewer.plan import CellKey, CellLayers, Draw, Ground, Objects, Plan, Sky

__all__ = ["Renderer"]

_NEAR, _FAR = 0.1, 20_000.0
_MOST_SETS = 64
"""Sets of objects kept as index buffers; a walk meets a new one in every cell."""
_MOST_VIEWS = 16
"""Sets of layers of a cell kept as index buffers; a viewer who turns around meets a new one every few degrees."""
_LAYER_VERTEX_BYTES = 24
_SAMPLE_ALPHA_TO_COVERAGE = 0x809E
_SWITCH_INTERVAL = 5e-4
"""Seconds for which other threads may keep the interpreter when OpenGL has finished: Python's own 5 ms would be felt."""


class Renderer:
    """One city in one OpenGL context, drawing pictures of one size. Use as a context manager.

    ``measured`` keeps what measuring needs (object ids of layers). ``samples``: multisampling of unmeasured pictures.
    Raises CaptureError where no OpenGL context can be had.
    """

    def __init__(
        self, mesh: CityMesh, ground: CityMesh, *, size: tuple[int, int], measured: bool = False, samples: int = 0
    ) -> None:
        try:
            self._context: Any = moderngl.create_standalone_context(require=330, backend="egl")  # type: ignore[arg-type]
        except Exception as error:  # moderngl raises bare Exceptions
            raise CaptureError(
                f"no OpenGL 3.3 context through EGL ({error}); on Debian or Ubuntu, "
                "'apt-get install libegl1 libgl1-mesa-dri' brings software rendering"
            ) from error
        try:
            with self._context:  # another library's context may be current, here and whenever we are called again
                if samples > self._context.max_samples:
                    raise CaptureError(f"at most {self._context.max_samples} samples a pixel here, found {samples}")
                self.device = str(self._context.info["GL_RENDERER"])
                """Name of what draws (``llvmpipe ...`` is software)."""
                self._prepare(mesh, ground, size, measured, samples)
        except BaseException:
            self._context.release()
            raise

    def _prepare(self, mesh: CityMesh, ground: CityMesh, size: tuple[int, int], measured: bool, samples: int) -> None:
        self.size, self.measured, self._samples = size, measured, samples
        self._timer = self._context.query(time=True)
        self._finish = _finish_without_lock() or self._finish_with_lock
        self._modes = (False, True) if measured else (False,)
        self._programs = {(kind, mode): self._program(kind, mode) for kind in KINDS for mode in self._modes}
        self._city = self._upload_mesh(
            mesh, np.repeat(np.arange(len(mesh.triangle_counts)), np.diff(mesh.object_vertices))
        )
        self._ground = self._upload_mesh(ground, np.full(len(ground.positions), -2))
        plain = backdrop(ground)
        self._backdrop = self._upload_mesh(plain, np.full(len(plain.positions), -2))
        self._beyond = self._triangles(self._backdrop, plain.triangles)
        self._sets: dict[object, Triangles] = {}
        self._cells: dict[CellKey, CellBuffers] = {}
        self._rooms: dict[CellKey, list[Any]] = {}  # of cells that still make room
        self._screen = {
            (kind, mode): self._context.vertex_array(self._programs[kind, mode].program, [])
            for kind in ("sky", "fade")
            for mode in self._modes
        }
        self._targets = {mode: self._framebuffer(mode) for mode in self._modes}
        self._colors = {mode: self._color_only(target) for mode, target in self._targets.items()}
        self._before = self._context.texture(size, 4)
        self._plain = self._context.framebuffer([self._before])

    def __enter__(self) -> Renderer:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Free everything. The renderer cannot be used afterwards."""
        self._context.release()

    # --------------------------------------------------------------------------------------------------- uploads

    def upload(self, cell: LoadedCell) -> None:
        """Bring all layers of a cell to the GPU."""
        for layer in cell.layers:
            while not self.upload_layer(cell, layer):
                pass

    def upload_layer(self, cell: LoadedCell, layer: LoadedLayer) -> bool:
        """Bring one of a cell's layers to the GPU; draws refer to it by the cell's key and its name. Whether it is there now.

        The first calls for a cell only make room, each some of it: that takes as long as many layers.
        """
        with self._context:
            buffers = self._cells.get(cell.key)
            if buffers is None:
                self._make_room(cell)
                return False
            if layer.name not in buffers.triangles:
                self._fill(buffers, layer)
            return True

    def evict(self, cell: CellKey) -> None:
        """Free a cell's layers; nothing where they are not there."""
        with self._context:
            for texture in self._rooms.pop(cell, ()):
                texture.release()
            if cell in self._cells:
                self._cells.pop(cell).release()

    def _finish_with_lock(self) -> None:
        self._context.finish()
        time.sleep(0.0)  # lets other threads in

    # --------------------------------------------------------------------------------------------------- drawing

    def draw(self, plan: Plan, view: View, *, measured: bool = False, read: bool = True) -> DrawnPicture:
        """Draw ``plan`` as ``view`` sees it. Without ``read``, ``color`` is empty: for timing.

        In a measured picture, ids, depth and displacement are those of ``draws``, whatever fades. Raises KeyError where a layer
        is drawn that was not uploaded, ValueError for measuring with a renderer that was not made for it.
        """
        if measured and not self.measured:
            raise ValueError("a renderer made with measured=True expected")
        with self._context:
            start = time.perf_counter()
            with self._timer:
                triangles, draws = self._draw(plan, view, measured)
            with turns_after(_SWITCH_INTERVAL):
                self._finish()
            seconds = time.perf_counter() - start
            sent = (seconds, self._timer.elapsed * 1e-9, triangles, draws)
            color = self._color(measured) if read else np.empty((0, 0, 3), dtype=np.uint8)
            if not measured:
                return DrawnPicture(color, None, None, None, *sent)
            target = self._targets[True]
            ids = self._read(target, 1, 1, "i4").reshape(self.size[::-1])
            surface = self._read(target, 2, 2, "f4").reshape(*self.size[::-1], 2)
            depth = np.where(surface[..., 0] > 1e29, np.inf, surface[..., 0]).astype(np.float32)
            displacement = np.where(surface[..., 1] < 0.0, np.nan, surface[..., 1]).astype(np.float32)
            return DrawnPicture(color, ids, depth, displacement, *sent)

    def _draw(self, plan: Plan, view: View, measured: bool) -> tuple[int, int]:
        if plan.mix >= 1.0:
            return self._paint(plan.draws, view, measured)
        before = self._paint(plan.fading, view, measured)
        self._context.copy_framebuffer(self._plain, self._colors[measured])
        now = self._paint(plan.draws, view, measured)
        self._colors[measured].use()
        self._context.disable(moderngl.DEPTH_TEST)
        self._context.enable(moderngl.BLEND)
        self._context.blend_func = moderngl.SRC_ALPHA, moderngl.ONE_MINUS_SRC_ALPHA
        self._before.use(0)
        self._programs["fade", measured].set({"share": np.float32(1.0 - plan.mix).tobytes()})
        self._screen["fade", measured].render(moderngl.TRIANGLES, vertices=3)
        self._context.disable(moderngl.BLEND)
        return before[0] + now[0] + 1, before[1] + now[1] + 1

    def _paint(self, draws: Sequence[Draw], view: View, measured: bool) -> tuple[int, int]:
        """Draw into the target; triangles and draws sent."""
        context, target = self._context, self._targets[measured]
        target.use()
        target.clear(0.0, 0.0, 0.0, 1.0)
        context.enable_only(moderngl.DEPTH_TEST)
        self._look_through(view, measured)
        triangles = calls = 0
        for draw in draws:
            if isinstance(draw, Sky):
                self._screen["sky", measured].render(moderngl.TRIANGLES, vertices=3)
                counts = [1]
            elif isinstance(draw, Ground):
                counts = self._draw_ground(draw, measured)
            elif isinstance(draw, Objects):
                counts = self._draw_set(self._city, self._kept(draw.key, self._city, draw.objects), measured)
            else:
                counts = self._draw_layers(draw, view, measured)
            triangles, calls = triangles + sum(counts), calls + len(counts)
        return triangles, calls

    def _look_through(self, view: View, measured: bool) -> None:
        left, top, width, height = view.window
        f = view.focal
        projection = (2.0 * f / width, 2.0 * f / height, -(2.0 * left / width + 1.0), 2.0 * top / height + 1.0)
        values = {
            "eye_from_world": np.ascontiguousarray(view.eye_from_world[:3, :3].T, dtype="f4").tobytes(),
            "eye": view.eye.astype("f4").tobytes(),
            "projection": np.array(projection, dtype="f4").tobytes(),
            "clip": np.array([_NEAR, _FAR], dtype="f4").tobytes(),
            "horizon": (np.array(SKY_HORIZON) / 255.0).astype("f4").tobytes(),
            "zenith": (np.array(SKY_ZENITH) / 255.0).astype("f4").tobytes(),
        }
        for (_, mode), program in self._programs.items():
            if mode == measured:
                program.set(values)

    def _draw_set(self, mesh: MeshBuffers, some: Triangles, measured: bool) -> list[int]:
        if not some.count:
            return []
        mesh.texture.use(0)
        some.arrays[measured].render()
        return [some.count]

    def _draw_ground(self, draw: Ground, measured: bool) -> list[int]:
        tiles = self._kept(draw.tiles, self._ground, np.array(draw.tiles, dtype=np.int64))
        return [
            *self._draw_set(self._ground, tiles, measured),
            *self._draw_set(self._backdrop, self._beyond, measured),
        ]

    def _draw_layers(self, draw: CellLayers, view: View, measured: bool) -> list[int]:
        if not draw.names:
            return []
        cell = self._cells[draw.cell]
        if draw.names not in cell.sets:
            if len(cell.sets) >= _MOST_VIEWS:
                for some in cell.sets.pop(next(iter(cell.sets))):
                    some.release()
            cell.sets[draw.names] = self._layer_set(cell, draw.names)
        for unit, texture in enumerate(cell.textures):
            texture.use(unit)
        smooth = self._samples and not measured
        if smooth:
            self._context.enable_direct(_SAMPLE_ALPHA_TO_COVERAGE)
        values = {
            "captured_from": cell.eye.astype("f4").tobytes(),
            "viewer": (view.eye - cell.eye).astype("f4").tobytes(),
            "ahead": np.float32(view.project(cell.eye[None])[0, 2]).tobytes(),
        }
        counts = []
        for kind, some in zip(("layer", "captured"), cell.sets[draw.names], strict=True):
            if some.count:
                self._programs[kind, measured].set(values)
                some.arrays[measured].render()
                counts.append(some.count)
        if smooth:
            self._context.disable_direct(_SAMPLE_ALPHA_TO_COVERAGE)
        return counts

    def _layer_set(self, cell: CellBuffers, names: tuple[str, ...]) -> tuple[Triangles, Triangles]:
        """Triangles of some layers of a cell, in this order. Raises KeyError where one is not there."""
        parts = [cell.triangles[name] for name in names]
        layout = [(cell.vertices, "3f 3f", "position", "texture_from_capture")]
        sets = []
        for k, kind in enumerate(("layer", "captured")):
            triangles = np.concatenate([np.empty((0, 3), dtype=np.int32), *(part[k] for part in parts)])
            indices = self._context.buffer(np.ascontiguousarray(triangles, dtype="<i4").tobytes() or b"none")
            arrays = {
                mode: self._context.vertex_array(self._programs[kind, mode].program, layout, indices)
                for mode in self._modes
                if len(triangles)
            }
            sets.append(Triangles(len(triangles), arrays, indices))
        return sets[0], sets[1]

    def _color(self, measured: bool) -> NDArray[np.uint8]:
        target = self._targets[measured]
        if self._samples and not measured:
            self._context.copy_framebuffer(self._plain, target)
            target = self._plain
        return np.ascontiguousarray(self._read(target, 0, 4, "u1").reshape(*self.size[::-1], 4)[..., :3])

    def _read(self, target: Any, attachment: int, components: int, dtype: str) -> NDArray[Any]:  # noqa: ANN401
        data = target.read(components=components, attachment=attachment, dtype="f1" if dtype == "u1" else dtype)
        return np.frombuffer(data, dtype=dtype).reshape(self.size[1], -1)[::-1]

    # --------------------------------------------------------------------------------------------------- buffers

    def _program(self, kind: str, measured: bool) -> Program:
        flags = ["MEASURED"] if measured and kind != "fade" else []
        if self._samples and not measured:
            flags.append("COVERAGE")
        vertex, fragment = program_source(kind, flags=flags)
        program = self._context.program(vertex_shader=vertex, fragment_shader=fragment)
        members = {name: program[name] for name in program if isinstance(program[name], moderngl.Uniform)}
        for unit, name in enumerate(("picture", "depths", "ids")):
            if name in members:
                members[name].value = unit
        return Program(program, members)

    def _framebuffer(self, measured: bool) -> Any:  # noqa: ANN401
        context, size = self._context, self.size
        if not measured:
            samples = self._samples
            return context.framebuffer(
                [context.renderbuffer(size, 4, samples=samples)], context.depth_renderbuffer(size, samples=samples)
            )
        return context.framebuffer(
            [
                context.renderbuffer(size, 4),
                context.renderbuffer(size, 1, dtype="i4"),
                context.renderbuffer(size, 2, dtype="f4"),
            ],
            context.depth_renderbuffer(size),
        )

    def _color_only(self, target: Any) -> Any:  # noqa: ANN401
        """The same picture without depth and measures."""
        return self._context.framebuffer([target.color_attachments[0]])

    def _upload_mesh(self, mesh: CityMesh, objects: NDArray[np.int64]) -> MeshBuffers:
        layout = np.dtype([("position", "<f4", 3), ("uv", "<f4", 2), ("color", "u1", 4), ("object", "<i4")])
        vertices = np.zeros(len(mesh.positions), dtype=layout)
        vertices["position"], vertices["uv"] = mesh.positions, mesh.uv
        vertices["color"][:, :3], vertices["object"] = mesh.colors, objects
        return MeshBuffers(mesh, self._context.buffer(vertices.tobytes()), self._texture(mesh.texture))

    def _triangles(self, mesh: MeshBuffers, triangles: NDArray[np.int32]) -> Triangles:
        if not len(triangles):
            return Triangles(0, {}, self._context.buffer(reserve=4))
        indices = self._context.buffer(np.ascontiguousarray(triangles, dtype="<i4").tobytes())
        arrays = {}
        for mode in self._modes:
            layout = ["3f 2f 3f1 x1 1i" if mode else "3f 2f 3f1 x1 x4", "position", "uv", "color"]
            if mode:
                layout.append("object")
            program = self._programs["geometry", mode].program
            arrays[mode] = self._context.vertex_array(program, [(mesh.vertices, *layout)], indices)
        return Triangles(len(triangles), arrays, indices)

    def _kept(self, key: object, mesh: MeshBuffers, objects: NDArray[np.int64]) -> Triangles:
        """Triangles of some objects of a mesh, made when first drawn and kept until others were drawn more recently."""
        found = self._sets.pop(key, None)
        if found is None:
            found = self._triangles(mesh, triangles_of(mesh.mesh, objects))
            if len(self._sets) >= _MOST_SETS:
                self._sets.pop(next(iter(self._sets))).release()
        self._sets[key] = found
        return found

    def _texture(self, pixels: NDArray[np.uint8]) -> Any:  # noqa: ANN401
        texture = self._context.texture(
            pixels.shape[1::-1], pixels.shape[2], np.ascontiguousarray(pixels).tobytes(), alignment=1
        )
        texture.build_mipmaps()
        texture.filter = (moderngl.LINEAR_MIPMAP_LINEAR, moderngl.LINEAR)
        texture.repeat_x = texture.repeat_y = True
        return texture

    def _make_room(self, cell: LoadedCell) -> None:
        """Make the next texture for the layers of a cell; after the last one, the rest of the room for them."""
        limit = self._context.info["GL_MAX_TEXTURE_SIZE"]
        if max(cell.size) > limit:
            raise CaptureError(
                f"OpenGL here has textures of at most {limit} texels a side, and a cell needs {cell.size}"
            )
        kinds = [(4, "f1", moderngl.LINEAR), (1, "f4", moderngl.NEAREST)]
        if self.measured:
            kinds.append((1, "i4", moderngl.NEAREST))
        textures = self._rooms.setdefault(cell.key, [])
        components, dtype, smoothing = kinds[len(textures)]
        texture = self._context.texture(cell.size, components, dtype=dtype, alignment=1)
        texture.filter = (smoothing, smoothing)  # texels are about as large as pixels: no mipmaps
        texture.repeat_x = texture.repeat_y = False
        textures.append(texture)
        if len(textures) < len(kinds):
            return
        counts = [len(layer.vertices) for layer in cell.layers]
        first = dict(zip((layer.name for layer in cell.layers), np.cumsum([0, *counts]).tolist(), strict=False))
        vertices = self._context.buffer(reserve=max(sum(counts), 1) * _LAYER_VERTEX_BYTES)
        self._cells[cell.key] = CellBuffers(cell.eye, tuple(self._rooms.pop(cell.key)), vertices, first, {}, {})

    def _fill(self, cell: CellBuffers, layer: LoadedLayer) -> None:
        """Put a layer where there is room for it."""
        if self.measured and layer.object_ids is None:
            raise ValueError(f"layer {layer.name}: object ids expected for measuring, found none")
        height, width = layer.depth.shape
        for texture, values in zip(cell.textures, (layer.pixels, layer.depth, layer.object_ids), strict=False):
            texture.write(np.ascontiguousarray(values).tobytes(), viewport=(*layer.corner, width, height), alignment=1)
        first = cell.first_vertex[layer.name]
        cell.vertices.write(layer.vertices.astype("<f4").tobytes(), offset=first * _LAYER_VERTEX_BYTES)
        triangles = layer.triangles + np.int32(first)
        cell.triangles[layer.name] = triangles[: layer.plain], triangles[layer.plain :]


def _finish_without_lock() -> Callable[[], object] | None:
    """glFinish as ctypes calls it, which lets Python's other threads run meanwhile; moderngl does not. None where it is not
    found.

    Most of a frame is spent waiting there, which is the time that cells are loaded in (``viewer.cells.cell_cache``).
    """
    for name in ("libOpenGL.so.0", "libGL.so.1"):
        with suppress(OSError, AttributeError):
            finish = ctypes.CDLL(name).glFinish
            finish.restype, finish.argtypes = None, ()
            return finish
    return None
