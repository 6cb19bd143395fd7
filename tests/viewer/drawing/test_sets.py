"""Sets of objects on the GPU: kept while they are drawn again and again, as far as there is room for them."""

import numpy as np
import pytest

from mmi.foundation.camera import view_towards
from viewer.drawing.kinds import meshes
from viewer.drawing.renderer import Renderer
from viewer.plan import ImageKey, Objects, Plan, Relief, ReliefPart, Request, Sky, Slot

SIZE = (64, 48)


@pytest.fixture
def made(monkeypatch):
    """The triangles of each set that is made."""
    found = []
    gather = meshes.triangles_of

    def remembered(mesh, objects):
        found.append(gather(mesh, objects))
        return found[-1]

    monkeypatch.setattr(meshes, "triangles_of", remembered)
    return found


def draw(renderer, place, sets):
    view = view_towards(place.cell.reference, 0.3, 0.0, focal=55.0, window=(-32, -24, *SIZE))
    return renderer.draw(Plan((*sets, Sky())), view)


def test_many_small_sets_are_made_once(scene, made):
    """As many as a technique has that captures the layers of some cells again, a piece at a time."""
    place = scene.cell("0001-01")
    sets = [Objects(f"piece {i}", place.visible[i % len(place.visible) :][:1]) for i in range(300)]
    with Renderer(scene.mesh, scene.ground, size=SIZE) as renderer:
        first = draw(renderer, place, sets)
        assert len(made) == 300
        again = draw(renderer, place, sets[::-1])
    assert len(made) == 300
    assert (first.triangles, first.draws) == (again.triangles, again.draws)


def test_sets_that_were_not_drawn_for_longest_make_room(scene, made, monkeypatch):
    place = scene.cell("0001-01")
    sets = [Objects(f"set {i}", place.visible[i : i + 2]) for i in range(4)]
    counts = [int(scene.mesh.triangle_counts[one.objects].sum()) for one in sets]
    monkeypatch.setattr(meshes, "_MOST_TRIANGLES", sum(counts[:3]))
    with Renderer(scene.mesh, scene.ground, size=SIZE) as renderer:
        draw(renderer, place, [sets[0], sets[1], sets[2], sets[0]])
        assert len(made) == 3
        picture = draw(renderer, place, [sets[3]])
        draw(renderer, place, [sets[0], sets[3]])
        assert len(made) == 4, "of those that were there, set 0 was drawn last"
        draw(renderer, place, [sets[1]])
        assert len(made) == 5
        assert np.array_equal(draw(renderer, place, [sets[3]]).color, picture.color)


def test_a_set_that_is_larger_than_all_room_is_drawn(scene, monkeypatch):
    monkeypatch.setattr(meshes, "_MOST_TRIANGLES", 1)
    place = scene.cell("0001-01")
    some = Objects("all", place.visible)
    with Renderer(scene.mesh, scene.ground, size=SIZE) as renderer:
        found = [draw(renderer, place, [some, Objects("one", place.visible[:1])]).color for _ in range(2)]
    assert np.array_equal(*found)


def test_what_a_plan_draws_is_made_before_it_is_drawn(scene, made):
    """What it draws into images as well, of which nothing stays; reliefs of images that are not there yet are left out."""
    place = scene.cell("0001-01")
    view = view_towards(place.cell.reference, 0.3, 0.0, focal=55.0, window=(-32, -24, *SIZE))
    key = ImageKey("test", "one")
    captured, drawn = (Objects(name, place.visible[i : i + 2]) for i, name in enumerate(("captured", "drawn")))
    request = Request(Slot(key, SIZE), view, (captured,))
    plan = Plan((Relief(key, (ReliefPart(view, (0, 0), 100.0),)), drawn, Sky()), requests=(request,))
    with Renderer(scene.mesh, scene.ground, size=SIZE) as renderer:
        assert renderer.prepare(plan, view) > 0.0
        assert len(made) == 2
        with pytest.raises(KeyError):
            renderer.image(key)
        renderer.draw(plan, view)
    assert len(made) == 2
