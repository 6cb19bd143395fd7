"""The public names of ``mmi`` and ``viewer``, pinned in public_names.txt: none comes, goes or changes its arguments unnoticed.

After a change that is meant, write the file anew: python tests/test_public_names.py
"""

import ast
import importlib
import inspect
import subprocess
import sys
from pathlib import Path

import pytest

PINNED = Path(__file__).with_name("public_names.txt")
FACES = ("mmi", "viewer")


def described(package, name):
    """The name, with the names of its arguments where it takes any."""
    value = getattr(importlib.import_module(package), name)
    if not callable(value) or (inspect.isclass(value) and getattr(value, "_is_protocol", False)):
        return f"{package}.{name}"
    if inspect.isclass(value) and issubclass(value, BaseException):
        return f"{package}.{name}"
    try:
        return f"{package}.{name}({', '.join(inspect.signature(value).parameters)})"
    except (TypeError, ValueError):
        return f"{package}.{name}"


def public_names():
    return [described(package, name) for package in FACES for name in importlib.import_module(package).__all__]


def test_public_names_are_those_that_are_pinned():
    found, pinned = public_names(), PINNED.read_text(encoding="utf-8").splitlines()
    gone, new = [one for one in pinned if one not in found], [one for one in found if one not in pinned]
    assert found == pinned, f"gone: {gone}; new: {new}; if this is meant: python tests/test_public_names.py"


@pytest.mark.parametrize("package", FACES)
def test_a_face_shows_type_checkers_what_it_gives(package):
    """Names are written down twice, for type checkers and for the interpreter: both say the same."""
    module = importlib.import_module(package)
    tree = ast.parse(Path(module.__file__).read_text(encoding="utf-8"))
    (checked,) = [node for node in tree.body if isinstance(node, ast.If)]
    shown = {one.module: tuple(alias.name for alias in one.names) for one in checked.body}
    assert shown == dict(module._HOMES)
    assert sorted(name for names in shown.values() for name in names) == sorted(module.__all__) == sorted(dir(module))
    with pytest.raises(AttributeError, match=f"module '{package}' has no attribute 'nothing'"):
        _ = module.nothing


def test_a_face_costs_nothing_until_it_is_used():
    code = "import sys, mmi, viewer, mmi.foundation.errors; print(sorted({'numpy', 'shapely', 'numba'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


if __name__ == "__main__":
    sys.path[0] = str(Path(__file__).resolve().parents[1])  # beside this file is tests/mmi, which is no package
    PINNED.write_text("\n".join(public_names()) + "\n", encoding="utf-8")
