"""Angles, strikes and offs of simulated people while they come in, against those of the whole recording."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from asterism.gait import find_events
from asterism.gait.events import OFF, STRIKE
from asterism.live import AngleOptions, FrameAnalysis, LabelledFrame, LiveFrame, MovementAnalysis
from asterism.live._step_kernels import followed
from asterism.motion.clinical import SubjectMeasures, clinical_angles
from asterism.recording import Floats, Recording
from asterism.simulation import simulate_walks

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
    times = np.arange(0.0, given.times[-1], 1.0 / rate)
    columns = given.positions.reshape(len(given), -1)
    resampled = np.stack([np.interp(times, given.times, column) for column in columns.T], axis=1).reshape(len(times), -1, 3)
    recording = Recording(resampled, given.labels, rate)
    told = [event for one in analysed(frames_of(recording)) for event in one.events]
    expected = [event for event in find_events(recording).events if 0.3 < event.time < times[-1] - 0.3]
    assert len(expected) > 20
    for event in expected:
        own = [one for one in told if one.side[0].upper() == event.side and LABELS[one.kind] == event.label]
        nearest = min(own, key=lambda one: abs(one.time - event.time))
        assert abs(nearest.time - event.time) < 0.04
        assert nearest.time + nearest.delay - event.time < (0.06 if event.label == STRIKE else 0.09)
    assert len([event for event in told if 0.3 < event.time < times[-1] - 0.3]) == len(expected)


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
