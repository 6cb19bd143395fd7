"""What images of boxes are wrong by: no box is shown whose true error exceeds the limit, by brute force over its points."""

import math

import numpy as np
import pytest

from mmi.foundation.camera import Camera, View
from viewer.caching.captures import captures_of, sharpness_of
from viewer.caching.node_images import GENERATIONS, NodeImages
from viewer.plan import ImageKey, Slot

CAMERA = Camera(640, 480, math.radians(60.0))
SHARPNESS = sharpness_of(View(np.eye(4), CAMERA.focal, CAMERA.window))
SLOT = Slot(ImageKey("test", "0"), (256, 256))


def images_of(boxes, limit=SHARPNESS.pixel):
    return NodeImages(boxes, SHARPNESS, limit)


def keep(images, nodes, boxes, eye, *, inherited=0.0, generation=0, frame=0):
    found = captures_of(eye, boxes[nodes], SHARPNESS)
    for place, node in enumerate(nodes):
        images.keep(node, SLOT, eye, found, place, inherited=inherited, generation=generation, frame=frame)
    images.settle(np.array(nodes))
    return found


def true_errors(found, place, points, captured, eye):
    """Angles at ``eye`` between points and where the quadrilateral shows them, by plain geometry."""
    ahead = -found.eye_from_world[place, 2, :3]
    rays = points - captured
    shown = captured + rays * (found.depths[place] / (rays @ ahead))[:, None]
    a, b = points - eye, shown - eye
    return np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), np.sum(a * b, axis=1))


def test_no_image_is_valid_that_is_wrong_by_more_than_the_limit():
    rng = np.random.default_rng(7)
    valid, largest = 0, 0.0
    for _ in range(60):
        low = rng.uniform(-100.0, 100.0, (30, 3))
        boxes = np.stack([low, low + rng.uniform(0.1, 30.0, (30, 3))], axis=1)
        captured = rng.uniform(-150.0, 150.0, 3)
        images = images_of(boxes)
        found = keep(images, range(30), boxes, captured)
        for _ in range(20):
            eye = captured + rng.normal(size=3) * 10.0 ** rng.uniform(-2.5, 0.5)
            for node in np.flatnonzero(images.valid(np.arange(30), eye) & found.possible):
                points = boxes[node, 0] + rng.uniform(0.0, 1.0, (100, 3)) * np.ptp(boxes[node], axis=0)
                points[:8] = boxes[node][[[i & 1, i >> 1 & 1, i >> 2] for i in range(8)], [0, 1, 2]]
                wrong = true_errors(found, node, points, captured, eye).max()
                valid, largest = valid + 1, max(largest, wrong)
                assert wrong <= SHARPNESS.pixel
    assert valid > 1000
    assert largest > 0.5 * SHARPNESS.pixel  # the bound is no wild one


def moved_onto(found, place, captured, where):
    """Where on its quadrilateral an image shows points that were ``where`` when it was captured."""
    ahead = -found.eye_from_world[place, 2, :3]
    rays = where - captured
    return captured + rays * (found.depths[place] / (rays @ ahead))[:, None]


@pytest.mark.parametrize("limit_px", [1.5, 3.0])
def test_no_image_of_images_is_valid_that_is_wrong_by_more_than_the_limit(limit_px):
    """Parts' images of images' images, each captured from elsewhere: points go from quadrilateral to quadrilateral.

    Each time an image is captured from others, texels are sampled anew, up to half the diagonal of one that this does not see.
    """
    rng = np.random.default_rng(11)
    limit = limit_px * SHARPNESS.pixel
    shown, largest = dict.fromkeys(range(GENERATIONS), 0), 0.0
    for _ in range(1500):
        low = rng.uniform(-100.0, 100.0, 3)
        part = np.stack([low, low + rng.uniform(0.1, 10.0, 3)])
        boxes = [part]
        for _ in range(GENERATIONS - 1):  # boxes around boxes
            within = boxes[-1]
            boxes.append(np.stack([within[0] - rng.uniform(0.0, 10.0, 3), within[1] + rng.uniform(0.0, 10.0, 3)]))
        boxes = np.array(boxes)
        images = images_of(boxes, limit)
        points = part[0] + rng.uniform(0.0, 1.0, (60, 3)) * np.ptp(part, axis=0)
        points[:8] = part[[[i & 1, i >> 1 & 1, i >> 2] for i in range(8)], [0, 1, 2]]
        where, eye, sampled, before = points, rng.uniform(-150.0, 150.0, 3), 0.0, None
        for generation in range(GENERATIONS):
            inherited = 0.0
            if generation:
                inherited = float(images.handed_on(np.array([generation - 1]), eye, generation)[0])
                if inherited > limit:
                    break
                middle = boxes[generation - 1].mean(axis=0)
                closer = np.linalg.norm(middle - before) / np.linalg.norm(middle - eye)
                sampled += math.sqrt(0.5) * closer / SHARPNESS.texel_focal
            found = keep(images, [generation], boxes, eye, inherited=inherited, generation=generation, frame=generation)
            if not found.possible[0]:
                break
            where = moved_onto(found, 0, eye, where)
            for _ in range(6):
                later = eye + rng.normal(size=3) * 10.0 ** rng.uniform(-2.5, 0.5)
                if not images.valid(np.array([generation]), later)[0]:
                    continue
                a, b = points - later, where - later
                wrong = np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), np.sum(a * b, axis=1)).max()
                assert wrong <= limit - sampled
                shown[generation] += 1
                largest = max(largest, wrong / limit)
            before, eye = eye, eye + rng.normal(size=3) * 10.0 ** rng.uniform(-2.5, 0.0)
    assert min(shown.values()) > 30
    assert largest > 0.5


def test_what_an_image_inherits_counts_with_its_own_error():
    boxes = np.array([[[20.0, -5.0, 0.0], [30.0, 5.0, 10.0]]])
    fresh, second = images_of(boxes), images_of(boxes)
    keep(fresh, [0], boxes, np.zeros(3))
    keep(second, [0], boxes, np.zeros(3), inherited=0.6 * SHARPNESS.pixel, generation=1)
    eyes = np.array([0.0, 1.0, 0.0]) * np.linspace(0.0, 0.5, 200)[:, None]
    good, worse = ([bool(one.valid(np.array([0]), eye)[0]) for eye in eyes] for one in (fresh, second))
    assert 0 < sum(worse) < sum(good) < len(eyes)
    for eye in eyes:
        one, other = (images.errors(np.array([0]), eye)[0] for images in (fresh, second))
        assert other >= one + 0.6 * SHARPNESS.pixel - 1e-12


def test_what_is_handed_on_is_part_of_a_texel_more_and_nothing_of_the_last_generation():
    boxes = np.array([[[20.0, -5.0, 0.0], [30.0, 5.0, 10.0]]] * 3)
    images = images_of(boxes)
    keep(images, [0], boxes, np.zeros(3), frame=4)
    keep(images, [1], boxes, np.zeros(3), frame=4, generation=GENERATIONS - 1)
    found = images.handed_on(np.arange(3), np.zeros(3), 4)
    assert found.tolist() == [pytest.approx(math.sqrt(0.5) / SHARPNESS.texel_focal), math.inf, math.inf]
    moved = np.array([0.0, 0.05, 0.0])
    later = images.handed_on(np.array([0]), moved, 5)[0]
    middle = boxes[0].mean(axis=0)
    texel = np.linalg.norm(middle) / np.linalg.norm(middle - moved) / SHARPNESS.texel_focal
    assert later == pytest.approx(images.errors(np.array([0]), moved)[0] + math.sqrt(0.5) * texel)


def test_texels_that_would_show_or_flicker_are_not_valid():
    boxes = np.array([[[1000.0, 0.0, 0.0], [1000.0, 0.0, 0.0]]])  # nothing is ever wrong with a point
    images = images_of(boxes)
    keep(images, [0], boxes, np.zeros(3))
    ahead = np.array([1.0, 0.0, 0.0])
    assert images.valid(np.array([0]), 100.0 * ahead)[0]
    assert not images.valid(np.array([0]), (1000.0 - 1000.0 / (1.01 * SHARPNESS.finer)) * ahead)[0]
    assert not images.valid(np.array([0]), -1100.0 * ahead)[0]


def test_what_was_dropped_is_not_valid_and_boards_are_of_one_image_each():
    boxes = np.array([[[20.0, -5.0, 0.0], [30.0, 5.0, 10.0]]] * 3)
    images = images_of(boxes)
    keep(images, [0, 1, 2], boxes, np.zeros(3), frame=3)
    (board,) = images.boards(np.array([2, 0]), 3)
    assert board.image == SLOT.image and board.fresh.all() and len(board.depths) == 2
    images.drop(1)
    assert images.valid(np.arange(3), np.zeros(3)).tolist() == [True, False, True]
    assert not images.boards(np.array([0]), 4)[0].fresh.any()
