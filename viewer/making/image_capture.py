"""Pictures of what images replace, drawn by the renderer and merged (section 4.1)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mmi.appearance.city_mesh import CityMesh
from mmi.appearance.cut_outs import clear_blocks, cut_out_triangles
from mmi.foundation.camera import View
from viewer.drawing.programs import NEAR
from viewer.drawing.renderer import Renderer
from viewer.layered.layered_image import NOTHING, LayeredImage, Picture
from viewer.layered.merging import merged
from viewer.layered.viewpoints import construction_views
from viewer.making.shown_triangles import may_show
from viewer.placed.solutions import Solutions
from viewer.placing.model_cells import ModelCells
from viewer.plan import Faces, ImageKey, Plan, Request, Slot
from viewer.scene.frustum import box_corners

__all__ = ["ImageCapture"]

_KEY = ImageKey("place-images", "picture")


class ImageCapture:
    """Makes layered images of a model with an OpenGL context of its own; to be closed."""

    def __init__(self, mesh: CityMesh, ground: CityMesh, cells: ModelCells) -> None:
        self._cells, self._mesh = cells, mesh
        self._solid: NDArray[np.bool_] | None = None
        if mesh.has_cut_outs:
            self._solid = ~cut_out_triangles(clear_blocks(mesh.texture), mesh.uv, mesh.triangles)
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
        corners = np.ascontiguousarray(self._mesh.positions[self._mesh.triangles[triangles]].T)
        solid = None if self._solid is None else self._solid[triangles]
        pictures = [
            self._picture(view, triangles[may_show(corners, view, nearest=NEAR, solid=solid)]) for view in views
        ]
        return merged(pictures, radius=image.radius)

    def _picture(self, view: View, triangles: NDArray[np.int32]) -> Picture:
        size = view.window[2:]
        request = Request(Slot(_KEY, size), view, (Faces("", triangles),))
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
