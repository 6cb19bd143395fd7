"""A finished folder put to the test: how many triangles are drawn in all directions from all points, and in random views."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from mmi.foundation.camera import View, view_towards
from mmi.foundation.errors import FaultError
from mmi.foundation.progress import Progress, silent
from viewer.drawing.renderer import Renderer
from viewer.making.models import Model
from viewer.placed.folder import PlacedFolder
from viewer.placed.rules import PlacedRules
from viewer.placing.grid_check import GridChecked, check_grid
from viewer.placing.model_cells import cells_for
from viewer.plan import Budget, Faces, Plan
from viewer.techniques.placed_images import PlacedImages, PlacedTally

__all__ = ["Checked", "check_directions", "check_views"]

_DRAWN = 1000
"""Views, spread over all, in which triangles are counted by the renderer as well."""


@dataclass(frozen=True, slots=True)
class Checked:
    """What ``views`` drew, in ``tally``; the renderer agreed in ``drawn`` of them. They should keep to ``budget`` triangles."""

    views: int
    drawn: int
    budget: int
    tally: PlacedTally

    @property
    def kept(self) -> bool:
        """Whether no view drew more than the budget, and all could be judged."""
        return self.tally.over == 0 and self.tally.outside == 0 and self.tally.tilted == 0


def check_directions(folder: PlacedFolder, model: Model, *, progress: Progress = silent) -> GridChecked:
    """Count what views from the points of a folder draw, in all directions, of the model that it is for."""
    solutions = folder.solutions
    cells = cells_for(model.mesh.positions, model.mesh.triangles, solutions.rules)
    return check_grid(cells, solutions.grid, solutions.points, solutions.rules, progress)


def check_views(
    folder: PlacedFolder, model: Model, *, views: int, seed: int = 1, progress: Progress = silent
) -> Checked:
    """Plan ``views`` random views from within the grid's domain, in all directions, and pitched as far as is promised.

    Raises FaultError where the renderer draws other triangles than were counted; ParameterError and DatasetError as the
    technique does.
    """
    solutions = folder.solutions
    camera, rng = solutions.camera, np.random.default_rng(seed)
    scene = model.scene(camera)
    technique = PlacedImages(scene, PlacedRules(folder.path), counting=True)
    low, high = solutions.grid.domain
    step = max(views // _DRAWN, 1)
    drawn = 0
    with Renderer(scene.mesh, scene.ground, size=(camera.width, camera.height)) as renderer:
        for number in range(views):
            eye, yaw = rng.uniform(low, high), rng.uniform(-math.pi, math.pi)
            pitch = rng.uniform(-solutions.rules.pitch, solutions.rules.pitch)
            view = view_towards(eye, yaw, pitch, focal=camera.focal, window=camera.window)
            plan = technique.plan(view, now=0.0, budget=Budget())
            if number % step == 0 and drawn < _DRAWN:
                _compare(renderer, plan, view, technique.latest.most)
                drawn += 1
            progress(number + 1, views, "views")
    return Checked(views, drawn, solutions.rules.budget, technique.tally)


def _compare(renderer: Renderer, plan: Plan, view: View, counted: int) -> None:
    plan = replace(plan, draws=tuple(one for one in plan.draws if isinstance(one, Faces)))
    found = renderer.draw(plan, view, read=False).triangles
    if found != counted:
        raise FaultError(f"{counted} triangles expected of a frame, found {found} that were drawn")
