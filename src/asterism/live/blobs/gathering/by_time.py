"""Blobs of cameras that run freely in; frames of all cameras at the instants at which one of them looks out."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator

import numpy as np

from asterism.live.blobs.camera_clock import same_clock
from asterism.live.blobs.following import FollowedImage, between, follow
from asterism.live.blobs.gathering.arrivals import AWAY, FEWEST, LONGEST_WAIT, REMEMBERED, CameraArrivals, RigFrame
from asterism.live.camera_frames import LiveBlobs
from asterism.recording import Floats
from asterism.synchronization.common_clock import RULES

_ONE_RATE = 0.05
"""Share by which periods of cameras of one rate differ: free-running ones do by a thousandth, rates that are set to others by a tenth or
more. Half and double do as well."""


class ByTime:
    """Gathers blobs of cameras that are not triggered together: each camera's are moved to the instants at which one of them looks.

    That one, the reference, is the camera after whose images the others' come soonest; a camera as fast as half of them or faster. The
    blobs of the others are put between their images before and after the instant, along their paths (see `following`). So a frame waits
    for the next image of each camera: `image_wait` says how long, and never more than a period. Nothing is taken at another time than its
    own: a camera without an image on both sides of the instant, no further apart than 2.5 of its periods, has no blobs in the frame.

    Times are compared as they are where the cameras share a clock (`one_clock`), else by each clock's offset to this machine's. A camera
    joins when 20 images have told its clock and rate, and again when its clock was set.
    """

    def __init__(self, cameras: int, rate: float = math.nan) -> None:
        self.cameras = [CameraArrivals() for _ in range(cameras)]
        self.image_wait = 0.0
        self._tracks = [_RecentImages() for _ in range(cameras)]
        self._leader = list(range(cameras))
        self.one_clock = True
        self._reference: int | None = None
        self._instants: deque[float] = deque(maxlen=REMEMBERED)
        self._last: tuple[int, float] | None = None
        self._newest = -math.inf
        self._chosen, self._first = -math.inf, math.inf
        self._period = 1 / rate

    def push(self, camera: int, blobs: LiveBlobs) -> float | None:
        """Take the blobs of a camera. Returns when they were taken on the common clock, NaN while that is not known; None if not new."""
        state, track, jumps = self.cameras[camera], self._tracks[camera], self.cameras[camera].clock.jumps
        if not state.takes(blobs):
            return None
        if state.clock.jumps > jumps:
            self._leave(camera)
        if track.stamps and blobs.time <= track.stamps[-1][1]:
            state.untimed += 1
            return None
        track.stamps.append((blobs.number, blobs.time))
        if not track.joined:
            if len(track.stamps) < FEWEST:
                return math.nan
            self._join(camera)
        at = self._common(camera, blobs.time)
        state.lag.add(blobs.arrived, max(0.0, blobs.arrived - self._arrival(camera, at)))
        last = track.images[-1] if track.images else None
        image = FollowedImage(at, blobs.arrived, blobs.xy, blobs.sizes)
        follow(last, image, RULES.longest_gap * track.period)
        track.images.append(image)
        if self._last is not None and at < self._last[1]:
            state.late += 1
        self._choose(blobs.arrived)
        self._look_out()
        return at

    def ready(self, now: float) -> Iterator[RigFrame]:
        """The frames that are whole, or waited long enough, oldest first. now: s on this machine's clock."""
        while self._instants:
            instant = self._instants[0]
            missing = self._missing(instant)
            if missing and now < max(self._until(c, instant) for c in missing):
                return
            self._instants.popleft()
            for c in missing:
                self.cameras[c].missing()
            yield self._frame(instant)

    def due(self) -> float:
        """s on this machine's clock, when the oldest frame waits no longer; infinite where none waits."""
        if not self._instants:
            return math.inf
        return max((self._until(c, self._instants[0]) for c in self._missing(self._instants[0])), default=-math.inf)

    def _look_at_clocks(self) -> None:
        """Whether the cameras share a clock; where that changed, times are on another one from here on."""
        was_one = self.one_clock
        self.one_clock = len({self._leader[c] for c, track in enumerate(self._tracks) if track.joined}) <= 1
        if was_one != self.one_clock:
            self._anew()

    def _there(self) -> list[int]:
        return [c for c, track in enumerate(self._tracks) if track.joined and not self.cameras[c].away]

    def _missing(self, instant: float) -> list[int]:
        """The cameras that are there and have no image at the instant or after it yet."""
        return [c for c in self._there() if not self._tracks[c].reaches(instant)]

    def _until(self, camera: int, instant: float) -> float:
        """When a camera's first image at the instant or after it is here at the latest, on this machine's clock."""
        track = self._tracks[camera]
        last = track.images[-1].time if track.images else instant
        coming = last + track.period * max(1, math.ceil((instant - last) / track.period - RULES.same))
        return self._arrival(camera, coming) + self.cameras[camera].wait

    def _arrival(self, camera: int, at: float) -> float:
        """When the fastest image of a time on the common clock is here, on this machine's clock."""
        # Without a common clock of the cameras, this machine's is the common one, the fastest way included.
        return at + self.cameras[camera].clock.offset(at) if self.one_clock else at

    def _common(self, camera: int, time: float) -> float:
        return time if self.one_clock else time + self.cameras[self._leader[camera]].clock.offset(time)

    def _join(self, camera: int) -> None:
        """Take part with the rate and the clock that its first images told."""
        track = self._tracks[camera]
        numbers, times = np.array(track.stamps).T
        track.period = float(np.median(np.diff(times) / np.maximum(1, np.diff(numbers))))
        track.joined = True
        clocks = [state.clock for state in self.cameras]
        for other in self._there():
            if other != camera and self._leader[other] == other and same_clock(clocks[other], clocks[camera], LONGEST_WAIT):
                self._leader[camera] = other
                break
        else:
            self._leader[camera] = camera
        self._look_at_clocks()

    def _leave(self, camera: int) -> None:
        """Its clock was set: nothing is known of it."""
        # Others that shared its clock still share one until they are set, too.
        others = [c for c, leader in enumerate(self._leader) if leader == camera and c != camera]
        for c in (*others, camera):
            self._leader[c] = others[0] if others and c != camera else camera
        self._tracks[camera] = _RecentImages()
        self._look_at_clocks()
        if not self._there():
            self._anew()

    def _anew(self) -> None:
        """Times are on another clock from here on."""
        for track in self._tracks:
            track.images.clear()
        self._instants.clear()
        self._newest, self._chosen, self._reference = -math.inf, -math.inf, None

    def _choose(self, now: float) -> None:
        """The reference: anew where it is away, and each second where another one spares a quarter of a period."""
        self._first = min(self._first, now)
        joined = sum(track.joined for track in self._tracks)
        if self._last is None and joined < len(self._tracks) and now < self._first + LONGEST_WAIT:
            # The first frame waits for cameras that begin a little later.
            return
        if self._reference is not None and now > self._until(self._reference, self._newest + AWAY * self._period):
            # Without its images there is no instant, and so no frame that shows that it is missing.
            self.cameras[self._reference].falls_silent()
        there = [c for c in self._there() if self._tracks[c].images]
        gone = self._reference is None or self._reference not in there
        if not there or not (gone or now - self._chosen > 1.0):
            return
        self._chosen = now
        self._part(there)
        there = [c for c in there if self._tracks[c].images]
        if not there:
            return
        usual = float(np.quantile([self._tracks[c].period for c in there], 0.5, method="lower"))
        waits = {c: self._waits(c, there) for c in there if self._tracks[c].period <= (1 + _ONE_RATE) * usual}
        best = min(waits, key=lambda c: waits[c])
        if gone or self._reference not in waits or waits[self._reference] - waits[best] > 0.25 * usual:
            self._reference, self._period = best, self._tracks[best].period
            # Of the first images there are none before them.
            self._newest = self._tracks[best].images[-1].time if math.isinf(self._newest) else self._newest

    def _look_out(self) -> None:
        """The instants of the reference's images that are new: of one that took another's place, those since that one fell silent, too."""
        if self._reference is None:
            return
        track, new = self._tracks[self._reference], deque[float]()
        for image in reversed(track.images):
            if image.time <= self._newest + 0.5 * track.period:
                break
            new.appendleft(image.time)
        for instant in new:
            if 1.5 * track.period < instant - self._newest <= RULES.longest_gap * track.period:
                # Of one lost image the other cameras' blobs are there, and its own go on across it.
                self._instants.append(0.5 * (self._newest + instant))
            self._instants.append(instant)
            self._newest = instant

    def _part(self, cameras: list[int]) -> None:
        """Cameras whose clocks run apart share none."""
        for c in cameras:
            leader = self._leader[c]
            if leader != c and not same_clock(self.cameras[leader].clock, self.cameras[c].clock, LONGEST_WAIT):
                self._leader[c] = c
        self._look_at_clocks()

    def _waits(self, reference: int, there: list[int]) -> float:
        """s that frames would wait for the cameras' next images."""
        period, at = self._tracks[reference].period, self._tracks[reference].images[-1].time
        waits = [0.0]
        for c in there:
            track = self._tracks[c]
            same_rate = abs(track.period - period) <= _ONE_RATE * period
            behind = (track.images[-1].time - at) % track.period if same_rate else track.period
            # What is taken at the instant needs no next image.
            waits.append(0.0 if min(behind, track.period - behind) <= RULES.same * period and same_rate else behind)
        return max(waits)

    def _frame(self, instant: float) -> RigFrame:
        xy, sizes = [np.empty((0, 2))] * len(self.cameras), [np.empty(0)] * len(self.cameras)
        without, arrived, waited = list[int](), -math.inf, 0.0
        for c, track in enumerate(self._tracks):
            at = track.at(instant)
            if at is None:
                without.append(c)
                self.cameras[c].without += 1
                continue
            xy[c], sizes[c], unlinked, last = at
            self.cameras[c].unlinked += unlinked
            arrived, waited = max(arrived, last.arrived), max(waited, last.time - instant)
        # The mean of some ten frames.
        self.image_wait += (waited - self.image_wait) * (0.1 if self._last is not None else 1.0)
        number = 0
        if self._last is not None:
            # Where another camera became the reference, up to three quarters of a period more are no lost frame.
            number = self._last[0] + max(1, math.floor((instant - self._last[1]) / self._period + 0.25))
        self._last = (number, instant)
        return RigFrame(number, instant, arrived, tuple(xy), tuple(sizes), tuple(without))


class _RecentImages:
    """The last images of a camera, on the common clock."""

    def __init__(self) -> None:
        self.joined = False
        self.period = math.nan
        self.stamps: deque[tuple[int, float]] = deque(maxlen=FEWEST)
        self.images: deque[FollowedImage] = deque(maxlen=REMEMBERED)

    def reaches(self, instant: float) -> bool:
        """Whether there is an image at the instant or after it."""
        return bool(self.images) and self.images[-1].time >= instant - RULES.same * self.period

    def at(self, instant: float) -> tuple[Floats, Floats, int, FollowedImage] | None:
        """Blobs and sizes at an instant, how many blobs were left out, and the last image that they rest on; None where none is around."""
        while len(self.images) > 3 and self.images[2].time < instant - RULES.longest_gap * self.period:
            self.images.popleft()
        images = list(self.images)
        for k, image in enumerate(images):
            if abs(image.time - instant) <= RULES.same * self.period:
                return image.xy, image.sizes, 0, image
            if image.time > instant:
                if k == 0 or image.time - images[k - 1].time > RULES.longest_gap * self.period:
                    return None
                xy, sizes = between(images[k - 2] if k > 1 else None, images[k - 1], image, instant)
                return xy, sizes, len(image.xy) - len(xy), image
        return None
