"""The one interface of cameras: what every camera is asked and set by name, and how its images are read."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass

from asterism.errors import AsterismError
from asterism.live.camera_frames import LiveImage
from asterism.live.cameras.settings import SettingOutcome, SettingValue, in_order, setting_value

BUFFERS = 4
"""Images that wait in a camera's driver until they are read, as webcams have under Linux. Half of it loses an image at each pause of the
system; with twice as many an image is a seventh of a second old at 60 Hz before a newer one takes its place."""


class CameraGone(AsterismError):
    """A camera is not there, or not any more: its cable is out, it has no power, or another program has it."""


@dataclass(frozen=True)
class CameraAbout:
    """What is known of a camera.

    name     in the rig
    address  where it was opened
    model    what its maker calls it, "" where it does not say
    serial   its serial number, "" where it does not say
    size     (width, height) px of its images, (0, 0) before it is known
    rate     images per second that it says, NaN where it does not
    clock    whose clock the times of its images are: "camera", "system" (the kernel's stamps), "file", or "arrival" (none but when it came)
    """

    name: str
    address: str
    model: str = ""
    serial: str = ""
    size: tuple[int, int] = (0, 0)
    rate: float = math.nan
    clock: str = "arrival"

    def said(self) -> dict[str, SettingValue]:
        """What it says of itself, as plain values by name."""
        found: dict[str, SettingValue] = {"model": self.model, "serial": self.serial}
        if any(self.size):
            found["size"] = "{}x{}".format(*self.size)
        return {name: value for name, value in found.items() if value}


class LiveCamera(ABC):
    """A camera that is open.

    Settings are known by name: `settings` lists those that this camera has. `threshold` is that of the detection of markers, which all
    cameras keep for whoever detects in their images. After `start`, `read` gives its images. All but `close` is called from one thread.

    name     in the rig
    address  where it was opened
    damaged  images that could not be read
    dropped  images that were not fetched in time, since newer ones came
    reopened times that it disappeared and came back
    problem  why it is gone now, "" while it is there
    """

    def __init__(self, name: str, address: str) -> None:
        self.name, self.address, self.damaged, self.dropped = name, address, 0, 0
        self.reopened, self.problem = 0, ""
        self.outcomes: tuple[SettingOutcome, ...] = ()
        """What became of the settings with which it was opened."""
        self._threshold: SettingValue | None = None

    @property
    def rate(self) -> float:
        """Images per second that it says, NaN where it does not."""
        return self.about.rate

    @property
    @abstractmethod
    def about(self) -> CameraAbout:
        """What is known of it."""

    @property
    @abstractmethod
    def own_settings(self) -> tuple[str, ...]:
        """The names of what can be asked of the camera itself."""

    @abstractmethod
    def get_own(self, name: str) -> SettingValue | None:
        """What the camera says that a setting of its own is; None where it does not say."""

    @abstractmethod
    def set_own(self, name: str, value: SettingValue) -> None:
        """Set it. Raises AsterismError with the reason where it cannot."""

    @abstractmethod
    def start(self, at: float | None = None) -> None:
        """Begin with images.

        at: s on `time.monotonic` when files and simulated cameras begin, so that several in several processes begin together; None: now.
        Raises AsterismError where it cannot.
        """

    @abstractmethod
    def stop(self) -> None:
        """No images any more, until it is started again."""

    @abstractmethod
    def read(self, timeout: float) -> LiveImage | None:
        """The next image; None where none came within so many seconds.

        Raises SourceEnded at the end of a file, CameraGone where the camera has disappeared.
        """

    @abstractmethod
    def close(self) -> None:
        """Let go of the camera or the file, from any thread. Again it does nothing."""

    @property
    def waits(self) -> bool:
        """Whether it waits until its images are taken, as a file can; of others the oldest is left out."""
        return False

    @property
    def temperature(self) -> float:
        """Degrees Celsius within the camera, NaN where it does not say."""
        return math.nan

    @property
    def settings(self) -> tuple[str, ...]:
        """The names of what can be asked and set."""
        return (*self.own_settings, "threshold")

    def knows(self, name: str) -> bool:
        """Whether a setting of the camera's own has this name."""
        return name in self.own_settings

    def get(self, name: str) -> SettingValue | None:
        """What a setting is, in the unit of `SETTINGS`; None where the camera does not have it or does not say."""
        return self._threshold if name == "threshold" else self.get_own(name) if self.knows(name) else None

    def said(self) -> dict[str, SettingValue]:
        """What it says of itself and of its settings, as plain values by name."""
        values = {name: self.get(name) for name in self.settings}
        known = {name: value for name, value in values.items() if value is not None}
        return self.about.said() | {"clock": self.about.clock} | known

    def set(self, name: str, value: object) -> SettingOutcome:
        """Set a setting, and ask what the camera has then. Raises AsterismError where there is no such setting, or no such value of it."""
        asked = setting_value(name, value)
        if name == "threshold":
            self._threshold = asked
            return SettingOutcome(self.name, name, asked, asked)
        if not self.knows(name):
            return SettingOutcome(self.name, name, asked, None, f"this camera has no such setting, only {', '.join(self.settings)}.")
        try:
            self.set_own(name, asked)
        except AsterismError as problem:
            return SettingOutcome(self.name, name, asked, self.get(name), str(problem))
        return SettingOutcome(self.name, name, asked, self.get(name))

    def set_all(self, settings: Mapping[str, SettingValue]) -> tuple[SettingOutcome, ...]:
        """Set several, those first on which others depend."""
        return tuple(self.set(name, settings[name]) for name in in_order(list(settings)))
