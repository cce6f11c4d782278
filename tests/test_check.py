"""`tools/check.py`: one failure fails all, failures are shown when they happen, and Ctrl-C ends everything."""

from __future__ import annotations

import importlib.util
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent

_spec = importlib.util.spec_from_file_location("check", ROOT / "tools" / "check.py")
assert _spec is not None and _spec.loader is not None
check = importlib.util.module_from_spec(_spec)
sys.modules["check"] = check
_spec.loader.exec_module(check)


def test_lint_format_types_and_room_order_are_checked() -> None:
    assert {step.name for step in check.STEPS} >= {"ruff check", "ruff format --check", "mypy", "lint-imports", "site"}


@pytest.mark.parametrize(("tests", "tool", "status"), [(0, 0, 0), (1, 0, 1), (0, 1, 1), (1, 1, 1)])
def test_one_failure_among_the_checks_fails_them_all(
    tests: int, tool: int, status: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The tool that fails is named with its output; pytest's closing line comes last."""
    judge = check.Step("judges", ["-c", f"print('as it is'); raise SystemExit({tool})"])
    monkeypatch.setattr(check, "STEPS", [check.Step("passes", ["-c", ""]), judge])
    monkeypatch.setattr(check, "TESTS", check.Step("pytest", ["-c", f"print('..'); print('9 passed in 1 s'); raise SystemExit({tests})"]))
    assert check.main([]) == status
    shown = capsys.readouterr().out.splitlines()
    assert ".." in shown and shown[-1] == "9 passed in 1 s"
    noticed = {
        any("judges:" in line and "FAILED (exit status 1)" in line for line in shown),
        "as it is" in shown,
        "failed: judges" in shown,
    }
    assert noticed == {tool == 1}
    assert any("pytest: FAILED" in line for line in shown) == (tests == 1)


@pytest.mark.parametrize(("words", "asked"), [([], ["-m", "not slow"]), (["--all", "-k", "label"], ["-k", "label"])])
def test_slow_tests_run_where_all_are_asked_for(
    words: list[str], asked: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(check, "STEPS", [check.Step("passes", ["-c", ""])])
    monkeypatch.setattr(check, "TESTS", check.Step("pytest", ["-c", "import sys; print(sys.argv[1:])"]))
    assert check.main(words) == 0
    assert capsys.readouterr().out.splitlines()[-1] == str(asked)


def test_the_site_is_written_where_all_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    ran = list[check.Step]()
    monkeypatch.setattr(check.Runner, "run", lambda self, step: ran.append(step) or True)
    monkeypatch.setattr(check.Runner, "run_tests", lambda *_: (0, ""))
    for words in ([], ["--all"]):
        assert check.check(check.Runner(), words) == 0
    assert [sorted({"dummy", "html"}.intersection(step.arguments)) for step in ran if step.name == "site"] == [["dummy"], ["html"]]


def test_a_failure_is_shown_when_it_happens_and_once(tmp_path: Path) -> None:
    # Without what all tests of Asterism are given, which takes longer than all else here.
    given = ("kept_virtual_people", "frames_looked_at_once", "parts_of_trainings_kept")
    nothing = "import pytest\n\n" + "".join(f"@pytest.fixture(scope='session')\ndef {one}():\n    return None\n\n" for one in given)
    tests = "def test_wrong():\n    assert 1 + 1 == 3\n\ndef test_right():\n    print('later')\n"
    (tmp_path / "test_two.py").write_text(nothing + tests)
    words = [
        sys.executable,
        "-m",
        "pytest",
        "-p",
        "conftest",
        "-p",
        "no:cacheprovider",
        "-v",
        "-s",
        "--at-once",
        "--rootdir",
        str(tmp_path),
    ]
    environment = {**os.environ, "PYTHONPATH": str(ROOT / "tests")}
    done = subprocess.run([*words, str(tmp_path)], capture_output=True, text=True, env=environment, cwd=tmp_path, timeout=60)
    assert done.returncode == 1
    assert done.stdout.count("E       assert (1 + 1) == 3") == 1
    assert done.stdout.index("assert (1 + 1) == 3") < done.stdout.index("later")


_SLEEPER = """
import importlib.util, sys
spec = importlib.util.spec_from_file_location("check", {source!r})
check = sys.modules["check"] = importlib.util.module_from_spec(spec)
spec.loader.exec_module(check)
sleeps = "import subprocess, sys, time; subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(60)']); "
sleeps += "print('asleep', flush=True); print('', flush=True); print('x', flush=True); time.sleep(60)"
check.STEPS = [check.Step("sleeps", ["-c", sleeps])]
check.TESTS = check.Step("pytest", ["-c", sleeps])
sys.exit(check.main([]))
"""


@pytest.mark.skipif(os.name != "posix", reason="Windows sends Ctrl-C to a console, not to a process")
def test_ctrl_c_ends_every_step_without_a_traceback() -> None:
    """The steps' own children too: their end of the pipe closes, so that reading it comes to an end."""
    words = [sys.executable, "-c", _SLEEPER.format(source=str(ROOT / "tools" / "check.py"))]
    with subprocess.Popen(
        words,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # a background job starts with SIGINT ignored
    ) as process:
        assert process.stdout is not None
        for line in process.stdout:
            if "asleep" in line:
                break
        process.send_signal(signal.SIGINT)
        rest, errors = process.communicate(timeout=30)
    assert process.returncode == 130 and errors == ""
    assert rest.rstrip().endswith("stopped")
