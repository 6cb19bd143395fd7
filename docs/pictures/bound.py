"""The figures of docs/bound.md: what a capture misses, how wide a strip of it can open, and strips side by side.

python docs/pictures/bound.py bound.png strips.png
"""

import sys

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.patches import Polygon

FRONT, BACK = np.array([[30, -1], [42, -1], [42, 9], [30, 9]]), np.array([[58, -8], [68, -8], [68, 12], [58, 12]])
C, M = np.array([0.0, 0.0]), np.array([4.0, -6.0])
CELL = np.array([[-10, -7], [10, -7], [10, 7], [-10, 7]])


def main() -> None:
    figure, axes = plt.subplots(1, 2, figsize=(8.5, 2.6), sharey=True, layout="constrained")
    for axis, title in zip(axes, ("within one object", "between two objects of a layer"), strict=True):
        axis.add_patch(Polygon(CELL, color="#56b4e9", alpha=0.35, lw=0))
        axis.add_patch(Polygon(FRONT, color="#999999"))
        axis.plot(*C, "ko", ms=4)
        axis.plot(*M, "k^", ms=5)
        axis.annotate("C", C, (-3.4, 0.8))
        axis.annotate("M", M, (0.4, -6.0))
        axis.set_aspect("equal")
        axis.set_title(title, fontsize=12)
        axis.set_axis_off()
        axis.set_xlim(-12, 72)
        axis.set_ylim(-9, 13)
    # The lower side of the front block is hidden from C by its front, and M sees it.
    x = np.array([42.0, -1.0])
    axes[0].plot([30, 42], [-1, -1], color="#d55e00", lw=3)
    _rays(axes[0], C + (x - C) * 30.0 / 42.0, x)
    # What M sees of the back block past the front one, and C does not.
    axes[1].add_patch(Polygon(BACK, color="#bbbbbb"))
    x = M + (x - M) * (58.0 - M[0]) / (42.0 - M[0])
    axes[1].plot([58, 58], [-58.0 / 30.0, x[1]], color="#d55e00", lw=3)
    _rays(axes[1], C + (x - C) * 30.0 / 58.0, x)
    figure.savefig(sys.argv[1] if len(sys.argv) > 1 else "bound.png", dpi=130, bbox_inches="tight")
    plt.close(figure)
    if len(sys.argv) > 2:
        strips(sys.argv[2])


def strips(path: str) -> None:
    """A row of houses whose fronts face just away from C: each is missed by less than the threshold, the row by more."""
    figure, axis = plt.subplots(figsize=(8.5, 2.4), layout="constrained")
    axis.add_patch(Polygon(CELL, color="#56b4e9", alpha=0.35, lw=0))
    for k in range(4):
        left = 26.0 + 11.0 * k
        axis.add_patch(Polygon([(left, 0.6), (left + 10.6, 0.6), (left + 10.6, 9.0), (left, 9.0)], color="#999999"))
        axis.plot([left, left + 10.6], [0.6, 0.6], color="#d55e00", lw=3)
        axis.plot(*np.array([M, (left, 0.6)]).T, "k--", lw=0.6)
    axis.plot(*np.array([M, (26.0 + 43.6, 0.6)]).T, "k--", lw=0.6)
    axis.plot(0.0, 1.5, "ko", ms=4)
    axis.plot(*M, "k^", ms=5)
    axis.annotate("C", (0.0, 1.5), (-3.0, 2.0))
    axis.annotate("M", M, (0.4, -6.0))
    axis.set_aspect("equal")
    axis.set_axis_off()
    axis.set_xlim(-12, 72)
    axis.set_ylim(-9, 11)
    figure.savefig(path, dpi=110, bbox_inches="tight")
    plt.close(figure)


def _rays(axis: plt.Axes, y: np.ndarray, x: np.ndarray) -> None:
    axis.plot(*np.array([C, x]).T, color="#0072b2", lw=1)
    for point, name, shift in ((y, "Y", (-2.2, 0.6)), (x, "X", (0.8, 0.6))):
        axis.plot(*np.array([M, point]).T, "k--", lw=0.8)
        axis.plot(*point, "o", color="#d55e00", ms=4)
        axis.annotate(name, point, point + np.array(shift))


if __name__ == "__main__":
    main()
