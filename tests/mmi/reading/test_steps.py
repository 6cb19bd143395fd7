"""A reading says how far it is to a function that is passed to it, and prints nothing."""

from itertools import groupby

import pytest
from city_files import OsmFile, degrees, geojson
from shapely.geometry import LineString, box

from mmi.foundation.errors import CityError
from mmi.reading.read_city import read_city
from mmi.reading.read_options import ReadOptions


def steps_of(path, **options):
    """(step, its numbers) in order, as ``progress`` hears them."""
    heard = []
    read_city(path, ReadOptions(**options), progress=lambda *what: heard.append(what))
    return [(what, [one[:2] for one in own]) for what, own in groupby(heard, key=lambda one: one[2])]


def boxes(path, count):
    """An OBJ file of boxes, 20 m apart, in two rows."""
    lines = []
    for k in range(count):
        x, y, first = 25 * (k // 2), 30 * (k % 2), 8 * k
        lines.append(f"o house {k}")
        lines += [f"v {x + a} {y + b} {z}" for z in (0, 10) for a, b in ((0, 0), (15, 0), (15, 12), (0, 12))]
        for face in ((4, 3, 2, 1), (5, 6, 7, 8), (1, 2, 6, 5), (2, 3, 7, 6), (3, 4, 8, 7), (4, 1, 5, 8)):
            lines.append("f " + " ".join(str(first + one) for one in face))
    path.write_text("\n".join(lines))
    return path


def test_a_map_is_read_step_by_step(tmp_path, capfd):
    osm = OsmFile()
    osm.box(1, 0, 10, 9, 19, building="yes", height="3")
    osm.way(2, [(-50.0, 0.0), (50.0, 0.0)], highway="residential")
    contours = [(degrees(box(*corners).boundary), {"height": 5.0}) for corners in ((-90, -90, 90, 90), (2, 12, 7, 17))]
    dem = geojson(tmp_path / "dem.geojson", contours)
    steps = steps_of(osm.write(tmp_path / "town.osm"), terrain=dem)
    assert [what for what, _ in steps] == [
        "reading the buildings of town.osm",
        "reading the streets of town.osm",
        "mending and raising the buildings",
        "reading the ground of dem.geojson",
        "joining the streets",
    ]
    assert all(numbers == [(0, 1), (1, 1)] for _, numbers in steps)
    assert capfd.readouterr() == ("", "")


def test_the_buildings_of_a_model_are_counted(tmp_path):
    path = boxes(tmp_path / "town.obj", 6)
    steps = dict(steps_of(path, up="z"))
    assert steps["mending the buildings"] == [(k, 6) for k in range(7)]
    assert list(steps) == [
        "reading the model town.obj",
        "mending the buildings",
        "looking for paths through the open space",
        "setting the buildings on the ground",
        "looking for what open buildings hide",
        "joining the streets",
    ]


def test_a_step_that_fails_does_not_end(tmp_path):
    houses = geojson(tmp_path / "h.geojson", [(degrees(box(0, 0, 20, 10)), {"levels": 2})])
    lines = geojson(tmp_path / "l.geojson", [(degrees(LineString([(0, -9), (20, -9)])), {"highway": "proposed"})])
    heard = []
    with pytest.raises(CityError):
        read_city(houses, ReadOptions(streets=lines), progress=lambda *what: heard.append(what))
    assert heard[-1] == (0, 1, "joining the streets")
