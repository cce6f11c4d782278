"""Asterism in the shell and at the Python prompt: completion, hints, progress in a pipe, interruption, rooms that come when named."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from asterism import formats
from asterism.cli import _console
from asterism.errors import AsterismError
from asterism.files.toml import read_toml, tables_of_toml
from asterism.recording import MarkerSet, Recording
from asterism.skeleton.body_file import load_body


def python(*words: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, *words], capture_output=True, text=True, env={**os.environ, **environment}, timeout=120)


def test_rooms_are_there_after_import_asterism() -> None:
    done = python(
        "-c", "import asterism; print(callable(asterism.labelling.audit), 'labelling' in dir(asterism), asterism.report.__name__)"
    )
    assert done.stdout.split() == ["True", "True", "asterism.report"], done.stderr
    assert "has no attribute 'labeling'" in python("-c", "import asterism; asterism.labeling").stderr


def test_import_asterism_alone_imports_no_room() -> None:
    done = python("-c", "import sys, asterism; dir(asterism); print([name for name in sys.modules if name.startswith('asterism.')])")
    assert done.stdout.strip() == "['asterism.errors']", done.stderr


@pytest.mark.parametrize(
    "typed, offered", [("asterism label-v", "label-views"), ("asterism label --known-l", "--known-labels"), ("asterism rig pl", "plan")]
)
def test_the_shell_completes_commands_and_options(typed: str, offered: str) -> None:
    done = python("-m", "asterism", _ASTERISM_COMPLETE="complete_bash", COMP_WORDS=typed, COMP_CWORD=str(len(typed.split()) - 1))
    assert done.stdout.split() == [offered], done.stderr


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_script_for_the_shell_is_printed(shell: str) -> None:
    done = python("-m", "asterism", _ASTERISM_COMPLETE=f"source_{shell}")
    assert f"_ASTERISM_COMPLETE=complete_{shell}" in done.stdout


def test_an_interruption_while_importing_leaves_no_traceback(tmp_path: Path) -> None:
    (tmp_path / "sitecustomize.py").write_text(
        "import sys\n"
        "class Interrupted:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name == 'typer': raise KeyboardInterrupt\n"
        "sys.meta_path.insert(0, Interrupted())\n",
        encoding="utf-8",
    )
    path = os.pathsep.join([str(tmp_path), *filter(None, [os.environ.get("PYTHONPATH")])])
    done = python("-m", "asterism", "label", "--help", PYTHONPATH=path)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "asterism: interrupted; nothing was begun.\n")


def test_progress_in_a_pipe_is_a_line_each_minute(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    clock = iter([0.0, 10.0, 61.0, 62.0, 130.0])
    monkeypatch.setattr("time.monotonic", lambda: next(clock))
    with _console.progress("labelling") as progress:
        assert progress is not None
        for fraction, doing in ((0.1, "a.c3d"), (0.5, "b.c3d"), (0.51, "b.c3d"), (1.0, "")):
            progress(fraction, doing)
    shown = capsys.readouterr()
    assert shown.err == "labelling: 50 %, b.c3d\nlabelling: 100 %\n" and shown.out == ""


@pytest.mark.parametrize("first", ["", "sep=;\n", '"sep=;"\r\n', "\ufeffsep=;\r\n"])
def test_what_european_excel_writes_is_read(first: str, tmp_path: Path) -> None:
    path = tmp_path / "walk.csv"
    path.write_bytes((first + "Frame;Time;LKNE_x;LKNE_y;LKNE_z\n1;0,00;0,1;0,2;0,3\n2;0,01;0,1;0,2;1,3\n").encode())
    recording = formats.read(path, vertical="z")
    assert recording.rate == 100 and recording.positions[:, 0].tolist() == [[0.1, 0.2, 0.3], [0.1, 0.2, 1.3]]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="a device that is always full")
@pytest.mark.parametrize(
    ("lead", "words", "status", "said"),
    [
        ("> /dev/full", "--version", 2, "standard output cannot be written (No space left on device)"),
        (">&-", "--version", 0, ""),
        ("2>&- >&-", "info nosuch.c3d", 2, ""),
        ("2> /dev/full", "info nosuch.c3d", 2, ""),
        (">&-", "info {walk} --json -", 2, "standard output is closed"),
        ("| true", "--help", 1, ""),
    ],
)
def test_an_output_that_is_closed_or_full_is_named(lead: str, words: str, status: int, said: str, tmp_path: Path) -> None:
    walk = tmp_path / "walk.npz"
    formats.write(walk, Recording(np.ones((3, 1, 3)), ("LKNE",), 100.0))
    command = f"{sys.executable} -m asterism {words.format(walk=walk)} {lead}; exit ${{PIPESTATUS[0]}}"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=False)
    assert done.returncode == status and said in done.stderr and "Traceback" not in done.stderr


@pytest.mark.parametrize("text", ["a" + ".a" * 200_000 + " = 1", "[" + "'a' . " * 200_000 + "b]\n", 'x = {"a"' + '."a"' * 200_000 + "=1}"])
def test_a_key_of_many_parts_is_refused_before_it_takes_minutes(text: str, tmp_path: Path) -> None:
    path = tmp_path / "set.toml"
    path.write_text(text)
    for read in (read_toml, MarkerSet.load, load_body):
        with pytest.raises(AsterismError, match=r"set\.toml .*more than 64 parts"):
            read(path)
    assert tables_of_toml("a.b.c = '" + "one. " * 100 + "'\nx = [" + "1.5, " * 100 + "]")["x"][99] == 1.5
