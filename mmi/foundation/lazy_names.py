"""Public names of a package that are imported when they are first asked for: a face that costs nothing until it is used.

A package's ``__init__`` imports its names under ``TYPE_CHECKING``, for people, editors and type checkers, and says here which
module has which; importing one of its modules then does not import all of the others.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping, Sequence

__all__ = ["lazy_names"]


def lazy_names(package: str, homes: Mapping[str, Sequence[str]]) -> Callable[[str], object]:
    """The ``__getattr__`` of ``package`` whose public names live in ``homes``: module -> names."""
    home = {name: module for module, names in homes.items() for name in names}

    def find(name: str) -> object:
        if name not in home:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(importlib.import_module(home[name]), name)

    return find
