"""What a command says and does in the run that compiles its kernels for the first time."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from asterism.cli import _first_compile
from asterism.progress import on_first_compile, report_first_compile


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[list[str]]]:
    """The steps that second processes were started for."""
    steps: list[list[str]] = []
    monkeypatch.setattr(_first_compile, "_compile_ahead", lambda given: steps.append(list(given)))
    monkeypatch.setattr(_first_compile.os, "cpu_count", lambda: 2)
    yield steps
    on_first_compile(None)


def test_it_is_said_once(started: list[list[str]], capsys: pytest.CaptureFixture[str]) -> None:
    _first_compile.prepare(["label", "walk.c3d"])
    for _ in range(2):
        report_first_compile(lambda: True)
    said = capsys.readouterr()
    assert (
        said.err == "Compiling the numerical kernels of this command; this happens once (up to 50 s of processor time).\n"
        and said.out == ""
    )
    assert started == [["whole"]]


def test_a_cache_that_is_lost_is_no_promise(started: list[list[str]], capsys: pytest.CaptureFixture[str]) -> None:
    _first_compile.prepare(["label", "walk.c3d"])
    report_first_compile(lambda: False)
    said = capsys.readouterr().err
    assert "every run" in said and "NUMBA_CACHE_DIR" in said and "once" not in said and said.count("\n") == 1
    assert started == [], "another process would compile into a folder of its own"


def test_other_commands_start_no_second_process(started: list[list[str]], capsys: pytest.CaptureFixture[str]) -> None:
    _first_compile.prepare(["detect", "video.avi"])
    report_first_compile(lambda: True)
    assert "this happens once" in capsys.readouterr().err
    assert started == []
