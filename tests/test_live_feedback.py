"""What the person is told while they move: rules, their hysteresis, markers that are missing, and the page that shows and sounds it."""

from __future__ import annotations

import asyncio
import json
import math
import re
import socket
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from browser import Tab, needs_chromium
from hypothesis import given
from hypothesis import strategies as st
from test_live import Given, Kept, Numbers, frames
from test_live_movement import frames_of

import asterism
from asterism import AsterismError
from asterism.cli import main
from asterism.findings import Finding, Severity
from asterism.live import (
    AnalysedFrame,
    AngleOptions,
    Cue,
    Feedback,
    FeedbackRule,
    FrameAnalysis,
    Health,
    LabelledFrame,
    LiveEvent,
    LiveFrame,
    LiveSession,
    MovementAnalysis,
    SessionWatch,
    example_names,
    labels_as_json,
    load_feedback,
    measures,
)
from asterism.live.feedback import _KEYS
from asterism.live.measures import Change
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
    lost = feedback.judge(labelled(leg(140), hidden=(1,), number=1))[0]
    assert math.isnan(lost.value) and not lost.on
    back = feedback.judge(labelled(leg(140), number=10))[0]
    assert back.on and not back.began, "a label that is lost for a tenth of a second is no new beginning"
    assert not feedback.judge(labelled(leg(140), hidden=(1,), number=20))[0].on
    assert feedback.judge(labelled(leg(140), number=50))[0].began, "it begins anew"
    assert feedback.missing(("LKNE", "LANK")) == ["LTHI"]
    unknown = LabelledFrame(LiveFrame(0, 0.0, 0.0, np.zeros((2, 3))), (), np.empty(0, dtype=int), np.empty(0), 0.0)
    assert math.isnan(feedback.judge(unknown)[0].value)


@given(st.floats(-10, 200), st.floats(0, 90), st.floats(1, 90))
def test_a_tone_stays_within_its_pitches(value: float, low: float, more: float) -> None:
    rule = FeedbackRule("knee", "angle", KNEE.markers, above=-1.0, sound="tone", low=low, high=low + more)
    tone = Feedback((rule,)).judge(labelled(leg(min(179.0, max(0.5, value)))))[0].tone
    assert 0.0 <= tone <= 1.0


# Values of the analysis and events, as a session gives them frame by frame.
Frames = Iterator[tuple[float, dict[str, float], tuple[LiveEvent, ...]]]


def told(rules: Sequence[FeedbackRule], frames: Frames) -> list[tuple[float, str, str]]:
    """When which rule begins to tell, and its words."""
    feedback, found = Feedback(rules), list[tuple[float, str, str]]()
    for number, (time_, values, events) in enumerate(frames):
        frame = LabelledFrame(LiveFrame(number, time_, 0.0, np.zeros((0, 3))), NAMES, np.full(4, -1), np.zeros(4), 0.0)
        cues = feedback.judge(frame, FrameAnalysis(values, dict.fromkeys(values, "degrees"), events))
        found.extend((round(time_, 2), cue.rule.name, cue.text) for cue in cues if cue.began)
    return found


def bends(
    depths: Sequence[float], seconds: float = 2.0, least: float = 5.0, name: str = "left knee flexion", rate: float = 100.0
) -> Frames:
    """Knees that bend and stretch, once a depth, with a rest between."""
    for n in range(round(len(depths) * seconds * rate)):
        at, share = divmod(n / rate, seconds)
        bend = math.sin(math.pi * min(1.0, max(0.0, share / seconds * 1.25 - 0.125))) ** 2
        yield n / rate, {name: least + (depths[int(at)] - least) * bend, "right knee flexion": 30 + 35 * bend}, ()


def steps(left: float, right: float, count: int = 12) -> Frames:
    """A walk whose left and right steps take so long; strikes are told 40 ms late, and with them how long the step took and was."""
    strikes, side, at = list[tuple[LiveEvent, float]](), "left", 0.5
    for n in range(2 * count):
        spent = left if side == "left" else right
        strikes.append((LiveEvent("heel strike", side, at, 0.04), spent + 1e-4 * (n % 7)))
        side = "right" if side == "left" else "left"
        at += left if side == "left" else right
    values = {"left step time": math.nan, "right step time": math.nan, "left step length": 0.5, "right step length": 0.6}
    for n in range(round(100 * at)):
        now = [each for each in strikes if int(100 * (each[0].time + 0.04)) == n]
        for event, spent in now:
            values |= {f"{event.side} step time": spent, f"{event.side} step length": (0.5 if event.side == "left" else 0.6) + spent / 1e4}
        yield n / 100, dict(values), tuple(event for event, _ in now)


def test_squats_that_are_not_deep_are_told_and_deep_ones_beep() -> None:
    said = told(load_feedback("squat-depth"), bends([110, 70, 95]))
    assert [(name, text) for _, name, text in said] == [
        ("left knee", "deep enough"),
        ("deepest", "deeper: that was 70°"),
        ("left knee", "deep enough"),
    ]
    assert 0.3 < said[0][0] < 1.0, "on the way down, not after it"
    assert 3.0 < said[1][0] < 4.0


@pytest.mark.parametrize(
    ("bottom", "words"), [(20.0, "saddle lower: knee at 20°"), (32.0, "knee at 32°"), (48.0, "saddle higher: knee at 48°")]
)
def test_the_knee_at_the_bottom_of_each_pedal_stroke_tells_of_the_saddle(bottom: float, words: str) -> None:
    said = told(load_feedback("bike-knee"), bends([105] * 8, seconds=0.7, least=bottom))
    assert {text for _, _, text in said if "bends more" not in text} == {words} and len(said) >= 7
    # The right knee of these strokes is at 30 degrees: 20 is 40 % less, 32 is 6 % more, 48 is 46 % more.
    other = {20.0: {"right knee bends more: -40 %"}, 32.0: set(), 48.0: {"left knee bends more: 46 %"}}[bottom]
    assert {text for _, _, text in said if "bends more" in text} == other


@pytest.mark.parametrize("rest", [0.0, 3.0])
def test_the_tempo_of_a_swing_is_its_way_up_against_its_way_down(rest: float) -> None:
    """Minimum jerk from the ball to the top in 0.9 s, down in 0.3 s, through to 1.9 m; a waggle and a tremble of 2 mm before."""
    rng, points = np.random.default_rng(0), {"LWRA": 0}

    def height(t: float) -> float:
        def jerk(share: float) -> float:
            return share**3 * (10 - 15 * share + 6 * share**2)

        if t < 0.9:
            return 0.8 + 1.0 * jerk(max(0.0, t) / 0.9) + (0.05 * math.sin(4 * t) if -2 < t < 0 else 0.0)
        return 1.8 - 1.0 * jerk((t - 0.9) / 0.3) if t < 1.2 else 0.8 + 1.1 * jerk(min(1.0, (t - 1.2) / 0.4))

    feedback, said = Feedback(load_feedback("golf-tempo")), list[tuple[float, str]]()
    for n in range(round(200 * (rest + 2.5))):
        at = n / 200 - rest
        place = np.array([[0.0, 0.0, height(at) + rng.normal(0, 0.002)]])
        frame = LabelledFrame(LiveFrame(n, n / 200, 0.0, place), tuple(points), np.zeros(1, dtype=int), np.ones(1), 0.0)
        said += [(at, cue.text) for cue in feedback.judge(frame) if cue.began]
    assert len(said) == 1 and said[0][1].endswith(" : 1")
    assert float(said[0][1].split()[0]) == pytest.approx(3.0, abs=0.25)
    assert 1.05 < said[0][0] < 1.2, "as the hands are back at the ball"


@pytest.mark.parametrize(
    ("left", "right", "words"), [(0.55, 0.55, "even"), (0.66, 0.5, "left steps take longer: 28 %"), (0.5, 0.6, "right")]
)
def test_uneven_steps_are_told_by_the_side_that_takes_longer(left: float, right: float, words: str) -> None:
    said = told(load_feedback("gait-symmetry"), steps(left, right))
    assert len(said) == 1 and said[0][2].startswith(words), "once, since it goes on"
    assert said[0][0] == pytest.approx(0.54 + 4 * (left + right) + right, abs=0.03), "five steps of each side are asked for"


def test_symmetry_of_a_value_of_each_step_and_its_change() -> None:
    length = FeedbackRule("length", "symmetry", of="step length", below=-1.0, last=3, text="{value}")
    assert [text for *_, text in told((length,), steps(0.5, 0.5))] == ["-18 %"], "100 (0.5 - 0.6) / 0.55"
    change = replace(length, change="start", over=2.0, above=-0.1, below=0.1)
    assert [text for *_, text in told((change,), steps(0.5, 0.5))] == ["-0 %"], "it does not change"


@pytest.mark.parametrize(("side", "every", "count"), [("left", 1, 12), ("", 1, 24), ("right", 3, 4)])
def test_an_event_is_told_each_time_or_each_third_time(side: str, every: int, count: int) -> None:
    rule = FeedbackRule("strike", "event", of="heel strike", side=side, every=every, sound="beep", text="{value}", hold=0.1)
    said = told((rule,), steps(0.6, 0.6))
    assert len(said) == count and said[0][2] == "–"
    assert {text for *_, text in said[1:]} == {"1.20 s" if side else "0.60 s"}


@pytest.mark.parametrize(("against", "shown"), [("start", 20.0), ("before", 0.0)])
def test_a_change_is_seen_against_the_first_seconds_or_the_last(against: str, shown: float) -> None:
    rule = FeedbackRule("lean", "value", of="trunk flexion", change=against, over=2.0, above=10.0, text="{value}")
    feedback, last = Feedback((rule,)), math.nan
    said = list[float]()
    for n in range(1000):
        value = 5.0 if n < 400 else 25.0
        cue = feedback.judge(labelled(leg(90), number=n), FrameAnalysis({"trunk flexion": value}))[0]
        last = cue.value
        said += [n / 100] if cue.began else []
    assert said == [4.0] and last == pytest.approx(shown, abs=1e-9)
    # Hidden for two seconds: the start is still known, the seconds before are not.
    back = feedback.judge(labelled(leg(90), number=1200), FrameAnalysis({"trunk flexion": 25.0}))[0]
    assert back.value == pytest.approx(20.0) if against == "start" else math.isnan(back.value)


@pytest.mark.parametrize(("which", "expected"), [("highest", 40.0), ("lowest", -40.0), ("range", 80.0), ("tempo", None)])
def test_a_movement_slower_than_what_is_kept_has_its_values_and_no_time(
    monkeypatch: pytest.MonkeyPatch, which: str, expected: float | None
) -> None:
    monkeypatch.setattr(measures, "_MOST_SAMPLES", 50)
    repetitions = measures.Repetitions(which, 10.0)
    found = [repetitions.push(n / 100, 40 * math.sin(n / 300)) for n in range(6000)]
    known = [value for value in found if not math.isnan(value)]
    assert known == [] if expected is None else known[-1] == pytest.approx(expected, abs=0.01)


def test_what_must_last_and_what_is_held() -> None:
    rule = replace(KNEE, hysteresis=0.0, after=0.045, hold=0.195)
    feedback = Feedback((rule,))
    on = [feedback.judge(labelled(leg(140 if n < 4 or 10 <= n < 18 else 160), number=n))[0].on for n in range(60)]
    assert on.index(True) == 15 and on.count(True) == 20, "four frames are too short; then from the sixth on, for 0.2 s"


@pytest.mark.parametrize("jump", [3600.0, -3600.0, 5.0])
def test_a_clock_that_is_set_or_a_long_gap_makes_up_no_repetition(jump: float) -> None:
    """The value falls by 90 degrees across the gap, which is no squat."""
    rule = FeedbackRule("deep", "value", of="left knee flexion", each="highest", swing=30.0)
    way = list(bends([110]))[:100]
    frames = [*way, *((t + jump, values, events) for t, values, events in list(bends([110]))[170:])]
    assert told((rule,), iter(frames)) == []
    assert told((rule,), bends([110])) != [], "it is told without the jump"


@given(
    st.lists(st.tuples(st.floats(0, 3), st.floats()), max_size=120),
    st.sampled_from(["highest", "lowest", "range", "tempo", ""]),
    st.sampled_from(["", "start", "before"]),
)
def test_no_series_of_values_breaks_a_rule(series: list[tuple[float, float]], each: str, change: str) -> None:
    rule = FeedbackRule("any", "value", of="x", above=0.0, each=each, swing=10.0 if each else math.nan, change=change, over=1.0, hold=0.5)
    feedback, now = Feedback((replace(rule, sound="tone", low=0.0, high=1.0), replace(rule, kind="symmetry", of="y"))), 0.0
    for n, (step, value) in enumerate(series):
        now += step - 0.5
        frame = LabelledFrame(LiveFrame(n, now, 0.0, np.zeros((0, 3))), (), np.empty(0, dtype=int), np.empty(0), 0.0)
        for cue in feedback.judge(frame, FrameAnalysis({"x": value, "left y": value, "right y": -value})):
            assert math.isnan(cue.tone) or 0 <= cue.tone <= 1
            assert (not cue.began or cue.on) and not math.isinf(cue.value)


def test_names_that_a_session_lacks_are_said_once_with_the_near_ones() -> None:
    said = list[str]()
    rules = (
        KNEE,
        FeedbackRule("bend", "value", of="left knee flexon"),
        FeedbackRule("even", "symmetry", of="step length", each="range", swing=1.0),
    )
    feedback = Feedback(rules, say=said.append)
    for number in range(700):
        frame = replace(labelled(leg(90), number=number), markers=("LTHY", "LKNE", "LANK", "RANK"))
        feedback.judge(
            frame, FrameAnalysis({"cadence": 100.0} | ({"left knee flexion": 1.0, "right hip flexion": 2.0} if number > 200 else {}))
        )
        if number == 450:
            assert said == ['The rule "knee" is silent: the marker set has no LTHI; near are LTHY.'], "angles come after some seconds"
    assert said[1:] == [
        'The rule "bend" is silent: there is no value left knee flexon; near are left knee flexion, right hip flexion.',
        'The rule "even" is silent: there is no value left step length and no right step length; '
        "steps are found where the marker set has heels, toes and a pelvis.",
    ]
    assert [finding.code for finding in feedback.findings()] == ["live-rule-silent"] * 3
    feedback.judge(frame)
    assert "angles are not found in this session" in said[3]
    alone = Feedback([FeedbackRule(name, "value", of="left knee flexion") for name in ("deep", "deeper")])
    alone.look_at(("LKNE",), ["cadence", "left step length"])
    assert alone.problems == [
        'The rules "deep", "deeper" are silent: there is no value left knee flexion; angles are not found in this session.'
    ]
    assert len({(finding.code, finding.where) for finding in feedback.findings()}) == len(feedback.problems) > 1, "none hides another"


@pytest.mark.kernels
@pytest.mark.parametrize(
    ("file", "rules", "begin", "end", "expected"),
    [
        # The person squats to 98 degrees; angles begin with the second squat.
        ("movement/lab51-multiactivity/squats1.trc", "squat-depth", 0.0, 4.0, ["deep enough"]),
        ("movement/fullbody61/markers_Squat2.trc", "squat-depth", 0.0, 5.0, ["deeper: that was 65°"]),
        # Cut off at the ball: the club goes up as fast as it comes down.
        ("conformance/c3d/sample_16/golf.c3d", "golf-tempo", 0.0, 1.0, ["0.5 : 1", "slower to the top"]),
        ("gait-events/treadmill/vanderzee10.c3d", "gait-symmetry", 0.0, 10.0, ["even"]),
    ],
)
def test_examples_tell_of_real_recordings(data: Path, file: str, rules: str, begin: float, end: float, expected: list[str]) -> None:
    """True labels, so that this judges the rules alone; angles and steps from the live analysis."""
    recording = asterism.read(data / file)
    recording = recording.frames(slice(round(begin * recording.rate), round(end * recording.rate)))
    up = recording.vertical
    analysis = MovementAnalysis(AngleOptions(waits=True, vertical=up))
    # The markers of the golf player have numbers: 2012 is on the wrist.
    feedback = Feedback([replace(rule, markers=("2012",) if rule.markers else ()) for rule in load_feedback(rules)], up)
    said = [cue.text for frame in frames_of(recording) for cue in feedback.judge(frame, analysis.push(frame)) if cue.began]
    assert said == expected and feedback.problems == []


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
    squat = '[[rule]]\nname = "deep"\nvalue = "Left  knee flexion"\neach = "highest"\nswing = 30\nbelow = 90\n'
    path.write_text(squat)
    assert load_feedback(path)[0].of == "left knee flexion" and load_feedback(path)[0].hold == 1.0
    for old, new, sentence in (
        ("swing = 30", "", "rule 1: highest of each repetition needs swing"),
        ("swing = 30", "swing = -3", "rule 1: swing is below 0"),
        ("swing = 30", "swing = inf", "rule 1: swing is inf, no number"),
        ('each = "highest"', 'each = "deepest"', "each is 'deepest'; it is one of highest, lowest"),
        ('each = "highest"', "", "swing goes with each"),
        ('each = "highest"', 'each = "highest"\nafter = 2', "does not last; leave out after"),
        ('each = "highest"', 'each = "highest"\nhysteresis = 2', "does not last; leave out hysteresis"),
        ("below = 90", "below = 90\nlow = 20", 'low is of a tone; add sound = "tone", or leave it out'),
        ('each = "highest"', 'each = "highest"\nlast = 3', "last goes with symmetry, not with value"),
        ('each = "highest"', 'each = "highest"\nchange = "start"', "a change needs over"),
        ('each = "highest"', 'each = ["highest"]', "each is"),
        ('value = "Left  knee flexion"', "value = 3", "value needs a name"),
        ('value = "Left  knee flexion"', 'event = "heel stroke"', "the event is 'heel stroke'; it is one of heel strike"),
        ('value = "Left  knee flexion"', 'event = "toe off"', "event goes with no highest of repetitions; leave out each"),
        ('value = "Left  knee flexion"', 'event = "toe off"\nevery = 0', "every is 0; it is a whole number"),
        ('value = "Left  knee flexion"', 'symmetry = "left step time"', "leave out left"),
        ("below = 90", f"below = 90\n{squat}", 'two rules are called "deep"'),
    ):
        path.write_text(squat.replace(old, new))
        with pytest.raises(AsterismError, match=sentence.replace("'", ".")):
            load_feedback(path)
    with pytest.raises(AsterismError, match="squat is no file and no example; give a TOML file, or one of bike-knee"):
        load_feedback("squat")
    for old, new, sentence in (
        ("below = 150", "", "rule 1: it needs above or below"),
        ('["LTHI", "LKNE", "LANK"]', '["LTHI", "LKNE"]', "rule 1: angle needs 3 marker names"),
        ('["LTHI", "LKNE", "LANK"]', '["LTHI", "LKNE", "lthi"]', "angle is of 3 different markers, and LTHI, LKNE, lthi names one of them"),
        ("above = 0.3", "hysteresis = 0.1", "rule 2: hysteresis is how far a value goes back behind above or below"),
        ('"deep enough"', '"{value}: {value:.1f}"', "rule 1: text has {value:.1f}; it takes {value} alone".replace("{", "[{]")),
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


def test_the_rules_of_the_docs_are_rules(tmp_path: Path) -> None:
    page = (Path(__file__).parents[1] / "docs" / "live-feedback.md").read_text(encoding="utf-8")
    blocks = [block for block in re.findall(r"```toml\n(.*?)```", page, re.DOTALL) if "[[rule]]" in block]
    (tmp_path / "docs.toml").write_text("\n".join(blocks), encoding="utf-8")
    assert len(load_feedback(tmp_path / "docs.toml")) >= 3
    assert all(f"`{name}`" in page for name in example_names())


@given(
    st.dictionaries(
        st.sampled_from([*_KEYS, "else"]),
        st.sampled_from(['"left knee flexion"', '"heel strike"', '"beep"', '"start"', '"highest"', '""', '["A", "B"]', "[]", "{a = 1}"])
        | st.sampled_from(["-1", "0", "3", "0.5", "1e400", "nan", "true", "1979-05-27", "10000000000000000000000"]),
        max_size=9,
    )
)
def test_any_table_is_a_rule_or_refused_in_one_sentence(tmp_path_factory: pytest.TempPathFactory, table: dict[str, str]) -> None:
    path = tmp_path_factory.getbasetemp() / "any.toml"
    path.write_text("[[rule]]\n" + "\n".join(f"{key} = {value}" for key, value in table.items()), encoding="utf-8")
    try:
        rules = load_feedback(path)
    except AsterismError as problem:
        assert str(problem).startswith(f"{path}, rule 1: ") and str(problem).endswith(".")
    else:
        assert Feedback(rules).judge(labelled(leg(90)), FrameAnalysis({"left knee flexion": 3.0}))[0].rule == rules[0]


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

    page, feedback, woken = ToPage(), Feedback((KNEE,)), list[int]()
    end = page.follow(lambda: woken.append(page.last_moment))
    strike = LiveEvent("heel strike", "left", 0.02, 0.01)
    for number, degrees in enumerate((160, 140, 160, 140, 170)):
        frame = replace(labelled(leg(degrees), number=number), done=time.monotonic())
        page.send(AnalysedFrame(frame, FrameAnalysis({"x": math.nan}, events=(strike,) if number == 2 else ()), feedback.judge(frame)))
    assert woken == [1, 2, 3], "what begins does not wait for the next picture"
    found = page.picture(0)
    assert found is not None
    count, content = found[0], json.loads(found[1])
    assert content["frame"] == 4 and content["values"] == [None] and content["cues"] == [[170.0, "170°", 0, None, ""]]
    assert page.picture(count) is None
    last, moments = page.moments(0)
    assert last == 3 and [next(iter(moment)) for moment in moments] == ["cue", "event", "cue"] and page.moments(2)[1] == moments[2:]
    page.send(AnalysedFrame(replace(labelled(leg(140)), done=time.monotonic() - 1.0), cues=feedback.judge(labelled(leg(140), number=9))))
    assert page.moments(3) == (4, []) and page.late == 1, "a sound of a second ago is none, and it is counted"
    end()
    page.close()
    assert len(woken) == 4
    page.sounded([3.0, -1.0, math.nan, "x", None, 1e9, 5.0])
    page.sounded({"a": 1})
    assert page.tone_latency() == pytest.approx((4.0, 4.98, 2))
    known = page.body()
    assert known is not None and known["sides"] == ["left", "left", "left", "right"] and not known["bones"], "lines need more frames"
    for number in range(60):
        page.send(AnalysedFrame(labelled(leg(140 + number % 7), number=number)))
    body = page.body()
    assert body is not None and [0, 1] in [sorted(bone) for bone in body["bones"]] and page.body() is body, "it is told once"
    page.send(AnalysedFrame(replace(labelled(leg(140)), markers=("RTHI", "RKNE", "RANK", "LANK"))))
    other = page.body()
    assert other is not None and other["markers"][0] == "RTHI" and other["sides"][0] == "right", "another marker set is another body"


HEALTH: dict[str, Any] = dict.fromkeys(("rate", "frames", "lost", "late", "damaged", "dropped", "p50", "p999", "not sounded"), 0) | {
    "problems": [],
    "notes": [],
    "pending": "",
}
INK = "({ canvas }) => canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data.some(value => value)"
WELL = HEALTH | {"frames": 1}
MOMENT = """globalThis.hear = (name, age) => {
  const live = Asterism.live, at = live.clock.at(performance.now()) - age, cue = { name, sound: "beep" };
  live.told(JSON.stringify({ sent: at, moments: [{ cue, at, done: at, time: 0 }] }));
  return live.log.length;
};
globalThis.show = age => {
  const live = Asterism.live, at = live.clock.at(performance.now()) - age, cues = [[0.4, "0.40 m", 1, 0.5, ""]];
  live.rules[0].sound = "tone";
  live.told(JSON.stringify({ ...live.newest, at, latency: 0, cues }));
  return live.sounds.tones.has(live.rules[0].name);
};
globalThis.slept = () => {
  const live = Asterism.live, link = live.socket;
  live.heard -= 60000;
  live.tried -= 60000;
  live.watch();
  const state = document.getElementById("state");
  return [state.textContent, live.sounds.tones.size, document.body.className.includes("old"), live.socket === link];
};"""


@needs_chromium
def test_a_tablet_reads_the_address_with_its_camera(tmp_path: Path) -> None:
    pytest.importorskip("segno", reason="QR codes need segno")
    pytest.importorskip("uvicorn")
    cv2 = pytest.importorskip("cv2")
    from asterism.web.live_page import ToPage, serve_live
    from asterism.web.serving import PageAddress

    page, said = ToPage(), list[str]()
    session = LiveSession(Given([]), lambda rate, up: Numbers(), [page])
    stop = serve_live(session, page, PageAddress("0.0.0.0"), said.append)
    address = said[0].rpartition(" ")[2]
    try:
        with Tab(address, 1400, 1400) as tab:
            tab.wait("document.getElementById('code').complete && document.getElementById('code').src")
            tab.value("document.documentElement.dataset.theme = 'dark', document.getElementById('tablet').open = true")
            tab.wait("document.getElementById('state').textContent === 'no frame yet'")
            tab.value("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")  # it is laid out
            tab.picture(tmp_path / "page.png")
            assert tab.value("document.getElementById('address').textContent") == address
    finally:
        stop()
    assert "nothing is encrypted" in said[1]
    picture = cv2.imread(str(tmp_path / "page.png"))
    # OpenCV fails at one code in fifty in one size.
    sizes = [picture, cv2.resize(picture, None, fx=2.0, fy=2.0, interpolation=cv2.INTER_CUBIC)]
    assert address in [cv2.QRCodeDetectorAruco().detectAndDecode(size)[0] for size in sizes]


def test_the_page_tells_what_the_command_tells_with_what_to_do() -> None:
    pytest.importorskip("starlette")
    from asterism.web import live_page

    class Says(Given):
        def findings(self) -> list[Finding]:
            return [
                Finding("live-unit-unknown", Severity.NOTE, "x", "x: no unit.", "Look."),
                Finding("live-lost", Severity.WARNING, "x", "x: lost."),
            ]

    session = LiveSession(Says(frames([0, 1, 2])), lambda rate, up: Numbers(), waits=True)
    assert live_page._plain_health(session, live_page.ToPage())["problems"] == ["x: lost.", "x: no unit. Look."], (
        "before a frame all is wanted"
    )
    session.run()
    session.recorder = cast(Any, SimpleNamespace(problem="x.live: recording ended.", mend="Leave it there."))
    session.watch = watch = SessionWatch("x", timed=False)
    far = LiveFrame(0, 0.0, 0.0, 1000.0 * leg(120))
    for judged in range(3):
        for _ in range(20):
            watch.add(LabelledFrame(far, np.full(4, -1), np.zeros(4), ("A", "B", "C", "D"), 0.0), 1.0)
        told = live_page._plain_health(session, live_page.ToPage())
        assert told["notes"] == ["x: no unit. Look."] and told["problems"][0].startswith("x.live: recording ended. Leave it there.")
        assert len(told["problems"]) == (2 if judged == 0 else 3), "a person may just walk in"
    # What goes missing is said in words where it is more than now and then.
    page = live_page.ToPage()
    counts = [Health(frames=1000, lost=300, late=2), Health(frames=1100, lost=301, late=2), Health(frames=1200, lost=401, late=2)]
    assert [page.missing(each) for each in counts] == [[], [], ["live-lost"]]
    for _ in range(20):
        watch.add(labelled(leg(120)), 1.0)
    assert watch.now == (), "what was mended is not told any more"


class Listener:
    """A page without a browser, which says what it has seen, or does not."""

    def __init__(self, address: str, *, answers: bool) -> None:
        connect = pytest.importorskip("websockets.sync.client").connect
        self.socket = connect(address.replace("http", "ws").replace("/?", "/ws?")).__enter__()
        self.answers = answers

    def next(self, kind: str) -> dict[str, Any]:
        """The next message of a kind; what comes before it is kept."""
        self.before = list[dict[str, Any]]()
        while kind not in (news := json.loads(self.socket.recv(timeout=60))):
            self.before.append(news)
            assert len(self.before) < 100, f"there is no {kind} among a hundred messages"
            self.seen(news)
        self.seen(news)
        return dict(news)

    def seen(self, news: dict[str, Any]) -> None:
        if self.answers and "picture" in news:
            self.socket.send(json.dumps({"seen": news["picture"]}))


def test_what_is_sent_to_the_page_waits_for_no_answer() -> None:
    from asterism.web.serving import PageAddress, bound

    async def sends_at_once() -> int:
        accepted = asyncio.get_running_loop().create_future()
        listening = bound(PageAddress())
        async with await asyncio.start_server(lambda reader, writer: accepted.set_result(writer), sock=listening):
            _, ours = await asyncio.open_connection(*listening.getsockname())
            theirs = await accepted
            at_once = theirs.get_extra_info("socket").getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)
            for writer in (ours, theirs):
                writer.close()
        return int(at_once)

    assert asyncio.run(sends_at_once())


def test_a_page_that_sleeps_holds_nobody_back_and_hears_no_old_sounds(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("uvicorn")
    from asterism.web import live_page
    from asterism.web.serving import PageAddress

    page, said, feedback = live_page.ToPage(), list[str](), Feedback((KNEE,))
    session = LiveSession(Given([]), lambda rate, up: Numbers(), [page], feedback=feedback)
    stop = live_page.serve_live(session, page, PageAddress(), said.append)
    address, number = said[0].rpartition(" ")[2], 0

    def send(degrees: float) -> None:
        nonlocal number
        number += 1
        frame = replace(labelled(leg(degrees), number=number), done=time.monotonic())
        page.send(AnalysedFrame(frame, cues=feedback.judge(frame)))

    try:
        quick, slow, odd = (Listener(address, answers=answers) for answers in (True, False, True))
        send(170)
        for each in (quick, slow, odd):
            each.next("picture")
            told = {kind for news in each.before for kind in news}
            assert {"source", "health", "names", "body"} <= told, "a picture says nothing before its names are known"
        for words in ("{", "[]", '{"seen": "x", "ping": [], "sounded": {"a": 1}}', '{"sounded": [1e999, null]}'):
            odd.socket.send(words)
        odd.socket.send(json.dumps({"ping": 5}))
        assert odd.next("pong")["pong"] == 5, "what is not understood is passed over"
        slow.socket.send('{"seen": 1}')
        for _ in range(6):
            send(170)
            slow.next("picture")
        # As many are under way as can be. A page that was heard a moment ago is only far away.
        monkeypatch.setattr(live_page, "_ASLEEP", 60.0)
        monkeypatch.setattr(live_page, "_STALE", 60.0)
        send(140)
        assert slow.next("moments")["moments"]
        assert quick.next("moments")["moments"]
        monkeypatch.setattr(live_page, "_ASLEEP", 0.0)
        for _ in range(20):
            send(170)
            send(140)
            assert quick.next("moments")["moments"][0]["cue"]["name"] == "knee"
        for _ in range(2):
            slow.next("health")
            assert not any("picture" in news or "moments" in news for news in slow.before)
        # It wakes: what it slept through is old by now.
        monkeypatch.setattr(live_page, "_STALE", 0.0)
        before = page.late
        slow.socket.send('{"seen": 1}')
        slow.next("picture")
        assert page.late == before + 20 and not any("moments" in news for news in slow.before)
        page.close()
        session.stop()
        while not quick.next("health")["health"]["ended"]:
            pass
        with pytest.raises(Exception, match="403"):
            Listener(address.replace("token=", "token=x"), answers=True)
    finally:
        stop()


@needs_chromium
def test_the_page_shows_counts_words_and_markers() -> None:
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
        with Tab(address) as tab:
            tab.wait("document.getElementById('words').textContent === 'far <apart>'")
            tab.wait("document.getElementById('state').textContent.includes('frames/s')")
            tab.wait("document.getElementById('rules').innerText.includes('0.40 m')")
            tab.wait("document.getElementById('missing').textContent === 'none'")
            tab.wait("Asterism.live.drawn > 3 && Asterism.live.curves.charts.length === 1")
            assert tab.value("Asterism.live.port.worker !== null"), "what is drawn delays no sound"
            tab.wait(f"Asterism.drawing.sheets.size === 3 && [...Asterism.drawing.sheets.values()].every({INK})", in_worker=True)
            assert tab.value("Asterism.live.sounds.on") is None, "silent until somebody asks for sound"
            tab.value("document.getElementById('sound').click(); globalThis.loud = Asterism.live.sounds.gain.gain.value")
            tab.wait("Asterism.live.sounds.gain.gain.value > 0.01")
            assert tab.value("Math.max(loud, Asterism.live.sounds.gain.gain.value)") < 0.021, "a fiftieth of the full scale at first"
            tab.wait("Asterism.live.sounds.context.state === 'running' && Asterism.live.clock.isKnown")
            tab.value(MOMENT)
            # A fresh one sounds, one of a minute ago does not; after a sleep none does until the clock is known again.
            assert tab.value("[hear('a', 0), hear('b', 60000), (Asterism.live.heard -= 60000, hear('c', 0))]") == [1, 1, 1]
            tab.wait("Asterism.live.clock.isKnown")
            assert tab.value("[hear('d', 0), hear('d', 0), Asterism.live.missed]") == [2, 2, 2], "no second beep at once"
            tab.value(f"Asterism.live.healthIs({json.dumps(HEALTH | {'silent': True})})")
            assert tab.value("hear('e', 0)") == 3, "a pause of the cameras does not switch the sound off"
            assert tab.value("Asterism.live.sounds.tone('t', 0.5)")
            tab.wait("Asterism.live.sounds.tones.get('t')[1].gain.value > 0.2")
            tab.wait("Asterism.live.sounds.tones.get('t')[1].gain.value < 0.01")  # a tone that nobody keeps up ends
            assert tab.value("[show(60000), show(0), show(60000)]") == [False, True, False], "a tone is of what is done now"
            # What draws has died: sounds go on.
            died = f"Object.assign(Asterism.live.port, {{ taken: -1e6, answeredAt: -1e6 }}); Asterism.live.healthIs({json.dumps(WELL)}); "
            died += "[document.getElementById('state').textContent, show(0)]"
            assert tab.value(died) == ["the browser draws nothing: load the page anew", True]
            # Another curve leaves those that are drawn alone.
            kept = "(named => { const before = $('canvas'); named(); return before.isConnected && before === $('canvas'); })"
            tab.value("globalThis.$ = name => document.querySelector(`.curve ${name}`)")
            names = json.dumps({"values": ["cadence"], "units": ["1/min"], "rules": [{"name": "apart", "unit": "m", "bounds": []}]})
            assert tab.value(f"{kept}(() => Asterism.live.curves.named({names}))"), "the rule is still the first one"
            # A sentence whose numbers grow is changed where it stands: only a new one is read aloud. At once: counts come meanwhile.
            tell = "Asterism.live.healthIs({});".format
            first, second = (
                WELL | {"problems": ["5 lost", "far"], "notes": ["z"]},
                WELL | {"problems": ["6 lost", "near"], "notes": ["z"], "lost": 1},
            )
            lines = "[...document.querySelectorAll(kind)].map(line => [line.textContent, line.old])"
            said = f"['#problems p', '#notes p', 'dd.bad'].map(kind => {lines})"
            mark = "for (const line of document.querySelectorAll('p')) line.old = 1;"
            problems, notes, grown = tab.value(tell(json.dumps(first)) + mark + tell(json.dumps(second)) + said)
            assert problems == [["6 lost", 1], ["near", None]] and notes == [["z", 1]] and ["1", None] in grown
            waits = (
                tell(json.dumps(WELL | {"pending": "it is made"}))
                + "[document.getElementById('hint').textContent, document.body.className]"
            )
            assert tab.value(waits) == ["Nothing is labelled now: it is made.", "old"]
            # The system takes the sound away: no tone goes on when it is back, and who touches the page gets it back.
            tab.value("Asterism.live.sounds.tone('t', 0.5), Asterism.live.sounds.context.suspend()")
            tab.wait("!Asterism.live.sounds.tones.has('t') && !document.getElementById('unheard').hidden")
            for kind in ("mousePressed", "mouseReleased"):
                tab.call("Input.dispatchMouseEvent", type=kind, x=500, y=500, button="left", clickCount=1)
            tab.wait("Asterism.live.sounds.context.state === 'running' && document.getElementById('unheard').hidden")
            # A cable that is out closes nothing: what is shown is old, and the page connects anew.
            assert tab.value("slept()") == ["nothing heard for 60 s", 0, True, False]
            tab.wait("!document.querySelector('.old') && Asterism.live.clock.isKnown")
            tab.resize(390, 844, is_phone=True)
            before = tab.value("[Asterism.live.camera.yaw, Asterism.live.camera.zoom]")
            for kind, apart in (("touchStart", 20), ("touchMove", 60), ("touchEnd", None)):
                points = [] if apart is None else [{"x": 150 - apart, "y": 300}, {"x": 150 + apart, "y": 300}]
                tab.call("Input.dispatchTouchEvent", type=kind, touchPoints=points)
            for kind, x in (("touchStart", 150), ("touchMove", 190), ("touchEnd", None)):
                tab.call("Input.dispatchTouchEvent", type=kind, touchPoints=[] if x is None else [{"x": x, "y": 300}])
            after = tab.value("[Asterism.live.camera.yaw, Asterism.live.camera.zoom]")
            assert after[0] == pytest.approx(before[0] - 0.4) and after[1] == pytest.approx(3 * before[1])
            assert tab.value("document.documentElement.scrollWidth") <= 390
            # The same in a browser whose Workers cannot draw.
            tab.call("Page.enable")
            tab.call("Page.addScriptToEvaluateOnNewDocument", source="delete HTMLCanvasElement.prototype.transferControlToOffscreen")
            tab.call("Page.reload")
            tab.wait("Asterism.live && Asterism.live.port.worker === null && Asterism.live.drawn > 3")
            tab.wait(f"[...Asterism.live.port.drawing.sheets.values()].every({INK})")
        with pytest.raises(urllib.error.HTTPError, match="403") as refused:
            urllib.request.urlopen(urllib.request.Request(address.replace("token=", "token=x"), headers={"Accept": "text/html"}))
        assert refused.value.read().startswith(b"Asterism: the token is missing"), "who opens it reads a sentence"
    finally:
        session.stop()
        running.join(timeout=10)
        stop()


@pytest.mark.kernels
@pytest.mark.usefixtures("without_studies")
def test_the_command_says_what_is_silent_and_how_late_sounds_were(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("uvicorn")
    from asterism.web.live_page import ToPage

    send = ToPage.send
    monkeypatch.setattr(ToPage, "send", lambda page, frame: (send(page, frame), page.sounded([8.0]))[0])
    (tmp_path / "feet.toml").write_text('[[rule]]\nheight = "LHEL"\nabove = 0.1\nsound = "beep"\n')
    asterism.write(tmp_path / "walk.c3d", asterism.simulation.simulate_walks(1, frames=40, seed=1)[0])
    words = ["live", "--replay", str(tmp_path / "walk.c3d"), "--markers", "helen-hayes", "--no-analysis", "--page"]
    assert main([*words, "--feedback", str(tmp_path / "feet.toml"), "--json", str(tmp_path / "out.json")]) == 1
    out, err = capsys.readouterr()
    assert "8 ms, one in a hundred after 8 ms; sound card and loudspeaker add to it" in " ".join(out.split())
    assert err.count('The rule "height of LHEL" is silent: the marker set has no LHEL; near are LHEE, RHEE') == 2, (
        "at the start and the end"
    )
    content = json.loads((tmp_path / "out.json").read_text())
    assert content["tone_ms"] == {"p50": 8.0, "p99": 8.0, "sounds": 40} and content["findings"][0]["code"] == "live-rule-silent"
    assert main([*words, "--feedback", "squat"]) == 2
    assert "squat is no file and no example" in capsys.readouterr().err


@pytest.mark.parametrize("samples", [50, 12_000])
def test_a_change_is_of_the_mean_of_the_seconds_before(monkeypatch, samples) -> None:
    """With a sum that goes along; where more samples come than are kept, of the last of them."""
    monkeypatch.setattr(measures, "_MOST_SAMPLES", samples)
    rng, change, seen = np.random.default_rng(samples), Change("before", 0.5), list[tuple[float, float]]()
    times = np.cumsum(rng.uniform(0.001, 0.012, 500))
    for t, value in zip(times.tolist(), rng.normal(90.0, 40.0, 500).tolist(), strict=True):
        found, before = change.push(t, value), [v for at, v in seen[-samples:] if t - at <= 0.5]
        assert math.isnan(found) if t - times[0] < 0.5 else abs(found - (value - np.mean(before))) < 1e-9
        seen.append((t, value))


def test_an_empty_file_of_rules_says_what_a_rule_is(tmp_path) -> None:
    path = tmp_path / "rules.toml"
    path.write_text("")
    with pytest.raises(AsterismError, match=r"rules\.toml is empty; write a table \[\[rule\]\] for each, with what it tells of"):
        load_feedback(path)
