"""What every source of live frames gives: the frame with its own number and clock, and what is known of the source."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
from scipy.spatial import cKDTree

from asterism.live.analog import AnalogSamples
from asterism.recording import Floats

MOST_POINTS = 2000
"""Points of a frame that are believed: systems of a hundred cameras deliver a few hundred. Half of it cuts a dense capture of a face; twice
as many would hold the next frames back."""
TURN = 0.1
"""s after which a thread or a process that waits looks whether it shall end. Half of it wakes twice as often for nothing; with twice as
much each session ends that much later."""
FARTHEST = 1000.0
"""m from the origin beyond which a coordinate is no laboratory's, but a damaged number. Half and double do as well: halls are smaller, and
what is meant is what overflows when it is squared."""
_SAME = 1e-5
"""m within which points of two lists of one frame are one point: both are the same float. Half and double do as well, since markers are a
millimetre apart at least."""


class DamagedPacket(Exception):
    """A packet ends before what it announces."""


def believable(points: Floats) -> Floats:
    """(n, 3) m, those that are finite and in the hall."""
    with np.errstate(invalid="ignore"):
        return points[(np.abs(points) < FARTHEST).all(axis=1)]


def joined(first: Floats, second: Floats, hidden: Floats | None = None) -> Floats:
    """(n, 3) m, points of two lists that may tell the same ones twice, each once, without hidden ones in the second. All are finite."""
    known = first if hidden is None else np.concatenate([first, hidden])
    if len(known) and len(second):
        apart, _ = cKDTree(known).query(second, p=np.inf)
        second = second[apart > _SAME]
    return np.concatenate([first, second]) if len(second) else first


@dataclass(frozen=True, eq=False)
class LiveFrame:
    """One frame as it came.

    number   the source's own, which grows by one from frame to frame: what is missing between two frames was lost on the way
    time     s on the source's clock
    arrived  s on this machine's `time.monotonic`, when the frame was complete
    points   (n, 3) m in the source's axes, all finite
    names    (n,) labels that the source gave, "" for none; () where it gives none at all
    analog   what force plates, EMG and the like measured since the frame before
    """

    number: int
    time: float
    arrived: float
    points: Floats
    names: tuple[str, ...] = ()
    analog: tuple[AnalogSamples, ...] = ()


@dataclass(frozen=True)
class SourceAbout:
    """What is known of a source.

    name      what the person calls it, as in "walk.c3d" or "Motive at 192.168.1.5"
    rate      frames per second that it says or was told; NaN where it is not known before frames come
    vertical  (3,) what points up in its axes; None where it does not say so
    """

    name: str
    rate: float
    vertical: Floats | None = None


class SourceEnded(Exception):
    """There are no frames any more: a file was played to its end, or the sender said goodbye."""


class LiveSource(Protocol):
    """Frames from a camera system, one after the other. Made by `open_source`; closed by `close`, from any thread."""

    @property
    def about(self) -> SourceAbout:
        """What is known of the source."""

    @property
    def damaged(self) -> int:
        """Packets that could not be read, which are counted and passed over."""

    def read(self, timeout: float) -> LiveFrame | None:
        """The next frame; None where none came within so many seconds. Raises SourceEnded at the end."""

    def close(self) -> None:
        """Let go of the network or the file."""


@runtime_checkable
class CameraControl(Protocol):
    """Cameras that are watched and set while they run."""

    def camera_states(self) -> list[dict[str, Any]]:
        """How each camera does, what it has, and what became of what was set, as plain values."""

    def set(self, setting: str, value: object) -> None:
        """Set all cameras; what became of it is in their states. Raises AsterismError where there is no such setting or value."""


@runtime_checkable
class OfCameras(Protocol):
    """A source of frames that are made of what several cameras see."""

    def camera_numbers(self) -> list[dict[str, Any]]:
        """How each camera does, as plain values; None for what is not known."""


@runtime_checkable
class WithCameraControl(Protocol):
    """A source of frames whose cameras may be this program's."""

    @property
    def control(self) -> CameraControl | None:
        """Where they are set; None where they are another program's."""
