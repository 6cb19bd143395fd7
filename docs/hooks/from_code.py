"""What the site takes from the project itself, so that nothing is copied: schemas, --help texts, packages, the changelog.

A page asks for a piece with a comment on a line of its own:

    <!-- schema mmi/dataset/schemas/manifest.json -->     the fields of a JSON Schema, as tables
    <!-- help build-impostors -->                         what a program prints for --help
    <!-- packages mmi -->                                 the packages, each with the first sentence of its docstring
    <!-- names mmi -->                                    the public names, likewise
    <!-- file CHANGELOG.md -->                            another Markdown file of the project, without its title
    <!-- example examples/build_from_python.py -->        a Python file, in a block

A page of the API is made for every package. Roles in docstrings (``:func:`plan_cell```) become links.
"""

from __future__ import annotations

import ast
import contextlib
import importlib
import io
import json
import os
import re
import textwrap
import tomllib
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parents[2]
ROOTS = ("mmi", "viewer", "citygen")
ASKED = re.compile(r"^<!-- (schema|help|packages|names|file|example) (\S+) -->$", re.MULTILINE)
INLINE = re.compile(r"<code>[^<\n]*</code>")
OPTION = re.compile(r"(?<=[>\s])--[a-z][a-z-]*")
ROLE = re.compile(r":(?:func|class|meth|mod|data|attr|exc):<code>~?([\w.]+)</code>")


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """The API's pages join the navigation."""
    api = next(entry["API"] for entry in config.nav or [] if "API" in entry)
    for root in ROOTS:
        api.append({root: [{name: f"api/{name}.md"} for name in _packages(root)]})
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """A page for every package, which mkdocstrings fills."""
    for root in ROOTS:
        for name in _packages(root):
            files.append(File.generated(config, f"api/{name}.md", content=_api_page(name)))
    return files


def on_page_markdown(markdown: str, *, page: Page, config: MkDocsConfig, files: Files) -> str:  # noqa: ARG001
    """What a page asks for stands in the comment's place."""
    makers = {
        "schema": _schema,
        "help": _help,
        "packages": _package_list,
        "names": _name_list,
        "file": _other_file,
        "example": _example,
    }
    return ASKED.sub(lambda found: makers[found[1]](found[2]), markdown)


def on_page_content(html: str, *, page: Page, config: MkDocsConfig, files: Files) -> str:  # noqa: ARG001
    """Sphinx roles become links where their target has a place on the site, and options do not break at their hyphens."""
    homes = {name: f"{module}.{name}" for root in ROOTS for name, module in _public(root).items()}

    def link(found: re.Match[str]) -> str:
        name = homes.get(found[1], found[1])
        return f'<autoref optional identifier="{name}"><code>{name.rsplit(".", 1)[-1]}</code></autoref>'

    def whole(found: re.Match[str]) -> str:
        return OPTION.sub(r'<span class="option">\g<0></span>', found[0])

    return INLINE.sub(whole, ROLE.sub(link, html))


# Packages --------------------------------------------------------------------------------------------------------------


def _packages(root: str) -> list[str]:
    """Dotted names of a root and of all its packages."""
    return [".".join(path.parent.relative_to(ROOT).parts) for path in sorted((ROOT / root).rglob("__init__.py"))]


def _docstring(path: Path) -> str:
    return ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""


def _api_page(name: str) -> str:
    folder = ROOT.joinpath(*name.split("."))
    lines = [f"# {name}", "", f"::: {name}", "    options:"]
    lines += ["      show_root_heading: false", "      show_root_toc_entry: false", ""]
    if name in ROOTS:
        lines.insert(-1, "      members: false")  # its public names stand in a table of api/index.md
    for path in sorted(folder.glob("*.py")):
        if path.stem != "__init__":
            lines += [f"::: {name}.{path.stem}", "    options:", "      heading_level: 2", ""]
    return "\n".join(lines)


def _package_list(root: str) -> str:
    rows = ["| package | what it is for |", "|---|---|"]
    for name in _packages(root):
        sentence = _first_sentence(_docstring(ROOT.joinpath(*name.split("."), "__init__.py")))
        rows.append(f"| [`{name}`]({name}.md) | {sentence} |")
    return "\n".join(rows)


@cache
def _public(root: str) -> dict[str, str]:
    """Public names of a root package, and the module that each comes from, in the order of its imports."""
    tree = ast.parse((ROOT / root / "__init__.py").read_text(encoding="utf-8"))
    lists = [one.value for one in tree.body if isinstance(one, ast.Assign) and ast.unparse(one.targets[0]) == "__all__"]
    listed = set(ast.literal_eval(lists[0])) if lists else set()
    imports = [one for one in ast.walk(tree) if isinstance(one, ast.ImportFrom)]
    return {name.name: one.module or "" for one in imports for name in one.names if name.name in listed}


def _name_list(root: str) -> str:
    rows = ["| name | what it is |", "|---|---|"]
    for name, module in _public(root).items():
        rows.append(f"| [`{name}`][{module}.{name}] | {_first_sentence(_told_of(name, module))} |")
    return "\n".join(rows)


def _told_of(name: str, module: str) -> str:
    """The docstring of a name that a module defines or passes on; an assignment's is the text below it."""
    tree = ast.parse(ROOT.joinpath(*module.split(".")).with_suffix(".py").read_text(encoding="utf-8"))
    for one, after in zip(tree.body, [*tree.body[1:], None], strict=True):
        if isinstance(one, ast.FunctionDef | ast.ClassDef) and one.name == name:
            return ast.get_docstring(one) or ""
        targets = one.targets if isinstance(one, ast.Assign) else [one.target] if isinstance(one, ast.AnnAssign) else []
        if name in map(ast.unparse, targets) and isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant):
            return str(after.value.value)
        if isinstance(one, ast.ImportFrom) and name in (alias.name for alias in one.names):
            return _told_of(name, one.module or "")
    return ""


def _first_sentence(docstring: str) -> str:
    """What fits into a cell of a table."""
    sentence = " ".join(docstring.split("\n\n", 1)[0].split())
    sentence = re.split(r"(?<=[.:]) (?=[A-Z`])", sentence)[0] if len(sentence) > 160 else sentence
    return re.sub(r":\w+:`~?([\w.]+)`", r"`\1`", sentence).replace("``", "`").replace("|", "\\|")


# Programs and files ----------------------------------------------------------------------------------------------------


def _help(program: str) -> str:
    """What ``program --help`` prints, in a block that opens when asked to."""
    scripts = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["scripts"]
    module, _, name = scripts[program].partition(":")
    printed = io.StringIO()
    before = os.environ.get("COLUMNS")
    os.environ["COLUMNS"] = "88"
    try:
        with contextlib.redirect_stdout(printed), contextlib.suppress(SystemExit):
            getattr(importlib.import_module(module), name)(["--help"])
    finally:
        if before is None:
            del os.environ["COLUMNS"]
        else:
            os.environ["COLUMNS"] = before
    block = f"```text\n{printed.getvalue().rstrip()}\n```"
    return f'??? note "All options, as `{program} --help` prints them"\n\n{textwrap.indent(block, "    ")}\n'


def _other_file(name: str) -> str:
    """Another Markdown file, without its title; its links into the documentation lead to pages of the site."""
    return re.sub(r"\A# .*\n", "", (ROOT / name).read_text(encoding="utf-8")).replace("](docs/", "](")


def _example(name: str) -> str:
    return f"```python\n{(ROOT / name).read_text(encoding='utf-8').rstrip()}\n```"


# Schemas ---------------------------------------------------------------------------------------------------------------


def _schema(name: str) -> str:
    """A JSON Schema's description, and a table of its fields; one more table for every definition that has fields."""
    schema = json.loads((ROOT / name).read_text(encoding="utf-8"))
    definitions = {key: one for key, one in schema.get("$defs", {}).items() if "properties" in one}
    pages = [schema.get("description", ""), *_table(schema, schema)]
    for key, one in definitions.items():
        pages += ["", f"## {key} {{: #{key} }}", "", one.get("description", ""), *_table(one, schema)]
    return "\n".join(pages)


def _table(one: Mapping[str, Any], schema: Mapping[str, Any]) -> list[str]:
    rows = [f"| `{path}` | {kind} | {text} |" for path, kind, text in _fields(one, schema, "")]
    return [
        "",
        '<div class="schema" markdown>',
        "",
        "| field | type | what it is |",
        "|---|---|---|",
        *rows,
        "",
        "</div>",
    ]


def _fields(one: Mapping[str, Any], schema: Mapping[str, Any], prefix: str) -> Iterator[tuple[str, str, str]]:
    """Path, type and meaning of every field below ``one``, definitions with fields of their own left to their table."""
    required = set(one.get("required", ()))
    for key, value in one.get("properties", {}).items():
        optional = "" if key in required else " (optional)"
        yield from _field(value, schema, f"{prefix}{key}", optional)
    more = one.get("additionalProperties")
    if isinstance(more, Mapping):
        yield from _field(more, schema, f"{prefix}NAME", "")


def _field(
    value: Mapping[str, Any], schema: Mapping[str, Any], path: str, optional: str
) -> Iterator[tuple[str, str, str]]:
    resolved = _resolved(value, schema)
    text = " ".join(str(value.get("description") or resolved.get("description") or "").split()).replace("|", "\\|")
    yield path, _kind(value, schema) + optional, text
    inner, suffix = value, ""
    while "items" in inner and isinstance(inner["items"], Mapping):
        inner, suffix = inner["items"], suffix + "[]"
    if "$ref" not in inner:
        yield from _fields(inner, schema, f"{path}{suffix}.")


def _resolved(value: Mapping[str, Any], schema: Mapping[str, Any]) -> Mapping[str, Any]:
    reference = value.get("$ref")
    if reference is None:
        return value
    found: Any = schema
    for key in reference.removeprefix("#/").split("/"):
        found = found.get(key, {})  # a definition of another schema: its table is there
    return {**found, **{key: one for key, one in value.items() if key != "$ref"}}


def _kind(value: Mapping[str, Any], schema: Mapping[str, Any]) -> str:
    """A field's type in words."""
    if "$ref" in value:
        name = value["$ref"].rsplit("/", 1)[-1]
        target = _resolved({"$ref": value["$ref"]}, schema)
        if not target:
            return f"[{name}](manifest.md#{name})"
        return f"[{name}](#{name})" if "properties" in target else _kind(target, schema)
    if "const" in value:
        return f"`{json.dumps(value['const'])}`"
    if "enum" in value:
        return "one of " + ", ".join(f"`{one}`" for one in value["enum"])
    if "anyOf" in value or "oneOf" in value:
        return " or ".join(_kind(one, schema) for one in value.get("anyOf", value.get("oneOf", ())))
    kinds = value.get("type", "any")
    kinds = kinds if isinstance(kinds, list) else [kinds]
    words = {"array": _list_kind(value, schema), "object": "object", "null": "null"}
    return " or ".join(str(words.get(kind, kind)) for kind in kinds)


def _list_kind(value: Mapping[str, Any], schema: Mapping[str, Any]) -> str:
    if value.get("prefixItems"):
        return "list (" + ", ".join(_kind(one, schema) for one in value["prefixItems"]) + ")"
    items = value.get("items")
    inner = _kind(items, schema) if isinstance(items, Mapping) else "any"
    count = value.get("minItems") if value.get("minItems") == value.get("maxItems") else None
    return f"list of {count} {inner}s" if count and inner in ("number", "integer") else f"list of {inner}"
