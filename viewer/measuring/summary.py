"""Many views in a few figures: a technique's errors, when its views settled, and its frame times (DESIGN sections 6 and 7).

All that comes out is plain floats and None, ready for JSON: no NaN, no infinity. Percentiles are interpolated linearly
between the two values next to them (NumPy's default).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from viewer.measuring.view_errors import ViewErrors

__all__ = ["ERRORS", "frame_summary", "settling_summary", "summarise"]

ERRORS = (
    "hole_share",
    "wrong_share",
    "wrong_thickness_px",
    "displacement_px",
    "flip",
    "psnr_db",
    "psnr_worst_db",
    "ssim",
)
"""The names of what :func:`summarise` tells."""


def summarise(errors: Sequence[ViewErrors]) -> dict[str, Any]:
    """The errors of a technique over all its views.

    - ``hole_share``, ``wrong_share``, ``ssim``: means over views;
    - ``wrong_thickness_px``: p50, p99 and max over views of a view's thickest wrong region;
    - ``displacement_px``: p50 and p99 over views of a view's 99th percentile over impostor pixels; max is the largest of
      all pixels of all views;
    - ``flip``: means over views of a view's mean, of its 95th percentile (``p95``) and of its mean where it is disoccluded
      (``masked``, over the views that have such pixels, null where none has); null where FLIP was not asked for;
    - ``psnr_db``: mean over the views that differ from the geometry's, null where none does; ``psnr_worst_db`` is the
      lowest of all views.

    Raises ValueError for no views at all.
    """
    if not errors:
        raise ValueError("errors of one view at least expected, found none")
    displacement = _percentiles([one.displacement_p99_px for one in errors], 50, 99)
    flip = {
        "mean": _mean([one.flip_mean for one in errors]),
        "p95": _mean([one.flip_p95 for one in errors]),
        "masked": _mean([one.flip_masked for one in errors]),
    }
    psnr = [float(one.psnr_db) for one in errors if np.isfinite(one.psnr_db)]
    return {
        "hole_share": _mean([one.hole_share for one in errors]),
        "wrong_share": _mean([one.wrong_share for one in errors]),
        "wrong_thickness_px": _percentiles([one.thickness_px for one in errors], 50, 99),
        "displacement_px": {**displacement, "max": max(float(one.displacement_max_px) for one in errors)},
        "flip": None if flip["mean"] is None else flip,
        "psnr_db": _mean(psnr),
        "psnr_worst_db": min(psnr, default=None),
        "ssim": _mean([one.ssim for one in errors]),
    }


def frame_summary(seconds: Sequence[float]) -> dict[str, float]:
    """p50, p95, p99 and max of frame times, in milliseconds. Raises ValueError for no frames at all."""
    if not len(seconds):
        raise ValueError("the time of one frame at least expected, found none")
    return _percentiles([1000.0 * one for one in seconds], 50, 95, 99)


def settling_summary(
    alike: Sequence[int | None], settled: Sequence[int | None], layers: Sequence[int] | None, *, held: int
) -> dict[str, Any]:
    """After how many frames a technique's views were like the geometry, of views that were ``held`` for so many frames.

    ``alike`` counts frames before the first that was like the geometry's (:func:`viewer.measuring.view_errors.alike`),
    ``settled`` those before nothing was left to capture; both have None for a view that never came there. ``layers`` says how
    many layers a view shows; None where there are none, as without a dataset.

    - ``alike_frames``: p50, p99 and max over the views that came there, null where none did; ``unlike``: the others;
    - ``settled_frames`` and ``unsettled``: the same of views that settled;
    - ``layers``: p50 and max over all views, null where there are none;
    - ``later_than_layers``: how many views took more frames to be like the geometry than they have layers. One that never was
      took as many as it was held for at least, and counts where those are more. Null where there are no layers.

    Raises ValueError for no views at all.
    """
    if not alike:
        raise ValueError("one view at least expected, found none")
    found: dict[str, Any] = {}
    for name, rest, some in (("alike_frames", "unlike", alike), ("settled_frames", "unsettled", settled)):
        known = [one for one in some if one is not None]
        found |= {name: _percentiles(known, 50, 99) if known else None, rest: len(some) - len(known)}
    if layers is None:
        return found | {"layers": None, "later_than_layers": None}
    return found | {
        "layers": _percentiles(layers, 50),
        "later_than_layers": sum(
            (held if after is None else after) > count for after, count in zip(alike, layers, strict=True)
        ),
    }


def _percentiles(values: Sequence[float], *percents: int) -> dict[str, float]:
    return {**{f"p{one}": float(np.percentile(values, one)) for one in percents}, "max": float(max(values))}


def _mean(values: Sequence[float | None]) -> float | None:
    """The mean of those that are known; None where none is."""
    known = [one for one in values if one is not None]
    return float(np.mean(known)) if known else None
