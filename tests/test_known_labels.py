"""Names that a file has already: what holds is kept, what the model contradicts is told."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from asterism.recording import Labelling, MarkerSet, Recording, check_labels, is_partly_labelled

SET = MarkerSet(("LKNE", "RKNE", "SACR"), aliases={"LKNE": ("L.Knee",)})


def _recording(labels: tuple[str, ...], frames: int = 1) -> Recording:
    return Recording(np.random.default_rng(0).normal(size=(frames, len(labels), 3)), labels, rate=100.0)


def _labelling(rows: list[list[int]], candidates: list[list[int]] | None = None) -> Labelling:
    indices = np.array(rows, dtype=np.int64)
    best = None if candidates is None else np.array(candidates, dtype=np.int64)
    return Labelling(indices, np.full(indices.shape, 0.4), SET.names, best)


def test_a_name_that_nothing_contradicts_is_kept() -> None:
    recording = _recording(("L.Knee", "*1", "SACR"))
    kept, against = check_labels(_labelling([[-1, 1, -1]], [[0, -1, 1]]), recording, recording.clouds(), SET)
    np.testing.assert_array_equal(kept.indices, [[0, 1, 2]])
    assert kept.confidence[0, 0] == 0.4, "the candidate that the model did not accept is the point that the file names"
    assert np.isnan(kept.confidence[0, 2]), "the model had another candidate: nothing is known about the file's"
    assert against == ()


def test_the_model_wins_where_it_contradicts_and_says_so() -> None:
    recording = _recording(("LKNE", "RKNE", "SACR"), frames=3)
    kept, against = check_labels(_labelling([[1, 0, 2], [1, 0, 2], [0, 1, 2]]), recording, recording.clouds(), SET)
    np.testing.assert_array_equal(kept.indices, [[1, 0, 2], [1, 0, 2], [0, 1, 2]])
    assert [(each.name, each.given, each.first_frame, each.last_frame, each.frames) for each in against] == [
        ("LKNE", "RKNE", 0, 1, 2),
        ("RKNE", "LKNE", 0, 1, 2),
    ]


def test_a_marker_that_the_model_finds_at_another_point_is_no_agreement() -> None:
    recording = _recording(("LKNE", "*1"))
    kept, against = check_labels(_labelling([[1, -1, -1]]), recording, recording.clouds(), SET)
    np.testing.assert_array_equal(kept.indices, [[1, -1, -1]])
    assert [(each.name, each.given) for each in against] == [("LKNE", None)]


def test_a_name_that_occurs_twice_counts_for_neither() -> None:
    recording = _recording(("LKNE", "L.Knee", "*1"))
    kept, against = check_labels(_labelling([[-1, -1, -1]]), recording, recording.clouds(), SET)
    np.testing.assert_array_equal(kept.indices, -1)
    assert against == ()


def test_partly_labelled_has_names_of_the_set_and_points_without() -> None:
    assert is_partly_labelled(_recording(("LKNE", "*1")), SET)
    assert not is_partly_labelled(_recording(("LKNE", "RKNE")), SET)
    assert not is_partly_labelled(_recording(("C7", "*1")), SET)
    assert not is_partly_labelled(_recording(("*1", "*2")), SET)
    gone = _recording(("LKNE", "*1"))
    gone.positions[:, 1] = np.nan
    assert not is_partly_labelled(gone, SET), "a column without samples is no point"


@given(st.integers(0, 2**32 - 1), st.permutations(["L.Knee", "RKNE", "C7", "*1", "SACR"]))
def test_no_point_gets_two_markers_and_every_label_of_the_model_stays(seed: int, labels: list[str]) -> None:
    rng = np.random.default_rng(seed)
    positions = rng.normal(size=(6, len(labels), 3))
    positions[rng.random((6, len(labels))) < 0.3] = np.nan
    recording = Recording(positions, tuple(labels), rate=100.0)
    clouds = recording.clouds()
    rows = [[int(i) if i < n else -1 for i in rng.permutation(max(n, 3) + 2)[:3]] for n in clouds.counts]
    before = _labelling(rows)
    kept, against = check_labels(before, recording, clouds, SET)
    for t in range(len(recording)):
        used = kept.indices[t][kept.indices[t] >= 0]
        assert len(set(used)) == len(used) and all(i < clouds.counts[t] for i in used)
    np.testing.assert_array_equal(kept.indices[before.indices >= 0], before.indices[before.indices >= 0])
    names = {SET.name_of(label): column for column, label in enumerate(labels)}
    for m, name in enumerate(SET.names):  # a frame in which a named point does not carry its name is told
        shown = recording.visible[:, names[name]]
        same = np.array(
            [
                kept.indices[t, m] >= 0 and clouds.columns[clouds.offsets[t] + kept.indices[t, m]] == names[name]
                for t in range(len(recording))
            ]
        )
        told = sum(each.frames for each in against if each.name == name)
        assert told == (shown & ~same).sum()
