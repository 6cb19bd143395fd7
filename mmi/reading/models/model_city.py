"""3D city models in: from a :class:`mmi.reading.raw_layers.ModelLayer` to objects, streets and ground in one local frame,
step by step.

Models differ from footprints in what they leave open. They may have no CRS: then their units are metres of a frame of their
own, ``"local"``. They may have no streets: then viewing cells follow the skeleton of the open space between the buildings.
They bring a ground of their own or leave it to be told from where the buildings stand.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import chain
from pathlib import Path

import numpy as np
import shapely
from numpy.typing import NDArray
from pyproj import CRS
from shapely.geometry import Polygon

from mmi import limits
from mmi.city.model import City, TriangleMesh
from mmi.city.terrain import Terrain
from mmi.foundation.errors import CityError, ParameterError
from mmi.foundation.whole_files import check_size
from mmi.reading.antimeridian import joined_model, joined_streets
from mmi.reading.city_models.citygml import is_citygml, read_citygml
from mmi.reading.city_models.cityjson import is_cityjson, read_cityjson
from mmi.reading.coordinates import (
    Box,
    LocalFrame,
    agree_on_crs,
    box_to_local_frame,
    choose_local_frame,
    coordinate_bounds,
    lonlat_bounds,
    meets_box,
    points_to_local_frame,
    within_clip,
)
from mmi.reading.ground.ground import ground_of_buildings, ground_of_file, ground_of_model, settled
from mmi.reading.ground.open_space import open_space_layer
from mmi.reading.ground.rooms import CLEAR, floor_below, opened
from mmi.reading.maps.heights import FOOT
from mmi.reading.maps.streets import OUTDOORS, graph_from_lines, moved_lines
from mmi.reading.models.enclosures import enclosing, note_open
from mmi.reading.models.mesh_files import is_mesh, read_meshes
from mmi.reading.models.objects_from_meshes import objects_from_models
from mmi.reading.raw_layers import BuildingLayer, ModelLayer, RawBuilding, StreetLayer
from mmi.reading.report import Ledger
from mmi.reading.steps import Progress, step

__all__ = ["city_of_model", "heights_in_metres", "is_model", "read_model"]

_LOCAL = LocalFrame("local", (0.0, 0.0, 0.0), "")


def is_model(path: Path) -> bool:
    """Whether the file is a 3D model: CityJSON, CityGML, glTF, OBJ or another mesh."""
    return path.is_file() and (is_mesh(path) or is_citygml(path) or is_cityjson(path))


def read_model(path: Path, ledger: Ledger, *, lod: str | None, up: str, crs: CRS | None = None) -> ModelLayer:
    """The model in ``path``; see the readers for ``lod``, ``up`` and ``crs``."""
    check_size(path, limits.CITY_BYTES, CityError)
    if is_mesh(path):
        if lod is not None:
            raise ParameterError(f"--lod: {path} has no levels of detail; found {lod!r}")
        layer = read_meshes(path, ledger, up=up)
    else:
        read = read_citygml if is_citygml(path) else read_cityjson
        layer = read(path, ledger, lod=lod, crs=crs)
    if not layer.items:
        expected = "expected objects of type Building, or named nodes with triangles"
        raise CityError(f"{path}: no buildings; {expected}{ledger.why_left_out()}")
    return layer


def heights_in_metres(layer: ModelLayer, unit: str | None, override: CRS | None, ledger: Ledger) -> ModelLayer:
    """The layer with its heights in metres. ``unit`` is what they are in, ``m`` or ``ft``; None is taken for metres.

    A coordinate system in feet (``override`` goes before the layer's) says nothing of heights, but makes feet likely: then
    None is warned of.
    """
    if unit == "ft":

        def lowered(mesh: TriangleMesh) -> TriangleMesh:
            return replace(mesh, vertices=mesh.vertices * (1.0, 1.0, FOOT))

        ledger.note("noted", "heights of the model in feet", count=len(layer.items))
        items = tuple(replace(item, mesh=lowered(item.mesh)) for item in layer.items)
        return replace(layer, items=items, terrain=None if layer.terrain is None else lowered(layer.terrain))
    crs = override or layer.crs
    units = set() if crs is None else {axis.unit_name for axis in crs.axis_info}
    if unit is None and any("foot" in name for name in units):
        ledger.warn(f"{layer.file}: heights are taken as metres, though its plan is in feet: --height-unit ft, or m")
    return layer


def city_of_model(
    layer: ModelLayer,
    streets: StreetLayer | None,
    ledger: Ledger,
    *,
    source: str,
    network: str,
    override: CRS | None,
    clip: Box | None,
    terrain: Path | None,
    terrain_unit: str | None = None,
    progress: Progress | None = None,
) -> City:
    """A city of the model's buildings. ``streets`` of another file replace its own; ``progress`` is told of each step.

    Raises:
        CityError: nothing usable; the CRS of the model and of its streets or ground do not agree.
        ParameterError: an option that needs what the model has not.
    """
    layer = joined_model(layer)
    own = StreetLayer(layer.file, layer.streets, layer.crs, False) if layer.streets else None
    lines = streets or own
    lines = None if lines is None else joined_streets(lines)
    building_crs, street_crs = _agreed(layer, lines, override)
    if clip is not None:
        layer = _clipped(layer, building_crs, clip, ledger)
    frame = _local_frame(layer, building_crs)
    if frame.why and building_crs is not None and not building_crs.is_geographic:
        ledger.warn(f"{layer.file}: {frame.why}")

    def move(points: NDArray[np.float64]) -> NDArray[np.float64]:
        return points_to_local_frame(points, building_crs, frame)

    objects, open_ids = objects_from_models(layer, move, ledger, progress=progress)
    floor: float | None = None
    if lines is None:
        with step(progress, "looking for paths through the open space"):
            lines = open_space_layer(layer.file, np.array([one.footprint for one in objects], dtype=object), ledger)
        network = "all"
        shapes = [list(item.lines) for item in lines.items]
    else:
        shapes = moved_lines(lines, street_crs, frame)
        if terrain is None and layer.terrain is None:
            floor = floor_below(objects, list(chain.from_iterable(shapes)))
    paths = list(chain.from_iterable(shapes))
    with step(progress, "setting the buildings on the ground"):
        bounds = coordinate_bounds([one.footprint for one in objects])
        ground: Terrain | float
        if floor is not None:
            ledger.note("noted", "indoors: paths over a floor of the model", count=len(paths))
            ground = floor
        elif terrain is not None:
            ground = ground_of_file(terrain, frame, bounds, ledger, unit=terrain_unit)
        elif layer.terrain is not None:
            ground = ground_of_model(layer.terrain, move, bounds, ledger)
        else:
            ground = ground_of_buildings(objects, paths, bounds, ledger)
        # Indoors things lie on one another and hang from the ceiling.
        objects = settled(objects, ground, ledger) if floor is None else opened(objects, paths, floor)
    if floor is None:
        with step(progress, "looking for what open buildings hide"):
            objects = enclosing(objects, open_ids, ground, layer.textures, ledger)
    else:
        note_open(objects, open_ids, ledger)
    with step(progress, "joining the streets"):
        graph = graph_from_lines(
            lines,
            shapes,
            objects,
            ledger,
            network=network if floor is None else "all",
            ground=ground,
            window=None if clip is None else box_to_local_frame(clip, frame),
            clear=OUTDOORS if floor is None else CLEAR,
        )
    flat_ground = 0.0 if isinstance(ground, Terrain) else ground
    rising = ground if isinstance(ground, Terrain) else None
    return City(objects, graph, frame.crs, frame.origin, source, flat_ground, rising, layer.textures)


def _agreed(layer: ModelLayer, lines: StreetLayer | None, override: CRS | None) -> tuple[CRS | None, CRS | None]:
    """The CRS of buildings and streets; both None where units are metres of the model's own frame."""
    if lines is None:
        return override or layer.crs, None
    if layer.crs is None and override is None and (lines.crs is None or _no_degrees(lines)):
        return None, None
    outlines = tuple(RawBuilding(item.id, box, {}) for item, box in zip(layer.items, _boxes(layer), strict=True))
    return agree_on_crs(BuildingLayer(layer.file, outlines, layer.crs, False, "", ""), lines, override)


def _no_degrees(lines: StreetLayer) -> bool:
    """Whether coordinates cannot be the degrees that every GeoJSON file declares where it says nothing else."""
    bounds = coordinate_bounds([line for item in lines.items for line in item.lines])
    return lines.crs is not None and lines.crs.is_geographic and max(abs(one) for one in bounds) > 360.0


def _local_frame(layer: ModelLayer, crs: CRS | None) -> LocalFrame:
    points = np.concatenate([item.mesh.vertices[:, :2] for item in layer.items])
    (x0, y0), (x1, y1) = points.min(axis=0), points.max(axis=0)
    if crs is None:
        spread = float(max(x1 - x0, y1 - y0))
        if not spread <= limits.EXTENT:
            raise CityError(
                f"{layer.file}: the buildings spread over {spread / 1000:.0f} km: expected a city in metres"
            )
        middle = np.floor(np.array([x0 + x1, y0 + y1]) / 20.0) * 10.0
        return replace(_LOCAL, origin=(float(middle[0]), float(middle[1]), 0.0))
    bounds = (float(x0), float(y0), float(x1), float(y1))
    return choose_local_frame(layer.file, bounds, crs, lonlat_bounds(layer.file, bounds, crs))


def _boxes(layer: ModelLayer) -> list[Polygon]:
    """The bounding box of each building's mesh, seen from above."""
    return [shapely.box(*shapely.total_bounds(shapely.points(item.mesh.vertices[:, :2]))) for item in layer.items]


def _clipped(layer: ModelLayer, crs: CRS | None, clip: Box, ledger: Ledger) -> ModelLayer:
    """The layer with those buildings whose bounding boxes meet ``clip``; the others are counted."""
    if crs is None:
        raise ParameterError(f"--clip: a model with a coordinate system expected, found {layer.file} (--crs names one)")
    near = meets_box(_boxes(layer), crs, clip)
    return replace(layer, items=within_clip(layer.items, near, clip, ledger, file=layer.file, kind="building"))
