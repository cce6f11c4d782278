"""What every kernel's source must hold to: one decorator, a card, one place of the compiler's flags."""

from __future__ import annotations

import ast
import re
import tomllib
from functools import cache
from pathlib import Path

import asterism

PACKAGE = Path(asterism.__file__).parent
ROOT = Path(__file__).parents[1]


@cache
def trees() -> dict[str, ast.Module]:
    """The modules of the package in whose text kernels or Numba are named, parsed, by their names within it."""
    texts = {path: path.read_text(encoding="utf-8") for path in sorted(PACKAGE.rglob("*.py"))}
    named = {path: text for path, text in texts.items() if "numba" in text or "@kernel" in text}
    return {".".join(path.relative_to(PACKAGE).with_suffix("").parts): ast.parse(text) for path, text in named.items()}


@cache
def kernels() -> dict[str, tuple[ast.FunctionDef, ast.expr]]:
    """All functions decorated with `kernel`, by module.name, with their decorator."""
    found = {}
    for module, tree in trees().items():
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef):
                for decorator in node.decorator_list:
                    name = decorator.func if isinstance(decorator, ast.Call) else decorator
                    if isinstance(name, ast.Name) and name.id == "kernel":
                        found[f"{module}.{node.name}"] = node, decorator
    return found


def test_only_the_decorator_imports_numba() -> None:
    importing = set()
    for module, tree in trees().items():
        for node in ast.walk(tree):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            if any(name.partition(".")[0] == "numba" for name in names):
                importing.add(module.partition(".")[0])
    assert importing == {"_jit"}, "kernels are decorated with asterism._jit.kernel"


def test_kernels_stand_in_files_of_their_own() -> None:
    assert len(kernels()) > 100, "the test looks at what it means to look at"
    assert [name for name in kernels() if not name.split(".")[-2].endswith("_kernels")] == []


def test_every_kernel_that_others_use_has_a_card() -> None:
    lacking = [name for name, (node, _) in kernels().items() if not node.name.startswith("_") and not ast.get_docstring(node)]
    assert lacking == []


def test_cards_say_what_goes_in_and_out_and_what_it_costs() -> None:
    lacking = set()
    for name, (node, _) in kernels().items():
        card = ast.get_docstring(node) or ""
        if not node.name.startswith("_") and not (re.search(r"\b(IN|OUT|Returns|Gives)\b", card) and re.search(r"\bO\(", card)):
            lacking.add(name)
    assert not lacking, "\n".join(["these do not say IN, OUT and O(...):", *sorted(lacking)])


def test_cards_say_why_what_is_counted_has_room() -> None:
    """A kernel that writes where a counter says states the bound of that array, and why it holds."""
    lacking = []
    for name, (node, _) in kernels().items():
        inside = list(ast.walk(node))
        counters = {
            n.target.id for n in inside if isinstance(n, ast.AugAssign) and isinstance(n.op, ast.Add) and isinstance(n.target, ast.Name)
        }
        places = [n.slice for n in inside if isinstance(n, ast.Subscript) and isinstance(n.ctx, ast.Store)]
        counted = any(isinstance(n, ast.Name) and n.id in counters for place in places for n in ast.walk(place))
        if counted and not re.search(r"\bBounds:", ast.get_docstring(node) or ""):
            lacking.append(name)
    assert not lacking, "\n".join(["these do not say Bounds:", *lacking])


def test_lint_asks_for_types_everywhere_but_in_kernels() -> None:
    """Mypy takes functions without types as kernels, so the lint rules must not let others pass."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]
    assert {"ANN001", "ANN201", "ANN202", "ANN204", "ANN205", "ANN206"} <= set(project["ruff"]["lint"]["select"])
    exempt = {pattern for pattern, rules in project["ruff"]["lint"]["per-file-ignores"].items() if "ANN" in rules}
    assert exempt <= {"**/*_kernels.py", "tests/**", "benchmarks/**"}


def test_files_that_call_kernels_have_the_marker() -> None:
    """`python tools/check.py --bounds` runs the files with it, and no others."""
    calling = {}
    for path in Path(__file__).parent.glob("test_*.py"):
        text = path.read_text(encoding="utf-8")
        imports = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.ImportFrom)]
        names = [f"{node.module}.{alias.name}" for node in imports for alias in node.names]
        if any(name.startswith("asterism.") and "_kernels" in name for name in names):
            calling[path.name] = "mark.kernels" in text
    assert len(calling) > 20, "the test looks at what it means to look at"
    assert [name for name, marked in calling.items() if not marked] == []
