"""The shape of the source, read from its syntax trees: no file imports in a circle, no string hides an import, one class per name."""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Collection, Iterator
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

from parsing import uncollected

import asterism

PACKAGE = Path(asterism.__file__).parent


@cache
@uncollected()
def nodes() -> dict[str, list[ast.AST]]:
    """The imports, calls and classes of each file by its module's name: read by the first test, not by each process that collects tests."""
    found: dict[str, list[ast.AST]] = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = ("asterism", *path.relative_to(PACKAGE).with_suffix("").parts)
        name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
        tree = ast.parse(path.read_text(encoding="utf-8"))
        found[name] = [node for node in ast.walk(tree) if isinstance(node, ast.Import | ast.ImportFrom | ast.Call | ast.ClassDef)]
    return found


def imported(of_file: list[ast.AST], known: Collection[str]) -> Iterator[str]:
    """The files that a file imports anywhere: at its top, in a function, or for its types only."""
    for node in of_file:
        if isinstance(node, ast.ImportFrom) and node.module and not node.level:
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                yield from {inner if inner in known else node.module}.intersection(known)
        elif isinstance(node, ast.Import):
            yield from {alias.name for alias in node.names}.intersection(known)


def circle(files: dict[str, list[ast.AST]]) -> list[str]:
    """Files that import each other in a circle; none where there is no circle."""
    graph = {name: set(imported(own, files)) - {name} for name, own in files.items()}
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as problem:
        return list(problem.args[1])
    return []


def test_no_file_imports_in_a_circle() -> None:
    assert circle(nodes()) == []


def test_a_circle_behind_a_type_is_noticed() -> None:
    one = ast.parse("from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from asterism.b import B")
    two = ast.parse("def f():\n    from asterism import a")
    assert set(circle({"asterism.a": list(ast.walk(one)), "asterism.b": list(ast.walk(two))})) == {"asterism.a", "asterism.b"}


def test_no_string_hides_an_import() -> None:
    """Only the front door and the command line load rooms by their names; no other file takes from the front door what it loads so."""
    loading = {
        name
        for name, of_file in nodes().items()
        for node in of_file
        if isinstance(node, ast.Call) and ast.unparse(node.func).split(".")[-1] in ("import_module", "__import__")
        if not ast.unparse(node.args[0]).startswith(("f'{__name__}.", "f'{__package__}."))
    }
    assert loading == {"asterism", "asterism.cli"}
    through_the_door = {
        f"{name}: {alias.name}"
        for name, of_file in nodes().items()
        for node in of_file
        if isinstance(node, ast.ImportFrom) and node.module == "asterism"
        for alias in node.names
        if f"asterism.{alias.name}" not in nodes() and alias.name != "__version__"
    }
    assert through_the_door == set()


def test_a_class_name_means_one_thing() -> None:
    places = defaultdict(list)
    for name, of_file in nodes().items():
        for node in of_file:
            if isinstance(node, ast.ClassDef):
                places[node.name.lstrip("_")].append(name)
    assert {name: where for name, where in places.items() if len(where) > 1} == {}
    assert "Recording" in places, "the measure works"
