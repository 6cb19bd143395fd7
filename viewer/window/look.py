"""What somebody wants to see: which techniques, how they are set against each other, and what is shown of them.

A :class:`Look` is a value that is checked when it is made, from fields as a page sends them. What a change is not about stays.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

from mmi.foundation.errors import ParameterError
from mmi.foundation.json_forms import json_number, shown

__all__ = ["MODES", "SHOWS", "Look"]

MODES = ("one", "side", "swipe", "blink", "difference", "wrong")
"""How the pictures of two techniques are set against each other."""
SHOWS = ("picture", "layers", "depth", "objects")
"""What is shown of each: itself, its layers tinted, how far things are, which object each pixel shows."""
_LONGEST_NAME = 200
_MOST_MS, _MOST_PX, _MOST_LAYERS = 1000.0, 1000.0, 1000
_QUALITIES = (30, 95)


@dataclass(frozen=True, slots=True)
class Look:
    """What is shown. Raises ParameterError for what has no meaning.

    ``left`` and ``right`` are names of techniques; ``one`` shows the right one. ``swipe`` is the share of the width that the
    left one has. ``layer`` is the index of the only layer that is drawn, None for all. With ``freeze`` the impostors' plan
    stays that of the place where it was set, while the camera flies on. ``worst`` has the worst region of a still frame boxed.
    ``budget_ms`` milliseconds of a frame may be spent on updates, None for as many as the frame leaves. ``threshold_px`` is how
    thick wrong regions must be to be shown, None for the error that the dataset was built for. ``lossless`` asks for pictures
    without loss, ``quality`` for a JPEG quality, None for one that adapts. With ``fly`` walls and ground do not count.
    """

    mode: str = "swipe"
    left: str = "full"
    right: str = "multi-mesh"
    swipe: float = 0.5
    show: str = "picture"
    wireframe: bool = False
    layer: int | None = None
    freeze: bool = False
    worst: bool = False
    budget_ms: float | None = 5.0
    threshold_px: float | None = None
    lossless: bool = False
    fly: bool = False
    quality: int | None = None

    def __post_init__(self) -> None:
        for name, value, among in (("mode", self.mode, MODES), ("show", self.show, SHOWS)):
            if value not in among:
                raise ParameterError(f"{name}: one of {', '.join(among)} expected, found {shown(value)}")
        for name in ("left", "right"):
            value = getattr(self, name)
            if not (isinstance(value, str) and 0 < len(value) <= _LONGEST_NAME):
                raise ParameterError(f"{name}: the name of a technique expected, found {shown(value)}")
        for name in ("wireframe", "freeze", "worst", "lossless", "fly"):
            if not isinstance(getattr(self, name), bool):
                raise ParameterError(f"{name}: true or false expected, found {shown(getattr(self, name))}")
        for name, most in (("swipe", 1.0), ("budget_ms", _MOST_MS), ("threshold_px", _MOST_PX)):
            value = getattr(self, name)
            if value is None and name != "swipe":
                continue
            number = json_number(value, name, most=most)
            if number < 0.0:
                raise ParameterError(f"{name}: 0 or more expected, found {shown(value)}")
            object.__setattr__(self, name, number)
        for name, least, last in (("layer", 0, _MOST_LAYERS), ("quality", *_QUALITIES)):
            value = getattr(self, name)
            if value is None:
                continue
            if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= last:
                raise ParameterError(f"{name}: a whole number from {least} to {last} expected, found {shown(value)}")

    def changed(self, some: Mapping[str, Any]) -> Look:
        """The same look with ``some`` of its fields changed. Raises ParameterError for unknown fields and wrong values."""
        known = [field.name for field in fields(self)]
        for name in some:
            if name not in known:
                raise ParameterError(f"look: the fields {', '.join(known)} expected, found {shown(name)}")
        return replace(self, **some)

    def plain(self) -> dict[str, Any]:
        """All fields as plain data."""
        return asdict(self)
