"""The values that captures and meshing produce: depth textures, grid meshes, layers and a cell's impostor (paper section 4)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mmi.cells.viewing_cells import ViewingCell
from mmi.foundation.camera import View

__all__ = ["DepthTexture", "GridMesh", "Impostor", "Layer", "LayerMesh", "LayerPicture", "Promise"]


@dataclass(frozen=True, slots=True, eq=False)
class DepthTexture:
    """What one layer looks like from the reference viewpoint, one sample a texel, taken at the texel's centre.

    ``color`` (h, w, 3) uint8 sRGB, dilated beyond the silhouette; ``depth`` (h, w) float32 eye-space metres, ``inf``
    where nothing was hit; ``object_ids`` (h, w) int32 indices into the city's objects, -1 where nothing was hit.
    Coverage is where depth is finite, which is where ``object_ids`` is not negative.
    """

    view: View
    color: NDArray[np.uint8]
    depth: NDArray[np.float32]
    object_ids: NDArray[np.int32]

    def __post_init__(self) -> None:
        shape = (self.view.window[3], self.view.window[2])
        if self.color.shape != (*shape, 3) or self.depth.shape != shape or self.object_ids.shape != shape:
            raise ValueError(
                f"a depth texture for window {self.view.window} needs arrays of {shape}, "
                f"found {self.color.shape}, {self.depth.shape}, {self.object_ids.shape}"
            )
        if not np.array_equal(np.isfinite(self.depth), self.object_ids >= 0):
            raise ValueError("a depth texture needs finite depth exactly where an object was hit")
        for array in (self.color, self.depth, self.object_ids):
            array.setflags(write=False)

    @property
    def coverage(self) -> NDArray[np.bool_]:
        """(h, w) where an object was hit."""
        return self.object_ids >= 0


@dataclass(frozen=True, slots=True, eq=False)
class GridMesh:
    """Triangles over the capture's image plane, lifted to depth: what an impostor draws.

    ``vertices`` (n, 3) float32 world metres, each on the capture ray of its ``uv`` (n, 2) float32 in [0, 1] (u right,
    v down, (0, 0) the texture's upper left corner); ``triangles`` (m, 3) int32, counter-clockwise seen from the capture.
    """

    vertices: NDArray[np.float32]
    uv: NDArray[np.float32]
    triangles: NDArray[np.int32]

    def __post_init__(self) -> None:
        if self.vertices.ndim != 2 or self.vertices.shape[1] != 3 or self.uv.shape != (len(self.vertices), 2):
            raise ValueError(f"a grid mesh needs (n, 3) and (n, 2), found {self.vertices.shape} and {self.uv.shape}")
        for array in (self.vertices, self.uv, self.triangles):
            array.setflags(write=False)


@dataclass(frozen=True, slots=True, eq=False)
class Layer:
    """A picture of one layer in one sector: ``index`` is its colour in the event graph, ``objects`` (n,) what it is made of.

    Others that touch those show in rims of a texel (:mod:`mmi.capture.rims`).
    A layer whose objects leave wide gaps between them has several pieces in a sector (``piece`` 0, 1, ... from left to right).
    ``displacement`` bounds how far its mesh draws any of a texel from where that was captured, from all of the cell; radians.
    The mesh's first ``in_order`` triangles can be drawn as they are; others need captured depths (:mod:`mmi.meshing.ordering`).
    """

    index: int
    sector: int
    piece: int
    objects: NDArray[np.int64]
    texture: DepthTexture
    mesh: GridMesh
    displacement: float
    in_order: int = 0

    @property
    def name(self) -> str:
        """How files call it: ``s0.l2``, and ``s0.l2.1`` for a second piece."""
        return f"s{self.sector}.l{self.index}" + (f".{self.piece}" if self.piece else "")


@dataclass(frozen=True, slots=True, eq=False)
class LayerMesh:
    """What a dataset without pictures has of a :class:`Layer`: its mesh, and the ``view`` that a picture is captured in."""

    name: str
    index: int
    sector: int
    piece: int
    view: View
    mesh: GridMesh
    in_order: int


@dataclass(frozen=True, slots=True, eq=False)
class LayerPicture:
    """What it takes to draw a :class:`Layer`: its mesh and its picture, without depth and ids.

    ``view`` is that of the capture; ``pixels`` (h, w, 4) uint8: sRGB, dilated beyond the silhouette, and coverage (0 or 255).
    The mesh's first ``in_order`` triangles can be drawn as they are; others need captured depths (:mod:`mmi.meshing.ordering`).
    """

    name: str
    index: int
    sector: int
    piece: int
    view: View
    pixels: NDArray[np.uint8]
    mesh: GridMesh
    in_order: int

    def __post_init__(self) -> None:
        shape = (self.view.window[3], self.view.window[2], 4)
        if self.pixels.shape != shape or self.pixels.dtype != np.uint8:
            raise ValueError(
                f"a picture of {shape} bytes for window {self.view.window} expected, "
                f"found {self.pixels.shape} of {self.pixels.dtype}"
            )
        self.pixels.setflags(write=False)


@dataclass(frozen=True, slots=True)
class Promise:
    """What is promised of a cell's impostor, and what is known of it; pixels of the display.

    ``error_px`` is how thick a wrong region may be from anywhere in the cell (but for two pixels of the rasters), or None,
    where something is not bounded; ``withheld`` then says what. ``largest_weight_px`` is the largest weight of two objects
    that share a layer, or self-parallax; ``missed_px`` how thick a region the layers may miss together, where that is
    bounded; ``displacement_px`` the largest of the layers' bounds on displacement. Raises ValueError where it neither promises
    nor says why not.
    """

    error_px: float | None
    withheld: str | None
    largest_weight_px: float
    missed_px: float | None
    displacement_px: float

    def __post_init__(self) -> None:
        if (self.error_px is None) == (self.withheld is None):
            raise ValueError(f"a promise or a reason expected, found {self.error_px} and {self.withheld!r}")


@dataclass(frozen=True, slots=True, eq=False)
class Impostor:
    """A cell's multi-mesh impostor: objects that stay geometry (indices into the city's objects), and the layers.

    The layers show the ``far`` objects in ``sectors`` views around the cell; ``near_triangles`` are those of the near ones,
    ``visible_triangles`` those of both.
    """

    cell: ViewingCell
    near: NDArray[np.int64]
    far: NDArray[np.int64]
    layers: tuple[Layer, ...]
    sectors: int
    near_triangles: int
    visible_triangles: int
    promise: Promise
