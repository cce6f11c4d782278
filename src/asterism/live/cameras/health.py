"""Images of a camera as they come in; how it does, and what a person should know of it, out."""

from __future__ import annotations

import math
import statistics
import time
import zlib
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from asterism.findings import Finding, Severity
from asterism.live.blobs.camera_clock import CameraClock
from asterism.live.camera_frames import LiveImage
from asterism.live.cameras.camera import LiveCamera
from asterism.live.cameras.settings import SettingOutcome
from asterism.live.clock import FrameCount
from asterism.recording.display import how_often, significant

_EVERY = 4
"""Pixels from one that is looked at to the next, and rows: a sixteenth tells the mean to a hundredth of a grey value. Half of it
takes four times as long; with twice as much a lamp of 20 pixels has six."""
_BLACK = 16
"""Grey values that the brightest pixel of an image with anything in it exceeds: where video calls black 16, no image falls below by itself.
Half of it takes the noise of a covered camera for an image; twice as much takes dim markers for nothing."""
_WHITE = 250
"""Grey value from which a pixel is saturated: JPEG scatters by five about 255. Half and double of the five count as many."""
_SATURATED = 0.02
"""Share of saturated pixels from which an exposure is too long: fifty markers of 12 px cover as much of 640 x 480 px. Half of it is reached
by markers that are near; twice as much leaves out a window of 200 x 60 px."""
_SLOW = 0.9
"""Share of its rate below which a camera is slow. Half as far from 1 is reached by a timer's scatter.

Twice as far leaves out a camera of 60 Hz that gives 50.
"""
_SECOND = 1.0
"""s over which rates and means are taken, and after which images that are black or do not change are told. Half of it tells a hand before
the lens; twice as much comes a second later."""
_LEAST = 6
"""Images by which a rate is told at least, where a second has fewer. Half of them scatter more; twice as many follow a change later."""
_DRIFT_KNOWN = 50.0
"""Millionths that a drift's standard deviation falls below before it is told: half of what is believed of any quartz.

At half of it the drift is told some seconds later; at twice as much it tells nothing.
"""
_TROUBLES = ("black", "frozen", "saturated", "slow")


@dataclass(frozen=True)
class CameraHealth:
    """How a camera does.

    images, late  see `FrameCount`; by the camera's numbers
    lost        images whose numbers are missing, but for those that were not fetched
    dropped     images that were not fetched in time
    damaged     images that could not be read
    reopened    times that it disappeared and came back
    rate        images per second, of the last second
    brightness  mean grey value of 255, of the last second
    saturated   share of saturated pixels, of the last second
    blobs       blobs per image, of the last second; NaN where none are sought
    temperature degrees Celsius, NaN where it does not say
    drift, drift_sd  millionths by which its clock is faster than this machine's, with its standard deviation; NaN where it has no clock, or
                before it is known
    last_seen   s since its last image, infinite before the first
    seconds     s of its images that were "black", "frozen" (the same again and again), "saturated" or "slow" for more than one
    problem     what is wrong now, "" where nothing is
    """

    camera: str
    images: int
    lost: int
    late: int
    dropped: int
    damaged: int
    reopened: int
    rate: float
    brightness: float
    saturated: float
    blobs: float
    temperature: float
    drift: float
    drift_sd: float
    last_seen: float
    seconds: dict[str, float]
    problem: str = ""


@dataclass
class CameraWatch:
    """Looks at each image of a camera for some hundredths of a millisecond. Memory is bounded: a second of numbers."""

    camera: LiveCamera
    _count: FrameCount = field(default_factory=FrameCount)
    _clock: CameraClock = field(default_factory=CameraClock)
    _recent: deque[tuple[float, float, float]] = field(default_factory=lambda: deque(maxlen=1000))
    """(arrived s, mean grey value, share saturated)"""
    _blobs: deque[tuple[float, int]] = field(default_factory=lambda: deque(maxlen=1000))
    _began: float = field(default_factory=time.monotonic)
    _arrived: float = math.nan
    _said_rate: float = math.nan
    """Images per second that the camera says: asking takes as long as an image, in some."""
    _seen: int = 0
    _since: dict[str, float] = field(default_factory=dict)
    """When a trouble began that goes on, s."""
    _seconds: dict[str, float] = field(default_factory=lambda: dict.fromkeys(_TROUBLES, 0.0))

    def __post_init__(self) -> None:
        self._said_rate = self.camera.rate

    def image(self, image: LiveImage) -> None:
        """Look at an image."""
        self._count.takes(image.number)
        few = image.image[::_EVERY, ::_EVERY]
        # Of colours green is the brightest, and there is no need to weigh them.
        few = few if few.ndim == 2 else few[..., 1]
        mean, white = float(few.mean()), float(np.count_nonzero(few >= _WHITE)) / few.size
        seen = zlib.crc32(few.tobytes())
        self._recent.append((image.arrived, mean, white))
        while len(self._recent) > _LEAST and self._recent[0][0] < image.arrived - _SECOND:
            self._recent.popleft()
        before, self._arrived = self._arrived, image.arrived
        long_enough = image.arrived - self._began > _SECOND
        black = int(image.image.max()) < _BLACK
        slow = long_enough and not self.camera.waits and self._usual_step() * _SLOW * self._said_rate > 1.0
        now = {"black": black, "frozen": seen == self._seen and not black, "saturated": white > _SATURATED, "slow": slow}
        self._seen = seen
        for trouble, there in now.items():
            if not there:
                self._since.pop(trouble, None)
                continue
            since = self._since.setdefault(trouble, image.arrived)
            lasts = image.arrived - since
            # What is there in each second image, as in a stream that shows each twice, is none.
            if lasts > _SECOND:
                self._seconds[trouble] += lasts if before - since <= _SECOND else min(image.arrived - before, _SECOND)
        self._clock.observe(image.time, image.arrived)

    def blobs(self, count: int) -> None:
        """Say how many blobs the last image has."""
        self._blobs.append((self._arrived, count))
        while self._blobs[0][0] < self._arrived - _SECOND:
            self._blobs.popleft()

    def health(self, at: float | None = None) -> CameraHealth:
        """How the camera does at a time, s on `time.monotonic`, None for now.

        Asks the camera for its rate and its temperature, from the thread that reads it, so not too often.
        """
        now, camera = time.monotonic() if at is None else at, self.camera
        self._said_rate = camera.rate
        mean, white = (float(np.mean([row[k] for row in self._recent])) if self._recent else math.nan for k in (1, 2))
        counts = [count for when, count in self._blobs if when > now - _SECOND]
        return CameraHealth(
            camera.name,
            self._count.received,
            # An image that was not fetched leaves its number out, too, and is counted once.
            max(0, self._count.lost - camera.dropped),
            self._count.late,
            camera.dropped,
            camera.damaged,
            camera.reopened,
            self._rate(now),
            mean,
            white,
            float(np.mean(counts)) if counts else math.nan,
            camera.temperature,
            *self._drift(),
            now - self._arrived if self._count.received else math.inf,
            dict(self._seconds),
            self._problem(now),
        )

    def _usual_step(self) -> float:
        """s from image to image, which one that is lost does not change; 0 before two are there."""
        arrived = [row[0] for row in self._recent]
        return statistics.median(b - a for a, b in pairwise(arrived)) if len(arrived) > 1 else 0.0

    def _rate(self, now: float) -> float:
        """Images per second, of the last second or the last images."""
        if len(self._recent) < 2:
            return 0.0
        first, last, steps = self._recent[0][0], self._recent[-1][0], len(self._recent) - 1
        # A pause counts as soon as it is longer than two images.
        until = now if now - last > 2 * (last - first) / steps else last
        return 0.0 if now - last > max(_SECOND, last - first) else steps / max(until - first, 1e-6)

    def _drift(self) -> tuple[float, float]:
        known = self.camera.about.clock == "camera" and self._clock.drift_sd_ppm < _DRIFT_KNOWN
        return (-self._clock.drift_ppm, self._clock.drift_sd_ppm) if known else (math.nan, math.nan)

    def _problem(self, now: float) -> str:
        """What is wrong now."""
        camera = self.camera
        if camera.problem:
            return camera.problem
        if now - (self._arrived if self._count.received else self._began) > _SECOND:
            waits = camera.get("trigger") not in (None, "off")
            return "it waits for its trigger." if waits else "no image comes."
        lasting = {trouble for trouble, since in self._since.items() if now - since > _SECOND}
        for trouble, sentence in _SENTENCES.items():
            if trouble in lasting:
                return sentence.format(rate=self._rate(now), of=self._said_rate, white=100 * self._recent[-1][2])
        return ""


_SENTENCES = {
    "black": "its images are black.",
    "frozen": "it gives the same image again and again.",
    "saturated": "{white:.0f} % of its pixels are saturated.",
    "slow": "it gives {rate:.1f} images/s of {of:.1f}.",
}


def camera_findings(healths: Iterable[CameraHealth], outcomes: Iterable[SettingOutcome] = ()) -> Iterator[Finding]:
    """What a person should know of cameras that were watched, and of their settings that are not as they were asked."""
    for outcome in outcomes:
        if not outcome.as_asked:
            severity = Severity.WARNING if outcome.problem else Severity.NOTE
            yield Finding("live-camera-setting", severity, outcome.camera, str(outcome), "Ask for what it can, or leave it out.")
    for health in healths:
        yield from _of_one(health)


def _of_one(health: CameraHealth) -> Iterator[Finding]:
    name, who, seconds = health.camera, f"camera {health.camera}:", health.seconds
    if not health.images or (health.problem and health.last_seen > _SECOND):
        sentence = f"{who} {health.problem or 'no image came.'}"
        mend = "Look at its cable and its power, and whether another program has it."
        yield Finding("live-camera-silent", Severity.ERROR, name, sentence, mend)
    if health.reopened:
        sentence = f"{who} it disappeared {how_often(health.reopened)} and came back."
        yield Finding("live-camera-reopened", Severity.WARNING, name, sentence, "Look at its cable and its power.")
    if health.lost:
        share = significant(100 * health.lost / (health.lost + health.images), 2)
        sentence = f"{who} {health.lost} images never arrived ({share} %)."
        mend = "Look at its cable." if health.reopened else f"{_USB}, or lower its rate or its size."
        yield Finding("live-camera-lost", Severity.WARNING, name, sentence, mend)
    if health.dropped:
        sentence = f"{who} {health.dropped} images were not fetched in time."
        yield Finding("live-camera-dropped", Severity.WARNING, name, sentence, "Close other programs, or lower its rate.")
    if health.damaged:
        sentence = f"{who} {health.damaged} images could not be read."
        yield Finding("live-camera-damaged", Severity.WARNING, name, sentence, "Look at its cable, or try another format.")
    if seconds["slow"] > _SECOND:
        sentence = f"{who} for {seconds['slow']:.0f} s it gave fewer images than its rate."
        yield Finding("live-camera-slow", Severity.WARNING, name, sentence, f"Switch its automatic exposure off. {_USB}.")
    if seconds["black"] > _SECOND:
        sentence = f"{who} for {seconds['black']:.0f} s its images were black."
        yield Finding("live-camera-black", Severity.WARNING, name, sentence, "Look at its lens cap, its light and its exposure.")
    if seconds["frozen"] > _SECOND:
        sentence = f"{who} for {seconds['frozen']:.0f} s the same image came again and again."
        yield Finding("live-camera-frozen", Severity.WARNING, name, sentence, "Take its cable out and in.")
    if seconds["saturated"] > _SECOND:
        sentence = f"{who} for {seconds['saturated']:.0f} s more than a fiftieth of its pixels were saturated."
        mend = "Lower its exposure or its gain, and turn it away from lamps and windows."
        yield Finding("live-camera-saturated", Severity.WARNING, name, sentence, mend)


_USB = "Use the format MJPG, and give it a USB socket that it shares with no other camera"
