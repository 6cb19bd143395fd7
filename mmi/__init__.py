"""Multi-mesh impostors: a city and its streets become layers of textured depth meshes with a bounded error, on disk.

Read a city (:func:`read_city`), build a dataset of it (:func:`build_dataset`), open it (:func:`open_dataset`), read a cell's
layers (:func:`read_impostor`), plot what was done (:func:`inspect_dataset`). The packages follow the paper, from the ground up:
foundation, city, reading, appearance, cells, movers, walks, gltf, writing, visibility, parallax, validity, rays, planning,
capture, meshing, dataset, building, inspection, programs.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING

from mmi.foundation.lazy_names import lazy_names

if TYPE_CHECKING:
    from mmi.building.cell_choice import CellChoice, choose_cells
    from mmi.building.dataset import BuildSummary, build_dataset
    from mmi.capture.layer_values import DepthTexture, GridMesh, Impostor, Layer, LayerMesh, LayerPicture, Promise
    from mmi.cells.viewing_cells import ViewingCell, viewing_cells
    from mmi.city.model import City, CityObject, Prism, Texture, TriangleMesh
    from mmi.city.terrain import Terrain
    from mmi.dataset.cell_files import read_depths, read_impostor, read_meshes, read_pictures
    from mmi.dataset.city_files import read_city_mesh
    from mmi.dataset.manifest import CellEntry, CityEntry, FileEntry, LayerEntry, Manifest
    from mmi.dataset.reading import Dataset, open_dataset
    from mmi.foundation.camera import Camera, View, level_view
    from mmi.foundation.errors import CaptureError, CityError, DatasetError, MmiError, ParameterError
    from mmi.foundation.plug_ins import PlugIn, plug_in
    from mmi.foundation.progress import Progress, ProgressLog
    from mmi.inspection.inspect import inspect_dataset, typical_cell
    from mmi.movers.movers import Movers
    from mmi.movers.movers_file import read_movers, write_movers
    from mmi.planning.parameters import BuildParameters
    from mmi.planning.plan import CellPlan, PreparedCity, plan_cell, prepare_city
    from mmi.planning.segmentation import NearSettings
    from mmi.planning.weighing import FarField
    from mmi.reading.read_city import CityReport, read_city
    from mmi.reading.read_options import ReadOptions
    from mmi.writing.cityjson_writer import write_cityjson
    from mmi.writing.gltf_writer import write_glb

__all__ = [
    "BuildParameters",
    "BuildSummary",
    "Camera",
    "CaptureError",
    "CellChoice",
    "CellEntry",
    "CellPlan",
    "City",
    "CityEntry",
    "CityError",
    "CityObject",
    "CityReport",
    "Dataset",
    "DatasetError",
    "DepthTexture",
    "FarField",
    "FileEntry",
    "GridMesh",
    "Impostor",
    "Layer",
    "LayerEntry",
    "LayerMesh",
    "LayerPicture",
    "Manifest",
    "MmiError",
    "Movers",
    "NearSettings",
    "ParameterError",
    "PlugIn",
    "PreparedCity",
    "Prism",
    "Progress",
    "ProgressLog",
    "Promise",
    "ReadOptions",
    "Terrain",
    "Texture",
    "TriangleMesh",
    "View",
    "ViewingCell",
    "build_dataset",
    "choose_cells",
    "inspect_dataset",
    "level_view",
    "open_dataset",
    "plan_cell",
    "plug_in",
    "prepare_city",
    "read_city",
    "read_city_mesh",
    "read_depths",
    "read_impostor",
    "read_meshes",
    "read_movers",
    "read_pictures",
    "typical_cell",
    "viewing_cells",
    "write_cityjson",
    "write_glb",
    "write_movers",
]

_HOMES = MappingProxyType(
    {
        "mmi.planning.segmentation": ("NearSettings",),
        "mmi.planning.weighing": ("FarField",),
        "mmi.foundation.progress": ("Progress", "ProgressLog"),
        "mmi.foundation.plug_ins": ("PlugIn", "plug_in"),
        "mmi.building.cell_choice": ("CellChoice", "choose_cells"),
        "mmi.building.dataset": ("BuildSummary", "build_dataset"),
        "mmi.capture.layer_values": (
            "DepthTexture",
            "GridMesh",
            "Impostor",
            "Layer",
            "LayerMesh",
            "LayerPicture",
            "Promise",
        ),
        "mmi.cells.viewing_cells": ("ViewingCell", "viewing_cells"),
        "mmi.city.model": ("City", "CityObject", "Prism", "Texture", "TriangleMesh"),
        "mmi.city.terrain": ("Terrain",),
        "mmi.dataset.cell_files": ("read_depths", "read_impostor", "read_meshes", "read_pictures"),
        "mmi.dataset.city_files": ("read_city_mesh",),
        "mmi.dataset.manifest": ("CellEntry", "CityEntry", "FileEntry", "LayerEntry", "Manifest"),
        "mmi.dataset.reading": ("Dataset", "open_dataset"),
        "mmi.foundation.camera": ("Camera", "View", "level_view"),
        "mmi.foundation.errors": ("CaptureError", "CityError", "DatasetError", "MmiError", "ParameterError"),
        "mmi.inspection.inspect": ("inspect_dataset", "typical_cell"),
        "mmi.movers.movers": ("Movers",),
        "mmi.movers.movers_file": ("read_movers", "write_movers"),
        "mmi.planning.parameters": ("BuildParameters",),
        "mmi.planning.plan": ("CellPlan", "PreparedCity", "plan_cell", "prepare_city"),
        "mmi.reading.read_city": ("CityReport", "read_city"),
        "mmi.reading.read_options": ("ReadOptions",),
        "mmi.writing.cityjson_writer": ("write_cityjson",),
        "mmi.writing.gltf_writer": ("write_glb",),
    }
)

__getattr__ = lazy_names("mmi", _HOMES)


def __dir__() -> list[str]:
    return __all__
