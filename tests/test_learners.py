"""Everything that learns sits the same exam."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
import pytest
from learner_exam import Learner, check_learner
from models import BRIEF

from asterism import MarkerModel, Recording
from asterism.labelling import FullSolver, FullSolverRules
from asterism.labelling.body.model import BodyRules, fit_body
from asterism.labelling.partial.matrix import PartialSolvers, label_by_matrix
from asterism.labelling.partial.search_strategies import search_partial_solvers
from asterism.labelling.partial.solver import stack_frames
from asterism.labelling.partial.solver_search import SearchSettings
from asterism.simulation import simulate_walks

FEW = ("LASI", "RASI", "SACR", "LKNE", "RKNE")
WALKS = [walk.select(FEW) for walk in simulate_walks(subjects=5, frames=40, seed=3)]
QUICK = BRIEF
SEARCH = SearchSettings(20, 40, 60, 60, 2, 8, 4, 6)


def labels(model: MarkerModel | FullSolver, recording: Recording, in_time: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Indices and confidence of a recording's points, without their labels."""
    by_frames = isinstance(model, MarkerModel) and not in_time
    labelling = (model.label_frames if by_frames else model.label)(recording.clouds())
    return labelling.indices, labelling.confidence


def searched(recordings: list[Recording]) -> PartialSolvers:
    """Partial solvers of some recordings."""
    frames, groups = stack_frames(recordings)
    return search_partial_solvers(frames, groups, targets=0.9, settings=SEARCH, seed=0)


def voted(solvers: PartialSolvers, recording: Recording) -> tuple[np.ndarray, np.ndarray]:
    """Labels and votes of the matrix."""
    votes = label_by_matrix(recording.clouds(), solvers)
    return votes.indices, votes.votes


def save_solvers(solvers: PartialSolvers, path: Path) -> None:
    """As arrays in an NPZ file."""
    with path.open("wb") as file:
        np.savez(file, **solvers.to_arrays())


def load_solvers(path: Path) -> PartialSolvers:
    """What `save_solvers` wrote."""
    with np.load(path) as file:
        return PartialSolvers.from_arrays(dict(file))


LEARNERS = [
    Learner(
        "MarkerModel",
        MarkerModel,
        partial(MarkerModel.fit, training=QUICK),
        labels,
        save=MarkerModel.save,
        load=MarkerModel.load,
    ),
    Learner(
        "MarkerModel in time",
        MarkerModel,
        partial(MarkerModel.fit, training=QUICK),
        partial(labels, in_time=True),
        frames=False,
        save=MarkerModel.save,
        load=MarkerModel.load,
    ),
    Learner("FullSolver", FullSolver, partial(FullSolver.fit, rules=FullSolverRules(weak_classifiers=12)), labels),
    Learner("PartialSolvers", PartialSolvers, searched, voted, save=save_solvers, load=load_solvers),
]


@pytest.mark.parametrize("learner", LEARNERS, ids=lambda learner: learner.name)
def test_exam(learner: Learner, tmp_path: Path) -> None:
    check_learner(learner, WALKS[:3], WALKS[1:4], WALKS[4], tmp_path)


def test_the_body_is_the_same_again_and_leaves_its_input_alone() -> None:
    frames, people = stack_frames(WALKS[:3])
    before = frames.copy()
    one, two = (fit_body(frames, people, BodyRules(), 0) for _ in range(2))
    np.testing.assert_array_equal(frames, before)
    for name, array in one.to_arrays().items():
        np.testing.assert_array_equal(array, two.to_arrays()[name], err_msg=name)
