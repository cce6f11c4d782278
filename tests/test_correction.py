"""A person corrects a recording: touches and their consequences, refusing, undo and redo, the log of it, and whether a trial is ready."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from correcting import longest, model, recorded, truth_of_points, walks, written

from asterism import formats
from asterism.errors import AsterismError
from asterism.labelling.correction import (
    Correction,
    CorrectionLog,
    Cut,
    Ghost,
    Name,
    PointInFrame,
    Right,
    Swap,
    SwapMarkers,
    Touch,
    log_path,
    request_of,
)
from asterism.labelling.correction.correct import FirstLabels
from asterism.labelling.correction.readiness import to_look_at
from asterism.labelling.correction.touches import Request
from asterism.labelling.recording_labeller import LabellingSettings, RecordingLabeller
from asterism.labelling.review import ReviewItem, labels_of_points
from asterism.recording import Ints, Labelling, Recording


@cache
def labelled_walk(seed: int) -> tuple[Recording, Ints, FirstLabels]:
    """A walk, the true marker of each column, and the labels that it begins with: labelled once for all tests that correct it."""
    recording, marker = recorded(walks()[4], seed=seed)
    return recording, marker, FirstLabels.of(RecordingLabeller((model(),), LabellingSettings()), recording.clouds())


def corrected(seed: int = 1) -> tuple[Correction, Ints]:
    """A walk to correct, and the true marker of each point."""
    recording, marker, first = labelled_walk(seed)
    correction = Correction(model(), recording, first=first)
    return correction, truth_of_points(correction.clouds, marker)


def test_a_recording_is_labelled_first_where_no_labels_are_given() -> None:
    assert same(Correction(model(), labelled_walk(1)[0]).labelling, corrected()[0].labelling)


def same(one: Labelling, other: Labelling) -> bool:
    return np.array_equal(one.indices, other.indices) and np.array_equal(one.confidence, other.confidence)


def long_piece(correction: Correction) -> int:
    pieces = correction.pieces
    return longest(pieces.id.tolist(), pieces.first.tolist(), pieces.last.tolist())


def test_a_name_wins_and_what_follows_is_told() -> None:
    correction, _ = corrected()
    piece = long_piece(correction)
    before = correction.names[correction.pieces.marker[correction.pieces.place_of(piece)]]
    change = correction.apply(Name(piece, "SACR"))
    [said] = [part for part in change.pieces if part.by_person]
    assert (said.piece, said.before, said.after) == (piece, before, "SACR")
    assert any(part.before == "SACR" and part.after != "SACR" for part in change.pieces if not part.by_person)
    place = correction.pieces.place_of(piece)
    assert correction.pieces.person[place] and correction.pieces.confidence[place] == 1.0
    assert piece not in {int(item.points[0]) for item in correction.items()}


def test_undo_gives_back_the_first_labelling_bit_for_bit_and_redo_the_last() -> None:
    correction, _ = corrected()
    first, pieces = correction.labelling, correction.pieces
    piece = long_piece(correction)
    correction.apply(Cut(piece, 60))
    correction.apply(Name(piece, "SACR"))
    correction.apply(Ghost(int(correction.pieces.id[3])))
    last = correction.labelling
    for _ in range(3):
        correction.undo()
    assert same(correction.labelling, first) and np.array_equal(correction.pieces.id, pieces.id)
    assert not correction.can_undo
    for _ in range(3):
        correction.redo()
    assert same(correction.labelling, last) and not correction.can_redo
    with pytest.raises(AsterismError, match="nothing to take again"):
        correction.redo()


def test_a_touch_after_undo_forgets_what_was_taken_back() -> None:
    correction, _ = corrected()
    piece = long_piece(correction)
    correction.apply(Name(piece, "SACR"))
    correction.undo()
    correction.apply(Right(piece))
    assert not correction.can_redo and len(correction.touches) == 1


def test_a_consequence_that_is_refused_stays_as_it_was() -> None:
    correction, _ = corrected()
    change = correction.apply(Name(long_piece(correction), "SACR"))
    consequence = next(part for part in change.pieces if not part.by_person and part.before is not None)
    refused = correction.refuse(change, [consequence.piece])
    assert [(part.piece, part.after) for part in refused.pieces if part.piece == consequence.piece] == [
        (consequence.piece, consequence.before)
    ]
    assert correction.touches[-1].kind == "refuse"
    with pytest.raises(AsterismError, match="did not change"):
        correction.refuse(change, [10**6])


def test_two_pieces_exchange_their_labels_from_a_frame_on() -> None:
    correction, _ = corrected()
    pieces = correction.pieces
    whole = [int(piece) for piece in pieces.id[(pieces.first == 0) & (pieces.last == 119) & (pieces.marker >= 0)]]
    one, other = whole[:2]
    names = [correction.names[pieces.marker[pieces.place_of(piece)]] for piece in (one, other)]
    correction.apply(Swap(one, other, first=60))
    marker = labels_of_points(correction.labelling, correction.clouds)[0]
    frame = correction.clouds.frame_of
    for piece, own, now in ((one, *names), (other, *names[::-1])):
        points = pieces.of_point == pieces.place_of(piece)
        assert (marker[points & (frame >= 60)] == correction.names.index(now)).all()
        assert (marker[points & (frame < 60)] == correction.names.index(own)).all()


def test_two_markers_exchange_their_labels_in_some_frames() -> None:
    correction, _ = corrected()
    before = correction.labelling.indices.copy()
    one, other = (correction.names.index(name) for name in ("RANK", "LANK"))
    correction.apply(SwapMarkers("RANK", "LANK", 30, 39))
    after = correction.labelling.indices
    both = (before[:, one] >= 0) & (before[:, other] >= 0)
    inside = np.zeros(len(before), dtype=np.bool_)
    inside[30:40] = True
    assert both[30:40].any()
    assert np.array_equal(after[both & inside, one], before[both & inside, other])
    assert np.array_equal(after[~inside, one], before[~inside, one])


def test_a_later_answer_contradicts_an_earlier_one() -> None:
    """Two pieces of the same moment are both said to be the sacrum: the last word holds, and the first is asked for again."""
    correction, _ = corrected()
    pieces = correction.pieces
    whole = [int(piece) for piece in pieces.id[(pieces.first == 0) & (pieces.last == 119)]][:2]
    for piece in whole:
        correction.apply(Name(piece, "SACR"))
    places = [correction.pieces.place_of(piece) for piece in whole]
    assert correction.pieces.person[places].tolist() == [False, True]
    assert correction.pieces.marker[places[1]] == correction.names.index("SACR")


def test_a_cut_keeps_a_name_on_the_side_that_was_named() -> None:
    correction, _ = corrected()
    piece = long_piece(correction)
    correction.apply(Name(piece, "SACR"))
    correction.apply(Cut(piece, 60))
    pieces = correction.pieces
    later = int(pieces.of_point[np.nonzero(correction.clouds.frame_of == 60)[0][0]])
    later = next(place for place in range(len(pieces)) if pieces.first[place] == 60 and not pieces.person[place])
    assert pieces.person[pieces.place_of(piece)] and not pieces.person[later]


@pytest.mark.parametrize(
    ("request_", "said"),
    [
        (Name(10**9, "SACR"), "no piece 1000000000"),
        (Name(-1, "SACR"), "no piece -1"),
        (Name(0, "HEAD\u202e"), "no marker of the model"),
        (Cut(0, 0), "cannot be cut at 0"),
        (Cut(0, 10**9), "cannot be cut"),
        (Swap(0, 0), "with itself"),
        (Swap(0, 1, 5000, 6000), "neither of the two is there"),
        (SwapMarkers("SACR", "nobody", 3), "no marker of the model"),
    ],
)
def test_what_cannot_be_is_refused_and_changes_nothing(request_: Request, said: str) -> None:
    correction, _ = corrected()
    first = correction.labelling
    with pytest.raises(AsterismError, match=said):
        correction.apply(request_)
    assert correction.labelling is first and not correction.touches


def test_a_piece_in_the_middle_of_another_is_no_id() -> None:
    correction, _ = corrected()
    inside = int(np.nonzero(correction.pieces.of_point == 0)[0][5])
    with pytest.raises(AsterismError, match="no piece"):
        correction.apply(Name(inside, "SACR"))


@pytest.mark.parametrize(
    ("plain", "said"),
    [
        ({}, "no kind of answer 'None'"),
        ({"kind": ["name"]}, "no kind of answer"),
        ({"kind": "name", "piece": 0}, "needs the field marker"),
        ({"kind": "name", "piece": "0", "marker": "SACR"}, "give a whole number"),
        ({"kind": "name", "piece": True, "marker": "SACR"}, "give a whole number"),
        ({"kind": "name", "piece": 0, "marker": {"a": 1}}, "give a text"),
        ({"kind": "name", "piece": 0, "marker": "SACR", "__class__": 1}, "has no field"),
        ({"kind": "cut", "piece": 0, "frame": None}, "give a whole number"),
        ({"kind": "swap", "markers": ["A"], "frame": 1}, "two names"),
        ({"kind": "swap", "markers": ["A", "B"]}, "needs the field frame"),
    ],
)
def test_a_request_from_outside_is_checked(plain: dict[str, Any], said: str) -> None:
    with pytest.raises(AsterismError, match=said):
        request_of(plain)


def test_requests_from_outside_are_what_they_say() -> None:
    assert request_of({"kind": "name", "piece": 4, "marker": "SACR"}) == Name(4, "SACR")
    assert request_of({"kind": "swap", "piece": 4, "other": 5, "first": None}) == Swap(4, 5)
    assert request_of({"kind": "swap", "markers": ["A", "B"], "frame": 7}) == SwapMarkers("A", "B", 7)


def test_the_verdict_follows_the_labels() -> None:
    """A walk without gaps is ready; with the wrong half named ghosts nobody should use it."""
    recording, _ = recorded(walks()[4], hidden=0, ghosts=0)
    correction = Correction(model(), recording)
    assert correction.verdict.kind == "ready" and correction.verdict.look_at == 0
    dirty, _ = corrected()
    assert dirty.verdict.kind == "look" and dirty.verdict.look_at > 0
    assert str(dirty.verdict.look_at) in dirty.verdict.sentence
    for item in dirty.items():
        dirty.apply(Right(int(item.points[0])))
    assert dirty.verdict.kind == "ready"
    stretched = replace(recording, positions=recording.positions * np.array([1.0, 1.0, 4.0]))
    assert Correction(model(), stretched).verdict.kind == "do-not-use"


@pytest.mark.parametrize(
    ("samples", "gain", "worth"), [(10, 0.9, False), (10, 1.0, True), (1000, 15.0, False), (1000, 25.0, True), (50, 1.0, True)], ids=str
)
def test_a_piece_is_worth_a_look_by_what_it_gains_and_by_its_share_of_errors(samples: int, gain: float, worth: bool) -> None:
    """At least one sample, and 2 % of a long piece: no model of few people is surer than that."""
    item = ReviewItem(0, samples - 1, 0, 0, "LASI", 1.0 - gain / samples, (), samples, gain, np.arange(samples))
    assert (to_look_at([item]) == [item]) == worth


def test_the_candidates_of_a_piece_have_the_chances_that_the_list_states() -> None:
    """One piece, one chance: the page shows both beside each other."""
    dirty, _ = corrected()
    stated = [item for item in dirty.items() if item.alternatives]
    assert stated
    for item in stated:
        piece = int(dirty.pieces.id[dirty.pieces.of_point[item.points[0]]])
        chances = dict(dirty.candidates(piece))
        assert {name: chances[name] for name, _ in item.alternatives} == pytest.approx(dict(item.alternatives))
        assert sum(chances.values()) <= 1.0 + 1e-9


def test_a_recording_without_points_is_refused() -> None:
    empty = Recording(np.full((5, 2, 3), np.nan), ("*1", "*2"), 100.0)
    with pytest.raises(AsterismError, match="no points"):
        Correction(model(), empty)


def test_the_corrected_recording_says_what_was_done() -> None:
    correction, _ = corrected()
    piece = long_piece(correction)
    correction.apply(Cut(piece, 60))
    correction.apply(Name(piece, "SACR"))
    done = correction.labelled_recording("gait.model")
    assert [step.action for step in done.log] == ["labelled", "corrected"]
    assert dict(done.log[-1].settings) == {"touches": 2, "cut": 1, "name": 1}
    column = done.labels.index("SACR")
    np.testing.assert_array_equal(done.positions[:60, column], correction.recording.positions[:60, correction.clouds.columns[piece]])


def test_a_person_who_knows_the_truth_gets_every_label_right() -> None:
    """They answer the list, from its top, until it is empty."""
    correction, truth = corrected(seed=5)
    for _ in range(100):
        items = correction.items()
        if not items:
            break
        piece = int(items[0].points[0])
        marker = int(truth[piece])
        correction.apply(Ghost(piece) if marker < 0 else Name(piece, correction.names[marker]))
    marker_of = labels_of_points(correction.labelling, correction.clouds)[0]
    assert not correction.items()
    assert np.array_equal(marker_of, truth)


# The log


def logged(folder: Path) -> tuple[Correction, CorrectionLog]:
    correction, _ = corrected()
    log = CorrectionLog(folder / "walk.c3d.asterism-log.jsonl", *correction.identity)
    correction.attach(log)
    return correction, log


def test_a_log_gives_the_same_labels_again(tmp_path: Path) -> None:
    correction, _ = logged(tmp_path)
    piece = long_piece(correction)
    change = correction.apply(Name(piece, "SACR"))
    correction.refuse(change, [next(part.piece for part in change.pieces if not part.by_person)])
    correction.apply(Cut(piece, 40))
    correction.undo()
    correction.close()
    again, _ = logged(tmp_path)
    assert same(again.labelling, correction.labelling) and again.touches == correction.touches
    assert again.can_redo
    again.redo()
    assert again.touches[-1].kind == "cut"
    again.close()


def test_a_torn_last_line_is_dropped_and_told(tmp_path: Path) -> None:
    correction, log = logged(tmp_path)
    correction.apply(Name(long_piece(correction), "SACR"))
    correction.close()
    whole = log.path.read_bytes()
    for torn in (b'{"kind":"gho', b'{"kind":"undo"}'[:-1], b'{"kind":"undo"\n'):
        log.path.write_bytes(whole + torn)
        again, other = logged(tmp_path)
        assert other.dropped and len(again.touches) == 1
        again.undo()
        again.close()
        assert log.path.read_bytes().startswith(whole + b'{"kind":"undo","at"')


def test_a_log_of_another_recording_is_refused_and_of_another_model_goes_on(tmp_path: Path) -> None:
    correction, log = logged(tmp_path)
    log.append({"kind": "saved"})
    correction.close()
    points, label_model = correction.identity
    with pytest.raises(AsterismError, match="another recording"):
        CorrectionLog(log.path, "0" * 64, label_model)
    same = CorrectionLog(log.path, points, label_model)
    same.close()
    other = CorrectionLog(log.path, points, "0" * 64)
    assert not same.other_model and other.other_model and len(other.entries) == 1, "what was said names points, and holds for other labels"
    other.append({"kind": "undo"})
    other.close()
    again = CorrectionLog(log.path, points, "0" * 64)
    assert not again.other_model and [entry["kind"] for entry in again.entries] == ["saved", "relabelled", "undo"]


@pytest.mark.parametrize(
    "line",
    [
        b'{"kind":"redo"}',
        b'{"kind":"name"}',
        b'{"kind":"name","cuts":[],"labels":[{"frame":0,"position":[1e999,0,0],"track":0,"marker":"SACR"}]}',
        b'{"kind":"name","cuts":[],"labels":[{"frame":0,"position":[0,0,0],"track":0,"marker":7}]}',
        b'{"kind":"name","cuts":5,"labels":[]}',
    ],
)
def test_a_damaged_entry_names_its_line(line: bytes, tmp_path: Path) -> None:
    correction, log = logged(tmp_path)
    log.append({"kind": "saved"})
    correction.close()
    log.path.write_bytes(log.path.read_bytes() + b"\n" + line + b"\n")
    other, _ = corrected()
    damaged = CorrectionLog(log.path, *other.identity)
    with pytest.raises(AsterismError, match="line 4"):
        other.attach(damaged)
    damaged.close()


def test_damage_before_the_last_line_is_not_skipped(tmp_path: Path) -> None:
    correction, log = logged(tmp_path)
    correction.apply(Name(long_piece(correction), "SACR"))
    correction.close()
    head, entry, _ = log.path.read_bytes().split(b"\n")
    log.path.write_bytes(b"\n".join([head, entry[:20], entry, b""]))
    with pytest.raises(AsterismError, match="line 2 is damaged"):
        CorrectionLog(log.path, *correction.identity)


def test_one_program_at_a_time_holds_a_log(tmp_path: Path) -> None:
    correction, log = logged(tmp_path)
    correction.apply(Name(long_piece(correction), "SACR"))
    with pytest.raises(AsterismError, match="open in another program"):
        CorrectionLog(log.path, *correction.identity)
    correction.close()
    CorrectionLog(log.path, *correction.identity).close()


def test_where_a_touch_cannot_be_written_it_is_not_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    correction, log = logged(tmp_path)
    log.append({"kind": "saved"})
    first, size = correction.labelling, log.path.stat().st_size
    write = os.write

    def full(file: int, data: bytes) -> int:
        if len(data) > 30:
            return write(file, data[:30])
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "write", full)
    with pytest.raises(AsterismError, match=r"cannot be written \(No space left"):
        correction.apply(Name(long_piece(correction), "SACR"))
    assert correction.labelling is first and not correction.touches and log.path.stat().st_size == size
    monkeypatch.undo()
    correction.apply(Name(long_piece(correction), "SACR"))
    correction.close()
    assert len(logged(tmp_path)[0].touches) == 1


def test_a_point_is_found_again_by_its_place_and_track() -> None:
    correction, _ = corrected()
    touch = Touch("ghost", (), ((PointInFrame(0, (99.0, 0.0, 0.0), 0), None),))
    with pytest.raises(AsterismError, match="another recording"):
        correction.touch(touch)
    entry = json.loads(json.dumps(correction.apply(Right(0)).touches[0].to_plain()))
    assert Touch.from_plain(entry) == correction.touches[0]


KILLED = """
import sys
from pathlib import Path
from asterism import MarkerModel, formats
from asterism.labelling.correction import Correction, CorrectionLog, Name, log_path
file = Path(sys.argv[1])
correction = Correction(MarkerModel.load(sys.argv[2]), formats.read(file))
correction.attach(CorrectionLog(log_path(file), *correction.identity))
pieces = [int(piece) for piece in correction.pieces.id]
while True:
    number = len(correction.touches)
    correction.apply(Name(pieces[number % len(pieces)], correction.names[number % len(correction.names)]))
    print(number + 1, flush=True)
"""


@pytest.mark.skipif(os.name != "posix", reason="a process is killed by a signal")
@pytest.mark.parametrize("kills", [[2], pytest.param([0, 1, 3, 4, 5], marks=pytest.mark.slow)])
def test_a_killed_program_loses_no_touch_that_was_answered(kills: list[int], tmp_path: Path) -> None:
    [file] = written(tmp_path)
    for kill in kills:
        run = subprocess.Popen(
            [sys.executable, "-c", KILLED, str(file), str(tmp_path / "gait.model")],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        assert run.stdout is not None and run.stderr is not None
        answered = [int(run.stdout.readline() or "-1") for _ in range(3)]
        time.sleep(0.013 * kill)
        os.kill(run.pid, signal.SIGKILL)
        answered += [int(line) for line in run.stdout.read().split() if line.isdigit()]
        run.wait()
        run.stderr.close()
        run.stdout.close()
        assert answered[0] > 0
        correction = Correction(model(), formats.read(file))
        log = CorrectionLog(log_path(file), *correction.identity)
        correction.attach(log)
        assert len(correction.touches) in (answered[-1], answered[-1] + 1), "the last one may have been written and not answered"
        correction.close()
