"""What the person is told while they move: rules, their hysteresis, markers that are missing, and the page that shows and sounds it."""

from __future__ import annotations

import json
import math
import threading
import time
import urllib.error
import urllib.request
from pathlib import Path

import numpy as np
import pytest
from browser import needs_chromium, opened
from hypothesis import given
from hypothesis import strategies as st
from test_live import Given, Kept, Numbers, frames

from asterism import AsterismError
from asterism.live import AnalysedFrame, Cue, Feedback, FeedbackRule, LabelledFrame, LiveFrame, LiveSession, labels_as_json, load_feedback
from asterism.recording import Floats

NAMES = ("LTHI", "LKNE", "LANK", "RANK")


def labelled(points: Floats, hidden: tuple[int, ...] = (), number: int = 0) -> LabelledFrame:
    indices = np.array([-1 if m in hidden else m for m in range(len(points))])
    return LabelledFrame(LiveFrame(number, 0.01 * number, 0.0, points), NAMES, indices, np.ones(len(points)), 0.002)


def leg(degrees: float, apart: float = 0.3) -> Floats:
    """A knee that is bent to this angle, in a body that stands turned."""
    bend = math.radians(degrees)
    turn = np.array([[0.6, -0.8, 0], [0.8, 0.6, 0], [0, 0, 1.0]])
    places = np.array(
        [[0, 0, 0.4], [0, 0, 0], [0.35 * math.sin(bend), 0, 0.35 * math.cos(bend)], [0.35 * math.sin(bend), apart, 0.35 * math.cos(bend)]]
    )
    return places @ turn.T + [1.0, 2.0, 0.5]


KNEE = FeedbackRule("knee", "angle", ("LTHI", "LKNE", "LANK"), below=150.0, hysteresis=5.0, sound="beep")


@pytest.mark.parametrize("degrees", [1.0, 60.0, 90.0, 179.9])
def test_values_are_those_of_geometry(degrees: float) -> None:
    rules = (KNEE, FeedbackRule("apart", "distance", ("LANK", "RANK"), above=1.0), FeedbackRule("low", "height", ("lkne",), below=0.0))
    angle, apart, height = (cue.value for cue in Feedback(rules).judge(labelled(leg(degrees))))
    assert angle == pytest.approx(degrees) and apart == pytest.approx(0.3) and height == pytest.approx(0.5)
    assert Feedback(rules[2:], np.array([0.0, -1.0, 0.0])).judge(labelled(leg(degrees)))[0].value == pytest.approx(-2.0)


def test_a_value_that_trembles_about_the_bound_begins_once() -> None:
    feedback = Feedback((KNEE,))
    told = [feedback.judge(labelled(leg(degrees)))[0] for degrees in (152, 149, 151, 149, 154, 156, 149)]
    assert [cue.on for cue in told] == [False, True, True, True, True, False, True]
    assert [cue.began for cue in told] == [False, True, False, False, False, False, True]


def test_a_marker_without_a_label_says_nothing() -> None:
    feedback = Feedback((KNEE,))
    assert feedback.judge(labelled(leg(140)))[0].on
    lost = feedback.judge(labelled(leg(140), hidden=(1,)))[0]
    assert math.isnan(lost.value) and not lost.on
    assert feedback.judge(labelled(leg(140)))[0].began, "it begins anew"
    assert feedback.missing(("LKNE", "LANK")) == ["LTHI"]
    unknown = LabelledFrame(LiveFrame(0, 0.0, 0.0, np.zeros((2, 3))), (), np.empty(0, dtype=int), np.empty(0), 0.0)
    assert math.isnan(feedback.judge(unknown)[0].value)


@given(st.floats(-10, 200), st.floats(0, 90), st.floats(1, 90))
def test_a_tone_stays_within_its_pitches(value: float, low: float, more: float) -> None:
    rule = FeedbackRule("knee", "angle", KNEE.markers, above=-1.0, sound="tone", low=low, high=low + more)
    tone = Feedback((rule,)).judge(labelled(leg(min(179.0, max(0.5, value)))))[0].tone
    assert 0.0 <= tone <= 1.0


RULES = """
[[rule]]
name = "left knee"
angle = ["LTHI", "LKNE", "LANK"]
below = 150
hysteresis = 5
text = "deep enough"
colour = "green"
sound = "beep"

[[rule]]
height = "LANK"
above = 0.3
low = 0.3
high = 0.6
sound = "tone"
"""


def test_rules_are_read_and_wrong_ones_named(tmp_path: Path) -> None:
    path = tmp_path / "squat.toml"
    path.write_text(RULES)
    knee, ankle = load_feedback(path)
    assert (knee.name, knee.below, knee.text) == ("left knee", 150, "deep enough")
    assert ankle.markers == ("LANK",) and ankle.name == "height of LANK"
    for old, new, sentence in (
        ("below = 150", "", "rule 1: it needs above or below"),
        ('["LTHI", "LKNE", "LANK"]', '["LTHI", "LKNE"]', "rule 1: angle needs 3 marker names"),
        ("below = 150", 'below = "150"', "rule 1: below is '150', no number"),
        ("below = 150", "belwo = 150", "rule 1: belwo is unknown"),
        ('"beep"', '"bang"', "rule 1: sound is 'bang'"),
        ("high = 0.6", "high = 0.1", "rule 2: a tone needs low and high"),
        ('height = "LANK"', 'height = "LANK"\ndistance = ["LANK", "RANK"]', "rule 2: give one of"),
        ("[[rule]]", "[[rules]]", "has no rule"),
        ("[[rule]]", "[[rule", "no TOML"),
    ):
        path.write_text(RULES.replace(old, new))
        with pytest.raises(AsterismError, match=sentence.replace("'", ".")):
            load_feedback(path)


def test_what_is_told_goes_out_with_the_labels() -> None:
    class Heard(Kept):
        def __init__(self) -> None:
            super().__init__()
            self.cues: list[Cue] = []

        def send(self, frame: AnalysedFrame) -> None:
            self.cues.extend(frame.cues)

    heard, rule = Heard(), FeedbackRule("apart", "distance", ("A", "B"), above=5.0)
    LiveSession(Given(frames([0, 1])), lambda rate, up: Numbers(), [heard], waits=True, feedback=Feedback((rule,))).run()
    assert [(cue.on, cue.began) for cue in heard.cues] == [(True, True), (True, False)]
    told = json.loads(labels_as_json(AnalysedFrame(labelled(leg(90)), cues=Feedback((KNEE,)).judge(labelled(leg(90))))))
    assert told["feedback"][0]["value"] == 90.0 and told["feedback"][0]["began"] is True


def test_a_slow_page_gets_the_newest_frame_and_every_beep() -> None:
    pytest.importorskip("starlette")
    from asterism.web.live_page import ToPage

    page, feedback = ToPage(), Feedback((KNEE,))
    for number, degrees in enumerate((160, 140, 160, 140, 170)):
        frame = labelled(leg(degrees), number=number)
        page.send(AnalysedFrame(frame, cues=feedback.judge(frame)))
    found = page.after(0)
    assert found is not None
    count, content = found
    assert content["frame"] == 4 and len(content["began"]) == 2
    assert page.after(count) is None
    assert page.body() is None, "lines are chosen when enough frames were seen"
    for number in range(60):
        page.send(AnalysedFrame(labelled(leg(140 + number % 7), number=number)))
    body = page.body()
    assert body is not None and body["sides"] == ["left", "left", "left", "right"] and [0, 1] in [sorted(bone) for bone in body["bones"]]


@needs_chromium
def test_the_page_shows_counts_words_and_markers(tmp_path: Path) -> None:
    pytest.importorskip("uvicorn")
    from asterism.web.live_page import ToPage, serve_live
    from asterism.web.serving import PageAddress

    class Endless(Given):
        def read(self, timeout: float) -> LiveFrame | None:
            time.sleep(0.005)
            self.number = getattr(self, "number", -1) + 1
            points = leg(120)[:2] + 0.001 * (self.number % 5)
            return LiveFrame(self.number, self.number / 100, time.monotonic(), points)

    page, said = ToPage(), list[str]()
    rule = FeedbackRule("apart", "distance", ("A", "B"), above=0.1, text="far <apart>", colour="red")
    session = LiveSession(Endless([]), lambda rate, up: Numbers(), [page], feedback=Feedback((rule,)))
    stop = serve_live(session, page, PageAddress(), said.append)
    running = threading.Thread(target=session.run)
    running.start()
    try:
        address = said[0].rpartition(" ")[2]
        elements = opened(address, tmp_path, r"far &lt;apart&gt;[\s\S]*<dd>\d")
        assert "frames/s" in elements and "0.400 m" in elements and ">none<" in elements
        with pytest.raises(urllib.error.HTTPError, match="403"):
            urllib.request.urlopen(address.replace("token=", "token=x"))
    finally:
        session.stop()
        running.join(timeout=10)
        stop()
