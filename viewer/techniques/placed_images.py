"""Placed images (Aliaga & Lastra 1999): what is near as geometry, the rest as a layered depth image, within a budget.

In each frame (section 5, figure 12) the closest point of the grid behind the viewer is found, and its image for the direction
of the view. The cells that the image replaces are left out, and those hidden from all whom the point serves; the other cells in
view are drawn, and the image is warped, here or by the renderer, to where the viewer is. A view of the same direction shows no
more cells than it would from the point, so that the budget holds.

That is so for level views, or for those turned up or down by no more than the images were placed for, of the display that they
were placed for or a smaller one, within the grid's domain. All other views are drawn as geometry, and counted apart.
"""

from __future__ import annotations

import math
from hashlib import blake2b
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mmi.foundation.camera import View
from mmi.foundation.errors import ParameterError
from viewer.computed import WarpedPicture, WarpedSamples
from viewer.layered.layered_image import LayeredImage
from viewer.layered.warping import warped
from viewer.placed.folder import PlacedFolder, open_placed
from viewer.placed.loading import LoadedImages
from viewer.placed.rules import PlacedRules
from viewer.placed.solutions import print_of
from viewer.placing.directions import seen_from
from viewer.placing.model_cells import ModelCells, cells_for
from viewer.plan import Budget, Draw, Faces, Plan, Sky
from viewer.scene.frustum import box_corners, within_view
from viewer.scene.scene import WalkScene

__all__ = ["PlacedImages", "PlacedTally"]

_HAIR = 1e-7
"""Radians, and tangents, that views may be off from level, upright and as wide as the display."""
_AHEAD = 12
"""Images that are brought in around the viewer."""


class PlacedTally(NamedTuple):
    """What ``frames`` were, in all: with an ``image``, ``outside`` of the grid's domain, or ``tilted``, which is not promised.

    ``most`` are the triangles of the model that a frame drew at most among those that are promised something, and ``over`` are
    the frames that drew more than the ``budget``: never. ``samples`` were warped.
    """

    frames: int = 0
    image: int = 0
    outside: int = 0
    tilted: int = 0
    over: int = 0
    most: int = 0
    samples: int = 0
    budget: int = 0

    def plus(self, other: PlacedTally) -> PlacedTally:
        """Both together."""
        sums = [a + b for a, b in zip(self, other, strict=True)]
        return PlacedTally(*sums)._replace(most=max(self.most, other.most), budget=max(self.budget, other.budget))


class PlacedImages:
    """Cells near the viewer, and an image instead of the others, from the folder that ``rules`` say.

    Who is only ``counting`` gets plans without images. Raises ParameterError where there is no folder, or one of another model
    than the scene's, DatasetError where it is damaged.
    """

    name = "placed-images"

    def __init__(self, scene: WalkScene, rules: PlacedRules, *, counting: bool = False) -> None:
        path = rules.folder
        if path is None:
            raise ParameterError("placed: the folder of placed images expected, which place-images makes, found none")
        folder: PlacedFolder = scene.workshop.once(("placed images", path), lambda: open_placed(path))
        self._scene, self._folder, self._rules, self._counting = scene, folder, rules, counting
        solutions = folder.solutions
        found = scene.workshop.once("print of the model", lambda: print_of(scene.mesh))
        if found != solutions.model:
            raise ParameterError(
                f"{folder.path}: images placed for {scene.source} as it is now expected, found those for "
                f"{solutions.source}, or for other triangles of it; place-images makes them"
            )
        placing = solutions.rules
        self._cells: ModelCells = scene.workshop.once(
            ("cells", placing.depth, placing.target),
            lambda: cells_for(scene.mesh.positions, scene.mesh.triangles, placing),
        )
        last = max((int(one.placement.cells[-1]) for one in solutions.images if len(one.placement.cells)), default=-1)
        if last >= len(self._cells.counts):
            raise ParameterError(f"{folder.path}: {len(self._cells.counts)} cells expected, found cell {last}")
        bits = len(self._cells.counts) + 7 & ~7
        if any(len(one.hidden) not in (0, bits // 8) for one in solutions.points):
            raise ParameterError(f"{folder.path}: bits of {len(self._cells.counts)} cells expected, found others")
        self._corners = box_corners(self._cells.boxes[:, 0], self._cells.boxes[:, 1])
        self._images: LoadedImages = scene.workshop.once(
            ("images in memory", path, rules.bytes), lambda: LoadedImages(folder, most=rules.bytes)
        )
        self._eye: NDArray[np.float64] | None = None
        self._points = np.array([one.point for one in solutions.images]).reshape(-1, 3)
        self._faces: tuple[bytes, Faces] | None = None
        self.tally = PlacedTally()
        """What frames were so far."""
        self.latest = PlacedTally()
        """What the last one was."""

    def plan(self, view: View, *, now: float, budget: Budget) -> Plan:  # noqa: ARG002
        """Draw the cells in view, but for those that an image replaces."""
        solutions, ground = self._folder.solutions, self._scene.ground_in(view)
        eye, yaw = view.eye, _yaw(view)
        tilted = not self._is_promised(view)
        point = -1 if tilted else solutions.grid.closest(eye, yaw)
        if point < 0:
            seen = within_view(self._corners, view)
            number = -1
        else:
            seen = seen_from(self._cells.boxes, eye, yaw, solutions.rules.pyramid)
            seen &= ~solutions.points[point].hides(len(seen))
            number = solutions.serving(point, yaw)
            if solutions.rules.pitch > 0.0:
                seen &= within_view(self._corners, view)
        draws: list[Draw] = []
        samples = 0
        if number >= 0:
            seen[solutions.images[number].placement.cells] = False
            if not self._counting:
                image = self._images.get(number)
                draws.append(self._warped(number, image, view))
                samples = len(image.depths)
        faces = self._of(np.flatnonzero(seen))
        if self._eye is not None and not self._counting:  # who has only just come may be gone at once
            self._images.want(self._around(eye))
        self._eye = eye
        counted, most = len(faces.triangles), solutions.rules.budget
        self.latest = PlacedTally(
            frames=1,
            image=int(number >= 0),
            outside=int(point < 0 and not tilted),
            tilted=int(tilted),
            over=int(point >= 0 and counted > most),
            most=counted if point >= 0 else 0,
            samples=samples,
            budget=most,
        )
        self.tally = self.tally.plus(self.latest)
        return Plan((faces, *draws, ground, Sky()))

    def _is_promised(self, view: View) -> bool:
        """Whether a view shows no more than those that images were placed for."""
        rules, (right, _, back) = self._folder.solutions.rules, view.eye_from_world[:3, :3]
        left, top, width, height = view.window
        across, up = max(-left, left + width) / view.focal, max(-top, top + height) / view.focal
        return bool(
            abs(right[2]) <= _HAIR
            and abs(math.asin(max(-1.0, min(1.0, -float(back[2]))))) <= rules.pitch + _HAIR
            and across <= rules.fov.across + _HAIR
            and up <= rules.fov.up + _HAIR
        )

    def _of(self, cells: NDArray[np.int64]) -> Faces:
        """What draws all triangles of ``cells`` (k,); the same cells have the same key."""
        told = cells.tobytes()
        if self._faces is None or self._faces[0] != told:
            key = f"placed {blake2b(told, digest_size=8).hexdigest()}"
            self._faces = told, Faces(key, self._cells.triangles_of(cells))
        return self._faces[1]

    def _warped(self, number: int, image: LayeredImage, view: View) -> Draw:
        """What draws an image as a view sees it."""
        if self._rules.warp == "points":
            return WarpedSamples(
                f"{self._folder.key} {number}",
                image.view,
                image.starts,
                image.depths,
                image.slopes,
                image.reaches,
                image.colors,
                image.ids,
            )
        found = warped(image, view, threads=self._rules.threads)
        return WarpedPicture(found.color, found.depth, found.ids)

    def _around(self, eye: NDArray[np.float64]) -> list[int]:
        """The images of the points nearest to a viewer at ``eye`` (3,), near to far."""
        away = np.linalg.norm(self._points - eye, axis=1)
        nearest = np.arange(len(away)) if len(away) <= _AHEAD else np.argpartition(away, _AHEAD)[:_AHEAD]
        found: list[int] = nearest[np.lexsort((nearest, away[nearest]))].tolist()
        return found


def _yaw(view: View) -> float:
    """Where a view looks to, radians from +X counter-clockwise; of one straight up or down, where its lower side is."""
    x, y, _ = -view.eye_from_world[2, :3]
    return math.atan2(y, x)
