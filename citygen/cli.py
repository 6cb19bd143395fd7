"""The program ``citygen``: a preset in, a city in files out, one line for every mistake, exit status 0, 2 or 130.

``citygen traffic --city`` writes vehicles for a city that is there already.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

from citygen.presets import PRESETS
from mmi.city.model import City, CityObject
from mmi.foundation.errors import CityError, ParameterError
from mmi.foundation.progress import Progress
from mmi.programs.command_line import Parser, ProgressBar, path_option, run_program

if TYPE_CHECKING:
    from mmi.movers.movers import Movers

__all__ = ["citygen"]

_SUFFIXES = (".json", ".jsonl", ".glb")
_LARGE = 20_000
"""A metropolis of more buildings is written to its file district by district."""
_VEHICLES, _SECONDS = 60, 60.0
_MOST_VEHICLES, _MOST_SECONDS = 100_000, 3600.0
_MOST_POSES = 50_000_000
"""Of all vehicles together, ten a second; four gigabytes while they drive."""
_EXACT = 0.02
"""Metres by which a vehicle may be off where poses are left out of its file."""
_EXAMPLE = """\
examples:
  citygen hamlet -o out/hamlet.json
  citygen montmartre --seed 7 -o out/montmartre.json -o out/montmartre.glb
  citygen metropolis --buildings 100000 -o out/metropolis.jsonl
  citygen traffic --city examples/helsinki/helsinki.osm.pbf --vehicles 300 -o out/helsinki.traffic.json

The suffix decides the format: .json CityJSON 2.0, .jsonl CityJSONSeq, .glb binary glTF. The same preset, seed and options
give the same city. traffic writes its vehicles beside the city, as NAME.traffic.json; with --city it writes nothing else.
"""


def citygen(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run ``citygen PRESET -o FILE``: generate a city and write it."""
    run_program(_parser(), arguments, _run, kept="no file was changed")


def _parser() -> Parser:
    parser = Parser(
        prog="citygen",
        description="Generate a city with streets, for tests, demonstrations and benchmarks.",
        epilog=_EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("preset", nargs="?", metavar="PRESET", help=f"which city: {', '.join(PRESETS)} (see --list)")
    parser.add_argument(
        "-o",
        "--output",
        type=path_option,
        action="append",
        metavar="FILE",
        help="file to write; may be given several times",
    )
    parser.add_argument("--list", action="store_true", help="list the presets and what they are")
    parser.add_argument(
        "--seed",
        type=int,
        default=0,
        metavar="S",
        help="seed of all random choices: another number gives another city (default: 0)",
    )
    parser.add_argument(
        "--detail",
        type=int,
        metavar="0..3",
        help="detail of houses: 0 prisms, 1 textured walls and roofs, 2 windows and doors, 3 balconies and dormers "
        "(default: the preset's own)",
    )
    parser.add_argument(
        "--buildings", type=int, metavar="N", help="how many buildings metropolis has, 1000 to 1000000 (default: 10000)"
    )
    traffic = parser.add_argument_group("traffic")
    traffic.add_argument(
        "--city",
        type=path_option,
        metavar="CITY",
        help="let vehicles drive through this city instead of a generated one: what build-impostors reads, or the folder of a "
        "dataset, which has the city as its options said",
    )
    traffic.add_argument(
        "--vehicles", type=int, metavar="N", help=f"how many vehicles there are (default: {_VEHICLES})"
    )
    traffic.add_argument("--seconds", type=float, metavar="S", help=f"for how long they drive (default: {_SECONDS:g})")
    parser.add_argument("--json", action="store_true", help="print the statistics as JSON on standard output")
    parser.add_argument("--quiet", action="store_true", help="print no progress and no statistics")
    return parser


@dataclass(slots=True)
class _Count:
    """How much a city has, counted while its objects are written."""

    blocks: int
    streets: int
    junctions: int
    textures: int
    buildings: int = 0
    triangles: int = 0
    vehicles: int | None = None
    """None where nothing drives."""

    def passing(self, objects: Iterable[CityObject]) -> Iterator[CityObject]:
        """The same objects, counted."""
        from citygen.buildings.objects import triangle_count

        for one in objects:
            self.buildings += 1
            self.triangles += triangle_count(one)
            yield one

    def show(self, *, as_json: bool) -> None:
        numbers = {
            "blocks": self.blocks,
            "street segments": self.streets,
            "junctions": self.junctions,
            "buildings": self.buildings,
            "triangles": self.triangles,
            "textures": self.textures,
        }
        if self.vehicles is not None:
            numbers["vehicles"] = self.vehicles
        if as_json:
            print(json.dumps({name.replace(" ", "_"): number for name, number in numbers.items()}))
        else:
            print(", ".join(f"{number:,} {name}" for name, number in numbers.items()))


def _run(options: argparse.Namespace) -> None:
    if options.list:
        for preset in PRESETS.values():
            print(f"{preset.name:12} {preset.summary}")
        return
    outputs = _checked(options)
    if options.city is not None:
        _drive(options, outputs[0])
        return
    streamed = (options.buildings or 0) > _LARGE
    if streamed and [path.suffix for path in outputs] != [".jsonl"]:
        raise ParameterError(
            f"--buildings: one .jsonl file expected for more than {_LARGE}, found {', '.join(map(str, outputs))}"
        )
    with ProgressBar("buildings", quiet=options.quiet) as advance:
        count = (_stream if streamed else _write)(options, outputs, advance)
    if not options.quiet or options.json:
        count.show(as_json=options.json)


def _checked(options: argparse.Namespace) -> list[Path]:
    """The files to write. Whatever is wrong is said before anything is generated."""
    if options.preset not in PRESETS:
        found = "nothing" if options.preset is None else repr(options.preset)
        raise ParameterError(f"a preset of {', '.join(PRESETS)} expected, found {found}")
    outputs: list[Path] = options.output or []
    if not outputs:
        raise ParameterError("-o FILE expected, found none")
    suffixes = _SUFFIXES if options.city is None else (".json",)
    for path in outputs:
        if path.suffix not in suffixes:
            raise ParameterError(f"{path}: a name that ends in {', '.join(suffixes)} expected, found {path.suffix!r}")
        if path.is_dir():
            raise CityError(f"{path}: a file expected, found a folder")
        path.parent.mkdir(parents=True, exist_ok=True)
        if not os.access(path.parent, os.W_OK):
            raise CityError(f"{path.parent}: a folder that can be written to expected")
    if len(set(outputs)) < len(outputs):
        raise ParameterError("-o: different files expected, found the same twice")
    if options.seed < 0:
        raise ParameterError(f"--seed: a whole number of at least 0 expected, found {options.seed}")
    if options.detail is not None and options.detail not in range(4):
        raise ParameterError(f"--detail: 0 to 3 expected, found {options.detail}")
    if options.buildings is not None and not PRESETS[options.preset].counted:
        raise ParameterError(f"--buildings: only metropolis takes a number of buildings, not {options.preset}")
    if options.buildings is not None and not 1_000 <= options.buildings <= 1_000_000:
        raise ParameterError(f"--buildings: 1000 to 1000000 expected, found {options.buildings}")
    _check_traffic(options, outputs)
    return outputs


def _check_traffic(options: argparse.Namespace, outputs: list[Path]) -> None:
    """Options of traffic mean something, and only with it."""
    for name in ("city", "vehicles", "seconds"):
        if getattr(options, name) is not None and options.preset != "traffic":
            raise ParameterError(f"--{name}: only traffic takes it, not {options.preset}")
    if options.city is not None and len(outputs) > 1:
        raise ParameterError(f"-o: one file for the vehicles expected, found {len(outputs)}")
    if options.city is not None and options.detail is not None:
        raise ParameterError("--detail: a city to generate expected, found --city")
    vehicles = _VEHICLES if options.vehicles is None else options.vehicles
    seconds = _SECONDS if options.seconds is None else options.seconds
    if not 1 <= vehicles <= _MOST_VEHICLES:
        raise ParameterError(f"--vehicles: 1 to {_MOST_VEHICLES} expected, found {vehicles}")
    if not 0.0 < seconds <= _MOST_SECONDS:
        raise ParameterError(f"--seconds: more than 0 and up to {_MOST_SECONDS:g} expected, found {seconds:g}")
    if vehicles * seconds * 10.0 > _MOST_POSES:
        raise ParameterError(
            f"--vehicles, --seconds: a product of up to {_MOST_POSES // 10} expected, found {vehicles * seconds:.0f}"
        )


def _write(options: argparse.Namespace, outputs: list[Path], advance: Progress) -> _Count:
    """Generate a city that fits into memory, and write it to all the files."""
    from citygen.generate import generate
    from mmi.writing.cityjson_writer import write_cityjson
    from mmi.writing.gltf_writer import write_glb

    city = generate(options.preset, options.seed, detail=options.detail, buildings=options.buildings, progress=advance)
    for path in outputs:
        advance(0, len(city.objects), f"writing {path.name}")
        if path.suffix == ".glb":
            write_glb(city, path)
        else:
            write_cityjson(city, path, progress=lambda done, total: advance(done, total, "writing"))
    count = _count(city)
    if options.preset == "traffic":
        advance(0, len(city.objects), "driving")
        beside = sorted({path.with_suffix(".traffic.json") for path in outputs})
        count.vehicles = len(_write_traffic(options, city, beside).ids)
    for _ in count.passing(city.objects):
        pass
    return count


def _write_traffic(options: argparse.Namespace, city: City, paths: Sequence[Path]) -> Movers:
    """Let vehicles drive through ``city``, and write them to all the files."""
    from citygen.traffic.traffic import traffic
    from mmi.movers.movers_file import write_movers
    from mmi.movers.thinning import thinned

    vehicles = _VEHICLES if options.vehicles is None else options.vehicles
    seconds = _SECONDS if options.seconds is None else options.seconds
    movers = thinned(traffic(city, options.seed, vehicles=vehicles, seconds=seconds), metres=_EXACT)
    for path in paths:
        write_movers(movers, path)
    return movers


def _drive(options: argparse.Namespace, path: Path) -> None:
    """Write vehicles for a city that is there already, and say how many."""
    with ProgressBar("steps", quiet=options.quiet) as advance:
        city = _existing(options.city, advance)
        advance(0, 1, "driving")
        movers = _write_traffic(options, city, [path])
    numbers = {
        "vehicles": len(movers.ids),
        "poses": len(movers.times),
        "seconds": round(movers.span[1], 3),
        "street segments": city.streets.number_of_edges(),
    }
    if options.json:
        print(json.dumps({name.replace(" ", "_"): number for name, number in numbers.items()}))
    elif not options.quiet:
        print(", ".join(f"{number:,} {name}" for name, number in numbers.items()))


def _existing(path: Path, advance: Progress) -> City:
    """The city in a file, or the one of a dataset."""
    from mmi.dataset.reading import open_dataset
    from mmi.reading.read_city import read_city

    if (path / "manifest.json").is_file():
        return open_dataset(path).city()
    city, _ = read_city(path, progress=advance)
    return city


def _count(city: City) -> _Count:
    import shapely

    lines = [edge["geometry"] for _, _, edge in city.streets.edges(data=True)]
    blocks = len(shapely.get_parts(shapely.polygonize(lines))) if lines else 0
    return _Count(blocks, len(lines), city.streets.number_of_nodes(), len(city.textures))


def _stream(options: argparse.Namespace, outputs: list[Path], advance: Progress) -> _Count:
    """Generate a city that may not fit into memory, and write it district by district."""
    import numpy as np

    from citygen.metropolis import metropolis
    from citygen.shapes.textures import city_textures
    from mmi.writing.cityjson_writer import CityJSONSeqWriter

    detail = options.detail or 0
    textures = city_textures(options.seed) if detail else ()
    city = metropolis(options.seed, buildings=options.buildings, detail=detail)
    count = _Count(city.blocks, city.streets.number_of_edges(), city.streets.number_of_nodes(), len(textures))
    with CityJSONSeqWriter(
        outputs[0], crs="local", origin=(0.0, 0.0, 0.0), source="metropolis", textures=textures
    ) as writer:
        for district in city.districts:
            writer.add(count.passing(district))
            advance(count.buildings, city.buildings, "building and writing")
        writer.add_streets(city.streets, lambda points: np.zeros(len(points)))
    return count
