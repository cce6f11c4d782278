"""Training and evaluating whose parts are done elsewhere give what one process gives, bit for bit."""

from __future__ import annotations

import json
import os
import pickle
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from asterism import AsterismError, MarkerModel
from asterism.labelling import TrainingRules, evaluate, leave_one_subject_out
from asterism.labelling.shared_work import each_shared, shared_by
from asterism.recording import Recording
from asterism.session import each_of
from asterism.simulation import simulate_walks

pytestmark = pytest.mark.usefixtures("training_anew")

QUICK: dict[str, Any] = {
    "training": TrainingRules(virtual_people=0, trial_frames=6, min_trial_frames=6, stretch_frames=40, stretches=1, frames_per_person=60)
}


@pytest.fixture(scope="module")
def walks() -> list[Recording]:
    found = simulate_walks(3, frames=60, markers="helen-hayes", seed=4)
    return [replace(one, metadata={**one.metadata, "subject": str(n)}) for n, one in enumerate(found)]


@pytest.fixture(scope="module")
def model(walks: list[Recording]) -> MarkerModel:
    return MarkerModel.fit(walks, seed=3, **QUICK)


class Elsewhere:
    """As another process does it: the function and each value go through messages, and the last task is done first."""

    def __init__(self) -> None:
        self.calls = 0

    def __call__(self, function: Any, items: Sequence[Any]) -> Iterator[Any]:
        self.calls += 1
        given = pickle.dumps(function)
        done = {item: pickle.dumps(pickle.loads(given)(item)) for item in reversed(items)}
        return iter([pickle.loads(done[item]) for item in items])


def test_training_elsewhere_gives_the_same_model(walks: list[Recording], model: MarkerModel, tmp_path: Path) -> None:
    elsewhere = Elsewhere()
    model.save(tmp_path / "here.model")
    with shared_by(elsewhere):
        MarkerModel.fit(walks, seed=3, **QUICK).save(tmp_path / "there.model")
    assert elsewhere.calls == 2
    assert (tmp_path / "here.model").read_bytes() == (tmp_path / "there.model").read_bytes()


def _but_times(evaluation: Any) -> str:
    plain = evaluation.to_dict()
    for one in plain["conditions"]:
        del one["frames_per_second"]
    return json.dumps(plain)


def test_evaluating_elsewhere_gives_the_same_figures(walks: list[Recording], model: MarkerModel, monkeypatch: pytest.MonkeyPatch) -> None:
    elsewhere = Elsewhere()
    monkeypatch.setattr(MarkerModel, "fit", lambda *_, **__: model)
    short = [walk.frames(slice(0, 30)) for walk in walks[:2]]
    for what in (
        partial(evaluate, model, short, occlusions=[0, 3], ghosts=[1]),
        partial(leave_one_subject_out, short, occlusions=[2]),
    ):
        here = what()
        with shared_by(elsewhere):
            there = what()
        assert _but_times(here) == _but_times(there)
        # people left out count among the labelled, too
        assert sum(vars(here.conditions[0].shares).values()) == pytest.approx(1.0)
    assert elsewhere.calls >= 3


def _of_process(offset: Any, item: int) -> tuple[int, Any]:
    if item < 0:
        raise AsterismError("this is none.")
    return os.getpid(), offset + item


def test_what_is_large_goes_over_the_disk(tmp_path: Path) -> None:
    with each_of(tmp_path, workers=2) as each:
        found = list(each(partial(_of_process, np.arange(50_000.0)), range(4)))
        assert [value[0] for _, value in found] == [0, 1, 2, 3]
        assert os.getpid() not in {process for process, _ in found}
        (scratch,) = tmp_path.iterdir()
        assert [path.suffix for path in scratch.iterdir()] == [".function"], "values that were read have gone"
    assert not list(tmp_path.iterdir())
    with each_of(tmp_path) as each, pytest.raises(AsterismError, match="this is none"):
        list(each(partial(_of_process, 0), [1, -1]))


def test_nobody_shares_unless_asked() -> None:
    assert list(each_shared(abs, [-1, -2], map)) == [1, 2]


@pytest.mark.slow
@pytest.mark.parametrize("how", [{"workers": 2}, {"dask": "local:2"}])
def test_processes_train_the_same_model(how: dict[str, Any], walks: list[Recording], model: MarkerModel, tmp_path: Path) -> None:
    if "dask" in how:
        pytest.importorskip("distributed")
    model.save(tmp_path / "here.model")
    with each_of(tmp_path, **how) as each, shared_by(each):
        MarkerModel.fit(walks, seed=3, **QUICK).save(tmp_path / "there.model")
    assert (tmp_path / "here.model").read_bytes() == (tmp_path / "there.model").read_bytes()
