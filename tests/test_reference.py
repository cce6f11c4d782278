"""The API reference and what the package exports say the same, and the other pages use nothing but exported names."""

from __future__ import annotations

import ast
import importlib
import importlib.util
import inspect
import re
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from types import ModuleType

import pytest

import asterism

ROOT = Path(__file__).parent.parent
WRITTEN_BY_HAND = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")), *sorted((ROOT / "docs" / "gallery").glob("*.*"))]


def _generator() -> ModuleType:
    spec = importlib.util.spec_from_file_location("make_reference", ROOT / "docs" / "make_reference.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules["make_reference"] = module
    spec.loader.exec_module(module)
    return module


reference = _generator()
MODULES = reference.public_modules()
pages = cache(reference.pages)


def test_the_committed_pages_are_those_of_the_code_as_it_is() -> None:
    committed = {path.name: path.read_text(encoding="utf-8") for path in (ROOT / "docs" / "reference").glob("*.md")}
    made = pages()
    stale = sorted(name for name in {*committed, *made} if committed.get(name) != made.get(name))
    assert not stale, f"run `python docs/make_reference.py`; these pages are not up to date: {stale}"


@pytest.mark.parametrize("module", MODULES)
def test_every_exported_name_has_a_place_in_the_reference(module: str) -> None:
    made = pages()
    for name in reference.exports(module):
        heading = f"\n### {reference.heading(module, name)}\n"
        assert heading in made[reference.page_of(module)], f"{module}.{name}"


@pytest.mark.parametrize("module", MODULES)
def test_every_exported_name_exists_and_explains_itself(module: str) -> None:
    loaded = importlib.import_module(module)
    exported = loaded.__all__ if hasattr(loaded, "__all__") else []
    assert len(set(exported)) == len(exported)
    for name in exported:
        thing = getattr(loaded, name)
        if inspect.isclass(thing) or inspect.isroutine(thing):
            text = inspect.getdoc(thing) or ""
            assert text and not text.startswith(f"{name}("), f"{module}.{name} has no docstring of its own"


def test_every_room_exports_what_it_offers() -> None:
    rooms = [module for module in MODULES if module.count(".") == 1]
    assert [room for room in rooms if not hasattr(importlib.import_module(room), "__all__")] == []


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
    private = [f"{module}.{name}" for module, name in _used_names(page) if name not in asterism_exports(module)]
    assert private == [], f"{page.name} uses names that no package exports"


def asterism_exports(module: str) -> set[str]:
    """What may be imported from a module: what it exports, and its public subpackages."""
    below = {name.rpartition(".")[2] for name in MODULES if name.rpartition(".")[0] == module}
    return {*reference.exports(module), *below} if module in MODULES else set()


def test_a_page_that_uses_a_private_name_is_noticed(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("`asterism.formats.read` and\n```python\nfrom asterism.files.text import decoded\n```\n", encoding="utf-8")
    found = list(_used_names(page))
    assert ("asterism.formats", "read") in found and ("asterism.files.text", "decoded") in found
    assert "decoded" not in asterism_exports("asterism.files.text") and asterism.__all__
