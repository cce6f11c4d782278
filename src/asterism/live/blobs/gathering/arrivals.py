"""What is known of one camera while it runs, and what the blobs of all cameras become: a frame."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from asterism.live.blobs.camera_clock import CameraClock
from asterism.live.camera_frames import LiveBlobs
from asterism.live.clock import FrameCount, RecentMost
from asterism.recording import Floats

LONGEST_WAIT = 0.1
"""s that a frame waits for a camera at most, however late that has been: as long as frames wait for their labels. Half of it gives up a
camera behind a slow radio link; with twice as much what is shown is a fifth of a second old."""
_MARGIN = 1.5
"""Times as late as it was at most in the last ten seconds, a camera is waited for. Without a margin each new latest image would miss its
frame; twice as much makes each lost image hold its frame back for as much longer."""
_LEAST_WAIT = 0.002
"""s that a camera is waited for at least: cameras whose images come in one packet are taken one after the other. Half of it is a pause of a
busy machine, which would cost a frame its cameras; twice as much is what each lost image would hold its frame back for."""
AWAY = 2
"""Frames in a row that a camera misses, after which it is not waited for until it is back. One image is lost now and then; each more holds
all frames back by that camera's wait. With one, each lost image is told as a camera that fell silent; twice as many hold four frames
back."""
FEWEST = 20
"""Images of a camera whose times tell its rate. Half of them tell it badly where some are lost; with twice as many a camera joins later:
after 0.7 s at 60 Hz."""
REMEMBERED = 256
"""Frames that are remembered after they went on, so that a camera that comes later is known to be so. Longer than any frame waits, at 1,000
Hz, too; half and double do as well."""


@dataclass(frozen=True, eq=False)
class RigFrame:
    """The blobs of all cameras at one instant.

    number   grows by one from frame to frame
    time     s on the common clock
    arrived  s on this machine's clock, when the last camera's blobs that are in it came
    xy       for each camera (n, 2) px, none where it delivered nothing
    sizes    for each camera (n,) px, NaN where unknown
    missing  the cameras, by their place, that were not waited for any longer
    """

    number: int
    time: float
    arrived: float
    xy: tuple[Floats, ...]
    sizes: tuple[Floats, ...]
    missing: tuple[int, ...]


@dataclass
class CameraArrivals:
    """What is known of one camera while it runs.

    count      images received, lost, late and begun anew, by their numbers
    clock      its clock against this machine's
    lag        how late its images are, behind the first of their frame or behind its fastest ones
    late       images that came when their frame had gone on without them
    untimed    images of cameras that run freely whose time is not after that of the one before
    without    frames that went on without it
    unlinked   blobs that could not be followed to the instant of a frame
    away       whether it is not waited for, since it sends nothing
    times_away how often that began
    seen       s on this machine's clock, when its last image came; NaN where none did
    """

    count: FrameCount = field(default_factory=FrameCount)
    clock: CameraClock = field(default_factory=CameraClock)
    lag: RecentMost = field(default_factory=RecentMost)
    late: int = 0
    untimed: int = 0
    without: int = 0
    unlinked: int = 0
    away: bool = False
    times_away: int = 0
    seen: float = math.nan
    missed: int = 0
    latest: int | None = None

    @property
    def wait(self) -> float:
        """s that it is waited for beyond the moment at which it could have come: by how late it has been."""
        late = _MARGIN * self.lag.most
        if self.count.received < FEWEST or late > LONGEST_WAIT:
            return LONGEST_WAIT
        return late if late > _LEAST_WAIT else _LEAST_WAIT

    def takes(self, blobs: LiveBlobs) -> bool:
        """Whether an image that came is a new one."""
        if not self.count.takes(blobs.number):
            return False
        self.seen, self.away, self.missed, self.latest = blobs.arrived, False, 0, blobs.number
        self.clock.observe(blobs.time, blobs.arrived)
        return True

    def missing(self) -> None:
        """A frame waited for it long enough."""
        self.missed += 1
        if self.missed >= AWAY:
            self.falls_silent()

    def falls_silent(self) -> None:
        """It is not waited for any more, until it is back."""
        if not self.away:
            self.away, self.times_away = True, self.times_away + 1
