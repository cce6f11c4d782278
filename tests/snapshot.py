"""Whole outputs of the commands, as a user sees them: wording is reviewed like code.

A case is a few command lines; `snapshots/NAME.txt` holds what they print and their exit status. After a change of wording:
`pytest tests/test_snapshots_labelling.py tests/test_snapshots_cameras.py --record-snapshots`, then read the difference with
`git diff tests/snapshots`.
What differs from run to run or from machine to machine is replaced by a word in capitals: seconds, speeds, versions, folders.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Sequence
from pathlib import Path

import pytest

import asterism
from asterism.cli import main

ROOT = Path(__file__).parents[1]
SNAPSHOTS = ROOT / "tests" / "snapshots"
RECORD = "pytest tests/test_snapshots_labelling.py tests/test_snapshots_cameras.py --record-snapshots"


def stable(text: str, folder: Path) -> str:
    """The same text on every machine and in every run."""
    text = text.replace(str(folder), "FOLDER").replace(str(ROOT), "ROOT").replace(asterism.__version__, "VERSION")
    text = re.sub(r"(?<=, )\d[\d.,]* frames/s(?=$|[,;])", "SPEED frames/s", text, flags=re.MULTILINE)
    text = re.sub(r"(?<=[%)]) +[\d,]+(?= +[\d,]+$)|(?<=\)) +[\d,]+$", lambda speed: f"{'SPEED':>{len(speed[0])}}", text, flags=re.MULTILINE)
    text = re.sub(r"\bin \d[\d.,]* s\b", "in SECONDS s", text)
    text = re.sub(r'("(?:seconds|frames_per_second)": )[\d.e+-]+', r"\1SECONDS", text)
    # Machines differ in the last digits of what no command rounds: JSON.
    return re.sub(r"-?\d+\.\d{5,}(?:e[+-]\d+)?", lambda number: f"{float(number[0]):.3g}", text)


def output(lines: Sequence[str], folder: Path, capsys: pytest.CaptureFixture[str]) -> str:
    """What the command lines print, one after the other, run in the folder, and their exit status."""
    capsys.readouterr()
    written = []
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for line in lines:
            status = main(shlex.split(line))
            shown = capsys.readouterr()
            said = re.sub(r"^\w+: \d+ %.*\n", "", shown.err, flags=re.MULTILINE)  # the progress, a line each minute
            errors = f"[standard error]\n{said}" if said else ""
            written.append(f"$ asterism {line}\n{shown.out}{errors}[exit status {status}]\n")
    return stable("".join(f"{line.rstrip()}\n" for line in "\n".join(written).splitlines()), folder)


def compare(name: str, text: str, record: bool) -> None:
    """Compare with the snapshot; or record it."""
    path = SNAPSHOTS / f"{name}.txt"
    if record:
        SNAPSHOTS.mkdir(exist_ok=True)
        path.write_text(text, encoding="utf-8", newline="\n")
    assert path.is_file(), f"no snapshot of {name}: {RECORD}"
    assert text == path.read_text(encoding="utf-8"), f"if the new words are better: {RECORD}"
