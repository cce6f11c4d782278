"""Angles, strikes and offs of simulated people while they come in, against those of the whole recording."""

from __future__ import annotations

from functools import cache, partial

import numpy as np
import pytest
from on_the_spot import kicking, marching, pedalling, standing_movements

from asterism.gait import cycles_of, find_events, parameters_of
from asterism.gait.events import OFF, STRIKE
from asterism.live import AngleOptions, FrameAnalysis, LabelledFrame, LiveEvent, LiveFrame, MovementAnalysis
from asterism.live._angle_kernels import nearer_triples
from asterism.live.angles import _SkeletonFrames
from asterism.live.walking._step_kernels import carried_point, followed, nearer_exchanged
from asterism.live.walking.events import LiveEvents
from asterism.live.walking.steps import LiveSteps
from asterism.motion.clinical import SubjectMeasures, clinical_angles
from asterism.recording import Floats, Recording
from asterism.simulation import simulate_walks
from asterism.skeleton import KinematicsRules, PersonRules, fit_person, solve_kinematics

pytestmark = pytest.mark.kernels

LABELS = {"heel strike": STRIKE, "toe off": OFF}


@cache
def walk(markers: str = "helen-hayes") -> Recording:
    """A person who walks to and fro at 100 Hz."""
    return simulate_walks(1, frames=600, markers=markers, seed=3)[0]


def frames_of(recording: Recording, times: Floats | None = None) -> list[LabelledFrame]:
    """Each frame with the labels of its file."""
    found = []
    for number, points in enumerate(recording.positions):
        seen = np.isfinite(points[:, 0])
        indices = np.where(seen, np.cumsum(seen) - 1, -1)
        time = number / recording.rate if times is None else float(times[number])
        frame = LiveFrame(number, time, time, points[seen])
        found.append(LabelledFrame(frame, recording.labels, indices, seen.astype(float), time))
    return found


def told_of(recording: Recording, times: Floats | None = None) -> list[LiveEvent]:
    """The events alone."""
    events, rate = LiveEvents(), recording.rate
    all_times = np.arange(len(recording)) / rate if times is None else times
    told = [events.push(float(time), recording.labels, points) for time, points in zip(all_times, recording.positions, strict=True)]
    assert len(events._kept) <= 4000
    return [event for frame in told for event in frame]


def analysed(frames: list[LabelledFrame], options: AngleOptions | None = None) -> list[FrameAnalysis]:
    """What is known of each frame."""
    analysis = MovementAnalysis(options or AngleOptions(waits=True))
    return [analysis.push(frame) for frame in frames]


def test_angles_are_those_of_the_recording_from_its_own_labels() -> None:
    """Whole body of Plug-in-Gait, with a marker hidden now and then: the same angles, and none where a marker is missing."""
    positions = walk("plug-in-gait").positions.copy()
    positions[300:330, walk("plug-in-gait").labels.index("LKNE")] = np.nan
    recording = Recording(positions, walk("plug-in-gait").labels, 100.0)
    measures = SubjectMeasures().with_values({"InterAsisDistance": 240.0, "LKneeWidth": 110.0})
    outputs = clinical_angles(recording, measures=measures).outputs
    found = analysed(frames_of(recording), AngleOptions(measures=lambda _: (measures, ()), waits=True))
    assert not found[50].values.keys() & {"left knee flexion"}
    names = {
        "left knee flexion": ("LKneeAngles", 0),
        "right hip rotation": ("RHipAngles", 2),
        "left ankle flexion": ("LAnkleAngles", 0),
        "right elbow flexion": ("RElbowAngles", 0),
        "spine bending": ("LSpineAngles", 1),
    }
    for name, (output, column) in names.items():
        live = np.array([one.values[name] for one in found[150:]])
        whole = np.degrees(outputs[output][150:, column])
        assert np.array_equal(np.isnan(live), np.isnan(whole)), name
        assert np.nanmax(np.abs(live - whole)) < 0.1, name
    assert np.isnan(found[310].values["left knee flexion"]) and found[310].units["left knee flexion"] == "degrees"


@pytest.mark.parametrize("rate", [60.0, 100.0, 250.0])
def test_strikes_and_offs_are_told_while_they_happen(rate: float) -> None:
    """All that the whole recording shows but those of its ends, none else, within 60 ms (strikes) of source time."""
    given = walk()
    times = np.arange(0.0, 4.5, 1.0 / rate)
    columns = given.positions.reshape(len(given), -1)
    resampled = np.stack([np.interp(times, given.times, column) for column in columns.T], axis=1).reshape(len(times), -1, 3)
    recording = Recording(resampled, given.labels, rate)
    told = told_of(recording)
    expected = [event for event in find_events(recording).events if 0.3 < event.time < times[-1] - 0.3]
    assert len(expected) > 14
    for event in expected:
        own = [one for one in told if one.side[0].upper() == event.side and LABELS[one.kind] == event.label]
        nearest = min(own, key=lambda one: abs(one.time - event.time))
        assert abs(nearest.time - event.time) < 0.04
        assert nearest.time + nearest.told_after - event.time < (0.06 if event.label == STRIKE else 0.09)
    assert len([event for event in told if 0.3 < event.time < times[-1] - 0.3]) == len(expected)


def moved(change: str) -> tuple[Recording, Floats]:
    """The walk with something done to it, and its times."""
    recording = walk()
    positions, times = recording.positions.copy(), recording.times - recording.times[0]
    rng = np.random.default_rng(4)
    feet = {side: [recording.labels.index(side + name) for name in ("HEE", "TOE", "ANK")] for side in "LR"}
    if change == "hidden heels":
        for first in range(60, 600, 80):
            positions[first : first + 8, recording.labels.index("LHEE")] = np.nan
    elif change == "wrong heels":
        for first in range(60, 600, 50):
            positions[first : first + 9, recording.labels.index("LHEE")] += rng.normal(0.0, 0.2, 3)
    elif change == "exchanged feet":
        for first in range(60, 600, 70):
            part = slice(first, first + 10)
            positions[part, feet["L"]], positions[part, feet["R"]] = positions[part, feet["R"]], positions[part, feet["L"]].copy()
    elif change == "late times":
        times = np.maximum.accumulate(times + np.abs(rng.normal(0.0, 0.003, len(times)))) + 1e-6 * np.arange(len(times))
    elif change == "lost frames":
        kept = rng.random(len(times)) > 0.1
        positions, times = positions[kept], times[kept]
    return Recording(positions, recording.labels, recording.rate), times


@pytest.mark.parametrize("change", ["hidden heels", "wrong heels", "exchanged feet", "late times", "lost frames"])
def test_what_goes_wrong_makes_no_step(change: str) -> None:
    """Nine of ten strikes at least are told as of the whole walk, and none that is not there."""
    expected = [event for event in find_events(walk()).events if event.label == STRIKE and 0.3 < event.time < 5.7]
    told = [event for event in told_of(*moved(change)) if event.kind == "heel strike" and 0.3 < event.time < 5.7]
    near = [[abs(one.time - event.time) for event in expected if event.side == one.side[0].upper()] for one in told]
    assert max(min(own) for own in near) < 0.06
    assert len(told) >= 0.9 * len(expected)


def events_of(positions: Floats, times: Floats | None = None) -> list[LiveEvent]:
    """Of the walk's markers at other places."""
    return told_of(Recording(positions, walk().labels, 100.0), times)


def test_who_squats_lies_or_goes_backwards_makes_no_step() -> None:
    """Feet on the spot while the pelvis goes forth and back by 15 cm; a walk with another axis up; one backwards, also on a treadmill."""
    time = np.arange(600) / 100.0
    still = np.repeat(walk().positions[:1], 600, axis=0)
    hips = [walk().labels.index(name) for name in ("LASI", "RASI", "SACR")]
    squat = still.copy()
    squat[:, hips, :2] += 0.15 * np.sin(2 * np.pi * 0.5 * time)[:, None, None]
    squat[:, hips, 2] -= 0.15 * (1.0 - np.cos(2 * np.pi * 0.5 * time))[:, None]
    assert events_of(squat + np.random.default_rng(0).normal(0.0, 0.0005, squat.shape)) == []
    backwards = walk().positions[::-1].copy()
    assert not [event for event in events_of(backwards) if event.time > 1.0]
    events, lying = LiveEvents(), walk().positions[:, :, [2, 0, 1]]
    assert not any(events.push(float(time), walk().labels, points) for time, points in zip(walk().times, lying, strict=True))
    assert [finding.code for finding in events.findings()] == ["live-not-upright"]
    # The floor moves as the person does: the pelvis stays, and only the feet tell.
    backwards[:, :, :2] -= np.linspace(backwards[0, hips, :2].mean(axis=0), backwards[-1, hips, :2].mean(axis=0), 600)[:, None]
    assert not [event for event in events_of(backwards) if event.time > 3.0]


@pytest.mark.parametrize("name", standing_movements())
def test_feet_that_stay_where_they_are_make_no_step(name: str) -> None:
    """One end of a foot that moves turns about the other."""
    assert told_of(standing_movements()[name]) == []


def test_a_foot_strikes_where_it_comes_down_and_leaves_when_it_moves() -> None:
    """Marching on the spot, and a kick: a foot turns back in the air, and a foot that stands is farthest behind at any time."""
    recording, lands = kicking()
    assert [(event.side, event.kind) for event in told_of(recording)] == [("right", "toe off"), ("right", "heel strike")]
    assert told_of(recording)[1].time == pytest.approx(lands, abs=0.07)
    recording, swings = marching()
    told = told_of(recording)
    for side in "LR":
        for kind, truth in (("toe off", swings[side]), ("heel strike", swings[side] + 0.5)):
            own = np.array([event.time for event in told if event.side[0].upper() == side and event.kind == kind])
            # The first step of a stream may begin before it is known where the foot stands.
            assert len(own) >= len(truth) - 1 and np.abs(own[:, None] - truth).min(axis=1).max() < 0.08, (side, kind)
    assert max(event.told_after for event in told) < 0.15


def test_feet_on_pedals_make_no_steps_once_three_turns_are_seen() -> None:
    assert not [event for event in told_of(pedalling()) if event.time > 3.5]


def test_a_stream_that_begins_anew_goes_on() -> None:
    """A clock set back by an hour, a pause and a clock that hardly goes on: no step is made of it, and memory stays bounded."""
    times = np.arange(600) / 100.0
    again = events_of(walk().positions, np.where(times < 3.0, times + 3600.0, times))
    assert not [event for event in again if not (3600.0 < event.time < 3603.0 or 3.0 < event.time < 6.0)]
    assert len([event for event in again if event.time < 6.0]) > 8
    pause = events_of(np.concatenate([walk().positions[:300], walk().positions[350:]]), np.r_[times[:300], times[350:]])
    assert not [event for event in pause if 3.0 < event.time < 3.5]
    assert events_of(np.concatenate([walk().positions] * 9), np.arange(5400) * 1e-8) == []


def test_steps_are_those_of_the_recording() -> None:
    """Cadence, lengths and times of the last steps, and a symmetry that a longer left step turns up."""
    found = analysed(frames_of(walk()))
    walking = find_events(walk())
    whole = [one for one in parameters_of(walking, cycles_of(walking)) if one.ends < 5.6]
    for name, unit in {"cadence": "steps/min", "walking speed": "m/s"}.items():
        last = next(one.value for one in reversed(whole) if one.name == name)
        assert found[-1].values[name] == pytest.approx(last, rel=0.06) and found[-1].units[name] == unit
    for side in ("left", "right"):
        own = [one.value for one in whole if one.name == "step length" and one.side == side[0].upper()]
        assert found[-1].values[f"{side} step length"] == pytest.approx(own[-1], abs=0.03)
    assert abs(found[-1].values["step length symmetry"]) < 20.0
    longer = LiveSteps()
    for number in range(8):
        side = ("left", "right")[number % 2]
        time = 0.5 * number
        place = 0.6 * number + (0.06 if side == "left" else 0.0)
        event = LiveEvent("heel strike", side, time, 0.0)
        values = longer.push(time, [event], AtPlace(np.array([place, 0.0])))  # type: ignore[arg-type]
    assert values["step length symmetry"] == pytest.approx(200.0 * (0.66 - 0.54) / 1.2)
    assert values["cadence"] == pytest.approx(120.0)
    assert np.isnan(longer.push(time + 3.0, [], AtPlace(np.zeros(2)))["cadence"])  # type: ignore[arg-type]


@pytest.mark.parametrize("change", ["out of view", "elsewhere"])
def test_no_step_is_made_of_what_nobody_saw(change: str) -> None:
    """Who goes out of view and comes back, or is at another place from one frame to the next, made no long step meanwhile."""
    positions = np.concatenate([walk().positions[:275], walk().positions[:275]])
    if change == "out of view":
        positions = walk().positions.copy()
        positions[255:390] = np.nan
    events, steps, told = LiveEvents(), LiveSteps(), set[float]()
    for number, points in enumerate(positions):
        time = number / 100.0
        values = steps.push(time, events.push(time, walk().labels, points), events)
        told |= {values[f"{side} {name}"] for side in ("left", "right") for name in ("step time", "stance time")}
    known = [value for value in told if np.isfinite(value)]
    assert len(known) > 8 and max(known) < 0.9


class AtPlace:
    """Where a toe is, on a floor that stands."""

    belt = np.zeros(2)

    def __init__(self, place: Floats) -> None:
        self._place = place

    def is_followed(self, begin: float, end: float) -> bool:
        """Always."""
        return True

    def toe_at(self, side: str, time: float) -> Floats:
        """(2,) m."""
        return self._place


def test_a_skeleton_follows_frames_as_the_whole_recording_is_solved(monkeypatch: pytest.MonkeyPatch) -> None:
    """Markers without a clinical model: the same coordinates as without smoothing; a hidden arm tells none."""
    # Angles of ten frames are not those of a person; the test asks only whether both ways give the same.
    monkeypatch.setattr("asterism.live.angles.fit_person", partial(fit_person, rules=PersonRules(frames=(0, 10), rounds=2)))
    whole_set = walk("plug-in-gait")
    kept = [name for name in whole_set.labels if name[1:] not in ("THI", "TIB")]
    given = whole_set.select(kept)
    positions = given.positions[:400].copy()
    arm = [column for column, name in enumerate(given.labels) if name in ("LELB", "LWRA", "LWRB", "LFIN", "LUPA", "LFRM")]
    positions[380:, arm] = np.nan
    analysis = MovementAnalysis(AngleOptions(waits=True))
    found = [analysis.push(frame) for frame in frames_of(Recording(positions, given.labels, 100.0))]
    followed_tree = analysis.angles._made
    assert isinstance(followed_tree, _SkeletonFrames)
    tree = followed_tree._followed.tree
    whole = solve_kinematics(tree, Recording(positions, given.labels, 100.0), rules=KinematicsRules(smooth=False))
    for column, coordinate in enumerate(tree.coordinates):
        live = np.array([one.values[coordinate.name] for one in found[320:380]])
        assert np.allclose(live, np.degrees(whole.coordinates[320:380, column]), atol=0.1), coordinate.name
    assert np.isnan(found[-1].values["left elbow flexion"])


def test_triples_of_turns_go_on_from_the_frame_before() -> None:
    """The same rotation, near the last angles, whichever of its two triples came; a hinge and what is hidden stay."""
    rng = np.random.default_rng(4)
    middle = np.array([0, 1, 2, -1, 1])
    last = rng.uniform(-1.4, 1.4, (5, 3))
    near = last + rng.uniform(-0.1, 0.1, (5, 3))
    other = near + np.pi
    other[np.arange(4), middle[:4]] = np.pi - near[np.arange(4), middle[:4]]
    found = (other + np.pi) % (2 * np.pi) - np.pi
    found[4] = np.nan
    hinge, before = found[3].copy(), last.copy()
    nearer_triples(found, middle, last)
    np.testing.assert_allclose(found[:3], near[:3])
    np.testing.assert_array_equal(found[3], hinge)
    np.testing.assert_array_equal(last[:4], found[:4])
    assert np.isnan(found[4]).all() and (last[4] == before[4]).all()
    nearer_triples(near, middle, before)
    np.testing.assert_array_equal(near, before)


def test_a_point_is_the_mean_of_its_markers_and_is_carried_by_the_middle_move_of_its_part() -> None:
    """The twin of the kernel, with all markers, with some hidden, and with none."""
    rng = np.random.default_rng(2)
    columns, part, last = np.array([4, 1]), np.array([1, 2, 4, 5]), rng.normal(size=3)
    for hidden in ([], [2], [1], [2, 5], [1, 2, 4, 5]):
        points, before = rng.normal(size=(6, 3)), rng.normal(size=(4, 3))
        points[hidden] = np.nan
        now, place, carried = np.empty((4, 3)), np.empty(3), np.empty(3)
        apart = carried_point(points, columns, part, before, last, now, place, carried)
        moved = (points[part] - before)[~np.isin(part, hidden)]
        expected = last + (np.median(moved, axis=0) if len(moved) else np.nan)
        np.testing.assert_array_equal(now, points[part])
        np.testing.assert_allclose(place, points[columns].mean(axis=0))
        np.testing.assert_allclose(carried, expected)
        np.testing.assert_allclose(apart, np.abs(place - expected).max())


def test_exchanged_feet_are_nearer_the_other_way_round() -> None:
    """The twin of the kernel; what is not known leaves it open."""
    feet, before, speeds = np.random.default_rng(3).normal(size=(3, 2, 2, 3))
    expected = before + 0.01 * speeds
    same, other = (np.linalg.norm((one - expected).mean(axis=1), axis=1).max() for one in (feet, feet[::-1]))
    assert nearer_exchanged(feet, before, speeds, 0.01) == pytest.approx(same - other)
    assert nearer_exchanged(expected[::-1].copy(), before, speeds, 0.01) > 0.0 > nearer_exchanged(expected, before, speeds, 0.01)
    for given in (feet, before):
        given[1, 0] = np.nan
        assert np.isnan(nearer_exchanged(feet, before, speeds, 0.01))
        given[1, 0] = 0.0


def test_a_filter_of_curves_is_that_of_matrices() -> None:
    """The twin of the kernel, with and without a value."""
    rng = np.random.default_rng(0)
    t, jerk, variance = 0.01, 7.0, 0.3
    turn = np.array([[1.0, t, t * t / 2], [0.0, 1.0, t], [0.0, 0.0, 1.0]])
    noise = jerk * np.array([[t**5 / 20, t**4 / 8, t**3 / 6], [t**4 / 8, t**3 / 3, t**2 / 2], [t**3 / 6, t**2 / 2, t]])
    for values in (rng.normal(size=2), np.full(2, np.nan)):
        state, half = rng.normal(size=(2, 3)), rng.normal(size=(3, 3))
        cov = half @ half.T
        expected, spread = state @ turn.T, turn @ cov @ turn.T + noise
        if np.isfinite(values[0]):
            gain = spread[:, 0] / (spread[0, 0] + variance)
            expected = expected + np.outer(values - expected[:, 0], gain)
            spread = spread - np.outer(gain, spread[0])
        followed(state, cov, t, jerk, values, variance)
        assert np.allclose(state, expected) and np.allclose(cov, spread)
