"""Several bodies in one volume: walkers who wear the same markers, and a walker with a box, whose truth is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import asterism
from asterism.hiding import hide_in_gaps
from asterism.labelling import label_together
from asterism.labelling.tracks.bodies import Bodies, follow_bodies
from asterism.recording import Labelling, Recording
from asterism.simulation import simulate_walks

BOX = np.array([[0.0, 0.0, 0.0], [0.25, 0.0, 0.0], [0.0, 0.18, 0.0], [0.05, 0.07, 0.2], [-0.12, 0.04, 0.09]])


@pytest.fixture(scope="module")
def walks() -> list[Recording]:
    return simulate_walks(subjects=7, frames=200, seed=11)


@pytest.fixture(scope="module")
def walker(walks: list[Recording]) -> asterism.SolverEnsemble:
    return asterism.SolverEnsemble.fit(walks[:5], miner=None, subjects=list("abcde"))


def tumbling_box(rng: np.random.Generator, frames: int = 200) -> Recording:
    """A rigid box of five markers that somebody carries about and turns every way."""
    time = np.arange(frames) / 100.0

    def wave(size: float) -> np.ndarray:
        frequency, phase = rng.uniform(0.1, 0.6, (3, 3, 1)), rng.uniform(0.0, 2 * np.pi, (3, 3, 1))
        return (size * rng.normal(size=(3, 3, 1)) * np.sin(2 * np.pi * frequency * time + phase)).sum(axis=1).T

    turned, moved = Rotation.from_rotvec(wave(1.0)), wave(0.2) + np.array([0.0, 0.0, 1.0])
    return Recording(np.stack([turned.apply(place) for place in BOX], axis=1) + moved[:, None], tuple(f"box{i}" for i in range(5)), 100.0)


def beside(first: Recording, second: Recording, away: tuple[float, float, float], speed: float = 0.0) -> Recording:
    """Both in one volume, the second's middle `away` (m) from the first's, or passing through that place at `speed` (m/s) along x."""
    moved = second.positions + (first.positions.mean(axis=1) - second.positions.mean(axis=1))[:, None] + np.array(away)
    moved[:, :, 0] += speed * ((np.arange(len(moved)) - len(moved) / 2) / second.rate)[:, None]
    labels = (*first.labels, *(f"2:{label}" for label in second.labels))
    return Recording(np.concatenate([first.positions, moved], axis=1), labels, first.rate)


def judged(labellings: list[Labelling], truth: np.ndarray) -> tuple[float, float]:
    """The share of right entries, and of wrong ones among those given; two who wear the same markers may be exchanged as a whole."""
    one, two = (labelling.indices for labelling in labellings)
    orders = [np.concatenate([one, two], axis=1)]
    if one.shape == two.shape:
        orders.append(np.concatenate([two, one], axis=1))
    given = max(orders, key=lambda indices: float((indices == truth).mean()))
    return float((given == truth).mean()), float((given != truth)[given >= 0].mean())


@pytest.mark.parametrize(("away", "speed"), [((0.8, 0.3, 0.0), 0.0), ((0.0, 1.0, 0.0), 1.5), ((0.3, 0.4, 0.0), 0.0)])
@pytest.mark.parametrize(("hidden", "ghosts", "numbered"), [(0, 0, True), (4, 0, True), (4, 0, False), (2, 3, True)])
def test_two_walkers_with_the_same_markers_are_told_apart(walks, walker, away, speed, hidden: int, ghosts: int, numbered: bool) -> None:
    clouds, truth = hide_in_gaps(beside(walks[5], walks[6], away, speed), hidden, ghosts, 3, number_tracks=numbered)
    right, wrong = judged(label_together([walker, walker], clouds), truth)
    assert right > 0.985, f"{right:.4f} right"
    assert wrong < 0.005, f"{wrong:.4f} wrong among those given"


@pytest.mark.parametrize(("hidden", "ghosts"), [(0, 0), (2, 0), (2, 2)])
def test_a_walker_and_a_box_are_told_apart_in_either_order(walks, walker, hidden: int, ghosts: int) -> None:
    rng = np.random.default_rng(0)
    box = asterism.SolverEnsemble.fit([tumbling_box(rng) for _ in range(4)], miner=None, subjects=list("abcd"))
    both = beside(walks[5], tumbling_box(rng), (0.4, 0.3, 0.1))
    clouds, truth = hide_in_gaps(both, hidden, ghosts, 1)
    found = label_together([walker, box], clouds)
    right, wrong = judged(found, truth)
    assert right > 0.97, f"{right:.4f} right"
    assert wrong < 0.005, f"{wrong:.4f} wrong among those given"
    for one, other in zip(found, label_together([box, walker], clouds)[::-1], strict=True):
        np.testing.assert_array_equal(one.indices, other.indices)


def test_no_point_belongs_to_two_bodies_and_workers_change_nothing(walks, walker) -> None:
    clouds, _ = hide_in_gaps(beside(walks[5], walks[6], (0.2, 0.0, 0.0)), 4, 4, 0)
    found = label_together([walker, walker], clouds)
    for frame in np.concatenate([labelling.indices for labelling in found], axis=1):
        given = frame[frame >= 0]
        assert len(set(given.tolist())) == len(given)
    for one, other in zip(found, label_together([walker, walker], clouds, workers=2), strict=True):
        np.testing.assert_array_equal(one.indices, other.indices)
        np.testing.assert_array_equal(one.confidence, other.confidence)


def test_whoever_is_not_there_gets_no_labels(walks, walker) -> None:
    found = label_together([walker, walker], walks[5].clouds())
    shares = sorted((labelling.indices >= 0).mean() for labelling in found)
    assert shares[0] == 0.0
    assert shares[1] > 0.99


def test_a_body_is_followed_by_its_tracklets_whichever_is_found_better() -> None:
    """Ten frames of two bodies with three tracklets each, one tracklet of each renumbered half way; the bodies come in any order."""
    rng = np.random.default_rng(2)
    order = np.array([rng.permutation(2) for _ in range(10)]).T
    track = np.tile(np.arange(6), (10, 1))
    track[5:, [0, 3]] = [6, 7]
    rows = np.array([[e * 6 + 3 * order[b, e] + np.arange(3) for e in range(10)] for b in range(2)])
    bodies = Bodies(np.zeros((2, 10), dtype=np.int64), rows, np.ones(rows.shape))
    who = follow_bodies(bodies, track.ravel())
    assert len(set((who == order).ravel().tolist())) == 1
    assert set(who.ravel().tolist()) == {0, 1}
    lost = replace(bodies, rows=np.where(rng.random(rows.shape) < 0.3, -1, rows))
    assert len(set((follow_bodies(lost, track.ravel()) == order).ravel().tolist())) == 1
