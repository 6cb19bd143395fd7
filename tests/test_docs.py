"""README and documentation: short where they must be, no dead links, no options that no program has, plain English."""

import contextlib
import importlib
import io
import re
import tomllib
from functools import cache
from pathlib import Path

import pytest
from test_architecture import FLOORS

from mmi.movers.movers_file import read_movers
from mmi.reading.gdal_files import RASTERS, VECTOR_FORMATS
from mmi.reading.maps.footprints import GDAL_SUFFIXES
from mmi.reading.models.mesh_files import MESH_SUFFIXES
from mmi.walks.walk import read_walk

ROOT = Path(__file__).resolve().parents[1]
PAGES = {
    path.relative_to(ROOT).as_posix(): path
    for path in [*ROOT.glob("*.md"), *sorted((ROOT / "docs").rglob("*.md")), *sorted((ROOT / "examples").rglob("*.md"))]
}
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
MOST_README_LINES = 120
BANNED = re.compile(r"\b(whence|thus|hence|dear|apt)\b", re.IGNORECASE)
FENCE = re.compile(r"^( *)(```|~~~).*?^\1\2\s*$", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"!?\[[^\]]*\]\(([^()\s]+)\)")
OPTION = re.compile(r"(?<![\w-])--[a-z][a-z0-9-]*")
GENERATED = re.compile(r"(^|/)api/(mmi|viewer|citygen)[\w.]*\.md$")
"""Pages of packages, which docs/hooks/from_code.py makes."""
OTHER_PROGRAMS = {
    "scripts/test": {"--slow"},
    "mkdocs": {"--strict"},
    "tests.fuzz": {"--format", "--mutants", "--run", "--first"},
    "pytest": {"--slow"},
}
"""Options of what is no program with a --help of ours."""


@cache
def text_of(name):
    return PAGES[name].read_text(encoding="utf-8")


def prose_of(text):
    """A page without code: what English is about."""
    return re.sub(r"`[^`\n]*`", "", re.sub(r"^( {4}|\t).*$", "", FENCE.sub("", text), flags=re.MULTILINE))


@cache
def options_of(program):
    """The options in a program's --help, which is a console script of ours or a file of benchmarks."""
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed), contextlib.suppress(SystemExit):
        module, _, name = PROJECT["scripts"][program].partition(":")
        getattr(importlib.import_module(module), name)(["--help"])
    return set(OPTION.findall(printed.getvalue()))


@cache
def options_of_benchmark(path):
    """Those in its own text, and in that of the modules beside it that it uses."""
    text = (ROOT / path).read_text(encoding="utf-8")
    beside = [ROOT / "benchmarks" / f"{name}.py" for name in re.findall(r"^from (\w+) import", text, re.MULTILINE)]
    texts = [text, *(one.read_text(encoding="utf-8") for one in beside if one.exists())]
    return set(re.findall(r'"(--[a-z][a-z0-9-]*)"', "\n".join(texts)))


def commands_of(text):
    """Every command line of a program of ours in a page: blocks and code in sentences, continued lines joined."""
    joined = text.replace("\\\n", " ")
    spans = re.findall(r"`([^`\n]+)`", FENCE.sub("", joined)) + joined.splitlines()
    starts = "|".join([*map(re.escape, PROJECT["scripts"]), r"python benchmarks/\w+\.py"])
    for span in spans:
        found = re.match(rf"\s*({starts})\s+(.*)", span.split("#", 1)[0])
        if found:
            yield found[1], found[2]


def links_of(name):
    for target in LINK.findall(FENCE.sub("", text_of(name))):
        if not re.match(r"[a-z]+:", target):
            yield target


def broken(name, target):
    """Why a relative link of a page leads nowhere, or None."""
    file, _, _ = target.partition("#")
    if not file or GENERATED.search(file):
        return None
    there = (PAGES[name].parent / file).resolve()
    if not there.is_relative_to(ROOT):
        return f"{target} leaves the project"
    return None if there.exists() else f"{target} does not exist"


def strange_options(text):
    """Options that a page gives to a program which does not have them."""
    for program, rest in commands_of(text):
        known = (
            options_of_benchmark(program.removeprefix("python "))
            if program.startswith("python ")
            else options_of(program)
        )
        yield from (f"{program} {option}" for option in OPTION.findall(rest) if option not in known)


def unknown_options(text):
    """Options that a page names anywhere and that no program has."""
    known = set().union(*map(options_of, PROJECT["scripts"]), *OTHER_PROGRAMS.values())
    for path in (ROOT / "benchmarks").glob("*.py"):
        known |= options_of_benchmark(path.relative_to(ROOT).as_posix())
    return sorted(set(OPTION.findall(re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL))) - known)


def test_the_readme_is_short():
    assert text_of("README.md").count("\n") <= MOST_README_LINES


@pytest.mark.parametrize("name", PAGES)
def test_relative_links_and_pictures_exist(name):
    assert [why for why in (broken(name, target) for target in links_of(name)) if why] == []


@pytest.mark.parametrize("name", PAGES)
def test_options_exist(name):
    assert list(strange_options(text_of(name))) == []
    assert unknown_options(text_of(name)) == []


@pytest.mark.parametrize("name", PAGES)
def test_english_is_plain(name):
    assert BANNED.findall(prose_of(text_of(name))) == []


@pytest.mark.parametrize("name", PAGES)
def test_pages_name_only_files_that_a_stranger_has(name):
    """Nobody else has a folder of data beside the project's."""
    assert "../shared" not in text_of(name)


def test_what_pages_ask_the_hook_for_exists():
    for name in PAGES:
        for kind, what in re.findall(
            r"^<!-- (schema|help|packages|names|file|example) (\S+) -->$", text_of(name), re.MULTILINE
        ):
            assert what in PROJECT["scripts"] if kind == "help" else (ROOT / what).exists(), f"{name}: {what}"


def test_every_schema_has_a_page():
    asked = {what for name in PAGES for what in re.findall(r"^<!-- schema (\S+) -->$", text_of(name), re.MULTILINE)}
    schemas = {
        str(one.relative_to(ROOT)) for root in ("mmi", "viewer") for one in ROOT.joinpath(root).rglob("schemas/*.json")
    }
    assert schemas - asked == set()


def test_examples_of_formats_are_read(tmp_path):
    """Whoever copies one has a file that works."""
    for page, read in (("walk", read_walk), ("movers", read_movers)):
        (example,) = re.findall(r"^```json\n(.*?)^```$", text_of(f"docs/formats/{page}.md"), re.MULTILINE | re.DOTALL)
        (tmp_path / "example.json").write_text(example, encoding="utf-8")
        read(tmp_path / "example.json")


def unknown_names(text):
    """Dotted names in a page that are no module, no name in one, and not what a table of renames starts from."""
    rows = re.sub(r"^\|[^|]*\|(?=[^|]*\|$)", "", text, flags=re.MULTILINE)
    return [name for name in re.findall(r"`((?:mmi|viewer|citygen)(?:\.\w+)+)`", rows) if not resolves(name)]


@cache
def resolves(name):
    """Whether a dotted name is a module, or something in one."""
    parts = name.split(".")
    for length in range(len(parts), 0, -1):
        there = ROOT.joinpath(*parts[:length])
        if there.with_suffix(".py").exists() or (there / "__init__.py").exists():
            found = importlib.import_module(".".join(parts[:length]))
            return all((found := getattr(found, part, None)) is not None for part in parts[length:])
    return False


@pytest.mark.parametrize("name", PAGES)
def test_modules_that_pages_name_exist(name):
    assert unknown_names(text_of(name)) == []


def test_every_dependency_is_explained():
    table = text_of("docs/contributing.md").split("## What each dependency is for", 1)[1].lower()
    names = (re.split(r"[<>=\[;]", one)[0].lower() for one in PROJECT["dependencies"])
    assert [name for name in names if {"av": "pyav"}.get(name, name) not in re.split(r"[|,\s()]+", table)] == []


def test_the_floors_are_those_that_hold():
    table = text_of("docs/contributing.md").split("| floor of `mmi`", 1)[1].split("\n\n", 1)[0].splitlines()[2:]
    told = [" ".join(re.findall(r"`(\w+)`", row.split("|")[2])) for row in table]
    assert [set(row.split()) for row in told] == [set(row.split()) for row in FLOORS["mmi"]]


@pytest.mark.parametrize("name", PAGES)
def test_nothing_is_fetched_from_elsewhere(name):
    """Material loads Mermaid from the network where a page has a diagram of it, and a picture may be anywhere."""
    assert "```mermaid" not in text_of(name)
    assert not re.search(r"!\[[^\]]*\]\(https?:|<(img|script|iframe)\b[^>]*https?:", text_of(name))


def test_no_picture_is_left_over():
    told = "".join(text_of(name) for name in PAGES) + (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    left = [path.name for path in (ROOT / "docs" / "pictures").iterdir() if path.name not in told]
    assert left == []


@pytest.mark.parametrize(
    ("check", "page"),
    [
        (strange_options, "    build-impostors CITY -o OUT --no-such-option 3"),
        (strange_options, "Use `compare-impostors OUT --views 3 --max-error 5`."),
        (strange_options, "    build-impostors CITY \\\n        --such"),
        (strange_options, "    python benchmarks/bound.py OUT --max-error 5"),
        (unknown_names, "See `mmi.planning.no_such_module`."),
        (unknown_names, "| `mmi.old` | `mmi.reading.no_such_name` |"),
        (unknown_options, "The option `--no-such-option` does it."),
        (lambda text: BANNED.findall(prose_of(text)), "It is thus a `thing`."),
        (
            lambda text: [why for why in (broken("README.md", one) for one in LINK.findall(text)) if why],
            "[a](docs/no.md)",
        ),
        (
            lambda text: [why for why in (broken("README.md", one) for one in LINK.findall(text)) if why],
            "![a](docs/no.png)",
        ),
    ],
)
def test_the_checks_notice(check, page):
    assert list(check(page))


@pytest.mark.parametrize(
    ("check", "page"),
    [
        (strange_options, "    build-impostors CITY -o OUT --max-error 5   # and then --anything"),
        (strange_options, "    scripts/test --slow"),
        (unknown_names, "| `mmi.old` | `mmi.reading.read_city.read_city` |"),
        (lambda text: BANNED.findall(prose_of(text)), "Run `apt-get`, or\n\n    apt install\n\n```\nthus\n```\n"),
    ],
)
def test_the_checks_let_pass(check, page):
    assert not list(check(page))


def test_the_table_of_readers_names_every_format_that_is_read():
    """In its first two columns, by the suffix or, where the contents tell, by the name."""
    section = PAGES["docs/cities.md"].read_text(encoding="utf-8").partition("## What each reader understands")[2]
    rows = [line.split(" | ") for line in section.partition("\n## ")[0].splitlines() if line.startswith("| ")]
    told = " ".join(cell for row in rows for cell in row[:2])
    suffixes = {*MESH_SUFFIXES, *GDAL_SUFFIXES, *(suffix for suffix, _ in RASTERS), ".osm", ".pbf", ".csv", ".net.xml"}
    names = [
        *VECTOR_FORMATS.split(", "),
        "OpenStreetMap",
        "CityJSON",
        "CityGML",
        "SUMO",
        "walks",
        "what moves",
        "datasets",
    ]
    assert [one for one in (*(f"`{suffix}`" for suffix in sorted(suffixes)), *names) if one not in told] == []
    assert {len(row) for row in rows} == {5}
