"""What the renderer keeps on the GPU: programs, meshes, triangles of them, and cells; plain values around OpenGL's objects.

The objects come from ``viewer.drawing.renderer``, which alone knows what they are.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mmi.appearance.city_mesh import CityMesh

__all__ = ["CellBuffers", "MeshBuffers", "Program", "Triangles"]


@dataclass(frozen=True, slots=True, eq=False)
class Program:
    """A program and those of its uniforms that the compiler has kept."""

    program: Any
    uniforms: Mapping[str, Any]

    def set(self, values: Mapping[str, bytes]) -> None:
        """Set uniforms; what the program does not use is passed over."""
        for name, value in values.items():
            if name in self.uniforms:
                self.uniforms[name].write(value)


@dataclass(frozen=True, slots=True, eq=False)
class MeshBuffers:
    """Geometry on the GPU: vertices with their texture. ``mesh`` is what it was made from."""

    mesh: CityMesh
    vertices: Any
    texture: Any


@dataclass(frozen=True, slots=True, eq=False)
class Triangles:
    """Some triangles of a mesh: ``arrays`` by whether pictures are measured."""

    count: int
    arrays: Mapping[bool, Any]
    indices: Any

    def release(self) -> None:
        """Free it."""
        for thing in (*self.arrays.values(), self.indices):
            thing.release()


@dataclass(frozen=True, slots=True, eq=False)
class CellBuffers:
    """A cell's layers on the GPU: their atlas and vertices; of each layer that is there its triangles, as indices into all.

    ``sets`` are the triangles of layers that were drawn together: plain ones, and those that need captured depths.
    """

    eye: NDArray[np.float64]
    textures: tuple[Any, ...]
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
