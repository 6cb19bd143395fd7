"""Tiles of a city model, as cities publish them: a folder of CityGML or CityJSON files becomes one model."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyproj

from mmi.city.model import Texture
from mmi.foundation.errors import CityError
from mmi.reading.city_models.citygml import is_citygml
from mmi.reading.city_models.cityjson import is_cityjson
from mmi.reading.models.raw_meshes import joined_meshes
from mmi.reading.names import UniqueNames
from mmi.reading.raw_layers import ModelLayer, RawModel, RawStreet, with_unique_ids
from mmi.reading.report import Ledger

__all__ = ["joined_tiles", "tiles_of"]


def tiles_of(folder: Path) -> list[Path]:
    """The CityGML or CityJSON files in a folder, by name; none where there are fewer than two, or some of both kinds."""
    inside = sorted(one for one in folder.iterdir() if one.is_file())
    for kind, other in ((is_citygml, is_cityjson), (is_cityjson, is_citygml)):
        tiles = [one for one in inside if kind(one)]
        if len(tiles) > 1 and not any(other(one) for one in inside):
            return tiles
    return []


def joined_tiles(file: str, layers: Sequence[ModelLayer], ledger: Ledger) -> ModelLayer:
    """One model of several (at least one), called ``file``.

    A building whose id stands in two tiles, in the same place, is there once, with the most triangles; where only its id comes
    twice, it gets a number.

    Raises:
        CityError: the tiles differ in their coordinate system; names two of them.
    """
    first = layers[0]
    for other in layers[1:]:
        if not _same(first.crs, other.crs):
            raise CityError(
                f"{file}: tiles of one coordinate system expected, found {_name(first.crs)} in {Path(first.file).name} and "
                f"{_name(other.crs)} in {Path(other.file).name}; put them into folders of their own"
            )
    names = UniqueNames()
    textures: list[Texture] = []
    items: list[RawModel] = []
    streets: list[RawStreet] = []
    places: dict[str, list[int]] = {}
    for layer in layers:
        for item in layer.items:
            item = _shifted(item, len(textures))
            twin = next((i for i in places.get(item.id, ()) if _same_place(items[i], item)), None)
            if twin is None:
                places.setdefault(item.id, []).append(len(items))
                items.append(item)
                continue
            ledger.note("left out", "building: stands in another tile", item.id)
            if len(item.mesh.triangles) > len(items[twin].mesh.triangles):
                items[twin] = item
        for texture in layer.textures:
            name = names.free(texture.name)
            names.take(name)
            textures.append(replace(texture, name=name))
        streets += layer.streets
    ground = [layer.terrain for layer in layers if layer.terrain is not None]
    return ModelLayer(
        file,
        with_unique_ids(items, ledger),
        first.crs,
        tuple(textures),
        joined_meshes(ground) if ground else None,
        tuple(_numbered(streets)),
    )


def _shifted(item: RawModel, count: int) -> RawModel:
    """The building, whose textures come behind ``count`` others."""
    textures = item.mesh.textures
    return replace(item, mesh=replace(item.mesh, textures=np.where(textures >= 0, textures + count, textures)))


def _same_place(one: RawModel, other: RawModel) -> bool:
    """Whether two buildings stand in one place: the smaller one's box, seen from above, lies in the other's by half."""
    low, high = (
        np.array([edge(item.mesh.vertices[:, :2], axis=0) for item in (one, other)]) for edge in (np.min, np.max)
    )
    common = np.prod(np.maximum(high.min(axis=0) - low.max(axis=0), 0.0))
    return bool(common > 0.5 * np.prod(high - low, axis=1).min())


def _same(one: pyproj.CRS | None, other: pyproj.CRS | None) -> bool:
    return one == other if one is None or other is None else one.equals(other)


def _name(crs: pyproj.CRS | None) -> str:
    return "none" if crs is None else crs.name


def _numbered(streets: Sequence[RawStreet]) -> Iterator[RawStreet]:
    """The streets, ids that come twice with a number."""
    names = UniqueNames()
    for street in streets:
        id_ = names.free(street.id)
        names.take(id_)
        yield replace(street, id=id_)
