"""Pictures of what images replace, drawn by the renderer and merged (section 4.1)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mmi.appearance.city_mesh import CityMesh
from mmi.foundation.camera import View
from viewer.drawing.renderer import Renderer
from viewer.layered.layered_image import NOTHING, LayeredImage, Picture
from viewer.layered.merging import merged
from viewer.layered.viewpoints import construction_views
from viewer.placed.solutions import Solutions
from viewer.placing.model_cells import ModelCells
from viewer.plan import Faces, ImageKey, Plan, Request, Slot
from viewer.scene.frustum import box_corners

__all__ = ["ImageCapture"]

_KEY = ImageKey("place-images", "picture")


class ImageCapture:
    """Makes layered images of a model with an OpenGL context of its own; to be closed."""

    def __init__(self, mesh: CityMesh, ground: CityMesh, cells: ModelCells) -> None:
        self._cells = cells
        self._renderer = Renderer(mesh, ground, size=(16, 16), measured=True)

    def image(self, solutions: Solutions, number: int) -> LayeredImage:
        """An image of ``solutions``, merged from as many pictures as they say."""
        image = solutions.images[number]
        some = image.placement.cells
        boxes = self._cells.boxes[some]
        views = construction_views(
            solutions.view(number),
            image.placement.near,
            image.radius,
            solutions.pictures,
            box_corners(boxes[:, 0], boxes[:, 1]).reshape(-1, 3),
            arrangement="ahead",
        )
        triangles = self._cells.triangles_of(some)
        return merged([self._picture(view, triangles, number) for view in views], radius=image.radius)

    def _picture(self, view: View, triangles: NDArray[np.int32], number: int) -> Picture:
        size = view.window[2:]
        request = Request(Slot(_KEY, size), view, (Faces(f"image {number}", triangles),))
        self._renderer.execute(Plan((), requests=(request,)))
        found = self._renderer.image(_KEY)
        there = found.depth > 0.0
        return Picture(
            view,
            np.ascontiguousarray(found.color[..., :3]),
            np.where(there, found.depth, np.float32(np.inf)),
            np.where(there, found.object_ids, np.int32(NOTHING)),
        )

    def close(self) -> None:
        """End the OpenGL context."""
        self._renderer.close()
