"""What users, vendors and networks bring: other markers, wrong units, axes and rates, two senders, no times: said, and never mixed in."""

from __future__ import annotations

import json
import socket

import numpy as np
import pytest

from asterism.findings import Finding, Severity
from asterism.live import Health, HostPort, JsonDatagrams, LabelledFrame, LiveFrame, SessionWatch, frame_as_json, session_findings

RATE, MARKERS = 100.0, tuple(f"M{n}" for n in range(20))
BODY = np.random.default_rng(0).uniform((-0.3, -0.3, 0.0), (0.3, 0.3, 1.7), (20, 3))


def watched(
    points: np.ndarray, labelled: int = 20, *, seconds: float = 6.0, comes: float = RATE, slower: float = RATE, up=None, refusal: str = ""
) -> tuple[list[str], list[str]]:
    """Codes that are told while a session runs, and those at its end; comes, slower: frames a second in its first and second half."""
    told = list[str]()
    watch = SessionWatch("lab", up, tell=lambda finding: told.append(finding.code))
    count, arrived = round(seconds * RATE), 50.0
    indices = np.where(np.arange(20) < min(labelled, len(points)), np.arange(20), -1)
    for n in range(count):
        frame = LiveFrame(n, n / RATE, arrived, points)
        names, own = ((), np.empty(0, dtype=np.int64)) if refusal else (MARKERS, indices)
        watch.add(LabelledFrame(frame, names, own, np.ones(len(own)), arrived), RATE, refusal)
        arrived += 1.0 / (comes if n < count / 2 else slower)
    return told, [finding.code for finding in watch.findings()]


@pytest.mark.parametrize(
    ("what", "codes"),
    [
        ({"points": BODY}, []),
        ({"points": np.empty((0, 3)), "labelled": 0}, ["live-no-points"]),
        ({"points": 1000 * BODY, "labelled": 0}, ["live-unit"]),
        ({"points": BODY / 1000, "labelled": 0}, ["live-unit"]),
        ({"points": BODY, "labelled": 2}, ["live-other-markers"]),
        ({"points": BODY, "labelled": 12}, ["live-other-markers"]),
        ({"points": BODY[:12]}, []),
        ({"points": np.concatenate([BODY[:14], BODY[:8] + np.array([1.0, 0.0, 0.0])]), "labelled": 14}, []),
        ({"points": np.concatenate([BODY[:17], BODY[:3] + np.array([0.05, 0.0, 0.0])]), "labelled": 17}, []),
        ({"points": BODY[:3], "labelled": 0}, ["live-few-points"]),
        ({"points": np.tile(BODY, (100, 1))}, ["live-many-points"]),
        ({"points": np.concatenate([BODY, BODY + np.array([1.0, 0.0, 0.0])])}, ["live-second-body"]),
        ({"points": BODY, "refusal": "no shipped set is like it."}, ["live-no-set"]),
        ({"points": BODY, "comes": 240.0, "slower": 240.0}, ["live-rate"]),
        ({"points": BODY[:8]}, ["live-few-points"]),
        ({"points": BODY[:, [0, 2, 1]]}, ["live-vertical"]),
        ({"points": BODY, "slower": 60.0, "seconds": 12.0}, ["live-rate-changed"]),
        ({"points": BODY, "comes": 95.0, "slower": 104.0}, []),
    ],
    ids=[
        "well",
        "none",
        "mm",
        "m",
        "others",
        "half",
        "part",
        "part and reflections",
        "hidden",
        "wand",
        "flood",
        "two",
        "no-set",
        "rate",
        "other-set",
        "lying",
        "slower",
        "busy",
    ],
)
def test_what_is_wrong_with_all_frames_is_said_within_seconds_and_at_the_end(what: dict, codes: list[str]) -> None:
    assert watched(**what) == (codes, codes)


def test_the_axis_along_which_a_body_is_tallest_is_named() -> None:
    watch = SessionWatch("lab", np.array([0.0, 1.0, 0.0]))
    none = np.full(20, -1)
    for n in range(300):
        watch.add(LabelledFrame(LiveFrame(n, n / RATE, n / RATE, BODY), MARKERS, none, np.zeros(20), n / RATE), RATE)
    assert "--vertical z" in watch.findings()[0].mend


def test_frames_from_before_the_set_was_known_say_nothing_of_its_labels() -> None:
    told = list[str]()
    watch = SessionWatch("lab", tell=lambda finding: told.append(finding.code))
    for n in range(200):
        names, own = (MARKERS, np.arange(20)) if n >= 170 else ((), np.empty(0, dtype=np.int64))
        watch.add(LabelledFrame(LiveFrame(n, n / RATE, n / RATE, BODY), names, own, np.ones(len(own)), n / RATE), RATE)
    assert watch.findings() == [] and told == []


def test_a_person_who_walks_in_and_out_is_no_fault() -> None:
    told = list[str]()
    watch = SessionWatch("lab", tell=lambda finding: told.append(finding.code))
    for n in range(1500):
        there = 300 <= n < 1200
        points = BODY if there else BODY[:2]
        own = np.where(there, np.arange(20), -1)
        watch.add(LabelledFrame(LiveFrame(n, n / RATE, n / RATE, points), MARKERS, own, np.ones(20), n / RATE), RATE)
    assert watch.findings() == [] and set(told) <= {"live-few-points"}


def sent(count: int, first: int = 0, step: int = 1, time: float | None = None) -> list[bytes]:
    numbers = range(first, first + count * step, step)
    return [frame_as_json(LiveFrame(n, n / RATE if time is None else time, 0.0, BODY[:2] + n % 5)) for n in numbers]


def taken(source: JsonDatagrams, count: int) -> list[LiveFrame]:
    """So many frames, and what else is there already; fewer where no more come for 10 s."""
    frames: list[LiveFrame] = []
    for _ in range(200):
        frame = source.read(0.05)
        if frame is None and len(frames) >= count:
            break
        frames += [] if frame is None else [frame]
    return frames


def test_of_two_senders_on_one_port_one_is_heard_and_the_other_named() -> None:
    source = JsonDatagrams(HostPort("127.0.0.1", 0), RATE)
    one, other = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
    for mine, theirs in zip(sent(40), sent(40, 7000), strict=True):
        one.sendto(mine, ("127.0.0.1", source.port))
        other.sendto(theirs, ("127.0.0.1", source.port))
    frames = taken(source, 40)
    assert [frame.number for frame in frames] == list(range(40)), "never mixed"
    (finding,) = source.findings()
    assert finding.code == "live-other-sender"
    assert f":{one.getsockname()[1]} is heard" in finding.sentence and f":{other.getsockname()[1]} (40 frames)" in finding.sentence
    # Begun anew after a silence, it comes from another port.
    source._at -= 2.0
    other.sendto(sent(1, 7040)[0], ("127.0.0.1", source.port))
    assert [frame.number for frame in taken(source, 1)] == [7040]
    for each in (one, other):
        each.close()
    source.close()


def test_a_sender_that_opens_a_socket_for_each_frame_is_one_sender() -> None:
    """Also where one of its frames is lost, or comes late."""
    source, numbers = JsonDatagrams(HostPort("127.0.0.1", 0), RATE), [*range(10), 12, 13, 11, *range(14, 20)]
    frames = sent(20)
    senders = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in numbers]
    for number, sender in zip(numbers, senders, strict=True):
        sender.sendto(frames[number], ("127.0.0.1", source.port))
    assert [frame.number for frame in taken(source, len(numbers))] == numbers and source.findings() == []
    for sender in senders:
        sender.close()
    source.close()


def test_a_second_sender_whose_number_is_the_next_one_by_chance_is_not_heard() -> None:
    """As of 100 and 120 Hz that were begun together: each number of the faster one is the next one of the slower, once."""
    source = JsonDatagrams(HostPort("127.0.0.1", 0), RATE)
    one, other = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
    for sender, number in [(one, 5), (other, 4), (one, 6), (other, 7), (other, 8), (one, 7), (one, 8)]:
        sender.sendto(sent(1, number)[0], ("127.0.0.1", source.port))
    assert [frame.number for frame in taken(source, 4)] == [5, 6, 7, 8]
    (finding,) = source.findings()
    assert f"is heard; these were not: 127.0.0.1:{other.getsockname()[1]} (3 frames)" in finding.sentence
    for each in (one, other):
        each.close()
    source.close()


def test_a_sender_that_is_begun_anew_at_another_port_is_not_called_two() -> None:
    source = JsonDatagrams(HostPort("127.0.0.1", 0), RATE)
    one, anew = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
    for sender, first in ((one, 500), (anew, 0)):
        for data in sent(10, first):
            sender.sendto(data, ("127.0.0.1", source.port))
    assert len(taken(source, 10)) == 10
    assert [finding.code for finding in source.findings()] == ["live-new-sender"], "it may be, before the second is over"
    source._at -= 2.0
    anew.sendto(sent(1, 10)[0], ("127.0.0.1", source.port))
    assert [frame.number for frame in taken(source, 1)] == [10]
    (finding,) = source.findings()
    assert finding.code == "live-new-sender" and "10 frames came from a new address" in finding.sentence
    for each in (one, anew):
        each.close()
    source.close()


@pytest.mark.parametrize("rate", [RATE, float("nan")])
def test_frames_without_times_get_some_and_it_is_said(rate: float) -> None:
    source = JsonDatagrams(HostPort("127.0.0.1", 0), rate)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for data in sent(10, time=0.0):
            sender.sendto(data, ("127.0.0.1", source.port))
            assert json.loads(data)["time"] == 0.0
    times = [frame.time for frame in taken(source, 10)]
    assert len(times) == 10 and (np.diff(times) > 0).all()
    assert [finding.code for finding in source.findings()] == ["live-no-times"]
    source.close()


class Says:
    """A source or a watch that has found something."""

    def __init__(self, *codes: str) -> None:
        self.codes = codes

    def findings(self) -> list[Finding]:
        return [Finding(code, Severity.WARNING, "lab", f"lab: {code}.") for code in self.codes]


@pytest.mark.parametrize(
    ("health", "said", "codes"),
    [
        (Health(), [], ["live-silent"]),
        (Health(), ["live-unknown-camera"], ["live-unknown-camera"]),
        (Health(), ["live-unconnected"], ["live-unconnected"]),
        (Health(frames=9, labelled=9, markers=15), ["live-no-points"], ["live-no-points"]),
        (Health(frames=9, labelled=9, markers=15), ["reconstruct-no-points", "live-no-points"], ["reconstruct-no-points"]),
        (Health(frames=9, labelled=9, markers=15, shown=9), ["label-wider-set", "live-other-markers"], ["label-wider-set"]),
        (Health(frames=9, labelled=9, markers=15), ["live-camera-silent", "live-no-points"], ["live-camera-silent"]),
        (Health(frames=9, labelled=9, markers=15), [], ["live-no-labels"]),
        (Health(frames=9, labelled=9, markers=15, shown=9, damaged=4), ["live-format"], ["live-format"]),
        (Health(frames=9, labelled=9, markers=15, shown=9, damaged=4), [], ["live-damaged"]),
    ],
)
def test_who_knows_why_is_heard_and_nobody_says_it_again(health: Health, said: list[str], codes: list[str]) -> None:
    assert [finding.code for finding in session_findings(health, "lab", None, [Says(*said)])] == codes


@pytest.mark.parametrize(("seconds", "pauses", "codes"), [(3.0, (1.0,), []), (3.0, (), []), (3.0, (0.5, 1.0, 1.2, 1.5), ["live-rate"])])
def test_one_pause_of_a_sender_makes_no_other_rate(seconds: float, pauses: tuple[float, ...], codes: list[str]) -> None:
    watch, indices, paused = SessionWatch("lab", None, tell=lambda finding: None), np.arange(20), 0.0
    for n in range(round(seconds * RATE)):
        paused += 3.0 * (n / RATE in pauses)
        frame = LiveFrame(n, n / RATE, 50.0 + n / RATE + paused, BODY)
        watch.add(LabelledFrame(frame, MARKERS, indices, np.ones(20), frame.arrived), RATE, "")
    assert [finding.code for finding in watch.findings()] == codes
