"""A camera that may disappear in; one that comes back with numbers and times that go on, out."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from dataclasses import replace

from asterism.errors import sentence_of
from asterism.live.addresses import without_password
from asterism.live.camera_frames import LiveImage
from asterism.live.cameras.camera import CameraAbout, CameraGone, LiveCamera
from asterism.live.cameras.settings import SettingOutcome, SettingValue
from asterism.live.frames import SourceEnded

_EVERY = 1.0
"""s from one try to open the camera again to the next. Half of it asks a system twice for nothing; with twice as much a camera that is
plugged in again is missing for a second longer."""
_SILENT, _PERIODS = 2.0, 20
"""s without an image, and at least so many images' time, after which a camera that raises nothing counts as gone all the same: drivers of
network cameras notice no cable. Half of it takes a machine that was busy for a lost camera; with twice as much it is missing for 4 s."""


class ReopeningCamera(LiveCamera):
    """A camera that is opened again, with its settings, when it has disappeared.

    What was missed counts in the numbers, by the rate, so that it is told as lost. A camera whose own clock began anew goes on in time.
    A camera that waits for its trigger is not gone.

    reopened  times that it came back
    problem   why it is gone now, "" while it is there
    """

    def __init__(self, open_: Callable[[], LiveCamera]) -> None:
        self._open = open_
        self._inner: LiveCamera | None = open_()
        super().__init__(self._inner.name, self._inner.address)
        self._about, self._own, self.outcomes = self._inner.about, self._inner.own_settings, self._inner.outcomes
        self._set: dict[str, SettingValue] = {}
        self._dropped_before = self._damaged_before = 0
        self._next_try, self._quiet_since = 0.0, time.monotonic()
        self._at: float | None = None
        self._started, self._closed = False, threading.Event()
        self._last: LiveImage | None = None
        self._came_back, self._numbers_on, self._times_on = False, 0, 0.0

    @property
    def about(self) -> CameraAbout:
        """What is known of it; while it is gone, what was."""
        if self._inner is not None:
            self._about = self._inner.about
        return self._about

    @property
    def own_settings(self) -> tuple[str, ...]:
        """The names of what can be asked of the camera itself."""
        return self._own

    @property
    def temperature(self) -> float:
        """Degrees Celsius within the camera, NaN where it does not say."""
        return math.nan if self._inner is None else self._inner.temperature

    def get(self, name: str) -> SettingValue | None:
        """What a setting is; None while it is gone."""
        return None if self._inner is None else self._inner.get(name)

    def get_own(self, name: str) -> SettingValue | None:
        """The same."""
        return self.get(name)

    def set(self, name: str, value: object) -> SettingOutcome:
        """Set a setting, now and whenever the camera comes back."""
        if self._inner is None:
            raise CameraGone(self.problem)
        outcome = self._inner.set(name, value)
        if not outcome.problem:
            self._set[name] = outcome.asked
        return outcome

    def set_own(self, name: str, value: SettingValue) -> None:
        """The same."""
        self.set(name, value)

    def start(self, at: float | None = None) -> None:
        """Begin with images."""
        self._at = time.monotonic() if at is None else at
        self._started, self._quiet_since = True, self._at
        if self._inner is not None:
            self._inner.start(self._at)

    def stop(self) -> None:
        """No images any more."""
        self._started = False
        if self._inner is not None:
            self._inner.stop()

    def close(self) -> None:
        """Let go of it."""
        self._closed.set()
        if self._inner is not None:
            self._inner.close()

    def read(self, timeout: float) -> LiveImage | None:
        """The next image; None while it is gone. Raises SourceEnded at the end of a file."""
        if self._inner is None and not self._try(timeout):
            return None
        inner = self._inner
        assert inner is not None
        try:
            image = inner.read(timeout)
        except SourceEnded:
            raise
        # A driver may raise anything: the camera is as good as gone.
        except Exception as problem:
            self._lose(sentence_of(problem))
            return None
        self.dropped, self.damaged = self._dropped_before + inner.dropped, self._damaged_before + inner.damaged
        if image is not None:
            self._quiet_since = image.arrived
            return self._going_on(image)
        if self._started and not self._closed.is_set() and time.monotonic() - self._quiet_since > self._patience(inner):
            self._lose(f"{self.name} ({without_password(self.address)}) gives no images; look at its cable and its power.")
        return None

    def _patience(self, inner: LiveCamera) -> float:
        if inner.get("trigger") not in (None, "off"):
            return math.inf
        rate = inner.rate
        return max(_SILENT, _PERIODS / rate) if rate > 0 else _SILENT

    def _lose(self, problem: str) -> None:
        inner, self._inner = self._inner, None
        if inner is not None:
            self._about = inner.about
            self._dropped_before += inner.dropped
            self._damaged_before += inner.damaged
            inner.close()
        self.problem, self._next_try = problem, time.monotonic() + _EVERY

    def _try(self, timeout: float) -> bool:
        """Open it again, not more often than each second; whether it is there."""
        wait = self._next_try - time.monotonic()
        if self._closed.wait(max(0.0, min(wait, timeout))) or wait > timeout:
            return False
        try:
            camera = self._open()
        except Exception:
            self._next_try = time.monotonic() + _EVERY
            return False
        try:
            camera.set_all(self._set)
            if self._started:
                camera.start(self._at)
        except Exception:
            camera.close()
            self._next_try = time.monotonic() + _EVERY
            return False
        self._inner, self._quiet_since, self._came_back = camera, time.monotonic(), True
        return True

    def _going_on(self, image: LiveImage) -> LiveImage:
        """The image with the number and the time that it has had the camera never been gone."""
        last = self._last
        if self._came_back:
            # Only with an image it is there again: drivers open what has no power.
            self._came_back, self.problem = False, ""
            self.reopened += 1
            if last is not None:
                since = image.arrived - last.arrived
                steps = round(since * self.about.rate) if self.about.rate > 0 else 1
                self._numbers_on = last.number + max(1, steps) - image.number
                # The system's clock and that of a file that went on need nothing.
                own = last.time + since
                jumped = abs(own - image.time) > since
                self._times_on = own - image.time if jumped else 0.0
        self._last = replace(image, number=image.number + self._numbers_on, time=image.time + self._times_on)
        return self._last
