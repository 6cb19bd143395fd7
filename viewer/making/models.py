"""Models that images are placed for: a city as it was read, or the geometry of a dataset. They need no streets and no cells."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mmi.appearance.city_mesh import CityMesh, object_boxes
from mmi.cells.viewing_cells import ViewingCell
from mmi.cells.whereabouts import Whereabouts
from mmi.city.long_objects import cut_objects
from mmi.city.model import City
from mmi.dataset.city_files import city_meshes, read_city_mesh
from mmi.dataset.reading import open_dataset
from mmi.foundation.camera import Camera
from mmi.foundation.errors import ParameterError
from mmi.foundation.processes import give_memory_back
from mmi.foundation.progress import Progress, silent
from mmi.reading.read_city import CityReport, read_city
from mmi.reading.read_options import ReadOptions
from viewer.placed.folder import WORKING
from viewer.scene.scene import WalkScene

__all__ = ["Model", "SharedMeshes", "read_model", "shared_meshes"]


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """Triangles of the objects of ``city``, and of its ground; ``report`` is what reading has found, None for a dataset."""

    city: City
    mesh: CityMesh
    ground: CityMesh
    report: CityReport | None = None

    def scene(self, camera: Camera) -> WalkScene:
        """The model as it is walked through, with a single cell in its middle."""
        boxes = object_boxes(self.mesh)
        middle = np.nanmean(boxes, axis=(0, 1))
        cell = ViewingCell("0000-00", (middle[0] - 0.5, middle[1]), (middle[0] + 0.5, middle[1]), 0.5, (middle[2],) * 2)
        return WalkScene(
            name="multi-mesh",
            source=self.city.source,
            built=None,
            camera=camera,
            mesh=self.mesh,
            ground=self.ground,
            terrain=self.city.terrain,
            ground_height=self.city.ground,
            tiles=object_boxes(self.ground),
            boxes=boxes,
            whereabouts=Whereabouts((cell,), {}),
            objects=self.city.index(),
        )


def read_model(
    path: Path, reading: ReadOptions | None, *, longest_object: float | None, progress: Progress = silent
) -> Model:
    """The model at ``path``, a city that is read with the options ``reading``, or without them a dataset.

    Objects of a city longer than ``longest_object`` metres are cut, as they are where it is walked through; None cuts none.
    Raises CityError, DatasetError, and ParameterError where it has no triangles.
    """
    if reading is None:
        dataset = open_dataset(path)
        made = Model(dataset.city(), *read_city_mesh(dataset))
    else:
        city, report = read_city(path, reading, progress=progress)
        city = cut_objects(city, longest_object)
        made = Model(city, *city_meshes(city), report)
    if not len(made.mesh.triangles):
        raise ParameterError(f"{path}: a model with triangles expected, found none")
    give_memory_back()  # workers follow that need some
    return made


@dataclass(frozen=True, slots=True)
class SharedMeshes:
    """A folder with the arrays of a model's meshes, which several processes look into: reading a model may take minutes."""

    folder: Path

    def read(self) -> tuple[CityMesh, CityMesh]:
        """Objects and ground, whose arrays stay on the disk."""
        mesh, ground = (
            CityMesh(**{name: self._array(f"{which}-{name}") for name in _arrays()}) for which in ("objects", "ground")
        )
        return mesh, ground

    def _array(self, name: str) -> NDArray[Any]:
        found: NDArray[Any] = np.load(self.folder / f"{name}.npy", mmap_mode="r")
        return found


@contextmanager
def shared_meshes(model: Model, folder: Path) -> Iterator[SharedMeshes]:
    """The meshes of a model in a temporary folder within ``folder``, for the block."""
    with TemporaryDirectory(prefix=WORKING, dir=folder) as place:
        for which, mesh in (("objects", model.mesh), ("ground", model.ground)):
            for name in _arrays():
                np.save(Path(place) / f"{which}-{name}.npy", getattr(mesh, name))
        yield SharedMeshes(Path(place))


def _arrays() -> tuple[str, ...]:
    return tuple(one.name for one in fields(CityMesh) if one.init)
