"""What every camera gives while it runs: images, or the blobs in them, with the camera's own number and clock."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

from numpy.typing import NDArray

from asterism.recording import Floats


@dataclass(frozen=True, eq=False)
class LiveImage:
    """One image as it came.

    camera   its name in the rig
    number   the camera's own, which grows by one from image to image: what is missing between two images was lost
    time     s on the camera's clock, of the middle of the exposure where that is known
    arrived  s on this machine's `time.monotonic`, when the image was complete
    image    (height, width) or (height, width, 3 BGR) uint8
    """

    camera: str
    number: int
    time: float
    arrived: float
    image: NDArray[Any]


@dataclass(frozen=True, eq=False)
class LiveBlobs:
    """The blobs of one camera in one frame.

    camera, number, time, arrived  as of `LiveImage`
    xy       (n, 2) px, OpenCV's axes: the centre of the top left pixel is (0, 0)
    sizes    (n,) px, diameters, NaN where unknown
    """

    camera: str
    number: int
    time: float
    arrived: float
    xy: Floats
    sizes: Floats


class BlobSource(Protocol):
    """Blobs of several cameras, frame by frame and camera by camera, in the order in which they come."""

    @property
    def name(self) -> str:
        """What the person calls it, as in "QTM at 192.168.1.5"."""

    @property
    def cameras(self) -> tuple[str, ...]:
        """The names of its cameras."""

    @property
    def rate(self) -> float:
        """Frames per second of each camera; NaN where that is not known."""

    @property
    def numbered_together(self) -> bool:
        """Whether equal numbers are one exposure of all cameras, as where a trigger or a sync cable drives them."""

    @property
    def damaged(self) -> int:
        """Packets or images that could not be read, which are counted and passed over."""

    def read(self, timeout: float) -> LiveBlobs | None:
        """The next blobs of some camera; None where none came within so many seconds. Raises SourceEnded at the end."""

    def close(self) -> None:
        """Let go of the network or the cameras."""
