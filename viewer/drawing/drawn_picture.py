"""What drawing a plan gives: the picture, what it cost, and, where the picture was measured, what each pixel shows.

It is a value of its own so that measures and reports run without OpenGL. ``viewer.drawing.renderer`` makes it.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from viewer.plan import Done

__all__ = ["DrawnPicture"]


@dataclass(frozen=True, slots=True, eq=False)
class DrawnPicture:
    """One drawn view, top row first.

    ``color`` (h, w, 3) uint8 sRGB. Where measured: ``object_ids`` (h, w) int32, -2 the ground, -1 the sky; ``depth``
    (h, w) float32 metres along the axis, ``inf`` for the sky; ``displacement`` (h, w) float32 radians between where an
    impostor's surface is drawn and where its texel was captured, as the viewer sees them, NaN where the pixel shows no
    impostor. ``seconds`` is the time from the first call to the finished picture; ``gpu_seconds`` is what the GPU reports,
    None where that means nothing (``viewer.drawing.renderer.gpu_seconds``); ``triangles`` and ``draws`` were sent. ``done``
    says what of that the plan's requests took, and what its draws.
    """

    color: NDArray[np.uint8]
    object_ids: NDArray[np.int32] | None
    depth: NDArray[np.float32] | None
    displacement: NDArray[np.float32] | None
    seconds: float
    gpu_seconds: float | None
    triangles: int
    draws: int
    done: Done = field(default_factory=Done)
