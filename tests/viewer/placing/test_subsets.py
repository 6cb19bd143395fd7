"""The best subset of cells: it removes enough and no border of it can move, and its choices are those of a plain search."""

import math

import numpy as np
import pytest

from viewer.placing.rules import Fov, PlacingRules
from viewer.placing.subsets import best_subset

RULES = PlacingRules(1000, 500, Fov(0.577, 0.433), look_ahead=1)
SIZE = (1.154, 0.866)


def some_cells(seed, count):
    rng = np.random.default_rng(seed)
    ends = np.sort(np.round(rng.uniform(-0.5, 0.5, size=(count, 2, 2)), 1), axis=2).reshape(-1, 4)
    return ends, np.round(rng.uniform(5.0, 80.0, size=count)), rng.integers(1, 60, size=count)


def plain_search(extents, distances, counts, enough, seen, farthest, rules):
    """Section 3.3.2.3 with sets of numbers."""
    borders = [distances, -extents[:, 3], extents[:, 2], -extents[:, 1], extents[:, 0]]

    def moved(subset, side, share):
        places = sorted({borders[side][n] for n in subset})
        if len(places) == 1:
            return subset
        border = places[max(len(places) // share, 1)]
        return frozenset(n for n in subset if borders[side][n] >= border)

    def value(subset):
        own = sorted(subset)
        removed = counts[own].sum()
        width = extents[own, 1].max() - extents[own, 0].min()
        height = extents[own, 3].max() - extents[own, 2].min()
        benefit = rules.small * (1.0 - max(width, height) / max(SIZE)) + rules.far * distances[own].min() / farthest
        return rules.cost * (1.0 - (seen - removed) / seen) + rules.benefit * benefit

    def next_ones(subset, share):
        for side in range(5):
            inner = moved(subset, side, share)
            if len(inner) < len(subset) and counts[sorted(inner)].sum() >= enough:
                yield inner

    def ahead(subset, share, deeper):
        rest = [ahead(one, share, deeper - 1) for one in next_ones(subset, share)] if deeper else []
        return max([value(subset), *rest])

    subset, share = frozenset(range(len(counts))), 2
    while share < 4 * len(counts):
        found = [(ahead(one, share, rules.look_ahead), one) for one in next_ones(subset, share)]
        if found:
            best = max(one for one, _ in found)
            subset = next(one for told, one in found if told == best)
        else:
            share *= 2
    return sorted(subset)


@pytest.mark.parametrize("seed", range(12))
def test_choices_are_those_of_a_plain_search(seed):
    extents, distances, counts = some_cells(seed, 40)
    seen = int(counts.sum()) + 50
    rules = RULES if seed % 2 else PlacingRules(1000, 500, Fov(0.577, 0.433), look_ahead=0, far=0.2, small=0.8)
    enough = int(counts.sum() * (0.2 + 0.05 * seed))
    chosen = best_subset(extents, distances, counts, enough=enough, seen=seen, size=SIZE, farthest=100.0, rules=rules)
    assert np.flatnonzero(chosen).tolist() == plain_search(extents, distances, counts, enough, seen, 100.0, rules)


def test_a_subset_removes_enough_and_no_border_can_move():
    extents, distances, counts = some_cells(99, 900)
    for share in (0.1, 0.5, 0.9, 0.999):
        enough = math.ceil(share * counts.sum())
        chosen = best_subset(
            extents, distances, counts, enough=enough, seen=int(counts.sum()), size=SIZE, farthest=100.0, rules=RULES
        )
        assert counts[chosen].sum() >= enough
        for border in (distances, -extents[:, 3], extents[:, 2], -extents[:, 1], extents[:, 0]):
            inner = chosen & (border > border[chosen].min())
            assert counts[inner].sum() < enough
        outside = ~chosen & (distances >= distances[chosen].min())
        outside &= (extents[:, 0] >= extents[chosen, 0].min()) & (extents[:, 1] <= extents[chosen, 1].max())
        outside &= (extents[:, 2] >= extents[chosen, 2].min()) & (extents[:, 3] <= extents[chosen, 3].max())
        assert not outside.any()  # contiguous


def test_all_are_chosen_where_all_are_no_more_than_enough():
    extents, distances, counts = some_cells(3, 30)
    for enough in (counts.sum(), 2 * counts.sum()):
        assert best_subset(
            extents, distances, counts, enough=int(enough), seen=9999, size=SIZE, farthest=100.0, rules=RULES
        ).all()


def test_the_farther_of_two_is_preferred():
    extents = np.array([[-0.3, -0.1, -0.1, 0.1], [0.1, 0.3, -0.1, 0.1]])
    for distances in (np.array([10.0, 50.0]), np.array([50.0, 10.0])):
        chosen = best_subset(
            extents,
            distances,
            np.array([100, 100]),
            enough=100,
            seen=200,
            size=SIZE,
            farthest=100.0,
            rules=RULES,
        )
        assert chosen.tolist() == (distances == 50.0).tolist()
