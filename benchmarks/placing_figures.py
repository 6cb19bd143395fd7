"""The plots of Aliaga & Lastra 1999, section 6, for other models, beside the paper's values: figures 13 to 16 and table 1.

    python benchmarks/placing_figures.py pipes montmartre:2 plant.glb -o out/placing --percents 12.5,15,20,25,30,40,50
    python benchmarks/placing_figures.py -o out/placing                               # draws again what is known

Images are placed for budgets that are so many percent of a model's triangles, and aim at 6 percent of the model less; none is
captured. What is found is kept as DIR/placing_figures.json, to which each run adds its models.

- figure13.png: images by budget. To the left, as in the paper, for each triangle of the model; to the right their number. The
  paper shows a theoretical best case, geometry of one density everywhere, and a near worst case, of large differences in
  density, and derives neither. Here images are placed for two such models: triangles spread evenly in a cube, and triangles
  whose logarithms of distances to a point are spread evenly, from a tenth of the cube to all of it, so that they are a thousand
  times as dense in the middle as outside.
- figure14-MODEL.png: triangles in view along a closed path through the model, and those that are left.
- figure15.png: of points with images, how many have one, two, three and more.
- figure16.png: what is left of the views that images were chosen for, compared with what was aimed at.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray
from placing import FOV, PAPER, city_of, closeness, flown, placed, triangles_of

from mmi.inspection.figures import EMPHASIS, INK, SMALL, new_figure, save, tidy
from viewer.placing.directions import TURN
from viewer.placing.grid_check import check_grid
from viewer.placing.model_cells import ModelCells, cells_for
from viewer.placing.placements import Placements
from viewer.placing.refining import solution_grid
from viewer.placing.rules import PlacingRules
from viewer.placing.solution_grid import SolutionGrid, domain_of

EVEN, UNEVEN = "even density", "uneven density"
BOUNDS = {EVEN: "best case", UNEVEN: "worst case"}
COLORS = ("#D55E00", "#0072B2", "#009E73", "#7B4FA3", "#E69F00")
AIM = 0.06
"""Of the model's triangles, by which less than the budget is aimed at."""
HISTOGRAM = {1: 14_012, 2: 4_311, 3: 862, 4: 40}
"""Points of figure 15 by their images."""
FRAMES = 600


def bounding(name: str, count: int = 20_000) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Positions (v, 3) and triangles (t, 3) of a model of small triangles in a cube, of even or uneven density."""
    rng = np.random.default_rng(1)
    if name == EVEN:
        middles, sizes = rng.uniform(-1.0, 1.0, (count, 3)), np.full(count, 0.002)
    else:
        ways = rng.normal(size=(count, 3))
        away = 10.0 ** rng.uniform(-1.0, 0.0, count)
        middles, sizes = away[:, None] * ways / np.linalg.norm(ways, axis=1, keepdims=True), 0.002 * away
    corners = middles[:, None] + sizes[:, None, None] * rng.uniform(-1.0, 1.0, (count, 3, 3))
    return 100.0 * corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3)


def along_a_path(
    cells: ModelCells, grid: SolutionGrid, found: list[Placements], rules: PlacingRules
) -> dict[str, list[int]]:
    """Triangles in view and left on a figure of eight through the model, at a quarter of its height, looking ahead."""
    low, high = cells.bounds
    turn = np.linspace(0.0, TURN, FRAMES, endpoint=False)
    half = 0.45 * (high - low)
    eyes = np.stack([half[0] * np.sin(turn), half[1] * np.sin(2.0 * turn), 0.0 * turn], axis=1) + 0.5 * (low + high)
    eyes[:, 2] = low[2] + 0.25 * (high - low)[2]
    seen, left = flown(
        cells, grid, found, rules, eyes, np.arctan2(2.0 * half[1] * np.cos(2.0 * turn), half[0] * np.cos(turn))
    )
    return {"seen": seen.tolist(), "left": left.tolist()}


def short(name: str) -> str:
    """What a model is called."""
    return Path(name).name.split(".")[0].replace(":", " --detail ")


def measured(name: str, percents: list[float]) -> list[dict[str, Any]]:
    """A row for each budget."""
    bounds = name in BOUNDS
    positions, triangles = bounding(name) if bounds else triangles_of(city_of(name))
    name, rows = short(name), []
    for percent in percents:
        budget = round(0.01 * percent * len(triangles))
        target = max(budget - round(AIM * len(triangles)), budget // 2)
        rules = PlacingRules(budget, target, FOV, depth=4 if bounds else 5)
        start = time.perf_counter()
        cells = cells_for(positions, triangles, rules)
        grid = solution_grid(cells, rules, domain_of(cells))
        needs, gridded = grid.needs(), time.perf_counter()
        found, ms = placed(cells, grid, needs, rules)
        checked = check_grid(cells, grid, found, rules)
        images = np.bincount([len(one.images) for one in found])
        rows.append(
            {
                "percent": percent,
                "triangles": len(triangles),
                "budget": budget,
                "target": target,
                "cells": len(cells.counts),
                "points": len(found),
                "images": int(np.arange(len(images)) @ images),
                "images_a_point": images.tolist(),
                "seconds": gridded - start + 1e-3 * ms * len(found),
                "most": checked.most,
                "ranges": checked.ranges,
                "over": checked.over,
                "close": closeness(cells, grid, found, rules).round(5).tolist(),
                "path": {} if bounds else along_a_path(cells, grid, found, rules),
            }
        )
        told(name, rows[-1])
    return rows


def told(name: str, row: dict[str, Any]) -> None:
    """A line of table 1."""
    print(
        f"| {name}, {row['triangles']:,} | {row['percent']:g} % | {row['budget']:,} | {row['cells']:,} | {row['points']:,} | "
        f"{row['images']:,} | {row['seconds']:.0f} s | {row['most']:,} | {row['over']} of {row['ranges']:,} |",
        flush=True,
    )


def labelled(axes: Axes, across: str, up: str, title: str) -> None:
    """What all plots have."""
    axes.set_xlabel(across, fontsize=SMALL)
    axes.set_ylabel(up, fontsize=SMALL)
    axes.set_title(title, fontsize=SMALL + 2, loc="left")
    axes.tick_params(which="both", labelsize=SMALL)
    axes.legend(fontsize=SMALL, frameon=False)
    tidy(axes)


def storage(known: dict[str, list[dict[str, Any]]], out: Path) -> None:
    """Figure 13."""
    figure = new_figure(10.0, 4.2)
    for axes, each, up in zip(
        figure.subplots(1, 2), (True, False), ("images for each triangle of the model", "images"), strict=True
    ):
        for name, (triangles, found) in PAPER.items():
            percents = [100.0 * budget / triangles for budget in found]
            images = np.array([images for images, _ in found.values()])
            axes.plot(
                percents,
                images / (triangles if each else 1),
                "o--",
                ms=3,
                lw=0.8,
                color="#999999",
                label="paper: power plant, torpedo room, house, pipes" if name == "pipes" else None,
            )
            axes.annotate(
                name, (percents[0], images[0] / (triangles if each else 1)), fontsize=SMALL - 2, color="#777777"
            )
        colors = iter(COLORS)
        for name, rows in known.items():
            bound = BOUNDS.get(name)
            percents = [row["percent"] for row in rows]
            images = np.array([row["images"] for row in rows])
            label = f"{bound}: {name} (left: for a million)" if bound else f"{name}, {rows[0]['triangles']:,} triangles"
            axes.plot(
                percents,
                images / ((1e6 if bound else rows[0]["triangles"]) if each else 1),
                lw=1.2,
                marker="" if bound else "o",
                ms=4,
                color=INK if bound else next(colors),
                ls=":" if name == UNEVEN else "-",
                label=label,
            )
        axes.set_yscale("log")
        labelled(axes, "budget, percent of the model", up, "placed images by budget (paper, figure 13)")
        axes.get_legend().remove()
    figure.legend(*axes.get_legend_handles_labels(), fontsize=SMALL, frameon=False, ncols=3, loc="outside lower center")
    save(figure, out / "figure13.png")


def path(name: str, row: dict[str, Any], out: Path) -> None:
    """Figure 14."""
    figure = new_figure(7.0, 3.2)
    axes = figure.subplots()
    seen, left = (np.array(row["path"][name]) / 1000.0 for name in ("seen", "left"))
    axes.plot(seen, color="#999999", lw=1.0, label="in cells in view")
    axes.plot(left, color=COLORS[1], lw=1.0, label="without those that an image replaces")
    axes.axhline(row["budget"] / 1000.0, color=EMPHASIS, lw=1.0, label="budget")
    axes.axhline(row["target"] / 1000.0, color=EMPHASIS, lw=0.8, ls=":", label="aimed at")
    axes.set_ylim(0.0, 1.4 * seen.max())  # room for the legend
    labelled(
        axes, "frame", "thousand triangles", f"a path through {name}, {row['triangles']:,} triangles (paper, figure 14)"
    )
    save(figure, out / f"figure14-{name.split()[0]}.png")


def histogram(chosen: dict[str, dict[str, Any]], out: Path) -> None:
    """Figure 15."""
    figure = new_figure(7.0, 3.2)
    axes = figure.subplots()
    counts = {f"{name}, {row['percent']:g} %": row["images_a_point"][1:] for name, row in chosen.items()}
    counts["paper: power plant"] = list(HISTOGRAM.values())
    wide = 0.8 / len(counts)
    for n, ((label, found), color) in enumerate(zip(counts.items(), (*COLORS[: len(chosen)], "#999999"), strict=True)):
        share = 100.0 * np.array(found) / max(sum(found), 1)
        axes.bar(
            np.arange(1, len(share) + 1) + (n - 0.5 * (len(counts) - 1)) * wide, share, wide, color=color, label=label
        )
    labelled(axes, "images", "percent of points with images", "images of a point (paper, figure 15)")
    save(figure, out / "figure15.png")


def closenesses(chosen: dict[str, dict[str, Any]], out: Path) -> None:
    """Figure 16."""
    figure = new_figure(7.0, 3.2)
    axes = figure.subplots()
    for (name, row), color in zip(chosen.items(), COLORS, strict=False):
        left = 100.0 * np.array(row["close"])
        within = f"{np.mean(np.abs(left - 100.0) <= 2.0):.1%} within 2 %"
        axes.hist(
            left,
            np.linspace(95.0, 100.0, 51),
            weights=np.full(len(left), 100.0 / len(left)),
            histtype="step",
            color=color,
            lw=1.2,
            label=f"{name}, {row['percent']:g} %: {within}",
        )
    axes.axvspan(98.0, 100.0, color="#DDDDDD", lw=0.0, zorder=0, label="paper: typically within 2 %")
    labelled(
        axes,
        "triangles left, percent of those aimed at",
        "percent of images",
        "views that images are chosen for (paper, figure 16)",
    )
    save(figure, out / "figure16.png")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "models", nargs="*", metavar="MODEL", help="a preset of citygen (a detail after a colon), or a file"
    )
    parser.add_argument("-o", "--out", type=Path, required=True, metavar="DIR")
    parser.add_argument(
        "--percents", default="12.5,15,20,25,30,40,50", metavar="N,...", help="budgets (default: %(default)s)"
    )
    parser.add_argument(
        "--shown", type=float, default=15.0, metavar="N", help="whose figures 14 to 16 are (default: %(default)s)"
    )
    parser.add_argument("--bounds", action="store_true", help="also the best and the worst case of figure 13")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    file = options.out / "placing_figures.json"
    known: dict[str, list[dict[str, Any]]] = json.loads(file.read_text()) if file.exists() else {}
    percents = [float(one) for one in options.percents.split(",")]
    print("| model | budget | triangles | cells | points | images | seconds | most of a view | ranges over |")
    print("|" + "---|" * 9)
    for name in [*options.models, *(BOUNDS if options.bounds else ())]:
        known[short(name)] = measured(name, percents)
        file.write_text(json.dumps(known) + "\n", encoding="utf-8")
    for model, (triangles, found) in PAPER.items():
        for budget, (images, hours) in found.items():
            row = f"{model}, {triangles:,} | {100.0 * budget / triangles:.3g} % | {budget:,}"
            print(f"| paper: {row} | | | {images:,} | {hours} h | | |")
    known = dict(sorted(known.items(), key=lambda one: one[0] in BOUNDS))
    storage(known, options.out)
    chosen = {
        name: min(rows, key=lambda row: abs(row["percent"] - options.shown))
        for name, rows in known.items()
        if name not in BOUNDS
    }
    for name, row in chosen.items():
        path(name, row, options.out)
    histogram(chosen, options.out)
    closenesses(chosen, options.out)


if __name__ == "__main__":
    main()
