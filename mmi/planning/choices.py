"""Weights, layerings and near stages by name: the tables of what a build can be told, and functions of one's own beside them.

A choice is a name, the function behind it, and whether the bound on the error holds with it. A researcher's own function is
given as itself or as ``package.module:function`` (:mod:`mmi.foundation.plug_ins`); nothing is promised of it. Parameters and
manifests hold a choice as text: a name of a table, or ``package.module:function@version``. Reading such a text imports
nothing; that happens where a plan is made (:func:`function_of`), which refuses another version of the function than was
chosen.

The functions take these, and their modules say what they return:

- weights: :class:`mmi.planning.weighing.FarField`;
- layerings: the graph of visibility events and the boxes of its nodes (:mod:`mmi.planning.layering`);
- near stages: :class:`mmi.planning.segmentation.NearSettings`.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from typing import Any

from mmi.foundation.errors import ParameterError
from mmi.foundation.plug_ins import PlugIn, names_plug_in, own_mistakes, plug_in

__all__ = ["LAYERINGS", "NEAR_STAGES", "WEIGHTS", "Choice", "blaming", "choose", "function_of"]


@dataclass(frozen=True, slots=True)
class Choice:
    """A weight, a layering or a near stage.

    ``function`` is what computes it, as ``package.module:function``. ``bounded``: the bound on the error holds with it, as
    long as it holds with all other choices. ``near_stage``: for weights, the near stage that goes with them where none is
    asked for. ``version`` is that of a function from outside the package, None for the package's own.
    """

    name: str
    function: str
    bounded: bool = False
    near_stage: str = "parallax"
    version: str | None = None

    @property
    def text(self) -> str:
        """What stands for it in parameters and manifests."""
        return self.name if self.version is None else f"{self.function}@{self.version}"


WEIGHTS = (
    Choice("same-ray", "mmi.planning.weighing:same_ray", bounded=True),
    Choice("critical-zone", "mmi.planning.weighing:critical_zone", near_stage="distance"),
    Choice("critical-zone-unsigned", "mmi.planning.weighing:critical_zone_unsigned", near_stage="distance"),
)
LAYERINGS = (
    Choice("best", "mmi.planning.layering:layers_best", bounded=True),
    Choice("incremental", "mmi.planning.layering:layers_incremental", bounded=True),
    Choice("largest-first", "mmi.planning.layering:layers_largest_first", bounded=True),
    Choice("smallest-last", "mmi.planning.layering:layers_smallest_last", bounded=True),
    Choice("dsatur", "mmi.planning.layering:layers_dsatur", bounded=True),
    Choice("single", "mmi.planning.layering:layers_single"),
)
NEAR_STAGES = (
    Choice("parallax", "mmi.planning.segmentation:near_stage_by_parallax", bounded=True),
    Choice("distance", "mmi.planning.segmentation:near_stage_by_distance"),
)


def choose(table: tuple[Choice, ...], of: str | Callable[..., Any] | PlugIn, *, what: str) -> Choice:
    """The entry of ``table`` that ``of`` names, or the choice of a function of one's own.

    Without a version, the text ``package.module:function`` gets that of the function as it is now. Raises ParameterError,
    which begins with ``what``, for an unknown name and for a function that other processes cannot import.
    """
    if isinstance(of, str) and not names_plug_in(of):
        found = next((one for one in table if one.name == of), None)
        if found is None:
            names = " or ".join([*(one.name for one in table), "package.module:function"])
            raise ParameterError(f"{what}: {names} expected, found {of!r}")
        return found
    if isinstance(of, str):
        function, _, version = of.partition("@")
        if version:
            return Choice(function, function, version=version)
    try:
        own = plug_in(of)
    except ParameterError as error:
        raise ParameterError(f"{what}: {error}") from error
    return Choice(own.target, own.target, version=own.version)


def function_of(choice: Choice) -> Callable[..., Any]:
    """The function of a choice, imported. Raises ParameterError where it is missing or of another version than was chosen."""
    if choice.version is None:
        place, _, name = choice.function.partition(":")
        function: Callable[..., Any] = getattr(importlib.import_module(place), name)
        return function
    found = plug_in(choice.function)
    if found.version != choice.version:
        raise ParameterError(f"{choice.function}: version {choice.version} expected, found {found.version}")
    return found.function


def blaming(choice: Choice, *, what: str) -> AbstractContextManager[None]:
    """In the body of a ``with`` statement, what a function from outside the package raises becomes a ParameterError."""
    return nullcontext() if choice.version is None else own_mistakes(f"{what} {choice.name}")
