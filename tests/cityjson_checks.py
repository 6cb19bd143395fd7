"""Whether a CityJSON document holds together: what ``solid_checks`` says of its geometry, and every index in it.

The second is what the schema cannot say (cjval's names): indices of vertices, semantics, materials and textures, vertices
that are there twice or for nothing, and parents and children that know each other.

Source: CityJSON 2.0.1 (OGC 20-072r5); cjval.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from solid_checks import Defect, Surface, check_solid, check_surfaces

from mmi.city.welding import weld
from mmi.foundation.errors import CityError

__all__ = ["check_cityjson"]

_DEPTHS = MappingProxyType({
    "MultiPoint": 1, "MultiLineString": 2, "MultiSurface": 3, "CompositeSurface": 3, "Solid": 4, "MultiSolid": 5,
    "CompositeSolid": 5,
})  # fmt: skip


def check_cityjson(
    document: Mapping[str, Any], *, transform: Mapping[str, Any] | None = None, self_intersections: bool = True
) -> list[Defect]:
    """All defects of a CityJSON document, or of a CityJSONFeature with the ``transform`` of its sequence's first line.

    Raises CityError where it is neither.
    """
    kind = document.get("type")
    transform = document.get("transform", transform)
    if kind not in {"CityJSON", "CityJSONFeature"} or transform is None:
        raise CityError(f"a CityJSON document or feature with a transform expected, found type {kind!r}")
    integers = np.array(document["vertices"], dtype=np.int64).reshape(-1, 3)
    vertices = integers * np.array(transform["scale"]) + np.array(transform["translate"])
    found: list[Defect] = []
    used = np.zeros(len(vertices), dtype=bool)
    for id_, one in document["CityObjects"].items():
        found += _family(document, id_, one)
        for number, geometry in enumerate(one.get("geometry", ())):
            where = f"{id_}, geometry {number}"
            boundaries, depth = geometry["boundaries"], _DEPTHS[geometry["type"]]
            indices = np.array(list(_leaves(boundaries, depth)), dtype=np.int64)
            if indices.size and not 0 <= indices.min() <= indices.max() < len(vertices):
                found.append(Defect(0, "wrong_vertex_index", where))
                continue
            used[indices] = True
            found += _geometry(vertices, geometry, where, self_intersections)
            if depth >= 3:
                found += _looks(document.get("appearance", {}), geometry, depth, where)
    if extra := len(integers) - (int(weld(integers).max()) + 1 if len(integers) else 0):
        found.append(Defect(0, "duplicate_vertices", f"{extra} vertices"))
    if idle := np.count_nonzero(~used):
        found.append(Defect(0, "unused_vertices", f"{idle} vertices"))
    return found


def _leaves(nested: Sequence[Any], depth: int) -> Iterator[Any]:
    """What lies ``depth`` lists deep."""
    if depth == 0:
        yield nested
    elif depth == 1:
        yield from nested
    else:
        for inner in nested:
            yield from _leaves(inner, depth - 1)


def _family(document: Mapping[str, Any], id_: str, one: Mapping[str, Any]) -> Iterator[Defect]:
    """Links to parents or children that are not there, or do not link back."""
    for there, back in (("parents", "children"), ("children", "parents")):
        for other in one.get(there, ()):
            if id_ not in document["CityObjects"].get(other, {}).get(back, ()):
                yield Defect(0, "parents_children_consistency", f"{id_}, {there}: {other}")


def _geometry(
    vertices: NDArray[np.float64], geometry: Mapping[str, Any], where: str, self_intersections: bool
) -> list[Defect]:
    boundaries, depth = geometry["boundaries"], _DEPTHS[geometry["type"]]
    if depth == 3:
        surfaces: Sequence[Surface] = boundaries
        return check_surfaces(vertices, surfaces, where=where)
    solids = [] if depth < 4 else [boundaries] if depth == 4 else boundaries
    found = []
    for number, shells in enumerate(solids):
        place = where if depth == 4 else f"{where}, solid {number}"
        found += check_solid(vertices, shells, where=place, self_intersections=self_intersections)
    return found


def _shape(nested: Any, depth: int) -> Any:
    """How many there are of what, down to ``depth`` lists deep; None where there is no list."""
    if not isinstance(nested, list):
        return None
    return len(nested) if depth == 1 else [_shape(inner, depth - 1) for inner in nested]


def _looks(appearance: Mapping[str, Any], geometry: Mapping[str, Any], depth: int, where: str) -> Iterator[Defect]:
    """Semantics, materials and textures that do not fit the surfaces or point to nothing."""
    boundaries = geometry["boundaries"]
    surfaces = _shape(boundaries, depth - 2)
    semantics = geometry.get("semantics")
    if semantics is not None:
        yield from _numbers(semantics["values"], surfaces, depth - 2, len(semantics["surfaces"]), where, "semantics")
    for theme, material in geometry.get("material", {}).items():
        count, place = len(appearance.get("materials", ())), f"{where}, theme {theme}"
        if "value" in material:
            if not 0 <= material["value"] < count:
                yield Defect(0, "materials", f"{place}: material {material['value']} of {count}")
        else:
            yield from _numbers(material["values"], surfaces, depth - 2, count, place, "materials")
    for theme, texture in geometry.get("texture", {}).items():
        place = f"{where}, theme {theme}"
        if _shape(texture["values"], depth - 1) != _shape(boundaries, depth - 1):
            yield Defect(0, "textures", f"{place}: not a list for each ring")
            continue
        counts = len(appearance.get("textures", ())), len(appearance.get("vertices-texture", ()))
        pairs = zip(_leaves(texture["values"], depth - 1), _leaves(boundaries, depth - 1), strict=True)
        for values, ring in pairs:
            if values == [None]:
                continue
            fits = len(values) == len(ring) + 1 and 0 <= values[0] < counts[0]
            if not (fits and all(0 <= value < counts[1] for value in values[1:])):
                yield Defect(0, "textures", f"{place}: {values} of {counts[0]} textures and {counts[1]} vertices")


def _numbers(values: list[Any], surfaces: object, depth: int, count: int, where: str, name: str) -> Iterator[Defect]:
    """Whether ``values`` have one number below ``count``, or None, for each surface."""
    if _shape(values, depth) != surfaces:
        yield Defect(0, name, f"{where}: not a value for each surface")
    elif any(value is not None and not 0 <= value < count for value in _leaves(values, depth)):
        yield Defect(0, name, f"{where}: values below {count} expected")
