"""A cell's layers in memory, ready for the GPU: pictures, meshes, and the depths that keep layers in order.

A mesh lies off the captured surfaces where its quads span two of them: there it could win or lose against another layer, or
the ground, that it should not. So triangles are divided in two: those *in order* are drawn as they are, since between them and
what was captured there is nothing; the others are drawn with the captured depth of each texel, the "limited depth
information" that the paper stores with its textures (section 5.5). Which ones the dataset says (``mmi.meshing.ordering``). The
z-buffer then composes the captured surfaces themselves, and not their approximations.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mmi.capture.layer_values import LayerPicture
from mmi.dataset.cell_files import read_depths, read_pictures
from viewer.cells.layer_atlas import BORDER, bordered, shelves
from viewer.plan import CellKey
from viewer.scene.scene import WalkScene

__all__ = ["LoadedCell", "LoadedLayer", "cell_bytes", "load_cell"]


@dataclass(frozen=True, slots=True, eq=False)
class LoadedLayer:
    """A layer as it goes to the GPU: into the cell's atlas at ``corner`` (x, y), with the atlas' border around it.

    ``pixels`` (h, w, 4) uint8 sRGB, alpha is coverage; ``depth`` (h, w) float32 eye-space metres in the capture, also one
    texel beyond the silhouette (filtering reaches that far), ``inf`` farther out; ``object_ids`` (h, w) int32 or None.
    ``vertices`` (n, 6) float32: world metres, and texture coordinates in the atlas times depth in the capture, and that
    depth: linear in space, and so projective texturing. ``triangles`` (m, 3) int32, the first ``in_order`` of which are
    drawn as they are.
    """

    name: str
    corner: tuple[int, int]
    pixels: NDArray[np.uint8]
    depth: NDArray[np.float32]
    object_ids: NDArray[np.int32] | None
    vertices: NDArray[np.float32]
    triangles: NDArray[np.int32]
    in_order: int


@dataclass(frozen=True, slots=True, eq=False)
class LoadedCell:
    """All layers of a cell, captured from ``eye`` (3,), for an atlas of ``size`` (width, height)."""

    key: CellKey
    eye: NDArray[np.float64]
    size: tuple[int, int]
    layers: tuple[LoadedLayer, ...]

    @property
    def bytes(self) -> int:
        """What it takes in memory, here and on the GPU alike."""
        return cell_bytes(
            self.size,
            vertices=sum(len(layer.vertices) for layer in self.layers),
            triangles=sum(len(layer.triangles) for layer in self.layers),
            measured=any(layer.object_ids is not None for layer in self.layers),
        )


def cell_bytes(size: tuple[int, int], *, vertices: int, triangles: int, measured: bool) -> int:
    """Bytes that a cell with an atlas of ``size`` and meshes of so many vertices and triangles takes: texels of colour with
    coverage, depth and, where measured, object id (4 each); vertices of six numbers, triangles of three indices.
    """
    return size[0] * size[1] * (12 if measured else 8) + 24 * vertices + 12 * triangles


def load_cell(
    scene: WalkScene, cell: str, *, measured: bool = False, rest: Callable[[], None] | None = None
) -> LoadedCell:
    """Read a cell's files; with ``measured`` object ids too, as indices into the city's objects.

    Spends its time where other threads can run, and calls ``rest`` now and then, so that it can leave them the processor.
    Raises DatasetError where a file is missing or damaged.
    """
    rest = rest or _never
    entry = scene.dataset.cell(cell)
    pictures = read_pictures(scene.dataset, cell)
    rest()
    depths = read_depths(scene.dataset, cell)
    rest()
    listed = [scene.objects[one] for one in (*entry.far, *entry.near)]
    objects = np.array([-1, *listed], dtype=np.int32) if measured else None
    sizes = [(one.view.window[2] + 2 * BORDER, one.view.window[3] + 2 * BORDER) for one in pictures]
    corners, size = shelves(sizes)
    layers = []
    for picture, corner in zip(pictures, corners, strict=True):
        depth, places = depths[picture.name]
        layers.append(
            LoadedLayer(
                name=picture.name,
                corner=corner,
                pixels=bordered(picture.pixels),
                depth=bordered(_one_texel_beyond(depth)),
                object_ids=None if objects is None else bordered(objects[places]),
                vertices=_vertices(picture, corner, size),
                triangles=picture.mesh.triangles,
                in_order=picture.in_order,
            )
        )
        rest()
    return LoadedCell(CellKey(scene.name, cell), np.array(entry.reference), size, tuple(layers))


def _never() -> None:
    """No rest."""


def _vertices(picture: LayerPicture, corner: tuple[int, int], size: tuple[int, int]) -> NDArray[np.float32]:
    """(n, 6) positions, and projective texture coordinates in an atlas of ``size``."""
    mesh, (_, _, width, height) = picture.mesh, picture.view.window
    depth = picture.view.project(mesh.vertices.astype(np.float64))[:, 2:]
    texels = mesh.uv * np.array([width, height]) + np.array(corner) + BORDER
    return np.hstack([mesh.vertices, texels / size * depth, depth]).astype(np.float32)


@njit(cache=True, nogil=True)
def _one_texel_beyond(depth: NDArray[np.float32]) -> NDArray[np.float32]:
    """``depth`` (h, w) with each ``inf`` next to a captured texel replaced by the nearest of those around it."""
    height, width = depth.shape
    result, column = depth.copy(), np.empty(width, dtype=np.float32)
    for i in range(height):
        column[:] = depth[i]
        for y in (i - 1, i + 1):
            if 0 <= y < height:
                for j in range(width):
                    column[j] = min(column[j], depth[y, j])
        for j in range(width):
            if np.isinf(depth[i, j]):
                result[i, j] = min(column[max(j - 1, 0)], column[j], column[min(j + 1, width - 1)])
    return result
