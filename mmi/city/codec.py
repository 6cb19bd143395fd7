"""A city as a dataset stores it: canonical JSON that gives the same city back, and fingerprints that tell what changed."""

from __future__ import annotations

import base64
import itertools
import json
import math
import zlib
from collections.abc import Iterator
from typing import Any

import networkx as nx
import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import LineString, Polygon

from mmi.city.model import City, CityObject, Prism, Texture, TriangleMesh
from mmi.city.terrain import Terrain
from mmi.foundation.errors import CityError
from mmi.foundation.json_forms import canonical_json, fingerprint

__all__ = ["city_from_json", "city_to_json", "object_fingerprints"]

_MESH = (("vertices", "<f8"), ("triangles", "<i4"), ("textures", "<i4"), ("colors", "|u1"), ("uv", "<f4"))
_DAMAGE = (
    ValueError,
    LookupError,
    TypeError,
    AttributeError,
    ArithmeticError,  # a whole number expected, infinity found
    RecursionError,
    zlib.error,
    shapely.errors.ShapelyError,
)


def object_fingerprints(city: City) -> list[str]:
    """One fingerprint an object, over all that decides how it looks and where it is."""
    return [fingerprint(one | _facades(city)) for one in _objects_to_dicts(city.objects)]


def city_to_json(city: City) -> bytes:
    """The whole city as canonical JSON; :func:`city_from_json` is the inverse."""
    streets = [
        {
            "ends": [int(a), int(b)],
            "key": int(key),
            "index": int(edge["index"]),
            "kind": str(edge["kind"]),
            "name": str(edge["name"]),
            "half_width": float(edge["half_width"]),
            "line": shapely.get_coordinates(edge["geometry"]).tolist(),
        }
        for a, b, key, edge in city.streets.edges(keys=True, data=True)
    ]
    junctions = [[int(node), float(data["x"]), float(data["y"])] for node, data in city.streets.nodes(data=True)]
    return canonical_json(
        {
            "objects": list(_objects_to_dicts(city.objects)),
            "junctions": sorted(junctions),
            "streets": sorted(streets, key=lambda street: street["index"]),
            "crs": city.crs,
            "origin": list(city.origin),
            "source": city.source,
            "ground": city.ground,
            "terrain": None
            if city.terrain is None
            else {
                "origin": list(city.terrain.origin),
                "spacing": city.terrain.spacing,
                "heights": _packed(city.terrain.heights),
            },
            "textures": [{"name": one.name, "image": _packed(one.image)} for one in city.textures],
            **_facades(city),
        }
    )


def _facades(city: City) -> dict[str, str]:
    """Painted facades are not mentioned: cities were stored before there were others."""
    return {} if city.facades == "painted" else {"facades": city.facades}


def city_from_json(data: bytes, *, name: str) -> City:
    """The city that :func:`city_to_json` wrote. ``name`` is the file's, for the message.

    Raises CityError when the JSON is damaged or is not a stored city.
    """
    try:
        stored = json.loads(data)
        streets = nx.MultiGraph()
        for node, x, y in stored["junctions"]:
            streets.add_node(int(node), x=float(x), y=float(y))
        for street in stored["streets"]:
            streets.add_edge(
                *street["ends"],
                key=street["key"],
                geometry=LineString(street["line"]),
                **{name: street[name] for name in ("index", "kind", "name", "half_width")},
            )
        return City(
            objects=tuple(_object_from_dict(one) for one in stored["objects"]),
            streets=streets,
            crs=str(stored["crs"]),
            origin=tuple(float(x) for x in stored["origin"]),  # type: ignore[arg-type]
            source=str(stored["source"]),
            ground=float(stored["ground"]),
            terrain=_terrain(stored["terrain"]),
            textures=tuple(Texture(str(one["name"]), _unpacked(one["image"], "|u1")) for one in stored["textures"]),
            facades=str(stored.get("facades", "painted")),
        )
    except _DAMAGE as error:
        why = " ".join(str(error).split())  # GEOS ends its own with a line break
        raise CityError(f"{name}: a city stored by build-impostors expected, found damaged data ({why})") from error


def _packed(array: NDArray[Any]) -> dict[str, Any]:
    """An array as JSON: little-endian bytes, compressed, in base64."""
    kind = array.dtype.newbyteorder("<")
    data = base64.b64encode(zlib.compress(np.ascontiguousarray(array, dtype=kind).tobytes(), 1)).decode()
    return {"kind": kind.str, "shape": list(array.shape), "data": data}


def _unpacked(stored: dict[str, Any], kind: str) -> NDArray[Any]:
    if stored["kind"] != kind:
        raise ValueError(f"an array of {kind} expected, found {stored['kind']!r}")
    shape = [int(one) for one in stored["shape"]]
    size = math.prod(shape) * np.dtype(kind).itemsize
    unpacking = zlib.decompressobj()
    # One byte more than is expected: what is packed may be a thousand times as large.
    data = unpacking.decompress(base64.b64decode(stored["data"], validate=True), max(size, 0) + 1)
    if len(data) != size or not unpacking.eof:
        raise ValueError(f"an array of {size} bytes expected, found {'more' if len(data) > size else len(data)}")
    return np.frombuffer(data, dtype=kind).reshape(shape)


def _terrain(stored: dict[str, Any] | None) -> Terrain | None:
    if stored is None:
        return None
    x, y = (float(one) for one in stored["origin"])
    return Terrain((x, y), float(stored["spacing"]), _unpacked(stored["heights"], "<f8"))


def _objects_to_dicts(objects: tuple[CityObject, ...]) -> Iterator[dict[str, Any]]:
    solids = [(*one.prisms, *(one.core or ())) for one in objects]
    rings = _rings([prism.footprint for own in solids for prism in own])
    for one in objects:
        # The order of the two lists is that of ``solids``.
        stored: dict[str, Any] = {"id": one.id, "prisms": _prisms_to_dicts(one.prisms, rings)}
        if one.core is not None:
            stored["core"] = _prisms_to_dicts(one.core, rings)
        if one.part_of is not None:
            stored["part_of"] = one.part_of
        if one.mesh is not None:
            stored["mesh"] = {name: _packed(getattr(one.mesh, name)) for name, _ in _MESH}
        yield stored


def _prisms_to_dicts(prisms: tuple[Prism, ...], rings: Iterator[list[list[list[float]]]]) -> list[dict[str, Any]]:
    return [{"rings": next(rings), "bottom": float(prism.bottom), "top": float(prism.top)} for prism in prisms]


def _rings(polygons: list[Polygon]) -> Iterator[list[list[list[float]]]]:
    """Each polygon's rings, exterior first, as lists of [x, y]."""
    rings, polygon = shapely.get_rings(polygons, return_index=True)
    points, ring = shapely.get_coordinates(rings, return_index=True)
    ends = np.searchsorted(ring, np.arange(len(rings) + 1)).tolist()
    lists = [points[start:end].tolist() for start, end in itertools.pairwise(ends)]
    starts = np.searchsorted(polygon, np.arange(len(polygons) + 1)).tolist()
    return (lists[start:end] for start, end in itertools.pairwise(starts))


def _object_from_dict(stored: dict[str, Any]) -> CityObject:
    mesh, core = stored.get("mesh"), stored.get("core")
    part_of = stored.get("part_of")
    if not isinstance(stored["id"], str) or not isinstance(part_of, str | None):
        raise ValueError(f"an object's id as text expected, found {stored['id']!r}, part of {part_of!r}")
    return CityObject(
        id=stored["id"],
        prisms=_prisms_from_dicts(stored["prisms"]),
        mesh=None if mesh is None else TriangleMesh(*(_unpacked(mesh[name], kind) for name, kind in _MESH)),
        core=None if core is None else _prisms_from_dicts(core),
        part_of=part_of,
    )


def _prisms_from_dicts(stored: list[dict[str, Any]]) -> tuple[Prism, ...]:
    return tuple(
        Prism(Polygon(one["rings"][0], one["rings"][1:]), float(one["bottom"]), float(one["top"])) for one in stored
    )
