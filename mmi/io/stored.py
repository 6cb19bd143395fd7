"""A city as a dataset stores it: canonical JSON that gives the same city back, and fingerprints that tell what changed."""

from __future__ import annotations

import hashlib
import itertools
import json
from collections.abc import Iterator
from typing import Any

import networkx as nx
import numpy as np
import shapely
from shapely.geometry import LineString, Polygon

from mmi.city import City, CityObject, Prism, TriangleMesh
from mmi.errors import CityError

__all__ = ["canonical_json", "city_from_json", "city_to_json", "fingerprint", "object_fingerprints"]

_CANONICAL = json.JSONEncoder(sort_keys=True, separators=(",", ":"), allow_nan=False, ensure_ascii=False)


def canonical_json(value: Any) -> bytes:  # noqa: ANN401
    """The one way that this project writes JSON for hashing and storing: sorted keys, no spaces, shortest floats."""
    return _CANONICAL.encode(value).encode()


def fingerprint(value: Any) -> str:  # noqa: ANN401
    """SHA-256 of the canonical JSON of ``value``, in hexadecimal."""
    return hashlib.sha256(canonical_json(value)).hexdigest()


def object_fingerprints(city: City) -> list[str]:
    """One fingerprint an object, over all that decides how it looks and where it is."""
    return [fingerprint(one) for one in _objects_to_dicts(city.objects)]


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
        }
    )


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
        )
    except (ValueError, KeyError, TypeError, AttributeError, shapely.errors.ShapelyError) as error:
        raise CityError(f"{name}: a city stored by build-impostors expected, found damaged data ({error})") from error


def _objects_to_dicts(objects: tuple[CityObject, ...]) -> Iterator[dict[str, Any]]:
    rings = _rings([prism.footprint for one in objects for prism in one.prisms])
    for one in objects:
        stored: dict[str, Any] = {
            "id": one.id,
            "opaque": one.opaque,
            "prisms": [
                {"rings": next(rings), "bottom": float(prism.bottom), "top": float(prism.top)} for prism in one.prisms
            ],
        }
        if one.mesh is not None:
            stored["mesh"] = {"vertices": one.mesh.vertices.tolist(), "triangles": one.mesh.triangles.tolist()}
        yield stored


def _rings(polygons: list[Polygon]) -> Iterator[list[list[list[float]]]]:
    """Each polygon's rings, exterior first, as lists of [x, y]."""
    rings, polygon = shapely.get_rings(polygons, return_index=True)
    points, ring = shapely.get_coordinates(rings, return_index=True)
    ends = np.searchsorted(ring, np.arange(len(rings) + 1)).tolist()
    lists = [points[start:end].tolist() for start, end in itertools.pairwise(ends)]
    starts = np.searchsorted(polygon, np.arange(len(polygons) + 1)).tolist()
    return (lists[start:end] for start, end in itertools.pairwise(starts))


def _object_from_dict(stored: dict[str, Any]) -> CityObject:
    mesh = stored.get("mesh")
    return CityObject(
        id=stored["id"],
        prisms=tuple(
            Prism(Polygon(prism["rings"][0], prism["rings"][1:]), prism["bottom"], prism["top"])
            for prism in stored["prisms"]
        ),
        mesh=None
        if mesh is None
        else TriangleMesh(np.array(mesh["vertices"], dtype=np.float64), np.array(mesh["triangles"], dtype=np.int32)),
        opaque=bool(stored["opaque"]),
    )
