"""Rules that keep the project's shape: who imports whom, where OpenGL is, and what no module may contain.

Each rule is a function from a module's syntax tree to complaints, held against a violation of its own further down.
"""

from __future__ import annotations

import ast
import importlib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("mmi", "citygen", "viewer")
MODULES = {path.relative_to(ROOT).as_posix(): path for name in PACKAGES for path in sorted((ROOT / name).rglob("*.py"))}

MAY_IMPORT = {"mmi": {"mmi"}, "citygen": {"citygen", "mmi"}, "viewer": {"viewer", "mmi"}}
FLOORS = {
    "mmi": (
        "limits",
        "foundation",
        "city gltf",
        "reading appearance cells movers walks",
        "writing visibility",
        "parallax validity rays",
        "planning capture",
        "meshing",
        "dataset",
        "building",
        "inspection",
        "programs",
    ),
    "citygen": ("shapes streets", "buildings scenes traffic", "presets", "metropolis", "generate", "cli"),
    "viewer": (
        "computed walks",
        "plan",
        "scene",
        "cells casting caching placing layered",
        "placed",
        "techniques",
        "drawing",
        "measuring runtime making",
        "report",
        "window",
        "serving",
        "programs",
    ),
}
"""The rooms (packages, and modules beside them) of each package from the ground up; a room imports from lower floors only."""
ONLY_IN = {
    "pyrender": "mmi/capture/",
    "OpenGL": "mmi/capture/",
    "moderngl": "viewer/drawing/",
    "numba": "mmi/foundation/kernels.py",
}
MOST_LINES = 420
MOST_FILES = 13
MUTABLE_CALLS = {"list", "dict", "set", "bytearray", "defaultdict", "OrderedDict", "Counter", "deque"}


def imported(tree):
    """Every module that is imported anywhere in the tree, by its full name."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "imports are absolute here"
            if node.module not in PACKAGES:
                yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def called(node):
    """``a.b`` for the call a.b(...), or an empty string."""
    return ast.unparse(node.func) if isinstance(node, ast.Call) else ""


def wrong_directions(name, tree):
    package = name.split("/")[0]
    for target in imported(tree):
        root = target.split(".")[0]
        if root in PACKAGES and root not in MAY_IMPORT[package]:
            yield f"{package} imports {target}"


def room_of(module):
    """``mmi``, ``city`` for mmi.city.model; the room of a package itself is an empty string."""
    root, _, rest = module.partition(".")
    return root, rest.split(".")[0]


def floor_of(module):
    """How high a module's room is within its package, None where it is on no floor."""
    root, room = room_of(module)
    return next((i for i, rooms in enumerate(FLOORS[root]) if room in rooms.split()), None)


def upwards(name, tree):
    """A room imports from rooms on lower floors; the package itself, its public face, from all of them."""
    module = name.removesuffix(".py").removesuffix("/__init__").replace("/", ".")
    root, room = room_of(module)
    if not room:
        return
    if floor_of(module) is None:
        yield f"{room} is on no floor of {root}"
        return
    for target in imported(tree):
        there, other = room_of(target)
        if there == root and other != room and (floor_of(target) is None or floor_of(target) >= floor_of(module)):
            yield f"{root}.{room} imports {target}, which is not below it"


def stray_opengl(name, tree):
    for target in imported(tree):
        home = ONLY_IN.get(target.split(".")[0])
        if home is not None and not name.startswith(home):
            yield f"{target} is imported outside {home}"


def unsafe(_name, tree):
    for target in imported(tree):
        if target.split(".")[0] in {"pickle", "cPickle", "dill", "joblib", "marshal", "shelve"}:
            yield f"imports {target}"
    for node in ast.walk(tree):
        if called(node) in {"eval", "exec", "yaml.load"}:
            yield f"line {node.lineno}: calls {called(node)}"
        if isinstance(node, ast.keyword) and node.arg == "allow_pickle":
            yield f"line {node.value.lineno}: allow_pickle"


def keyword_plumbing(_name, tree):
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda) and node.args.kwarg is not None:
            yield f"line {node.lineno}: takes **{node.args.kwarg.arg}"


def mutable_state(_name, tree):
    for node in ast.walk(tree):
        if isinstance(node, ast.Global):
            yield f"line {node.lineno}: global {', '.join(node.names)}"
    for node in tree.body:
        if isinstance(node, ast.Assign | ast.AnnAssign | ast.AugAssign) and node.value is not None:
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            literal = ast.List | ast.Dict | ast.Set | ast.ListComp | ast.DictComp | ast.SetComp
            mutable = isinstance(node.value, literal) or called(node.value).split(".")[-1] in MUTABLE_CALLS
            if mutable and [ast.unparse(target) for target in targets] != ["__all__"]:
                yield f"line {node.lineno}: {ast.unparse(targets[0])} can be changed"


def missing_charter(_name, tree):
    if len((ast.get_docstring(tree) or "").split()) < 5:
        yield "needs a docstring that says what belongs in it"


def bound_names(tree):
    """Names that the module's top level defines, and those that it imports."""
    defined, brought = set(), set()
    for node in [*tree.body, *(one for branch in tree.body if isinstance(branch, ast.If) for one in branch.body)]:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            defined.add(node.name)
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            defined |= {name.id for target in targets for name in ast.walk(target) if isinstance(name, ast.Name)}
        elif isinstance(node, ast.Import | ast.ImportFrom):
            brought |= {alias.asname or alias.name for alias in node.names}
    return defined, brought


def constants_classes_functions(name):
    """Sorts a list of names as isort does (and Ruff's RUF022): SHOUTED, then Capitalised, then the rest."""
    return (0 if name.isupper() else 1 if name[0].isupper() else 2), name


def false_names(name, tree):
    """``__all__`` must be there, sorted, and name all that is public: no more, no less."""
    lists = [node for node in tree.body if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__"]
    defined, brought = bound_names(tree)
    public = {one for one in defined if not one.startswith("_")}
    if not lists:
        if public or not name.endswith("__init__.py"):
            yield "needs one __all__"
        return
    listed = ast.literal_eval(lists[0].value)
    if sorted(set(listed), key=constants_classes_functions) != listed:
        yield f"__all__ is not sorted, or names one twice: {', '.join(listed)}"
    if public - set(listed):
        yield f"not in __all__: {', '.join(sorted(public - set(listed)))}"
    if set(listed) - public - brought:
        yield f"in __all__, but public names of the module expected: {', '.join(sorted(set(listed) - public - brought))}"


def too_long(_name, _tree, text):
    lines = text.count("\n")
    if lines > MOST_LINES:
        yield f"{lines} lines: two ideas, at most {MOST_LINES} lines expected"


RULES = (wrong_directions, upwards, stray_opengl, unsafe, keyword_plumbing, mutable_state, missing_charter, false_names)


@pytest.mark.parametrize("name", MODULES)
def test_module_keeps_the_rules(name):
    text = MODULES[name].read_text(encoding="utf-8")
    tree = ast.parse(text)
    complaints = [complaint for rule in RULES for complaint in rule(name, tree)] + list(too_long(name, tree, text))
    assert not complaints, f"{name}: " + "; ".join(complaints)


@pytest.mark.parametrize(
    ("rule", "name", "source"),
    [
        (wrong_directions, "mmi/x.py", "from viewer import walk"),
        (wrong_directions, "citygen/x.py", "def f():\n    import viewer.walk"),
        (wrong_directions, "viewer/x.py", "import citygen"),
        (upwards, "mmi/city/x.py", "from mmi.reading.read_city import read_city"),
        (upwards, "mmi/planning/x.py", "from mmi.capture.renderer import Capturer"),
        (upwards, "mmi/building/x.py", "from mmi import City"),
        (upwards, "mmi/cellar/x.py", "import math"),
        (upwards, "viewer/plan.py", "def f():\n    from viewer.drawing import renderer"),
        (stray_opengl, "mmi/building/x.py", "import pyrender"),
        (stray_opengl, "viewer/drawing/x.py", "from OpenGL import GL"),
        (stray_opengl, "mmi/capture/x.py", "import moderngl"),
        (unsafe, "mmi/x.py", "from pickle import loads"),
        (unsafe, "mmi/x.py", "def f(text):\n    return eval(text)"),
        (unsafe, "mmi/x.py", "import yaml\nyaml.load(text)"),
        (unsafe, "mmi/x.py", "import numpy as np\nnp.load(path, allow_pickle=True)"),
        (keyword_plumbing, "mmi/x.py", "def f(a, **options): ..."),
        (mutable_state, "mmi/x.py", "_cache: dict[str, int] = {}"),
        (mutable_state, "mmi/x.py", "NAMES = ['a']"),
        (mutable_state, "mmi/x.py", "from collections import defaultdict\nSEEN = defaultdict(list)"),
        (mutable_state, "mmi/x.py", "def f():\n    global count\n    count = 1"),
        (missing_charter, "mmi/x.py", "import math"),
        (false_names, "mmi/x.py", "import math"),
        (false_names, "mmi/__init__.py", "A = 1"),
        (false_names, "mmi/x.py", "__all__ = []\ndef f(): ..."),
        (false_names, "mmi/x.py", "__all__ = []\nA, _b = 1, 2"),
        (false_names, "mmi/x.py", "__all__ = ['f', 'g']\ndef f(): ..."),
        (false_names, "mmi/x.py", "__all__ = ['_f']\ndef _f(): ..."),
        (false_names, "mmi/x.py", "__all__ = ['f', 'Ab']\ndef f(): ...\nclass Ab: ..."),
        (false_names, "mmi/x.py", "__all__ = ['f', 'f']\ndef f(): ..."),
    ],
)
def test_rule_notices(rule, name, source):
    assert list(rule(name, ast.parse(source)))


@pytest.mark.parametrize(
    ("rule", "name", "source"),
    [
        (wrong_directions, "viewer/x.py", "from mmi.camera import View\nimport viewer.walk"),
        (upwards, "mmi/__init__.py", "from mmi.programs.build_impostors import build_impostors"),
        (upwards, "mmi/reading/models/x.py", "from mmi.reading.maps import osm\nfrom mmi.city.model import City"),
        (stray_opengl, "mmi/capture/x.py", "import pyrender"),
        (unsafe, "mmi/x.py", "import numpy as np\nnp.load(path)\nmodel.eval()"),
        (mutable_state, "mmi/x.py", "__all__ = ['a']\nA = (1, 2)\nB = MappingProxyType({'a': 1})"),
        (false_names, "mmi/__init__.py", "'''A package of one module.'''"),
        (false_names, "mmi/reading/__init__.py", "from mmi.reading.report import Tally\n__all__ = ['Tally']"),
        (false_names, "mmi/x.py", "__all__ = ['B', 'Ab', 'f']\nB = _c = 1\ndef f(): ...\nclass Ab: ...\ndef _g(): ..."),
    ],
)
def test_rule_lets_pass(rule, name, source):
    assert not list(rule(name, ast.parse(source)))


def test_every_package_is_looked_at():
    assert {name.split("/")[0] for name in MODULES} == set(PACKAGES)


def test_every_room_exists():
    for root, floors in FLOORS.items():
        listed = [room for rooms in floors for room in rooms.split()]
        there = {
            path.stem for path in (ROOT / root).iterdir() if path.suffix == ".py" or (path / "__init__.py").exists()
        }
        assert sorted(listed) == sorted(there - {"__init__"}), root


@pytest.mark.parametrize("folder", sorted({path.parent for path in MODULES.values()}), ids=lambda path: path.name)
def test_a_package_has_room(folder):
    """A package past a dozen files wants to become two."""
    assert len([path for path in folder.glob("*.py") if path.stem != "__init__"]) <= MOST_FILES


@pytest.mark.parametrize("name", MODULES)
def test_names_that_a_module_offers_exist(name):
    module = importlib.import_module(name.removesuffix(".py").removesuffix("/__init__").replace("/", "."))
    assert [one for one in getattr(module, "__all__", []) if not hasattr(module, one)] == []
