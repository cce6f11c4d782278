"""Subjects, frames and a marker set in; recordings of walking and standing people, with events, in a room of any vertical, out."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import gaussian_filter1d

from asterism.errors import AsterismError
from asterism.recording import Event, Floats, MarkerSet, Recording, as_vertical
from asterism.simulation.body import Body, markers_of, random_body
from asterism.simulation.gait import FOOT_OFF, pose, random_style, support

PATHS = ("straight", "turn", "curve")
HEIGHTS = (1.30, 1.95)
"""Shortest and tallest subject, in metres."""
NOISE = 0.0005
"""Standard deviation of the measurement per coordinate, in metres."""


def simulate_walks(
    subjects: int = 8,
    frames: int = 300,
    rate: float = 100.0,
    markers: Any = "helen-hayes",
    seed: int = 0,
    trials: int = 1,
    vertical: ArrayLike | str = "z",
) -> list[Recording]:
    """Walks of people of different sizes: straight on, around a corner of 90 degrees, and in a curve.

    subjects  how many people, from 1.30 to 1.95 m tall, each with proportions, marker places and a gait of their own
    trials    walks per person: the paths take turns, speed and start differ
    markers   what `MarkerSet.load` takes; every name must be one that the simulation knows (`simulated_markers`)
    vertical  the axis that points up

    Returns subjects x trials recordings, those of one person one after the other. Positions in metres, nothing missing; measurement
    noise 0.5 mm, skin that slides 2 to 10 mm. Events: "Foot Strike" and "Foot Off" with context "Left" or "Right". Metadata: subject,
    height (m), trial, path. The same arguments give the same recordings, and the same seed the same people (`simulate_standing` too).
    Raises AsterismError where a number is not positive or a marker is not known.

    >>> walk = simulate_walks(subjects=1, frames=60, seed=0)[0]
    >>> walk.positions.shape, walk.labels[:3], walk.metadata["path"]
    ((60, 15, 3), ('RASI', 'LASI', 'SACR'), 'straight')
    """
    _check(subjects=subjects, frames=frames, trials=trials, rate=rate)
    marker_set = MarkerSet.load(markers)
    names, up = markers_of(marker_set), as_vertical(vertical)
    recordings = []
    for person in range(subjects):
        body = _person(seed, person, subjects, names)
        for trial in range(trials):
            # Streams by person and trial: another number of trials leaves the first ones as they were.
            rng = np.random.default_rng([seed, person, 1 + trial])
            path = PATHS[(person + trial) % len(PATHS)]
            positions, events = _walk(body, frames, rate, path, rng, np.random.default_rng([seed, person, 0, 1]))
            facts = {"subject": f"S{person + 1:02d}", "height": round(body.height, 4), "trial": f"walk {trial + 1}", "path": path}
            recordings.append(_recording(positions, marker_set, rate, up, events, facts))
    return recordings


def simulate_standing(
    subjects: int = 8,
    frames: int = 100,
    rate: float = 100.0,
    markers: Any = "helen-hayes",
    seed: int = 0,
    vertical: ArrayLike | str = "z",
) -> list[Recording]:
    """One standing trial of each of the people whom `simulate_walks` makes from the same seed and number of subjects.

    They stand upright with the arms a little away from the body and sway by some millimetres. For arguments, metadata and errors see
    `simulate_walks`; there are no events.

    >>> standing = simulate_standing(subjects=1, frames=50, seed=0)[0]
    >>> bool(np.ptp(standing.positions, axis=0).max() < 0.05)
    True
    """
    _check(subjects=subjects, frames=frames, rate=rate)
    marker_set = MarkerSet.load(markers)
    names, up = markers_of(marker_set), as_vertical(vertical)
    recordings = []
    for person in range(subjects):
        body = _person(seed, person, subjects, names)
        positions = _stand(body, frames, rate, np.random.default_rng([seed, person, 0, 2]))
        facts = {"subject": f"S{person + 1:02d}", "height": round(body.height, 4), "trial": "standing", "path": "none"}
        recordings.append(_recording(positions, marker_set, rate, up, (), facts))
    return recordings


def _person(seed: int, person: int, subjects: int, names: tuple[str, ...]) -> Body:
    """The bodies of one study spread evenly over the heights, in mixed order."""
    rng = np.random.default_rng([seed, person, 0, 0])
    # Heights in equal steps, in mixed order: a few subjects already span the range.
    slot = np.random.default_rng([seed, subjects]).permutation(subjects)[person]
    low, high = HEIGHTS
    return random_body(rng, float(low + (high - low) * (slot + rng.random()) / subjects), names)


def _walk(
    body: Body, frames: int, rate: float, path: str, rng: np.random.Generator, personal: np.random.Generator
) -> tuple[Floats, tuple[Event, ...]]:
    time = np.arange(frames) / rate
    vigour = float(rng.uniform(0.8, 1.12))
    style = random_style(personal, body, vigour)
    leg = body.lengths["thigh"] + body.lengths["shank"]
    # A pendulum: longer legs swing slower.
    cadence = personal.uniform(0.92, 1.05) * np.sqrt(0.9 / leg) * (0.55 + 0.4 * vigour)
    rhythm, wobble = rng.uniform(0, 2 * np.pi), rng.uniform(0.0, 0.012)
    # The rhythm wanders a little, as that of people does.
    phase = rng.random() + cadence * time + wobble * np.sin(2 * np.pi * 0.31 * time + rhythm)
    heading = _heading(path, time, rng)
    turns = []
    # A planted foot keeps its heading; it turns while it swings.
    for shift in (0.0, 0.5):
        stride, within = np.divmod(phase + shift, 1.0)
        planted = np.interp(stride + FOOT_OFF / 2 - shift, phase, heading)
        following = np.interp(stride + 1.0 + FOOT_OFF / 2 - shift, phase, heading)
        swing = np.clip((within - FOOT_OFF) / (1.0 - FOOT_OFF), 0.0, 1.0)
        turns.append(planted + (following - planted) * swing**2 * (3 - 2 * swing) - heading)
    moving = pose(body, style, phase, (turns[0], turns[1]))
    local = _markers(body, moving.segments, phase, rng)

    weight, floor = support(moving.soles, phase)
    spin = np.gradient(heading, time) if frames > 1 else np.zeros(1)
    # The body goes where the feet that carry it do not slide.
    flow = np.gradient(moving.soles, time, axis=0) if frames > 1 else np.zeros_like(moving.soles)
    along = -np.einsum("ts,ts->t", weight, flow[:, :, 0] - spin[:, None] * moving.soles[:, :, 1])
    across = -np.einsum("ts,ts->t", weight, flow[:, :, 1] + spin[:, None] * moving.soles[:, :, 0])
    cos, sin = np.cos(heading), np.sin(heading)
    velocity = np.stack([cos * along - sin * across, sin * along + cos * across], axis=1)
    # Support changes within a few frames; a body does not change its speed as fast.
    velocity = gaussian_filter1d(velocity, sigma=0.1 / cadence * rate, axis=0, mode="nearest")
    track = np.cumsum(velocity, axis=0) / rate
    # The walk's middle near the origin, where cameras look.
    track += rng.uniform(-0.2, 0.2, 2) - track.mean(axis=0)
    room = np.empty_like(local)
    room[:, :, 0] = cos[:, None] * local[:, :, 0] - sin[:, None] * local[:, :, 1] + track[:, :1]
    room[:, :, 1] = sin[:, None] * local[:, :, 0] + cos[:, None] * local[:, :, 1] + track[:, 1:]
    room[:, :, 2] = local[:, :, 2] - floor[:, None]
    return room + rng.normal(0.0, NOISE, room.shape), _events(phase, time)


def _stand(body: Body, frames: int, rate: float, rng: np.random.Generator) -> Floats:
    style = random_style(rng, body, 0.0)
    time = np.arange(frames) / rate
    # Standing: nothing swings, and knees and elbows are nearly straight.
    still = {name: np.zeros_like(series) for name, series in style.series.items()}
    still["pelvis tilt"][0] = style.series["pelvis tilt"][0].real
    still["hip"][0] = still["pelvis tilt"][0] + np.radians(1.0)
    still["knee"][0] = np.radians(rng.uniform(1.0, 5.0))
    still["elbow"][0] = np.radians(rng.uniform(5.0, 25.0))
    upright = type(style)(still, 1.6 * style.step_width, style.toe_out, 0.0, style.lean, style.abduction + np.radians(15.0))
    none = np.zeros(frames)
    standing = pose(body, upright, none, (none, none))
    points = _markers(body, standing.segments, 0.3 * time, rng)
    points[:, :, 2] -= support(standing.soles, none)[1][:, None]
    # The sway grows from the floor up, like that of a pendulum on its head.
    share = points[:, :, 2:] / body.height
    for frequency in (0.21, 0.47):
        points[:, :, :2] += 0.006 * share * np.sin(2 * np.pi * (frequency * time[:, None, None] + rng.random(2)))
    heading = rng.uniform(-np.pi, np.pi)
    turn = np.array([[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]])
    points[:, :, :2] = points[:, :, :2] @ turn.T + rng.uniform(-0.5, 0.5, 2)
    return points + rng.normal(0.0, NOISE, points.shape)


def _heading(path: str, time: Floats, rng: np.random.Generator) -> Floats:
    """(T,) rad: where the walker faces."""
    start, hand = rng.uniform(-np.pi, np.pi), rng.choice([-1.0, 1.0])
    wander = 0.03 * np.sin(2 * np.pi * 0.13 * time + rng.uniform(0, 2 * np.pi))
    # A smooth step: heading and its speed have no jump.
    if path == "turn":
        middle = 0.5 * time[-1] + rng.uniform(-0.2, 0.2)
        done = np.clip((time - middle) / 1.4 + 0.5, 0.0, 1.0)
        return np.asarray(start + wander + hand * 0.5 * np.pi * done**2 * (3 - 2 * done))
    if path == "curve":
        return np.asarray(start + wander + hand * rng.uniform(0.15, 0.45) * time)
    return np.asarray(start + wander)


def _markers(body: Body, segments: dict[str, tuple[Floats, Floats]], phase: Floats, rng: np.random.Generator) -> Floats:
    """(T, M, 3) m: the markers on their segments, with skin that slides in step with the gait and a little out of it."""
    count = len(body.segments)
    out = np.empty((len(phase), count, 3))
    slow = phase * rng.uniform(0.2, 0.6) + rng.random()
    # Twice a cycle and once a cycle, and a course that the gait does not explain.
    basis = np.stack([f(2 * np.pi * k * x) for k, x in ((1, phase), (2, phase), (1, slow)) for f in (np.sin, np.cos)], axis=1)
    shares = np.array([0.6, 0.6, 0.35, 0.35, 0.3, 0.3])[:, None, None] * body.slides[None, :, None]
    sliding = np.einsum("tb,bmx->tmx", basis, rng.normal(size=(len(shares), count, 3)) * shares)
    for segment in dict.fromkeys(body.segments):
        markers = [i for i, name in enumerate(body.segments) if name == segment]
        rotation, origin = segments[segment]
        out[:, markers] = (body.places[markers] + sliding[:, markers]) @ rotation.swapaxes(1, 2) + origin[:, None]
    return out


def _events(phase: Floats, time: Floats) -> tuple[Event, ...]:
    """Foot strikes at whole cycles, foot offs at `FOOT_OFF` of them, in order of time; s on the recording's clock."""
    events = []
    for side, shift in (("Left", 0.0), ("Right", 0.5)):
        for label, share in (("Foot Strike", 0.0), ("Foot Off", FOOT_OFF)):
            # Only events within the recording.
            cycles = np.arange(np.ceil(phase[0] + shift - share), np.floor(phase[-1] + shift - share) + 1)
            events += [Event(label, float(at), side) for at in np.interp(cycles + share - shift, phase, time)]
    return tuple(sorted(events, key=lambda event: (event.time, event.context)))


def _recording(
    positions: Floats, marker_set: MarkerSet, rate: float, up: Floats, events: tuple[Event, ...], facts: dict[str, Any]
) -> Recording:
    """The recording in a room whose vertical is `up`: x, y, z are turned, never mirrored."""
    ahead = np.zeros(3)
    # The next axis after the vertical: x, y, z keep their turn, so nothing is mirrored.
    ahead[(int(np.argmax(np.abs(up))) + 1) % 3] = 1.0
    ahead -= up * (ahead @ up)
    ahead /= np.linalg.norm(ahead)
    axes = np.stack([ahead, np.cross(up, ahead), up])
    metadata = {"file": f"simulated {facts['subject']} {facts['trial']}", "format": "simulated", "units": "m", **facts}
    return Recording(positions @ axes, marker_set.names, rate, up, events, metadata)


def _check(**numbers: float) -> None:
    for name, number in numbers.items():
        if not number > 0:
            raise AsterismError(f"{name} is {number}; it must be greater than 0.")
