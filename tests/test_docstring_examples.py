"""The examples in docstrings give what they say: doctest on every module of Asterism that holds one."""

from __future__ import annotations

import doctest
import importlib
from pathlib import Path

import pytest

import asterism

ROOT = Path(asterism.__file__).parent
MODULES = sorted(
    ".".join(["asterism", *path.relative_to(ROOT).with_suffix("").parts])
    for path in ROOT.rglob("*.py")
    if ">>> " in path.read_text(encoding="utf-8")
)
FLAGS = doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS


@pytest.mark.parametrize("name", MODULES)
def test_the_examples_of_a_module_run(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)  # an example may write files by their bare names
    module = importlib.import_module(name.removesuffix(".__init__"))
    said: list[str] = []
    runner = doctest.DocTestRunner(optionflags=FLAGS)
    for test in doctest.DocTestFinder(exclude_empty=True).find(module):
        runner.run(test, out=said.append)
    assert runner.tries, f"{name} holds >>> outside of the docstrings that doctest finds"
    assert not runner.failures, "".join(said)
