"""Objects of a layer -> depth textures, by pyrender: the only module that touches OpenGL (paper section 5.1, DESIGN section 4).

One sample a texel, taken at its centre; no multisampling, which would blend silhouettes with the background and mismatch
depth. Colour, object id and depth come from a single pass: shading is baked into vertex colours, so the flat shader's
alpha is free to carry the object's number within the layer.
"""

from __future__ import annotations

import os

os.environ.setdefault("PYOPENGL_PLATFORM", "egl")
os.environ.setdefault("PYGLET_HEADLESS", "1")  # pyrender imports pyglet, which would look for X libraries

import math
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager
from types import TracebackType
from typing import Any

import numpy as np
import pyrender
from numpy.typing import NDArray
from OpenGL import GL
from OpenGL.error import Error as OpenGLError
from pyrender.platforms import egl
from pyrender.renderer import Renderer

from mmi.appearance.city_mesh import CityMesh, mesh_of
from mmi.appearance.cut_outs import clear_blocks
from mmi.capture.cut_out_materials import CutOutPrograms, SharperTexture, cut_out_coordinates
from mmi.capture.layer_values import DepthTexture
from mmi.foundation.camera import View
from mmi.foundation.errors import CaptureError
from mmi.foundation.kernels import kernel

__all__ = ["Capturer"]

_OBJECTS_A_PASS = 255  # alpha has eight bits, and 0 is the background
_FLAGS = (
    pyrender.RenderFlags.OFFSCREEN
    | pyrender.RenderFlags.FLAT
    | pyrender.RenderFlags.RGBA
    | pyrender.RenderFlags.SKIP_CULL_FACES
)


class Capturer:
    """Renders subsets of one city's objects; holds an OpenGL context until closed. Use as a context manager.

    Raises CaptureError where no OpenGL context can be had.
    """

    def __init__(self, mesh: CityMesh) -> None:
        self._mesh = mesh
        self._platform = _open_platform()
        self._renderer = _SingleSampleRenderer(64, 64)
        self._camera = _WindowCamera()
        self._scene = pyrender.Scene(bg_color=[0.0, 0.0, 0.0, 0.0])
        self._camera_node = self._scene.add(self._camera)
        sampler = pyrender.Sampler(wrapS=GL.GL_REPEAT, wrapT=GL.GL_CLAMP_TO_EDGE)
        self._clear = clear_blocks(mesh.texture)
        channels = "RGBA" if mesh.has_cut_outs else "RGB"
        texture = SharperTexture(source=mesh.texture, source_channels=channels, sampler=sampler)
        self._material = pyrender.MetallicRoughnessMaterial(baseColorTexture=texture, doubleSided=True)
        # A speck behind the camera keeps the texture loaded between captures.
        keeper = pyrender.Primitive(
            positions=np.zeros((3, 3)), texcoord_0=np.zeros((3, 2)), indices=[[0, 1, 2]], material=self._material
        )
        self._scene.add(pyrender.Mesh([keeper]))

    def __enter__(self) -> Capturer:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Free the OpenGL objects and the context.

        The EGL display stays initialised: other contexts of this process may live on it (pyrender would end them).
        """
        if self._platform is None:
            return
        self._platform.make_current()
        self._renderer.delete()
        _destroy_context(self._platform)
        self._platform = None

    def depth_textures(
        self, objects: NDArray[np.int64], views: Sequence[View], *, supersample: int = 1
    ) -> list[DepthTexture]:
        """Each view of the objects with these indices, all seen from the same eye.

        ``supersample`` (odd) subsamples a side: depth and id stay those of the texel's centre, colour becomes the mean
        over the subsamples that hit the same object, so that antialiasing never mixes two surfaces' colours.

        Raises CaptureError when OpenGL fails.
        """
        return list(self.captures(objects, views, supersample=supersample))

    def captures(
        self, objects: NDArray[np.int64], views: Sequence[View], *, supersample: int = 1
    ) -> Generator[DepthTexture, None, None]:
        """The pictures of :meth:`depth_textures` one by one, each drawn when it is asked for: one is in memory at a time."""
        if supersample < 1 or supersample % 2 == 0:
            raise CaptureError(f"supersampling needs an odd number of subsamples a side, found {supersample}")
        objects = np.asarray(objects, dtype=np.int64)
        if not views or not objects.size:
            return
        eye = views[0].eye
        groups = [objects[start : start + _OBJECTS_A_PASS] for start in range(0, len(objects), _OBJECTS_A_PASS)]
        drawn = [self._numbered(group, eye) for group in groups]
        with self._in_scene([primitive for primitive, _ in drawn]) as meshes:
            for view in views:
                color, depth, ids = self._picture(meshes[0], drawn[0][1], groups[0], view, supersample)
                for mesh, (_, extent), group in zip(meshes[1:], drawn[1:], groups[1:], strict=True):
                    other = self._picture(mesh, extent, group, view, supersample)
                    color, depth, ids = _nearer((color, depth, ids), other)
                if supersample > 1:
                    color, depth, ids = _average_within_objects(color, depth, ids, supersample)
                yield DepthTexture(view, color, depth, ids)

    def identify(self, objects: NDArray[np.int64], view: View) -> NDArray[np.int32]:
        """(h, w) int32: the item buffer of ``objects``; their indices into the city's objects, -1 for none."""
        objects = np.asarray(objects, dtype=np.int64)
        if not objects.size:
            return np.full((view.window[3], view.window[2]), -1, dtype=np.int32)
        part = mesh_of(self._mesh, objects)
        numbers = np.repeat(np.arange(1, len(objects) + 1), np.diff(part.object_vertices))
        colors = np.ones((len(numbers), 4), dtype=np.float32)
        colors[:, :3] = (numbers[:, None] >> np.array([0, 8, 16]) & 255) / np.float32(255.0)
        positions = part.positions - view.eye
        if part.has_cut_outs:
            looks = self._looks(part, plain=True)
        else:
            plain = pyrender.MetallicRoughnessMaterial(baseColorFactor=[1.0, 1.0, 1.0, 1.0], doubleSided=True)
            looks = {"material": plain}
        primitive = pyrender.Primitive(positions=positions, color_0=colors, indices=part.triangles, **looks)
        with self._in_scene([primitive]) as [mesh]:
            rgba, _ = self._render(mesh, _extent(positions[part.triangles]), view, 1)
        number = rgba[..., :3].astype(np.int32) @ np.array([1, 1 << 8, 1 << 16], dtype=np.int32)
        return np.concatenate([[-1], objects]).astype(np.int32)[np.where(rgba[..., 3] > 0, number, 0)]

    def _numbered(self, objects: NDArray[np.int64], eye: NDArray[np.float64]) -> tuple[pyrender.Primitive, _Extent]:
        """At most 255 objects to draw, alpha telling which, and between which distances from ``eye`` they lie."""
        part = mesh_of(self._mesh, objects)
        positions = part.positions - eye  # float64, so that float32 begins at the eye
        numbers = np.repeat(np.arange(1, len(objects) + 1), np.diff(part.object_vertices))
        colors = np.empty((len(positions), 4), dtype=np.float32)
        colors[:, :3] = part.colors / np.float32(255.0)
        colors[:, 3] = numbers / np.float32(255.0)
        primitive = pyrender.Primitive(
            positions=positions, color_0=colors, indices=part.triangles, **self._looks(part, plain=False)
        )
        return primitive, _extent(positions[part.triangles])

    def _looks(self, part: CityMesh, *, plain: bool) -> dict[str, Any]:
        """Material and texture coordinates of a primitive; ``plain``: the texture says what is clear, and nothing else."""
        found = {"material": self._material, "texcoord_0": np.stack([part.uv[:, 0], 1.0 - part.uv[:, 1]], axis=1)}
        if part.has_cut_outs:
            found["texcoord_1"] = cut_out_coordinates(part, self._clear, plain=plain)
        return found

    @contextmanager
    def _in_scene(self, primitives: Sequence[pyrender.Primitive]) -> Iterator[list[pyrender.Mesh]]:
        """Put primitives into the scene, a mesh each, all invisible; take them out again."""
        meshes = [pyrender.Mesh([primitive], is_visible=False) for primitive in primitives]
        nodes = [self._scene.add(mesh) for mesh in meshes]
        try:
            yield meshes
        finally:
            for node in nodes:
                self._scene.remove_node(node)

    def _picture(
        self,
        mesh: pyrender.Mesh,
        extent: _Extent,
        objects: NDArray[np.int64],
        view: View,
        supersample: int,
    ) -> _Picture:
        """Colour (h, w, 3), depth (h, w) and id (h, w) of numbered objects."""
        rgba, depth = self._render(mesh, extent, view, supersample)
        ids = np.full(256, -1, dtype=np.int32)
        ids[1 : len(objects) + 1] = objects
        return np.ascontiguousarray(rgba[..., :3]), depth, ids[rgba[..., 3]]

    def _render(
        self, mesh: pyrender.Mesh, extent: _Extent, view: View, supersample: int
    ) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        """RGBA and depth of one mesh of the scene, which has the eye at its origin."""
        self._platform.make_current()  # another context may have been used since
        self._look_through(view, *extent)
        self._renderer.viewport_width = view.window[2] * supersample
        self._renderer.viewport_height = view.window[3] * supersample
        mesh.is_visible = True
        try:
            rgba, depth = self._renderer.render(self._scene, _FLAGS)
        except OpenGLError as error:
            raise CaptureError(
                f"OpenGL failed to capture {len(mesh.primitives[0].indices)} triangles: {error}"
            ) from error
        finally:
            mesh.is_visible = False
        return rgba, depth

    def _look_through(self, view: View, clearance: float, far: float) -> None:
        """Aim the camera: at the origin, turned as ``view``, clip planes close around what it can see."""
        rotation = view.eye_from_world[:3, :3]
        left, top, width, height = view.window
        # A point at this distance is nearest along the axis at the border of the window; a level view ignores heights.
        level = abs(rotation[2, 2]) < 1e-9
        border = math.hypot(max(abs(left), abs(left + width)), 0.0 if level else max(abs(top), abs(top + height)))
        near = max(0.99 * clearance / math.hypot(1.0, border / view.focal), 0.05)
        self._camera.aim(view, near=near, far=max(1.01 * far, 2.0 * near))
        pose = np.eye(4)
        pose[:3, :3] = rotation.T
        self._scene.set_pose(self._camera_node, pose)


_Picture = tuple[NDArray[np.uint8], NDArray[np.float32], NDArray[np.int32]]
_Extent = tuple[float, float]
"""Horizontal distance from the eye to the nearest point, and distance to the farthest one."""


class _WindowCamera(pyrender.Camera):
    """A pinhole that shows an off-centre window of its image plane."""

    def __init__(self) -> None:
        super().__init__(znear=1.0, zfar=2.0)
        self._view: View | None = None

    def aim(self, view: View, *, near: float, far: float) -> None:
        self._view = view
        self.znear, self.zfar = near, far

    def get_projection_matrix(self, width: int | None = None, height: int | None = None) -> NDArray[np.float64]:  # noqa: ARG002
        if self._view is None:
            return np.eye(4)
        left, top, columns, rows = self._view.window
        near, far = self.znear, self.zfar
        matrix = np.zeros((4, 4))
        matrix[0, 0] = 2.0 * self._view.focal / columns
        matrix[0, 2] = 2.0 * left / columns + 1.0
        matrix[1, 1] = 2.0 * self._view.focal / rows
        matrix[1, 2] = -(2.0 * top / rows + 1.0)
        matrix[2, 2] = (near + far) / (near - far)
        matrix[2, 3] = 2.0 * near * far / (near - far)
        matrix[3, 2] = -1.0
        return matrix


class _SingleSampleRenderer(Renderer):
    """pyrender's renderer with one sample a pixel and a framebuffer that grows instead of being made anew."""

    _main_fb: int | None
    _main_fb_ms: int | None
    _main_fb_dims: tuple[int, int] | tuple[None, None]

    def __init__(self, width: int, height: int) -> None:
        super().__init__(width, height)
        self._program_cache = CutOutPrograms()

    def _configure_main_framebuffer(self) -> None:
        wanted = (self.viewport_width, self.viewport_height)
        have = (self._main_fb_dims[0] or 0, self._main_fb_dims[1] or 0)
        if wanted[0] <= have[0] and wanted[1] <= have[1]:
            return
        self._delete_main_framebuffer()
        size = (max(wanted[0], have[0]), max(wanted[1], have[1]))
        limit = int(GL.glGetIntegerv(GL.GL_MAX_RENDERBUFFER_SIZE))
        if max(size) > limit:
            raise CaptureError(f"OpenGL here renders at most {limit} pixels a side, and a capture needs {max(size)}")
        self._main_cb, self._main_db = (int(name) for name in GL.glGenRenderbuffers(2))
        GL.glBindRenderbuffer(GL.GL_RENDERBUFFER, self._main_cb)
        GL.glRenderbufferStorage(GL.GL_RENDERBUFFER, GL.GL_RGBA8, *size)
        GL.glBindRenderbuffer(GL.GL_RENDERBUFFER, self._main_db)
        GL.glRenderbufferStorage(GL.GL_RENDERBUFFER, GL.GL_DEPTH_COMPONENT24, *size)
        self._main_fb = int(GL.glGenFramebuffers(1))
        self._main_fb_ms = self._main_fb
        GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, self._main_fb)
        GL.glFramebufferRenderbuffer(GL.GL_FRAMEBUFFER, GL.GL_COLOR_ATTACHMENT0, GL.GL_RENDERBUFFER, self._main_cb)
        GL.glFramebufferRenderbuffer(GL.GL_FRAMEBUFFER, GL.GL_DEPTH_ATTACHMENT, GL.GL_RENDERBUFFER, self._main_db)
        self._main_fb_dims = size

    def _delete_main_framebuffer(self) -> None:
        if self._main_fb is not None:
            GL.glDeleteFramebuffers(1, [self._main_fb])
            GL.glDeleteRenderbuffers(2, [self._main_cb, self._main_db])
        self._main_fb = self._main_fb_ms = None
        self._main_fb_dims = (None, None)

    def _read_main_framebuffer(self, scene: Any, flags: int) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:  # noqa: ANN401, ARG002
        """RGBA (h, w, 4) and eye-space depth (h, w), ``inf`` where alpha is 0; top row first."""
        width, height = self.viewport_width, self.viewport_height
        GL.glBindFramebuffer(GL.GL_READ_FRAMEBUFFER, self._main_fb)
        rgba = np.empty((height, width, 4), dtype=np.uint8)
        window_depth = np.empty((height, width), dtype=np.float32)
        GL.glReadPixels(0, 0, width, height, GL.GL_RGBA, GL.GL_UNSIGNED_BYTE, rgba)
        GL.glReadPixels(0, 0, width, height, GL.GL_DEPTH_COMPONENT, GL.GL_FLOAT, window_depth)
        camera = scene.main_camera_node.camera
        return rgba[::-1], _eye_depth(window_depth, rgba, camera.znear, camera.zfar)


@kernel()
def _eye_depth(
    window_depth: NDArray[np.float32], rgba: NDArray[np.uint8], near: float, far: float
) -> NDArray[np.float32]:
    """Depth along the axis from what the depth buffer holds, bottom row first -> top row first; ``inf`` for alpha 0."""
    height, width = window_depth.shape
    depth = np.empty((height, width), dtype=np.float32)
    for i in range(height):
        for j in range(width):
            seen = rgba[i, j, 3] > 0
            depth[height - 1 - i, j] = near * far / (far - window_depth[i, j] * (far - near)) if seen else np.inf
    return depth


def _open_platform() -> Any:  # noqa: ANN401
    """A current EGL context without a window, on the first device that gives one (EGL_DEVICE_ID chooses another)."""
    chosen = os.environ.get("EGL_DEVICE_ID")
    try:
        devices = egl.query_devices() or [egl.get_default_device()]
        if chosen is not None:
            devices = [devices[int(chosen)]]
    except (IndexError, ValueError, RuntimeError, OpenGLError) as error:
        raise CaptureError(f"EGL offers no such device (EGL_DEVICE_ID={chosen}): {error}") from error
    reasons = []
    for device in devices:
        platform = egl.EGLPlatform(64, 64, device=device)
        try:
            platform.init_context()
        except (AssertionError, OpenGLError, RuntimeError) as error:
            reasons.append(str(error).splitlines()[0] if str(error) else "no context")
        else:
            return platform
    raise CaptureError(
        f"no OpenGL 4.1 context through EGL on {len(devices)} device(s) ({'; '.join(reasons) or 'none found'}); "
        "on Debian or Ubuntu, 'apt-get install libegl1 libgl1-mesa-dri' brings software rendering"
    )


def _destroy_context(platform: Any) -> None:  # noqa: ANN401
    """End one context, and not (as pyrender would) the display that others share."""
    egl.egl.eglMakeCurrent(
        platform._egl_display, egl.egl.EGL_NO_SURFACE, egl.egl.EGL_NO_SURFACE, egl.egl.EGL_NO_CONTEXT
    )
    egl.egl.eglDestroyContext(platform._egl_display, platform._egl_context)


def _extent(triangles: NDArray[np.float64]) -> _Extent:
    """Of triangles (m, 3, 3) relative to the eye."""
    return _clearance(triangles[..., :2]), float(np.sqrt((triangles**2).sum(axis=-1).max()))


def _clearance(triangles: NDArray[np.float64]) -> float:
    """Horizontal distance from the origin to the nearest of the triangles (m, 3, 2); 0 where one lies above or below."""
    start = triangles
    along = np.roll(triangles, -1, axis=1) - start
    squared = np.maximum(np.einsum("mkc,mkc->mk", along, along), 1e-300)
    t = np.clip(-np.einsum("mkc,mkc->mk", start, along) / squared, 0.0, 1.0)
    nearest = start + t[..., None] * along
    turn = start[..., 0] * along[..., 1] - start[..., 1] * along[..., 0]
    if ((turn > 0.0).all(axis=1) | (turn < 0.0).all(axis=1)).any():
        return 0.0
    return float(np.sqrt(np.einsum("mkc,mkc->mk", nearest, nearest).min()))


def _nearer(a: _Picture, b: _Picture) -> _Picture:
    """The nearer of two passes, pixel by pixel."""
    take = b[1] < a[1]
    return np.where(take[..., None], b[0], a[0]), np.where(take, b[1], a[1]), np.where(take, b[2], a[2])


def _average_within_objects(
    color: NDArray[np.uint8], depth: NDArray[np.float32], ids: NDArray[np.int32], side: int
) -> tuple[NDArray[np.uint8], NDArray[np.float32], NDArray[np.int32]]:
    """Texels from ``side`` x ``side`` subsamples: depth and id of the central one, mean colour of those of its object."""
    height, width = ids.shape[0] // side, ids.shape[1] // side
    blocks = ids.reshape(height, side, width, side)
    centre = blocks[:, side // 2, :, side // 2]
    same = blocks == centre[:, None, :, None]
    total = np.einsum("hawbc,hawb->hwc", color.reshape(height, side, width, side, 3).astype(np.float32), same)
    mean = np.rint(total / same.sum(axis=(1, 3))[..., None]).astype(np.uint8)
    middle = depth.reshape(height, side, width, side)[:, side // 2, :, side // 2]
    return mean, np.ascontiguousarray(middle), np.ascontiguousarray(centre)
