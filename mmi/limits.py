"""The largest things that are read, in one table: what is larger is refused, or left out and counted, before it is read.

They are there for files that are damaged or made to do harm: a few bytes can say that gigabytes follow, or unpack into
them. None is meant for real cities: a metropolis of a million buildings stays within all of them. Readers look a limit up
where they use it (``limits.PICTURE_PIXELS``), so that tests can lower it. The table for users is in ``docs/cities.md``.
"""

from __future__ import annotations

__all__ = [
    "ACCESSOR_ELEMENTS",
    "BUILDING_HEIGHT",
    "BUILDING_LEVELS",
    "CITY_BYTES",
    "COORDINATE",
    "CROSSINGS",
    "CROSSINGS_A_POINT",
    "CROSSINGS_IN_ALL",
    "EDGES_COMPARED",
    "EDGES_COMPARED_IN_ALL",
    "EMPTY_ACCESSOR_ELEMENTS",
    "EXPANSION",
    "EXTENT",
    "FACE_CORNERS",
    "INSTANCES",
    "JSON_BYTES",
    "MANIFEST_BYTES",
    "MESH_COORDINATE",
    "OUTLINE_POINTS",
    "PICTURES_PIXELS",
    "PICTURE_BYTES",
    "PICTURE_PIXELS",
    "PLACED_TRIANGLES",
    "RASTER_CELLS",
    "RECORD_BYTES",
    "REWRITTEN_BYTES",
    "SMALL_BYTES",
    "STREET_CROSSINGS",
    "STREET_EDGES_COMPARED",
    "STREET_REACH",
    "UNPACKED_ANYWAY",
    "UNPACKED_BYTES",
    "VIEWS",
    "XML_DEPTH",
    "ZIP_BYTES",
    "ZIP_FILES",
]

# ------------------------------------------------------------------------------------------------------ files of cities

CITY_BYTES = 64 << 30
"""Bytes of a city's file, of any format: six times a metropolis of a million buildings as CityJSON lines (10 GB)."""
SMALL_BYTES = 1 << 30
"""Bytes of a file of materials (.mtl)."""
UNPACKED_BYTES = 64 << 30
"""Bytes that a file of OpenStreetMap or SUMO unpacks into, as XML or as blocks of PBF."""
EXPANSION, UNPACKED_ANYWAY = 200, 64 << 20
"""How many times its own bytes a file unpacks into, once that is more than so many: XML shrinks to a tenth or a thirtieth."""
REWRITTEN_BYTES = 4 << 30
"""Bytes of OpenStreetMap's XML that is written anew in memory: what editors and Overpass save is a thousandth of it."""
ZIP_BYTES = 16 << 30
"""Bytes that the tiles in a zip unpack into, together; they lie on the disk meanwhile."""
ZIP_FILES = 100_000
"""Files in a zip of tiles."""
XML_DEPTH = 200
"""How deep elements of CityGML are nested; Python calls itself once for each level."""

# ------------------------------------------------------------------------------------------------- outlines and streets

OUTLINE_POINTS = 500_000
"""Points of an outline; the largest buildings of OpenStreetMap have some thousands."""
CROSSINGS_A_POINT, CROSSINGS = 10, 50_000
"""How often the edges of an outline cross, for each of its points and in all: mending takes 50 microseconds for each."""
CROSSINGS_IN_ALL = 1_000_000
"""How often edges of all outlines of a file cross, where they are mended."""
EDGES_COMPARED = 10_000_000
"""Pairs of edges of an outline whose boxes overlap: to look at them takes two seconds, and geometry as long again."""
EDGES_COMPARED_IN_ALL = 300_000_000
"""Likewise of all outlines that are invalid or have more than a thousand points: about a minute, by the time that one takes."""
STREET_CROSSINGS = 100_000
"""How often streets without common nodes cross, or once for each of their edges: to join them takes 0.4 ms for each."""
STREET_EDGES_COMPARED = 50_000_000
"""Pairs of edges of such streets whose boxes overlap, or a hundred for each edge: about ten seconds."""
STREET_REACH = 1e6
"""Metres from the origin that streets reach: who reaches further has damaged coordinates."""
EXTENT = 100_000.0
"""Metres across all buildings: a city, however large, in a frame in which the earth is flat."""
BUILDING_HEIGHT = 1000.0
"""Metres; the highest building has 828."""
BUILDING_LEVELS = 250.0
"""Storeys; the most in a building are 163."""
RASTER_CELLS = 4_000_000_000
"""Cells of a raster of heights: 63 km x 63 km at a metre each."""

# --------------------------------------------------------------------------------------------------------------- models

COORDINATE = 1e9
"""The largest coordinate in a file with a coordinate system, in its units: beyond is no place on earth."""
MESH_COORDINATE = 1e8
"""The largest coordinate of a mesh, in metres: no projection of the earth reaches there."""
FACE_CORNERS = 1 << 30
"""Corners of all faces of a file of CityJSON or CityGML, templates and links as often as they are used."""
PLACED_TRIANGLES = 1 << 28
"""Triangles of a glTF file, meshes as often as they are used: a metropolis of a million buildings has as many at most."""
INSTANCES = 100_000
"""Copies of meshes in a glTF file: more would be a forest, not a city."""
ACCESSOR_ELEMENTS = 1 << 28
"""Numbers behind an accessor of a glTF file."""
EMPTY_ACCESSOR_ELEMENTS = 1 << 24
"""Numbers behind an accessor without data of its own, which are zeros: a few bytes ask for as many as they like."""

# ------------------------------------------------------------------------------------------------------------- pictures

PICTURE_BYTES = 1 << 30
"""Bytes of an encoded picture; the largest that is read has 0.5 GB where nothing of it is packed."""
PICTURE_PIXELS = 1 << 26
"""Pixels of a picture: 8192 x 8192."""
PICTURES_PIXELS = 1 << 32
"""Pixels of all pictures of a model, which lie in memory with three bytes each: 15,000 photographs of 512 x 512."""

# ---------------------------------------------------------------------------------------- datasets, walks and what moves

MANIFEST_BYTES = 4 << 30
"""Bytes of a manifest: of 50,000 cells of 80 kB each, which is how Paris would come out."""
RECORD_BYTES = 256_000_000
"""Bytes of a cell's record, and of a build's report."""
JSON_BYTES = 256_000_000
"""Bytes of a walk or of a file of what moves."""
VIEWS = 100_000
"""Random views that a comparison is asked for: at ten a second they take three hours."""
