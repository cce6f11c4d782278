"""What an earlier run has labelled in a folder: a file of JSON lines, by which a run that was stopped goes on."""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from asterism.files.plain import as_json
from asterism.findings import Finding

NAME = "asterism-label.jsonl"


@dataclass(frozen=True)
class FinishedFile:
    """What an earlier run has said of a file.

    row       its results
    findings  what it reported, so that a run that goes on reports the same
    changed   whether somebody has changed the output since
    """

    row: Mapping[str, Any]
    findings: Sequence[Finding]
    changed: bool


class FinishedFiles:
    """The record in a folder of outputs: for each output what it was made from, how, with which result, and what was found.

    A line is written before an output, and another one after it. A line that was cut off is as if it were not there.
    how: the options, as plain values. inputs: models and other files beside the sources that an output depends on, by their content.
    columns: what a row of results has, without which a line is damaged. name: of the record in the folder.
    """

    def __init__(
        self, folder: Path, how: Mapping[str, Any], inputs: Sequence[Path], columns: Collection[str] = (), name: str = NAME
    ) -> None:
        self.path, self.columns = folder / name, columns
        # other options or models make another output: the record of an earlier run says nothing then
        self.how = hashlib.sha256(json.dumps(as_json(how), sort_keys=True).encode()).hexdigest()
        self.inputs = [_hash(path) for path in inputs]
        self.entries: dict[str, dict[str, Any]] = {}
        self.earlier: dict[str, set[Any]] = {}
        for line in _lines(self.path):
            output = str(line.get("output"))
            # an output that was begun again is not what the earlier line says
            if line.get("event") == "begun":
                self.entries[output] = line
            elif line.get("event") == "written" and output in self.entries:
                self.entries[output] |= line
                self.earlier.setdefault(output, set()).add(line.get("sha256"))

    def finished(self, place: Path, source: Path, target: Path) -> FinishedFile | None:
        """What was said of a file that this version has labelled with the same models and options from the same content; else None."""
        entry = self.entries.get(place.as_posix())
        # the source, the models, the options or the program are others than then
        if entry is None or entry.get("key") != self._key(source):
            return None
        try:
            state, content = _state(target), _hash(target)
            # the run was stopped between the two lines: the output counts where it is another one than before, whatever the clocks say
            if state is None or ("sha256" not in entry and state == entry["before"]):
                return None
            # what somebody corrected by hand stays; the row says that it is no longer what was written
            changed = "sha256" in entry and entry["sha256"] != content
            # the new output did not reach its place
            if changed and content in self.earlier[place.as_posix()]:
                return None
            # both may be named by other paths today
            named = {str(entry["source"]): str(source), str(entry["target"]): str(target)}
            findings = [_renamed(Finding.from_dict(found), named) for found in entry["findings"]]
            row = dict(entry["row"])
            return FinishedFile(row, findings, changed) if row.keys() >= set(self.columns) else None
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            return None

    def made_here(self, place: Path, target: Path) -> bool:
        """Whether an output is what a run has written, from whatever and however, and nobody has changed it since."""
        entry = self.entries.get(place.as_posix())
        return entry is not None and ("sha256" not in entry or _hash(target) in self.earlier[place.as_posix()])

    def begin(self, place: Path, source: Path, target: Path, row: Mapping[str, Any], findings: Sequence[Finding]) -> None:
        """Note that an output is being made, and what is said of it where the run is stopped before `end`."""
        about = {"source": str(source), "target": str(target), "key": self._key(source), "before": _state(target)}
        self._append({"event": "begun", "output": place.as_posix(), **about, **_said(row, findings)})

    def end(self, place: Path, target: Path, row: Mapping[str, Any], findings: Sequence[Finding]) -> None:
        """Note that an output is complete, with its row of results and all that was found."""
        self._append({"event": "written", "output": place.as_posix(), "sha256": _hash(target), **_said(row, findings)})

    def _key(self, source: Path) -> str:
        from asterism import __version__

        return hashlib.sha256(" ".join([__version__, self.how, *self.inputs, _hash(source)]).encode()).hexdigest()

    def _append(self, line: Mapping[str, Any]) -> None:
        """Add a line in one piece, after an end of line where the last one was cut off."""
        text = json.dumps(line, ensure_ascii=True, allow_nan=False) + "\n"
        with self.path.open("ab+") as file:
            # a power cut may have left half a line, which the next one must not be joined with
            if file.seek(0, os.SEEK_END) and (file.seek(-1, os.SEEK_END), file.read(1))[1] != b"\n":
                text = "\n" + text
            file.write(text.encode())


def _said(row: Mapping[str, Any], findings: Sequence[Finding]) -> dict[str, Any]:
    return {"row": as_json(row), "findings": [finding.to_dict() for finding in findings]}


def _renamed(finding: Finding, named: Mapping[str, str]) -> Finding:
    """A finding under today's names of the files that it names."""
    # the longer name first, and none inside another path: out/walk.c3d holds walk.c3d
    names = "|".join(map(re.escape, sorted(named, key=len, reverse=True)))
    pattern = re.compile(rf"(?<![\w/\\.-])(?:{names})(?![\w-])")

    def today(text: str) -> str:
        return pattern.sub(lambda found: named[found[0]], text)

    return replace(finding, where=today(finding.where), sentence=today(finding.sentence), mend=today(finding.mend))


def _lines(path: Path) -> list[dict[str, Any]]:
    found = []
    try:
        texts = path.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return []
    for text in texts:
        try:
            line = json.loads(text)
        except (ValueError, RecursionError):
            continue
        if isinstance(line, dict):
            found.append(line)
    return found


def _state(path: Path) -> list[int] | None:
    """What tells one state of a file from another; None where there is none. A file that is replaced is another one, also at once."""
    try:
        found = path.stat()
    except OSError:
        return None
    return [found.st_size, found.st_mtime_ns, found.st_ino]


def _hash(path: Path) -> str:
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:
        return "none"
