"""Blobs of cameras that are triggered together in; frames of all cameras, by their numbers, out."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from asterism.live.blobs.gathering.arrivals import REMEMBERED, CameraArrivals, RigFrame
from asterism.live.camera_frames import LiveBlobs


class ByNumber:
    """Gathers blobs whose numbers tell which of them are one exposure.

    A frame is whole when each camera that is there has sent it, or a later one. A camera that is late is waited for as long as it was late
    in the last ten seconds, and half as long again, at most 0.1 s; then the frame goes on without it. What comes after that is counted.
    """

    def __init__(self, cameras: int, rate: float = math.nan) -> None:
        self.cameras = [CameraArrivals() for _ in range(cameras)]
        self.image_wait = 0.0
        self._window = 100 if math.isnan(rate) else max(20, round(rate))
        self._open: dict[int, dict[int, LiveBlobs]] = {}
        self._begun: dict[int, float] = {}
        self._gone: int | None = None
        self._due: float | None = None
        """When the oldest frame waits no longer, as `ready` found; None where images came since"""

    def push(self, camera: int, blobs: LiveBlobs) -> float | None:
        """Take the blobs of a camera. Returns when they were taken on the common clock, NaN while that is not known; None if not new."""
        self._due = None
        state, restarts = self.cameras[camera], self.cameras[camera].count.restarts
        if not state.takes(blobs):
            return None
        usual = self._usual()
        # Numbers of a camera that counts otherwise than most say nothing about its exposure.
        if abs(blobs.number - usual) > self._window:
            state.late += 1
            return None
        behind = 0 if self._gone is None else self._gone - usual
        if behind > self._window or (behind > 0 and state.count.restarts > restarts):
            # Most cameras began anew.
            self._open, self._begun, self._gone = {}, {}, None
        begun = self._begun.setdefault(blobs.number, blobs.arrived)
        state.lag.add(blobs.arrived, blobs.arrived - begun)
        while len(self._begun) > REMEMBERED:
            self._begun.pop(next(iter(self._begun)))
        if self._gone is not None and blobs.number <= self._gone:
            state.late += 1
            return blobs.time
        self._open.setdefault(blobs.number, {})[camera] = blobs
        return blobs.time

    def _usual(self) -> int:
        """The number at which most cameras are."""
        numbers = sorted([state.latest for state in self.cameras if state.latest is not None and not state.away])
        return numbers[(len(numbers) - 1) // 2]

    def ready(self, now: float) -> Iterator[RigFrame]:
        """The frames that are whole, or waited long enough, oldest first. now: s on this machine's clock."""
        while self._open:
            number = min(self._open)
            missing = self._missing(number)
            if missing:
                self._due = self._until(number, missing)
                if now < self._due:
                    return
            self._due = None
            taken = self._open.pop(number)
            self._gone = number
            for camera in missing:
                self.cameras[camera].missing()
            yield self._frame(number, taken)

    def due(self) -> float:
        """s on this machine's clock, when the oldest frame waits no longer; infinite where none waits."""
        if not self._open:
            return math.inf
        if self._due is not None:
            return self._due
        number = min(self._open)
        return self._until(number, self._missing(number))

    def _missing(self, number: int) -> list[int]:
        """The cameras that may still send a frame."""
        there = self._open[number]
        return [
            c
            for c, state in enumerate(self.cameras)
            if c not in there and not state.away and (state.latest is None or state.latest < number)
        ]

    def _until(self, number: int, missing: list[int]) -> float:
        return self._begun[number] + max([self.cameras[c].wait for c in missing], default=0.0)

    def _frame(self, number: int, taken: dict[int, LiveBlobs]) -> RigFrame:
        xy, sizes = [np.empty((0, 2))] * len(self.cameras), [np.empty(0)] * len(self.cameras)
        for c, blobs in taken.items():
            xy[c], sizes[c] = blobs.xy, blobs.sizes
        time = float(np.median([blobs.time for blobs in taken.values()]))
        arrived = max(blobs.arrived for blobs in taken.values())
        without = tuple(c for c in range(len(self.cameras)) if c not in taken)
        for c in without:
            self.cameras[c].without += 1
        return RigFrame(number, time, arrived, tuple(xy), tuple(sizes), without)
