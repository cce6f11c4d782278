"""What tests reach, and a fault, in; the tests that can notice it, nearest first, out.

A recording of the calls does not see compiled kernels. A test reaches a kernel if it reaches a function, of the package or of the tests,
that names the kernel or a kernel that calls it.
"""

from __future__ import annotations

import ast
import json
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from faults import Fault, is_kernel

TRAINED, FITTED = "tests/models.py:trained", "src/asterism/labelling/marker_model.py:MarkerModel.fit"
"""A test that takes a kept model reaches all that fitting one reaches: with a fault in it the model is fitted anew."""


@dataclass(frozen=True)
class Function:
    """A top-level function or method: the names in it, whether it is compiled, and whether its results are kept."""

    module: str
    name: str
    names: frozenset[str]
    compiled: bool
    kept: bool

    @property
    def key(self) -> str:
        """`path:name`, as recordings have it."""
        return f"{self.module}:{self.name}"


class Program:
    """The functions of the sources and of the tests, and which of them name which."""

    def __init__(self, root: Path) -> None:
        self.functions: list[Function] = []
        self.imports: dict[str, set[str]] = {}
        files = sorted([*(root / "src").rglob("*.py"), *(root / "tests").glob("*.py")])
        for file in files:
            module, tree = file.relative_to(root).as_posix(), ast.parse(file.read_bytes())
            self.imports[module] = set(_imported(tree))
            self.functions += _functions(module, tree)

    @cached_property
    def naming(self) -> dict[str, list[Function]]:
        """The functions that have a name in them, by the name."""
        found = defaultdict(list)
        for function in self.functions:
            for name in function.names:
                found[name].append(function)
        return found

    def callers(self, module: str, name: str, is_field: bool) -> Iterator[tuple[str, int]]:
        """Keys of the functions in Python that name something of a module, through kernels that name it, and through how many.

        A field is read by modules that do not import its class.
        """
        waiting, seen = [(module, name, 0)], {(module, name)}
        for module, name, far in waiting:
            stem = Path(module).stem
            for function in self.naming.get(name, ()):
                imported = {stem, name} & self.imports[function.module]
                if not (function.module == module or imported or (is_field and far == 0)):
                    continue
                if not function.compiled:
                    yield function.key, far
                elif (function.module, function.name) not in seen:
                    seen.add((function.module, function.name))
                    waiting.append((function.module, function.name, far + 1))

    def nearest_functions(self, fault: Fault) -> dict[str, int]:
        """Functions that a recording can see and that come to the fault, with the steps between; else all of its module."""
        own = next((function for function in self.functions if function.key == f"{fault.path}:{fault.place}"), None)
        if own is not None and not own.compiled:
            return {own.key: 0}
        name = fault.place.rpartition(".")[2] if own is None else own.name
        found: dict[str, int] = {}
        for key, far in self.callers(fault.path, name, own is None and "." in fault.place):
            found.setdefault(key, far)
        return found or {function.key: 0 for function in self.functions if function.module == fault.path and own is None}

    @cached_property
    def kept(self) -> frozenset[str]:
        """Functions whose result is kept, so that the second test that calls them does not run them."""
        return frozenset(function.key for function in self.functions if function.kept)


def _imported(tree: ast.Module) -> Iterator[str]:
    """The names that a file imports, and the parts of the names of modules."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (part for alias in node.names for part in alias.name.split("."))
        elif isinstance(node, ast.ImportFrom):
            yield from (node.module or "").split(".")
            yield from (alias.name for alias in node.names)


def _functions(module: str, tree: ast.Module) -> Iterator[Function]:
    renamed = {
        alias.asname: alias.name for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) for alias in node.names if alias.asname
    }
    for statement in tree.body:
        methods = statement.body if isinstance(statement, ast.ClassDef) else []
        prefix = f"{statement.name}." if isinstance(statement, ast.ClassDef) else ""
        for node in (statement, *methods):
            if isinstance(node, ast.FunctionDef):
                names = {part.id for part in ast.walk(node) if isinstance(part, ast.Name)}
                names |= {part.attr for part in ast.walk(node) if isinstance(part, ast.Attribute)}
                names |= {renamed[name] for name in names if name in renamed}
                marks = {ast.unparse(mark).partition("(")[0].rpartition(".")[2] for mark in node.decorator_list}
                yield Function(module, prefix + node.name, frozenset(names), is_kernel(node), bool(marks & {"cache", "lru_cache"}))


@dataclass(frozen=True)
class Test:
    """A recorded test: its file, how long it took (s), and the keys of the functions that it reached."""

    __test__ = False

    name: str
    file: str
    seconds: float
    reached: frozenset[str]


class Recording:
    """What all tests reach, from the files that `reached.py` wrote."""

    def __init__(self, folder: Path, program: Program) -> None:
        self.program = program
        self.tests: list[Test] = []
        self.shared: dict[str, frozenset[str]] = {}
        for file in sorted(folder.glob("*.json")):
            content = json.loads(file.read_text(encoding="utf-8"))
            functions = content["functions"]
            shared = {functions[number] for number in content["set_up"]}
            for name, entry in content["tests"].items():
                reached = frozenset(functions[number] for number in entry["reached"])
                self.tests.append(Test(name, name.partition("::")[0], entry["seconds"], reached))
                if reached & program.kept:
                    shared |= reached
            self.shared[f"tests/{file.stem}.py"] = frozenset(shared)

    @cached_property
    def by_fitting(self) -> frozenset[str]:
        """Functions that a test of training reaches."""
        return frozenset().union(*(test.reached for test in self.tests if FITTED in test.reached))

    def can_notice(self, fault: Fault) -> list[Test]:
        """The tests that can notice a fault.

        First those that reach it, then those whose fixtures, or what other tests of their file have kept, reach it, at last those that take
        a model whose training reaches it. In each of these parts: files that name the kernel before others, then those that import from the
        module or near it, then short ones.
        """
        near = self.program.nearest_functions(fault)
        parts = {part.strip("_").removesuffix("_kernels") for part in Path(fault.path).with_suffix("").parts}
        ranked: dict[tuple[int, str], list[Test]] = defaultdict(list)
        steps: dict[tuple[int, str], int] = {}
        for test in self.tests:
            for part, reached in enumerate((test.reached, self.shared[test.file], self.by_fitting if TRAINED in test.reached else ())):
                found = [2 * far + key.startswith("src/") for key, far in near.items() if key in reached]
                if found:
                    group = part, test.file
                    ranked[group].append(test)
                    steps[group] = min(steps.get(group, found[0]), *found)
                    break

        def place(group: tuple[int, str]) -> tuple[int, int, int, float]:
            part, file = group
            imported = {name.strip("_").removesuffix("_kernels") for name in self.program.imports.get(file, ())}
            return part, steps[group], -len(parts & imported), sum(test.seconds for test in ranked[group])

        return [test for group in sorted(ranked, key=place) for test in sorted(ranked[group], key=lambda test: test.seconds)]
