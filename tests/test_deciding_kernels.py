"""The table of deciding kernels names kernels that exist, and tests that exist and call them."""

from __future__ import annotations

import ast
from importlib import import_module
from pathlib import Path

import pytest
from deciding_kernels import CHECKED_BY

TESTS = Path(__file__).parent


@pytest.mark.parametrize("kernel", CHECKED_BY)
def test_a_deciding_kernel_is_a_kernel(kernel: str) -> None:
    module, _, name = kernel.rpartition(".")
    assert hasattr(getattr(import_module(module), name), "py_func"), f"{kernel} is not compiled"


@pytest.mark.parametrize(("kernel", "test"), [(kernel, test) for kernel, test in CHECKED_BY.items() if test])
def test_the_check_of_a_deciding_kernel_exists_and_calls_it(kernel: str, test: str) -> None:
    place, _, through = test.partition(" via ")
    file, _, name = place.partition("::")
    tree = ast.parse((TESTS / file).read_text(encoding="utf-8"))
    functions = {node.name: node for node in tree.body if isinstance(node, ast.FunctionDef)}
    assert name in functions, f"{file} has no test {name}"
    called = through or kernel.rpartition(".")[2]
    reached, waiting = set(), [name]
    while waiting:
        nodes = list(ast.walk(functions[waiting.pop()]))
        words = {node.id for node in nodes if isinstance(node, ast.Name)} | {node.attr for node in nodes if isinstance(node, ast.Attribute)}
        waiting += [word for word in words & set(functions) if word not in reached]
        reached |= words
    assert called in reached, f"{test} does not call {called}"
