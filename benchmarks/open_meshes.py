"""What meshes hide that are no closed solids, and whether they hide too much: rays at the triangles of what is hidden.

    python benchmarks/open_meshes.py CITY --cells 12 --rays 1000000
    python benchmarks/open_meshes.py CITY --without floors party corners facing -o out/open.json

CITY is a 3D model. With ``--without`` it is opened first, written to the file and read again: without ``floors``; without
``party`` walls, which stand on a neighbour's footprint; with the longest sides of half of the triangles divided, so that
``corners`` are not shared; with half of the triangles turned round (``facing``); with a triangle of a ``wall`` missing in every
tenth building.

Each line is an average cell: visible objects and their triangles, and the milliseconds that it takes to find them. The first
line is without what open meshes hide by their walls. Then come rays from random places of the cell, half of them at random
points of hidden objects, half in random directions, cast at the triangles: the hits of objects that are not in the visible set.
Rays that pass through the ground do not count.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

from mmi.appearance.city_mesh import build_city_mesh
from mmi.cells.choice import spread
from mmi.cells.viewing_cells import ViewingCell, viewing_cells
from mmi.city.long_objects import cut_objects
from mmi.city.model import City
from mmi.rays.embree import EmbreeCaster, embree_caster
from mmi.reading.read_city import read_city
from mmi.reading.read_options import ReadOptions
from mmi.visibility.horizon import horizon_extractor, prepare_horizon
from mmi.visibility.selection import everything
from mmi.writing.cityjson_writer import write_cityjson

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from open_meshes import KINDS, opened_up
from oracles import viewpoints_within

_STEP = 1.0
"""Metres between points of a ray that are looked at whether they are below the ground."""


def measured(city: City, cells: list[ViewingCell]) -> tuple[list[NDArray[np.int64]], float]:
    """What is visible from each cell, and seconds a cell."""
    extract = horizon_extractor(prepare_horizon(city))
    extract(everything(city, cells[0]))
    start = time.perf_counter()
    sets = [extract(everything(city, cell)).objects for cell in cells]
    return sets, (time.perf_counter() - start) / len(cells)


def told(name: str, city: City, sets: list[NDArray[np.int64]], seconds: float) -> None:
    triangles = np.array([0 if one.mesh is None else len(one.mesh.triangles) for one in city.objects])
    hiding = sum(bool(one.occluders) for one in city.objects)
    print(
        f"{name}: {hiding} of {len(city.objects)} objects hide something; of an average cell "
        f"{np.mean([len(one) for one in sets]):.1f} are visible, with {np.mean([triangles[one].sum() for one in sets]):,.0f} "
        f"of {triangles.sum():,} triangles; {1e3 * seconds:.1f} ms"
    )


def wrongly_hidden(
    city: City,
    cell: ViewingCell,
    visible: NDArray[np.int64],
    count: int,
    caster: EmbreeCaster,
    owners: NDArray[np.int64],
) -> tuple[int, int]:
    """How many of ``count`` rays from ``cell`` hit a hidden object, and how many hidden objects they hit."""
    rng = np.random.default_rng(int.from_bytes(cell.id.encode(), "little") % 2**32)
    origins = viewpoints_within(cell, count, rng)
    directions = rng.normal(size=(count, 3)) * (1.0, 1.0, 0.3)
    hidden = np.setdiff1d(np.arange(len(city.objects)), visible)
    of_hidden = np.flatnonzero(np.isin(owners, hidden))
    if len(of_hidden):
        half = count // 2
        corners = caster.corners.reshape(-1, 3, 3)[rng.choice(of_hidden, half)].astype(np.float64)
        weights = rng.dirichlet((1.0, 1.0, 1.0), half)
        directions[:half] = (corners * weights[..., None]).sum(axis=1) - origins[:half]
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    hits = caster.first_hits(origins, directions)
    wrong = np.flatnonzero((hits.triangle >= 0) & np.isin(owners[hits.triangle], hidden))
    above = np.ones(len(wrong), dtype=bool)
    for k, ray in enumerate(wrong.tolist()):
        far = float(hits.distance[ray])
        at = origins[ray] + np.append(np.arange(0.0, far, _STEP), far)[:, None] * directions[ray]
        above[k] = bool((at[:, 2] > city.ground_at(at[:, :2]) - 1e-3).all())
    wrong = wrong[above]
    return len(wrong), len(np.unique(owners[hits.triangle[wrong]]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("city", type=Path)
    parser.add_argument("--cells", type=int, default=12)
    parser.add_argument("--rays", type=int, default=1_000_000, help="in all cells together")
    parser.add_argument("--without", nargs="+", default=[], choices=KINDS)
    parser.add_argument("--streets", type=Path, help="as of build-impostors")
    parser.add_argument("--network", default="drive", help="as of build-impostors")
    parser.add_argument("-o", "--out", type=Path, help="the opened model, a .json file")
    options = parser.parse_args()
    path, ways = options.city, ReadOptions(streets=options.streets, network=options.network)
    if options.without:
        if options.out is None:
            parser.error("--without: a file for the opened model expected (-o)")
        write_cityjson(opened_up(read_city(path, ways)[0], tuple(options.without)), options.out)
        path, ways = options.out, ReadOptions(network="all")
    with patch("mmi.reading.models.model_city.enclosing", lambda objects, *_: objects):
        before = cut_objects(read_city(path, ways)[0], 40.0)
    city, report = read_city(path, ways)
    print("; ".join(f"{note.what}: {note.count}" for note in report.noted))
    city = cut_objects(city, 40.0)
    graph = viewing_cells(city)
    cells = [graph.nodes[one]["cell"] for one in spread(graph, options.cells)]
    told("solids only", before, *measured(before, cells))
    found = measured(city, cells)
    told("and what walls enclose", city, *found)
    caster = embree_caster(mesh := build_city_mesh(city), workers=1)
    owners = np.repeat(np.arange(len(city.objects)), mesh.triangle_counts)
    each = options.rays // len(cells)
    hits = [wrongly_hidden(city, cell, own, each, caster, owners) for cell, own in zip(cells, found[0], strict=True)]
    print(
        f"{each * len(cells):,} rays: {sum(n for n, _ in hits)} hit what is hidden, {sum(n for _, n in hits)} objects"
    )


if __name__ == "__main__":
    main()
