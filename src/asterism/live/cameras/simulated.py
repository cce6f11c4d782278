"""A camera without hardware: bright dots that move before a dark wall, with an exposure, a gain and a rate that can be set."""

from __future__ import annotations

import math
import threading
import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from asterism.errors import AsterismError
from asterism.live.addresses import Query
from asterism.live.camera_frames import LiveImage
from asterism.live.cameras.camera import BUFFERS, CameraAbout, CameraGone, LiveCamera
from asterism.live.cameras.settings import SettingValue, size_of
from asterism.recording import Floats

_LINE_TIME = 0.02
"""ms of which its exposures are multiples, as rows of a sensor are read one after the other."""
_GAIN_STEP, _MOST_GAIN = 0.1, 24.0
"""dB, as sensors have them: what lies between or beyond is rounded, and told. Half and double do as well."""
_FASTEST = 500.0
"""Hz to which it can be set, as a machine vision camera of this size. Half and double do as well."""
_PEAK = 200.0
"""Grey value of a dot at 4 ms and 0 dB, so that twice the exposure saturates and half of it does not."""
_NOISE = 1.5
"""Grey values of noise at 0 dB, as webcams have in good light. Half and double hide no dot."""
_NOISES = 8
"""Images of noise that follow each other: making a new one for each image takes longer than the image. Half of them repeat sooner;
twice as many take twice the memory."""
_MOST_PIXELS = 5_000_000
"""Its images of noise take 160 MB with so many. Half of them are a usual camera's, twice as many take twice the memory."""
_GROWS = 0.5
"""Grey value of the dark wall at 4 ms: a long exposure shows it. Half and double do as well."""


@dataclass(frozen=True)
class SimulatedFaults:
    """What goes wrong on purpose.

    lost    share of images that are lost on the way
    gone    (s after the start, for how many s) the cable is out; NaN for never
    frozen  s after the start from which the same image comes again and again; NaN for never
    drift   millionths by which its clock is fast
    """

    lost: float = 0.0
    gone: tuple[float, float] = (math.nan, 0.0)
    frozen: float = math.nan
    drift: float = 0.0


class SimulatedCamera(LiveCamera):
    """Images of moving dots, as simulated://?size=640x480&dots=12&seed=3 says.

    Other words of the address: radius (px), and the faults `lost`, `gone`, `gone-for`, `frozen` and `drift` of `SimulatedFaults`.
    Brightness is proportional to exposure and gain until it saturates. `dots(time)` is where the dots are. With a trigger no image comes.
    """

    def __init__(self, name: str, address: str) -> None:
        super().__init__(name, address)
        query = Query(address)
        self._size = size_of(query.text("size", "640x480"))
        if self._size[0] * self._size[1] > _MOST_PIXELS:
            raise AsterismError(f"{address}: give a size of at most {_MOST_PIXELS / 1e6:.0f} million pixels.")
        count, seed, self._radius = query.whole("dots", 12), query.whole("seed", 0), query.number("radius", 4.0)
        self._faults = SimulatedFaults(
            query.number("lost", 0.0),
            (query.number("gone", math.nan), query.number("gone-for", 1.0)),
            query.number("frozen", math.nan),
            query.number("drift", 0.0),
        )
        query.check_all_used()
        self._exposure, self._gain, self._rate, self._trigger = 4.0, 0.0, 60.0, "off"
        self._rng = np.random.default_rng(seed)
        width, height = self._size
        self._centres = self._rng.uniform(0.25, 0.75, (count, 2)) * (width, height)
        self._swings = self._rng.uniform(0.05, 0.2, (count, 2)) * (width, height)
        self._speeds = self._rng.uniform(0.5, 4.0, (count, 2))
        self._phases = self._rng.uniform(0, 2 * np.pi, (count, 2))
        self._noise = [self._rng.normal(0.0, _NOISE, (height, width)).astype(np.float32) for _ in range(_NOISES)]
        self._began, self._next, self._first = math.nan, 0, 0
        self._stopped = threading.Event()
        self._closed = False

    @property
    def about(self) -> CameraAbout:
        """What is known of it."""
        return CameraAbout(self.name, self.address, "Asterism simulated", self.name, self._size, self._rate, "camera")

    @property
    def own_settings(self) -> tuple[str, ...]:
        """The names of what can be set."""
        return ("exposure", "gain", "rate", "trigger", "size")

    @property
    def temperature(self) -> float:
        """Degrees Celsius: warmer with its rate."""
        return 30.0 + self._rate / 20.0

    def get_own(self, name: str) -> SettingValue | None:
        """What a setting is."""
        values: dict[str, SettingValue] = {
            "exposure": self._exposure,
            "gain": self._gain,
            "rate": self._rate,
            "trigger": self._trigger,
            "size": "{}x{}".format(*self._size),
        }
        return values.get(name)

    def set_own(self, name: str, value: SettingValue) -> None:
        """Set it: numbers are rounded to the steps of the camera and kept within its limits."""
        if name == "size":
            if size_of(value) != self._size:
                raise AsterismError("the size of a simulated camera is in its address: simulated://?size=640x480.")
        elif name == "trigger":
            self._trigger = str(value)
        elif not isinstance(value, float):
            raise AsterismError("it has nothing automatic; give a number.")
        elif name == "gain":
            self._gain = round(min(value, _MOST_GAIN) / _GAIN_STEP) * _GAIN_STEP
        elif name == "rate":
            # From here on images are counted at the new rate.
            now = self._next
            begin = self._due(now)
            self._rate = min(max(value, 1.0), _FASTEST)
            self._began, self._first = begin, now
            self.set_own("exposure", self._exposure)
        else:
            longest = 1000.0 / self._rate
            self._exposure = max(1, math.floor(min(value, longest) / _LINE_TIME + 1e-9)) * _LINE_TIME

    def dots(self, seconds: float) -> Floats:
        """(n, 2) px where the dots are so many seconds after the start."""
        return self._centres + self._swings * np.sin(self._speeds * seconds + self._phases)

    def start(self, at: float | None = None) -> None:
        """Begin with images."""
        self._began = time.monotonic() if at is None else at
        self._zero = self._began
        # One that comes back does not begin anew.
        self._next, self._first = max(0, math.floor((time.monotonic() - self._began) * self._rate)), 0
        self._stopped.clear()

    def stop(self) -> None:
        """No images any more."""
        self._began = math.nan

    def close(self) -> None:
        """Let go of it."""
        self._closed = True
        self._stopped.set()

    def read(self, timeout: float) -> LiveImage | None:
        """The next image, when its exposure has ended. Raises CameraGone while its cable is out."""
        if math.isnan(self._began) or self._trigger != "off" or self._closed:
            self._stopped.wait(timeout)
            return None
        until = time.monotonic() + timeout
        while True:
            now = time.monotonic()
            behind = math.floor((now - self._due(self._next)) * self._rate) - BUFFERS
            if behind > 0:
                self.dropped += behind
                self._next += behind
            number, due = self._next, self._due(self._next)
            if due > now and (self._stopped.wait(max(0.0, min(due, until) - now)) or time.monotonic() < due):
                return None
            since = due - self._zero
            out, for_how_long = self._faults.gone
            if out <= since < out + for_how_long:
                raise CameraGone("its cable was taken out on purpose.")
            self._next += 1
            if self._rng.random() >= self._faults.lost:
                break
        shown = min(since, self._faults.frozen) if not math.isnan(self._faults.frozen) else since
        middle = since * (1.0 + 1e-6 * self._faults.drift) - 0.5e-3 * self._exposure
        image = self.image(shown, self._noise[0 if shown < since else number % _NOISES])
        return LiveImage(self.name, number, middle, time.monotonic(), image)

    def image(self, seconds: float, noise: NDArray[np.float32]) -> NDArray[np.uint8]:
        """What it shows so many seconds after the start; noise (height, width) grey values."""
        import cv2

        amplified = 10.0 ** (self._gain / 20.0)
        light = self._exposure / 4.0 * amplified
        shape = (self._size[1], self._size[0])
        disc = np.zeros(shape, np.uint8)
        for x, y in self.dots(seconds):
            # In sixteenths of a pixel, with soft edges: as a lens draws a marker.
            cv2.circle(disc, (round(x * 16), round(y * 16)), round(self._radius * 16), 255, -1, cv2.LINE_AA, 4)
        signal = cv2.addWeighted(disc.astype(np.float32), _PEAK / 255.0 * light, noise, amplified, _GROWS * light)
        return np.asarray(cv2.convertScaleAbs(np.maximum(signal, 0.0)), dtype=np.uint8)

    def _due(self, number: int) -> float:
        """s on `time.monotonic` when the exposure of an image ends."""
        return self._began + (number - self._first + 1) / self._rate
