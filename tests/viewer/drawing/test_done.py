"""What a renderer says that it has done: requests and draws apart, in numbers that costs are predicted from."""

import numpy as np

from mmi.foundation.camera import view_towards
from viewer.drawing.renderer import Renderer
from viewer.plan import ImageKey, Objects, Plan, Relief, ReliefPart, Request, Sky, Slot

SIZE = (64, 48)
WINDOW = (-32, -24, *SIZE)
KEY = ImageKey("test", "one")


def test_requests_and_draws_are_counted_apart(scene):
    place = scene.cell("0001-01")
    view = view_towards(place.cell.reference, 0.3, 0.0, focal=55.0, window=WINDOW)
    part = view.cropped((0, 0, 20, 10))
    some = Objects("some", place.visible)
    triangles = int(scene.mesh.triangle_counts[place.visible].sum())
    into = Slot(KEY, SIZE)
    relief = Relief(KEY, (ReliefPart(view, (0, 0), 100.0), ReliefPart(part, (32, 24), 100.0)))
    requests = (
        Request(into, view, (some,)),
        Request(Slot(KEY, SIZE, (32, 24)), part, (some, Sky())),
        Request(Slot(ImageKey("test", "two"), SIZE), view, (relief,)),
    )
    columns, rows = relief.parts[0].grid
    grids = 2 * (2 * columns * rows)  # the larger part's grid for both
    with Renderer(scene.mesh, scene.ground, size=SIZE) as renderer:
        whole = renderer.draw(Plan((relief, some, Sky()), requests=requests), view)
        again = renderer.draw(Plan((relief, some, Sky())), view)
        assert renderer.execute(Plan((), requests=requests))[1:] == whole.done.requests[1:]
    pixels = SIZE[0] * SIZE[1]
    captured, drawn = whole.done[:2]
    assert captured[1:] == (2 * triangles + 1 + grids, 4, 2 * pixels + 200, 3, pixels + 200)
    assert drawn[1:] == (grids + triangles + 1, 3, 0, 0, pixels + 200)
    assert captured.seconds > 0.0 and drawn.seconds > 0.0
    np.testing.assert_allclose(captured.seconds + drawn.seconds, whole.seconds)
    assert (whole.triangles, whole.draws) == (captured.triangles + drawn.triangles, captured.draws + drawn.draws)
    assert again.done.requests == (0.0, 0, 0, 0, 0, 0)
    assert again.done.draws[1:] == drawn[1:]
