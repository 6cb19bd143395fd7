"""The cost model against machines whose costs are known: noisy ones, disturbed ones, one that becomes slower."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from viewer.plan import Costs, Done, Work
from viewer.runtime.cost_model import LATE, CostModel, fitted

TRUE = Costs(frame=3e-3, draw=4e-5, triangle=1.5e-7, request=3e-4, pixel=1e-8, relief=2.5e-8, captured=1e-7)


class Machine:
    """Draws frames of many kinds, each of which takes what ``costs`` say, times lognormal ``noise``."""

    def __init__(self, costs=TRUE, *, noise=0.2, seed=0):
        self.costs, self.noise, self.random = costs, noise, np.random.default_rng(seed)

    def frame(self):
        """(what was done, what it took without noise: requests and draws)."""
        integer = self.random.integers
        relief = int(integer(0, 3)) * 100_000
        draws = Work(0.0, int(integer(2000, 60_000)), int(integer(3, 12)), relief=relief)
        n = int(integer(0, 4))
        requests = Work(0.0, n * int(integer(100, 5000)), n, n * int(integer(1000, 60_000)), n)
        true = predicted(self.costs, Done(requests, draws))
        factors = np.exp(self.noise * self.random.normal(size=2))
        took = [one * factor for one, factor in zip(true, factors.tolist(), strict=True)]
        return Done(requests._replace(seconds=took[0]), draws._replace(seconds=took[1])), true


def predicted(costs, done):
    """What a frame's requests and draws are predicted to take."""
    work = done.requests
    each = [getattr(work, name) for name in ("requests", "draws", "triangles", "pixels", "relief")]
    prices = (costs.request, costs.draw, costs.captured, costs.pixel, costs.relief)
    draws = costs.of_draws(triangles=done.draws.triangles, draws=done.draws.draws, relief=done.draws.relief)
    return sum(a * b for a, b in zip(each, prices, strict=True)), draws


def followed(model, machine, frames):
    """The model after some frames, and predicted : true of their draws and requests, (frames, 2)."""
    ratios = []
    for _ in range(frames):
        done, true = machine.frame()
        found = predicted(model.costs, done)
        ratios.append([a / b if b else np.nan for a, b in zip(found[::-1], true[::-1], strict=True)])
        model = model.after(done)
    return model, np.array(ratios)


def off(factor):
    return Costs(*(factor * cost for cost in TRUE))


@pytest.mark.parametrize("start", [Costs(), TRUE, off(3.0), off(1 / 3)])
def test_predictions_become_slight_over_estimates(start):
    model, _ = followed(CostModel(start), Machine(), 150)
    _, ratios = followed(model, Machine(seed=1), 300)
    medians = np.nanmedian(ratios, axis=0)
    assert np.all((medians > 1.0) & (medians < 1.45)), medians
    assert np.all(np.nanquantile(ratios, 0.05, axis=0) > 0.85)


@pytest.mark.parametrize("noise", [0.1, 0.3])
def test_about_four_frames_of_five_and_three_requests_of_four_take_no_longer_than_predicted(noise):
    machine, model = Machine(noise=noise), CostModel(TRUE)
    held = []
    for i in range(600):
        done, _ = machine.frame()
        if i >= 100:
            found = predicted(model.costs, done)
            held.append((done.requests.seconds <= found[0], done.draws.seconds <= found[1]))
        model = model.after(done)
    assert np.all(np.abs(np.mean(held, axis=0) - [0.73, 0.8]) < 0.08), np.mean(held, axis=0)


def test_requests_that_sometimes_wait_for_a_processor_are_predicted_as_they_usually_are():
    machine, model, ratios = Machine(noise=0.1), CostModel(TRUE), []
    for _ in range(600):
        done, true = machine.frame()
        if machine.random.random() < 0.1:
            done = done._replace(requests=done.requests._replace(seconds=10.0 * done.requests.seconds))
        if true[0]:
            ratios.append(predicted(model.costs, done)[0] / true[0])
        model = model.after(done)
    assert 1.0 < np.median(ratios) < 1.4


def test_a_machine_that_becomes_twice_as_slow_is_followed_within_a_second():
    model, _ = followed(CostModel(TRUE), Machine(), 100)
    _, ratios = followed(model, Machine(off(2.0), seed=1), 60)
    assert np.nanmedian(ratios[:3], axis=0).max() < 0.85
    assert np.nanmedian(ratios[20:], axis=0).min() > 0.95
    assert np.nanmedian(ratios[20:], axis=0).max() < 1.5


def test_a_machine_that_becomes_twice_as_fast_is_followed_within_four():
    model, _ = followed(CostModel(off(2.0)), Machine(off(2.0)), 100)
    _, ratios = followed(model, Machine(seed=1), 200)
    assert np.nanmedian(ratios[:3], axis=0).min() > 1.7
    assert np.nanmedian(ratios[120:], axis=0).max() < 1.5


@pytest.mark.parametrize("took", [1e-9, 10.0, 1e6])
def test_a_single_frame_that_is_disturbed_moves_predictions_by_an_eighth_at_most(took):
    model, _ = followed(CostModel(TRUE), Machine(), 100)
    machine = Machine(seed=1)
    done, _ = machine.frame()
    after = model.after(Done(done.requests._replace(seconds=took), done.draws._replace(seconds=took)))
    for _ in range(100):
        other, _ = machine.frame()
        for one, two in zip(predicted(model.costs, other), predicted(after.costs, other), strict=True):
            if one:
                assert 0.8 < two / one < 1.25
    before, changed = (predicted(one.costs, done)[1] for one in (model, after))
    assert 0.85 < changed / before < 1.15


def test_one_frame_of_twenty_that_takes_ten_times_as_long_is_not_what_is_expected():
    machine, random = Machine(), np.random.default_rng(5)
    model, ratios = CostModel(TRUE), []
    for _ in range(400):
        done, true = machine.frame()
        if random.random() < 0.05:
            done = done._replace(draws=done.draws._replace(seconds=10.0 * done.draws.seconds))
        ratios.append(predicted(model.costs, done)[1] / true[1])
        model = model.after(done)
    assert np.median(ratios[100:]) < 1.5
    assert np.quantile(ratios[100:], 0.95) < 1.8


times = st.floats(0.0, 1e9, allow_nan=False)
counts = st.integers(0, 10**9)
works = st.builds(Work, times, counts, counts, counts, counts, counts)


@settings(deadline=None)
@given(st.lists(st.tuples(works, works), max_size=40), st.floats(0.0, 1.0))
def test_costs_are_always_positive_and_finite(pairs, planning):
    model = CostModel()
    for requests, draws in pairs:
        model = model.after(Done(requests, draws), planning=planning)
        assert all(0.0 < cost < math.inf for cost in model.costs)


@settings(deadline=None)
@given(st.lists(works, max_size=12), st.lists(works, max_size=12))
def test_whatever_is_fitted_is_positive_and_finite(frames, requests):
    assert all(0.0 < cost < math.inf for cost in fitted(frames, requests))


def test_frames_that_were_not_timed_teach_nothing():
    model = CostModel(TRUE)
    assert model.after(Done()) == model
    assert model.after(Done(Work(0.0, 10, 1, 100, 1), Work(0.0, 1000, 4)), planning=1.0) == model


def test_the_making_of_plans_is_a_part_of_what_a_frame_costs():
    model, done = CostModel(TRUE), Done(Work(), Work(3e-3 + 4e-5, 0, 1))
    for _ in range(200):
        model = model.after(done, planning=6e-3)
    assert predicted(model.costs, done)[1] == pytest.approx(9e-3 + 4e-5, rel=0.01)


def examples(machine, count):
    found = [machine.frame()[0] for _ in range(count)]
    return [one.draws for one in found], [one.requests for one in found]


def assert_predicts(costs, machine, *, within):
    for _ in range(100):
        done, true = machine.frame()
        for one, two in zip(predicted(costs, done), true, strict=True):
            assert one == pytest.approx(two, rel=within)


@pytest.mark.parametrize("machine", [TRUE, off(30.0), off(1 / 30), Costs(1e-3, 3e-4, 1e-8, 1e-3, 1e-9, 9e-8, 3e-8)])
def test_exact_examples_are_predicted_nearly_exactly(machine):
    exact = Machine(machine, noise=0.0)
    found = fitted(*examples(exact, 20))
    assert_predicts(found, exact, within=0.1)
    np.testing.assert_allclose(found, machine, rtol=0.35)


def test_noisy_examples_are_fitted_nearly():
    found = fitted(*examples(Machine(noise=0.1), 60))
    assert_predicts(found, Machine(noise=0.1, seed=1), within=0.25)


def test_what_there_is_no_example_of_costs_what_it_does_by_default_where_all_costs_as_much_more():
    slow = Machine(Costs(*(3.0 * cost for cost in Costs())), noise=0.0)
    found = fitted(examples(slow, 20)[0], [])
    np.testing.assert_allclose(found, slow.costs, rtol=1e-6)
    assert fitted([], []) == Costs()


def test_what_examples_do_not_tell_apart_has_a_share_of_the_cost_each():
    """Frames that are all the same, and captures that are: nothing of it costs nothing."""
    done = Done(Work(0.0, 3000, 2, 90_000, 2), Work(0.0, 20_000, 6, relief=100_000))
    requests, draws = predicted(TRUE, done)
    found = fitted([done.draws._replace(seconds=draws)] * 5, [done.requests._replace(seconds=requests)] * 5)
    for one, two in zip(predicted(found, done), (requests, draws), strict=True):
        assert one == pytest.approx(two, rel=0.01)
    assert all(0.3 < cost / true < 3.0 for cost, true in zip(found, TRUE, strict=True))


DRAWS = Work(0.0, 40_000, 6, relief=100_000)


def filled(model, machine, *, target, frames, learn=True):
    """Frames that have ``DRAWS`` and are filled with requests: seconds with and without those, (frames, 2), and how many."""
    seconds, captured = [], 0
    for _ in range(frames):
        left = target - predicted(model.costs, Done(Work(), DRAWS))[1]
        n = max(int(left / model.costs.of_request(triangles=500, draws=1, pixels=10_000)), 0)
        requests = Work(0.0, 500 * n, n, 10_000 * n, n)
        factors = np.exp(machine.noise * machine.random.normal(size=2))
        took = np.array(predicted(machine.costs, Done(requests, DRAWS))) * factors
        if learn:
            done = Done(requests._replace(seconds=float(took[0])), DRAWS._replace(seconds=float(took[1])))
            model = model.after(done, target=target)
        seconds.append((took.sum(), took[1]))
        captured += n
    return model, np.array(seconds), captured / frames


@pytest.mark.parametrize(("noise", "least"), [(0.02, 0.7), (0.1, 0.35), (0.2, 0.05)])
def test_frames_that_requests_fill_are_hardly_ever_late_because_of_them(noise, least):
    """``least`` is the share of what somebody captures who knows the costs and keeps no margin, and is late for it."""
    target = 1.5 * predicted(TRUE, Done(Work(), DRAWS))[1]
    _, bold, many = filled(CostModel(TRUE), Machine(noise=noise), target=target, frames=2000, learn=False)
    model, _, _ = filled(CostModel(TRUE), Machine(noise=noise, seed=1), target=target, frames=300)
    _, seconds, some = filled(model, Machine(noise=noise, seed=2), target=target, frames=2000)
    shares = (seconds > LATE * target).mean(axis=0)
    assert shares[0] - shares[1] < 0.01
    assert some > least * many
    if noise >= 0.1:
        assert (bold > LATE * target).mean(axis=0)[0] - shares[1] > 0.05, "without a margin many should be late"


def test_a_margin_goes_when_there_is_no_need_of_it_any_more_nor_anything_captured():
    model = CostModel(TRUE, 2.0)
    for _ in range(3000):
        model = model.after(Done(Work(), Work(predicted(model.costs, Done(Work(), DRAWS))[1], *DRAWS[1:])), target=1.0)
    assert model.margin == 1.0


def test_what_is_late_without_its_requests_is_not_late_because_of_them():
    slow = Work(2.0, *DRAWS[1:])
    assert CostModel(TRUE).after(Done(Work(1.0, 10, 1, 100, 1), slow), target=1.0).margin == 1.0
    fast = Work(1.0, *DRAWS[1:])
    assert CostModel(TRUE).after(Done(Work(1.0, 10, 1, 100, 1), fast), target=1.0).margin > 1.1
    assert CostModel(TRUE).after(Done(Work(0.05, 10, 1, 100, 1), fast), target=1.0).margin == 1.0


def test_requests_that_take_longer_than_they_may_are_late_though_the_frame_is_not():
    model, requests = CostModel(TRUE), Work(0.5, 10, 1, 100, 1)
    assert model.after(Done(requests, Work(1.0, *DRAWS[1:])), target=10.0, updates=0.3).margin > 1.1
    assert model.after(Done(requests, Work(1.0, *DRAWS[1:])), target=10.0, updates=0.4).margin == 1.0  # a tenth of 1.4
    assert model.after(Done(requests, Work(1.0, *DRAWS[1:])), target=10.0).margin == 1.0
    assert model.after(Done(requests, Work(11.5, *DRAWS[1:])), target=10.0, updates=0.1).margin == 1.0


def test_what_triangles_take_in_requests_is_found_apart_from_what_they_take_in_frames():
    apart = TRUE._replace(triangle=1e-6, captured=1e-8)
    model, _ = followed(CostModel(TRUE), Machine(apart, noise=0.1), 300)
    _, ratios = followed(model, Machine(apart, noise=0.1, seed=1), 200)
    medians = np.nanmedian(ratios, axis=0)
    assert np.all((medians > 0.95) & (medians < 1.4)), medians
