"""The casters by name, as programs offer them."""

from __future__ import annotations

from typing import Literal

from mmi.appearance.city_mesh import CityMesh
from mmi.rays.embree import embree_caster
from mmi.rays.grid_caster import grid_caster
from mmi.rays.hits import Caster

__all__ = ["CasterKind", "make_caster"]

CasterKind = Literal["grid", "embree"]
"""``embree`` is the faster one; ``grid`` needs nothing but Numba."""


def make_caster(mesh: CityMesh, *, kind: CasterKind, workers: int) -> Caster:
    """A caster for all triangles of ``mesh``, which casts with ``workers`` threads (one means that of the caller)."""
    return grid_caster(mesh, workers=workers) if kind == "grid" else embree_caster(mesh, workers=workers)
