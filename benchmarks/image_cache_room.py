"""Figures 10 and 11 of Schaufler & Stuerzlinger 1996: a living room by images of boxes, and by images of its objects.

    python benchmarks/image_cache_room.py -o out/room

figure10.png    the geometry, an image of each object before those of objects farther away, and where these two differ
figure11.png    the image cache (a tree of depth 3, as in the paper), where it differs from the geometry, and two bird's eye
                views of what the cache holds: images captured from triangles have red borders, those combined from images
                green ones, and what is shown as triangles none

An image of an object is a picture that hides all of what lies farther away: right for a house, wrong for a book in a shelf or a
chair under a table, whose objects reach into each other. It is taken from where it is shown, so that nothing else is wrong.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from citygen.generate import generate
from mmi.foundation.camera import Camera, View, view_towards
from mmi.foundation.thickness import thickness
from viewer.caching.rules import CacheRules
from viewer.drawing.drawn_picture import DrawnPicture
from viewer.drawing.renderer import Renderer
from viewer.measuring.view_errors import flip_map
from viewer.plan import Budget, Nailboards, Objects, Plan, Sky
from viewer.scene.scene import WalkScene, scene_of_city
from viewer.techniques.geometry import FullGeometry
from viewer.techniques.image_cache import ImageCache

CAMERA = Camera(640, 480, math.radians(60.0))
INSIDE = (
    (np.array([5.9, 3.3, 1.6]), math.radians(190.0), math.radians(-8.0)),
    (np.array([2.6, 4.4, 1.6]), math.radians(-35.0), math.radians(-8.0)),
)
"""Where the room is seen from: the shelf with its books ahead, and from beside it."""
ABOVE = (np.array([4.0, -5.5, 9.0]), math.radians(90.0), math.radians(-45.0))
ROOM = ("floor", "ceiling", "wall/")
CEILING = "ceiling"
"""What a bird's eye view leaves out."""
RULES = CacheRules(eager=True, depth=3, leaf_triangles=1, largest=512)
"""Texels are finer than the paper's, so that boxes of this depth need more of them than its 256 a side."""
RED, GREEN = (214, 39, 40), (44, 160, 44)


def looking(eye: NDArray[np.float64], azimuth: float, pitch: float) -> View:
    """A view of the display's size."""
    return view_towards(eye, azimuth, pitch, focal=CAMERA.focal, window=CAMERA.window)


def by_objects(scene: WalkScene, renderer: Renderer, view: View) -> tuple[NDArray[np.uint8], NDArray[np.int32]]:
    """Colours (h, w, 3) and ids (h, w): each object's own picture, over those of objects whose middles are farther away.

    The room itself, which is behind everything, is geometry.
    """
    middles = scene.boxes.mean(axis=1)
    room = np.array([place for name, place in scene.objects.items() if name.startswith(ROOM)])
    others = np.setdiff1d(np.flatnonzero(np.isfinite(middles).all(axis=1)), room)
    far_first = others[np.argsort(-np.linalg.norm(middles[others] - view.eye, axis=1), kind="stable")]
    back = renderer.draw(Plan((Objects("room", room), Sky())), view, measured=True)
    assert back.color is not None
    assert back.object_ids is not None
    color, ids = back.color.copy(), back.object_ids.copy()
    for number in far_first.tolist():
        one = renderer.draw(Plan((Objects(f"object {number}", np.array([number])),)), view, measured=True)
        assert one.color is not None
        assert one.object_ids is not None
        covered = one.object_ids == number
        color[covered], ids[covered] = one.color[covered], number
    return color, ids


def difference(truth: NDArray[np.uint8], shown: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """(h, w, 3) how far two pictures are apart, three times as strong, on white."""
    apart = 3 * np.abs(truth.astype(np.int64) - shown).max(axis=2)
    return np.repeat((255 - np.minimum(apart, 255)).astype(np.uint8)[..., None], 3, axis=2)


def told(name: str, truth: DrawnPicture, color: NDArray[np.uint8], ids: NDArray[np.int32]) -> None:
    """A line of what is wrong."""
    assert truth.color is not None
    wrong = truth.object_ids != ids
    flip = float(flip_map(truth.color, color).mean())
    print(f"| {name} | {thickness(wrong):.1f} px | {wrong.mean():.2%} | {flip:.4f} |", flush=True)


def corners_of(boards: Nailboards) -> NDArray[np.float64]:
    """(n, 4, 3) corners of quadrilaterals in the world, one after the other around them."""
    left, top, width, height = boards.windows.T.astype(np.float64)
    across = np.stack([left, left + width, left + width, left], axis=1) / boards.focal
    down = np.stack([top, top, top + height, top + height], axis=1) / boards.focal
    seen = np.stack([across, -down, -np.ones_like(across)], axis=2) * boards.depths[:, None, None]
    turned, shift = boards.captures[:, :3, :3], boards.captures[:, :3, 3]
    return np.asarray(np.einsum("nji,nkj->nki", turned, seen - shift[:, None, :]))


def bird_s_eye(scene: WalkScene, renderer: Renderer, where: tuple[NDArray[np.float64], float, float]) -> Image.Image:
    """What a cache holds all around a viewer that has just come, seen from above, without the ceiling."""
    cache = ImageCache(scene, RULES)
    eye, azimuth, pitch = where
    boards: list[Nailboards] = []
    combined = np.zeros((0, 3))
    for quarter in range(4):
        plan = cache.plan(looking(eye, azimuth + quarter * 0.5 * math.pi, pitch), now=0.0, budget=Budget())
        renderer.draw(plan, looking(eye, azimuth, pitch), read=False)
        boards += [draw for draw in plan.draws if isinstance(draw, Nailboards)]
        if not quarter:  # the other quarters show the same images
            middles = cache.tree.boxes[cache.kinds["combined"]].mean(axis=1) - eye
            combined = middles / np.linalg.norm(middles, axis=1)[:, None]
    ceiling = float(scene.boxes[scene.objects[CEILING], 0, 2])
    above = looking(*ABOVE)
    kept, outlines = [], []
    for one in boards:
        corners = corners_of(one)
        below = np.flatnonzero(corners[..., 2].mean(axis=1) < ceiling - 0.3)
        kept.append(
            replace(
                one,
                captures=one.captures[below],
                windows=one.windows[below],
                corners=one.corners[below],
                depths=one.depths[below],
                fresh=one.fresh[below],
            )
        )
        ahead = -one.captures[below, 2, :3]
        green = (ahead @ combined.T).max(axis=1, initial=-1.0) > 1.0 - 1e-9
        outlines += list(zip(corners[below], green, strict=True))
    drawn = renderer.draw(Plan((*kept, Sky())), above, measured=True)
    assert drawn.color is not None
    picture = Image.fromarray(drawn.color)
    pen = ImageDraw.Draw(picture)
    for corners, green in outlines:
        u, v, depth = above.project(corners).T
        if (depth > 0.0).all():
            at = np.stack([u - above.window[0], v - above.window[1]], axis=1)
            pen.polygon([(float(x), float(y)) for x, y in at], outline=GREEN if green else RED)
    return picture


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--out", type=Path, required=True, metavar="DIR", help="gets the pictures")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    scene = scene_of_city(generate("living-room"), name="multi-mesh", camera=CAMERA)
    view = looking(*INSIDE[0])
    print("| | thickest wrong region | wrong | FLIP |")
    print("|---|---|---|---|")
    with Renderer(scene.mesh, scene.ground, size=(CAMERA.width, CAMERA.height), measured=True) as renderer:
        truth = renderer.draw(FullGeometry(scene).plan(view, now=0.0, budget=Budget()), view, measured=True)
        color, ids = by_objects(scene, renderer, view)
        told("an image of each object", truth, color, ids)
        cache = ImageCache(scene, RULES)
        shown = renderer.draw(cache.plan(view, now=0.0, budget=Budget()), view, measured=True)
        assert truth.color is not None
        assert shown.color is not None
        assert shown.object_ids is not None
        told("images of boxes", truth, shown.color, shown.object_ids)
        figure10 = np.concatenate([truth.color, color, difference(truth.color, color)], axis=1)
        Image.fromarray(figure10).save(options.out / "figure10.png")
        upper = np.concatenate([shown.color, difference(truth.color, shown.color)], axis=1)
        lower = np.concatenate([np.asarray(bird_s_eye(scene, renderer, where)) for where in INSIDE], axis=1)
        Image.fromarray(np.concatenate([upper, lower])).save(options.out / "figure11.png")


if __name__ == "__main__":
    main()
