"""Small models with images placed for them: round towers of different heights on a floor, and blocks along streets."""

import math

import numpy as np
from cities import city_of
from shapely.geometry import Point, box

from mmi.city.model import CityObject, Prism
from mmi.dataset.city_files import city_meshes
from mmi.foundation.camera import Camera
from viewer.making.models import Model
from viewer.making.place_images import place_images
from viewer.placing.rules import PlacingRules, fov_of

CAMERA = Camera(96, 72, math.radians(60.0))
RULES = PlacingRules(budget=2000, target=1400, fov=fov_of(CAMERA), depth=4)


def towers():
    """36 of them, of 92 triangles each, close to each other in the middle."""
    rng = np.random.default_rng(5)
    made = []
    for i in range(6):
        for j in range(6):
            x, y = 12.0 * (i - 2.5) + rng.uniform(-2.0, 2.0), 12.0 * (j - 2.5) + rng.uniform(-2.0, 2.0)
            outline = Point(1.6 * x, y).buffer(rng.uniform(2.0, 4.0), quad_segs=8)
            made.append(CityObject(f"tower/{i}{j}", (Prism(outline, 0.0, float(rng.uniform(6.0, 20.0))),)))
    return city_of(*made, lines=([(-80.0, -50.0), (80.0, -50.0)],))


def blocks(street=10.0):
    """36 square ones of 30 m, higher than viewers, and as many round trees where streets cross."""
    rng = np.random.default_rng(3)
    made = []
    for i in range(6):
        for j in range(6):
            x, y = (30.0 + street) * i, (30.0 + street) * j
            tree = Point(x + 30.0 + 0.5 * street, y + 30.0 + 0.5 * street).buffer(1.5, quad_segs=8)
            block = box(x, y, x + 30.0, y + 30.0)
            made.append(CityObject(f"block/{i}{j}", (Prism(block, 0.0, float(rng.uniform(12.0, 18.0))),)))
            made.append(CityObject(f"tree/{i}{j}", (Prism(tree, 0.0, float(rng.uniform(3.0, 6.0))),)))
    return city_of(*made, lines=([(-5.0, -50.0), (-5.0, 300.0)],))


def model_of(city):
    return Model(city, *city_meshes(city))


def placed(model, folder, **options):
    """Place images in ``folder``."""
    return place_images(model, folder, camera=CAMERA, **{"rules": RULES, "pictures": 5, **options})
