"""3D models without a city's structure: glTF, OBJ, PLY, OFF and STL become buildings, ground and streets.

A node or group with a name is a building. A file that is one mesh, or whose nodes each span the whole city (one for each
material), is taken apart by ``mmi.reading.models.triangle_soup``. Nothing in a file is ever evaluated, and nothing outside
its folder read.
"""

from __future__ import annotations

import io
import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh

from mmi.city.model import TriangleMesh
from mmi.foundation.errors import CityError, ParameterError
from mmi.reading.models.gltf_reader import read_gltf
from mmi.reading.models.obj import read_obj
from mmi.reading.models.polygon_files import read_polygon_file
from mmi.reading.models.raw_meshes import joined_meshes, placed_corners, y_up_to_z_up
from mmi.reading.models.triangle_soup import split_into_objects
from mmi.reading.raw_layers import ModelLayer, RawModel, with_unique_ids
from mmi.reading.report import Ledger

__all__ = ["MESH_SUFFIXES", "is_mesh", "read_meshes", "up_axis"]

_GLTF = (".glb", ".gltf")
_POLYGONS = (".ply", ".off")
_BY_TRIMESH = (".stl",)
_TO_CONVERT = (".dae", ".3ds", ".fbx", ".blend", ".skp", ".max", ".usd", ".usdz", ".usda", ".x3d", ".wrl", ".dxf")
MESH_SUFFIXES = (*_GLTF, ".obj", *_POLYGONS, *_BY_TRIMESH)
"""Endings of files that ``read_meshes`` reads."""
_GROUND_NAMES = frozenset({"terrain", "ground", "relief", "dem", "tin"})
_OVERLAP = 1.5
"""Where the areas of the nodes' boxes, seen from above, add up to more than this times the area of the box of all, the nodes
lie over one another: they are not one building each."""


def is_mesh(path: Path) -> bool:
    """True for 3D models by name or first bytes, also for kinds that ``read_meshes`` can only refuse with advice."""
    if path.suffix.lower() in (*MESH_SUFFIXES, *_TO_CONVERT):
        return True
    if not path.is_file():
        return False
    with path.open("rb") as file:
        head = file.read(8)
    return head.startswith((b"glTF", b"ply\n", b"ply\r"))


def read_meshes(path: Path, ledger: Ledger, *, up: str = "auto") -> ModelLayer:
    """Buildings, ground and streets of a 3D model, Z up, in the file's units; ids are the names of nodes or groups.

    ``up`` is the axis that points up in a file that does not say: ``y``, ``z``, or ``auto`` (``up_axis``); glTF says.

    Raises:
        CityError: the file is damaged, empty, or of a kind that is not read (the message says how to convert it).
        ParameterError: ``up`` means nothing.
    """
    if up not in ("auto", "y", "z"):
        raise ParameterError(f"the axis that points up is auto, y or z, found {up!r}")
    suffix = path.suffix.lower()
    with path.open("rb") as file:
        head = file.read(8)
    if suffix in _GLTF or head.startswith(b"glTF"):
        layer = read_gltf(path, ledger)
    else:
        if suffix in _TO_CONVERT:
            raise CityError(
                f"{path}: {suffix} is not read; expected {', '.join(MESH_SUFFIXES)}: convert it, for instance with "
                f"`assimp export {path.name} {path.stem}.glb`, or open it in Blender and export glTF"
            )
        if suffix == ".obj":
            layer = read_obj(path, ledger)
        elif suffix in _BY_TRIMESH:
            layer = _read_by_trimesh(path, ledger)
        else:
            layer = read_polygon_file(path, ledger)
        axis = up_axis(joined_meshes([item.mesh for item in layer.items])) if up == "auto" else up
        if axis == "y":
            ledger.note("noted", "axis that points up: y" + (" (guessed)" if up == "auto" else ""))
            layer = replace(layer, items=tuple(RawModel(one.id, y_up_to_z_up(one.mesh)) for one in layer.items))
    ledger.note("read", "meshes", count=len(layer.items))
    ledger.note("read", "triangles of meshes", count=sum(len(one.mesh.triangles) for one in layer.items))
    layer = _without_ground(layer)
    return (
        replace(layer, items=with_unique_ids(layer.items, ledger)) if _are_buildings(layer) else _split(layer, ledger)
    )


def up_axis(mesh: TriangleMesh) -> str:
    """``y`` or ``z``: which axis looks more like the heights of a city.

    Three shares in [0, 1] are summed for each. Walls and roofs: the area that is parallel or at right angles to the axis
    (along another axis of a city that is turned, it is little). Roofs: the area at right angles to it. Flatness: how small
    the extent along it is. A single tower that is as slim as it is high can deceive it.
    """
    corners = mesh.vertices[mesh.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normals, axis=1)
    along = np.abs(normals) / np.maximum(area, 1e-300)[:, None]
    size = np.ptp(corners.reshape(-1, 3), axis=0)
    total = max(float(area.sum()), 1e-300)

    def score(axis: int) -> float:
        flat, wall = along[:, axis] > 0.99, along[:, axis] < 0.02
        shares = (2.0 * area[flat].sum() + area[wall].sum()) / total
        return float(shares + 1.0 - size[axis] / max(size[1], size[2], 1e-300))

    return "y" if score(1) > score(2) else "z"


def _read_by_trimesh(path: Path, ledger: Ledger) -> ModelLayer:
    """STL: triangles without looks."""
    kind = path.suffix[1:]
    try:
        with _silence(), np.errstate(all="ignore"):
            # From memory, so that trimesh cannot open other files that this one refers to.
            loaded = trimesh.load(io.BytesIO(path.read_bytes()), file_type=kind.lower(), process=False)
            mesh = loaded.to_mesh() if isinstance(loaded, trimesh.Scene) else loaded
        if not isinstance(mesh, trimesh.Trimesh) or not len(mesh.faces):
            raise CityError(f"{path}: expected {kind.upper()} with triangles, found none")
        points, triangles = np.array(mesh.vertices, dtype=np.float64), np.array(mesh.faces, dtype=np.int64)
        if not 0 <= triangles.min() <= triangles.max() < len(points):
            raise ValueError(f"corners of {len(points)} points, found number {triangles.max()}")
    except CityError:
        raise
    except Exception as error:  # whatever trimesh stumbles over
        raise CityError(
            f"{path}: expected {kind.upper()}, complete and valid; found: {' '.join(str(error).split())[:200]}"
        ) from error
    points, keep = placed_corners(points, triangles, path.stem, ledger)
    if not keep.any():
        raise CityError(f"{path}: expected triangles with corners that are numbers, found none")
    one = TriangleMesh(points, triangles[keep].astype(np.int32))
    return ModelLayer(str(path), (RawModel(path.stem, one),), None)


@contextmanager
def _silence() -> Iterator[None]:
    """Keeps trimesh quiet: no warnings, and no tracebacks on stderr of what it tried in vain (unless its log is set up)."""
    logger, handler = logging.getLogger("trimesh"), logging.NullHandler()
    logger.addHandler(handler)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.removeHandler(handler)


def _without_ground(layer: ModelLayer) -> ModelLayer:
    """Nodes called ground, relief and the like are the terrain, where there are others beside them."""
    ground = [one.mesh for one in layer.items if one.id.lower() in _GROUND_NAMES]
    if layer.terrain is not None or not ground or len(ground) == len(layer.items):
        return layer
    items = tuple(one for one in layer.items if one.id.lower() not in _GROUND_NAMES)
    return replace(layer, items=items, terrain=joined_meshes(ground))


def _are_buildings(layer: ModelLayer) -> bool:
    """False for one mesh, and for meshes that lie over one another as those of different materials do."""
    if len(layer.items) < 2:
        return not layer.items
    low = np.array([one.mesh.vertices[:, :2].min(axis=0) for one in layer.items])
    high = np.array([one.mesh.vertices[:, :2].max(axis=0) for one in layer.items])
    return bool(np.prod(high - low, axis=1).sum() <= _OVERLAP * np.prod(high.max(axis=0) - low.min(axis=0)))


def _split(layer: ModelLayer, ledger: Ledger) -> ModelLayer:
    """The layer with its meshes taken apart, or as it was where that gives no more objects than it has nodes."""
    trial = Ledger()
    models, ground = split_into_objects(joined_meshes([one.mesh for one in layer.items]), trial)
    if len(layer.items) > 1 and len(models) <= len(layer.items):
        ledger.note("noted", "meshes that overlap, taken as they are", count=len(layer.items))
        return replace(layer, items=with_unique_ids(layer.items, ledger))
    if len(layer.items) > 1:
        ledger.note("noted", "meshes that overlap, joined before splitting", count=len(layer.items))
    ledger.absorb(trial)
    if layer.terrain is not None and ground is not None:
        ground = joined_meshes([layer.terrain, ground])
    if len(models) == 1 and len(layer.items) == 1:
        models = (RawModel(layer.items[0].id, models[0].mesh),)
    else:
        ledger.note("noted", "objects that one mesh was split into", count=len(models))
    return replace(layer, items=models, terrain=layer.terrain if ground is None else ground)
