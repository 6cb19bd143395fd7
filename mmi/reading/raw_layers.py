"""What the readers hand over: outlines, meshes and street lines with tags, in the coordinates of their file.

Tags speak OpenStreetMap's vocabulary whatever the file was (``height``, ``building:levels``, ``highway``, ...): readers of
other formats translate their columns. Nothing here is repaired, projected or judged yet.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import pyproj
from shapely.geometry import LineString
from shapely.geometry.base import BaseGeometry

from mmi.city.model import Texture, TriangleMesh
from mmi.reading.names import UniqueNames
from mmi.reading.report import Ledger

__all__ = [
    "BuildingLayer",
    "ModelLayer",
    "RawBuilding",
    "RawModel",
    "RawStreet",
    "StreetLayer",
    "is_yes",
    "with_unique_ids",
]


@dataclass(frozen=True, slots=True, eq=False)
class RawBuilding:
    """A building or building part as found: any geometry with polygons in it."""

    id: str
    geometry: BaseGeometry
    tags: dict[str, str]


@dataclass(frozen=True, slots=True, eq=False)
class RawStreet:
    """A street as found: ``lines``, and for OpenStreetMap the node ids of each line's points (junctions = shared ids)."""

    id: str
    lines: tuple[LineString, ...]
    tags: dict[str, str]
    nodes: tuple[tuple[int, ...], ...] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class RawModel:
    """A building as a mesh, as found: z up, in the file's coordinates; it may be open, or its triangles wound any way."""

    id: str
    mesh: TriangleMesh


@dataclass(frozen=True, slots=True, eq=False)
class ModelLayer:
    """All that a 3D model holds. ``crs`` is None where the file declares none: then its units are taken as metres.

    ``textures`` are what the meshes refer to. ``terrain`` is a triangulated surface or loose points (no triangles) of the
    ground; ``streets`` are centre lines, empty if the file has none.
    """

    file: str
    items: tuple[RawModel, ...]
    crs: pyproj.CRS | None
    textures: tuple[Texture, ...] = ()
    terrain: TriangleMesh | None = None
    streets: tuple[RawStreet, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class BuildingLayer:
    """All buildings of a source. ``crs`` is None where the file declares none; ``crs_certain`` where the format fixes it.

    ``height_label`` and ``levels_label`` say where heights were looked for (``"column HAUTEUR"``), for report and errors.
    """

    file: str
    items: tuple[RawBuilding, ...]
    crs: pyproj.CRS | None
    crs_certain: bool
    height_label: str
    levels_label: str


@dataclass(frozen=True, slots=True, eq=False)
class StreetLayer:
    """All streets of a source; ``crs`` and ``crs_certain`` as in ``BuildingLayer``."""

    file: str
    items: tuple[RawStreet, ...]
    crs: pyproj.CRS | None
    crs_certain: bool


def is_yes(value: str | None) -> bool:
    """True for a flag that is set: present and not one of the ways to write no."""
    return value is not None and value.strip().lower() not in {"", "no", "n", "false", "f", "0", "none"}


_Named = TypeVar("_Named", RawBuilding, RawModel)


def with_unique_ids(items: Sequence[_Named], ledger: Ledger) -> tuple[_Named, ...]:
    """The items in their order; an id that is there already gets ``#2``, ``#3``, ..., which the ledger counts.

    One that is empty is ``unnamed``.
    """
    names = UniqueNames()
    unique: list[_Named] = []
    for item in items:
        id_ = names.free(item.id or "unnamed")
        names.take(id_)
        if id_ != item.id:
            ledger.note("repaired", "repeated id made unique" if item.id else "building without an id named", id_)
            item = replace(item, id=id_)
        unique.append(item)
    return tuple(unique)
