"""Whole recordings: known truth from the simulation, gaps and ghosts that last, points in any order."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import asterism
from asterism.hiding import hide_in_gaps
from asterism.recording import Clouds
from asterism.simulation import simulate_walks


@pytest.fixture(scope="module")
def walks() -> list[asterism.Recording]:
    return simulate_walks(subjects=5, frames=120, seed=4)


@pytest.fixture(scope="module")
def ensemble(walks: list[asterism.Recording]) -> asterism.SolverEnsemble:
    return asterism.SolverEnsemble.fit(walks[:4], miner=None)


@pytest.mark.parametrize("number_tracks", [True, False], ids=["with tracks", "raw clouds"])
def test_a_stranger_with_gaps_is_labelled_right(
    ensemble: asterism.SolverEnsemble, walks: list[asterism.Recording], number_tracks: bool
) -> None:
    clouds, truth = hide_in_gaps(walks[4], 3, 0, seed=1, number_tracks=number_tracks)
    labelling = ensemble.label(clouds, time=True)
    given = labelling.indices >= 0
    assert (labelling.indices == truth)[given].mean() > 0.999
    assert (given & (truth >= 0)).sum() > 0.97 * (truth >= 0).sum()


def test_the_order_of_the_points_plays_no_part(ensemble: asterism.SolverEnsemble, walks: list[asterism.Recording]) -> None:
    clouds, _ = hide_in_gaps(walks[4], 2, 2, seed=2)
    assert clouds.tracks is not None
    rng = np.random.default_rng(0)
    order = np.concatenate([a + rng.permutation(b - a) for a, b in zip(clouds.offsets[:-1], clouds.offsets[1:], strict=True)])
    shuffled = Clouds(clouds.xyz[order], clouds.offsets, clouds.rate, clouds.vertical, clouds.columns, clouds.tracks[order])
    one, other = ensemble.label(clouds, time=True), ensemble.label(shuffled, time=True)
    assert np.array_equal(one.positions(clouds), other.positions(shuffled), equal_nan=True)
    assert np.array_equal(one.confidence, other.confidence)


def test_empty_frames_are_fine(ensemble: asterism.SolverEnsemble) -> None:
    labelling = ensemble.label(Clouds.from_points([np.empty((0, 3))] * 4, 100.0), time=True)
    assert (labelling.indices == -1).all()


def test_other_rules_do_not_label_whole_recordings(ensemble: asterism.SolverEnsemble, walks: list[asterism.Recording]) -> None:
    with pytest.raises(asterism.AsterismError, match="whole-body"):
        ensemble.label(walks[4].clouds(), time=True, rules="thesis")


def test_a_saved_model_labels_whole_recordings_alike(
    ensemble: asterism.SolverEnsemble, walks: list[asterism.Recording], tmp_path: Path
) -> None:
    path = tmp_path / "walk.model"
    ensemble.save(path)
    clouds, _ = hide_in_gaps(walks[4], 3, 1, seed=3)
    one, other = ensemble.label(clouds, time=True), asterism.SolverEnsemble.load(path).label(clouds, time=True)
    assert np.array_equal(one.indices, other.indices)
    assert np.array_equal(one.confidence, other.confidence)
