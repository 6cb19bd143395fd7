"""What all sessions share: scenes, the renderer, the cells in memory, walls; and a session's own way to draw with them.

A renderer and a cache of cells belong to one thread, which makes a :class:`Stage` and ends it.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import cached_property
from types import TracebackType

import numpy as np
from numpy.typing import NDArray

from mmi.city.model import City
from mmi.foundation.camera import Camera, View
from mmi.foundation.errors import DatasetError
from mmi.foundation.processes import usable_cores
from mmi.walks.walk import Pose, Walk
from viewer.casting.rules import CastRules
from viewer.cells.cell_cache import CellCache
from viewer.cells.loaded_cell import LoadedCell, load_cell
from viewer.cells.scene_cache import foretold_bytes
from viewer.drawing.drawn_picture import DrawnPicture
from viewer.drawing.renderer import Renderer
from viewer.drawing.style import Style, layer_names
from viewer.placed.rules import PlacedRules
from viewer.plan import CellKey, CellLayers, Costs, Draw, Ground, Objects, Plan, Relief
from viewer.runtime.calibration import calibrated
from viewer.scene.scene import WalkScene
from viewer.scene.walls import Walls, walls_of
from viewer.techniques.catalogue import MAIN, TechniqueRules, find_technique
from viewer.walks.tour import tour
from viewer.window.motion import EYE_HEIGHT
from viewer.window.preparation import Preparation

__all__ = ["Painting", "Share", "Stage", "Streets", "window_camera"]

_AGAIN = 3.0
"""Seconds after which a cell that could not be read is tried again."""
_SPEED = 4.0
"""Metres a second of a tour."""


class Stage:
    """Scenes by name, the renderer that draws them, and their cells in memory. Use as a context manager, in one thread."""

    def __init__(
        self, scenes: Mapping[str, WalkScene], *, capacity: int, samples: int = 0, placed: PlacedRules | None = None
    ) -> None:
        self.scenes = scenes
        self.main = scenes[MAIN]
        self._capacity, self._samples = capacity, samples
        self._costs: Costs | None = None
        self._stack = ExitStack()
        mesh = self.main.mesh
        kept = mesh.positions.nbytes + mesh.uv.nbytes + mesh.colors.nbytes + mesh.triangles.nbytes
        self._triangle_bytes = kept / max(len(mesh.triangles), 1)
        self._sizes: dict[tuple[CellKey, bool], int] = {}
        self._bad: dict[CellKey, tuple[float, DatasetError]] = {}
        self._wants: dict[str, tuple[tuple[CellKey, ...], tuple[CellKey, ...]]] = {}
        self._preparing: dict[str, Preparation] = {}
        self.rules = TechniqueRules(rays=CastRules(workers=usable_cores()), placed=placed or PlacedRules())
        """What techniques are told."""

    def __enter__(self) -> Stage:
        main, camera = self.main, self.main.camera
        with ExitStack() as stack:
            # A renderer that can measure draws what is not measured as fast as another one.
            self.renderer = stack.enter_context(
                Renderer(
                    main.mesh,
                    main.ground,
                    size=(camera.width, camera.height),
                    measured=True,
                    samples=self._samples,
                    movers=main.movers,
                )
            )
            self.cells = stack.enter_context(CellCache(self._load, self._size, self.renderer, capacity=self._capacity))
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()

    @property
    def costs(self) -> Costs:
        """What drawing takes here, found out when somebody first wants to know: that takes most of a second."""
        if self._costs is None:
            camera = self.main.camera
            self.renderer.resize((camera.width, camera.height))
            self._costs = calibrated(self.renderer, self.main)
        return self._costs

    def prepared(self, name: str) -> bool:
        """Whether what the technique needs once is there. Who asks first has it made in the background.

        Raises what went wrong with that.
        """
        entry = find_technique(name)
        if entry.prepare is None:
            return True
        if name not in self._preparing:
            make, scene = entry.prepare, self.scenes[entry.scene]
            self._preparing[name] = Preparation(lambda: make(scene, self.rules))
        return self._preparing[name].over()

    def share(self, name: str) -> Share:
        """A share in the cells, which counts as wanting what it wanted last until it is forgotten."""
        return Share(self, name)

    def want(self, name: str, needed: Sequence[CellKey], ahead: Sequence[CellKey]) -> None:
        """What the share of this name wants from now on, before what all others want.

        Raises DatasetError where a cell that it needs could not be read a moment ago.
        """
        self._wants.pop(name, None)
        others = list(self._wants.values())
        for key in needed:
            if key in self._damaged():
                raise self._bad[key][1]
        mine = self._wants[name] = (tuple(needed), tuple(ahead))
        while True:
            damaged = self._damaged()
            wanted = [[key for one in (mine, *others) for key in one[i] if key not in damaged] for i in range(2)]
            try:
                return self.cells.want(*wanted)
            except DatasetError:
                self.cells.recover()
                if self._damaged() & {*needed}:
                    raise

    def require(self, cells: Sequence[CellKey], *, counted: bool) -> float:
        """Wait for cells; the seconds that took. Raises DatasetError where one of them cannot be read."""
        while True:
            try:
                return self.cells.require([key for key in cells if key not in self._damaged()], counted=counted)
            except DatasetError:
                self.cells.recover()
                if self._damaged() & {*cells}:
                    raise

    def spend(self, seconds: float) -> float:
        """Upload what has arrived, for about as long; the seconds that took. What cannot be read does not matter here."""
        try:
            return self.cells.spend(seconds)
        except DatasetError:
            self.cells.recover()
            return 0.0

    def forget(self, name: str) -> None:
        """A share wants nothing any more, and images that were captured for it go."""
        self._wants.pop(name, None)
        self.renderer.forget(name)

    def bytes_of(self, plan: Plan, share: str) -> int:
        """What a share's ``plan`` needs in memory: its objects' part of the city's meshes, its cells, and its images."""
        counts = self.main.mesh.triangle_counts
        drawn = sum(int(counts[draw.objects].sum()) for draw in plan.draws if isinstance(draw, Objects))
        return (
            round(drawn * self._triangle_bytes)
            + sum(map(self._cell_bytes, plan.cells))
            + self.renderer.image_bytes(share)
        )

    def _load(self, key: CellKey, rest: Callable[[], None]) -> LoadedCell:
        try:
            return load_cell(self.scenes[key.dataset], key.cell, measured=True, rest=rest)
        except DatasetError as error:
            self._bad[key] = (time.monotonic(), error)
            raise

    def _size(self, key: CellKey) -> int:
        return self._foretold(key, True)

    def _damaged(self) -> set[CellKey]:
        """The cells that could not be read, and are not tried again yet."""
        now = time.monotonic()
        return {key for key, (at, _) in self._bad.items() if now < at + _AGAIN}

    def _foretold(self, key: CellKey, measured: bool) -> int:
        if (key, measured) not in self._sizes:
            self._sizes[key, measured] = foretold_bytes(self.scenes[key.dataset].dataset, key.cell, measured=measured)
        return self._sizes[key, measured]

    def _cell_bytes(self, key: CellKey) -> int:
        return self._foretold(key, False)


@dataclass(frozen=True, slots=True)
class Share:
    """A share in a stage's cells: what a frame loop is given as its cache."""

    stage: Stage
    name: str

    def want(self, needed: Iterable[CellKey], ahead: Iterable[CellKey] = ()) -> None:
        """See :meth:`viewer.cells.cell_cache.CellCache.want`."""
        self.stage.want(self.name, tuple(needed), tuple(ahead))

    def require(self, cells: Iterable[CellKey], *, counted: bool = True) -> float:
        """See :meth:`viewer.cells.cell_cache.CellCache.require`."""
        return self.stage.require(tuple(cells), counted=counted)

    def spend(self, seconds: float) -> float:
        """See :meth:`viewer.cells.cell_cache.CellCache.spend`."""
        return self.stage.spend(seconds)


@dataclass(slots=True)
class Painting:
    """How a session's next picture is drawn: a painter for a frame loop, told before each frame what it is to be.

    ``size`` of the whole picture, of which ``columns`` are drawn, ``into`` an array where one is given. ``flying`` is a view
    to draw from instead of that which the plan was made for; then all layers of a cell are drawn. ``tint``, ``wireframe`` and
    the only ``layer`` that is drawn, by its index, are the style.
    """

    stage: Stage
    scene: WalkScene
    size: tuple[int, int] = (1, 1)
    columns: tuple[int, int] | None = None
    into: NDArray[np.uint8] | None = None
    measured: bool = False
    flying: View | None = None
    tint: bool = False
    wireframe: bool = False
    layer: int | None = None

    def prepare(self, plan: Plan, view: View) -> float:
        """See :meth:`viewer.drawing.renderer.Renderer.prepare`."""
        self.stage.renderer.resize(self.size)
        return self.stage.renderer.prepare(plan, view)

    def draw(self, plan: Plan, view: View, *, read: bool = True) -> DrawnPicture:
        """Draw ``plan``."""
        renderer = self.stage.renderer
        renderer.resize(self.size)
        if self.flying is not None:
            plan, view = self._seen_from(plan, self.flying), self.flying
        return renderer.draw(
            plan,
            view,
            measured=self.measured,
            read=read,
            style=Style(self.tint, self._alone(plan), self.wireframe),
            columns=self.columns,
            into=self.into if read else None,
        )

    def _alone(self, plan: Plan) -> frozenset[str] | None:
        """The names of the only layer that is drawn, None for all."""
        if self.layer is None:
            return None
        names = [name for key in plan.cells for name in self.stage.scenes[key.dataset].cell(key.cell).layers]
        return layer_names(names, self.layer)

    def _seen_from(self, plan: Plan, view: View) -> Plan:
        """What is drawn of a plan by somebody who left the place that it was made for."""

        def more(draw: Draw) -> Draw:
            match draw:
                case Ground():
                    return self.scene.ground_in(view)
                case CellLayers():
                    scene = self.stage.scenes[draw.cell.dataset]
                    drawn = set(draw.names)
                    captured = any(isinstance(one, Relief) for one in plan.draws)
                    names = scene.cell(draw.cell.cell).layers
                    return replace(draw, names=tuple(name for name in names if name in drawn or not captured))
                case _:
                    return draw

        return replace(plan, draws=tuple(more(draw) for draw in plan.draws), fading=(), mix=1.0)


class Streets:
    """What a viewer walks on and against in a scene, whose ``city`` it is, and where its nearest street is."""

    def __init__(self, scene: WalkScene, city: City) -> None:
        self._scene = scene
        self.walls: Walls = walls_of(city)

    def ground(self, point: tuple[float, float]) -> float:
        """The height of the ground, metres."""
        terrain = self._scene.terrain
        return self._scene.ground_height if terrain is None else float(terrain.at(point))

    def slide(self, start: tuple[float, float], end: tuple[float, float]) -> tuple[float, float]:
        """Where somebody comes to that goes from ``start`` towards ``end``."""
        return self.walls.slide(start, end)

    def freed(self, point: tuple[float, float]) -> tuple[float, float]:
        """The point, or where it is within a building the nearest place outside."""
        return self.walls.freed(point)

    @cached_property
    def start(self) -> Pose:
        """Where a viewer begins: in a cell with much near by and much far away, looking along its street to where more is."""
        scene = self._scene
        entries = scene.dataset.manifest.cells
        entry = max(entries, key=lambda one: len(one.near) * len(one.far))
        cell = entry.viewing_cell
        seen = scene.boxes[[scene.objects[one] for one in (*entry.near, *entry.far)], :, :2].mean(axis=1)
        x, y = (0.5 * (a + b) for a, b in zip(cell.p, cell.q, strict=True))
        along = np.array(cell.q) - np.array(cell.p)
        ahead = np.count_nonzero((seen - [x, y]) @ along > 0.0)
        back = np.pi if 2 * ahead < len(seen) else 0.0
        azimuth = math.remainder(math.atan2(along[1], along[0]) + back, math.tau)
        return Pose((x, y, self.ground((x, y)) + EYE_HEIGHT), azimuth, 0.0)

    def tour(self, metres: float) -> Walk:
        """A walk along the streets of the dataset."""
        whereabouts = self._scene.whereabouts
        return tour(whereabouts.cells, whereabouts.adjacency, metres=metres, speed=_SPEED)

    def nearest_place(self, point: tuple[float, float]) -> tuple[float, float]:
        """The nearest place to ``point`` on the axis of a cell."""
        cells = self._scene.whereabouts.cells
        p, q = np.array([cell.p for cell in cells]), np.array([cell.q for cell in cells])
        along = q - p
        t = np.clip(((np.array(point) - p) * along).sum(axis=1) / (along * along).sum(axis=1), 0.0, 1.0)
        places = p + t[:, None] * along
        x, y = places[int(np.argmin(np.hypot(*(places - np.array(point)).T)))].tolist()
        return x, y


def window_camera(camera: Camera, size: tuple[int, int]) -> Camera:
    """The camera of a window of ``size``: with the vertical field of view of the dataset's ``camera``."""
    width, height = size
    focal = camera.focal * height / camera.height
    return Camera(width, height, 2.0 * math.atan(0.5 * width / focal))
