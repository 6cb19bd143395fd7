"""Functions from outside the package: a weight, a layering or a technique of one's own, named so that it can be found again.

Such a function is given as itself or as the text ``package.module:function``. It must be importable under that name: only then
can another process call it, and only then does a dataset or a report say what it was made with. The version tells two states of
one function apart.
"""

from __future__ import annotations

import hashlib
import importlib
import inspect
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

from mmi.foundation.errors import MmiError, ParameterError

__all__ = ["PlugIn", "names_plug_in", "own_mistakes", "plug_in", "said"]

_DIGITS = 12
"""Hexadecimal digits of a version that is made from a module's source."""


@dataclass(frozen=True, slots=True)
class PlugIn:
    """An importable function. Made by :func:`plug_in`, which checks what is said here.

    ``name`` is what reports call it, ``target`` the text ``package.module:function`` that it is imported by, and ``version`` a
    text that changes when the function does. Two plug-ins are equal where name, target, version and function are.
    """

    name: str
    target: str
    version: str
    function: Callable[..., Any]


def names_plug_in(text: str) -> bool:
    """Whether ``text`` has the form ``package.module:function``, and so is no name of the package's own."""
    return ":" in text


def plug_in(of: str | Callable[..., Any] | PlugIn, *, name: str | None = None, version: str | None = None) -> PlugIn:
    """The plug-in that ``of`` is or names.

    ``of`` is a function of a module's top level, or its name as ``package.module:function``; a plug-in stays what it is, except
    for ``name`` and ``version`` where those are given. Without a ``name`` it is called by its target. Without a ``version`` it
    has that of its module (``__version__``), or else twelve hexadecimal digits of the SHA-256 of the module's source, so that
    an edited module counts as another one.

    Raises ParameterError for lambdas, functions inside of functions, methods, whatever is no function, and what cannot be
    imported; also where the module has neither a version nor a source.
    """
    if isinstance(of, PlugIn):
        return PlugIn(name or of.name, of.target, version or of.version, of.function)
    if isinstance(of, str):
        module, target, function = _by_name(of)
    else:
        module, target, function = _by_value(of)
    return PlugIn(name or target, target, version or _version(module, target), function)


def _by_name(text: str) -> tuple[ModuleType, str, Callable[..., Any]]:
    place, colon, attribute = text.partition(":")
    if not colon or not attribute.isidentifier() or not all(part.isidentifier() for part in place.split(".")):
        raise ParameterError(f"a function as package.module:function expected, found {text!r}")
    module = _imported(place, text)
    function = getattr(module, attribute, None)
    if function is None:
        raise ParameterError(f"{text}: a function {attribute!r} of the module {place} expected, found none")
    _check_function(function, text)
    return module, text, function


def _by_value(function: Callable[..., Any]) -> tuple[ModuleType, str, Callable[..., Any]]:
    described = getattr(function, "__qualname__", None) or repr(function)
    _check_function(function, described)
    place, attribute = function.__module__, function.__qualname__
    if "<" in attribute or "." in attribute:
        kind = "a lambda" if "<lambda>" in attribute else "a function inside of a function or class"
        raise ParameterError(
            f"{described}: a function of a module's top level expected, so that other processes can import it, found {kind}"
        )
    if place == "__main__":
        place = _script(described)
    target = f"{place}:{attribute}"
    module = _imported(place, target)
    if not hasattr(module, attribute):
        raise ParameterError(f"{target}: a function {attribute!r} of the module {place} expected, found none")
    return module, target, function


def _check_function(function: object, where: str) -> None:
    """Functions compiled by Numba count: they keep what they were made from as ``py_func``."""
    if not (inspect.isfunction(getattr(function, "py_func", function)) or inspect.isbuiltin(function)):
        raise ParameterError(f"{where}: a function expected, found a value of type {type(function).__name__}")


def _imported(place: str, target: str) -> ModuleType:
    try:
        return importlib.import_module(place)
    except (Exception, SystemExit) as error:  # a module may raise anything while it is imported
        reason = " ".join(str(error).split()) or "no reason given"
        raise ParameterError(
            f"{target}: a module {place} that can be imported expected, found {type(error).__name__}: {reason}"
        ) from error


def _script(described: str) -> str:
    """The name under which other processes can import the module that was started as a program."""
    file = getattr(sys.modules["__main__"], "__file__", None)
    spec = getattr(sys.modules["__main__"], "__spec__", None)
    if spec is not None:
        return str(spec.name).removesuffix(".__main__")
    if file is None:
        raise ParameterError(
            f"{described}: a function of a module expected, found one that was typed into an interpreter"
        )
    return Path(file).stem


def _version(module: ModuleType, target: str) -> str:
    stated = getattr(module, "__version__", None)
    if isinstance(stated, str) and stated:
        return stated
    try:
        source = inspect.getsource(module)
    except (OSError, TypeError) as error:
        raise ParameterError(f"{target}: a version expected, as its module states none and has no source") from error
    return hashlib.sha256(source.encode()).hexdigest()[:_DIGITS]


@contextmanager
def own_mistakes(what: str) -> Iterator[None]:
    """In the body of a ``with`` statement, what a function from outside the package raises becomes a ParameterError.

    ``what`` names the function, such as ``weights my_module:apart``. Errors of this project pass.
    """
    try:
        yield
    except MmiError:
        raise
    except (Exception, SystemExit) as error:
        raise ParameterError(f"{what}: {said(error)}") from error


def said(error: BaseException) -> str:
    """An error of a function from outside the package, in one line."""
    text = str(error).splitlines()
    return f"{type(error).__name__}: {text[0]}" if text else type(error).__name__
