"""A recording with filled gaps in; how far its events and angles move when the filled samples do, out."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.ndimage import gaussian_filter1d

from asterism.errors import AsterismError
from asterism.gait.events import STRIKE, EventRules, GaitEvent, Walking
from asterism.gait.feet import Feet
from asterism.recording import Floats, Recording

_DRAWS = 24
"""Samples of the fills: their standard deviation is known to 15 %; with half as many to 21 %."""
_STEADY = 0.1
"""s over which errors of a fill go together, as its kernels in time do: at half events move a little more, at double a little less."""

_MOVED = 2e-4
"""m from which an event depends on a fill: filters carry each fill a little into all frames. Half and double flag an event more or less."""


def drawn_fills(recording: Recording, deviation: Floats) -> Iterator[Recording]:
    """The recording again and again, its filled samples displaced by errors of their standard deviation (T, M) m, NaN for measured ones."""
    rng, columns = np.random.default_rng(0), np.flatnonzero(np.isfinite(deviation).any(axis=0))
    width = max(_STEADY * recording.rate, 0.5)
    # what smoothing leaves of white noise
    left = np.sqrt((gaussian_filter1d(np.eye(1, 2 * int(5 * width) + 1, int(5 * width))[0], width) ** 2).sum())
    for _ in range(_DRAWS):
        noise = gaussian_filter1d(rng.standard_normal((len(recording), len(columns), 3)), width, axis=0) / left
        positions = recording.positions.copy()
        positions[:, columns] += np.nan_to_num(deviation[:, columns])[:, :, None] * noise
        yield replace(recording, positions=positions)


def events_with_fills(walking: Walking, draws: Sequence[Recording], find: Callable[[Recording], Walking]) -> Walking:
    """The events, each as much less certain as it moves from draw to draw; those whose heel or toe moves there are flagged as `filled`.

    find  gives the events of a draw. One that half of the draws do not show is uncertain by the time within which two events are the same.
    A load on a plate does not depend on markers
    """
    near, found = EventRules().near, list[Walking]()
    for draw in draws:
        try:
            found.append(find(draw))
        except AsterismError:
            continue
    events = []
    for event in walking.events:
        moved = max((_moved(event, walking.feet, one.feet, near) for one in found), default=0.0)
        if event.source != "markers" or moved < _MOVED:
            events.append(event)
            continue
        apart = [min((one.time - event.time for one in walk.of(event.side, event.label)), key=abs, default=np.inf) for walk in found]
        same = np.array([one for one in apart if abs(one) < near])
        spread = near if 2 * len(same) < len(draws) else float(np.sqrt((same**2).mean()))
        events.append(replace(event, sigma=float(np.hypot(event.sigma, spread)), filled=True))
    return replace(walking, events=tuple(events))


def _moved(event: GaitEvent, feet: Feet, others: Feet, near: float) -> float:
    """m, how far the foot is ahead of the pelvis in one and not in the other, at most, about an event."""
    around = np.abs(feet.times - event.time) < near
    heels = event.label == STRIKE
    one, other = ((each.heels if heels else each.toes).get(event.side) for each in (feet, others))
    if one is None or other is None:
        return 0.0
    return float(np.abs(feet.forward(one) - others.forward(other))[around].max(initial=0.0))


def angles_with_fills(
    angles: Mapping[str, Floats], draws: Sequence[Recording], find: Callable[[Recording], Mapping[str, Floats]]
) -> dict[str, Floats]:
    """By name, (T, 3) rad: the standard deviation of angles from draw to draw; 0 without a filled sample, NaN without an angle."""
    squares = {name: np.zeros_like(values) for name, values in angles.items()}
    for draw in draws:
        found = find(draw)
        for name, values in angles.items():
            apart = found[name] - values
            # An angle near half a turn must not jump by a whole one.
            squares[name] += (apart - 2.0 * np.pi * np.round(apart / (2.0 * np.pi))) ** 2
    return {name: np.sqrt(total / len(draws)) for name, total in squares.items()}
