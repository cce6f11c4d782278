"""The subject's own body: what a few labelled frames of one person, markers missing here and there, make of the model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from asterism.labelling.body.model import BodyModel, BodyRules, fit_body
from asterism.labelling.body.subject import SubjectRules, adapt_body
from asterism.recording import Recording
from asterism.simulation import simulate_walks


@pytest.fixture(scope="module")
def walks() -> list[Recording]:
    return simulate_walks(subjects=4, frames=100, markers="helen-hayes", seed=5)


@pytest.fixture(scope="module")
def body(walks: list[Recording]) -> BodyModel:
    people = np.repeat(np.arange(3), 100)
    return fit_body(np.concatenate([walk.positions for walk in walks[:3]]), people, BodyRules(), 0)


@pytest.mark.parametrize("weight", [0.3, 1.0])
@pytest.mark.parametrize("sway", [0.0, 0.02], ids=["as learned", "markers sway together"])
def test_any_pattern_of_missing_markers_leaves_a_body_that_can_be(
    walks: list[Recording], body: BodyModel, weight: float, sway: float
) -> None:
    """Covariances stay positive definite, and nothing is less known than before."""
    assert body.within is not None and body.between is not None
    swaying = replace(body, within=body.within + sway)
    own = walks[3].positions
    for seed in range(6):
        rng = np.random.default_rng(seed)
        some = own[rng.choice(len(own), 3)]
        some[rng.random(some.shape[:2]) < 0.3] = np.nan
        mine = adapt_body(swaying, some, np.zeros(3, dtype=np.int64), np.full(3, weight), SubjectRules(), BodyRules())
        assert mine.between is not None
        assert np.linalg.eigvalsh(mine.between).min() > 0 and np.linalg.eigvalsh(mine.noise).min() > 0
        assert (np.diagonal(mine.between[0]) <= np.diagonal(body.between[0]) + 1e-12).all()


def test_the_same_moment_twice_tells_less_than_two_moments(walks: list[Recording], body: BodyModel) -> None:
    """A second frame that differs tells more of the body than one that repeats the first."""
    own, weight, poses = walks[3].positions, np.ones(2), np.zeros(2, dtype=np.int64)
    again, apart = (adapt_body(body, own[list(frames)], poses, weight, SubjectRules(), BodyRules()).between for frames in ((0, 0), (0, 40)))
    assert again is not None and apart is not None and np.trace(apart[0]) < np.trace(again[0])
