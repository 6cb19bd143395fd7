"""Calibration with painters that draw nothing but take as long as a machine whose costs are known."""

from dataclasses import replace

import numpy as np
import pytest

from viewer.drawing.drawn_picture import DrawnPicture
from viewer.drawing.renderer import Renderer
from viewer.plan import Costs, Done, Ground, Objects, Relief, Work
from viewer.runtime.calibration import CAUTION, calibrated


class Machine:
    """A painter for which drawing takes what ``costs`` say, times lognormal noise, and one time of ten tenfold."""

    def __init__(self, scene, costs, *, noise=0.0, disturbed=0.0):
        self.scene, self.costs, self.noise, self.disturbed = scene, costs, noise, disturbed
        self.random = np.random.default_rng(1)
        self.images, self.seconds, self.drawn = set(), 0.0, 0

    def draw(self, plan, view, *, read=True):  # noqa: ARG002
        self.images -= set(plan.drops)
        captured = Work()
        for request in plan.requests:
            triangles, draws, relief = self.count(request.draws)
            seconds = self.costs.of_request(triangles=triangles, draws=draws, pixels=request.pixels, relief=relief)
            captured = Work(*np.add(captured, (seconds, triangles, draws, request.pixels, 1, relief)).tolist())
            self.images.add(request.into.image)
        triangles, draws, relief = self.count(plan.draws)
        seconds = self.costs.of_draws(triangles=triangles, draws=draws, relief=relief)
        done = Done(
            *(
                one._replace(seconds=one.seconds * self.factor())
                for one in (captured, Work(seconds, triangles, draws, relief=relief))
            )
        )
        seconds = done.requests.seconds + done.draws.seconds
        self.seconds += seconds
        self.drawn += 1
        picture = DrawnPicture(np.empty((0, 0, 3), np.uint8), None, None, None, seconds, None, triangles, draws)
        return replace(picture, done=done)

    def factor(self):
        return np.exp(self.noise * self.random.normal()) * (10.0 if self.random.random() < self.disturbed else 1.0)

    def count(self, draws):
        triangles, relief = 0, 0
        for draw in draws:
            match draw:
                case Objects():
                    triangles += int(self.scene.mesh.triangle_counts[draw.objects].sum())
                case Ground():
                    triangles += int(self.scene.ground.triangle_counts[list(draw.tiles)].sum())
                case Relief():
                    assert draw.image in self.images
                    triangles += sum(2 * part.grid[0] * part.grid[1] for part in draw.parts)
                    relief += draw.pixels
                case _:
                    triangles += 1
        return triangles, len(draws), relief


TRUE = Costs(frame=1e-3, draw=2e-5, triangle=1e-6, request=2e-4, pixel=2e-8, relief=4e-8, captured=1e-6)
EXAMPLES = [(500, 6, 0), (300, 4, 60_000), (100, 12, 20_000)]


@pytest.mark.parametrize(
    ("noise", "disturbed", "speed", "within"), [(0.0, 0.0, 1.0, 0.2), (0.2, 0.1, 1.0, 0.3), (0.2, 0.1, 0.02, 0.3)]
)
def test_costs_of_a_machine_are_found(scene, noise, disturbed, speed, within):
    true = Costs(*(speed * cost for cost in TRUE))
    found = calibrated(Machine(scene, true, noise=noise, disturbed=disturbed), scene)
    for triangles, draws, size in EXAMPLES:
        for name in ("of_draws", "of_request"):
            told = {"triangles": triangles, "draws": draws} | (
                {"pixels": size} if name == "of_request" else {"relief": size}
            )
            assert getattr(found, name)(**told) == pytest.approx(CAUTION * getattr(true, name)(**told), rel=within), (
                name
            )


@pytest.mark.parametrize("slower", [1.0, 10.0])
def test_it_takes_less_than_a_second_and_leaves_no_image(scene, slower):
    machine = Machine(scene, Costs(*(slower * cost for cost in Costs())))
    calibrated(machine, scene)
    assert machine.seconds < (1.0 if slower == 1.0 else 2.0)
    assert not machine.images
    assert machine.drawn > 20


def test_a_city_is_drawn_in_parts_where_it_is_large(scene, monkeypatch):
    most = []

    class Counting(Machine):
        def count(self, draws):
            found = super().count([draw for draw in draws if isinstance(draw, Objects)])
            most.append(found[0])
            return super().count(draws)

    monkeypatch.setattr("viewer.runtime.calibration._TRIANGLES", 40)
    monkeypatch.setattr("viewer.runtime.calibration._FEWEST", 1)
    calibrated(Counting(scene, TRUE), scene)
    assert 10 < max(most) <= 60 < scene.mesh.triangle_counts.sum()


def test_what_really_draws_can_be_calibrated(scene):
    with Renderer(scene.mesh, scene.ground, size=(scene.camera.width, scene.camera.height)) as renderer:
        first, second = calibrated(renderer, scene), calibrated(renderer, scene)
    for costs in (first, second):
        assert 1e-5 < costs.of_draws(triangles=1000, draws=5) < 1.0
        assert 1e-6 < costs.of_request(triangles=100, draws=1, pixels=10_000) < 1.0
