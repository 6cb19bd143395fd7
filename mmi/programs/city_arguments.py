"""The arguments of a program that reads a city: CITY and the group "the city", as one ``ReadOptions``.

A program adds them to its parser and gets the value back, checked, before anything that takes time is loaded.
"""

from __future__ import annotations

import argparse

from mmi.city.facade_kinds import FACADE_KINDS
from mmi.foundation.errors import ParameterError
from mmi.programs.command_line import numbers_option, path_option
from mmi.reading.read_options import HEIGHT_UNITS, NETWORKS, OBJECTS, UP_AXES, ReadOptions

__all__ = ["CITY_FILES", "add_city_arguments", "add_reading_arguments", "read_options", "refuse_reading_arguments"]

_DEFAULT = ReadOptions()

CITY_FILES = (
    "OpenStreetMap .osm or .osm.pbf, footprints (GeoJSON, GeoPackage, Shapefile, ...), or a 3D model: CityJSON, CityGML (also "
    "a folder or zip of tiles), glTF, OBJ, PLY, STL"
)
"""What can be read, for people."""


def add_city_arguments(parser: argparse.ArgumentParser) -> None:
    """Add CITY and every option of ``ReadOptions``, by its name, with its default."""
    parser.add_argument("city", type=path_option, metavar="CITY", help=CITY_FILES)
    add_reading_arguments(parser)


def add_reading_arguments(parser: argparse.ArgumentParser, default: ReadOptions = _DEFAULT) -> None:
    """Add every option of ``ReadOptions``, by its name, with its ``default``, without CITY."""
    city = parser.add_argument_group("the city")
    city.add_argument(
        "--streets",
        type=path_option,
        metavar="FILE",
        help="streets, where CITY holds only buildings (default then: paths through the open space)",
    )
    city.add_argument(
        "--terrain", type=path_option, metavar="FILE", help="heights of the ground: a raster, points or contour lines"
    )
    city.add_argument(
        "--terrain-unit",
        choices=HEIGHT_UNITS,
        help="unit of the ground's heights (default: feet where the file says so, else m)",
    )
    city.add_argument(
        "--lod", metavar="N", help="level of detail of a 3D model (default: the highest of each building)"
    )
    city.add_argument(
        "--up", choices=UP_AXES, default=default.up, help="axis of a mesh that points up (default: %(default)s)"
    )
    city.add_argument(
        "--crs", metavar="CRS", help="coordinate system (EPSG:32632), where a file declares none or a wrong one"
    )
    city.add_argument(
        "--network", choices=NETWORKS, default=default.network, help="which streets are used (default: %(default)s)"
    )
    city.add_argument(
        "--objects",
        choices=OBJECTS,
        default=default.objects,
        help="what layers are made of: buildings, or blocks of buildings that touch (default: %(default)s)",
    )
    city.add_argument(
        "--facades",
        choices=FACADE_KINDS,
        default=default.facades,
        help="walls that the file says nothing of: painted with windows and doors, or plain (default: %(default)s)",
    )
    city.add_argument(
        "--clip", type=_box, metavar="W,S,E,N", help="read only what lies in this box of degrees: west,south,east,north"
    )
    city.add_argument("--height-column", metavar="NAME", help="column of heights (default: guessed)")
    city.add_argument(
        "--height-unit",
        choices=HEIGHT_UNITS,
        help="unit of the height column or of a 3D model's heights (default: feet where the column's name says so, else m)",
    )
    city.add_argument("--levels-column", metavar="NAME", help="column of numbers of storeys (default: guessed)")
    city.add_argument("--id-column", metavar="NAME", help="column of the buildings' ids (default: guessed)")
    city.add_argument(
        "--buildings-layer", metavar="NAME", help="layer of CITY that holds the buildings (default: guessed)"
    )
    city.add_argument("--streets-layer", metavar="NAME", help="layer that holds the streets (default: guessed)")


def read_options(arguments: argparse.Namespace) -> ReadOptions:
    """The options that ``add_city_arguments`` added, as a value.

    Raises:
        ParameterError: an option means nothing.
    """
    return ReadOptions(**{name: getattr(arguments, name) for name in ReadOptions.__slots__})


def refuse_reading_arguments(arguments: argparse.Namespace, found: str, default: ReadOptions = _DEFAULT) -> None:
    """Raises ParameterError for an option that :func:`add_reading_arguments` added and somebody gave, where nothing is read.

    ``found`` says what there is instead of a city; ``default`` are those of the options.
    """
    for name in ReadOptions.__slots__:
        if getattr(arguments, name) != getattr(default, name):
            raise ParameterError(f"--{name.replace('_', '-')}: a city to read expected, found {found}")


def _box(text: str) -> tuple[float, ...]:
    return tuple(numbers_option(text, 4, "west,south,east,north in degrees"))
