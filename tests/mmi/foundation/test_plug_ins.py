"""Functions from outside: found by name, refused where another process could not find them."""

import math
import pickle
import subprocess
import sys
from functools import partial

import numba
import pytest

from mmi.foundation.errors import ParameterError
from mmi.foundation.plug_ins import PlugIn, names_plug_in, plug_in

MODULE = "def heavier(a, b):\n    return a + b\n"


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A package ``borrowed`` with a module ``weights`` that nobody else has."""
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "borrowed").mkdir()
    (tmp_path / "borrowed" / "__init__.py").write_text("'''Somebody's.'''\n")
    (tmp_path / "borrowed" / "weights.py").write_text(MODULE)
    yield tmp_path / "borrowed"
    for name in [name for name in sys.modules if name.split(".")[0] == "borrowed"]:
        del sys.modules[name]


def top_level(x):
    return x


@numba.njit
def compiled(x):
    return x


class Callable:
    def __call__(self):
        """Callable, but no function."""

    def method(self):
        """No function of the module's top level."""


@pytest.mark.usefixtures("package")
def test_a_function_is_found_by_its_name():
    found = plug_in("borrowed.weights:heavier")
    assert found.function(1, 2) == 3
    assert (found.name, found.target) == ("borrowed.weights:heavier", "borrowed.weights:heavier")


@pytest.mark.usefixtures("package")
def test_a_function_and_its_name_are_the_same_plug_in():
    found = plug_in("borrowed.weights:heavier")
    assert plug_in(found.function) == found
    assert plug_in(found) == found


@pytest.mark.usefixtures("package")
def test_names_and_versions_are_as_given():
    named = plug_in("borrowed.weights:heavier", name="heavy", version="7")
    assert (named.name, named.target, named.version) == ("heavy", "borrowed.weights:heavier", "7")
    assert plug_in(named, version="8") == PlugIn("heavy", named.target, "8", named.function)


def test_the_version_is_the_modules_own(package):
    (package / "weights.py").write_text("__version__ = '2.1'\n" + MODULE)
    assert plug_in("borrowed.weights:heavier").version == "2.1"


def test_an_edited_module_has_another_version(package):
    before = plug_in("borrowed.weights:heavier").version
    (package / "other.py").write_text(MODULE)
    assert plug_in("borrowed.other:heavier").version == before
    (package / "edited.py").write_text(MODULE.replace("+", "-"))
    assert plug_in("borrowed.edited:heavier").version != before


@pytest.mark.usefixtures("package")
def test_another_process_gets_it():
    found = plug_in("borrowed.weights:heavier")
    assert pickle.loads(pickle.dumps(found)) == found


def test_functions_compiled_and_built_in_are_functions():
    assert plug_in(compiled).function is compiled
    assert plug_in("math:sqrt", version="1").function is math.sqrt
    with pytest.raises(ParameterError, match="a version expected"):
        plug_in("math:sqrt")


def test_what_others_cannot_import_is_refused():
    def local(x):
        return x

    with pytest.raises(ParameterError, match="found a lambda"):
        plug_in(lambda x: x)
    for inner in (local, Callable.method):
        with pytest.raises(ParameterError, match=r"found a function inside of a function or class"):
            plug_in(inner)
    for value in (3, Callable(), Callable, partial(top_level, 1), Callable().method):
        with pytest.raises(ParameterError, match="a function expected, found a value of type"):
            plug_in(value)


@pytest.mark.parametrize(
    "text", ["borrowed", "borrowed.weights.heavier", "a b:c", "borrowed.weights:", ":f", "a:b.c", ""]
)
def test_a_name_of_another_form_is_refused(text):
    with pytest.raises(ParameterError, match=r"package\.module:function expected"):
        plug_in(text)


def test_what_does_not_import_is_said_in_words(package):
    (package / "broken.py").write_text("1 / 0\n")
    with pytest.raises(ParameterError, match=r"borrowed.broken that can be imported expected, found ZeroDivisionError"):
        plug_in("borrowed.broken:f")
    with pytest.raises(ParameterError, match=r"found ModuleNotFoundError"):
        plug_in("borrowed.absent:f")
    with pytest.raises(ParameterError, match=r"'lighter' of the module borrowed.weights expected, found none"):
        plug_in("borrowed.weights:lighter")
    with pytest.raises(ParameterError, match=r"a function expected, found a value of type str"):
        plug_in("borrowed.weights:__name__")


def test_a_program_names_its_functions_by_its_file(tmp_path):
    script = tmp_path / "my_study.py"
    script.write_text(
        "from mmi.foundation.plug_ins import plug_in\n"
        "def mine(): ...\n"
        "if __name__ == '__main__':\n    print(plug_in(mine).target)\n"
    )
    told = subprocess.run([sys.executable, script], capture_output=True, text=True, check=True)
    assert told.stdout.strip() == "my_study:mine"


def test_names_of_the_package_are_no_plug_ins():
    assert names_plug_in("borrowed.weights:heavier")
    assert not names_plug_in("multi-mesh")
