"""A small model with images placed for it: round towers of different heights on a floor, without streets."""

import math

import numpy as np
from cities import city_of
from shapely.geometry import Point

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


def model_of(city):
    return Model(city, *city_meshes(city))


def placed(model, folder, **options):
    """Place images in ``folder``."""
    return place_images(model, folder, camera=CAMERA, **{"rules": RULES, "pictures": 5, **options})
