"""What is walked through: a city's geometry, its cells, and, where a dataset was opened, what each cell's impostor consists of.

open_scene      a dataset: all comes from the manifest and the files that cells share; the cells' own files are for
                ``viewer.cells.cell_cache``
scene_of_city   a city as it was read: the same geometry and the same viewing cells, and no impostors
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mmi.appearance.city_mesh import CityMesh, object_boxes
from mmi.building.cell_choice import choose_cells
from mmi.cells.viewing_cells import ViewingCell
from mmi.cells.whereabouts import Whereabouts
from mmi.city.long_objects import cut_objects
from mmi.city.model import City
from mmi.city.terrain import Terrain
from mmi.dataset.city_files import city_meshes, read_city_mesh
from mmi.dataset.reading import Dataset
from mmi.foundation.camera import Camera, View
from mmi.foundation.errors import DatasetError, ParameterError
from mmi.movers.movers import NOTHING_MOVES, Movers
from mmi.planning.parameters import BuildParameters
from viewer.plan import Ground
from viewer.scene.frustum import boxes_within_view, window_corners, within_view
from viewer.scene.skyline import Skyline, skyline_of
from viewer.scene.workshop import Workshop

__all__ = ["CellContents", "WalkScene", "open_scene", "scene_of_city"]

_USUAL = BuildParameters()
"""What decides viewing cells, and which objects are cut, where nobody says otherwise."""
_FAR_GROUND_PX = 2.0
"""This many pixels below the horizon the ground has no details, because it is too far away for them."""


@dataclass(frozen=True, slots=True, eq=False)
class CellContents:
    """A cell and its impostor, as far as the manifest tells. Without a dataset all objects are near, and visible.

    ``near`` and ``visible`` are indices into the city's objects. ``layers`` are names sorted from the nearest to the
    farthest, ``hulls`` (n, 8, 3) what their meshes lie in.
    """

    cell: ViewingCell
    near: NDArray[np.int64]
    visible: NDArray[np.int64]
    layers: tuple[str, ...]
    hulls: NDArray[np.float64]

    def layers_in(self, view: View) -> tuple[str, ...]:
        """The layers that ``view`` may show, nearest first."""
        return tuple(self.layers[i] for i in np.flatnonzero(within_view(self.hulls, view)))


@dataclass(frozen=True, slots=True, eq=False)
class WalkScene:
    """What techniques know of a city. ``name`` stands for it in plans; ``objects`` maps ids to places in ``mesh``.

    ``source`` says for people where the city was read from, ``built`` is the dataset that was opened, None where there is none
    and so no impostors. ``camera`` is the display that pictures are drawn for: that of the dataset, or another one.
    ``boxes`` (n, 2, 3) are the lowest and the highest coordinates of the mesh's objects, NaN for one without triangles.
    ``movers`` are what moves in the city, in its frame; where there are any, ``skyline`` is what hides them. ``workshop`` keeps
    what techniques make once of the scene.
    """

    name: str
    source: str
    built: Dataset | None
    camera: Camera
    mesh: CityMesh
    ground: CityMesh
    terrain: Terrain | None
    ground_height: float
    tiles: NDArray[np.float64]
    boxes: NDArray[np.float64]
    whereabouts: Whereabouts
    objects: Mapping[str, int]
    movers: Movers = NOTHING_MOVES
    skyline: Skyline | None = None
    workshop: Workshop = field(default_factory=Workshop)

    @property
    def dataset(self) -> Dataset:
        """The dataset that was opened. Raises ParameterError where the scene is a city without one."""
        if self.built is None:
            raise ParameterError(
                f"{self.source}: a dataset expected, which build-impostors makes of it, found the city alone"
            )
        return self.built

    @property
    def parameters(self) -> BuildParameters:
        """What the dataset was built with. Raises ParameterError where there is none."""
        return self.dataset.manifest.parameters

    def cell(self, name: str) -> CellContents:
        """What the manifest says of a cell. Raises DatasetError where it is none of the dataset's.

        Without a dataset, raises ParameterError where it is none of the city's.
        """
        if self.built is None:
            return self._undivided(name)
        entry = self.dataset.cell(name)
        near = self._indices(entry.near)
        described = sorted(entry.pictures, key=lambda pair: (pair[1].depth[0], pair[1].name))
        hulls = [window_corners(entry.view(sector, one), *one.depth) for sector, one in described]
        return CellContents(
            cell=entry.viewing_cell,
            near=near,
            visible=np.union1d(near, self._indices(entry.far)),
            layers=tuple(one.name for _, one in described),
            hulls=np.array(hulls, dtype=np.float64).reshape(-1, 8, 3),
        )

    def ground_in(self, view: View) -> Ground:
        """The tiles of the ground that ``view`` may show.

        On flat ground, none beyond the distance at which all the rest of it is a line of two pixels below the horizon.
        """
        low, high = self.tiles[:, 0], self.tiles[:, 1]
        close = np.arange(len(low))
        if self.terrain is None:
            reach = max(self.above_ground(view.eye), 0.1) * view.focal / _FAR_GROUND_PX
            away = np.maximum(np.maximum(low - view.eye, view.eye - high), 0.0)
            close = np.flatnonzero(np.hypot(away[:, 0], away[:, 1]) <= reach)
        return Ground(tuple(close[boxes_within_view(self.tiles[close], view)].tolist()))

    def above_ground(self, eye: NDArray[np.float64]) -> float:
        """Metres from the ground up to ``eye`` (3,)."""
        return float(eye[2]) - (self.ground_height if self.terrain is None else float(self.terrain.at(eye)))

    def _undivided(self, name: str) -> CellContents:
        """A cell from which all objects are drawn, as they are."""
        found = next((cell for cell in self.whereabouts.cells if cell.id == name), None)
        if found is None:
            raise ParameterError(f"{self.source}: one of {len(self.whereabouts.cells)} cells expected, found {name!r}")
        everything = np.arange(len(self.mesh.triangle_counts), dtype=np.int64)
        return CellContents(found, everything, everything, (), np.empty((0, 8, 3)))

    def _indices(self, ids: Sequence[str]) -> NDArray[np.int64]:
        try:
            return np.array([self.objects[one] for one in ids], dtype=np.int64)
        except KeyError as error:
            raise DatasetError(
                f"{self.dataset.path / 'manifest.json'}: objects of {self.dataset.path / 'city.json'} expected, "
                f"found {error}"
            ) from error


def open_scene(
    dataset: Dataset,
    *,
    name: str,
    like: WalkScene | None = None,
    camera: Camera | None = None,
    movers: Movers = NOTHING_MOVES,
    city: City | None = None,
) -> WalkScene:
    """Open a dataset for walking; ``like`` is one of the same city whose geometry is there already, and whose movers.

    ``camera`` is the display of the pictures to draw; None: that of ``like``, or the one that the dataset was built for.
    ``movers`` are put into the frame of the city, which is ``city`` where somebody has read that already. Raises DatasetError
    where the dataset has no cells, a file is missing or damaged, or ``like`` shows another city; ParameterError
    where the movers are in another coordinate system.
    """
    manifest = dataset.manifest
    if not manifest.cells:
        raise DatasetError(f"{dataset.path}: a dataset with cells expected, found none; build some")
    if camera is None:
        camera = manifest.parameters.camera if like is None else like.camera
    if like is not None and like.dataset.manifest.city.files != manifest.city.files:
        raise DatasetError(f"{dataset.path}: the city of {like.dataset.path} expected, found another")
    mesh, ground = (like.mesh, like.ground) if like is not None else read_city_mesh(dataset)
    cells = tuple(entry.viewing_cell for entry in manifest.cells)
    if like is None:
        city = dataset.city() if city is None else city
        terrain, objects = city.terrain, city.index()
        movers = movers.in_frame(crs=manifest.city.crs, origin=manifest.city.origin)
        skyline = skyline_of(city) if movers.ids else None
    else:
        terrain, objects, movers, skyline = like.terrain, dict(like.objects), like.movers, like.skyline
    return WalkScene(
        name=name,
        source=manifest.city.source,
        built=dataset,
        camera=camera,
        mesh=mesh,
        ground=ground,
        terrain=terrain,
        ground_height=manifest.city.ground,
        tiles=object_boxes(ground) if like is None else like.tiles,
        boxes=object_boxes(mesh) if like is None else like.boxes,
        whereabouts=Whereabouts(cells, {entry.id: entry.neighbours for entry in manifest.cells}),
        objects=objects,
        movers=movers,
        skyline=skyline,
    )


def scene_of_city(
    city: City,
    *,
    name: str,
    camera: Camera,
    longest_object: float | None = _USUAL.longest_object,
    movers: Movers = NOTHING_MOVES,
) -> WalkScene:
    """A city for walking as it was read, without impostors: for techniques that need no dataset.

    Geometry and viewing cells are those of the dataset that would be built of it for the same ``longest_object`` (metres; None:
    no object is cut), so that pictures of both are equal. ``movers`` are put into the city's frame. Raises ParameterError where
    no street has room for a cell, or the movers are in another coordinate system.
    """
    graph = choose_cells(city, _USUAL).graph
    city = cut_objects(city, longest_object)
    mesh, ground = city_meshes(city)
    cells = tuple(graph.nodes[one]["cell"] for one in sorted(graph))
    movers = movers.in_frame(crs=city.crs, origin=city.origin)
    return WalkScene(
        name=name,
        source=city.source,
        built=None,
        camera=camera,
        mesh=mesh,
        ground=ground,
        terrain=city.terrain,
        ground_height=city.ground,
        tiles=object_boxes(ground),
        boxes=object_boxes(mesh),
        whereabouts=Whereabouts(cells, {one: tuple(sorted(graph.neighbors(one))) for one in graph}),
        objects=city.index(),
        movers=movers,
        skyline=skyline_of(city) if movers.ids else None,
    )
