"""Exchanges of near markers: labelled frames and the whole covariance in; how far the labels are ahead out, held against density ratios."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from asterism import AsterismError, MarkerModel
from asterism.geometry import align_about_z
from asterism.labelling import virtual_model
from asterism.labelling.body.exchanges import ExchangeModel
from asterism.recording import MarkerSet
from asterism.skeleton import virtual_people

MARKERS = 7
FREEDOM = 8.0


def random_model(rng: np.random.Generator, poses: int = 2) -> ExchangeModel:
    """A body of seven markers within 0.5 m, whose movements are correlated at random."""
    spread = rng.normal(0.0, 0.03, (poses, 3 * MARKERS, 3 * MARKERS))
    covariance = spread @ spread.transpose(0, 2, 1) + 1e-4 * np.eye(3 * MARKERS)
    mean = rng.uniform(-0.25, 0.25, (1, MARKERS, 3)) + rng.normal(0.0, 0.02, (poses, MARKERS, 3))
    pairs = np.argwhere(np.triu(np.ones((MARKERS, MARKERS)), 1))
    return ExchangeModel(mean, covariance, np.log(np.full(poses, 1.0 / poses)), pairs, np.array([[0, 1, 2, 3], [2, 4, 5, 6]]))


def frames_of(rng: np.random.Generator, model: ExchangeModel, frames: int, hidden: int) -> np.ndarray:
    bodies = np.stack([rng.multivariate_normal(model.mean[0].ravel(), model.covariance[0]) for _ in range(frames)])
    bodies = bodies.reshape(frames, MARKERS, 3)
    for body in bodies:
        body[rng.choice(MARKERS, hidden, replace=False)] = np.nan
    return bodies


def plain_behind(model: ExchangeModel, frame: np.ndarray, permutation: np.ndarray) -> float:
    """The log of a ratio of densities of the exchanged markers' points, all others given, by the conditional normal distribution."""
    shown = ~np.isnan(frame[:, 0])
    if shown.sum() < 3 or not (shown | shown[permutation])[permutation != np.arange(MARKERS)].any():
        return float("nan")
    best, scores = None, []
    for mean, covariance, weight in zip(model.mean, model.covariance, model.log_weight, strict=True):
        placed = align_about_z(frame[None], mean)[0]
        rows = np.repeat(shown, 3)
        apart, block = (placed - mean)[shown].ravel(), covariance[np.ix_(rows, rows)]
        scores.append(weight - 0.5 * np.linalg.slogdet(block)[1] - 0.5 * apart @ np.linalg.solve(block, apart))
        if scores[-1] == max(scores):
            best = placed, mean, covariance
    assert best is not None
    placed, mean, covariance = best
    moved = np.nonzero(permutation != np.arange(MARKERS))[0]

    def density(points: np.ndarray) -> float:
        there = ~np.isnan(points[:, 0])
        # a group's permutation is one of its four markers, given those outside
        asked = np.zeros(MARKERS, dtype=bool)
        asked[next(group for group in ([moved] if len(moved) == 2 else model.groups.tolist()) if set(moved) <= set(group))] = True
        given_rows, asked_rows = np.repeat(there & ~asked, 3), np.repeat(there & asked, 3)
        across = covariance[np.ix_(asked_rows, given_rows)]
        gain = across @ np.linalg.inv(covariance[np.ix_(given_rows, given_rows)])
        left = covariance[np.ix_(asked_rows, asked_rows)] - gain @ across.T
        deviation = (points - mean).ravel()
        apart = deviation[asked_rows] - gain @ deviation[given_rows]
        squares = apart @ np.linalg.solve(left, apart)
        return float(-0.5 * (FREEDOM + len(apart)) * np.log1p(squares / FREEDOM) - 0.5 * np.linalg.slogdet(left)[1])

    return density(placed) - density(placed[permutation])


@given(st.integers(0, 2**32 - 1), st.integers(0, 5))
@settings(max_examples=20, deadline=None)
def test_exchanges_are_ratios_of_densities(seed: int, hidden: int) -> None:
    """With all markers in view, some hidden, and too few to tell anything."""
    rng = np.random.default_rng(seed)
    model = random_model(rng)
    frames = frames_of(rng, model, 3, hidden)
    found, table = model.held(frames, FREEDOM).behind(), model.table
    assert (np.sort(table, axis=1) == np.arange(MARKERS)).all()
    wanted = np.array([[plain_behind(model, frame, permutation) for frame in frames] for permutation in table])
    np.testing.assert_allclose(found, wanted, rtol=1e-5, atol=1e-5)


def test_the_right_labels_are_ahead_where_neighbours_move_together() -> None:
    """Two markers 1 cm apart that are carried 10 cm to and fro together are told apart; by their own spreads they would be alike."""
    rng = np.random.default_rng(3)
    model = random_model(rng, poses=1)
    covariance = 0.1**2 * np.kron(np.ones((MARKERS, MARKERS)), np.eye(3)) + 0.002**2 * np.eye(3 * MARKERS)
    mean = model.mean.copy()
    mean[0, 1] = mean[0, 0] + [0.01, 0.0, 0.0]
    model = ExchangeModel(mean, covariance[None], np.zeros(1), np.array([[0, 1]]), model.groups)
    frames = frames_of(rng, model, 50, 0)
    ahead = model.held(frames, FREEDOM).behind()[0]
    assert (ahead > 0.0).all()
    exchanged = frames.copy()
    exchanged[:, [0, 1]] = frames[:, [1, 0]]
    np.testing.assert_allclose(model.held(exchanged, FREEDOM).behind()[0], -ahead, rtol=0.01)  # each is placed by its own labels


@given(st.integers(0, 2**32 - 1), st.integers(0, 4))
@settings(max_examples=10, deadline=None)
def test_other_points_are_held_against_labels_by_ratios_of_densities(seed: int, hidden: int) -> None:
    """Of the place of one marker, all others given: that of its point and that of a point without a label."""
    rng = np.random.default_rng(seed)
    model = random_model(rng, poses=1)
    frames = frames_of(rng, model, 2, hidden)
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    others = rng.uniform(-0.3, 0.3, (2, 3, 3))
    others[0, 2] = np.nan
    found = model.held(frames @ turn.T, FREEDOM).behind_others(others @ turn.T)
    mean, covariance = model.mean[0], model.covariance[0]
    for e, frame in enumerate(frames):
        moved = align_about_z(np.concatenate([frame, others[e]])[None], np.concatenate([mean, np.full((3, 3), np.nan)]))[0]
        shown = ~np.isnan(frame[:, 0])
        for m in range(MARKERS):
            if not shown[m]:
                assert np.isnan(found[:, m, e]).all()
                continue
            rest, own = np.repeat(shown & (np.arange(MARKERS) != m), 3), np.repeat(np.arange(MARKERS) == m, 3)
            gain = covariance[np.ix_(own, rest)] @ np.linalg.inv(covariance[np.ix_(rest, rest)])
            left = covariance[np.ix_(own, own)] - gain @ covariance[np.ix_(rest, own)]
            expected = mean[m] + gain @ (moved[:MARKERS] - mean).ravel()[rest]
            squares = [float((at - expected) @ np.linalg.solve(left, at - expected)) for at in (moved[m], *moved[MARKERS:])]
            logs = -0.5 * (FREEDOM + 3) * np.log1p(np.array(squares) / FREEDOM)
            np.testing.assert_allclose(found[:, m, e], logs[0] - logs[1:], rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("hidden", [5, 6, 7])
def test_frames_of_fewer_than_three_labels_tell_nothing(hidden: int) -> None:
    rng = np.random.default_rng(hidden)
    model = random_model(rng)
    frames = frames_of(rng, model, 2, hidden)
    assert np.isnan(model.held(frames, FREEDOM).behind()).all()
    assert np.isnan(model.held(frames, FREEDOM).behind_others(np.zeros((2, 1, 3)))).all()


def test_what_laboratories_often_leave_out_is_not_taken_for_what_all_wear() -> None:
    """Upper arms without their markers, as in most files of Plug-in Gait: the model knows from the set, and elbows keep their names."""
    marker_set = MarkerSet.load("plug-in-gait")
    absent = [name for name in marker_set.names if name[1:] in ("UPA", "FRM")]
    assert set(absent) < set(marker_set.optional)
    model = virtual_model(marker_set)
    blind = MarkerModel(replace(model.state, marker_set=replace(marker_set, optional=())))
    counts = {"knows": 0, "blind": 0}
    columns = [marker_set.names.index(name) for name in absent]
    for person in virtual_people(marker_set, 2, 60, seed=9)[:5]:
        clouds = person.select([name for name in marker_set.names if name not in absent]).clouds()
        for name, labeller in (("knows", model), ("blind", blind)):
            counts[name] += int((labeller.label(clouds).indices[:, columns] >= 0).sum())
    assert counts["knows"] == 0
    assert counts["blind"] > 20, "as elbows and wrists are taken for these"
    odds = model.body_labeller.worn_odds
    assert (odds[[marker_set.names.index(name) for name in absent]] == 0.0).all()
    assert odds[marker_set.names.index("LELB")] > 4.0


def test_a_set_keeps_what_is_optional_in_its_file() -> None:
    marker_set = MarkerSet(("LKNE", "RKNE", "LTHI"), optional=("LTHI",))
    assert MarkerSet.from_toml(marker_set.to_toml(), "here").optional == ("LTHI",)
    with pytest.raises(AsterismError, match="optional"):
        MarkerSet(("LKNE",), optional=("RKNE",))
    with pytest.raises(AsterismError, match="optional"):
        MarkerSet.from_toml('markers = ["LKNE"]\noptional = "LKNE"\n', "here")
