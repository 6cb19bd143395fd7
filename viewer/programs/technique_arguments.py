"""Options of single techniques, which mean something only where that technique is asked for."""

from __future__ import annotations

import argparse
from collections.abc import Collection
from types import MappingProxyType
from typing import TYPE_CHECKING

from mmi.foundation.errors import ParameterError
from mmi.foundation.processes import usable_cores

if TYPE_CHECKING:
    from viewer.casting.rules import CastRules

__all__ = ["add_cast_arguments", "cast_rules"]

_CAST = "ray-cast"
_OPTIONS = MappingProxyType(
    {"near_field": "near-field", "limit_px": "reuse-error", "reuse": "reuse", "rays": "rays", "caster": "caster"}
)
"""Fields of the rules, and their options."""


def add_cast_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of ray casting."""
    group = parser.add_argument_group("ray casting (the technique ray-cast)")
    group.add_argument(
        "--near-field",
        type=float,
        metavar="METRES",
        help="objects within this distance are drawn, rays find what is beyond (default: 100)",
    )
    group.add_argument(
        "--reuse-error",
        dest="limit_px",
        type=float,
        metavar="PX",
        help="pixels that what was cast before may be off by (default: the error that the dataset was built for, or would be)",
    )
    group.add_argument(
        "--reuse",
        choices=("bound", "hits"),
        help="how that is known: a bound for all that is far (default), or a measurement of each surface that was hit",
    )
    group.add_argument(
        "--rays",
        type=int,
        metavar="N",
        help="cast at most so many in a frame, the worst pixels first (default: as many as the error asks for)",
    )
    group.add_argument(
        "--caster", choices=("embree", "grid"), help="what finds hits: Embree (default), or a regular grid in Numba"
    )


def cast_rules(options: argparse.Namespace, techniques: Collection[str]) -> CastRules:
    """The rules that the options say.

    Raises ParameterError for what has no meaning, and for options of rays where ``techniques`` cast none.
    """
    from viewer.casting.rules import CastRules

    given = {name: getattr(options, name) for name in _OPTIONS if getattr(options, name) is not None}
    if given and _CAST not in techniques:
        raise ParameterError(f"--{_OPTIONS[next(iter(given))]}: {_CAST} among --techniques expected")
    try:
        return CastRules(**given, workers=usable_cores())
    except ParameterError as error:
        name, colon, rest = str(error).partition(":")
        raise ParameterError(f"--{_OPTIONS.get(name, name)}{colon}{rest}") from None
