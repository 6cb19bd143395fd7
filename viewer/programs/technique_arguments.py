"""Options of single techniques, which mean something only where that technique is asked for."""

from __future__ import annotations

import argparse
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from mmi.foundation.errors import ParameterError
from mmi.foundation.processes import usable_cores
from mmi.programs.command_line import path_option

if TYPE_CHECKING:
    from viewer.caching.rules import CacheRules
    from viewer.casting.rules import CastRules
    from viewer.placed.rules import PlacedRules

__all__ = [
    "add_cache_arguments",
    "add_cast_arguments",
    "add_placed_arguments",
    "add_warp_argument",
    "cache_rules",
    "cast_rules",
    "placed_rules",
]

_CAST, _CACHE, _PLACED = "ray-cast", "image-cache", "placed-images"
_PLACED_OPTIONS = MappingProxyType({"folder": "placed", "warp": "warp"})
_OPTIONS = MappingProxyType(
    {"near_field": "near-field", "limit_px": "reuse-error", "reuse": "reuse", "rays": "rays", "caster": "caster"}
)
"""Fields of the rules, and their options."""
_CACHE_OPTIONS = MappingProxyType(
    {
        "keep": "cached",
        "error_px": "cache-error",
        "leaf_triangles": "leaf-triangles",
        "depth": "depth",
        "bytes": "cache-bytes",
        "eager": "eager",
    }
)


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

    given = _given(options, _OPTIONS, _CAST, techniques)
    with _by_option(_OPTIONS):
        return CastRules(**given, workers=usable_cores())


def add_cache_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the image cache."""
    group = parser.add_argument_group("images of boxes (the technique image-cache)")
    group.add_argument(
        "--cached",
        dest="keep",
        choices=("sphere", "frustum"),
        help="keep images up to date all around the viewer, so that turning needs no new ones (default), or only in view",
    )
    group.add_argument(
        "--cache-error",
        dest="error_px",
        type=float,
        metavar="PX",
        help="an image is shown while no point of it is off by more than so many of the display's smallest pixels (default: 1)",
    )
    group.add_argument(
        "--leaf-triangles",
        type=int,
        metavar="N",
        help="boxes of so many triangles or fewer are not divided (default: 1000)",
    )
    group.add_argument(
        "--depth", type=int, metavar="N", help="levels of boxes below the first (default: as many as it takes)"
    )
    group.add_argument(
        "--cache-bytes",
        dest="bytes",
        type=int,
        metavar="N",
        help="bytes that all images may take together; the least recently shown give way (default: 536870912)",
    )
    group.add_argument(
        "--eager",
        action="store_const",
        const=True,
        help="make an image of every box that can be one, and only those of the smallest from triangles, as the paper does, "
        "and not just where that is predicted to save time",
    )


def cache_rules(options: argparse.Namespace, techniques: Collection[str]) -> CacheRules:
    """The rules that the options say.

    Raises ParameterError for what has no meaning, and for options of boxes where none of ``techniques`` has any.
    """
    from viewer.caching.rules import CacheRules

    given = _given(options, _CACHE_OPTIONS, _CACHE, techniques)
    with _by_option(_CACHE_OPTIONS):
        return CacheRules(**given)


def add_placed_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of placed images."""
    group = parser.add_argument_group("placed images (the technique placed-images)")
    group.add_argument(
        "--placed", dest="folder", type=path_option, metavar="DIR", help="what place-images wrote for the same model"
    )
    add_warp_argument(group)


def add_warp_argument(parser: argparse._ActionsContainer) -> None:
    """The option that says what warps placed images."""
    parser.add_argument(
        "--warp",
        choices=("software", "points"),
        help="what warps placed images: the processor (default), or the renderer, as points with depth",
    )


def placed_rules(options: argparse.Namespace, techniques: Collection[str]) -> PlacedRules:
    """The rules that the options say.

    Raises ParameterError for some where none of ``techniques`` shows images, and for no folder where one would.
    """
    from viewer.placed.rules import PlacedRules

    given = _given(options, _PLACED_OPTIONS, _PLACED, techniques)
    if "folder" not in given and _PLACED in techniques:
        raise ParameterError(f"--placed: a folder that place-images wrote expected for {_PLACED}, found none")
    return PlacedRules(**given, threads=max(1, usable_cores() // 2))


def _given(
    options: argparse.Namespace, names: Mapping[str, str], technique: str, techniques: Collection[str]
) -> dict[str, Any]:
    """The fields of rules that the user has said something of."""
    given = {name: getattr(options, name) for name in names if getattr(options, name) is not None}
    if given and technique not in techniques:
        raise ParameterError(f"--{names[next(iter(given))]}: {technique} among --techniques expected")
    return given


@contextmanager
def _by_option(names: Mapping[str, str]) -> Iterator[None]:
    """Within it, fields of rules that are refused are told by their options."""
    try:
        yield
    except ParameterError as error:
        name, colon, rest = str(error).partition(":")
        raise ParameterError(f"--{names.get(name, name)}{colon}{rest}") from None
