"""How fast the viewer's studio draws, without a browser: what a frame takes while somebody walks, and of what.

    python benchmarks/studio.py OUT [--size 1280x720] [--frames 60]

Median milliseconds a frame for each mode, from asking for it to the picture: rendering, reading the picture back, composing,
and all. Encoding and the way to a page come on top, in other threads (``benchmarks/viewing.py``).
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

from mmi.programs.command_line import size_option
from viewer.window.commands import LookChange, WalkCommand
from viewer.window.studio import Studio

LOOKS = (
    {"mode": "one", "right": "multi-mesh"},
    {"mode": "one", "right": "full"},
    {"mode": "one", "right": "multi-mesh-dynamic"},
    {"mode": "swipe", "right": "multi-mesh"},
    {"mode": "side", "right": "multi-mesh"},
    {"mode": "difference", "right": "multi-mesh"},
    {"mode": "wrong", "right": "multi-mesh"},
    {"mode": "one", "right": "multi-mesh", "show": "layers"},
    {"mode": "one", "right": "multi-mesh", "show": "depth"},
    {"mode": "one", "right": "multi-mesh", "show": "objects"},
)


def measured(studio: Studio, look: dict[str, str], frames: int) -> tuple[float, dict[str, float]]:
    studio.tell("walker", LookChange({"show": "picture", **look}))
    studio.answer("walker", WalkCommand("tour")).result()
    for _ in range(5):
        studio.ask("walker").result()
    seconds, parts = [], []
    for _ in range(frames):
        start = time.perf_counter()
        parts.append(studio.ask("walker").result().header["ms"])
        seconds.append(time.perf_counter() - start)
    return 1e3 * float(np.median(seconds)), {
        name: float(np.median([one[name] for one in parts])) for name in ("render", "read", "compose")
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--size", type=size_option, default=(1280, 720))
    parser.add_argument("--frames", type=int, default=60)
    options = parser.parse_args()
    with Studio(options.dataset) as studio:
        print(studio.device)
        studio.join("walker", options.size)
        print(f"{'shown':40} {'render':>8} {'read':>8} {'compose':>8} {'all':>8}  ms")
        for look in LOOKS:
            whole, parts = measured(studio, look, options.frames)
            told = " ".join(f"{value:8.1f}" for value in (*parts.values(), whole))
            print(f"{' '.join(look.values()):40} {told}")


if __name__ == "__main__":
    main()
