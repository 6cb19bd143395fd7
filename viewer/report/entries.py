"""What a comparison found, as plain values for ``report.json`` (schemas/report.json)."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from viewer.cells.cell_cache import CacheReport
from viewer.measuring.judge import Judge, Scored
from viewer.measuring.summary import ERRORS, frame_summary, summarise
from viewer.plan import Done
from viewer.report.options import CompareOptions
from viewer.report.pictures import save_picture, triptych
from viewer.report.promise import display_of, source_of, verdict_of
from viewer.report.tallies import NOTHING_TALLIED
from viewer.runtime.loop import FrameTimes
from viewer.scene.scene import WalkScene
from viewer.techniques.catalogue import MAIN, REFERENCE, TechniqueEntry

__all__ = [
    "by_technique",
    "frame_series",
    "gpu_times",
    "loading_of",
    "pops_of",
    "report_of",
    "scored_views",
    "technique_of",
    "worst_views",
]

_LATE = 1.1
"""A frame is late where it takes more than this many times what it should take (DESIGN section 6)."""
_AWKWARD = re.compile(r"[^\w.-]+")
"""Characters that a technique's name may have and that names of files are better without."""


def report_of(
    scene: WalkScene,
    device: str,
    options: CompareOptions,
    *,
    mode: str,
    views: int,
    seed: int | None,
    techniques: dict[str, dict[str, Any]],
    scores: Mapping[str, Sequence[Scored]],
) -> dict[str, Any]:
    """The part of a report that views and walks have in common; ``views`` is how many were scored of each technique."""
    verdict = verdict_of(scene, scores.get(MAIN), glint=options.glint, movers=bool(scene.movers.ids))
    rate = {name: 1.0 / max(one["frame_ms"]["p50"], 1e-9) for name, one in techniques.items()}
    return {
        "format_version": 7,
        "program": "compare-impostors",
        "source": source_of(scene),
        "verdict": verdict,
        "device": device,
        "display": display_of(scene.camera),
        "reference": REFERENCE,
        "mode": mode,
        "views": views,
        "seed": seed,
        "held_frames": options.settle if mode == "views" else None,
        "frames_per_second": options.frames_per_second,
        "budget_ms": options.budget_ms if math.isfinite(options.budget_ms) else None,
        "movers": _movers_told(scene, options, mode),
        "glint": options.glint,
        "techniques": techniques,
        "ratios": {
            name: {other: rate[name] / rate[other] if other in rate else None for other in ("full", "visible", "local")}
            for name in techniques
        },
    }


def technique_of(
    entry: TechniqueEntry,
    scored: Sequence[Scored] | None,
    *,
    seconds: Sequence[float],
    gpu: Sequence[float | None],
    done: Sequence[Done],
    target: float,
    settling: dict[str, Any] | None = None,
    pop: dict[str, Any] | None = None,
    update_pop: dict[str, Any] | None = None,
    loading: dict[str, Any] | None = None,
    tallied: Mapping[str, Any] = NOTHING_TALLIED,
) -> dict[str, Any]:
    """What the report says of a technique: its ``scored`` views, None for the reference, which nothing is wrong with.

    ``seconds``, ``gpu`` and ``done`` have a value for each of its frames: what it took, what the GPU says of that, and what
    was done. A frame should take ``target`` seconds. ``tallied`` is what :func:`viewer.report.tallies.tallied` says of it.
    """
    origin = entry.origin
    return {
        "layered": entry.layered,
        "origin": None if origin is None else {"function": origin.target, "version": origin.version},
        **(dict.fromkeys(ERRORS) if scored is None else summarise([one.errors for one in scored])),
        "settling": settling,
        "pop": pop,
        "update_pop": update_pop,
        "frame_ms": frame_summary(seconds),
        "gpu_ms": gpu_times(gpu),
        "late_share": float(np.mean([one > _LATE * target for one in seconds])),
        **_mean_done(done),
        "loading": loading,
        **tallied,
    }


def _movers_told(scene: WalkScene, options: CompareOptions, mode: str) -> dict[str, Any] | None:
    """What moved in the city, None where nothing did."""
    if not scene.movers.ids:
        return None
    return {
        "source": scene.movers.source,
        "objects": len(scene.movers.ids),
        "max_error_px": options.mover_frames.limit_px,
        "calculation": options.mover_frames.calculation,
        "time_s": options.movers_time if mode == "views" else None,
    }


def worst_views(judge: Judge, techniques: Sequence[str], out: Path) -> list[dict[str, Any]]:
    """Write pictures of the worst views in place of an earlier report's. Returns what the report says of them."""
    for stale in (out / "worst").glob("*-[0-9][0-9].png"):
        stale.unlink()
    entries = []
    for name in techniques:
        for rank, view in enumerate(judge.worst(name), start=1):
            scored, errors = view.scored, view.scored.errors
            file = f"worst/{_AWKWARD.sub('-', name)}-{rank:02d}.png"
            titles = ("geometry", name, "what is wrong")
            (out / "worst").mkdir(exist_ok=True)
            save_picture(
                out / file, triptych(view.truth, view.shown, view.regions.wrong, view.regions.holes, titles=titles)
            )
            entries.append(
                {
                    "technique": name,
                    "rank": rank,
                    "cell": scored.cell,
                    "eye": list(scored.pose.eye),
                    "azimuth_deg": math.degrees(scored.pose.azimuth),
                    "pitch_deg": math.degrees(scored.pose.pitch),
                    "time_s": scored.time,
                    "wrong_share": errors.wrong_share,
                    "hole_share": errors.hole_share,
                    "wrong_thickness_px": errors.thickness_px,
                    "displacement_px": errors.displacement_max_px,
                    "flip_mean": errors.flip_mean,
                    "picture": file,
                }
            )
    return entries


def by_technique(scored: Sequence[Scored]) -> dict[str, list[Scored]]:
    """Scores grouped by technique, in order."""
    grouped: dict[str, list[Scored]] = {}
    for one in scored:
        grouped.setdefault(one.technique, []).append(one)
    return grouped


def scored_views(
    scores: Mapping[str, Sequence[Scored]],
    *,
    frames: Mapping[str, Sequence[int | None]] | None = None,
    layers: Sequence[int] | None = None,
) -> dict[str, list[dict[str, Any]]]:
    """What the report says of every scored view.

    ``frames``: after how many frames the views of a technique were like the geometry, for those that were held; ``layers``: how
    many layers multi-mesh draws in each view.
    """
    known = frames or {}
    return {
        name: [
            {
                "time_s": one.time,
                "wrong_share": one.errors.wrong_share,
                "wrong_thickness_px": one.errors.thickness_px,
                "displacement_px": one.errors.displacement_max_px,
                "flip_mean": one.errors.flip_mean,
                "psnr_db": one.errors.psnr_db if math.isfinite(one.errors.psnr_db) else None,
                "frames": known[name][i] if name in known else None,
                "layers": None if layers is None else layers[i],
            }
            for i, one in enumerate(some)
        ]
        for name, some in scores.items()
    }


def frame_series(run: Sequence[FrameTimes]) -> dict[str, Any]:
    """Every frame of a walk: time, milliseconds, cell, and the frames at which the cell changed."""
    return {
        "time_s": [frame.time for frame in run],
        "frame_ms": [1e3 * frame.total for frame in run],
        "cell": [frame.cell for frame in run],
        "switch": [i for i, frame in enumerate(run) if frame.entered],
    }


def _mean_done(done: Sequence[Done]) -> dict[str, float]:
    """Means over frames of what was sent and captured."""
    whole = [
        (work.triangles + draws.triangles, work.draws + draws.draws, work.requests, work.pixels)
        for work, draws, *_ in done
    ]
    means = np.mean(np.array(whole, dtype=np.float64), axis=0).tolist()
    return dict(zip(("triangles", "draws", "requests", "captured_pixels"), means, strict=True))


def gpu_times(seconds: Sequence[float | None]) -> dict[str, float] | None:
    """Percentiles of what the GPU reports, milliseconds; None where it does not do so for all pictures."""
    times = [one for one in seconds if one is not None]
    return frame_summary(times) if len(times) == len(seconds) else None


def loading_of(report: CacheReport, run: Sequence[FrameTimes]) -> dict[str, Any]:
    """What loading cells took during a walk."""
    return {
        "seconds_waited": report.waited,
        "frames_waited": sum(frame.waiting > 0.0 for frame in run),
        "bytes_loaded": report.bytes_loaded,
        "largest_cache_bytes": report.largest_bytes,
    }


def pops_of(
    pops: Sequence[float] | None, *, switches: int | None = None, frames: int | None = None
) -> dict[str, Any] | None:
    """Pops at changes of cells, of which there were ``switches``, or of updates, which so many ``frames`` had.

    None where no pop was measured.
    """
    if not pops:
        return None
    count = {"frames": frames} if switches is None else {"switches": switches}
    return {**count, "mean": float(np.mean(pops)), "max": float(np.max(pops))}
