"""Pictures of techniques in the viewer's small city, and what is wrong with them beside its geometry."""

import numpy as np

from mmi.foundation.camera import view_towards
from viewer.measuring.view_errors import view_errors
from viewer.plan import Budget
from viewer.techniques.catalogue import TECHNIQUES
from viewer.techniques.geometry import FullGeometry

BUDGET = Budget()
OF_DATASETS = tuple(name for name in TECHNIQUES if name != "placed-images")
"""Techniques that need nothing besides a dataset."""


def look(scene, x, y, azimuth, pitch=0.0, height=1.7):
    return view_towards(np.array([x, y, height]), azimuth, pitch, focal=scene.camera.focal, window=scene.camera.window)


def drawn(renderer, technique, view, *, measured=True, budget=BUDGET):
    return renderer.draw(technique.plan(view, now=0.0, budget=budget), view, measured=measured)


def errors(scene, renderer, picture, view):
    truth = drawn(renderer, FullGeometry(scene), view)
    nowhere = np.zeros(truth.depth.shape, dtype=bool)
    return view_errors(truth, picture, focal=scene.camera.focal, disoccluded=nowhere, flip=False)
