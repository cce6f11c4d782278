"""Folders of laboratories as they are: how many of their files `asterism label` labels, and whether these are the labels of the files."""

from __future__ import annotations

import io
import json
import tempfile
from collections.abc import Iterator
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from asterism import AsterismError, formats
from asterism.cli import main
from asterism.recording import SURE, MarkerSet
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import folder, gait, people_and_trials
from benchmarks.figures import Figure

TREES = ("gait", "movement", "gait-events")
QUICK_TREES = ("movement/clinical-lower", "movement/optitrack-lower")
WORN = 0.9
"""Share of the model's markers that a file names from which it wears the set. Not tuned."""
RIGHT = 0.99
"""Share of the labels given at 99 % or more that must agree with the file's own names. Not tuned."""


@dataclass(frozen=True)
class _Compared:
    """A file that wears the set: its labels given at 99 % or more, and how many of them are on the point that the file names so."""

    sure: int
    right: int

    @property
    def as_named(self) -> bool:
        return self.sure > 0 and self.right >= RIGHT * self.sure


def trees(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """All folders of recordings through one call of `asterism label` each, by a model of the gait subjects, names of the files ignored."""
    people, recordings = people_and_trials(gait())
    ensemble = benchmark.fit(recordings, people, marker_set=MarkerSet.load("helen-hayes"))
    labelled, failed, compared, passed_over = 0, list[str](), list[_Compared](), 0
    with tempfile.TemporaryDirectory() as made:
        model = Path(made) / "gait.model"
        ensemble.save(model)
        for number, tree in enumerate(QUICK_TREES if benchmark.quick else TREES):
            told = _labelled(folder() / tree, model, Path(made) / str(number))
            labelled += len(told["files"])
            passed_over += len(told["passed_over"])
            failed += [str(name) for name in told["failed"]]
            compared += [one for row in told["files"] if (one := _compare(Path(row["file"]), Path(row["output"]), ensemble.marker_set))]
            benchmark.report(
                f"{tree}: {len(told['files'])} labelled, {len(told['failed'])} failed, {len(told['passed_over'])} without markers"
            )
    for name in failed:
        benchmark.report(f"failed: {name}")
    total = labelled + len(failed)
    yield Figure("folders of recordings as trees: files with markers that are labelled", ">= 1", labelled / total, "share of files", total)
    if compared:
        share = float(np.mean([one.as_named for one in compared]))
        yield Figure(
            "folders of recordings as trees: files that wear the model's set and get its labels",
            ">= 1",
            share,
            "share of files",
            len(compared),
        )
        sure = sum(one.sure for one in compared)
        wrong = (sure - sum(one.right for one in compared)) / max(sure, 1)
        yield Figure(
            "folders of recordings as trees: labels given at 99 % or more that the file names otherwise",
            "<= 0.01",
            wrong,
            "share of labels",
            max(sure, 1),
        )


def _labelled(tree: Path, model: Path, out: Path) -> dict[str, list[dict[str, str]]]:
    """What `asterism label` tells of a tree."""
    told = out.with_suffix(".json")
    with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
        main(["label", str(tree), "-m", str(model), "-o", str(out), "--known-labels", "ignore", "--json", str(told)])
    content: dict[str, list[dict[str, str]]] = json.loads(told.read_text(encoding="utf-8"))
    return content


def _compare(source: Path, output: Path, marker_set: MarkerSet) -> _Compared | None:
    """The labels of an output held against the names of its source; None where the source does not wear the set, or keeps no confidence."""
    try:
        named, given = formats.read(source, markers=marker_set), formats.read(output, markers=marker_set)
        confidence = formats.read_confidence(output)
    except AsterismError:
        return None
    if named.visible.any(axis=0).mean() < WORN or confidence is None or len(named) != len(given):
        return None
    columns = [confidence.names.index(name) for name in marker_set.names]
    sure = given.visible & named.visible & (confidence.values[:, columns] >= SURE)
    same = np.linalg.norm(given.positions - named.positions, axis=2)[sure] < 1e-3
    return _Compared(int(sure.sum()), int(same.sum()))
