"""One frame of casting: from the depths of what was drawn to the pixels that complete the picture (paper sections 4.1 and 5.2).

All pixels are classified; those that nothing shows well enough get rays, the worst first where there are more than a frame may
cast: records by their distance, and of pixels that are equally bad every n-th (paper section 5.2). What stays without a ray is
shown as it was cast last, or not at all, and counted.
"""

from __future__ import annotations

import math
import time
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mmi.foundation.kernels import kernel
from mmi.rays.horizon_map import Horizon
from viewer.casting.far_field import FarField
from viewer.casting.open_pixels import CAST, REUSED, TILE, Rays, classify
from viewer.casting.panorama import SAMPLE, Panorama, store
from viewer.casting.rules import CastRules
from viewer.casting.surfaces import cast_pixels, shown_again
from viewer.computed import CAST_PIXEL, CastPixels

__all__ = ["CastTally", "cast_frame", "directions_of", "record_errors", "worst_first"]


_STEEPEST = 0.999
"""Of the near field: from farther away, all that is far may be anywhere."""
_LATEST = 0.1
"""The tangent of the angle by which something may be off that is shown for want of rays."""


class CastTally(NamedTuple):
    """What pixels of ``frames`` were, in all; ``kept_px`` is the largest error in pixels that a pixel was shown with."""

    frames: int = 0
    covered: int = 0
    sky: int = 0
    reused: int = 0
    hit: int = 0
    missed: int = 0
    late: int = 0
    """Shown although their error was too large, because the frame had no more rays."""
    unknown: int = 0
    """Not shown, because nothing was known of them and the frame had no more rays."""
    kept_px: float = 0.0

    @property
    def rays(self) -> int:
        """That were cast."""
        return self.hit + self.missed

    def plus(self, other: CastTally) -> CastTally:
        """Both together."""
        return CastTally(
            self.frames + other.frames,
            self.covered + other.covered,
            self.sky + other.sky,
            self.reused + other.reused,
            self.hit + other.hit,
            self.missed + other.missed,
            self.late + other.late,
            self.unknown + other.unknown,
            max(self.kept_px, other.kept_px),
        )


def record_errors(
    distances: NDArray[np.float32], rules: CastRules, *, focal: float, limit_px: float
) -> NDArray[np.float32]:
    """(records,) by how many pixels far surfaces may be off that were cast from these ``distances``, metres.

    What is at least R away is seen from d beside at an angle of at most asin(d / R) to where it was. Infinite for what must not
    be shown, even where there are no rays for it: what nobody has cast, and unless each texel's own error counts (``reuse``
    "hits"), what was cast from a tenth of R away, if the limit does not allow as much.
    """
    share = np.minimum(distances / np.float32(rules.near_field), np.float32(_STEEPEST))
    found: NDArray[np.float32] = np.float32(focal) * np.tan(np.arcsin(share))
    lost = ~np.isfinite(distances)
    if rules.reuse == "bound":
        lost |= found > max(limit_px, focal * _LATEST)
    found[lost] = np.inf
    return found


def worst_first(errors: NDArray[np.float32], count: int) -> NDArray[np.int64]:
    """Places of ``count`` of ``errors`` (n,), in pixels: the largest, and of equal ones every n-th, in their order."""
    if count >= len(errors):
        return np.arange(len(errors))
    if count <= 0:
        return np.zeros(0, dtype=np.int64)
    threshold = np.partition(errors, len(errors) - count)[len(errors) - count]
    worse, equal = np.flatnonzero(errors > threshold), np.flatnonzero(errors == threshold)
    left = count - len(worse)
    return np.sort(np.concatenate([worse, equal[np.arange(left) * len(equal) // left]]))


@kernel(error_model="numpy", nogil=True)
def directions_of(pixels: NDArray[np.int32], width: int, rays: Rays) -> NDArray[np.float64]:
    """(n, 3) unit directions, world, through the middles of ``pixels`` (n,), places in a picture of ``width`` columns."""
    unit = np.empty((len(pixels), 3))
    for k in range(len(pixels)):
        x, y = (rays.left + pixels[k] % width) / rays.focal, -(rays.top + pixels[k] // width) / rays.focal
        scale = 1.0 / math.sqrt(x * x + y * y + 1.0)
        for n in range(3):
            unit[k, n] = scale * (x * rays.axes[0, n] + y * rays.axes[1, n] - rays.axes[2, n])
    return unit


def cast_frame(
    depths: NDArray[np.float32],
    first_column: int,
    rays: Rays,
    horizon: Horizon,
    panorama: Panorama,
    far: FarField,
    near_objects: NDArray[np.bool_],
    rules: CastRules,
    *,
    limit_px: float,
    most: int | None,
    share: float = 0.0,
    settling: int = 0,
) -> tuple[CastPixels, CastTally]:
    """What completes a picture whose near field has ``depths`` (h, w), and what its pixels were.

    ``first_column`` is where the picture begins in its view. At most ``most`` rays are cast for what is off by more than
    ``limit_px`` pixels; where these suffice, more for a ``share`` of the others that are off at all, and for ``settling`` of
    them.
    """
    height, width = depths.shape
    record_error = record_errors(panorama.distances(rays.eye), rules, focal=rays.focal, limit_px=limit_px)
    found = panorama.room(height, width)

    def classified(share: int) -> tuple[int, int, int]:
        """Classify a worker's rows of tiles: where the list of their open pixels begins and ends, and how many are sky."""
        begin = width * sum(min(TILE, height - top) for one in range(share) for top in range(TILE * one, height, apart))
        end, sky = classify(
            depths,
            share,
            far.workers,
            rays,
            rules.near_field,
            horizon.slopes,
            horizon.first,
            horizon.per_radian,
            panorama.texels,
            record_error,
            near_objects,
            limit_px,
            rules.reuse == "hits",
            found,
            begin,
        )
        return begin, end, sky

    apart = TILE * far.workers
    others = [far.threads.submit(classified, share) for share in range(1, far.workers)]
    parts = [classified(0), *(one.result() for one in others)]
    # Few of all pixels are open; from here on, numbers are places among them.
    pixels, texel, error = (
        np.concatenate([one[begin:end] for begin, end, _ in parts]) for one in (found.pixel, found.texel, found.error)
    )
    kind = found.state.reshape(-1)[pixels]
    wanted = np.flatnonzero(kind == CAST)
    chosen = wanted if most is None else wanted[worst_first(error[wanted], most)]
    if (share or settling) and len(chosen) == len(wanted):
        stale = np.flatnonzero((kind == REUSED) & (error > 0.0))
        count = math.ceil(share * len(stale)) + settling
        more = stale[worst_first(error[stale], count if most is None else min(count, most - len(chosen)))]
        chosen = np.concatenate([chosen, more])
    rayless = np.ones(len(pixels), dtype=np.bool_)  # shown as they are known
    rayless[chosen] = False

    shown = np.flatnonzero(rayless & (texel >= 0))
    kept = float(error[shown].max(initial=0.0))
    again = far.threads.submit(  # while rays are cast
        shown_again, pixels[shown], width, first_column, texel[shown], near_objects, rays, panorama.texels
    )
    start = time.perf_counter()
    directions = directions_of(pixels[chosen], width, rays)
    hits = far.caster.first_hits(rays.eye, directions, nearest=rules.near_field, pixel_angle=1.0 / rays.focal)
    looks, points = cast_pixels(pixels[chosen], width, first_column, directions, hits, rays, far.surfaces)
    whole = np.dtype(("V", CAST_PIXEL.itemsize))  # copied several times as fast as field by field
    fresh = looks.view(whole)[hits.triangle >= 0]
    old = again.result()  # before what it shows is overwritten
    if len(chosen):
        store(panorama.record_at(rays.eye), directions, -rays.axes[2], points, looks.view(SAMPLE), panorama.texels)
    seconds = time.perf_counter() - start if len(chosen) else 0.0
    left = wanted[rayless[wanted]]
    known = int((texel[left] >= 0).sum())
    sky = sum(some for *_, some in parts)
    tally = CastTally(
        frames=1,
        covered=depths.size - sky - len(pixels),
        sky=sky,
        reused=int(rayless.sum()) - len(left),
        hit=len(fresh),
        missed=len(chosen) - len(fresh),
        late=known,
        unknown=len(left) - known,
        kept_px=kept,
    )
    samples = np.concatenate([fresh, old.view(whole)]).view(CAST_PIXEL)
    return CastPixels(samples, len(fresh), seconds), tally
