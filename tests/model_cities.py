"""A small city with everything that files of 3D models carry: courtyards, towers, textured and open meshes, a hill."""

from __future__ import annotations

import numpy as np
from cities import block, streets
from shapely.geometry import Polygon, box

from mmi.city.model import PAINTED, PLAIN, City, CityObject, Prism, Texture, TriangleMesh
from mmi.city.terrain import Terrain

# Quads of a box, counter-clockwise from outside: bottom, top, south, east, north, west.
QUADS = ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7))
BOX_TRIANGLES = np.array([half for a, b, c, d in QUADS for half in ((a, b, c), (a, c, d))])
ORIGIN = (385000.5, 6672000.25, 10.0)


def box_corners(x0, y0, z0, x1, y1, z1):
    """The eight corners of a box, lower four first, counter-clockwise from above."""
    return np.array([(x, y, z) for z in (z0, z1) for x, y in ((x0, y0), (x1, y0), (x1, y1), (x0, y1))], dtype=float)


def chequers(name, color):
    image = np.full((4, 8, 3), 255, dtype=np.uint8)
    image[::2, ::2] = color
    return Texture(name, image)


def dressed_box():
    """A closed box: a plain brown bottom, a painted top, walls of two textures, one of them tinted."""
    uv = np.random.default_rng(3).uniform(-2.0, 3.0, (12, 3, 2)).astype(np.float32)
    textures = np.array([PLAIN, PLAIN, PAINTED, PAINTED, 1, 1, 0, 0, 1, 1, 0, 0])
    colors = np.full((12, 3), 255)
    colors[:2] = (90, 60, 30)
    colors[6:8] = (255, 200, 100)
    return TriangleMesh(box_corners(40.0, 20.0, 0.0, 52.5, 31.0, 8.0), BOX_TRIANGLES, textures, colors, uv)


def open_box():
    """A box without its bottom, plain red."""
    triangles = BOX_TRIANGLES[2:]
    colors = np.tile([200, 10, 10], (10, 1))
    return TriangleMesh(box_corners(60.0, 20.0, 0.0, 70.0, 30.0, 5.0), triangles, np.full(10, PLAIN), colors)


def model_city():
    yard = Polygon(box(0, 20, 20, 40).exterior, [box(5, 25, 12, 33).exterior.coords])
    objects = (
        CityObject("way/1", (Prism(yard, 0.0, 12.0),)),
        CityObject("way/2", (Prism(box(0, -40, 20, -20), 0.0, 6.0), Prism(box(5, -35, 10, -25), 6.0, 30.0))),
        CityObject("dressed", (Prism(box(40, 20, 52.5, 31), 0.0, 8.0),), dressed_box(), ()),
        CityObject("open", (Prism(box(60, 20, 70, 30), 0.0, 5.0),), open_box(), ()),
        block("street/1", -30.0, 20.0, -20.0, 30.0, 7.0),
    )
    heights = np.array([[0.0, 0.5, 1.0, 1.0], [0.0, 1.0, 2.0, 1.5], [0.5, 1.0, 1.5, 1.0]])
    lines = streets([(-20.0, 0.0), (0.0, 0.0), (30.0, 4.0)], [(30.0, 4.0), (60.0, 4.0)], half_width=2.5)
    for _, _, edge in lines.edges(data=True):
        if edge["index"] == 1:
            edge["name"], edge["kind"] = "", "residential"
    return City(
        objects,
        lines,
        "EPSG:3067",
        ORIGIN,
        "models.city",
        terrain=Terrain((-40.0, -50.0), 40.0, heights),
        textures=(chequers("bricks", (150, 40, 30)), chequers("glass/front.png", (20, 60, 90))),
    )
