"""What ``read_city`` is told beside its file: one value for the program and for Python, checked where it is made.

It imports no reader, so that a program can check what it was told before it loads anything that takes time.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from mmi.city.facade_kinds import FACADE_KINDS
from mmi.foundation.errors import ParameterError

__all__ = ["HEIGHT_UNITS", "NETWORKS", "OBJECTS", "UP_AXES", "ReadOptions"]

NETWORKS = ("drive", "walk", "all")
"""Which streets: those for cars, those for people on foot, or both."""
OBJECTS = ("buildings", "blocks")
"""What an object of the city is: a building, or a block of touching buildings."""
UP_AXES = ("auto", "y", "z")
"""Which axis of a mesh points up."""


HEIGHT_UNITS = ("m", "ft")
"""What heights are in: metres, or feet of 0.3048 m."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ReadOptions:
    """How to read a city. Every option has a default that fits a file with nothing unusual about it.

    Attributes:
        streets: a second file that holds the streets: a map or GIS file, or a SUMO network.
        terrain: a raster, points or contour lines with the heights of the ground; None: flat, or what a model says.
        terrain_unit: one of ``HEIGHT_UNITS``, for the heights in ``terrain``; None: feet where the raster's unit, the vertical
            coordinate system or the column's name says so, else metres.
        crs: the coordinate system (``EPSG:32632``), where a file declares none or a wrong one; never OpenStreetMap's.
        network: one of ``NETWORKS``.
        objects: one of ``OBJECTS``.
        clip: west, south, east, north in degrees; buildings that meet the box stay whole, streets are cut at it. A box
            across 180 degrees has its east beyond.
        height_column: column of heights; like all names below guessed if None.
        height_unit: one of ``HEIGHT_UNITS``, for the height column, or for all heights of a 3D model; None: feet where the
            column's name says so, else metres.
        levels_column: column of numbers of levels.
        id_column: column of ids that stay the same when the file changes.
        buildings_layer: layer of buildings, or several with commas between.
        streets_layer: layer of streets, or several with commas between.
        lod: level of detail of a model's buildings (``"1"``, ``"2.2"``); None: the highest of each.
        up: one of ``UP_AXES``, for meshes whose format does not say.
        facades: one of ``FACADE_KINDS``: how walls look for which the file has neither pictures nor colours.

    Raises:
        ParameterError: an option means nothing; the message names it as the program does (``--network``).
    """

    streets: Path | None = None
    terrain: Path | None = None
    terrain_unit: str | None = None
    crs: str | None = None
    network: str = "drive"
    objects: str = "buildings"
    clip: tuple[float, float, float, float] | None = None
    height_column: str | None = None
    height_unit: str | None = None
    levels_column: str | None = None
    id_column: str | None = None
    buildings_layer: str | None = None
    streets_layer: str | None = None
    lod: str | None = None
    up: str = "auto"
    facades: str = "painted"

    def __post_init__(self) -> None:
        for name in ("streets", "terrain"):
            value = getattr(self, name)
            if isinstance(value, str) and value:
                object.__setattr__(self, name, Path(value))
            elif value is not None and not isinstance(value, Path):
                raise ParameterError(f"--{name}: a path expected, found {value!r}")
        for name in ("crs", "height_column", "levels_column", "id_column", "buildings_layer", "streets_layer", "lod"):
            value = getattr(self, name)
            if value is not None and not isinstance(value, str):
                raise ParameterError(f"--{name.replace('_', '-')}: text expected, found {value!r}")
        for option, value, choices in (
            ("--network", self.network, NETWORKS),
            ("--objects", self.objects, OBJECTS),
            ("--up", self.up, UP_AXES),
            ("--facades", self.facades, FACADE_KINDS),
            ("--terrain-unit", "m" if self.terrain_unit is None else self.terrain_unit, HEIGHT_UNITS),
            ("--height-unit", "m" if self.height_unit is None else self.height_unit, HEIGHT_UNITS),
        ):
            if value not in choices:
                expected = f"{', '.join(choices[:-1])} or {choices[-1]}"
                raise ParameterError(f"{option}: expected {expected}, found {value!r}")
        if self.terrain_unit is not None and self.terrain is None:
            raise ParameterError(
                f"--terrain-unit: heights of the ground (--terrain) expected, found {self.terrain_unit!r}"
            )
        if self.lod is not None and not re.fullmatch(r"[0-4](\.[0-9])?", self.lod):
            raise ParameterError(f"--lod: a level of detail such as 2 or 1.3 expected, found {self.lod!r}")
        if self.clip is not None:
            try:
                west, south, east, north = map(float, self.clip)
            except (TypeError, ValueError) as error:
                raise ParameterError(
                    f"--clip: four numbers expected (west, south, east, north), found {self.clip!r}"
                ) from error
            if not (-180 <= west <= 180 and west < east <= min(360, west + 360) and -90 <= south < north <= 90):
                raise ParameterError(f"--clip: expected west < east and south < north in degrees, found {self.clip}")
        if self.crs is not None:
            from mmi.reading.coordinates import parse_crs

            parse_crs(self.crs)

    def columns(self) -> dict[str, str | None]:
        """The options that name a layer or a column of the buildings, by the names that the program gives them."""
        return {
            "--buildings-layer": self.buildings_layer,
            "--height-column": self.height_column,
            "--levels-column": self.levels_column,
            "--id-column": self.id_column,
        }
