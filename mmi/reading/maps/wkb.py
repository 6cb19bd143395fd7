"""Well-known binary that shapely does not read: triangulated and polyhedral surfaces, which are polygons by another name.

GDAL gives MultiPatch shapes of strips and fans as TINs. Their triangles lie in WKB as polygons do, so that another number for
their kind is all it takes.
Source: OGC Simple Feature Access, part 1 (06-103r4), section 8.2.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from types import MappingProxyType

import numpy as np
import shapely
from numpy.typing import NDArray

__all__ = ["geometries_from_wkb"]

_POINT, _LINE, _POLYGON, _MULTIPOLYGON = 1, 2, 3, 6
_COLLECTIONS = frozenset({4, 5, 6, 7, 15, 16})
_KNOWN_AS = MappingProxyType({15: _MULTIPOLYGON, 16: _MULTIPOLYGON, 17: _POLYGON})
_DEEPEST = 20


def geometries_from_wkb(wkb: Sequence[bytes | None] | NDArray[np.object_]) -> NDArray[np.object_]:
    """Geometries (n,) in two dimensions; None where there is none, or none that can be read."""
    shapes = np.asarray(shapely.from_wkb(wkb, on_invalid="ignore"), dtype=object)
    for i, one in enumerate(wkb):
        if shapes[i] is None and one is not None:
            renamed = bytearray(one)
            try:
                _rename(renamed, 0, 0)
            except (struct.error, IndexError, ValueError):
                continue  # damaged, or of a kind that is no polygon either
            shapes[i] = shapely.from_wkb(bytes(renamed), on_invalid="ignore")
    return shapes


def _rename(wkb: bytearray, at: int, depth: int) -> int:
    """Surfaces among the geometry that starts ``at`` become polygons in place; where the next one starts."""
    if depth > _DEEPEST:
        raise ValueError("nested too deep")
    order = "<" if wkb[at] else ">"
    (kind,) = struct.unpack_from(order + "I", wkb, at + 1)
    if kind in _KNOWN_AS:
        struct.pack_into(order + "I", wkb, at + 1, _KNOWN_AS[kind])
    at += 5
    if kind == _POINT:
        return at + 16
    (count,) = struct.unpack_from(order + "I", wkb, at)
    at += 4
    if kind == _LINE:
        return at + 16 * int(count)
    if kind not in {_POLYGON, 17, *_COLLECTIONS}:
        raise ValueError(f"a geometry of kind {kind}")
    for _ in range(count):
        if kind in _COLLECTIONS:
            at = _rename(wkb, at, depth + 1)
        else:
            (points,) = struct.unpack_from(order + "I", wkb, at)
            at += 4 + 16 * int(points)
    return at
