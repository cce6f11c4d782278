"""Labelled frames in; angles, strikes and offs, and what steps are like, of the person in them, out."""

from __future__ import annotations

import numpy as np

from asterism.findings import Finding
from asterism.geometry import rotate_z_up
from asterism.live.analysis import FrameAnalysis
from asterism.live.angles import AngleOptions, LiveAngles
from asterism.live.chain import LabelledFrame
from asterism.live.walking.events import LiveEvents
from asterism.live.walking.steps import LiveSteps


class MovementAnalysis:
    """Of a frame all angles that the set of markers allows, the strikes and offs told with it, and the steps up to it.

    A label that is not sure is a missing marker. What is not known is NaN, so that names stay the same once they are known.
    """

    def __init__(self, options: AngleOptions | None = None) -> None:
        options = options or AngleOptions()
        self._up = np.array([0.0, 0.0, 1.0]) if options.vertical is None else options.vertical
        self.angles, self.events, self.steps = LiveAngles(options), LiveEvents(), LiveSteps()
        self._units: dict[str, str] = {}

    def push(self, frame: LabelledFrame) -> FrameAnalysis:
        """See `LiveAnalysis.push`."""
        time, markers = frame.frame.time, frame.markers
        points = frame.places
        values = self.angles.push(time, markers, points)
        events = self.events.push(time, markers, rotate_z_up(points, self._up))
        if self.events.feet:
            steps = self.steps.push(time, events, self.events)
            # All names come at once: a stream of values has its channels from the beginning, and who receives it looks for them once.
            values |= {} if self.angles.are_awaited else steps
        if values.keys() != self._units.keys():
            self._units = {name: self.steps.units.get(name, "degrees") for name in values}
        return FrameAnalysis(values, self._units, tuple(events))

    def findings(self) -> list[Finding]:
        """What a person should know of angles and steps."""
        return [*self.angles.findings(), *self.events.findings()]
