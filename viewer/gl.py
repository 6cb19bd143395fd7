"""Draws plans, with moderngl: the only module of the viewer that touches OpenGL (DESIGN section 5).

Headless through EGL, in software (Mesa) or on a GPU. The city's geometry is one vertex buffer; a set of objects is an
index buffer, one draw. An impostor layer is one draw, its texture projected from where it was captured. A measured frame
also yields, per pixel, the object, its depth, and by how many pixels an impostor's surface is displaced from the one that
was captured (DESIGN section 6).
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from mmi.camera import View
from mmi.errors import CaptureError
from mmi.ground import SKY_HORIZON, SKY_ZENITH
from mmi.impostor import Impostor, Layer
from mmi.surfaces import CityMesh
from viewer.technique import CellLayers, Draw, Ground, Objects, Plan, Sky

__all__ = ["Frame", "Renderer"]

_NEAR, _FAR = 0.1, 20_000.0

_COMMON = """
#version 330
uniform mat3 eye_from_world;
uniform vec3 eye;
uniform vec4 projection;  // x and y scale, x and y offset
uniform vec2 clip;        // near, far
vec4 project(vec3 p) {    // p in the eye's frame
    return vec4(projection.x * p.x - projection.z * p.z, projection.y * p.y - projection.w * p.z,
                (clip.y + clip.x) / (clip.x - clip.y) * p.z + 2.0 * clip.x * clip.y / (clip.x - clip.y), -p.z);
}
"""
_OUTPUTS = """
layout(location = 0) out vec4 color_out;
#ifdef MEASURED
layout(location = 1) out int id_out;
layout(location = 2) out vec2 surface_out;  // depth along the axis, displacement as an angle
#endif
"""
_GEOMETRY_VERTEX = """
in vec3 position; in vec2 uv; in vec3 color; in int object;
out vec2 at; out vec3 tint; flat out int which; out float depth;
void main() {
    vec3 p = eye_from_world * (position - eye);
    at = uv; tint = color; which = object; depth = -p.z;
    gl_Position = project(p);
}
"""
_GEOMETRY_FRAGMENT = """
uniform sampler2D picture;
in vec2 at; in vec3 tint; flat in int which; in float depth;
void main() {
    color_out = vec4(texture(picture, at, -0.75).rgb * tint, 1.0);
#ifdef MEASURED
    id_out = which; surface_out = vec2(depth, 0.0);
#endif
}
"""
_LAYER_VERTEX = """
in vec3 position;
out vec3 world;  // relative to the capture's eye
out float depth;
uniform vec3 captured_from;
void main() {
    vec3 p = eye_from_world * (position - eye);
    world = position - captured_from; depth = -p.z;
    gl_Position = project(p);
}
"""
_LAYER_FRAGMENT = """
uniform sampler2D picture;
uniform mat3 capture_from_world;
uniform vec4 window;   // focal, -left, -top of the capture's window in pixels, and nothing
uniform vec2 size;     // of the window
in vec3 world; in float depth;
#ifdef MEASURED
uniform sampler2D depths;
uniform isampler2D ids;
uniform vec3 viewer;   // relative to the capture's eye
#endif
void main() {
    vec3 p = capture_from_world * world;
    vec2 texel = vec2(window.x * p.x, -window.x * p.y) / -p.z + window.yz;
    vec4 color = texture(picture, texel / size);
    if (color.a < 0.5) discard;
    color_out = vec4(color.rgb, 1.0);
#ifdef MEASURED
    ivec2 nearest = clamp(ivec2(floor(texel)), ivec2(0), ivec2(size) - 1);
    int id = texelFetch(ids, nearest, 0).r;
    if (id < 0) {  // the filter reaches half a texel beyond the silhouette: take the covered neighbour
        ivec2 other = nearest;
        for (int k = 0; k < 8 && id < 0; ++k) {
            ivec2 step = ivec2(k % 3, k / 3) - 1;
            if (k >= 4) { int m = k + 1; step = ivec2(m % 3, m / 3) - 1; }
            other = clamp(nearest + step, ivec2(0), ivec2(size) - 1);
            id = texelFetch(ids, other, 0).r;
        }
        nearest = other;
    }
    id_out = id;
    float truth = texelFetch(depths, nearest, 0).r;
    vec3 captured = world * (truth / max(-p.z, 1e-6));
    vec3 a = normalize(world - viewer), b = normalize(captured - viewer);
    surface_out = vec2(depth, id < 0 || isinf(truth) ? 0.0 : atan(length(cross(a, b)), dot(a, b)));
#endif
}
"""
_SKY_VERTEX = """
out vec2 at;
void main() {
    at = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0;
    gl_Position = vec4(at, 0.9999999, 1.0);
}
"""
_SKY_FRAGMENT = """
uniform vec3 horizon; uniform vec3 zenith;
in vec2 at;
void main() {
    vec3 ray = vec3((at.x + projection.z) / projection.x, (at.y + projection.w) / projection.y, -1.0);
    float up = pow(clamp(normalize(ray * eye_from_world).z, 0.0, 1.0), 0.6);
    color_out = vec4(mix(horizon, zenith, up), 1.0);
#ifdef MEASURED
    id_out = -1; surface_out = vec2(1e30, 0.0);
#endif
}
"""


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """A drawn frame, top row first.

    ``color`` (h, w, 3) uint8 sRGB. Where measured: ``object_ids`` (h, w) int32, -2 the ground, -1 the sky; ``depth``
    (h, w) float32 metres along the axis, ``inf`` for the sky; ``displacement`` (h, w) float32 radians between where an
    impostor's surface is drawn and where its texel was captured, as the viewer sees them. ``seconds`` from first call to
    finished picture; ``triangles`` and ``draws`` sent.
    """

    color: NDArray[np.uint8]
    object_ids: NDArray[np.int32] | None
    depth: NDArray[np.float32] | None
    displacement: NDArray[np.float32] | None
    seconds: float
    triangles: int
    draws: int


@dataclass(frozen=True, slots=True, eq=False)
class _LayerBuffers:
    """A layer on the GPU; depths and ids are there only for measuring."""

    view: View
    triangles: int
    arrays: Mapping[bool, Any]
    picture: Any
    measures: tuple[Any, Any] | None
    owned: tuple[Any, ...]

    def release(self) -> None:
        for thing in self.owned:
            thing.release()


class Renderer:
    """One city in one OpenGL context, drawing frames of a size. Use as a context manager.

    ``measured`` keeps what measuring needs (object ids and depths of layers). ``samples``: multisampling of unmeasured
    frames. Raises CaptureError where no OpenGL context can be had.
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
        with self._context:  # another library's context may be current, here and whenever we are called again
            self._prepare(mesh, ground, size, measured, samples)

    def _prepare(self, mesh: CityMesh, ground: CityMesh, size: tuple[int, int], measured: bool, samples: int) -> None:
        self.size, self.measured = size, measured
        self._mesh, self._ground = mesh, ground
        self._programs = {
            (kind, flag): self._program(vertex, fragment, flag)
            for kind, vertex, fragment in (
                ("geometry", _GEOMETRY_VERTEX, _GEOMETRY_FRAGMENT),
                ("layer", _LAYER_VERTEX, _LAYER_FRAGMENT),
                ("sky", _SKY_VERTEX, _SKY_FRAGMENT),
            )
            for flag in ((False, True) if measured else (False,))
        }
        self._city = self._upload_mesh(
            mesh, np.repeat(np.arange(len(mesh.triangle_counts)), np.diff(mesh.object_vertices))
        )
        self._floor = self._upload_mesh(ground, np.full(len(ground.positions), -2))
        self._sets: dict[str, tuple[int, dict[bool, Any]]] = {}
        self._layers: dict[tuple[str, str], dict[str, _LayerBuffers]] = {}
        self._sky = {
            flag: self._context.vertex_array(self._programs["sky", flag], [])
            for kind, flag in self._programs
            if kind == "sky"
        }
        self._targets = {flag: self._framebuffer(flag, samples) for flag in ((False, True) if measured else (False,))}
        self._plain = self._context.simple_framebuffer(size, components=4) if samples else None

    def __enter__(self) -> Renderer:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def device(self) -> str:
        """Name of what draws (``llvmpipe ...`` is software)."""
        return str(self._context.info["GL_RENDERER"])

    def close(self) -> None:
        """Free everything. The renderer cannot be used afterwards."""
        self._context.release()

    # --------------------------------------------------------------------------------------------------- uploads

    def upload(self, dataset: str, impostor: Impostor) -> None:
        """Bring a cell's layers to the GPU; draws refer to them by ``dataset`` and the cell's id."""
        key = (dataset, impostor.cell.id)
        if key not in self._layers:
            with self._context:
                self._layers[key] = {one.name: self._upload_layer(one) for one in impostor.layers}

    def evict(self, dataset: str, cell: str) -> None:
        """Free a cell's layers; nothing where they are not there."""
        with self._context:
            for layer in self._layers.pop((dataset, cell), {}).values():
                layer.release()

    def holds(self, dataset: str, cell: str) -> bool:
        """Whether a cell's layers are on the GPU."""
        return (dataset, cell) in self._layers

    # --------------------------------------------------------------------------------------------------- drawing

    def draw(self, plan: Plan, view: View, *, measured: bool = False, read: bool = True) -> Frame:
        """Draw ``plan`` as ``view`` sees it. Without ``read``, ``color`` is empty: for timing frames.

        Raises KeyError where a layer is drawn that was not uploaded.
        """
        if measured and not self.measured:
            raise ValueError("a renderer made with measured=True expected")
        with self._context:
            return self._draw(plan, view, measured, read)

    def _draw(self, plan: Plan, view: View, measured: bool, read: bool) -> Frame:
        start = time.perf_counter()
        triangles, draws = self._paint(plan.draws, view, measured)
        color = self._color(measured) if read or plan.mix < 1.0 else None
        if plan.mix < 1.0 and color is not None:
            more, again = self._paint(plan.fading, view, measured)
            mixed = plan.mix * color.astype(np.float32) + (1.0 - plan.mix) * self._color(measured)
            color, triangles, draws = np.rint(mixed).astype(np.uint8), triangles + more, draws + again
        self._context.finish()
        seconds = time.perf_counter() - start
        if color is None:
            color = np.empty((0, 0, 3), dtype=np.uint8)
        if not measured:
            return Frame(color, None, None, None, seconds, triangles, draws)
        target = self._targets[True]
        ids = self._read(target, 1, 1, "i4").reshape(self.size[::-1])
        surface = self._read(target, 2, 2, "f4").reshape(*self.size[::-1], 2)
        depth = np.where(surface[..., 0] > 1e29, np.inf, surface[..., 0]).astype(np.float32)
        return Frame(color, ids, depth, np.ascontiguousarray(surface[..., 1]), seconds, triangles, draws)

    def _paint(self, draws: Sequence[Draw], view: View, measured: bool) -> tuple[int, int]:
        """Draw into the target; triangles and draws sent."""
        context, target = self._context, self._targets[measured]
        target.use()
        target.clear(0.0, 0.0, 0.0, 1.0)
        context.enable(moderngl.DEPTH_TEST)
        context.disable(moderngl.BLEND | moderngl.CULL_FACE)
        left, top, width, height = view.window
        projection = (
            2.0 * view.focal / width,
            2.0 * view.focal / height,
            -(2.0 * left / width + 1.0),
            2.0 * top / height + 1.0,
        )
        rotation = np.ascontiguousarray(view.eye_from_world[:3, :3].T, dtype="f4").tobytes()
        for (_, flag), program in self._programs.items():
            if flag == measured:
                _set(program, "eye_from_world", rotation)
                _set(program, "eye", view.eye.astype("f4").tobytes())
                _set(program, "projection", np.array(projection, dtype="f4").tobytes())
                _set(program, "clip", np.array([_NEAR, _FAR], dtype="f4").tobytes())
        triangles = calls = 0
        for draw in draws:
            if isinstance(draw, Sky):
                program = self._programs["sky", measured]
                _set(program, "horizon", (np.array(SKY_HORIZON) / 255.0).astype("f4").tobytes())
                _set(program, "zenith", (np.array(SKY_ZENITH) / 255.0).astype("f4").tobytes())
                self._sky[measured].render(moderngl.TRIANGLES, vertices=3)
                triangles, calls = triangles + 1, calls + 1
            elif isinstance(draw, Ground):
                self._floor[1].use(0)
                self._floor[2][measured].render()
                triangles, calls = triangles + len(self._ground.triangles), calls + 1
            elif isinstance(draw, Objects):
                count, arrays = self._object_set(draw)
                if count:
                    self._city[1].use(0)
                    arrays[measured].render()
                    triangles, calls = triangles + count, calls + 1
            elif isinstance(draw, CellLayers):
                buffers = self._layers[draw.dataset, draw.cell]
                for name in draw.names:
                    self._draw_layer(buffers[name], view, measured)
                    triangles, calls = triangles + buffers[name].triangles, calls + 1
        return triangles, calls

    def _draw_layer(self, layer: _LayerBuffers, view: View, measured: bool) -> None:
        program = self._programs["layer", measured]
        left, top, width, height = layer.view.window
        rotation = np.ascontiguousarray(layer.view.eye_from_world[:3, :3].T, dtype="f4")
        _set(program, "capture_from_world", rotation.tobytes())
        _set(program, "captured_from", layer.view.eye.astype("f4").tobytes())
        _set(program, "window", np.array([layer.view.focal, -left, -top, 0.0], dtype="f4").tobytes())
        _set(program, "size", np.array([width, height], dtype="f4").tobytes())
        layer.picture.use(0)
        if measured and layer.measures is not None:
            layer.measures[0].use(1)
            layer.measures[1].use(2)
            program["depths"].value, program["ids"].value = 1, 2
            _set(program, "viewer", (view.eye - layer.view.eye).astype("f4").tobytes())
        layer.arrays[measured].render()

    def _color(self, measured: bool) -> NDArray[np.uint8]:
        target = self._targets[measured]
        if self._plain is not None and not measured:
            self._context.copy_framebuffer(self._plain, target)
            target = self._plain
        return np.ascontiguousarray(self._read(target, 0, 4, "u1").reshape(*self.size[::-1], 4)[..., :3])

    def _read(self, target: Any, attachment: int, components: int, dtype: str) -> NDArray[Any]:  # noqa: ANN401
        data = target.read(components=components, attachment=attachment, dtype="f1" if dtype == "u1" else dtype)
        return np.frombuffer(data, dtype=dtype).reshape(self.size[1], -1)[::-1]

    # --------------------------------------------------------------------------------------------------- buffers

    def _program(self, vertex: str, fragment: str, measured: bool) -> Any:  # noqa: ANN401
        head = _COMMON.replace("#version 330", "#version 330\n" + ("#define MEASURED\n" if measured else ""), 1)
        return self._context.program(vertex_shader=head + vertex, fragment_shader=head + _OUTPUTS + fragment)

    def _framebuffer(self, measured: bool, samples: int) -> Any:  # noqa: ANN401
        context, size = self._context, self.size
        if not measured:
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

    def _texture(self, pixels: NDArray[np.uint8], *, repeat: bool) -> Any:  # noqa: ANN401
        texture = self._context.texture(
            pixels.shape[1::-1], pixels.shape[2], np.ascontiguousarray(pixels).tobytes(), alignment=1
        )
        texture.build_mipmaps()
        texture.filter = (moderngl.LINEAR_MIPMAP_LINEAR, moderngl.LINEAR)
        texture.repeat_x = texture.repeat_y = repeat
        return texture

    def _upload_mesh(self, mesh: CityMesh, objects: NDArray[np.int64]) -> tuple[Any, Any, dict[bool, Any]]:
        """Vertex buffer, texture, and vertex arrays of the whole mesh."""
        layout = np.dtype([("position", "<f4", 3), ("uv", "<f4", 2), ("color", "u1", 4), ("object", "<i4")])
        vertices = np.zeros(len(mesh.positions), dtype=layout)
        vertices["position"], vertices["uv"] = mesh.positions, mesh.uv
        vertices["color"][:, :3], vertices["object"] = mesh.colors, objects
        buffer = self._context.buffer(vertices.tobytes())
        return buffer, self._texture(mesh.texture, repeat=True), self._arrays(buffer, mesh.triangles)

    def _arrays(self, buffer: Any, triangles: NDArray[np.int32]) -> dict[bool, Any]:  # noqa: ANN401
        indices = self._context.buffer(np.ascontiguousarray(triangles, dtype="<i4").tobytes())
        arrays = {}
        for (kind, measured), program in self._programs.items():
            if kind == "geometry":
                layout = ["3f 2f 3f1 x1 1i" if measured else "3f 2f 3f1 x1 x4", "position", "uv", "color"]
                if measured:
                    layout.append("object")
                arrays[measured] = self._context.vertex_array(program, [(buffer, *layout)], indices)
        return arrays

    def _object_set(self, draw: Objects) -> tuple[int, dict[bool, Any]]:
        """Triangles and vertex arrays of a set of objects, made when first drawn."""
        if draw.key not in self._sets:
            first, last = self._mesh.object_triangles[draw.objects], self._mesh.object_triangles[draw.objects + 1]
            rows = np.repeat(first - (np.cumsum(last - first) - (last - first)), last - first) + np.arange(
                (last - first).sum()
            )
            triangles = self._mesh.triangles[rows]
            arrays = self._arrays(self._city[0], triangles) if len(triangles) else {}
            self._sets[draw.key] = (len(triangles), arrays)
        return self._sets[draw.key]

    def _upload_layer(self, layer: Layer) -> _LayerBuffers:
        context, mesh, texture = self._context, layer.mesh, layer.texture
        positions = context.buffer(np.ascontiguousarray(mesh.vertices, dtype="<f4").tobytes())
        indices = context.buffer(np.ascontiguousarray(mesh.triangles, dtype="<i4").tobytes())
        alpha = np.where(texture.coverage, 255, 0).astype(np.uint8)
        picture = self._texture(np.dstack([texture.color, alpha]), repeat=False)
        arrays = {
            measured: context.vertex_array(program, [(positions, "3f", "position")], indices)
            for (kind, measured), program in self._programs.items()
            if kind == "layer"
        }
        measures = None
        if self.measured:
            size = texture.depth.shape[::-1]
            depths = context.texture(size, 1, np.ascontiguousarray(texture.depth).tobytes(), dtype="f4", alignment=1)
            ids = context.texture(size, 1, np.ascontiguousarray(texture.object_ids).tobytes(), dtype="i4", alignment=1)
            for one in (depths, ids):
                one.filter = (moderngl.NEAREST, moderngl.NEAREST)
            measures = (depths, ids)
        owned = (*arrays.values(), positions, indices, picture, *(measures or ()))
        return _LayerBuffers(texture.view, len(mesh.triangles), arrays, picture, measures, owned)


def _set(program: Any, name: str, value: bytes) -> None:  # noqa: ANN401
    """Set a uniform, unless the compiler has found that the program does not need it."""
    if name in program:
        program[name].write(value)
