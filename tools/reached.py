"""Plugin of pytest for `mutate.py`: records which functions each test reaches, or runs chosen tests in a given order and logs them."""

from __future__ import annotations

import json
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from types import FrameType
from typing import Any

import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    """Three files: what tests reach (written), the tests to run (read), and what happened (written line by line)."""
    parser.addoption("--record-reached", metavar="FILE", type=Path)
    parser.addoption("--chosen-tests", metavar="FILE", type=Path)
    parser.addoption("--log-tests", metavar="FILE", type=Path)


def pytest_configure(config: pytest.Config) -> None:
    """Register the recorder or the log where an option asks for it."""
    record, log = config.getoption("--record-reached"), config.getoption("--log-tests")
    if record is not None:
        config.pluginmanager.register(ReachRecorder(config.rootpath, record), "reach-recorder")
    if log is not None:
        config.pluginmanager.register(TestLog(log), "test-log")


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Keep the chosen tests only, in the order in which they are named."""
    path = config.getoption("--chosen-tests")
    if path is None:
        return
    places = {name: place for place, name in enumerate(json.loads(path.read_text(encoding="utf-8")))}
    config.hook.pytest_deselected(items=[item for item in items if item.nodeid not in places])
    items[:] = sorted((item for item in items if item.nodeid in places), key=lambda item: places[item.nodeid])


def function_key(file: str, name: str, root: str) -> str | None:
    """`src/package/file.py:Class.method` of a function under `root`, an inner function under its outermost one; None for another's code."""
    if not file.startswith(root):
        return None
    path = file[len(root) :].replace("\\", "/")
    return f"{path}:{name.partition('.<locals>')[0]}"


class ReachRecorder:
    """Writes, for the tests that passed, the functions of the sources and of the tests that each one called; kernels are not seen."""

    def __init__(self, root: Path, path: Path) -> None:
        self.root, self.path = f"{root}/", path
        self.called: set[tuple[str, str]] = set()
        self.tests: dict[str, dict[str, Any]] = {}
        self.set_up: set[str] = set()

    def _trace(self, frame: FrameType, event: str, _: Any) -> None:
        self.called.add((frame.f_code.co_filename, frame.f_code.co_qualname))

    def _take(self) -> set[str]:
        called, self.called = self.called, set()
        found = {function_key(file, name, self.root) for file, name in called}
        return {key for key in found if key is not None}

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        """Trace the calls of one test; what its fixtures reach counts for all tests of the file."""
        self.tests[item.nodeid] = {"seconds": 0.0, "passed": True, "reached": []}
        began = time.perf_counter()
        threading.settrace(self._trace)
        sys.settrace(self._trace)
        try:
            return (yield)
        finally:
            sys.settrace(None)
            threading.settrace(None)  # type: ignore[arg-type]
            entry = self.tests[item.nodeid]
            entry["reached"] = sorted({*entry["reached"], *self._take()})
            entry["seconds"] = round(time.perf_counter() - began, 3)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_setup(self, item: pytest.Item) -> Iterator[None]:
        """Keep apart what the fixtures reach."""
        try:
            return (yield)
        finally:
            found = self._take()
            self.set_up |= found
            self.tests[item.nodeid]["reached"] = sorted(found)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Note what did not pass."""
        if not report.passed:
            self.tests[report.nodeid]["passed"] = False

    def pytest_sessionfinish(self) -> None:
        """Write tests that passed, functions as numbers."""
        tests = {name: entry for name, entry in self.tests.items() if entry["passed"]}
        functions = sorted(self.set_up.union(*(entry["reached"] for entry in tests.values())))
        number = {key: place for place, key in enumerate(functions)}
        content = {
            "functions": functions,
            "set_up": sorted(number[key] for key in self.set_up),
            "tests": {
                name: {"seconds": entry["seconds"], "reached": [number[key] for key in entry["reached"]]} for name, entry in tests.items()
            },
        }
        self.path.write_text(json.dumps(content), encoding="utf-8")


class TestLog:
    """Writes a line when a test begins and when it fails, so that whoever stops the run knows where it was."""

    __test__ = False

    def __init__(self, path: Path) -> None:
        self.file = path.open("a", encoding="utf-8")

    def _write(self, **entry: str | float) -> None:
        self.file.write(json.dumps(entry) + "\n")
        self.file.flush()

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        """A test begins."""
        self._write(began=nodeid, at=time.time())

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """A test failed."""
        if report.failed:
            self._write(failed=report.nodeid, why=str(report.longrepr)[-2000:])
