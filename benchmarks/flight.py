"""Duckstein's flight over an urban scene (1998, figures 7 to 9): how long images last, and what a frame takes.

    python benchmarks/flight.py out/flight

Two roads with six trucks each, which drive 0.5 and 1.0 units a frame; two houses and two trees between them. In 256 frames the
viewer flies on by 0.9 units a frame, slightly up, and looks further and further down. Whatever moves or stands may be an image,
which may be wrong by 4 pixels of 512 (60 degrees) and is made where it is predicted to last two frames, or by the common
calculation, as in the paper. Units are metres. Writes a plot and flight.json; times are the medians of three flights.

--finer cuts every triangle of the objects into its square: images pay where objects are costly. With 1, a truck has 728
triangles, and the whole scene takes software OpenGL half a millisecond.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from dataclasses import replace
from pathlib import Path

import networkx as nx
import numpy as np
from matplotlib.figure import Figure
from PIL import Image
from shapely.geometry import LineString, box
from walks import triangle_lattice

from citygen.generate import generate
from citygen.shapes.solids import compacted, join, lathe
from citygen.traffic.vehicles import KINDS, vehicle_mesh
from mmi.appearance.city_mesh import build_city_mesh
from mmi.appearance.ground_mesh import ground_mesh
from mmi.city.model import PLAIN, City, CityObject, Prism, TriangleMesh
from mmi.foundation.camera import Camera, View, view_towards
from mmi.movers.movers import Movers
from viewer.drawing.renderer import Renderer
from viewer.plan import Budget, Ground, Moving, Plan, Sky, Technique
from viewer.techniques.virtual_frames import FrameRules
from viewer.techniques.with_movers import WithMovers

_FRAMES, _RATE, _LIMIT = 256, 30.0, 4.0
_CAMERA = Camera(512, 512, math.radians(60.0))
_ROUNDS = 3
_BIN = 16
_ROADS = ((-12.0, 0.5), (12.0, -1.0))
"""Where the roads are, and how many units trucks on them go in a frame."""


class _Empty:
    """A technique that draws all ``tiles`` of the ground, and the sky."""

    name = "flight"

    def __init__(self, tiles: int) -> None:
        self._plan = Plan((Ground(tuple(range(tiles))), Sky()))

    def plan(self, view: View, *, now: float, budget: Budget) -> Plan:  # noqa: ARG002
        return self._plan


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--finer", type=int, default=4)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    movers = _scene(options.finer)
    print(
        f"{sum(len(movers.meshes[kind].triangles) for kind in movers.kinds):,} triangles of {len(movers.ids)} objects"
    )
    city = _ground()
    ground = ground_mesh(city, margin=400.0)
    empty = _Empty(len(ground.triangle_counts))
    rules = FrameRules(limit_px=_LIMIT, nearest=1.0, coarsest=4.0, largest=512, thrifty=False)
    variants: dict[str, FrameRules | None] = {
        "geometry": None,
        "common": replace(rules, calculation="common"),
        "predictive": rules,
        "predictive, where it pays": replace(rules, thrifty=True),
    }
    times: dict[str, list[np.ndarray]] = {name: [] for name in variants}
    lives: dict[str, np.ndarray] = {}
    told: dict[str, dict[str, float | None]] = {}
    with Renderer(build_city_mesh(city), ground, size=(512, 512), movers=movers) as renderer:
        for _ in range(_ROUNDS):
            for name, rule in variants.items():
                technique = WithMovers(empty, movers, _CAMERA, rules=rule)
                found, plans = _fly(technique, renderer)
                times[name].append(found)
                lives[name] = _lives(plans, len(movers.ids))
                tally = technique.tally
                told[name] = {
                    "geometry": tally.geometry / tally.frames,
                    "captured": tally.captured / tally.frames,
                    "reused": tally.reused / tally.frames,
                    "valid_frames": tally.shown / tally.ended if tally.ended else None,
                }
        full = WithMovers(empty, movers, _CAMERA)
        frames = [(_view(i), full.plan(_view(i), now=i / _RATE, budget=Budget())) for i in (0, 85, 170, 255)]
        pictures = [renderer.draw(plan, view).color for view, plan in frames]
    Image.fromarray(np.hstack(pictures)).save(options.out / "flight_views.png")
    medians = {name: np.median(found, axis=0) for name, found in times.items()}
    for name, one in told.items():
        one["frame_ms"] = 1e3 * float(np.mean(medians[name]))
        one["times_as_fast"] = float(np.mean(medians["geometry"]) / np.mean(medians[name]))
        print(name, {key: None if value is None else round(value, 2) for key, value in one.items()})
    (options.out / "flight.json").write_text(json.dumps(told, indent=1) + "\n", encoding="utf-8")
    _plot(medians, lives, options.out / "flight.png")


def _fly(technique: Technique, renderer: Renderer) -> tuple[np.ndarray, list[Plan]]:
    """Seconds of every frame, planning included, and the plans."""
    found, plans = np.zeros(_FRAMES), []
    for i in range(_FRAMES):
        start = time.perf_counter()
        plan = technique.plan(_view(i), now=i / _RATE, budget=Budget(1.0))
        planned = time.perf_counter() - start
        found[i] = planned + renderer.draw(plan, _view(i), read=False).seconds
        plans.append(plan)
    return found, plans


def _view(frame: int) -> View:
    """Where the viewer is in a frame: forwards over both roads, slightly up, looking down more and more."""
    share = frame / (_FRAMES - 1)
    eye = np.array([0.0, -240.0 + 0.9 * frame, 18.0 + 14.0 * share])
    return view_towards(
        eye, 0.5 * math.pi, math.radians(-4.0 - 26.0 * share), focal=_CAMERA.focal, window=_CAMERA.window
    )


def _lives(plans: list[Plan], n: int) -> np.ndarray:
    """(frames,) how many frames the images that a frame shows last, in the mean; NaN where it shows none."""
    since = np.full(n, -1)
    spans: list[tuple[int, int]] = []

    def end(one: int, frame: int) -> None:
        if since[one] >= 0:
            spans.append((int(since[one]), frame))
        since[one] = -1

    for frame, plan in enumerate(plans):
        for draw in plan.draws:
            if isinstance(draw, Moving):
                for one in draw.which.tolist():
                    end(one, frame)
        for request in plan.requests:
            (draw,) = request.draws
            assert isinstance(draw, Moving)
            for one in draw.which.tolist():
                end(one, frame)
                since[one] = frame
    sums, counts = np.zeros(_FRAMES), np.zeros(_FRAMES)
    for start, stop in spans:
        sums[start:stop] += stop - start
        counts[start:stop] += 1
    return np.divide(sums, counts, out=np.full(_FRAMES, np.nan), where=counts > 0)


def _scene(finer: int) -> Movers:
    """Trucks, houses and trees."""
    truck = next(kind for kind in KINDS if kind.form == "truck")
    houses = [one for one in generate("hamlet", 3, detail=2).objects if one.mesh is not None][:2]
    meshes = [vehicle_mesh(truck), *(_plain(one.mesh) for one in houses if one.mesh is not None), _tree()]
    seconds = _FRAMES / _RATE
    kinds, tracks = [], []
    for place, speed in _ROADS:
        for i in range(6):
            start = -100.0 + 40.0 * i + (5.0 if speed > 0 else 25.0)
            heading = 0.0 if speed > 0 else math.pi
            kinds.append(0)
            y = place
            tracks.append([(0.0, start, y, heading), (seconds, start + speed * _FRAMES, y, heading)])
    for kind, x, y in ((1, -30.0, 40.0), (2, 30.0, 45.0), (3, -12.0, 32.0), (3, 14.0, -28.0)):
        kinds.append(kind)
        tracks.append([(0.0, x, y, 0.0)])
    rows = [row for track in tracks for row in track]
    return Movers(
        ids=tuple(f"{kind}-{i}" for i, kind in enumerate(kinds)),
        kinds=np.array(kinds),
        names=("truck", "house", "other house", "tree"),
        meshes=tuple(_finer(mesh, finer) for mesh in meshes),
        starts=np.cumsum([0, *map(len, tracks)]),
        times=np.array([row[0] for row in rows]),
        positions=np.array([(x, y, 0.0) for _, x, y, _ in rows]),
        angles=np.array([(heading, 0.0, 0.0) for *_, heading in rows]),
        stays=np.ones(len(kinds), dtype=bool),
    )


def _plain(mesh: TriangleMesh) -> TriangleMesh:
    """The shape without pictures, with the middle of its foot at the origin."""
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    middle = np.array([*(0.5 * (low + high))[:2], low[2]])
    return TriangleMesh(mesh.vertices - middle, mesh.triangles, np.full(len(mesh.triangles), PLAIN), mesh.colors)


def _finer(mesh: TriangleMesh, side: int) -> TriangleMesh:
    """The same surfaces with every triangle cut into ``side`` squared."""
    weights, cells = triangle_lattice(side)
    vertices = np.einsum("kc,mcd->mkd", weights, mesh.vertices[mesh.triangles]).reshape(-1, 3)
    first = len(weights) * np.arange(len(mesh.triangles))
    triangles = (cells[None] + first[:, None, None]).reshape(-1, 3)
    return TriangleMesh(
        vertices, triangles, np.full(len(triangles), PLAIN), np.repeat(mesh.colors, side * side, axis=0)
    )


def _tree() -> TriangleMesh:
    trunk = lathe([(0, 0), (0.3, 0), (0.25, 2.6), (0, 2.6)], 12, color=(96, 72, 52))
    crown = lathe([(0, 2.2), (1.6, 2.8), (2.2, 4.2), (1.7, 6.0), (0.9, 7.4), (0, 8.0)], 24, color=(72, 112, 58))
    made = compacted(join([trunk, crown]))
    return TriangleMesh(made.vertices, made.triangles, np.full(len(made.triangles), PLAIN), made.colors)


def _ground() -> City:
    """Two roads, and far away a house, since a city has one."""
    streets = nx.MultiGraph()
    for i, (y, _) in enumerate(_ROADS):
        for end, x in enumerate((-250.0, 250.0)):
            streets.add_node(2 * i + end, x=x, y=y)
        line = LineString([(-250.0, y), (250.0, y)])
        streets.add_edge(2 * i, 2 * i + 1, geometry=line, kind="street", half_width=5.0, name="", index=i)
    far = CityObject("far", (Prism(box(0.0, -900.0, 9.0, -890.0), 0.0, 5.0),))
    return City((far,), streets, "local", (0.0, 0.0, 0.0), "flight")


def _plot(times: dict[str, np.ndarray], lives: dict[str, np.ndarray], path: Path) -> None:
    figure = Figure(figsize=(9.0, 6.0), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True)
    centres = np.arange(_FRAMES).reshape(-1, _BIN).mean(axis=1)
    for name, one in lives.items():
        if np.isfinite(one).any():
            above.plot(one, label=name, linewidth=1.2)
    above.set_ylabel("frames that images last (mean)")
    above.set_ylim(bottom=0.0)
    above.legend(fontsize=8)
    for name, one in times.items():
        below.plot(centres, 1e3 * np.median(one.reshape(-1, _BIN), axis=1), label=name, linewidth=1.2)
    below.set_ylabel("a frame, ms")
    below.set_xlabel("frame")
    below.set_ylim(bottom=0.0)
    below.legend(fontsize=8)
    figure.savefig(path, dpi=120)


if __name__ == "__main__":
    main()
