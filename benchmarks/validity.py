"""How long images stay valid, by the papers' formulas, by the safe ones and in truth: ratios, and Duckstein's figures 13 to 16.

    python benchmarks/validity.py -o /tmp/validity

*Ratios*: random boxes, viewpoints and movements, and points all over the boxes (faces, edges, inside) for what is true. *now*
is an error angle that is stated : the true largest; *ahead* is a distance : the radius of the largest ball around the
viewpoint in which no point exceeds the limit; *frames* are those promised : those until a point exceeds it, for viewers and
objects that move each frame alike. What must not happen is below 1 for *now* and above 1 for the others: *unsafe* is its share.

*Figures*: trucks are boxes of 8 x 2.5 x 3 units (the paper does not state its own), twelve of them that point in directions
30 degrees apart, at the paper's distances, limit of 4 pixels and 256 frames, on a display of 512 x 512 pixels and 60 degrees.
The viewer is 2 units up. In the translation tests all trucks drive across the view, and a truck counts in the frames in which
its box is wholly on screen; in the rotation tests each turns around its own middle. *Validity* is the mean number of frames in
which an image is used again. Predictions below 2 do not pay and count as 0, as in the paper. Exponents are slopes in double
logarithmic axes: 1 is linear, 2 quadratic. Figure 15 has its trucks a second time, each counted wherever it is: 256 frames
carry it 256 units along, so that its mean distance hardly depends on how far its street is away.

What comes out: an image that moves along lasts quadratically in distance when its truck translates (exponents of 1.9 to 2.1)
and linearly when it turns (the predictive calculation; images last longer where half a truck's width subtends less than the
limit, since then no turn is visible). The paper calls both linear. Trucks that count wherever they are give 1.25 to 1.4 on
this range, which looks like its line; an image that stays would be linear, but lasts one or two frames at this speed.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterator
from pathlib import Path

import matplotlib
import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

from mmi.foundation.camera import Camera
from mmi.validity.images import Flat, Relief, error_angle, safe_distance
from mmi.validity.layers import layer_errors, layer_parallax
from mmi.validity.movement import (
    frames_at_equal_steps,
    frames_within_limits,
    relative_viewpoint,
    viewpoint_step,
)
from mmi.validity.papers import (
    common_error,
    corners,
    moved_points,
    on_quadrilateral,
    predicted_frames,
    safety_zone,
    safety_zone_of_the_nearer,
    turned_to_viewer,
)
from mmi.validity.ray_pairs import safe_step

Array = NDArray[np.float64]
DISPLAY = Camera(512, 512, math.radians(60.0))
LIMIT = DISPLAY.angle_from_pixels(4.0)
FRAMES = 256
TRUCK = np.array([[-4.0, -1.25, 0.0], [4.0, 1.25, 3.0]])
HEADINGS = np.radians(np.arange(0.0, 360.0, 30.0))
HEIGHT = 2.0
STEADY = np.zeros(3)


# Ratios


def unit(rng: np.random.Generator, count: int) -> Array:
    one = rng.normal(size=(count, 3))
    return np.asarray(one / np.linalg.norm(one, axis=1)[:, None])


def random_boxes(rng: np.random.Generator, count: int) -> tuple[Array, Array]:
    """Viewpoints (n, 3) and boxes (n, 2, 3) of all shapes, whose middles are 1 to 20 diagonals away."""
    size = 10.0 ** rng.uniform(-0.5, 1.0, (count, 3))
    away = np.linalg.norm(size, axis=1) * 20.0 ** rng.uniform(0.0, 1.0, count)
    eyes = rng.normal(size=(count, 3))
    middle = eyes + unit(rng, count) * away[:, None]
    return eyes, np.stack((middle - 0.5 * size, middle + 0.5 * size), axis=1)


def all_over(rng: np.random.Generator, boxes: Array, count: int) -> Array:
    """Points (n, count, 3): corners, middles of edges and faces, and others at random, most of them on faces and edges."""
    marks = np.array(list(np.ndindex(3, 3, 3))) / 2.0
    part = rng.uniform(size=(len(boxes), count, 3))
    part = np.where(rng.uniform(size=part.shape) < 0.4, np.round(part), part)
    part[:, : len(marks)] = marks
    return np.asarray(boxes[:, None, 0] + part * (boxes[:, 1] - boxes[:, 0])[:, None])


def ends(eyes: Array, points: Array, boxes: Array) -> tuple[Array, Array]:
    """Where the rays through points enter and leave their boxes."""
    rays = points - eyes[:, None]
    with np.errstate(divide="ignore"):
        one, other = ((boxes[:, None, side] - eyes[:, None]) / rays for side in (0, 1))
    enter, leave = np.minimum(one, other).max(axis=-1), np.maximum(one, other).min(axis=-1)
    return eyes[:, None] + rays * enter[..., None], eyes[:, None] + rays * leave[..., None]


def row(name: str, ratios: Array, *, floor: bool) -> None:
    """One line of the table; ``floor``: the ratio must not be below 1, else not above."""
    kept = ratios[np.isfinite(ratios)]
    unsafe = np.mean(kept < 1.0 - 1e-6) if floor else np.mean(kept > 1.0 + 1e-6)
    shortest, longest = kept.min(), kept.max()
    print(f"  {name:58}{np.median(kept):8.3f}{shortest:9.3f}{longest:9.3f}{100.0 * unsafe:9.1f} %")


def ratios_now(rng: np.random.Generator, count: int) -> None:
    eyes, boxes = random_boxes(rng, count)
    middle, dense, few = boxes.mean(axis=1), all_over(rng, boxes, 150), corners(boxes)
    near = np.linalg.norm(middle - eyes, axis=1)
    now = eyes + unit(rng, count) * (near * 10.0 ** rng.uniform(-2.0, -0.5, count))[:, None]

    def stays(points: Array) -> Array:
        return common_error(now, points, on_quadrilateral(eyes, points, middle))

    def turns(points: Array) -> Array:
        return common_error(now, points, turned_to_viewer(now, eyes, on_quadrilateral(eyes, points, middle), middle))

    first, last = ends(eyes, dense, boxes)
    row("now: corners, eq. (1), quadrilateral stays", stays(few) / stays(dense), floor=True)
    row("now: safe, quadrilateral stays", error_angle(now, eyes, boxes, Flat()) / stays(dense), floor=True)
    row("now: corners, eq. (1), quadrilateral turns", turns(few) / turns(dense), floor=True)
    row("now: safe, quadrilateral turns", error_angle(now, eyes, boxes, Flat(turns=True)) / turns(dense), floor=True)
    row("now: safe, depth mesh", error_angle(now, eyes, boxes, Relief()) / common_error(now, first, last), floor=True)


def ratios_ahead(rng: np.random.Generator, count: int) -> None:
    eyes, boxes = random_boxes(rng, count)
    middle, dense, few = boxes.mean(axis=1), all_over(rng, boxes, 150), corners(boxes)

    def radius(one: Array, other: Array) -> Array:
        """Of the ball in which no pair parts by more than the limit: exact for each pair."""
        a, b = (np.linalg.norm(points - eyes[:, None], axis=-1) for points in (one, other))
        return np.asarray(np.min(safe_step(np.minimum(a, b), np.maximum(a, b), LIMIT), axis=1))

    true, shown = radius(dense, on_quadrilateral(eyes, dense, middle)), on_quadrilateral(eyes, few, middle)
    row("ahead: corners, eq. (3) as printed", safety_zone(eyes, few, shown, LIMIT) / true, floor=False)
    row(
        "ahead: corners, eq. (3) from the nearer",
        safety_zone_of_the_nearer(eyes, few, shown, LIMIT) / true,
        floor=False,
    )
    row("ahead: safe, quadrilateral stays", safe_distance(eyes, boxes, Flat(), LIMIT) / true, floor=False)
    front = _front(eyes, boxes)
    at_front = eyes + (middle - eyes) * (front / np.linalg.norm(middle - eyes, axis=1))[:, None]
    true, shown = radius(dense, on_quadrilateral(eyes, dense, at_front)), on_quadrilateral(eyes, few, at_front)
    row(
        "ahead: eq. (3) as printed, quadrilateral at the front",
        safety_zone(eyes, few, shown, LIMIT) / true,
        floor=False,
    )
    nearer = safety_zone_of_the_nearer(eyes, few, shown, LIMIT)
    row("ahead: eq. (3) from the nearer, at the front", nearer / true, floor=False)
    row("ahead: safe, at the front", safe_distance(eyes, boxes, Flat(distance=front), LIMIT) / true, floor=False)
    row("ahead: safe, quadrilateral turns", _turning_ratios(rng, eyes, boxes, dense), floor=False)
    true = radius(*ends(eyes, dense, boxes))
    row("ahead: safe, depth mesh", safe_distance(eyes, boxes, Relief(), LIMIT) / true, floor=False)


def _front(eyes: Array, boxes: Array) -> Array:
    """The least depth (n,) of a box along the line to its middle, or a little where that is behind the viewer."""
    line = boxes.mean(axis=1) - eyes
    away = np.linalg.norm(line, axis=1)
    depth = np.einsum("nkc,nc->nk", corners(boxes) - eyes[:, None], line / away[:, None]).min(axis=1)
    return np.asarray(np.maximum(depth, 0.1 * away))


def _turning_ratios(rng: np.random.Generator, eyes: Array, boxes: Array, dense: Array) -> Array:
    """Predicted : true, the true radius by halving over 40 directions, among them those across."""
    middle, shown = boxes.mean(axis=1), on_quadrilateral(eyes, dense, boxes.mean(axis=1))
    predicted = safe_distance(eyes, boxes, Flat(turns=True), LIMIT)
    low, high = predicted, 20.0 * predicted
    ways = [unit(rng, len(eyes)) for _ in range(20)]
    ways += [np.cross(way, middle - eyes) for way in ways]
    ways = [way / np.linalg.norm(way, axis=1)[:, None] for way in ways]
    for _ in range(12):
        half, worst = 0.5 * (low + high), np.zeros(len(eyes))
        for way in ways:
            now = eyes + way * half[:, None]
            worst = np.maximum(worst, common_error(now, dense, turned_to_viewer(now, eyes, shown, middle)))
        low, high = np.where(worst <= LIMIT, half, low), np.where(worst <= LIMIT, high, half)
    return np.asarray(predicted / low)


def rotations(axes: Array, angles: Array) -> Array:
    """(n, 3, 3): around unit ``axes`` (n, 3)."""
    skew = np.zeros((len(axes), 3, 3))
    skew[:, [2, 0, 1], [1, 2, 0]], skew[:, [1, 2, 0], [2, 0, 1]] = axes, -axes
    s, c = np.sin(angles)[:, None, None], np.cos(angles)[:, None, None]
    return np.asarray(np.eye(3) + s * skew + (1.0 - c) * (skew @ skew))


def around(turn: Array, pivots: Array, shifts: Array) -> Array:
    """(n, 4, 4): rotations ``turn`` (n, 3, 3) around ``pivots`` (n, 3), then ``shifts`` (n, 3)."""
    moved = np.zeros((len(pivots), 4, 4))
    moved[:, :3, :3], moved[:, 3, 3] = turn, 1.0
    moved[:, :3, 3] = pivots + shifts - np.einsum("nij,nj->ni", turn, pivots)
    return moved


def ratios_in_frames(
    rng: np.random.Generator, count: int, name: str, viewer: float, object_: float, turn: float
) -> None:
    """Each of the viewer's and the object's speeds, and the turn, is up to this share of what a tenth of the zone takes."""
    eyes, boxes = random_boxes(rng, count)
    middle, few = boxes.mean(axis=1), corners(boxes)
    zone, arm = safe_distance(eyes, boxes, Flat(), LIMIT), np.linalg.norm(middle - eyes, axis=1)
    pace = 0.1 * zone
    speed, drive, angle = (share * pace * rng.uniform(0.2, 1.0, count) for share in (viewer, object_, turn))
    angle = angle / arm
    steps, shifts = unit(rng, count) * speed[:, None], unit(rng, count) * drive[:, None]
    moved = around(rotations(unit(rng, count), angle), middle, shifts)
    shown = on_quadrilateral(eyes, few, middle)
    printed = safety_zone(eyes, few, shown, LIMIT)
    nearer = safety_zone_of_the_nearer(eyes, few, shown, LIMIT)

    def each(function: Callable[..., NDArray[np.int64]], zones: Array, **options: int) -> NDArray[np.int64]:
        return np.array(
            [function(zones[i : i + 1], moved[i : i + 1], eyes[i], steps[i], **options)[0] for i in range(count)]
        )

    dense = all_over(rng, boxes, 80)
    images, true, pose = on_quadrilateral(eyes, dense, middle), np.full(count, -1), np.tile(np.eye(4), (count, 1, 1))
    for frame in range(1, FRAMES + 1):
        pose = moved @ pose
        error = common_error(relative_viewpoint(pose, eyes + frame * steps), dense, images)
        true = np.where((true < 0) & (error > LIMIT), frame - 1, true)
    ended = (true > 0) & (true < FRAMES)
    for label, frames in (
        ("corners, eq. (5) as printed", each(predicted_frames, printed)),
        ("corners, eq. (5), zone of the nearer", each(predicted_frames, nearer)),
        ("safe, steps alike", each(frames_at_equal_steps, zone, most=FRAMES)),
        ("safe, within limits", frames_within_limits(zone, speed=speed + drive, turn=angle, arm=arm, most=FRAMES)),
    ):
        row(f"frames, {name}: {label}", (frames / np.maximum(true, 1))[ended], floor=False)


def ratios_of_layers(rng: np.random.Generator, count: int) -> None:
    """Layers of 20 houses 40 to 200 metres away, a viewer up to 10 metres off, and 4,000 rays."""
    eye, ratios = np.array([0.0, 0.0, 1.7]), np.empty(count)
    for i in range(count):
        turn, away = rng.uniform(0.0, 2.0 * math.pi, 20), 40.0 * 5.0 ** rng.uniform(0.0, 1.0, 20)
        middle = np.column_stack((np.cos(turn) * away, np.sin(turn) * away, rng.uniform(4.0, 12.0, 20)))
        half = np.column_stack((rng.uniform(3.0, 10.0, (20, 2)), middle[:, 2]))
        boxes = np.stack((middle - half, middle + half), axis=1)
        rays = (all_over(rng, boxes, 200) - eye).reshape(-1, 1, 3)
        with np.errstate(divide="ignore"):
            one, other = ((boxes[:, side] - eye) / rays for side in (0, 1))
        enter, leave = np.minimum(one, other).max(axis=-1), np.maximum(one, other).min(axis=-1)
        met = (enter <= leave) & (leave > 0.0)
        near, far = np.where(met, enter, math.inf).min(axis=1), np.where(met, leave, 0.0).max(axis=1)
        kept = far >= near
        first, last = (eye + rays[kept, 0] * at[kept, None] for at in (near, far))
        now = eye + unit(rng, 1)[0] * rng.uniform(0.5, 10.0) * [1.0, 1.0, 0.1]
        true = common_error(now, first[None], last[None])[0]
        ratios[i] = layer_errors([layer_parallax(eye, boxes)], now)[0] / true
    row("now: safe, image of a layer of 20 boxes", ratios, floor=True)


def keeping_up() -> None:
    """A viewer that nearly keeps up with what an object that turns by 5 degrees a frame shows it: equal steps are no bound."""
    pivot, eye = np.array([[60.0, 0.0, 0.0]]), np.zeros(3)
    moved = around(rotations(np.array([[0.0, 0.0, 1.0]]), np.radians([5.0])), pivot, np.zeros((1, 3)))
    step = 0.96 * relative_viewpoint(np.linalg.inv(moved[0]), eye)
    first = float(viewpoint_step(moved, eye, step, 1)[0])
    zone = np.array([29.5 * first])
    promised, kept = predicted_frames(zone, moved, eye, step)[0], frames_at_equal_steps(zone, moved, eye, step)[0]
    reached = np.linalg.norm(relative_viewpoint(np.linalg.matrix_power(moved[0], 29), eye + 29.0 * step))
    print(
        f"  an object 60 units away turns by 5 degrees a frame, the viewer walks 96 % of that arc: eq. (5) promises {promised}"
    )
    print(
        f"  frames, at whose end the viewpoint is {reached / (29.0 * first):.0f} times as far as predicted; safe: {kept}"
    )


# Figures


class Trucks:
    """Trucks that move alike every frame: (n) of them, each at its ``distance`` and with its ``speed`` or ``turn`` a frame."""

    def __init__(self, distance: Array, speed: Array, turn: Array, *, whole: bool = True) -> None:
        self.heading = np.tile(HEADINGS, len(distance))
        self.distance, self.speed, self.turn = (np.repeat(one, len(HEADINGS)) for one in (distance, speed, turn))
        self.eye, self.whole = np.array([0.0, 0.0, HEIGHT]), whole
        self.boxes = np.tile(TRUCK, (len(self.heading), 1, 1))

    def pose(self, frame: int) -> Array:
        """(n, 4, 4) world from truck: across the view, in its middle half way through."""
        place = np.zeros((len(self.heading), 3))
        place[:, 0], place[:, 1] = self.distance, self.speed * (frame - 0.5 * FRAMES)
        up = np.tile([0.0, 0.0, 1.0], (len(place), 1))
        return around(rotations(up, self.heading + frame * self.turn), np.zeros_like(place), place)

    def on_screen(self, frame: int) -> NDArray[np.bool_]:
        """Which are wholly on a screen that looks along x."""
        seen = moved_points(self.pose(frame), corners(self.boxes)) - self.eye
        half = math.tan(0.5 * DISPLAY.fov)
        inside = (seen[..., 0] > 0.0) & (np.abs(seen[..., 1:]) <= half * seen[..., :1]).all(axis=-1)
        return np.asarray(inside.all(axis=1)) if self.whole else np.ones(len(seen), dtype=np.bool_)


def validity(trucks: Trucks, error: Callable[[Array, Array, Array, Array], Array] | None, promise: str = "") -> Array:
    """Mean frames (samples,) in which an image is used again: while ``error`` is within the limit, or as ``promise`` says."""
    count, rng = len(trucks.heading), np.random.default_rng(1)
    few, dense, middle = corners(trucks.boxes), all_over(rng, trucks.boxes, 80), trucks.boxes.mean(axis=1)
    then = trucks.pose(0)
    captured = relative_viewpoint(then, trucks.eye)
    held, left = np.zeros(count, dtype=np.bool_), np.zeros(count, dtype=np.int64)
    again, images = np.zeros(count), np.zeros(count)
    for frame in range(FRAMES):
        pose, there = trucks.pose(frame), trucks.on_screen(frame)
        eye = relative_viewpoint(pose, trucks.eye)
        if error is not None:
            points = dense if promise == "dense" else few
            after = moved_points(np.linalg.inv(pose) @ then, on_quadrilateral(captured, points, middle))
            held &= error(eye, captured, points, after) <= LIMIT
        else:
            held &= left > 0
        held &= there
        left -= 1
        again += held
        fresh = there & ~held
        images += fresh
        captured, then = np.where(fresh[:, None], eye, captured), np.where(fresh[:, None, None], pose, then)
        held |= fresh
        if error is None and fresh.any():
            moved = trucks.pose(frame + 1) @ np.linalg.inv(pose)
            shown = on_quadrilateral(eye, few, middle)
            if promise == "printed":
                frames = predicted_frames(safety_zone(eye, few, shown, LIMIT), moved, trucks.eye, STEADY)
            else:
                zone = safe_distance(eye, trucks.boxes, Flat(), LIMIT)
                frames = frames_at_equal_steps(zone, moved, trucks.eye, STEADY, most=FRAMES)
            left = np.where(fresh, np.where(frames >= 2, frames, 0), left)
    by_sample = (one.reshape(-1, len(HEADINGS)).sum(axis=1) for one in (again, images))
    kept, made = by_sample
    return np.asarray(kept / np.maximum(made, 1.0))


def left_behind(eye: Array, _captured: Array, points: Array, after: Array) -> Array:
    """Figure 4: the image stays where it was."""
    return common_error(eye, points, after)


def along(eye: Array, captured: Array, points: Array, _after: Array) -> Array:
    """Figure 5: the image moves with its object."""
    return common_error(eye, points, on_quadrilateral(captured, points, _middle(eye)))


def turning(eye: Array, captured: Array, points: Array, _after: Array) -> Array:
    """The image moves with its object and turns to face the viewer."""
    shown = on_quadrilateral(captured, points, _middle(eye))
    return common_error(eye, points, turned_to_viewer(eye, captured, shown, _middle(eye)))


def safe_now(eye: Array, captured: Array, _points: Array, _after: Array) -> Array:
    return error_angle(eye, captured, np.tile(TRUCK, (len(eye), 1, 1)), Flat())


def _middle(like: Array) -> Array:
    return np.broadcast_to(TRUCK.mean(axis=0), like.shape)


CURVES = (
    ("common, image stays (fig. 4)", left_behind, "", "C7--"),
    ("common, image turns to the viewer", turning, "", "C4-."),
    ("common, image moves along (fig. 5)", along, "", "C0-"),
    ("predictive, eq. (5) as printed", None, "printed", "C1-"),
    ("safe, now", safe_now, "", "C2-"),
    ("safe, ahead", None, "safe", "C3-"),
    ("true, image moves along", along, "dense", "k:"),
)


def figures() -> Iterator[tuple[str, str, Array, Trucks]]:
    """Title, label of the axis, samples, and the trucks of Duckstein's figures 13 to 16."""
    speeds, turns = np.geomspace(0.1, 4.0, 16), np.geomspace(0.1, 6.0, 16)
    far = np.linspace(20.0, 200.0, 16)
    none, one = np.zeros(16), np.ones(16)
    yield "13: translation, 135 units away", "units a frame", speeds, Trucks(135.0 * one, speeds, none)
    yield "14: rotation, 60 units away", "degrees a frame", turns, Trucks(60.0 * one, none, np.radians(turns))
    yield "15: 1 unit of translation a frame", "units away", far, Trucks(far, one, none)
    yield "16: 1 degree of rotation a frame", "units away", far, Trucks(far, none, np.radians(one))


def exponent(x: Array, y: Array) -> float:
    """The slope in double logarithmic axes, where images are used again at least twice, and end within the sequence."""
    kept = (y >= 2.0) & (y < 0.4 * FRAMES)
    return float(np.polyfit(np.log(x[kept]), np.log(y[kept]), 1)[0]) if kept.sum() > 2 else math.nan


def draw_figures(folder: Path) -> None:
    figure, axes = plt.subplots(2, 2, figsize=(12.0, 9.0))
    for axis, (title, label, samples, trucks) in zip(axes.flat, figures(), strict=True):
        print(f"\n  figure {title}: validity in frames, {label}, and its exponent")
        print(f"  {'':38}" + "".join(f"{x:8.3g}" for x in samples[::3]) + "  exponent")
        curves = [(name, error, promise, style, trucks) for name, error, promise, style in CURVES]
        if title.startswith("15"):
            anywhere = Trucks(samples, np.ones(len(samples)), np.zeros(len(samples)), whole=False)
            curves.append(("common, moves along, counted anywhere", along, "", "C0:", anywhere))
            curves.append(("predictive, (5), counted anywhere", None, "printed", "C1:", anywhere))
        for name, error, promise, style, some in curves:
            frames = validity(some, error, promise)
            axis.plot(samples, frames, style, label=name)
            print(f"  {name:38}" + "".join(f"{y:8.1f}" for y in frames[::3]) + f"{exponent(samples, frames):10.2f}")
        axis.set(title=f"Figure {title}", xlabel=label, ylabel="average validity, frames")
        axis.grid(alpha=0.3)
        if label != "units away":
            axis.set(ylim=(0.0, 60.0))
    axes[1, 0].legend(fontsize=8)
    figure.tight_layout()
    figure.savefig(folder / "validity.png", dpi=110)
    print(f"\nwrote {folder / 'validity.png'}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder for the plots")
    parser.add_argument("--boxes", type=int, default=600, help="random boxes for each ratio")
    parser.add_argument("--seed", type=int, default=5)
    arguments = parser.parse_args()
    matplotlib.use("Agg")
    arguments.output.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(arguments.seed)
    print(f"{arguments.boxes} random boxes, limit of 4 px ({math.degrees(LIMIT):.3f} degrees)")
    print(f"  {'stated : true':58}  median    least     most   unsafe")
    ratios_now(rng, arguments.boxes)
    ratios_ahead(rng, arguments.boxes)
    few = max(arguments.boxes // 4, 1)
    ratios_in_frames(rng, few, "viewer", 1.0, 0.0, 0.0)
    ratios_in_frames(rng, few, "object", 0.0, 1.0, 0.0)
    ratios_in_frames(rng, few, "turn", 0.0, 0.0, 1.0)
    ratios_in_frames(rng, few, "all", 0.4, 0.3, 0.3)
    ratios_of_layers(rng, few)
    keeping_up()
    draw_figures(arguments.output)


if __name__ == "__main__":
    main()
