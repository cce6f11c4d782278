"""`--keep`: labels that a recording has stay, and the model names only what has no name."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from asterism.errors import AsterismError
from asterism.recording import Labelling, MarkerSet, Recording, is_unnamed, keep_labels

SET = MarkerSet(("LKNE", "RKNE", "SACR"), aliases={"LKNE": ("L.Knee",)})


def _recording(labels: tuple[str, ...], frames: int = 4, seed: int = 0) -> Recording:
    positions = np.random.default_rng(seed).normal(size=(frames, len(labels), 3))
    return Recording(positions, labels, rate=100.0)


def _labelling(rows: list[list[int]]) -> Labelling:
    indices = np.array(rows, dtype=np.int64)
    return Labelling(indices, np.full(indices.shape, 0.9), SET.names)


def test_a_label_of_the_file_wins_over_the_model() -> None:
    recording = _recording(("RKNE", "*1", "L.Knee"), frames=1)
    kept = keep_labels(_labelling([[1, 2, 0]]), recording, recording.clouds(), SET)
    # The model's LKNE was the nameless point; the file says that its third point is LKNE, and RKNE its first.
    np.testing.assert_array_equal(kept.indices, [[2, 0, -1]])
    np.testing.assert_array_equal(kept.confidence[0, :2], 1.0)


def test_the_model_names_what_has_no_name() -> None:
    recording = _recording(("RKNE", "*1", "*2"), frames=1)
    kept = keep_labels(_labelling([[2, 0, 1]]), recording, recording.clouds(), SET)
    np.testing.assert_array_equal(kept.indices, [[2, 0, 1]])
    assert kept.confidence[0, 0] == 0.9


def test_a_point_with_another_name_keeps_it() -> None:
    recording = _recording(("C7", "*1"), frames=1)
    clouds = recording.clouds()
    kept = keep_labels(_labelling([[0, -1, 1]]), recording, clouds, SET)
    np.testing.assert_array_equal(kept.indices, [[-1, -1, 1]])
    out = recording.with_labelling(kept, clouds, keep_names=True)
    assert out.labels == (*SET.names, "C7")
    np.testing.assert_array_equal(out.positions[:, 3], recording.positions[:, 0])
    assert recording.with_labelling(kept, clouds).labels == (*SET.names, "*1")


def test_two_columns_for_one_marker_are_refused() -> None:
    recording = _recording(("LKNE", "L.Knee"), frames=1)
    with pytest.raises(AsterismError, match="both labelled LKNE"):
        keep_labels(_labelling([[0, 1, -1]]), recording, recording.clouds(), SET)


@given(st.integers(0, 2**32 - 1), st.permutations(["LKNE", "RKNE", "C7", "*1", "*2", "uname*3"]))
def test_kept_labels_hold_in_every_frame_and_no_point_has_two(seed: int, labels: list[str]) -> None:
    rng = np.random.default_rng(seed)
    positions = rng.normal(size=(6, len(labels), 3))
    positions[rng.random((6, len(labels))) < 0.3] = np.nan
    recording = Recording(positions, tuple(labels), rate=100.0)
    clouds = recording.clouds()
    rows = [[int(i) if i < n else -1 for i in rng.permutation(max(n, 3) + 1)[:3]] for n in clouds.counts]
    kept = keep_labels(_labelling(rows), recording, clouds, SET)
    out = kept.positions(clouds)
    for marker, name in enumerate(SET.names[:2]):
        own = recording.positions[:, labels.index(name)]
        seen = ~np.isnan(own[:, 0])
        np.testing.assert_array_equal(out[seen, marker], own[seen])
    for t in range(len(recording)):
        used = kept.indices[t][kept.indices[t] >= 0]
        assert len(set(used)) == len(used)
        assert all(i < clouds.counts[t] for i in used)


@pytest.mark.parametrize("label", ["*12", "", "uname*3", "U7", "Unlabeled 108", "Unidentified", "Ann:*4", "unlabelled_2"])
def test_counted_points_have_no_name(label: str) -> None:
    assert is_unnamed(label)


@pytest.mark.parametrize("label", ["LKNE", "T10", "C7", "Ann:RASI", "upper_back", "U_arm", "ULNA"])
def test_marker_names_are_names(label: str) -> None:
    assert not is_unnamed(label)
