"""The options of reading: refused where they are made, and the same value for Python and for the program."""

import argparse
import os
import shutil
from dataclasses import fields
from pathlib import Path

import pytest
from cities import HELSINKI

from mmi.city.codec import city_from_json, city_to_json
from mmi.foundation.errors import CityError, ParameterError
from mmi.programs.city_arguments import add_city_arguments, read_options
from mmi.reading.read_city import read_city
from mmi.reading.read_options import ReadOptions


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"network": "fly"}, "--network: expected drive, walk or all, found 'fly'"),
        ({"objects": "trees"}, "--objects: expected buildings or blocks, found 'trees'"),
        ({"height_unit": "feet"}, "--height-unit: expected m or ft, found 'feet'"),
        ({"facades": "brick"}, "--facades: expected painted or plain, found 'brick'"),
        ({"terrain_unit": "mm", "terrain": "dem.tif"}, "--terrain-unit: expected m or ft, found 'mm'"),
        ({"terrain_unit": "ft"}, "--terrain-unit: heights of the ground (--terrain) expected, found 'ft'"),
        ({"up": "x"}, "--up: expected auto, y or z, found 'x'"),
        ({"lod": "5"}, "--lod: a level of detail such as 2 or 1.3 expected, found '5'"),
        ({"clip": (9.0, 48.0, 8.0, 49.0)}, "--clip: expected west < east and south < north in degrees, found"),
        ({"clip": (1, 2, 3)}, "--clip: four numbers expected (west, south, east, north), found (1, 2, 3)"),
        ({"clip": "abcd"}, "--clip: four numbers expected"),
        ({"lod": 2}, "--lod: text expected, found 2"),
        ({"streets": 5}, "--streets: a path expected, found 5"),
        ({"terrain": ""}, "--terrain: a path expected, found ''"),
        ({"height_column": 5}, "--height-column: text expected, found 5"),
        ({"crs": "utm please"}, "--crs: expected a coordinate system such as EPSG:32632, found 'utm please'"),
    ],
)
def test_options_are_checked_where_they_are_made(options, message):
    with pytest.raises(ParameterError) as caught:
        ReadOptions(**options)
    assert str(caught.value).startswith(message)


def parsed(*words):
    parser = argparse.ArgumentParser()
    add_city_arguments(parser)
    return read_options(parser.parse_args(["town.osm", *words]))


def test_the_program_without_options_reads_as_python_without_options():
    assert parsed() == ReadOptions()


def test_every_option_has_its_argument():
    told = ReadOptions(
        streets=Path("roads.shp"),
        terrain=Path("dem.tif"),
        terrain_unit="ft",
        crs="EPSG:32632",
        network="walk",
        objects="blocks",
        clip=(8.0, 47.0, 9.0, 48.0),
        height_column="h",
        height_unit="ft",
        levels_column="n",
        id_column="key",
        buildings_layer="houses",
        streets_layer="ways",
        lod="2.2",
        up="z",
        facades="plain",
    )
    assert not [one.name for one in fields(told) if getattr(told, one.name) == getattr(ReadOptions(), one.name)]
    words = []
    for one in fields(told):
        value = getattr(told, one.name)
        words += [f"--{one.name.replace('_', '-')}", ",".join(map(str, value)) if one.name == "clip" else str(value)]
    assert parsed(*words) == told


def test_paths_may_be_text():
    assert ReadOptions(streets="roads.shp").streets == Path("roads.shp")
    city, _ = read_city(str(HELSINKI))
    assert city.source == HELSINKI.name


def test_names_that_no_file_can_have_and_bytes_that_are_no_text_are_told(tmp_path):
    with pytest.raises(CityError, match="no such file or folder"):
        read_city(tmp_path / ("a" * 300 + ".osm"))
    odd = Path(os.fsdecode(os.fsencode(tmp_path) + b"/caf\xe9.osm.pbf"))
    shutil.copy(HELSINKI, odd)
    city, _ = read_city(odd)
    assert city.source == r"caf\xe9.osm.pbf"
    assert city_from_json(city_to_json(city), name="city.json").source == city.source
