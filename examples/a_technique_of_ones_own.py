"""A technique of one's own next to the package's: all objects within 100 m of the viewer, and nothing beyond.

python examples/a_technique_of_ones_own.py out/helsinki out/comparison

The program takes it as well, from the folder where this file is:
compare-impostors out/helsinki -o out/comparison --techniques local,multi-mesh,a_technique_of_ones_own:within_100_m
"""

import sys
from pathlib import Path

import numpy as np

from mmi import View
from mmi.foundation.plug_ins import plug_in
from viewer import Budget, CompareOptions, Objects, Plan, Sky, WalkScene, compare_views


class Within:
    """Geometry of the objects whose corner nearest to the viewer is at most ``metres`` away."""

    def __init__(self, scene: WalkScene, metres: float) -> None:
        self.name, self._scene, self._metres = f"within {metres:g} m", scene, metres
        starts = scene.mesh.object_vertices[:-1]
        self._objects = np.flatnonzero(np.diff(scene.mesh.object_vertices))  # those that have corners
        self._starts = starts[self._objects]

    def plan(self, view: View, *, now: float, budget: Budget) -> Plan:  # noqa: ARG002
        """What to draw of them for this view: the same key means the same objects."""
        away = np.hypot(*(self._scene.mesh.positions[:, :2] - view.eye[:2]).T)
        near = self._objects[np.minimum.reduceat(away, self._starts) <= self._metres]
        return Plan((Objects(f"{self.name} {near.tobytes().hex()}", near), self._scene.ground_in(view), Sky()))


def within_100_m(scene: WalkScene) -> Within:
    """What the comparison calls: a function of the scene, at a module's top level, that returns a technique."""
    return Within(scene, 100.0)


def main(dataset: Path, out: Path, *, views: int = 12) -> dict:
    own = plug_in(within_100_m, name="within 100 m", version="1")
    options = CompareOptions(techniques=("full", "local", own, "multi-mesh"), flip=False)
    report = compare_views(dataset, out, views=views, options=options)
    for name in ("local", own.name, "multi-mesh"):
        print(f"{name:14} {100.0 * report['techniques'][name]['wrong_share']:.2f} % of the pixels are wrong")
    return report


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
