"""Single-mesh impostors of the same cells, built when a comparison asks for them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from mmi.building.dataset import build_dataset
from mmi.dataset.reading import open_dataset
from mmi.foundation.errors import DatasetError
from viewer.scene.scene import WalkScene, open_scene

__all__ = ["single_mesh_scene"]


def single_mesh_scene(
    scene: WalkScene,
    folder: Path,
    cells: Sequence[str],
    *,
    workers: int = 1,
    progress: Callable[[int, int, str], None] | None = None,
) -> WalkScene:
    """The baseline of the paper: ``cells`` of ``scene`` built again in ``folder`` with one layer a view, or found there:
    every far object is in it, whatever that costs.

    Raises DatasetError where ``folder`` holds something else, or the scene was built with functions from outside the package:
    nothing that a dataset names is imported here. Raises CaptureError where OpenGL fails.
    """
    named = scene.parameters.own_functions
    if named:
        raise DatasetError(
            f"{scene.dataset.path / 'manifest.json'}: single-mesh expects a dataset built with choices of this package, found "
            f"{', '.join(named)}, which a comparison does not import"
        )
    parameters = replace(scene.parameters, layering="single", geometry="near")
    city = scene.dataset.city()
    build_dataset(city, folder, parameters, cells=sorted(set(cells)), workers=workers, progress=progress)
    return open_scene(open_dataset(folder), name="single-mesh", like=scene)
