"""What the JSON of CityJSON means, object by object: families, boundaries, levels of detail, themes and colours.

Pure functions; what reads files and collects is ``cityjson``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mmi.reading.city_models.faces import Color
from mmi.reading.names import UniqueNames

__all__ = [
    "DAMAGE",
    "attributes_of",
    "color_of",
    "families_of",
    "is_building_kind",
    "level_of",
    "line_of",
    "missing_parts",
    "objects_with_all_ids",
    "points_of",
    "surfaces_of",
    "theme_values",
    "without_looks",
    "worth_of",
]

DAMAGE = (KeyError, TypeError, ValueError, IndexError, AttributeError, OverflowError, RecursionError)
"""What Python raises on JSON of another shape than expected."""
_BUILDING = frozenset(
    {"Building", "BuildingPart", "BuildingInstallation", "BuildingConstructiveElement", "Tunnel", "OtherConstruction"}
)
_INSIDE = ("room", "storey", "unit", "furniture", "intbuilding")


def is_building_kind(kind: object) -> bool:
    """Whether objects of this type are buildings or what belongs to one; of extensions (``+GenericBuilding``) the name tells.

    Rooms, storeys and furniture of buildings are inside of them.
    """
    if isinstance(kind, str) and kind.startswith("+"):
        return "building" in kind.lower() and not any(word in kind.lower() for word in _INSIDE)
    return isinstance(kind, str) and kind in _BUILDING


def attributes_of(one: Mapping[str, Any]) -> dict[str, Any]:
    """The attributes of an object, none where they are something else."""
    attributes = one.get("attributes")
    return attributes if isinstance(attributes, dict) else {}


def objects_with_all_ids(repeated: list[str]) -> Callable[[list[tuple[str, Any]]], dict[str, Any]]:
    """What makes a dict of the members of a JSON object, for ``json.loads(object_pairs_hook=...)``.

    Of two city objects with one id JSON's readers keep the last. Here the others get numbers, which go into ``repeated``; what
    is no city object is kept as usual.
    """

    def members(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        whole = dict(pairs)
        if len(whole) == len(pairs) or not all(isinstance(one, dict) and "type" in one for one in whole.values()):
            return whole
        names, kept = UniqueNames(), dict[str, Any]()
        for name in whole:
            names.take(name)
        for name, value in pairs:
            own = names.free(name) if name in kept else name
            names.take(own)
            kept[own] = value
            if own != name:
                repeated.append(own)
        return kept

    return members


def without_looks(templates: dict[str, Any]) -> dict[str, Any]:
    """Geometry templates without their materials and textures."""
    shapes = templates.get("templates")
    bare = [
        {key: value for key, value in shape.items() if key not in ("material", "texture")}
        if isinstance(shape, dict)
        else shape
        for shape in (shapes if isinstance(shapes, list) else [])
    ]
    return {**templates, "templates": bare}


def families_of(objects: Mapping[str, Any]) -> dict[str, list[str]]:
    """The first-level objects, each with the names of all that belong to it, itself included."""
    families: dict[str, list[str]] = {}
    parents = _parents(objects)
    for name in objects:
        families.setdefault(_family(name, parents), []).append(name)
    return families


def missing_parts(objects: Mapping[str, Any]) -> dict[str, int]:
    """How many parts each object names that are not there, where some are not. Groups are no wholes."""
    missing: dict[str, int] = {}
    for name, one in objects.items():
        listed = one.get("children") if isinstance(one, dict) and one.get("type") != "CityObjectGroup" else None
        lost = [
            child
            for child in (listed if isinstance(listed, list) else ())
            if isinstance(child, str) and child not in objects
        ]
        if lost:
            missing[name] = len(lost)
    return missing


def points_of(vertices: Any) -> NDArray[np.float64]:  # noqa: ANN401
    """Points (n, 3), not a number where they are none."""
    try:
        points = np.array(vertices or np.empty((0, 3)), dtype=np.float64)
        if points.shape == (len(points), 3):
            return points
    except DAMAGE:
        pass
    rows = vertices if isinstance(vertices, list) else []
    return np.array([_point(row) for row in rows], dtype=np.float64).reshape(-1, 3)


def _point(row: Any) -> tuple[float, ...]:  # noqa: ANN401
    try:
        point = tuple(map(float, row))
    except DAMAGE:
        point = ()
    return point if len(point) == 3 else (np.nan,) * 3


def line_of(error: BaseException) -> str:
    """What the error says, in one short line."""
    return " ".join(str(error).split())[:160]


def _parents(objects: Mapping[str, Mapping[str, Any]]) -> dict[str, str]:
    """Parts and what they are parts of. Groups are no wholes; the oldest files tell a whole its parts only."""
    found: dict[str, str] = {}
    sound = {name: one for name, one in objects.items() if isinstance(one, dict)}
    for name, one in sound.items():
        if one.get("type") != "CityObjectGroup":
            for key in ("children", "Parts", "Installations"):
                listed = one.get(key)
                found |= {
                    child: name for child in (listed if isinstance(listed, list) else ()) if isinstance(child, str)
                }
    for name, one in sound.items():
        own = one.get("parents") or [one.get("parent")]
        for parent in own if isinstance(own, list) else []:
            if isinstance(parent, str) and parent in sound and sound[parent].get("type") != "CityObjectGroup":
                found[name] = parent
                break
    return found


def _family(name: str, parents: Mapping[str, str]) -> str:
    """The first-level object that ``name`` belongs to."""
    seen = {name}
    while name in parents and parents[name] not in seen:
        name = parents[name]
        seen.add(name)
    return name


def level_of(geometry: Mapping[str, Any]) -> float:
    """The level of detail as a number, 2 where it cannot be read."""
    try:
        return float(geometry.get("lod", 2))
    except (TypeError, ValueError):
        return 2.0


def worth_of(geometry: Mapping[str, Any]) -> tuple[bool, bool, bool]:
    """Rank of a geometry among those of one level: those with pictures first, then closed ones, then those with colours."""
    return bool(geometry.get("texture")), geometry["type"] != "MultiSurface", bool(geometry.get("material"))


def surfaces_of(boundaries: list[Any], depth: int) -> Iterator[list[list[int]]]:
    """The surfaces of nested boundaries, outer shells only."""
    if depth == 1:
        yield from boundaries
    elif depth == 2:
        if boundaries:
            yield from boundaries[0]
    else:
        for solid in boundaries:
            yield from surfaces_of(solid, 2)


def theme_values(themes: Any, depth: int, count: int) -> list[Any] | None:  # noqa: ANN401
    """What the first theme says of each surface, None where it says nothing (of this shape).

    A theme has ``values`` nested like the boundaries, or one ``value`` for all; the oldest files have the values alone.
    """
    if not themes:
        return None
    theme = next(iter(themes.values())) if isinstance(themes, dict) else {"values": themes}
    if "value" in theme:
        return [theme["value"]] * count
    values = theme.get("values")
    if not isinstance(values, list):
        return None
    try:
        flat = list(surfaces_of(values, depth))
    except TypeError:
        return None
    return flat if len(flat) == count else None


def color_of(value: Any) -> Color | None:  # noqa: ANN401
    """sRGB bytes of a diffuse colour in [0, 1]."""
    if value is None:
        return None
    red, green, blue = (round(255 * min(max(float(one), 0.0), 1.0)) for one in value[:3])
    return red, green, blue
