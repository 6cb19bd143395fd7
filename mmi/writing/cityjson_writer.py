"""Cities out as CityJSON 2.0: one document (``.json``), or a line for each object (``.jsonl``, CityJSONSeq).

Coordinates are the city's plus its origin, in its CRS. Both kinds are written object by object and are there whole or not
at all; the same city gives the same bytes. Textures are PNG files in ``<stem>.appearances/`` beside the file.

Prisms and core of an object with a mesh are not written: the reader finds them again.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack
from itertools import islice
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, Self

import networkx as nx
import numpy as np
import pyproj
import shapely
from numpy.typing import NDArray
from pyproj.exceptions import ProjError

from mmi.city.model import City, CityObject, Texture
from mmi.city.terrain import Terrain
from mmi.foundation.errors import CityError, ParameterError
from mmi.foundation.srgb import png_bytes
from mmi.foundation.whole_files import whole_file, write_whole
from mmi.writing.cityjson_geometry import SCALE, Named, Pools, buildings, millimetres, reliefs, roads

__all__ = ["CityJSONSeqWriter", "write_cityjson"]

_CHUNK = 4096  # objects that are prepared at a time
_ENCODER = json.JSONEncoder(ensure_ascii=False, allow_nan=False, check_circular=False, separators=(",", ":"))

_Heights = Callable[[NDArray[np.float64]], NDArray[np.float64]]


def write_cityjson(city: City, path: Path, *, progress: Callable[[int, int], None] | None = None) -> None:
    """Write ``city`` to ``path``: ``.json`` CityJSON, ``.jsonl`` CityJSONSeq. ``progress`` hears (objects done, of all).

    Raises:
        ParameterError: the path has another suffix.
        CityError: the city's CRS has no name to put into the file, or the file cannot be written.
    """
    suffix = path.suffix.lower()
    if suffix not in {".json", ".jsonl"}:
        raise ParameterError(f"{path}: a name that ends in .json or .jsonl expected, found {path.suffix!r}")
    if suffix == ".jsonl":
        with CityJSONSeqWriter(
            path,
            crs=city.crs,
            origin=city.origin,
            source=city.source,
            textures=city.textures,
            extent=_extent(city),
        ) as writer:
            writer.add(_counted(city.objects, progress))
            writer.add_streets(city.streets, city.ground_at)
            if city.terrain is not None:
                writer.add_terrain(city.terrain)
        return
    head = _head(path, city.crs, city.origin, city.source, _extent(city))
    pools = Pools()
    names = _Names()
    with whole_file(path, error=CityError) as file:
        file.write(_text(head)[:-1] + b',"CityObjects":{')
        separator = b""
        for id_, entry, _ in _everything(city, lambda: pools, progress):
            file.write(separator + b"\n" + _text(names.free(id_, path)) + b":" + _text(entry))
            separator = b","
        file.write(b"\n}")
        files = _texture_files(path, city.textures)
        if appearance := pools.appearance(files):
            file.write(b',\n"appearance":' + _text(appearance))
        file.write(b',\n"vertices":' + _text(pools.points) + b"}\n")
        _write_textures(path, city.textures, files, pools.used_textures)


class CityJSONSeqWriter:
    """A CityJSONSeq that grows object by object; a context manager, which makes the file appear when it ends well.

    Holds :data:`_CHUNK` objects at a time and the ids of all. ``origin`` is added to all coordinates; ``textures`` are
    what meshes refer to; ``extent`` (min x, y, z, max x, y, z in the CRS) goes into the first line, if known by then.
    """

    def __init__(
        self,
        path: Path,
        *,
        crs: str,
        origin: tuple[float, float, float],
        source: str,
        textures: Sequence[Texture] = (),
        extent: tuple[float, ...] | None = None,
    ) -> None:
        self._path = path
        self._head = _head(path, crs, origin, source, extent)
        self._textures = tuple(textures)
        self._files = _texture_files(path, self._textures)
        self._used: set[int] = set()
        self._names = _Names()
        self._stack = ExitStack()
        self._file: BinaryIO | None = None

    def __enter__(self) -> Self:
        self._file = self._stack.enter_context(whole_file(self._path, error=CityError))
        self._file.write(_text(self._head | {"CityObjects": {}, "vertices": []}) + b"\n")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file = None
        with self._stack.pop_all() as stack:
            # Errors leave through the stack, so that the file vanishes.
            if kind is None:
                _write_textures(self._path, self._textures, self._files, sorted(self._used))
            else:
                stack.__exit__(kind, error, trace)

    def add(self, objects: Iterable[CityObject]) -> None:
        """Write objects. Raises CityError for an id that was written before, or a texture that is not there."""
        for chunk in _chunks(objects):
            self._check_textures(chunk)
            for named in buildings(chunk, Pools):
                self._write(named)

    def add_streets(self, graph: nx.MultiGraph, ground_at: _Heights) -> None:
        """Write the edges of a city's street graph, at the heights that ``ground_at`` gives for points (n, 2)."""
        for named in roads(graph, ground_at, Pools):
            self._write(named)

    def add_terrain(self, terrain: Terrain) -> None:
        """Write the ground."""
        for named in reliefs(terrain, Pools):
            self._write(named)

    def _check_textures(self, chunk: Sequence[CityObject]) -> None:
        for one in chunk:
            last = -1 if one.mesh is None else int(one.mesh.textures.max(initial=-1))
            if last >= len(self._textures):
                raise CityError(f"{self._path}: object {one.id} refers to texture {last} of {len(self._textures)}")

    def _write(self, named: Named) -> None:
        if self._file is None:
            raise ParameterError(f"{self._path}: CityJSONSeqWriter writes only inside its with block")
        id_, entry, pools = named
        id_ = self._names.free(id_, self._path)
        line: dict[str, Any] = {"type": "CityJSONFeature", "id": id_, "CityObjects": {id_: entry}}
        if appearance := pools.appearance(self._files):
            line["appearance"] = appearance
            self._used.update(pools.used_textures)
        self._file.write(_text(line | {"vertices": pools.points}) + b"\n")


class _Names:
    """The ids that are taken."""

    def __init__(self) -> None:
        self._taken: set[str] = set()

    def free(self, id_: str, path: Path) -> str:
        """``id_`` itself, or if it is a street's or the ground's and taken, with a ``+`` after it."""
        while id_ in self._taken and re.match(r"street/|terrain", id_):
            id_ += "+"
        if id_ in self._taken:
            raise CityError(f"{path}: object ids must be unique, found {id_} twice")
        self._taken.add(id_)
        return id_


def _text(value: object) -> bytes:
    return _ENCODER.encode(value).encode("utf-8", errors="backslashreplace")


def _chunks(objects: Iterable[CityObject]) -> Iterator[list[CityObject]]:
    rest = iter(objects)
    while chunk := list(islice(rest, _CHUNK)):
        yield chunk


def _counted(objects: Sequence[CityObject], progress: Callable[[int, int], None] | None) -> Iterator[CityObject]:
    """The objects; tells ``progress`` after each chunk that was taken."""
    for done, one in enumerate(objects, 1):
        yield one
        if progress is not None and (done % _CHUNK == 0 or done == len(objects)):
            progress(done, len(objects))


def _everything(city: City, pools: Callable[[], Pools], progress: Callable[[int, int], None] | None) -> Iterator[Named]:
    for chunk in _chunks(_counted(city.objects, progress)):
        yield from buildings(chunk, pools)
    yield from roads(city.streets, city.ground_at, pools)
    if city.terrain is not None:
        yield from reliefs(city.terrain, pools)


# -------------------------------------------------------------------------------------------------------- metadata


def _head(
    path: Path, crs: str, origin: tuple[float, float, float], source: str, extent: tuple[float, ...] | None
) -> dict[str, Any]:
    """All that goes before the City Objects."""
    metadata: dict[str, Any] = {"title": source}
    if extent is not None:
        metadata["geographicalExtent"] = list(extent)
    if crs != "local":
        metadata["referenceSystem"] = _reference_system(path, crs)
    transform = {"scale": [SCALE] * 3, "translate": [float(one) for one in origin]}
    return {"type": "CityJSON", "version": "2.0", "transform": transform, "metadata": metadata}


def _reference_system(path: Path, crs: str) -> str:
    try:
        found = pyproj.CRS.from_user_input(crs).to_authority()
    except ProjError as error:
        raise CityError(f"{path}: a CRS that pyproj understands expected, found {crs!r}") from error
    if found is None:
        raise CityError(f"{path}: a CRS with a name such as EPSG:32635 expected, found {crs!r}")
    return f"https://www.opengis.net/def/crs/{found[0]}/0/{found[1]}"


def _extent(city: City) -> tuple[float, ...] | None:
    """The extent of all that is written; None where that is nothing."""
    corners = [np.empty((0, 3))]
    solids = [prism for one in city.objects if one.mesh is None for prism in one.prisms]
    if solids:
        flat = shapely.bounds([prism.footprint for prism in solids])
        heights = np.array([(prism.bottom, prism.top) for prism in solids])
        corners += [np.column_stack([flat[:, 2 * k : 2 * k + 2], heights[:, k]]) for k in (0, 1)]
    corners += [one.mesh.vertices[one.mesh.triangles.reshape(-1)] for one in city.objects if one.mesh is not None]
    lines = shapely.get_coordinates([edge["geometry"] for _, _, edge in city.streets.edges(data=True)])
    corners.append(np.column_stack([lines, city.ground_at(lines)]))
    if city.terrain is not None:
        x0, y0, x1, y1 = city.terrain.bounds
        heights = city.terrain.heights
        corners.append(np.array([(x0, y0, heights.min()), (x1, y1, heights.max())]))
    points = np.concatenate(corners)
    if not len(points):
        return None
    ends = millimetres(np.concatenate([points.min(axis=0), points.max(axis=0)])) * SCALE + np.tile(city.origin, 2)
    return tuple(round(end, 3) for end in ends.tolist())


# -------------------------------------------------------------------------------------------------------- textures


def _texture_files(path: Path, textures: Sequence[Texture]) -> list[str]:
    """Where each texture goes, relative to the file's folder: by its name, as far as file systems allow, and one each."""
    files: list[str] = []
    taken: set[str] = set()
    for texture in textures:
        stem = re.sub(r"[^A-Za-z0-9._-]+", "_", re.sub(r"\.(png|jpe?g)$", "", texture.name, flags=re.I)).strip(".")
        name, count = stem or "texture", 1
        while name.lower() in taken:
            count += 1
            name = f"{stem or 'texture'}-{count}"
        taken.add(name.lower())
        files.append(f"{path.stem}.appearances/{name}.png")
    return files


def _write_textures(path: Path, textures: Sequence[Texture], files: Sequence[str], used: Iterable[int]) -> None:
    for number in used:
        write_whole(path.parent / files[number], png_bytes(textures[number].image), error=CityError)
