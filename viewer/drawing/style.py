"""How a plan is drawn where a viewer wants to look inside: layers tinted, some of them alone, meshes as lines. Plain values.

A style changes what a picture looks like and nothing else: the plan's requests are executed as they are, so that what a
technique has captured is there in the next frame, whatever its style. Without one, nothing is done here at all.

What is tinted:

    stored layers           each layer in its colour of ``mmi.appearance.layer_colors``
    captured in this frame  white, with stripes
    captured before         black, with stripes: pictures that are shown again

Near geometry, ground and sky are never tinted.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, replace

from mmi.appearance.layer_colors import layer_color
from viewer.plan import CellLayers, Draw, Plan, Relief, ReliefPart, Request, Sky

__all__ = [
    "CAPTURED",
    "CAPTURED_LINES",
    "NEAR_LINES",
    "PLAIN",
    "REUSED",
    "REUSED_LINES",
    "Ink",
    "Style",
    "fresh_parts",
    "layer_ink",
    "layer_names",
    "narrowed",
]

Ink = tuple[int, int, int, int]
"""sRGB of a tint or a line, and its pattern: 0 none, 1 stripes, 2 dots, 3 crossed stripes."""
CAPTURED: Ink = (255, 255, 255, 1)
"""The tint of what was captured in this frame."""
REUSED: Ink = (0, 0, 0, 1)
"""The tint of what was captured in an earlier frame."""
CAPTURED_LINES: Ink = (255, 255, 255, 0)
REUSED_LINES: Ink = (140, 140, 140, 0)
NEAR_LINES: Ink = (225, 225, 225, 0)
"""Lines of geometry; lines are drawn over a darkened picture."""
_PATTERNS = 4
_NAME = re.compile(r"s(\d+)\.l(\d+)(\.\d+)?")


@dataclass(frozen=True, slots=True)
class Style:
    """What to show: ``tint`` layers; only layers ``alone`` (names as in the dataset, ``s0.l2``) before the sky, None for
    everything; and ``wireframe``: the edges of layers' meshes and of geometry as lines over the picture, which is darkened.
    """

    tint: bool = False
    alone: frozenset[str] | None = None
    wireframe: bool = False


PLAIN = Style()
"""The picture as it is."""


def layer_ink(name: str) -> Ink:
    """The tint of a layer of this name, or of one of its pieces. Raises ValueError for what is no name of a layer."""
    color, number = layer_color(_index(name))
    red, green, blue = bytes.fromhex(color.removeprefix("#"))
    return red, green, blue, number % _PATTERNS


def layer_names(names: Iterable[str], layer: int) -> frozenset[str]:
    """Those of some ``names`` that are pictures of the layer of this index, in whatever sector."""
    return frozenset(name for name in names if _index(name) == layer)


def narrowed(plan: Plan, style: Style) -> Plan:
    """The plan with only what ``style`` leaves of its draws; requests stay.

    Of what was captured, pictures of one layer stay with that layer; pictures of all layers (a viewer who stands still has
    one) are left out, and so is what a plan finishes with.
    """
    if style.alone is None:
        return plan
    some, before = _narrowed(plan.draws, style.alone), _narrowed(plan.fading, style.alone)
    return replace(plan, draws=some, fading=before, finish=None)


def fresh_parts(relief: Relief, requests: Iterable[Request]) -> tuple[Relief, Relief]:
    """``relief`` in two: the parts into whose place some of ``requests`` capture, and the others."""
    places = [(*one.into.corner, *one.view.window[2:]) for one in requests if one.into.image == relief.image]
    fresh: list[ReliefPart] = []
    rest: list[ReliefPart] = []
    for part in relief.parts:
        (x, y), (_, _, width, height) = part.corner, part.view.window
        meets = any(a < x + width and x < a + w and b < y + height and y < b + h for a, b, w, h in places)
        (fresh if meets else rest).append(part)
    return replace(relief, parts=tuple(fresh)), replace(relief, parts=tuple(rest))


def _narrowed(draws: tuple[Draw, ...], alone: frozenset[str]) -> tuple[Draw, ...]:
    kept: list[Draw] = []
    for draw in draws:
        match draw:
            case Sky():
                kept.append(draw)
            case CellLayers():
                kept.append(replace(draw, names=tuple(name for name in draw.names if name in alone)))
            case Relief() if draw.image.name.split(" ")[0] in alone:
                kept.append(draw)
    return tuple(kept)


def _index(name: str) -> int:
    found = _NAME.fullmatch(name)
    if found is None:
        raise ValueError(f"a layer's name such as s0.l2 expected, found {name!r}")
    return int(found[2])
