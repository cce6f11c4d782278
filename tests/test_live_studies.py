"""Studies of a stream: the last seconds labelled as a whole, in the push or in a process, against walkers whose truth is known."""

from __future__ import annotations

import gc
import os
import signal
import sys
import threading
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from models import trained

import asterism
from asterism.errors import AsterismError
from asterism.files.processes import FreeCores
from asterism.labelling.live import study_process
from asterism.labelling.live.stream import FrameLabels, Stream, _Frame, _RefinedLabelling
from asterism.labelling.live.study import LEAST_CHANCE, StreamFrames, Study, StudyPlan, StudyRules
from asterism.labelling.live.study_process import StudyProcess, make_studies
from asterism.labelling.live.study_worker import StudyWorker
from asterism.labelling.live.tracks import TrackEvidence
from asterism.labelling.simulated_occlusions import simulate_gaps_and_ghosts
from asterism.recording import NULL, Clouds, Recording
from asterism.simulation import simulate_walks
from asterism.tracking.linking import LinkRules

pytestmark = pytest.mark.kernels

RATE = 100.0
PATIENCE = 120.0


@pytest.fixture(scope="module")
def walks() -> list[Recording]:
    return simulate_walks(subjects=6, frames=200, seed=11)


@pytest.fixture(scope="module")
def model(walks: list[Recording]) -> asterism.MarkerModel:
    return trained(walks[:5], miner=None, subjects=list("abcde"))


@pytest.fixture
def process() -> Iterator[StudyProcess]:
    made = StudyProcess(RATE, StudyRules())
    yield made
    made.close()


def run(stream: Stream, clouds: Clouds) -> list[FrameLabels]:
    out = [frame for points in clouds if (frame := stream.push(points)) is not None]
    return out + stream.flush()


def as_frames(clouds: Clouds, first: int = 0) -> StreamFrames:
    """Frames whose points keep their place: the place is the track."""
    serials = np.concatenate([np.arange(count) for count in clouds.counts])
    return StreamFrames(first, clouds.xyz, clouds.counts, serials)


def test_a_stream_says_what_the_last_seconds_say(walks, model) -> None:
    clouds, truth = simulate_gaps_and_ghosts(walks[5].frames(slice(120)), 0, 6, 2, number_tracks=False)
    shares = {}
    for place in ("none", "push"):
        got = np.array([frame.indices for frame in run(model.stream(RATE, 0, studies=make_studies(place, RATE, model)), clouds)])
        given, right = got >= 0, (got >= 0) & (got == truth)
        shares[place] = right.sum() / (truth >= 0).sum(), (given & ~right).sum() / (truth >= 0).sum()
    assert shares["push"][0] > shares["none"][0] + 0.005, shares
    assert shares["push"][1] <= shares["none"][1], shares


def test_the_first_frame_that_shows_a_person_is_looked_at_by_itself(walks, model) -> None:
    clouds, truth = simulate_gaps_and_ghosts(walks[5].frames(slice(20)), 3, 3, 2, number_tracks=False)
    alone, looked = (model.stream(RATE, studies=make_studies(place, RATE, model)) for place in ("none", "push"))
    for stream in (alone, looked):
        for empty in range(3):
            assert (stream.push(np.zeros((empty, 3))).indices < 0).all()
    plain, better = alone.push(clouds[0]), looked.push(clouds[0])
    given = better.indices >= 0
    assert given.sum() >= 12 and (better.indices == truth[0])[given].all()
    assert (better.confidence > plain.confidence)[given].all()
    # Two hundred reflections would take too long.
    crowd = np.random.default_rng(0).uniform(0, 2, (200, 3))
    looked.flush()
    looked._studies.look = None
    looked.push(crowd)


@pytest.mark.parametrize(("recordings", "given"), [(5, [True, True, False]), (0, [False, True, False])])
def test_labels_of_one_frame_alone_must_be_surer_where_only_virtual_people_taught(model, recordings, given) -> None:
    state = replace(model.state, about=model.about | {"recordings": recordings})
    worker = StudyWorker(asterism.MarkerModel(state), RATE, StudyRules())
    said = Study(0, 1, np.arange(3), np.arange(3), np.array([1, 1, 0]) > 0, np.array([0.9, 0.96, 0.97]), None)
    worker.study = lambda frames: said
    looked = worker.look(np.zeros((3, 3)), np.arange(3))
    # Those that are not sure enough are candidates.
    assert looked.given.tolist() == given and looked.markers.tolist() == [0, 1, 2]


def test_studies_in_pushes_give_the_same_each_time_and_after_a_flush(walks, model) -> None:
    clouds = walks[5].frames(slice(60)).clouds()
    stream = model.stream(RATE, 2, studies="push")
    one, again = run(stream, clouds), run(stream, clouds)
    other = run(model.stream(RATE, 2, studies=make_studies("push", RATE, model)), clouds)
    for first, second, third in zip(one, again, other, strict=True):
        assert first.frame == second.frame == third.frame
        for labels in (second, third):
            np.testing.assert_array_equal(first.indices, labels.indices)
            np.testing.assert_array_equal(first.confidence, labels.confidence)


class Told:
    """Studies that say of each track of the tenth frame what they are told, three frames later."""

    def __init__(self, tell) -> None:
        self.tell, self.found, self.rules = tell, None, StudyRules()

    def add(self, number, xyz, serials, *, unsure) -> None:
        if number == 10:
            self.serials = np.sort(serials)
            self.found = self.tell(xyz, serials, np.argsort(serials))

    def look(self, xyz, serials) -> None:
        return None

    def taken(self, number):
        found, self.found = (self.found, None) if number == 13 else (None, self.found)
        return found

    def restart(self) -> None:
        self.found = None

    def close(self) -> None:
        self.found = None


def test_what_a_study_says_counts_beside_the_frames_of_its_tracks() -> None:
    tracks = TrackEvidence(3, LinkRules(), RATE, 0.9, 0.1)
    tracks.link(np.array([[0.0, 0.0, 1.0], [0.5, 0.0, 1.0], [1.0, 0.0, 1.0], [1.5, 0.0, 1.0]]), [])
    tracks.add(np.full((4, 3), 2.0))
    study = Study(
        0, 1, np.array([0, 1, 2, 7]), np.array([1, NULL, 2, 0]), np.array([1, 0, 0, 1]) > 0, np.array([0.99, 0.0, 0.2, 1.0]), None
    )
    tracks.take(study, 3.0)
    sure = 3.0 * np.log(0.99 / 0.01)
    expected = 2.0 + np.array([[-sure, sure, -sure], [0.0] * 3, [0.0] * 3, [0.0] * 3])
    np.testing.assert_allclose(tracks.totals(tracks.current)[0], expected)
    assert tracks.studied[tracks.current].tolist() == [1, NULL, 2, NULL] and tracks.seen[tracks.current].tolist() == [
        True,
        True,
        True,
        False,
    ]
    # What is held against a track holds until a study gives it the label.
    tracks.exclude(tracks.current[:2], np.array([1]), np.array([4.0]))
    expected[:2, 1] -= 4.0
    np.testing.assert_allclose(tracks.totals(tracks.current)[0], expected)
    tracks.take(study, 3.0)
    expected[0, 1] += 4.0
    np.testing.assert_allclose(tracks.totals(tracks.current)[0], expected)
    tracks.clear(tracks.current[:1])
    assert not tracks.totals(tracks.current[:1])[0].any() and not tracks.seen[tracks.current[0]]


def test_a_doubt_of_a_study_takes_back_a_label_and_a_study_that_is_sure_gives_it(walks, model) -> None:
    clouds = walks[5].frames(slice(14)).clouds()

    def of_stream(given: bool, chance: float) -> FrameLabels:
        def tell(xyz, serials, order):
            markers = found[10].indices
            of_point = np.empty(len(xyz), dtype=np.int64)
            place = np.lexsort((clouds[10][:, 2], clouds[10][:, 1], clouds[10][:, 0]))
            number = np.empty(len(place), dtype=np.int64)
            number[place] = np.arange(len(place))
            of_point[number[markers]] = np.arange(15)
            return Study(10, 300, serials[order], of_point[order], np.full(15, given), np.full(15, chance), None)

        return run(model.stream(RATE, 0, studies=Told(tell)), clouds)[-1]

    found = run(model.stream(RATE), clouds)
    doubted, taken_back, sure = of_stream(False, 0.3), of_stream(False, 0.001), of_stream(True, 1.0)
    assert (found[-1].indices >= 0).all() and (doubted.confidence < found[-1].confidence).all()
    assert (taken_back.confidence < doubted.confidence).all() and (taken_back.indices < 0).any()
    # Two that name one marker, as sure of it as can be, are surer together.
    assert (sure.indices == found[-1].indices).all() and (sure.confidence > 1.0 - LEAST_CHANCE).all()


def test_a_rival_labelling_must_outweigh_what_a_study_gave(walks, model) -> None:
    clouds = list(walks[5].frames(slice(30)).clouds())

    def taken_over(chance: float) -> bool:
        def tell(xyz, serials, order):
            known, of_point = stream._known or stream._chances(stream._tracks.current), np.full(len(xyz), NULL, dtype=np.int64)
            of_point[known[0]] = np.arange(15)
            return Study(10, 300, serials[order], of_point[order], np.ones(15, dtype=np.bool_), np.full(15, chance), None)

        stream = model.stream(RATE, 0, studies=Told(tell))
        for points in clouds:
            stream.push(points)
        carried = _RefinedLabelling(stream._labelled, 100.0, 0)
        # It lacks two of the labels, and is ahead by ten nats more than a rival must be.
        rival = _RefinedLabelling(np.where(np.arange(15) < 2, NULL, carried.point_of), 100.0, 0)
        stream._refined = lambda *_: rival
        frame = _Frame(clouds[-1], model.body_labeller.settings, None)
        return stream._contest(frame, carried, rival.point_of, stream._rules.takeover_margin + 10.0)[0] is rival

    assert taken_over(0.5) and not taken_over(0.99)


def test_a_study_is_forgotten_with_its_tracks(walks, model) -> None:
    stream = model.stream(RATE, studies=make_studies("push", RATE, model))
    for points in walks[5].frames(slice(40)).clouds():
        stream.push(points)
    tracks = stream._tracks
    assert tracks.seen[tracks.current].all() and len(set(tracks.serial[tracks.current])) == 15
    stream._studies.look = lambda *_: None
    for _ in range(50):
        stream.push(np.empty((0, 3)))
    stream.push(walks[5].positions[41])
    assert not tracks.seen[tracks.current].any()
    assert (tracks.serial >= 0).sum() == 15, "rows without a track have no number"


def test_frames_before_everybody_left_are_another_persons(walks, model) -> None:
    worker, clouds = StudyWorker(model, RATE, StudyRules()), walks[5].frames(slice(50)).clouds()
    assert worker.study(as_frames(clouds)).frames == 50
    nobody = StreamFrames(50, np.empty((0, 3)), np.zeros(99, dtype=np.int64), np.empty(0, dtype=np.int64))
    assert worker.study(nobody).frames == 149
    found = worker.study(StreamFrames(149, np.empty((0, 3)), np.zeros(1, dtype=np.int64), np.empty(0, dtype=np.int64)))
    assert found.frames == 1 and not len(found.serials) and found.body is None
    assert worker.study(as_frames(clouds, 150)).frames == 51
    assert worker.study(as_frames(clouds, 900)).frames == 50, "frames are missing between"


def test_a_study_goes_on_with_the_person_whom_it_labelled(walks, model) -> None:
    worker = StudyWorker(model, RATE, StudyRules())
    first, second = walks[5].frames(slice(60)).positions, walks[4].frames(slice(60)).positions + np.array([0.0, 3.0, 0.0])
    alone = worker.study(as_frames(Clouds.from_points(second[:30], RATE)))
    assert alone.given.all()
    # The other person shows all markers, this one two less.
    both = [np.concatenate([two[:13], one]) for one, two in zip(first, second, strict=True)]
    serials = np.concatenate([np.arange(13), np.arange(100, 115)])
    xyz = np.concatenate(both[30:])
    found = worker.study(StreamFrames(30, xyz, np.full(30, 28), np.tile(serials, 30)))
    assert set(found.serials[found.given]) <= set(range(15)) and found.given.sum() >= 12


def test_when_studies_begin() -> None:
    plan, begun = StudyPlan(RATE, StudyRules(window=1.0, growth=2.0, interval=0.5)), []
    for number in range(200):
        plan.add(number, np.zeros((2, 3)), np.array([0, 1]))
        if plan.is_due(unsure=number == 60):
            frames = plan.frames()
            assert frames.first + len(frames.counts) == number + 1 and len(frames.xyz) == 2 * len(frames.counts) <= 200
            begun.append(number)
    assert begun == [0, 1, 3, 7, 15, 31, 60, 110, 160]


def test_a_process_finds_what_the_same_thread_finds_and_ends(walks, model, process, monkeypatch: pytest.MonkeyPatch) -> None:
    # A machine that runs these tests has no core to spare.
    for name in ("_FREE", "_COUNTED", "_REST"):
        monkeypatch.setattr(study_process, name, 0.0)
    process.teach(model)
    clouds, found = walks[5].frames(slice(30)).clouds(), []
    assert process.wait(PATIENCE) and process.taken(0) is None
    for number, points in enumerate(clouds):
        process.add(number, points, np.arange(15), unsure=number in (9, 29))
        assert process.wait(PATIENCE), process.findings()
        found.append(process.taken(number))
    worker, begun = StudyWorker(model, RATE, StudyRules()), 0
    for study in filter(None, found):
        part = clouds.frames(slice(begun, study.last + 1))
        expected = worker.study(as_frames(part, begun))
        begun = study.last + 1
        for name in ("last", "frames", "serials", "markers", "given", "chance"):
            np.testing.assert_array_equal(getattr(study, name), getattr(expected, name))
        # Some of the body follows from the rest, and is made anew.
        assert (study.body is None) == (expected.body is None)
        for own, its in zip(study.body or (), expected.body or (), strict=True):
            np.testing.assert_array_equal(own, its)
    assert found[0] and found[9] and begun == 30 and study.frames == 30 and study.given.all() and study.body is not None
    # What is under way when frames begin anew is not given.
    process.add(30, clouds[0], np.arange(15), unsure=True)
    process.restart()
    assert process.wait(PATIENCE) and process.taken(31) is None
    number = process.process
    process.close()
    assert gone(number)


def gone(process: int | None) -> bool:
    """Whether no process has this number."""
    if process is None or sys.platform == "win32":
        return True
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return True
    return False


@pytest.mark.skipif(sys.platform == "win32", reason="processes are killed by signals")
def test_a_process_that_dies_is_told_and_labels_go_on(walks, model, process) -> None:
    stream = model.stream(RATE, studies=make_studies(process, RATE, model))
    os.kill(process.process, signal.SIGKILL)
    assert not process.wait(PATIENCE)
    (finding,) = stream.findings()
    assert finding.code == "live-no-studies" and "-9" in finding.sentence
    labels = run(stream, walks[5].frames(slice(40)).clouds())
    assert (labels[-1].indices >= 0).all()
    stream.close()
    stream.close()


def test_nobody_who_has_studies_no_more_leaves_a_process(model) -> None:
    stream = model.stream(RATE, studies=make_studies("process", RATE, model))
    number = stream._studies.process
    del stream
    gc.collect()
    assert gone(number)
    assert not [thread for thread in threading.enumerate() if thread.name == "live studies"]


def test_a_place_that_is_none_is_refused(model) -> None:
    assert make_studies("none", RATE, model) is None
    with pytest.raises(AsterismError, match="process, push, none"):
        make_studies("cloud", RATE, model)


def test_a_study_waits_for_a_core_that_nobody_uses(
    walks: list[Recording], model: asterism.MarkerModel, process: StudyProcess, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first begins at once; the next ones when cores are free."""
    free = [0.2]
    monkeypatch.setattr(study_process, "_COUNTED", 0.0)
    monkeypatch.setattr(FreeCores, "count", lambda self: free[0])
    clouds, last = walks[5].clouds(), list[int | None]()
    process.teach(model)
    for number, cores in enumerate((0.2, 0.2, 0.2, 2.0)):
        free[0] = cores
        assert process.wait(PATIENCE)
        process.add(number, clouds[number], np.arange(len(clouds[number])), unsure=True)
        assert process.wait(PATIENCE)
        found = process.taken(number)
        last.append(None if found is None else found.last)
    assert last == [0, None, None, 3] and process.made() == (2, 0.0)
    process.add(4, clouds[4], np.arange(len(clouds[4])), unsure=False)
    assert process.made() == (2, 1.0 / RATE) and not process.findings()


def test_a_person_is_told_where_no_core_was_free_for_long(monkeypatch: pytest.MonkeyPatch) -> None:
    now, waits = [0.0], study_process._Waits()
    monkeypatch.setattr(study_process.time, "monotonic", lambda: now[0])
    waits.begin()
    waits.go_on()
    said = list[str]()
    for now[0] in (1.0, 19.0, 30.0):
        waits.go_on()
        said.append(" ".join(finding.sentence for finding in waits.findings()))
    waits.end()
    # A minute later it was the smaller part of the session.
    now[0] = 90.0
    waits.go_on()
    assert said[:2] == ["", ""] and "for 30 s no processor core was free" in said[2] and not waits.findings()


@pytest.mark.skipif(not hasattr(os, "SCHED_IDLE"), reason="needs a class of processes that runs on idle cores alone")
def test_the_process_lets_every_other_one_go_first(model: asterism.MarkerModel, process: StudyProcess) -> None:
    process.teach(model)
    assert process.wait(PATIENCE) and process.process is not None
    assert os.sched_getscheduler(process.process) == os.SCHED_IDLE


def test_cores_are_counted_that_nobody_uses() -> None:
    free = FreeCores()
    while free.seconds < 0.05:
        pass
    # The system counts in hundredths of a second, so that a core more may seem to be free.
    assert 0.0 <= free.count() <= (os.cpu_count() or 1) + 1.0
