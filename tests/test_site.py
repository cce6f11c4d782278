"""The site's reference holds every public name, its docstrings become text as they are meant, and pages use public names only.

`python tools/check.py` builds the site itself, strictly.
"""

from __future__ import annotations

import ast
import importlib
import inspect
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import asterism

ROOT = Path(__file__).parent.parent
WRITTEN_BY_HAND = sorted(
    {ROOT / "README.md", *(ROOT / "docs").glob("*.md"), *(ROOT / "docs" / "gallery").glob("*.*")} - {ROOT / "docs" / "index.md"}
)

sys.path.insert(0, str(ROOT / "docs" / "_site"))
import contents  # noqa: E402
import docstrings  # noqa: E402
import public_names  # noqa: E402

MODULES = public_names.public_modules()


@pytest.mark.parametrize("module", MODULES)
def test_every_exported_name_has_a_place_in_the_reference(module: str) -> None:
    room = ".".join(module.split(".")[:2])
    page = "\n".join(contents._page(room)) if public_names.modules_of(room) else ""
    for name in public_names.exports(module):
        home = public_names.homes()[module, name]
        line = (
            rf"^\.\. auto(class|exception|function|data):: {re.escape(module)}\.{name}$"
            if home == module
            else rf"`~{re.escape(home)}\.{name}`"
        )
        assert re.search(line, page, re.MULTILINE), f"{module}.{name}"


@pytest.mark.parametrize("module", MODULES)
def test_every_exported_name_exists_and_explains_itself(module: str) -> None:
    loaded = importlib.import_module(module)
    exported = getattr(loaded, "__all__", [])
    assert len(set(exported)) == len(exported)
    for name in exported:
        thing = getattr(loaded, name)
        if inspect.isclass(thing) or inspect.isroutine(thing):
            text = inspect.getdoc(thing) or ""
            assert text and not text.startswith(f"{name}("), f"{module}.{name} has no docstring of its own"
        elif public_names.homes()[module, name] == module:
            assert docstrings._constant_docstring(f"{module}.{name}"), f"{module}.{name} has no string below it"


def test_every_room_exports_what_it_offers() -> None:
    rooms = [module for module in MODULES if module.count(".") == 1]
    assert [room for room in rooms if not hasattr(importlib.import_module(room), "__all__")] == []


def test_every_page_is_in_the_table_of_contents() -> None:
    listed = {name for pages in contents.GUIDE.values() for name in pages} | {"index"}
    written = {
        page.relative_to(ROOT / "docs").with_suffix("").as_posix()
        for page in WRITTEN_BY_HAND
        if page.suffix == ".md" and page.parent != ROOT
    }
    assert written == {page for page in listed if page not in contents.BESIDE_DOCS.values()}


def test_a_docstring_becomes_text_code_lists_and_examples() -> None:
    text = """Points (N, 3) m, *not* markup_, of `fit_rigid`s and `x`.

    name     what it is,
             and more
    a, b     two
    longname with one blank

    Text after.

        as it is

    >>> 1 + 1
    2
    """
    assert docstrings.as_rst(inspect.cleandoc(text)).split("\n\n") == [
        r"Points (N, 3) m, \*not\* markup\_, of :py:obj:`~asterism.geometry.fit_rigid`\ s and ``x``.",
        "- ``name``: what it is,\n  and more",
        "- ``a``, ``b``: two",
        "- ``longname``: with one blank",
        "Text after.",
        "::",
        "    as it is",
        ">>> 1 + 1\n2",
    ]


def test_signatures_show_no_placeholders_long_values_and_private_fields() -> None:
    written = "(a: TypeAliasForwardRef('Floats') | None, b: dict[str, int] = <factory>, c: Rules = Rules(x=(1, 2), y=3), _d: int = 0)"
    assert docstrings._plain(written) == "(a: Floats | None, b: dict[str, int] = ..., c: Rules = Rules(...))"


def _used_names(page: Path) -> Iterator[tuple[str, str]]:
    """The (module, name) pairs that a page's Python imports, and those that its text writes out as `asterism.room.name`."""
    text = page.read_text(encoding="utf-8")
    python = [text] if page.suffix == ".py" else re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    for block in python:
        for node in ast.walk(ast.parse(block)):
            if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] == "asterism":
                yield from ((node.module, alias.name) for alias in node.names)
    for dotted in re.findall(r"(?<![\w/.-])asterism((?:\.[A-Za-z_]\w*)+)", text):
        parts = ["asterism", *dotted[1:].split(".")]
        depth = max(n for n in range(1, len(parts) + 1) if ".".join(parts[:n]) in MODULES)
        if depth < len(parts):
            yield ".".join(parts[:depth]), parts[depth]


OF_THE_SOURCES = ("thesis.md",)
"""Pages about where something is in the code; `test_thesis_page.py` checks their names."""


@pytest.mark.parametrize("page", [page for page in WRITTEN_BY_HAND if page.name not in OF_THE_SOURCES], ids=lambda page: page.name)
def test_pages_and_gallery_use_exported_names_only(page: Path) -> None:
    if page.suffix not in (".md", ".py"):
        pytest.skip("a picture")
    private = [f"{module}.{name}" for module, name in _used_names(page) if name not in _importable(module)]
    assert private == [], f"{page.name} uses names that no package exports"


def _importable(module: str) -> set[str]:
    """What may be imported from a module: what it exports, and its public subpackages."""
    below = {name.rpartition(".")[2] for name in MODULES if name.rpartition(".")[0] == module}
    return {*public_names.exports(module), *below} if module in MODULES else set()


def test_a_page_that_uses_a_private_name_is_noticed(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("`asterism.formats.read` and\n```python\nfrom asterism.formats._tables import rate_of\n```\n", encoding="utf-8")
    found = list(_used_names(page))
    assert ("asterism.formats", "read") in found and ("asterism.formats._tables", "rate_of") in found
    assert "rate_of" not in _importable("asterism.formats._tables") and asterism.__all__
