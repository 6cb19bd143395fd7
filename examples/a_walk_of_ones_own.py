"""A technique, a walk and a frame loop put together by hand: what a program that embeds the viewer does.

python examples/a_walk_of_ones_own.py out/helsinki out/walk.png
"""

import sys
from pathlib import Path

import numpy as np
from PIL import Image

from mmi import open_dataset
from viewer import FrameLoop, Keyframe, Pose, Renderer, Walk, cell_cache, make_technique, open_scene


def main(folder: Path, picture: Path) -> list:
    scene = open_scene(open_dataset(folder), name="multi-mesh")
    scenes, camera = {"multi-mesh": scene}, scene.camera
    cell = scene.whereabouts.cells[0]
    azimuth = float(np.arctan2(cell.q[1] - cell.p[1], cell.q[0] - cell.p[0]))
    start, end = (Pose((*point, sum(cell.eye) / 2), azimuth, 0.0) for point in (cell.p, cell.q))
    walk = Walk("along the first cell", (Keyframe(0.0, start), Keyframe(cell.length / 1.5, end)))
    with (
        Renderer(scene.mesh, scene.ground, size=(camera.width, camera.height), samples=4) as renderer,
        cell_cache(scenes, renderer) as cache,
    ):
        loop = FrameLoop(make_technique("multi-mesh", scenes), renderer, cache, camera=camera)
        frames = [loop.frame(step.pose, step.time, cut=step.cut, read=True) for step in walk.frames(10.0)]
    Image.fromarray(np.hstack([frames[0].picture.color, frames[-1].picture.color])).save(picture)
    times = [frame.times for frame in frames]
    milliseconds = 1e3 * float(np.median([one.total for one in times]))
    print(f"{walk.metres:.0f} m in {len(times)} frames of {milliseconds:.1f} ms, first and last in {picture}")
    return times


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
