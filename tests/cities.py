"""Small cities that can be worked out by hand, and where the real ones are: all tests find them here."""

from __future__ import annotations

from pathlib import Path

import networkx as nx
import pytest
from shapely.geometry import LineString, Polygon, box

from mmi.cells.viewing_cells import ViewingCell
from mmi.city.model import City, CityObject, Prism

SHARED = Path(__file__).resolve().parents[2] / "shared" / "data"
"""Real cities and models; may be absent."""
HELSINKI = Path(__file__).resolve().parents[1] / "examples" / "helsinki" / "helsinki.osm.pbf"
"""A district that comes with the project."""


def real(name: str | Path) -> Path:
    """A file or folder of ../shared/data, or the path itself if absolute; skips the test where it is not there."""
    path = SHARED / name
    if not path.exists():
        pytest.skip(f"needs {path.name}, which comes with ../shared/data")
    return path


def block(name: str, x0: float, y0: float, x1: float, y1: float, top: float, bottom: float = 0.0) -> CityObject:
    """A box of a building."""
    return CityObject(name, (Prism(box(x0, y0, x1, y1), bottom, top),))


def streets(*lines: list[tuple[float, float]], half_width: float = 3.0) -> nx.MultiGraph:
    """Streets that meet where their ends coincide."""
    graph = nx.MultiGraph()
    nodes: dict[tuple[float, float], int] = {}
    for index, line in enumerate(lines):
        for end in (line[0], line[-1]):
            if end not in nodes:
                nodes[end] = len(nodes)
                graph.add_node(nodes[end], x=end[0], y=end[1])
        graph.add_edge(
            nodes[line[0]],
            nodes[line[-1]],
            geometry=LineString(line),
            kind="street",
            half_width=half_width,
            name=f"street {index}",
            index=index,
        )
    return graph


def city_of(*objects: CityObject, lines: tuple[list[tuple[float, float]], ...] = ()) -> City:
    """A city of these objects; its streets run along y = 0 unless ``lines`` are given."""
    return City(objects, streets(*(lines or ([(-20.0, 0.0), (20.0, 0.0)],))), "EPSG:32631", (0.0, 0.0, 0.0), "made")


def cell_along_x(length: float = 40.0, half_width: float = 3.0) -> ViewingCell:
    """A cell centred on the origin."""
    return ViewingCell("0000-00", (-0.5 * length, 0.0), (0.5 * length, 0.0), half_width, (1.5, 1.9))


def two_blocks() -> City:
    """One house at 60 m north of the street's middle, a taller one behind it at 120 m."""
    return city_of(block("front", -10.0, 60.0, 10.0, 75.0, 12.0), block("back", -30.0, 120.0, 30.0, 140.0, 40.0))


def crossroads() -> City:
    """A 3 x 3 grid of blocks of different heights with streets between them; one has a courtyard."""
    objects = []
    for i in range(4):
        for j in range(4):
            x, y = (i - 2) * 80.0 + 10.0, (j - 2) * 80.0 + 10.0
            outline = Polygon(box(x, y, x + 60.0, y + 60.0).exterior)
            if (i, j) == (1, 3):
                outline = Polygon(outline.exterior, [box(x + 15.0, y + 15.0, x + 45.0, y + 45.0).exterior.coords])
            objects.append(CityObject(f"block/{i}{j}", (Prism(outline, 0.0, 9.0 + 3.0 * ((5 * i + 3 * j) % 7)),)))
    return city_of(
        *objects,
        lines=(
            [(-160.0, 0.0), (0.0, 0.0)],
            [(0.0, 0.0), (150.0, 0.0)],
            [(0.0, -160.0), (0.0, 0.0)],
            [(0.0, 0.0), (0.0, 150.0)],
        ),
    )
