"""Cities in: maps, GIS files and 3D models become a :class:`mmi.city.model.City`, with a report of what was done to them.

``read_city`` tells the way from file to city top to bottom: read (``osm``, ``footprints``), agree on a CRS and a local frame
(``coordinates``), mend and raise the buildings (``repair``, ``heights``, ``buildings``), set them on their ground
(``ground``), knit the streets (``streets``) or find paths (``open_space``), and account for everything (``report``). 3D
models (``cityjson``, ``citygml``, ``mesh_files``) have meshes instead of outlines, and a way of their own (``model_city``).
"""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
from pyproj import CRS

from mmi import limits
from mmi.city.model import PAINTED, PLAIN, City
from mmi.foundation.errors import CityError, ParameterError
from mmi.foundation.whole_files import check_size
from mmi.reading.antimeridian import joined_buildings, joined_streets
from mmi.reading.city_models.tiles import joined_tiles, tiles_of
from mmi.reading.city_models.zipped import unpacked_tiles
from mmi.reading.coordinates import (
    Box,
    agree_on_crs,
    box_to_local_frame,
    check_not_swapped,
    choose_local_frame,
    coordinate_bounds,
    lonlat_bounds,
    meets_box,
    parse_crs,
    to_local_frame,
    within_clip,
)
from mmi.reading.ground.ground import ground_of_file, raised
from mmi.reading.ground.open_space import open_space_layer
from mmi.reading.maps.buildings import merge_blocks, objects_from_outlines
from mmi.reading.maps.footprints import GDAL_SUFFIXES, read_footprints, read_street_lines
from mmi.reading.maps.osm import is_osm, read_osm
from mmi.reading.maps.streets import graph_from_lines, moved_lines
from mmi.reading.maps.sumo import is_sumo, read_sumo
from mmi.reading.models.model_city import city_of_model, heights_in_metres, is_model, read_model
from mmi.reading.names import UniqueNames, valid_text
from mmi.reading.raw_layers import BuildingLayer, StreetLayer
from mmi.reading.read_options import ReadOptions
from mmi.reading.report import CityReport, Ledger, Tally
from mmi.reading.steps import Progress, step

__all__ = ["CityReport", "Tally", "read_city"]

_GROUND = 0.0
_TOLD, _LOOKED_INTO = 6, 1000
"""Folders that a message names, and that are looked into for it."""


def read_city(
    path: Path, options: ReadOptions | None = None, *, progress: Progress | None = None
) -> tuple[City, CityReport]:
    """Read the buildings and streets of ``path`` into a local metric frame.

    Args:
        path: OpenStreetMap ``.osm`` or ``.osm.pbf``, a file that GDAL reads, a folder of those, or a 3D model: CityJSON
            (also a sequence), CityGML, a folder or zip of tiles of these two, glTF, OBJ, PLY, STL.
        options: further files, and what the reader shall not guess; None: ``ReadOptions()``.
        progress: is called with (done, of how many, what is done), from 0 to all, for one step after the other.

    Returns:
        The city and the account of everything that was read.

    Raises:
        CityError: the files do not hold a usable city; one line says what was found, where, and what to do.
        ParameterError: an option means nothing for what was found.
    """
    path, options = Path(path), ReadOptions() if options is None else options
    override = None if options.crs is None else parse_crs(options.crs)
    for file in (path, options.streets, options.terrain):
        if file is not None and not _exists(file):
            raise CityError(f"{file}: no such file or folder")
        if file is not None and not (file.is_file() or file.is_dir()):
            raise CityError(
                f"{file}: a file or folder expected, found a pipe or a device; save what comes from it in a file"
            )
        if file is not None:
            check_size(file, limits.CITY_BYTES, CityError)
    ledger = Ledger()
    try:
        file = _the_file(path)
        with unpacked_tiles(path) as unpacked:
            tiles = tiles_of(path) if path.is_dir() else unpacked
            if tiles or is_model(file):
                found = _read_model_city(path, tiles or [file], options, override, ledger, progress)
                city = _finished(found, options.facades, ledger)
                return city, _accounted(city, ledger)
        if options.lod is not None:
            raise ParameterError(f"--lod: a 3D model expected, found {path}")
        with step(progress, f"reading the buildings of {_printable(file.name)}"):
            buildings = _read_buildings(file, ledger, options)
        street_file = file if options.streets is None else _the_file(options.streets)
        with step(progress, f"reading the streets of {_printable(street_file.name)}"):
            lines = _read_streets(street_file, ledger, layer=options.streets_layer)
        if options.streets is not None or options.streets_layer is not None:
            lines = _required(lines, street_file, ledger)
    except OSError as error:
        raise CityError(f"{error.filename or path}: cannot be read: {error.strerror or error}") from error
    buildings, lines = joined_buildings(buildings), None if lines is None else joined_streets(lines)
    building_crs, street_crs = agree_on_crs(buildings, lines, override)
    check_not_swapped(buildings.file, [item.geometry for item in buildings.items], building_crs)
    if options.clip is not None:
        buildings = _clipped_buildings(buildings, building_crs, options.clip, ledger)
        lines = None if lines is None else _clipped_streets(lines, street_crs, options.clip, ledger)
    bounds = coordinate_bounds([item.geometry for item in buildings.items])
    frame = choose_local_frame(
        buildings.file, bounds, building_crs, lonlat_bounds(buildings.file, bounds, building_crs)
    )
    if frame.why and not building_crs.is_geographic:
        ledger.warn(f"{buildings.file}: {frame.why}")

    shapes = to_local_frame([item.geometry for item in buildings.items], building_crs, frame)
    with step(progress, "mending and raising the buildings"):
        solids = objects_from_outlines(buildings, shapes, ledger, ground=_GROUND)
    relief = None
    if options.terrain is not None:
        with step(progress, f"reading the ground of {options.terrain.name}"):
            within, unit = coordinate_bounds(list(shapes)), options.terrain_unit
            relief = ground_of_file(options.terrain, frame, within, ledger, unit=unit)
            solids = raised(solids, relief)
    ledger.note("kept", "buildings", count=len(solids))
    if options.objects == "blocks":
        solids = merge_blocks(solids, ledger)
        ledger.note("kept", "objects (blocks)", count=len(solids))

    network = options.network
    if lines is None:
        ledger.warn(f"{file}: {_no_streets(ledger)}; paths lead through the open space instead (--streets FILE)")
        with step(progress, "looking for paths through the open space"):
            footprints = np.array([one.footprint for one in solids], dtype=object)
            lines, network = open_space_layer(buildings.file, footprints, ledger), "all"
        moved = [list(item.lines) for item in lines.items]
    else:
        moved = moved_lines(lines, street_crs, frame)
    with step(progress, "joining the streets"):
        graph = graph_from_lines(
            lines,
            moved,
            solids,
            ledger,
            network=network,
            ground=_GROUND if relief is None else relief,
            window=None if options.clip is None else box_to_local_frame(options.clip, frame),
        )
    city = City(solids, graph, frame.crs, frame.origin, _printable(path.name), _GROUND, relief)
    city = _finished(city, options.facades, ledger)
    return city, _accounted(city, ledger)


def _read_model_city(
    path: Path, files: list[Path], options: ReadOptions, override: CRS | None, ledger: Ledger, progress: Progress | None
) -> City:
    """The city of a 3D model: ``files`` are ``path``, the only one in that folder, or all of its tiles (of that zip)."""
    _refuse_columns(path, "a 3D model", options)
    if options.objects == "blocks":
        raise ParameterError(f"--objects: buildings expected, as {path} is a 3D model, found 'blocks'")
    layers = []
    for file in files:
        with step(progress, f"reading the model {_printable(file.name)}"):
            try:
                layers.append(read_model(file, ledger, lod=options.lod, up=options.up, crs=override))
            except CityError as error:
                if len(files) == 1 or (file == files[-1] and not layers):
                    raise
                ledger.note("left out", "tile: it cannot be used", _printable(file.name))
                ledger.warn(str(error).replace(str(file), _printable(file.name)))
    layer = layers[0] if len(files) == 1 else joined_tiles(str(path), layers, ledger)
    if path.is_file():  # the file itself, or what was unpacked from it
        layer = replace(layer, file=str(path))
    ledger.note("read", "tiles", count=len(layers) if len(files) > 1 else 0)
    layer = heights_in_metres(layer, options.height_unit, override, ledger)
    lines: StreetLayer | None = None
    if options.streets is not None:
        own_metres = layer.crs is None and override is None
        street_file = _the_file(options.streets)
        with step(progress, f"reading the streets of {_printable(street_file.name)}"):
            found = _read_streets(street_file, ledger, layer=options.streets_layer, local=own_metres)
            lines = _required(found, street_file, ledger)
    return city_of_model(
        layer,
        lines,
        ledger,
        source=_printable(path.name),
        network=options.network,
        override=override,
        clip=options.clip,
        terrain=options.terrain,
        terrain_unit=options.terrain_unit,
        progress=progress,
    )


def _exists(file: Path) -> bool:
    """Whether there is such a file or folder; a name that no file can have is none."""
    try:
        return file.exists()
    except (OSError, ValueError):
        return False


def _printable(name: str) -> str:
    """A file's name, which Linux takes to be bytes, with those that are no UTF-8 written out."""
    return name.encode("utf-8", "surrogateescape").decode("utf-8", "backslashreplace")


def _finished(city: City, facades: str, ledger: Ledger) -> City:
    """The city with ids and names that can be written to files, wherever they were read from, and its ``facades``."""
    names, objects = UniqueNames(), []
    for one in city.objects:
        id_ = names.free(valid_text(one.id))
        names.take(id_)
        ledger.note("repaired", "id that is no valid text written out", id_, count=int(id_ != one.id))
        objects.append(one if id_ == one.id else replace(one, id=id_))
    for *_, edge in city.streets.edges(data=True):
        edge["name"] = valid_text(edge["name"])
    textures = tuple(replace(one, name=valid_text(one.name)) for one in city.textures)
    return replace(city, objects=tuple(objects), textures=textures, facades=facades)


def _accounted(city: City, ledger: Ledger) -> CityReport:
    """The report, with what the city consists of."""
    metres = sum(edge["geometry"].length for _, _, edge in city.streets.edges(data=True))
    ledger.note("kept", "prisms", count=sum(len(one.prisms) for one in city.objects))
    triangles = sum(len(one.mesh.triangles) for one in city.objects if one.mesh is not None)
    if triangles:
        ledger.note("kept", "buildings", count=len(city.objects))
        ledger.note("kept", "triangles", count=triangles)
    if city.textures:
        ledger.note("kept", "pictures", count=len(city.textures))
    _warn_of_lost_pictures(city, ledger)
    ledger.note("kept", "street edges between junctions", count=city.streets.number_of_edges(), metres=metres)
    return ledger.report(source=city.source, crs=city.crs, origin=city.origin)


def _warn_of_lost_pictures(city: City, ledger: Ledger) -> None:
    """Where pictures are left out: what share of the buildings' faces shows painted facades or plain colours instead."""
    lost = ledger.count_of_kind("left out", "picture")
    looks = [one.mesh.textures for one in city.objects if one.mesh is not None]
    if not lost or not looks:
        return
    faces = np.concatenate(looks)
    painted, plain = np.count_nonzero(faces == PAINTED), np.count_nonzero(faces == PLAIN)
    facades = "painted with facades" if city.facades == "painted" else "plain, as they have no looks of their own"
    instead = " and ".join(
        f"{number} are {what}" for number, what in ((painted, facades), (plain, "of a plain colour")) if number
    )
    if instead:
        share = 100.0 * (painted + plain) / len(faces)
        what = "1 picture" if lost == 1 else f"{lost} pictures"
        ledger.warn(
            f"{what} could not be read, and {share:.0f} % of {len(faces)} triangles of the buildings have no picture: {instead}"
        )


def _refuse_columns(path: Path, what: str, options: ReadOptions) -> None:
    """Options of layers and columns mean nothing where there are none."""
    for option, value in options.columns().items():
        if value is not None:
            raise ParameterError(f"{option}: {path} is {what}, which has neither layers nor columns; found {value!r}")


def _the_file(path: Path) -> Path:
    """``path``, or the one OpenStreetMap file or 3D model in a folder that holds nothing else to read."""
    if not path.is_dir():
        return path
    inside = sorted(one for one in path.iterdir() if one.is_file())
    extracts = [one for one in inside if one.name.lower().endswith((".osm", ".pbf"))]
    alone = len(extracts) == 1 and not any(one.suffix.lower() in GDAL_SUFFIXES for one in inside)
    if alone:
        return extracts[0]
    models = [one for one in inside if is_model(one)]
    if not models and not any(_has_map(one) for one in inside):
        below = _folders_below(path)
        if below:
            raise CityError(
                f"{path}: a folder; expected one file of a city, or a folder that holds its files; these folders in it do: "
                f"{', '.join(map(_printable, below))}"
            )
    return models[0] if len(models) == 1 else path


def _has_map(file: Path) -> bool:
    """Whether a file is called as maps are."""
    return file.name.lower().endswith((".osm", ".pbf", *GDAL_SUFFIXES))


def _folders_below(folder: Path) -> list[str]:
    """Up to ``_TOLD`` folders at any depth, links aside, in which there are maps or models, in the order of their names."""
    found = []
    for number, (place, folders, files) in enumerate(os.walk(folder)):
        folders.sort()
        if any(_has_map(Path(place, one)) or is_model(Path(place, one)) for one in sorted(files)):
            found.append(str(Path(place).relative_to(folder)))
        if len(found) == _TOLD or number == _LOOKED_INTO:
            break
    return found


def _read_buildings(file: Path, ledger: Ledger, options: ReadOptions) -> BuildingLayer:
    """The buildings of ``file``, at least one."""
    if file.is_file() and is_osm(file):
        _refuse_columns(file, "OpenStreetMap", options)
        if options.height_unit is not None:
            raise ParameterError(
                f"--height-unit: {file} is OpenStreetMap, whose heights are metres or name their unit; found "
                f"{options.height_unit!r}"
            )
        found, _ = read_osm(file, ledger, buildings=True, streets=False)
    else:
        found = read_footprints(
            file,
            ledger,
            layer=options.buildings_layer,
            height_column=options.height_column,
            height_unit=options.height_unit,
            levels_column=options.levels_column,
            id_column=options.id_column,
        )
    if not found.items:
        why = ledger.why_left_out("building")
        raise CityError(f"{file}: no buildings; expected outlines tagged building, or polygons{why}")
    return found


def _read_streets(file: Path, ledger: Ledger, *, layer: str | None, local: bool = False) -> StreetLayer | None:
    """The streets of ``file``; None where there are none. ``local``: a SUMO network keeps its own metres."""
    found: StreetLayer | None
    if file.is_file() and is_osm(file):
        if layer is not None:
            raise ParameterError(f"--streets-layer: {file} is OpenStreetMap, which has no layers; found {layer!r}")
        _, found = read_osm(file, ledger, buildings=False, streets=True)
    elif file.is_file() and is_sumo(file):
        if layer is not None:
            raise ParameterError(f"--streets-layer: {file} is a SUMO network, which has no layers; found {layer!r}")
        found = read_sumo(file, ledger, local=local)
    else:
        found = read_street_lines(file, ledger, layer=layer)
    return found if found is not None and found.items else None


def _required(streets: StreetLayer | None, file: Path, ledger: Ledger) -> StreetLayer:
    """The streets of a ``file`` or layer that somebody named: there have to be some."""
    if streets is None:
        raise CityError(f"{file}: {_no_streets(ledger)}; expected streets, as this is where they are said to be")
    return streets


def _no_streets(ledger: Ledger) -> str:
    why = ledger.why_left_out("street")
    return f"no streets: {'no usable line in it' if why else 'no line layer or highways in it'}{why}"


def _clipped_buildings(layer: BuildingLayer, crs: CRS, clip: Box, ledger: Ledger) -> BuildingLayer:
    """Only what meets the box by its own bounding box; the rest is counted."""
    near = meets_box([item.geometry for item in layer.items], crs, clip)
    return replace(layer, items=within_clip(layer.items, near, clip, ledger, file=layer.file, kind="building"))


def _clipped_streets(layer: StreetLayer, crs: CRS, clip: Box, ledger: Ledger) -> StreetLayer:
    """Likewise."""
    near = np.array([meets_box(item.lines, crs, clip).any() for item in layer.items])
    return replace(layer, items=within_clip(layer.items, near, clip, ledger, file=layer.file, kind="street"))
