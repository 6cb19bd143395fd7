"""A cell's layers in memory, ready for the GPU: pictures, meshes, and the depths that keep layers in order.

A dataset may hold no pictures (``build-impostors --pictures none``). Then a layer has an order to capture one instead, from the
viewpoint that its mesh was made for (paper section 5.2): it is executed when the layer is brought to the GPU, into an image
that has the place of the cell's atlas.

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
from numpy.typing import NDArray

from mmi.capture.layer_values import LayerMesh, LayerPicture
from mmi.dataset.cell_files import read_depths, read_meshes, read_pictures
from mmi.foundation.kernels import kernel
from viewer.cells.layer_atlas import BORDER, bordered, shelves
from viewer.plan import CellKey, ImageKey, Objects, Request, Slot
from viewer.scene.scene import WalkScene

__all__ = ["LoadedCell", "LoadedLayer", "StoredPicture", "cell_bytes", "cell_image", "load_cell"]

_IMAGES = "cells"
"""The owner of the images that pictures of cells are captured into."""


@dataclass(frozen=True, slots=True, eq=False)
class StoredPicture:
    """A layer's picture from the dataset, with the atlas' border around it.

    ``pixels`` (h, w, 4) uint8 sRGB, alpha is coverage; ``depth`` (h, w) float32 eye-space metres in the capture, also one
    texel beyond the silhouette (filtering reaches that far), ``inf`` farther out; ``object_ids`` (h, w) int32 or None.
    """

    pixels: NDArray[np.uint8]
    depth: NDArray[np.float32]
    object_ids: NDArray[np.int32] | None


@dataclass(frozen=True, slots=True, eq=False)
class LoadedLayer:
    """A layer as it goes to the GPU: into the cell's atlas at ``corner`` (x, y), with the atlas' border around it.

    ``picture`` is what the dataset holds, or the order to capture it into the cell's image. ``vertices`` (n, 6) float32: world
    metres, and texture coordinates in the atlas times depth in the capture, and that depth: linear in space, and so projective
    texturing. ``triangles`` (m, 3) int32, the first ``in_order`` of which are drawn as they are.
    """

    name: str
    corner: tuple[int, int]
    picture: StoredPicture | Request
    vertices: NDArray[np.float32]
    triangles: NDArray[np.int32]
    in_order: int


@dataclass(frozen=True, slots=True, eq=False)
class LoadedCell:
    """All layers of a cell, captured from ``eye`` (3,), for an atlas of ``size`` (width, height).

    ``image`` is the atlas of a cell whose pictures are captured when it is brought to the GPU, None of one that stores them.
    """

    key: CellKey
    eye: NDArray[np.float64]
    size: tuple[int, int]
    layers: tuple[LoadedLayer, ...]
    image: ImageKey | None = None

    @property
    def bytes(self) -> int:
        """What it takes in memory, here and on the GPU alike."""
        return cell_bytes(
            self.size,
            vertices=sum(len(layer.vertices) for layer in self.layers),
            triangles=sum(len(layer.triangles) for layer in self.layers),
            measured=any(_has_ids(layer.picture) for layer in self.layers),
            captured=self.image is not None,
        )


def cell_bytes(size: tuple[int, int], *, vertices: int, triangles: int, measured: bool, captured: bool = False) -> int:
    """Bytes that a cell with an atlas of ``size`` and meshes of so many vertices and triangles takes: texels of colour with
    coverage, depth and, where measured, object id (4 each); vertices of six numbers, triangles of three indices.

    An atlas that is ``captured`` has object ids in any case, and a depth buffer.
    """
    texel = 16 if captured else 12 if measured else 8
    return size[0] * size[1] * texel + 24 * vertices + 12 * triangles


def cell_image(cell: CellKey) -> ImageKey:
    """The image that pictures of a cell are captured into, where its dataset holds none."""
    return ImageKey(_IMAGES, f"{cell.dataset}/{cell.cell}")


def load_cell(
    scene: WalkScene, cell: str, *, measured: bool = False, rest: Callable[[], None] | None = None
) -> LoadedCell:
    """Read a cell's files; with ``measured`` object ids too, as indices into the city's objects.

    Where the dataset holds no pictures, layers have orders to capture them.

    Spends its time where other threads can run, and calls ``rest`` now and then, so that it can leave them the processor.
    Raises DatasetError where a file is missing or damaged.
    """
    rest = rest or _never
    if scene.parameters.pictures == "none":
        return _to_be_captured(scene, cell)
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
                picture=StoredPicture(
                    pixels=bordered(picture.pixels),
                    depth=bordered(_one_texel_beyond(depth)),
                    object_ids=None if objects is None else bordered(objects[places]),
                ),
                vertices=_vertices(picture, corner, size),
                triangles=picture.mesh.triangles,
                in_order=picture.in_order,
            )
        )
        rest()
    return LoadedCell(CellKey(scene.name, cell), np.array(entry.reference), size, tuple(layers))


def _to_be_captured(scene: WalkScene, cell: str) -> LoadedCell:
    """A cell's meshes, with orders to capture what they show: of each layer just the objects that its picture is of.

    A captured picture has its border from the scene itself, as what continues there.
    """
    entry, meshes = scene.dataset.cell(cell), read_meshes(scene.dataset, cell)
    key = CellKey(scene.name, cell)
    image = cell_image(key)
    sizes = [(one.view.window[2] + 2 * BORDER, one.view.window[3] + 2 * BORDER) for one in meshes]
    corners, size = shelves(sizes)
    far = np.array([scene.objects[one] for one in entry.far], dtype=np.int64)
    layers = []
    for one, corner, (_, described) in zip(meshes, corners, entry.pictures, strict=True):
        left, top, width, height = one.view.window
        view = one.view.cropped((left - BORDER, top - BORDER, width + 2 * BORDER, height + 2 * BORDER))
        shown = Objects("", far[list(described.objects)])
        layers.append(
            LoadedLayer(
                name=one.name,
                corner=corner,
                picture=Request(Slot(image, size, corner), view, (shown,)),
                vertices=_vertices(one, corner, size),
                triangles=one.mesh.triangles,
                in_order=one.in_order,
            )
        )
    return LoadedCell(key, np.array(entry.reference), size, tuple(layers), image)


def _has_ids(picture: StoredPicture | Request) -> bool:
    return isinstance(picture, StoredPicture) and picture.object_ids is not None


def _never() -> None:
    """No rest."""


def _vertices(picture: LayerPicture | LayerMesh, corner: tuple[int, int], size: tuple[int, int]) -> NDArray[np.float32]:
    """(n, 6) positions, and projective texture coordinates in an atlas of ``size``."""
    mesh, (_, _, width, height) = picture.mesh, picture.view.window
    depth = picture.view.project(mesh.vertices.astype(np.float64))[:, 2:]
    texels = mesh.uv * np.array([width, height]) + np.array(corner) + BORDER
    return np.hstack([mesh.vertices, texels / size * depth, depth]).astype(np.float32)


@kernel(nogil=True)
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
