"""The formats that are fuzzed: what seeds each has, what is done to them, how they are tried, and what may be accepted.

A seed is a folder of small files; ``mutants`` says what may be done to which of them. ``attempt`` reads the mutant as the
programs do and holds what was accepted against what any city, walk or dataset must be.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path
from random import Random

import numpy as np
import shapely
from fuzz.datasets import Expect, seal_again, seal_inside, try_cells, try_dataset, try_record
from fuzz.mutators import (
    Mutator,
    changed_bytes,
    changed_chunks,
    changed_elements,
    changed_glb,
    changed_gzip,
    changed_json,
    changed_lines,
    changed_numbers,
    changed_pbf,
    changed_sqlite,
    changed_xml,
)
from fuzz.programs import try_comparing, try_comparing_walk, try_inspecting, try_resuming, try_viewing

from mmi.movers.movers_file import read_movers
from mmi.reading.read_city import read_city
from mmi.reading.read_options import ReadOptions
from mmi.walks.walk import read_walk

SEED = -1
"""The number of the mutant that is none."""
BINARY = (changed_bytes, changed_chunks)
TEXT = (changed_numbers, changed_numbers, changed_lines, changed_bytes, changed_chunks)
XML = (
    changed_elements,
    changed_elements,
    changed_elements,
    changed_xml,
    changed_numbers,
    changed_bytes,
    changed_chunks,
)
JSON = (changed_json, changed_json, changed_json, changed_numbers, changed_bytes, changed_chunks)
EDITED = {
    "manifest.json": (changed_json,),
    "cells/*.json": (changed_json,),
    "city.json": (changed_json,),
    "city.glb": (changed_glb,),
    "cells/*.glb": (changed_glb,),
    "cells/*.exr": BINARY,
}
"""The files of a dataset."""
GLB = (changed_glb, changed_glb, changed_glb, changed_bytes, changed_chunks)


@dataclass(frozen=True, slots=True)
class Format:
    """A format: which files of its seed (by pattern) are changed and how, and what tries the folder that results."""

    name: str
    mutators: dict[str, tuple[Mutator, ...]]
    attempt: Callable[[Path, Expect], None]
    finish: Callable[[dict[str, bytes], dict[str, bytes], Random], dict[str, bytes]] = field(
        default=lambda seeds, changed, _: {**seeds, **changed}
    )
    """(seeds, changed files, generator) -> all files of the mutant."""


def mutant_of(form: Format, seeds: dict[str, bytes], run: int, number: int) -> dict[str, bytes]:
    """The files of a mutant; the same ones for the same format, run and number. ``SEED`` is the seed as it is."""
    if number == SEED:
        return seeds
    rng = Random(f"{form.name}/{run}/{number}")
    pattern = rng.choice(list(form.mutators))
    name = next(one for one in seeds if fnmatchcase(one, pattern))
    data = seeds[name]
    for _ in range(rng.choice((1, 1, 1, 2, 3, 6))):
        try:
            data = rng.choice(form.mutators[pattern])(data, rng)
        except Exception:  # an earlier change left no such structure
            data = changed_bytes(data, rng)
    return form.finish(seeds, {name: data}, rng)


# ------------------------------------------------------------------------------------------------------------ cities


def _city(
    name: str, *, streets: str | None = None, terrain: str | None = None, **options: object
) -> Callable[..., None]:
    def attempt(folder: Path, expect: Expect) -> None:
        told = ReadOptions(
            streets=None if streets is None else folder / streets,
            terrain=None if terrain is None else folder / terrain,
            **options,
        )
        city, _ = read_city(folder / name, told)
        check_city(city, expect)

    return attempt


def check_city(city, expect: Expect) -> None:
    """Whether a city that was accepted is one: finite, of at most 100 km, of plausible heights, with streets."""
    expect(len(city.objects) > 0 and city.streets.number_of_edges() > 0, "a city without objects or streets")
    expect(len(city.index()) == len(city.objects), "ids that come twice")
    expect(bool(np.isfinite(city.origin).all() and np.isfinite(city.ground)), f"origin {city.origin}, {city.ground}")
    lines = [edge["geometry"] for _, _, edge in city.streets.edges(data=True)]
    widths = [edge["half_width"] for _, _, edge in city.streets.edges(data=True)]
    shapes = [one.footprint for one in city.objects]
    for what, found in (("objects", shapes), ("streets", lines)):
        points = shapely.get_coordinates(found)
        expect(bool(np.isfinite(points).all()), f"{what}: coordinates that are no numbers")
        size = np.ptp(points, axis=0).max()
        expect(bool(size <= 1e5 * 1.5), f"{what}: an extent of {size:.0f} m")
    expect(all(0.0 < one <= 100.0 for one in widths), f"half widths {min(widths)} to {max(widths)}")
    for one in city.objects:
        heights = (one.base, one.top)
        expect(all(map(np.isfinite, heights)) and -2e3 < one.base < one.top < 4e4, f"{one.id}: heights {heights}")
        if one.mesh is not None:
            expect(bool(np.isfinite(one.mesh.vertices).all()), f"{one.id}: vertices that are no numbers")
            expect(bool(np.abs(one.mesh.vertices).max(initial=0.0) < 2e5), f"{one.id}: vertices far away")
    if city.terrain is not None:
        heights = city.terrain.heights
        expect(bool(np.isfinite(heights).all() and np.abs(heights).max() < 4e4), "ground of implausible heights")
        expect(heights.size <= 4_000_000, f"ground of {heights.shape} heights")


# --------------------------------------------------------------------------------------------------- walks and movers


def _walk(folder: Path, expect: Expect) -> None:
    walk = read_walk(folder / "walk.json")
    for time in np.linspace(walk.keyframes[0].time, walk.keyframes[-1].time, 7):
        pose = walk.pose(float(time))
        expect(bool(np.isfinite([*pose.eye, pose.azimuth, pose.pitch]).all()), f"pose {pose}")
        expect(bool(np.abs(pose.eye).max() <= 1e7), f"pose {pose}")


def _movers(folder: Path, expect: Expect) -> None:
    movers = read_movers(folder / "movers.json")
    for name in ("times", "positions", "angles"):
        expect(bool(np.isfinite(getattr(movers, name)).all()), f"{name} that are no numbers")
    expect(len(set(movers.ids)) == len(movers.ids), "ids that come twice")
    expect(all(np.isfinite(one.vertices).all() for one in movers.meshes), "vertices that are no numbers")


# ---------------------------------------------------------------------------------------------------------------- all


def _form(name: str, mutators: dict[str, tuple[Mutator, ...]], attempt: Callable[..., None], **more: object) -> Format:
    return Format(name, mutators, attempt, **more)


FORMATS = {
    one.name: one
    for one in (
        _form("osm", {"x.osm": XML}, _city("x.osm")),
        _form("osm.gz", {"x.osm.gz": (changed_gzip, *BINARY)}, _city("x.osm.gz")),
        _form("pbf", {"x.osm.pbf": (changed_pbf, changed_pbf, changed_pbf, *BINARY)}, _city("x.osm.pbf")),
        _form("geojson", {"x.geojson": JSON, "s.geojson": JSON}, _city("x.geojson", streets="s.geojson")),
        _form(
            "gpkg",
            {"x.gpkg": (changed_sqlite, changed_sqlite, *BINARY)},
            _city("x.gpkg", buildings_layer="buildings", streets="x.gpkg", streets_layer="streets"),
        ),
        _form(
            "shp",
            {f"{name}.{end}": BINARY for name in "bs" for end in ("shp", "shx", "dbf", "prj")},
            _city("b.shp", streets="s.shp"),
        ),
        _form("sumo", {"x.net.xml": XML}, _city("m.obj", streets="x.net.xml", up="z")),
        _form("cityjson", {"x.city.json": JSON}, _city("x.city.json")),
        _form("cityjsonl", {"x.city.jsonl": (*JSON, changed_lines)}, _city("x.city.jsonl")),
        _form("citygml", {"x.gml": XML}, _city("x.gml", streets="s.geojson")),
        _form("glb", {"x.glb": GLB}, _city("x.glb")),
        _form("gltf", {"x.gltf": JSON, "x.bin": BINARY}, _city("x.gltf")),
        _form("obj", {"x.obj": TEXT, "x.mtl": TEXT, "bricks.png": BINARY}, _city("x.obj", streets="s.net.xml", up="z")),
        _form("ply", {"x.ply": (*TEXT, *BINARY)}, _city("x.ply", streets="s.net.xml", up="z")),
        _form("ply-text", {"t.ply": TEXT}, _city("t.ply", streets="s.net.xml", up="z")),
        _form("off", {"x.off": TEXT}, _city("x.off", streets="s.net.xml", up="z")),
        _form("stl", {"x.stl": BINARY}, _city("x.stl", streets="s.net.xml", up="z")),
        _form("tif", {"x.tif": BINARY}, _city("x.osm", terrain="x.tif")),
        _form("asc", {"x.asc": TEXT}, _city("x.osm", terrain="x.asc")),
        _form("walk", {"walk.json": JSON}, _walk),
        _form("movers", {"movers.json": JSON}, _movers),
        _form("manifest", {"manifest.json": JSON}, try_dataset),
        _form("record", {"cells/*.json": JSON}, try_record),
        _form("sealed-manifest", {"manifest.json": (changed_json,)}, try_dataset, finish=seal_again),
        _form("sealed-record", {"cells/*.json": (changed_json,)}, try_record, finish=seal_again),
        _form("sealed-city", {"city.json": (changed_json,)}, try_dataset, finish=seal_again),
        _form("sealed-city-glb", {"city.glb": GLB}, try_dataset, finish=seal_again),
        _form("cell-exr", {"cells/*.exr": BINARY}, try_cells, finish=seal_again),
        _form("cell-glb", {"cells/*.glb": GLB}, try_cells, finish=seal_again),
        _form("inspect-layers", EDITED, try_inspecting, finish=seal_again),
        _form("compare-impostors", EDITED, try_comparing, finish=seal_again),
        _form("compare-walk", {"walk.json": (changed_json,), "movers.json": (changed_json,)}, try_comparing_walk),
        _form("view-impostors", EDITED, try_viewing, finish=seal_again),
        _form(
            "build-impostors", {f"out/{name}": how for name, how in EDITED.items()}, try_resuming, finish=seal_inside
        ),
    )
}
"""All formats by name."""
