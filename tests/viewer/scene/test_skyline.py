"""What buildings hide of what moves: never what a ray reaches, and most of what none does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from cities import crossroads
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles import PrismRays
from shapely.geometry import box

from mmi.city.model import CityObject, Prism
from viewer.scene.skyline import skyline_of, unhidden


@pytest.fixture(scope="module")
def city():
    return crossroads()


@pytest.fixture(scope="module")
def skyline(city):
    return skyline_of(city)


def boxes(places, size=(2.0, 1.0, 1.5)):
    """(k, 8, 3) corners of boxes that stand on z = 0 around places (k, 2) or (k, 3)."""
    places = np.asarray(places, dtype=float)
    foot = np.column_stack([places, np.zeros(len(places))]) if places.shape[1] == 2 else places
    pick = np.array([[(k >> axis) & 1 for axis in range(3)] for k in range(8)])
    return foot[:, None] + np.where(pick, np.array(size), np.array([-size[0], -size[1], 0.0]))


def reached(city, eye, corners, count=3000):
    """(k,) which boxes a ray from ``eye`` meets first, of many towards points all over them."""
    rng = np.random.default_rng(1)
    solid = [
        CityObject(f"box {i}", (Prism(box(*one.min(axis=0)[:2], *one.max(axis=0)[:2]), 0.0, one[:, 2].max()),))
        for i, one in enumerate(corners)
    ]
    with_boxes = replace(city, objects=(*city.objects, *solid))
    low, high = corners.min(axis=1), corners.max(axis=1)
    which = np.arange(count) % len(corners)
    targets = low[which] + rng.uniform(size=(count, 3)) * (high - low)[which]
    hits = PrismRays(with_boxes).first_hits(np.tile(eye, (count, 1)), targets - eye)
    return np.isin(len(city.objects) + np.arange(len(corners)), hits)


place = st.tuples(st.floats(-170.0, 170.0), st.floats(-170.0, 170.0))


@settings(max_examples=40, deadline=None)
@given(
    st.lists(place, min_size=1, max_size=6),
    st.floats(-140.0, 140.0),
    st.floats(-8.0, 8.0),
    st.floats(1.2, 30.0),
    st.booleans(),
)
def test_what_a_ray_reaches_is_never_hidden(city, skyline, places, along, aside, height, turned):
    eye = np.array([aside, along, height] if turned else [along, aside, height])
    corners = boxes(places)
    assert (unhidden(skyline, eye, corners) | ~reached(city, eye, corners)).all()


def test_what_stands_behind_blocks_is_hidden(skyline):
    eye = np.array([0.0, 0.0, 1.7])
    corners = boxes([(80.0, 80.0), (80.0, 3.0), (-80.0, -80.0), (0.0, 100.0), (80.0, -75.0)])
    assert unhidden(skyline, eye, corners).tolist() == [False, True, False, True, False]


def test_what_rises_above_the_roofs_is_not_hidden(skyline):
    eye = np.array([0.0, 0.0, 1.7])
    assert unhidden(skyline, eye, boxes([(80.0, 80.0)], size=(2.0, 1.0, 200.0))).all()
    assert unhidden(skyline, eye, boxes([(80.0, 80.0, 150.0)])).all()
    assert unhidden(skyline, np.array([0.0, 0.0, 90.0]), boxes([(80.0, 80.0)])).all()


def test_what_is_around_the_viewer_is_not_hidden(skyline):
    eye = np.array([0.0, 0.0, 1.7])
    assert unhidden(skyline, eye, boxes([(0.0, 0.0), (2.5, 0.0)])).all()


def test_a_viewer_within_a_building_sees_all_but_what_others_hide(skyline):
    eye = np.array([40.0, 40.0, 5.0])
    assert unhidden(skyline, eye, boxes([(3.0, 40.0), (200.0, 40.0)])).tolist() == [True, False]


def test_nothing_to_ask_for(skyline):
    assert unhidden(skyline, np.zeros(3), np.empty((0, 8, 3))).shape == (0,)
