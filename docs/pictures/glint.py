"""The picture of windows that mirror the sun: stored | updated | geometry.

python docs/pictures/glint.py OUT glint.webp
"""

import sys
from pathlib import Path

import numpy as np
from PIL import Image

from mmi import open_dataset
from mmi.walks.walk import Pose
from viewer.cells.loaded_cell import load_cell
from viewer.drawing.renderer import Renderer
from viewer.plan import Budget, Plan
from viewer.scene.scene import WalkScene, open_scene
from viewer.techniques.catalogue import make_technique
from viewer.walks.random_views import random_views

FRAMES = 40
"""For how many frames a view is held before it is shown."""
VIEWS = 200
"""Of so many random views the one is shown in which stored pictures miss most."""


def pictures(scene: WalkScene, renderer: Renderer, pose: Pose, *names: str) -> list[np.ndarray]:
    """The view as each technique of ``names`` draws it in the end."""
    view, scenes = pose.view(scene.camera), {"multi-mesh": scene}
    drawn = []
    for name in names:
        technique = make_technique(name, scenes)
        for i in range(FRAMES if "dynamic" in name else 1):
            plan = technique.plan(view, now=i / 30.0, budget=Budget())
            for key in plan.cells if i == 0 else ():
                renderer.upload(load_cell(scene, key.cell))
            picture = renderer.draw(plan, view)
        drawn.append(picture.color)
        renderer.execute(Plan((), drops=tuple(one.into.image for one in plan.requests)))
    return drawn


def main(dataset: Path, path: Path) -> None:
    scene = open_scene(open_dataset(dataset), name="multi-mesh")
    size = (scene.camera.width, scene.camera.height)
    with Renderer(scene.mesh, scene.ground, size=size, glint=True) as renderer:
        poses = [pose for _, pose in random_views(scene.whereabouts.cells, VIEWS, seed=5, terrain=scene.terrain)]
        missed = []
        for pose in poses:
            stored, geometry = pictures(scene, renderer, pose, "multi-mesh", "full")
            missed.append(float((np.maximum(geometry.astype(int) - stored, 0) ** 2).sum()))
        shown = pictures(scene, renderer, poses[int(np.argmax(missed))], "multi-mesh", "multi-mesh-dynamic", "full")
    Image.fromarray(np.hstack(shown)[: 2 * size[1] // 3]).save(path, quality=80, method=6)


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
