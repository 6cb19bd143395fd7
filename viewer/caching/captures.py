"""As what boxes are captured: pictures towards their middles, a little larger than they are (paper sections 3 and 4.1).

Neighbours may shift apart by as much as each of them may be wrong, so that boxes are taken larger by what two pixels cover at
their far ends. What is captured and drawn twice so is the same surface.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mmi.foundation.camera import View
from viewer.scene.frustum import box_corners

__all__ = ["Captures", "Sharpness", "captures_of", "least_distances", "sharpness_of"]

_FINER = 2.5
"""Texels are so much finer than the smallest pixels when they are captured: the viewer may come closer, and of facades in a
row, each as narrow as a pixel, the right one is shown (``benchmarks/image_cache_pictures.py``)."""
_LARGER_PX = 2.0
"""Pixels by which boxes are captured larger (paper section 4.1)."""
_BESIDE = 0.999
"""The cosine with the vertical from which on another direction says what is to the right."""
_LEAST_AHEAD = 0.05
"""Metres that all of a box must be ahead of where it is captured from."""


@dataclass(frozen=True, slots=True)
class Sharpness:
    """Of a display: the radians that its smallest pixel covers, that in the middle of its farthest border (paper equation 1,
    which has displays wider than high), its ``focal`` length, and that of images whose texels are as fine, ``texel_focal``;
    both in pixels or texels.
    """

    pixel: float
    focal: float
    texel_focal: float

    @property
    def finer(self) -> float:
        """By how much the viewer may come closer before texels show."""
        return self.texel_focal * self.pixel


def sharpness_of(view: View) -> Sharpness:
    """What a view needs; at 60 degrees pixels at its borders are three quarters of those in the middle."""
    left, top, width, height = view.window
    aside = max(abs(left), abs(left + width), abs(top), abs(top + height)) / view.focal
    pixel = 1.0 / ((1.0 + aside * aside) * view.focal)
    return Sharpness(pixel, view.focal, _FINER / pixel)


class Captures(NamedTuple):
    """Pictures of n boxes from one viewpoint: ``eye_from_world`` (n, 4, 4), ``windows`` (n, 4) of their image planes, the
    ``boxes`` (n, 2, 3) that they show, larger than what was asked for, the ``depths`` (n,) at which what they show stands best,
    metres along their axes, and which are ``possible`` (n,): those wholly ahead of the viewpoint.
    """

    eye_from_world: NDArray[np.float64]
    windows: NDArray[np.int64]
    boxes: NDArray[np.float64]
    depths: NDArray[np.float64]
    possible: NDArray[np.bool_]


def captures_of(eye: NDArray[np.float64], boxes: NDArray[np.float64], sharpness: Sharpness) -> Captures:
    """Pictures of ``boxes`` (n, 2, 3) from ``eye`` (3,), each towards the middle of its box.

    A quadrilateral between a box's nearest and farthest depths a and b is best at 2 a b / (a + b): points at both ends are off
    by the same then.
    """
    middle = 0.5 * (boxes[:, 0] + boxes[:, 1]) - eye
    distance = np.linalg.norm(middle, axis=1)
    radius = 0.5 * np.linalg.norm(boxes[:, 1] - boxes[:, 0], axis=1)
    margin = _LARGER_PX * sharpness.pixel * (distance + radius)
    larger = np.stack([boxes[:, 0] - margin[:, None], boxes[:, 1] + margin[:, None]], axis=1)
    ahead = middle / np.maximum(distance, 1e-12)[:, None]
    upright = np.abs(ahead[:, 2]) > _BESIDE
    right = np.where(upright[:, None], np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]))
    right = np.where(upright[:, None], right - ahead * np.sum(right * ahead, axis=1)[:, None], np.cross(ahead, right))
    right /= np.maximum(np.linalg.norm(right, axis=1), 1e-12)[:, None]
    turned = np.stack([right, np.cross(right, ahead), -ahead], axis=1)
    eye_from_world = np.zeros((len(boxes), 4, 4))
    eye_from_world[:, :3, :3], eye_from_world[:, 3, 3] = turned, 1.0
    eye_from_world[:, :3, 3] = -turned @ eye
    points = np.einsum("nij,nkj->nki", turned, box_corners(larger[:, 0], larger[:, 1]) - eye)
    depth = -points[..., 2]
    possible = depth.min(axis=1) > _LEAST_AHEAD
    depth = np.where(possible[:, None], depth, 1.0)
    u, v = sharpness.texel_focal * points[..., 0] / depth, -sharpness.texel_focal * points[..., 1] / depth
    low = np.floor(np.stack([u.min(axis=1), v.min(axis=1)], axis=1)) - 1.0
    high = np.ceil(np.stack([u.max(axis=1), v.max(axis=1)], axis=1)) + 1.0
    bounds = np.where(possible[:, None], np.concatenate([low, high - low], axis=1), 1.0)
    near, far = depth.min(axis=1), depth.max(axis=1)
    return Captures(
        eye_from_world=eye_from_world,
        windows=np.clip(bounds, -(2.0**31), 2.0**31).astype(np.int64),
        boxes=larger,
        depths=2.0 * near * far / (near + far),
        possible=possible,
    )


def least_distances(boxes: NDArray[np.float64], largest: int, sharpness: Sharpness) -> NDArray[np.float64]:
    """Metres (n,) from the middles of ``boxes`` from which on images of at most ``largest`` texels a side have room for them,
    whichever side they show: those of the spheres around them, and of what they are captured larger by.
    """
    radius = 0.5 * np.linalg.norm(boxes[:, 1] - boxes[:, 0], axis=1)
    share = math.sin(math.atan(0.5 * (largest - 4) / sharpness.texel_focal))
    # The sphere around the larger box: radius + sqrt(3) * margin, where the margin grows with the distance.
    wider = math.sqrt(3.0) * _LARGER_PX * sharpness.pixel
    least = radius * (1.0 + wider) / max(share - wider, 1e-9)
    return np.asarray(np.maximum(least, radius + 4.0 * _LEAST_AHEAD))
