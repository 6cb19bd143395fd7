"""A cell's layers in memory, ready for the GPU: pictures, meshes, and the depths that keep layers in order.

A mesh lies off the captured surfaces where its quads span two of them: there it would win or lose against another layer
that it should not. So triangles are divided in two: *even* ones lie on what was captured, and are drawn as they are; the
others are drawn with the captured depth of each texel, "limited depth information" that the paper stores with its
textures (section 5.5). The z-buffer then composes the captured surfaces themselves, and not their approximations.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mmi.camera import View
from mmi.cellfiles import read_depths, read_pictures
from mmi.impostor import GridMesh, LayerPicture
from viewer.scene import Scene
from viewer.technique import CellKey

__all__ = ["LoadedCell", "LoadedLayer", "divide_triangles", "load_cell", "loaded_layer"]

_EVEN = 1e-3
"""Relative difference of depths up to which a triangle lies on what was captured."""


@dataclass(frozen=True, slots=True, eq=False)
class LoadedLayer:
    """A layer as it goes to the GPU.

    ``pixels`` (h, w, 4) uint8 sRGB, alpha is coverage; ``depth`` (h, w) float32 eye-space metres, also one texel beyond the
    silhouette (filtering reaches that far), ``inf`` farther out; ``object_ids`` (h, w) int32 or None. ``vertices`` (n, 3)
    float32 world metres, ``triangles`` (m, 3) int32, the first ``even`` of which lie on the captured surface.
    """

    name: str
    view: View
    pixels: NDArray[np.uint8]
    depth: NDArray[np.float32]
    object_ids: NDArray[np.int32] | None
    vertices: NDArray[np.float32]
    triangles: NDArray[np.int32]
    even: int

    @property
    def bytes(self) -> int:
        """What it takes in memory, here and on the GPU alike (with mipmaps)."""
        ids = 0 if self.object_ids is None else self.object_ids.nbytes
        return self.pixels.nbytes * 4 // 3 + self.depth.nbytes + ids + self.vertices.nbytes + self.triangles.nbytes


@dataclass(frozen=True, slots=True, eq=False)
class LoadedCell:
    """All layers of a cell."""

    key: CellKey
    layers: tuple[LoadedLayer, ...]

    @property
    def bytes(self) -> int:
        """What it takes in memory."""
        return sum(layer.bytes for layer in self.layers)


def load_cell(scene: Scene, cell: str, *, measured: bool = False) -> LoadedCell:
    """Read a cell's files; with ``measured`` object ids too, as indices into the city's objects.

    Spends its time where other threads can run. Raises DatasetError where a file is missing or damaged.
    """
    pictures, depths = read_pictures(scene.dataset, cell), read_depths(scene.dataset, cell)
    far = scene.dataset.cell(cell)["far"]
    objects = np.array([-1, *(scene.objects[one] for one in far)], dtype=np.int32) if measured else None
    layers = []
    for picture in pictures:
        depth, places = depths[picture.name]
        layers.append(loaded_layer(picture, depth, None if objects is None else objects[places]))
    return LoadedCell(CellKey(scene.name, cell), tuple(layers))


def loaded_layer(
    picture: LayerPicture, depth: NDArray[np.float32], object_ids: NDArray[np.int32] | None
) -> LoadedLayer:
    """A layer from its picture, ``depth`` (h, w) as captured, and ``object_ids`` (h, w) for measuring."""
    triangles, even = divide_triangles(picture.mesh, picture.view, depth)
    return LoadedLayer(
        name=picture.name,
        view=picture.view,
        pixels=picture.pixels,
        depth=_one_texel_beyond(depth),
        object_ids=object_ids,
        vertices=picture.mesh.vertices,
        triangles=triangles,
        even=even,
    )


def divide_triangles(mesh: GridMesh, view: View, depth: NDArray[np.float32]) -> tuple[NDArray[np.int32], int]:
    """The mesh's triangles (m, 3) with even ones first, and how many those are.

    Even is a triangle below which every covered texel's depth is that of the triangle, up to ``_EVEN``. ``depth`` (h, w) is
    what ``view`` captured, ``inf`` where nothing is covered.
    """
    corners = mesh.uv.astype(np.float64) * [depth.shape[1], depth.shape[0]]
    nearness = 1.0 / view.project(mesh.vertices.astype(np.float64))[:, 2]  # linear in the picture along a triangle
    even = _even(corners, nearness, mesh.triangles, depth, _EVEN)
    order = np.argsort(~even, kind="stable")
    return np.ascontiguousarray(mesh.triangles[order]), int(even.sum())


@njit(cache=True, nogil=True)
def _even(
    corners: NDArray[np.float64],
    nearness: NDArray[np.float64],
    triangles: NDArray[np.int32],
    depth: NDArray[np.float32],
    tolerance: float,
) -> NDArray[np.bool_]:
    """(m,) whether each triangle lies on the captured surface; ``corners`` (n, 2) in texels, ``nearness`` (n,) 1/m."""
    height, width = depth.shape
    even = np.ones(len(triangles), dtype=np.bool_)
    for t in range(len(triangles)):
        a, b, c = triangles[t]
        ax, ay = corners[a]
        bx, by = corners[b, 0] - ax, corners[b, 1] - ay
        cx, cy = corners[c, 0] - ax, corners[c, 1] - ay
        area = bx * cy - by * cx
        if area == 0.0:
            continue
        left, right = min(0.0, bx, cx) + ax, max(0.0, bx, cx) + ax
        upper, lower = min(0.0, by, cy) + ay, max(0.0, by, cy) + ay
        for i in range(max(int(np.floor(upper)), 0), min(int(np.ceil(lower)), height)):
            y = i + 0.5 - ay
            for j in range(max(int(np.floor(left)), 0), min(int(np.ceil(right)), width)):
                if not np.isfinite(depth[i, j]):
                    continue
                x = j + 0.5 - ax
                s, t_ = (x * cy - y * cx) / area, (bx * y - by * x) / area
                if s < -1e-9 or t_ < -1e-9 or s + t_ > 1.0 + 1e-9:
                    continue
                here = nearness[a] + s * (nearness[b] - nearness[a]) + t_ * (nearness[c] - nearness[a])
                if abs(here * depth[i, j] - 1.0) > tolerance:
                    even[t] = False
                    break
            if not even[t]:
                break
    return even


@njit(cache=True, nogil=True)
def _one_texel_beyond(depth: NDArray[np.float32]) -> NDArray[np.float32]:
    """``depth`` (h, w) with each ``inf`` next to a captured texel replaced by the nearest of those around it."""
    height, width = depth.shape
    result = depth.copy()
    for i in range(height):
        for j in range(width):
            if np.isfinite(depth[i, j]):
                continue
            for y in range(max(i - 1, 0), min(i + 2, height)):
                for x in range(max(j - 1, 0), min(j + 2, width)):
                    result[i, j] = min(result[i, j], depth[y, x])
    return result
