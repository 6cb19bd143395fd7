"""The colours that tell layers apart, in plots of a build and in tinted pictures of a walk.

They are those of Okabe and Ito's palette, which colour-blind readers can tell apart, without black. Layers beyond the last
colour begin with the first again; how a plot or a picture marks their round is its own business.
"""

from __future__ import annotations

__all__ = ["LAYER_COLORS", "layer_color"]

LAYER_COLORS = ("#E69F00", "#56B4E9", "#009E73", "#F0E442", "#0072B2", "#D55E00", "#CC79A7")
"""sRGB, as text."""


def layer_color(layer: int) -> tuple[str, int]:
    """(colour, round) of a layer: the round counts how often the colours were used up by the layers before it."""
    return LAYER_COLORS[layer % len(LAYER_COLORS)], layer // len(LAYER_COLORS)
