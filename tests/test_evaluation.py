"""The rates of section 5.3 against counts done by hand, and who is trained on whom."""

from __future__ import annotations

import json

import numpy as np
import pytest

import asterism.labelling.evaluation as room
from asterism import AsterismError, Labelling, MarkerSet, Recording
from asterism.labelling import evaluate, leave_one_subject_out
from asterism.labelling.evaluation import expected_calibration_error

NAMES = ("A", "B", "C", "D")


def line(frames=10, subject="Ann", missing=()):
    """Marker m stands still at x = m; `missing` are (frame, marker)."""
    positions = np.zeros((frames, len(NAMES), 3))
    positions[:, :, 0] = np.arange(len(NAMES))
    for frame, marker in missing:
        positions[frame, marker] = np.nan
    return Recording(positions, NAMES, 100.0, metadata={"subject": subject, "file": f"{subject}.c3d"})


class Knower:
    """Labels the points of `line` rightly, ghosts never; `spoil` then changes indices and confidence as it likes."""

    marker_set = MarkerSet(NAMES)

    def __init__(self, spoil=lambda indices, confidence, clouds: None):
        self.spoil = spoil
        self.in_time = []

    def label_frames_with_cost(self, clouds, *, method="whole-body", workers=1, progress=None):
        indices = np.full((len(clouds), len(NAMES)), -1)
        for t, points in enumerate(clouds):
            for c, (x, y, z) in enumerate(points):
                if y == z == 0.0 and x in range(len(NAMES)):
                    indices[t, int(x)] = c
        confidence = np.where(indices >= 0, 0.95, 0.1)
        self.spoil(indices, confidence, clouds)
        return Labelling(indices, confidence, NAMES), np.full(len(clouds), 7)

    def label(self, clouds):
        self.in_time.append(True)
        return self.label_frames_with_cost(clouds)[0]


def swap_and_forget(indices, confidence, clouds):
    """Frame 0: A and B exchanged, hardly sure; frame 1: C forgotten; frame 2: D forgotten."""
    if len(clouds) > 2:
        indices[0, [0, 1]], confidence[0, [0, 1]] = indices[0, [1, 0]], 0.45
        indices[1, 2] = indices[2, 3] = -1


def ghosts_for_the_hidden(indices, confidence, clouds):
    """The first marker of each frame that has no point gets the ghost."""
    for t, points in enumerate(clouds):
        free = [c for c in range(len(points)) if c not in indices[t]]
        if free:
            indices[t, np.argmax(indices[t] < 0)] = free[0]


def test_all_rates_as_counted_by_hand():
    """40 samples, one missing: 39 visible; 37 labels, 2 of them wrong; 3 nulls, 2 of them for visible markers."""
    evaluation = evaluate(Knower(swap_and_forget), [line(missing=[(9, 0)])], occlusions=[0], time=False)
    (got,) = evaluation.conditions
    assert (got.frames, got.visible, got.given) == (10, 39, 37)
    assert got.fa == pytest.approx(2 / 37)
    assert got.fo == pytest.approx(2 / 3)
    assert got.missed == pytest.approx(2 / 39)
    assert got.right == pytest.approx(35 / 39)
    assert got.perfect == pytest.approx(7 / 10)
    assert got.ece == pytest.approx(0.05 * 35 / 37 + 0.45 * 2 / 37)
    assert [(round(said, 9), was, count) for said, was, count in got.reliability] == [(0.45, 0.0, 2), (0.95, 1.0, 35)]
    assert got.evaluations_per_frame == 7
    assert got.frames_per_second > 0
    assert got.per_marker["A"] == {"fa": pytest.approx(1 / 9), "fo": 0.0, "missed": 0.0, "assignments": 9, "nulls": 1}
    assert got.per_marker["C"] == {"fa": 0.0, "fo": 1.0, "missed": pytest.approx(1 / 10), "assignments": 9, "nulls": 1}


def test_a_label_for_a_hidden_marker_is_a_false_assignment():
    """One of the visible markers hidden and one ghost in each of ten frames; the ghost is given ten times."""
    (got,) = evaluate(Knower(ghosts_for_the_hidden), [line(missing=[(9, 0)])], occlusions=[1], ghosts=[1], time=False).conditions
    assert (got.visible, got.given) == (29, 39)
    assert got.fa == pytest.approx(10 / 39)
    assert (got.fo, got.missed, got.right, got.perfect) == (0.0, 0.0, 1.0, 0.0)


def test_all_hidden_and_nothing_given_is_perfect():
    (got,) = evaluate(Knower(), [line()], occlusions=[4]).conditions
    assert (got.visible, got.given, got.fa, got.fo, got.missed, got.ece) == (0, 0, 0.0, 0.0, 0.0, 0.0)
    assert got.perfect == 1.0
    assert got.reliability == []


def test_every_pair_of_occlusions_and_ghosts_is_tried_on_all_recordings():
    evaluation = evaluate(Knower(), [line(4, "Ann"), line(6, "Bob"), line(2, "Ann")], occlusions=[0, 1, 2], ghosts=[0, 3])
    assert [(c.occlusions, c.ghosts) for c in evaluation.conditions] == [(k, g) for g in (0, 3) for k in (0, 1, 2)]
    assert [c.visible for c in evaluation.conditions] == [48, 36, 24] * 2
    assert all((c.frames, c.perfect) == (12, 1.0) for c in evaluation.conditions)
    assert evaluation.subjects == ["Ann", "Bob"]
    assert evaluation.markers == NAMES


class Nobody:
    """Knows six markers, and labels no point."""

    marker_set = MarkerSet(tuple("ABCDEF"))

    def label_frames_with_cost(self, clouds, *, method="whole-body", workers=1, progress=None):
        shape = (len(clouds), 6)
        return Labelling(np.full(shape, -1), np.zeros(shape), self.marker_set.names), np.zeros(len(clouds), dtype=np.int64)


def test_none_to_five_markers_are_hidden_unless_asked_otherwise():
    """As in the thesis' section 5.3."""
    recording = Recording(np.random.default_rng(0).normal(size=(8, 6, 3)), Nobody.marker_set.names, 100.0)
    conditions = evaluate(Nobody(), [recording], time=False).conditions
    assert [(c.occlusions, c.ghosts, c.visible) for c in conditions] == [(k, 0, 8 * (6 - k)) for k in range(6)]


def test_the_seed_decides_what_is_hidden():
    seen = []

    def watch(indices, confidence, clouds):
        seen.append((indices >= 0).tobytes())

    for seed in (0, 0, 1):
        evaluate(Knower(watch), [line(40)], occlusions=[2], seed=seed)
    first, again, other = seen[1::2]
    assert first == again
    assert first != other


def test_progress_grows_to_one():
    told = []
    evaluate(Knower(), [line(), line()], occlusions=[0, 1], progress=lambda fraction, what: told.append(fraction))
    assert told == sorted(told)
    assert told[-1] == 1.0


@pytest.mark.parametrize("occlusions", [5, -1])
def test_an_impossible_number_of_occlusions_is_refused(occlusions):
    with pytest.raises(AsterismError, match=rf"cannot hide {occlusions} of 4 markers; ask for 0 to 4"):
        evaluate(Knower(), [line()], occlusions=[0, occlusions])


def test_an_impossible_number_of_occlusions_is_refused_before_training(monkeypatch):
    monkeypatch.setattr(room.MarkerModel, "fit", lambda *_, **__: pytest.fail("trained first"))
    with pytest.raises(AsterismError, match="cannot hide 5 of 4"):
        leave_one_subject_out([line(subject="Ann"), line(subject="Bob")], occlusions=[5])


def test_other_columns_are_refused():
    recording = line()
    strange = Recording(recording.positions, ("A", "B", "D", "C"), 100.0, metadata={"file": "strange.c3d"})
    with pytest.raises(AsterismError, match=r"strange\.c3d has other columns"):
        evaluate(Knower(), [strange])


def test_nobody_is_tested_by_a_model_that_saw_them(monkeypatch):
    """Each person's recordings are labelled once, by a model trained on all recordings of all others and on none of theirs."""
    recordings = [line(2, "Ann"), line(3, "Bob"), line(4, "Ann"), line(5, "Cid")]
    tested = []

    class Trained(Knower):
        def __init__(self, on):
            super().__init__()
            self.on = on

        def label_frames_with_cost(self, clouds, **options):
            tested.append((frozenset(self.on), len(clouds)))
            return super().label_frames_with_cost(clouds, **options)

    options = []

    def fit(given, *, subjects, seed, progress, **rest):
        assert [recording.metadata["subject"] for recording in given] == subjects
        options.append((rest, seed))
        return Trained({len(recording) for recording in given})

    monkeypatch.setattr(room.MarkerModel, "fit", fit)
    evaluation = leave_one_subject_out(recordings, occlusions=[1], seed=5, target_hit_rate=0.99, miner=None)
    assert evaluation.subjects == ["Ann", "Bob", "Cid"]
    assert options == [({"target_hit_rate": 0.99, "miner": None}, 5)] * 3
    whole = {2: {3, 5}, 4: {3, 5}, 3: {2, 4, 5}, 5: {2, 3, 4}}
    assert {frames for _, frames in tested} == set(whole)
    longer = [(on, frames) for on, frames in tested if frames > 2]  # two frames are also what a warm-up takes
    assert sorted(frames for _, frames in longer) == [3, 4, 5]
    for on, frames in longer:
        assert on == whole[frames], f"{frames} frames labelled by a model trained on {sorted(on)}"
    (got,) = evaluation.conditions
    assert (got.frames, got.visible, got.perfect) == (14, 42, 1.0)


def test_names_given_go_before_names_in_the_files(monkeypatch):
    trained = []

    def fit(given, *, subjects, **_):
        trained.append(subjects)
        return Knower()

    monkeypatch.setattr(room.MarkerModel, "fit", fit)
    leave_one_subject_out([line(), line(), line()], subjects=["x", "y", "x"], occlusions=[0])
    assert trained == [["y"], ["x", "x"]]


def test_one_person_alone_cannot_be_left_out():
    with pytest.raises(AsterismError, match="at least two"):
        leave_one_subject_out([line(), line()])


def test_the_result_is_plain_json():
    evaluation = evaluate(Knower(swap_and_forget), [line()], occlusions=[0, 2], ghosts=[0, 1])
    told = json.loads(json.dumps(evaluation.to_dict()))
    assert told["markers"] == list(NAMES)
    assert [c["occlusions"] for c in told["conditions"]] == [0, 2, 0, 2]
    assert told["conditions"][0]["per_marker"]["C"]["assignments"] == 9
    assert told["rules"] == "whole-body"


def test_calibration_error_by_hand():
    """Ten labels said 0.9 of which seven are right, thirty said 0.6 of which eighteen are: a quarter times 0.2 is missed."""
    confidence = np.repeat([0.92, 0.6], [10, 30])
    right = np.concatenate([np.arange(10) < 7, np.arange(30) < 18])
    error, bins = expected_calibration_error(confidence, right)
    assert error == pytest.approx(0.25 * 0.22)
    assert [(round(said, 9), round(was, 9), count) for said, was, count in bins] == [(0.6, 0.6, 30), (0.92, 0.7, 10)]


def test_full_confidence_has_a_bin():
    error, bins = expected_calibration_error(np.ones(4), np.array([True, True, True, False]))
    assert error == pytest.approx(0.25)
    assert bins == [(1.0, 0.75, 4)]


def test_recordings_are_judged_as_a_whole_unless_frames_are_asked_for():
    """As `asterism label` gives them: the default, without counted evaluations; the thesis' rules know single frames only."""
    for time, rules, expected in (
        (None, "whole-body", True),
        (True, "whole-body", True),
        (False, "whole-body", False),
        (None, "thesis", False),
    ):
        knower = Knower()
        evaluation = evaluate(knower, [line()], occlusions=[0], rules=rules, time=time)
        assert evaluation.time is expected
        assert knower.in_time == ([True] * 2 if expected else [])
        assert np.isnan(evaluation.conditions[0].evaluations_per_frame) is np.bool_(expected)
    with pytest.raises(AsterismError, match="leave out time or the rules"):
        evaluate(Knower(), [line()], rules="thesis", time=True)
    with pytest.raises(AsterismError, match="no rules 'guess'"):
        evaluate(Knower(), [line()], rules="guess")


def test_gaps_last_in_whole_recordings():
    """One of four markers hidden at every moment: for single frames another one in every frame, in time for a tenth of a second or more."""
    shown = []

    def changes(time):
        evaluate(Knower(lambda indices, confidence, clouds: shown.append(indices >= 0)), [line(200)], occlusions=[1], time=time)
        assert ((~shown[-1]).sum(axis=1) == 1).all()
        return (shown[-1][1:] != shown[-1][:-1]).any(axis=1).sum()

    assert changes(True) <= 20 < 100 < changes(False)


def test_wrong_labels_at_a_high_confidence_are_a_finding():
    """Two of forty labels wrong at 0.95 lie within chance; half of them do not."""

    def swap_all(indices, confidence, clouds):
        indices[:, [0, 1]] = indices[:, [1, 0]]

    few, many = (evaluate(Knower(spoil), [line(100)], occlusions=[0]) for spoil in (lambda *_: None, swap_all))
    assert few.findings() == []
    (finding,) = many.findings()
    assert (finding.code, finding.where) == ("evaluate-overconfident", "confidence 0.95 to 0.99")
    assert "95.00 %" in finding.sentence and "50.00 %" in finding.sentence
    assert not many.confidence.beats_constant


def test_a_label_without_a_confidence_is_not_judged_by_it():
    """What the completion of the thesis' solvers gives: right or wrong it counts, its confidence does not."""

    def forget(indices, confidence, clouds):
        confidence[:, 0] = np.nan

    (got,) = evaluate(Knower(forget), [line()], occlusions=[0], time=False).conditions
    assert (got.given, got.confidence.labels) == (40, 30)
    assert got.ece == pytest.approx(0.05)
