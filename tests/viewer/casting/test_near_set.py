import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from viewer.casting.near_set import Neighbourhoods


def distances(boxes, eye):
    """(n,) metres on the map from a place to each box, NaN for none."""
    low, high = boxes[:, 0, :2], boxes[:, 1, :2]
    return np.hypot(*np.maximum(np.maximum(low - eye[:2], eye[:2] - high), 0.0).T)


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    count=st.integers(0, 80),
    extent=st.sampled_from([1.0, 60.0, 3000.0]),
    reach=st.sampled_from([1.0, 25.0, 100.0]),
)
def test_who_is_within_reach_is_near_and_hardly_anybody_else(seed, count, extent, reach):
    rng = np.random.default_rng(seed)
    low = rng.uniform(-extent, extent, (count, 3))
    boxes = np.stack([low, low + rng.uniform(0.0, 0.3 * extent, (count, 3))], axis=1)
    boxes[rng.uniform(size=count) < 0.1] = np.nan
    found = Neighbourhoods(boxes, reach=reach)
    for eye in rng.uniform(-1.5 * extent, 1.5 * extent, (8, 3)):
        near = found.around(eye)
        away = distances(boxes, eye)
        must, may = np.flatnonzero(away <= reach), np.flatnonzero(away <= reach + 8.0 * 2.0**0.5)
        assert np.isin(must, near.objects).all()
        assert np.isin(near.objects, may).all()
        assert near.objects.tolist() == np.unique(near.objects).tolist() == np.flatnonzero(near.flags).tolist()


def test_a_key_names_a_set():
    rng = np.random.default_rng(3)
    low = rng.uniform(-200.0, 200.0, (300, 3))
    found = Neighbourhoods(np.stack([low, low + 5.0], axis=1), reach=50.0)
    named = {}
    for eye in rng.uniform(-30.0, 30.0, (200, 3)):
        near = found.around(eye)
        assert named.setdefault(near.key, near.objects.tolist()) == near.objects.tolist()
    assert len(named) < 80, "a viewer who moves a little has the same set"
