"""What techniques count while they draw (objects that move, pixels that were cast, boxes), and what reports say of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

from viewer.caching.rules import CacheRules
from viewer.casting.frame import CastTally
from viewer.casting.rules import CastRules
from viewer.placed.rules import PlacedRules
from viewer.plan import Technique
from viewer.scene.scene import WalkScene
from viewer.techniques.catalogue import TechniqueRules
from viewer.techniques.image_cache import CacheTally, ImageCache
from viewer.techniques.placed_images import PlacedImages, PlacedTally
from viewer.techniques.ray_cast import RayCasting, limit_px
from viewer.techniques.virtual_frames import FrameTally
from viewer.techniques.with_movers import WithMovers

__all__ = ["NOTHING_TALLIED", "Tallies", "tallied", "tallies_of"]

NOTHING_TALLIED: Mapping[str, Any] = MappingProxyType({"movers": None, "rays": None, "boxes": None, "placed": None})
"""What the report says of a technique that counts nothing."""


class Tallies(NamedTuple):
    """What a technique has counted so far; None of what it does not draw."""

    movers: FrameTally | None = None
    rays: CastTally | None = None
    boxes: CacheTally | None = None
    placed: PlacedTally | None = None


def tallies_of(technique: Technique) -> Tallies:
    """What a technique has counted."""
    moving = technique.tally if isinstance(technique, WithMovers) else None
    inner = technique.technique if isinstance(technique, WithMovers) else technique
    return Tallies(
        moving,
        inner.tally if isinstance(inner, RayCasting) else None,
        inner.tally if isinstance(inner, ImageCache) else None,
        inner.tally if isinstance(inner, PlacedImages) else None,
    )


def tallied(tallies: Sequence[Tallies], scene: WalkScene, rules: TechniqueRules) -> Mapping[str, Any]:
    """What the report says of all ``tallies`` of a technique: ``movers``, ``rays``, ``boxes``, ``placed`` images, or None."""
    return {
        "movers": _movers([one.movers for one in tallies if one.movers is not None]),
        "rays": _rays([one.rays for one in tallies if one.rays is not None], scene, rules.rays),
        "boxes": _boxes([one.boxes for one in tallies if one.boxes is not None], rules.images),
        "placed": _placed([one.placed for one in tallies if one.placed is not None], rules.placed),
    }


def _movers(tallies: Sequence[FrameTally]) -> dict[str, Any] | None:
    """Means of a frame over all ``tallies``; None where nothing moved."""
    if not tallies:
        return None
    frames, geometry, captured, reused, ended, shown, hidden = (sum(one) for one in zip(*tallies, strict=True))
    return {
        "geometry": geometry / max(frames, 1),
        "captured": captured / max(frames, 1),
        "reused": reused / max(frames, 1),
        "hidden": hidden / max(frames, 1),
        "valid_frames": shown / ended if ended else None,
    }


def _rays(tallies: Sequence[CastTally], scene: WalkScene, rules: CastRules) -> dict[str, Any] | None:
    """What pixels were over all ``tallies``, as shares of all, and by which rules; None where no rays are cast."""
    if not tallies:
        return None
    sum_ = CastTally()
    for one in tallies:
        sum_ = sum_.plus(one)
    counts = sum_._asdict()
    frames, kept = max(counts.pop("frames"), 1), counts.pop("kept_px")
    pixels = max(sum(counts.values()), 1)
    return {
        "near_field_m": rules.near_field,
        "caster": rules.caster,
        "reuse": rules.reuse,
        "reuse_error_px": limit_px(scene, rules),
        "most": rules.rays,
        "cast": sum_.rays / frames,
        **{f"{name}_share": count / pixels for name, count in counts.items()},
        "kept_px": kept,
    }


def _boxes(tallies: Sequence[CacheTally], rules: CacheRules) -> dict[str, Any] | None:
    """What boxes were over all ``tallies``, a frame, and by which rules; None where there are none."""
    if not tallies:
        return None
    sum_ = CacheTally()
    for one in tallies:
        sum_ = sum_.plus(one)
    counts = sum_._asdict()
    frames, kept, most = max(counts.pop("frames"), 1), counts.pop("kept_px"), counts.pop("bytes")
    return {
        "keep": rules.keep,
        "error_px": rules.error_px,
        "leaf_triangles": rules.leaf_triangles,
        "depth": rules.depth,
        "eager": rules.eager,
        "most_bytes": rules.bytes,
        **{name: count / frames for name, count in counts.items()},
        "kept_px": kept,
        "bytes": most,
    }


def _placed(tallies: Sequence[PlacedTally], rules: PlacedRules) -> dict[str, Any] | None:
    """What frames were over all ``tallies``, as shares of them, the most triangles of one, what warped; None without any."""
    if not tallies:
        return None
    sum_ = PlacedTally()
    for one in tallies:
        sum_ = sum_.plus(one)
    frames = max(sum_.frames, 1)
    return {
        "warp": rules.warp,
        "budget": sum_.budget,
        "image_share": sum_.image / frames,
        "outside_share": sum_.outside / frames,
        "tilted_share": sum_.tilted / frames,
        "most_triangles": sum_.most,
        "over_budget": sum_.over,
        "samples": sum_.samples / frames,
    }
