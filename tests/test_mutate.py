"""The tool that puts deliberate faults into a copy of the sources, on a package of a few lines."""

from __future__ import annotations

import ast
import json
import sys
from dataclasses import replace
from pathlib import Path

import pytest

TOOLS = Path(__file__).parents[1] / "tools"
sys.path.append(str(TOOLS))

import mutate  # noqa: E402
from faults import Fault, faults_of, sample  # noqa: E402
from which_tests import Program, Recording  # noqa: E402

SOURCE = '''"""Counts."""

from tiny._jit import kernel

LAST = (4, 5, 6)[2]
MORE = 10


def total(values):
    """The sum of the values from 1 on."""
    return sum(value for value in values if value >= 1)


def is_even(count):
    """Whether a count is even."""
    while count > 1:
        count -= 2
    return count == 0


def untested(value):
    """Nobody calls this."""
    if value > MORE:
        raise ValueError(f"{value} is more than {MORE + 1}")
    return value


@kernel
def doubled(value):
    """Twice the value."""
    return value * 2


def doubled_twice(value):
    """Four times the value."""
    return doubled(doubled(value))
'''

TESTS = """from tiny.counts import doubled_twice, is_even, total


def test_is_even():
    assert is_even(4)


def test_total():
    assert total([3, 1, -2]) == 4


def test_doubled():
    assert doubled_twice(3) == 12
"""


@pytest.fixture
def tiny(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A repository with one package and one file of tests."""
    root = tmp_path / "repository"
    files = {
        "pyproject.toml": "[tool.pytest.ini_options]\n",
        "src/tiny/__init__.py": "",
        "src/tiny/_jit.py": "def kernel(function):\n    return function\n",
        "src/tiny/counts.py": SOURCE,
        "tests/test_counts.py": TESTS,
    }
    for name, text in files.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text, encoding="utf-8")
    for name in ("NUMBA_CACHE_DIR", "ASTERISM_TEST_CACHE"):
        monkeypatch.delenv(name, raising=False)
    return root


def faults_in(text: str) -> set[tuple[str, str]]:
    """What a piece of source is changed to, with the kind."""
    return {(fault.kind, fault.apply(text.encode()).decode()) for fault in faults_of("m.py", text.encode())}


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ("x = a < b", {("comparison", "x = (a <= b)"), ("comparison", "x = (a > b)")}),
        ("x = a + b", {("operator", "x = (a - b)")}),
        ("x = a and b", {("and, or", "x = (a or b)")}),
        ("x = 3", {("constant", "x = (4)"), ("constant", "x = (2)")}),
        ("x = True", {("constant", "x = False")}),
        ("x = -a", {("sign", "x = (a)")}),
        ("x = a if b else c", {("condition", "x = a if (not (b)) else c")}),
        ("x = [a for a in b if c]", {("condition", "x = [a for a in b if (not (c))]")}),
        ("x = max(a, b)", {("opposite", "x = min(a, b)")}),
        ("x = a.any()", {("opposite", "x = a.all()")}),
        ("x = np.sum(a, axis=b)", {("argument", "x = np.sum(a)")}),
        ("def f(a):\n    return a, 'b'", {("return", "def f(a):\n    return ('b', a)")}),
        ("def f(a):\n    return a", {("return", "def f(a):\n    return None")}),
        ("@kernel\ndef f(a):\n    return a", {("return", "@kernel\ndef f(a):\n    return (-(a))")}),
        ("@kernel\ndef f(a):\n    b = not a\n    return b", {("return", "@kernel\ndef f(a):\n    b = not a\n    return (not (b))")}),
        ("for a in b:\n    continue", {("loop", "for a in b:\n    break")}),
        ("é = 'é'; x = -a", {("sign", "é = 'é'; x = (a)")}),
    ],
)
def test_each_kind_of_fault(source: str, expected: set[tuple[str, str]]) -> None:
    """Of changes of one kind in one place there is one, chosen by its name."""
    found = faults_in(source)
    wanted = {kind for kind, _ in expected}
    assert len(found & expected) == 1
    assert {kind for kind, _ in found} <= wanted | {"condition", "constant"}
    for _, text in found:
        ast.parse(text)


@pytest.mark.parametrize(
    "source",
    [
        '"""Text 1 + 1."""',
        "def f(a: Literal[1] = a) -> Tuple[1, 2]: ...",
        "def f():\n    raise ValueError(1 + 1)",
        "x = f'{1 + 1}'",
        "class A:\n    def __repr__(self):\n        return 1 + 1",
        "if TYPE_CHECKING:\n    x = 1",
        "y = Finding('code', 1, a + b)",
        "x = a.strip('1') + 'b'",
        "assert a < b",
        "z = isinstance(a, int | float)",
    ],
)
def test_what_is_left_alone(source: str) -> None:
    assert faults_in(source) == set()


def test_a_sample_is_the_same_again_begins_a_longer_one_and_ignores_code_elsewhere(tiny: Path) -> None:
    short, there = sample(tiny, ["src/tiny"], 3, 5)
    long, _ = sample(tiny, ["src/tiny"], 3, 9)
    assert there > 9
    assert long[:5] == short
    assert sample(tiny, ["src/tiny"], 4, 5)[0] != short
    file = tiny / "src/tiny/counts.py"
    file.write_text(SOURCE.replace("def untested", "def other(value):\n    return value * 3\n\n\ndef untested"), encoding="utf-8")
    moved = sample(tiny, ["src/tiny"], 3, there + 5)[0]
    assert [fault.key for fault in moved if fault.place != "other"][:9] == [fault.key for fault in long]


def fault_of_tiny(place: str, kind: str, after: str) -> Fault:
    """The fault of the tiny package with this text."""
    found = faults_of("src/tiny/counts.py", SOURCE.encode())
    return next(fault for fault in found if (fault.place, fault.kind, fault.after) == (place, kind, after))


@pytest.mark.skipif(sys.platform == "win32", reason="needs symbolic links and process groups")
def test_faults_are_caught_survive_hang_or_are_not_counted(tiny: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    work = tmp_path / "work"
    mutate.record(tiny, work, minutes=10, jobs=1)
    recording = Recording(work / "reached", Program(tiny))
    copy = mutate.Copy(tiny, work / "copy")
    monkeypatch.setattr(mutate, "HANGS", 3.0)
    wanted = {
        ("is_even", "operator", "count += 2"): ("caught", "tests/test_counts.py::test_is_even", "test_is_even"),
        ("total", "condition", "(not (value >= 1))"): ("caught", "tests/test_counts.py::test_total", "test_total"),
        ("doubled", "operator", "(value / 2)"): ("caught", "tests/test_counts.py::test_doubled", "test_doubled"),
        ("untested", "condition", "(not (value > MORE))"): ("survived", "", ""),
    }
    for (place, kind, after), (status, by, reached) in wanted.items():
        fault = fault_of_tiny(place, kind, after)
        tests = recording.can_notice(fault)
        assert [test.name.partition("::")[2] for test in tests] == ([reached] if reached else [])
        outcome = mutate.try_fault(copy, fault, tests, 60.0)
        assert (outcome.status, outcome.by) == (status, by), outcome
    assert (copy.tree / "src/tiny/counts.py").read_text(encoding="utf-8") == SOURCE, "the copy is as it was"


@pytest.mark.skipif(sys.platform == "win32", reason="needs symbolic links and process groups")
def test_a_module_that_cannot_be_imported_is_not_counted_and_results_are_kept(tiny: Path, tmp_path: Path) -> None:
    work, results = tmp_path / "work", tmp_path / "faults.json"
    mutate.record(tiny, work, minutes=10, jobs=1)
    (fault,) = (fault for fault in faults_of("src/tiny/counts.py", SOURCE.encode()) if (fault.place, fault.before) == ("LAST", "2"))
    broken = replace(fault, after="3")
    outcome = mutate.try_fault(mutate.Copy(tiny, work / "copy"), broken, Recording(work / "reached", Program(tiny)).tests, 60.0)
    assert outcome.status == "no import"
    options = mutate.RunOptions(faults=1, seed=0, jobs=1, limit=60.0, minutes=10.0, rooms=("src/tiny",))
    mutate.run(tiny, work, results, options)
    first = json.loads(results.read_text(encoding="utf-8"))
    assert len(first) == 1
    results.write_text(results.read_text(encoding="utf-8").replace('"seconds": ', '"seconds": 9'), encoding="utf-8")
    mutate.run(tiny, work, results, options)
    again = json.loads(results.read_text(encoding="utf-8"))
    assert [entry["seconds"] for entry in again.values()] != [entry["seconds"] for entry in first.values()], (
        "what is known is not tried again"
    )
