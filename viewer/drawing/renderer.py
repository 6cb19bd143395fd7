"""Draws plans, with moderngl: puts the kinds of draw together, times them and reads pictures back (DESIGN section 5).

What a kind of draw keeps on the GPU, its shaders and how it is drawn are in ``viewer.drawing.kinds``, which has a module for
each; images that requests capture into are in ``viewer.drawing.images``. A measured picture also has, per pixel, the object,
its depth, and by what angle an impostor's surface is displaced from the one that was captured (DESIGN section 6).
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from types import TracebackType
from typing import assert_never

import moderngl
import numpy as np
from numpy.typing import NDArray

from mmi.appearance.city_mesh import CityMesh
from mmi.foundation.camera import View
from mmi.foundation.errors import CaptureError
from mmi.movers.movers import NOTHING_MOVES, Movers
from viewer.cells.loaded_cell import LoadedCell, LoadedLayer
from viewer.computed import CastPixels, WarpedPicture, WarpedSamples
from viewer.drawing.drawn_picture import DrawnPicture
from viewer.drawing.fade import Fade
from viewer.drawing.images import CapturedPixels, Images
from viewer.drawing.kinds.cast_pixels import CastPixelsDrawer
from viewer.drawing.kinds.ground import GroundDrawer
from viewer.drawing.kinds.layers import LayersDrawer
from viewer.drawing.kinds.lines import LineProgram
from viewer.drawing.kinds.meshes import MeshProgram
from viewer.drawing.kinds.moving import MovingDrawer
from viewer.drawing.kinds.nailboards import NailboardsDrawer
from viewer.drawing.kinds.objects import ObjectsDrawer
from viewer.drawing.kinds.reliefs import ReliefsDrawer
from viewer.drawing.kinds.sky import SkyDrawer
from viewer.drawing.kinds.warped import WarpedDrawer
from viewer.drawing.kinds.warped_samples import WarpedSamplesDrawer
from viewer.drawing.opengl import finisher, is_software, open_context
from viewer.drawing.programs import Programs
from viewer.drawing.style import CAPTURED, CAPTURED_LINES, PLAIN, REUSED, REUSED_LINES, Style, fresh_parts, narrowed
from viewer.drawing.targets import Targets
from viewer.drawing.thread_turns import turns_after
from viewer.plan import (
    CellKey,
    CellLayers,
    Done,
    Draw,
    Faces,
    Finish,
    Ground,
    ImageKey,
    Moving,
    Nailboards,
    Objects,
    Plan,
    Relief,
    Request,
    Sky,
    Work,
)

__all__ = ["Renderer", "gpu_seconds"]

_SWITCH_INTERVAL = 5e-4
"""Seconds for which other threads may keep the interpreter when OpenGL has finished. Python's own 5 ms would be felt."""
_SIZES, _PIXELS = 8, 12 << 20
"""What is drawn into is kept for this many sizes and pixels: several windows take turns, and some show two pictures."""
_CLOCKS = 1.05
"""The GPU's own clock may count this many times the seconds of the whole drawing, since two clocks never quite agree."""


class Renderer:
    """One city in one OpenGL context, drawing pictures of ``size``, which can be changed. Use as a context manager.

    ``measured`` keeps what measuring needs (object ids of layers). ``samples``: multisampling of unmeasured pictures.
    ``movers`` are what moves in the city, in its frame; plans say where they are. With ``glint``, windows of painted facades
    mirror the sun wherever geometry is drawn, into images as well.
    Raises CaptureError where no OpenGL context can be had.
    """

    def __init__(
        self,
        mesh: CityMesh,
        ground: CityMesh,
        *,
        size: tuple[int, int],
        measured: bool = False,
        samples: int = 0,
        movers: Movers | None = None,
        glint: bool = False,
    ) -> None:
        self._context = open_context()
        try:
            with self._context:  # another library's context may be current, here and whenever we are called again
                if samples > self._context.max_samples:
                    raise CaptureError(f"at most {self._context.max_samples} samples a pixel here, found {samples}")
                self.device = str(self._context.info["GL_RENDERER"])
                """Name of what draws (``llvmpipe ...`` is software)."""
                self._prepare(mesh, ground, size, measured, samples, movers, glint)
        except BaseException:
            self._context.release()
            raise

    def _prepare(
        self,
        mesh: CityMesh,
        ground: CityMesh,
        size: tuple[int, int],
        measured: bool,
        samples: int,
        movers: Movers | None,
        glint: bool,
    ) -> None:
        context = self._context
        self.size, self.measured = size, measured
        self._timer, self._finish = context.query(time=True), finisher(context)
        self._programs = Programs(context, samples=samples)
        self._line = LineProgram(self._programs)
        self._targets = Targets(self._programs, size, measured=measured)
        self._images = Images(context)
        self._other_targets: dict[tuple[int, int], Targets] = {}
        self._fade = Fade(self._programs)
        meshes = MeshProgram.made_by(self._programs)
        self._sky = SkyDrawer(self._programs)
        self._ground = GroundDrawer(context, meshes, ground)
        of_objects = meshes
        if glint or mesh.has_cut_outs:
            of_objects = MeshProgram.made_by(self._programs, glint=glint, cut_outs=mesh.has_cut_outs)
        self._objects = ObjectsDrawer(self._programs, of_objects, mesh)
        self._layers = LayersDrawer(self._programs, self._images, measured=measured)
        self._reliefs = ReliefsDrawer(self._programs, self._images)
        self._nailboards = NailboardsDrawer(self._programs, self._images)
        self._cast = CastPixelsDrawer(self._programs, self._objects.texture)
        self._warped = WarpedDrawer(self._programs)
        self._samples = WarpedSamplesDrawer(self._programs)
        self._moving = MovingDrawer(
            self._programs, NOTHING_MOVES if movers is None else movers, first=len(mesh.triangle_counts)
        )

    def __enter__(self) -> Renderer:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def resize(self, size: tuple[int, int]) -> None:
        """Draw pictures of ``size`` (width, height) from now on. Changing back and forth costs nothing."""
        if size == self.size:
            return
        with self._context:
            found = self._other_targets.pop(size, None) or Targets(self._programs, size, measured=self.measured)
            self._other_targets[self.size] = self._targets
            while len(self._other_targets) >= _SIZES or sum(w * h for w, h in self._other_targets) > _PIXELS:
                self._other_targets.pop(next(iter(self._other_targets))).release()
            self.size, self._targets = size, found

    def close(self) -> None:
        """Free everything. The renderer cannot be used afterwards."""
        self._context.release()

    # --------------------------------------------------------------------------------------------------- uploads

    def upload(self, cell: LoadedCell) -> None:
        """Bring all layers of a cell to the GPU."""
        for layer in cell.layers:
            while not self.upload_layer(cell, layer):
                pass

    def upload_layer(self, cell: LoadedCell, layer: LoadedLayer) -> bool:
        """Bring one of a cell's layers to the GPU; draws refer to it by the cell's key and its name. True if it is there now.

        A picture that the dataset does not hold is captured here. The first calls for a cell only make room, a part of it each,
        because that takes as long as many layers do.
        """
        with self._context:
            if not self._layers.upload_layer(cell, layer):
                return False
            if isinstance(layer.picture, Request):
                self._capture(layer.picture)
                with turns_after(_SWITCH_INTERVAL):
                    self._finish()  # so that who asked knows what it took
            return True

    def evict(self, cell: CellKey) -> None:
        """Free a cell's layers; nothing where they are not there."""
        with self._context:
            self._layers.evict(cell)

    # --------------------------------------------------------------------------------------------------- drawing

    def draw(
        self,
        plan: Plan,
        view: View,
        *,
        measured: bool = False,
        read: bool = True,
        style: Style = PLAIN,
        columns: tuple[int, int] | None = None,
        into: NDArray[np.uint8] | None = None,
    ) -> DrawnPicture:
        """Draw ``plan`` as ``view`` sees it, in a ``style``. Without ``read``, ``color`` is empty: for timing.

        With ``columns``, only those from the first to before the second are drawn and read, as they are in the whole picture.
        Colours are read ``into`` an array of their shape where there is one.
        The plan's requests are executed first. In a measured picture, ids, depth and displacement are those of ``draws``,
        whatever fades; lines of a style do not count in it, nor among triangles and draws. Raises KeyError where a
        layer is drawn that was not uploaded or an image that was not captured, ValueError for measuring with a renderer that
        was not made for it.
        """
        if measured and not self.measured:
            raise ValueError("a renderer made with measured=True expected")
        with self._context:
            self._targets.limit(columns)
            start = time.perf_counter()
            with self._timer:
                captured = self._execute(plan)
                shown = narrowed(plan, style)
                counts, finished = self._draw(shown, view, measured, style)
            with turns_after(_SWITCH_INTERVAL):
                self._finish()
            seconds = time.perf_counter() - start
            empty = np.empty((0, 0, 3), dtype=np.uint8)
            color = self._targets.color(measured=measured, into=into) if read else empty
            ids, depth, displacement = self._targets.measures() if measured else (None, None, None)
            gpu = gpu_seconds(self._timer.elapsed, seconds=seconds, device=self.device)
            relief = _relief(shown.draws) + (_relief(shown.fading) if plan.mix < 1.0 else 0)
            drawn = Work(seconds - captured.seconds - finished.finish, sum(counts), len(counts), relief=relief)
            return DrawnPicture(
                color=color,
                object_ids=ids,
                depth=depth,
                displacement=displacement,
                seconds=seconds,
                gpu_seconds=gpu,
                triangles=captured.triangles + drawn.triangles,
                draws=captured.draws + drawn.draws,
                done=finished._replace(requests=captured, draws=drawn),
            )

    def prepare(self, plan: Plan, view: View) -> float:
        """Make what drawing ``plan`` for the first time makes, sets of objects for instance; the seconds that took.

        What it draws, on the screen or into images, is drawn once for nothing; only reliefs and nailboards are not, which need
        their images.
        Raises what :meth:`draw` does.
        """
        draws = (*plan.draws, *(draw for request in plan.requests for draw in request.draws))
        some = tuple(draw for draw in draws if not isinstance(draw, Relief | Nailboards))
        return self.draw(Plan(some), view, read=False).seconds

    def execute(self, plan: Plan) -> Work:
        """Execute the requests of a plan and draw nothing: what they took. Raises what :meth:`draw` does."""
        with self._context:
            return self._execute(plan)

    def image(self, key: ImageKey) -> CapturedPixels:
        """What an image holds. Raises KeyError where nothing was captured into it."""
        with self._context:
            return self._images.read(key)

    def image_bytes(self, owner: str) -> int:
        """Bytes of all images of an owner."""
        return self._images.bytes(owner)

    def forget(self, owner: str) -> None:
        """Drop all images of an owner, whose viewer has left."""
        with self._context:
            for key in self._images.of(owner):
                self._images.drop(key)

    def _execute(self, plan: Plan) -> Work:
        for key in plan.drops:
            self._images.drop(key)
        if not plan.requests:
            return Work()
        start = time.perf_counter()
        counts = [count for request in plan.requests for count in self._capture(request)]
        with turns_after(_SWITCH_INTERVAL):
            self._finish()
        return Work(
            time.perf_counter() - start,
            sum(counts),
            len(counts),
            relief=sum(_relief(request.draws) for request in plan.requests),
            requests=len(plan.requests),
            pixels=sum(request.pixels for request in plan.requests),
        )

    def _capture(self, request: Request) -> list[int]:
        """Draw into an image; the triangles of each call."""
        self._context.enable_only(moderngl.DEPTH_TEST)
        self._images.begin(request.into, request.view.window[2:], clear=request.clear)
        self._programs.look_through(request.view, measured=True, downwards=True)
        try:
            return [count for draw in request.draws for count in self._paint_one(draw, request.view, True, PLAIN, ())]
        finally:
            self._images.end()

    def _draw(self, plan: Plan, view: View, measured: bool, style: Style) -> tuple[list[int], Done]:
        """The triangles of each call that was sent, and what finishing the plan took."""
        if plan.mix >= 1.0:
            return self._paint(plan.draws, plan.finish, view, measured, style, plan.requests)
        before, *_ = self._paint(plan.fading, None, view, measured, style, plan.requests)
        self._fade.keep(self._targets, measured=measured)
        now, finished = self._paint(plan.draws, plan.finish, view, measured, style, plan.requests)
        return [*before, *now, *self._fade.mix(self._targets, 1.0 - plan.mix, measured=measured)], finished

    def _paint(
        self,
        draws: Sequence[Draw],
        finish: Finish | None,
        view: View,
        measured: bool,
        style: Style,
        requests: Sequence[Request],
    ) -> tuple[list[int], Done]:
        """Draw into the target, and finish; the triangles of each call, lines aside, and what finishing took."""
        self._targets.clear(measured=measured)
        self._programs.look_through(view, measured=measured)
        counts = [count for draw in draws for count in self._paint_one(draw, view, measured, style, requests)]
        finished = Done()
        if finish is not None:
            depths = self._targets.depths(measured=measured)  # waits for what was drawn
            start = time.perf_counter()
            more = finish(depths, self._targets.first_column)
            seconds = time.perf_counter() - start
            found = [draw for draw in more if isinstance(draw, CastPixels)]
            finished = Done(
                finish=seconds, fresh=sum(draw.fresh for draw in found), finding=sum(draw.seconds for draw in found)
            )
            counts += [count for draw in more for count in self._paint_one(draw, view, measured, style, requests)]
        if style.wireframe:
            with self._line.over(self._targets, measured=measured):
                for draw in draws:
                    self._paint_lines(draw, view, measured, requests)
        return counts, finished

    def _paint_one(
        self, draw: Draw, view: View, measured: bool, style: Style, requests: Sequence[Request]
    ) -> list[int]:
        match draw:
            case Sky():
                return self._sky.draw(measured=measured)
            case Ground():
                return self._ground.draw(draw, measured=measured)
            case Objects():
                return self._objects.draw(draw, measured=measured)
            case Faces():
                return self._objects.draw_faces(draw, view, measured=measured)
            case Nailboards():
                inks_of = (CAPTURED, REUSED) if style.tint else None
                return self._nailboards.draw(draw, view, measured=measured, inks=inks_of)
            case CellLayers():
                return self._layers.draw(draw, view, measured=measured, tint=style.tint)
            case Relief() if style.tint:
                inks = zip(fresh_parts(draw, requests), (CAPTURED, REUSED), strict=True)
                return [
                    count for some, ink in inks for count in self._reliefs.draw(some, view, measured=measured, ink=ink)
                ]
            case Relief():
                return self._reliefs.draw(draw, view, measured=measured)
            case Moving():
                return self._moving.draw(draw, view, measured=measured)
            case CastPixels():
                size, some = view.window[2:], draw.samples
                if not style.tint:
                    return self._cast.draw(some, size, measured=measured)
                inked = ((some[: draw.fresh], CAPTURED), (some[draw.fresh :], REUSED))
                return [
                    count for part, ink in inked for count in self._cast.draw(part, size, measured=measured, ink=ink)
                ]
            case WarpedPicture():
                return self._warped.draw(draw, measured=measured, ink=REUSED if style.tint else None)
            case WarpedSamples():
                return self._samples.draw(draw, view, measured=measured, ink=REUSED if style.tint else None)
            case _:
                assert_never(draw)

    def _paint_lines(self, draw: Draw, view: View, measured: bool, requests: Sequence[Request]) -> None:
        """Draw the edges of what has a mesh of its own; sky, ground and what moves have none to show."""
        match draw:
            case Objects():
                self._objects.draw_lines(draw, self._line, measured=measured)
            case CellLayers():
                self._layers.draw_lines(draw, self._line, measured=measured)
            case Relief():
                for some, ink in zip(fresh_parts(draw, requests), (CAPTURED_LINES, REUSED_LINES), strict=True):
                    self._reliefs.draw_lines(some, view, ink=ink, measured=measured)


def _relief(draws: Sequence[Draw]) -> int:
    """Pixels of captured images among some draws."""
    return sum(draw.pixels for draw in draws if isinstance(draw, Relief | Nailboards))


def gpu_seconds(nanoseconds: int, *, seconds: float, device: str) -> float | None:
    """What a time query of OpenGL says of a drawing that took ``seconds`` in all, or None where that means nothing.

    Software OpenGL works before the query begins and after it has ended; and a query that overflows, or that the driver does
    not answer, yields more than the whole drawing took, 4.295 s say (2^32 nanoseconds).
    """
    found = nanoseconds * 1e-9
    return None if is_software(device) or not 0.0 < found <= _CLOCKS * seconds else found
