"""Packets of Qualisys Track Manager's real-time protocol (1.8 and later) in; points, blobs and settings out. Nothing here raises."""

from __future__ import annotations

import struct
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field

import numpy as np

from asterism.cameras.files.qualisys import SUBPIXELS
from asterism.live.analog import AnalogDevice, AnalogSamples
from asterism.live.camera_frames import LiveBlobs
from asterism.live.frames import MOST_POINTS, LiveFrame, believable, joined
from asterism.recording import Floats

MOST_BYTES = 1 << 24
"""Bytes of a packet that are believed: the longest are settings of a hundred cameras with their labels, some hundred thousand. Half and
double do as well."""
_POINT_SIZES = {1: 12, 9: 16, 2: 16, 10: 20}
"""Bytes of a point by the type of its component: with labels and without, each without and with a residual. x, y, z come first in all."""
_WITH_LABELS = (1, 9)
"""Types of components whose points have labels."""
_ANALOG = 3
"""The type of analog samples."""
_BLOBS = 7
"""The type of blobs as the sensor saw them; 8 is without the lens's distortion, which a rig's camera models itself."""


@dataclass(frozen=True)
class QtmSettings:
    """What QTM says about itself.

    rate      frames per second of the cameras; NaN where it does not say so
    vertical  (3,) what points up; None where it does not say so
    computed  whether each label is that of a virtual marker, which no camera saw
    cameras   serial numbers, in the order of the 2D data
    devices   analog devices by their number
    """

    rate: float = float("nan")
    vertical: Floats | None = None
    computed: tuple[bool, ...] = ()
    cameras: tuple[str, ...] = ()
    devices: Mapping[int, AnalogDevice] = field(default_factory=dict)

    def __bool__(self) -> bool:
        """Whether QTM says anything."""
        return self.rate > 0 or self.vertical is not None or bool(self.computed or self.cameras)


@dataclass(frozen=True, eq=False)
class QtmPoints:
    """A frame with the number of its points that QTM gave a label; None where only analog samples came."""

    frame: LiveFrame | None
    labelled: int
    analog: tuple[AnalogSamples, ...] = ()


def settings_of_xml(data: bytes) -> QtmSettings:
    """The settings in QTM's answer; what is missing or damaged stays unknown."""
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError:
        text = data.decode("cp1252", "replace")
    # QTM writes neither; both let a few bytes become gigabytes.
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        return QtmSettings()
    try:
        root = ET.fromstring(text.strip("\0 \r\n"))
    except (ET.ParseError, ValueError):
        return QtmSettings()
    rate = float("nan")
    with suppress(ValueError):
        rate = float(root.findtext("General/Frequency", "nan"))
    return QtmSettings(
        rate if 0 < rate < 1e5 else float("nan"),
        _axis(root.findtext("The_3D/AxisUpwards", "")),
        tuple(label.findtext("Trajectory_Type", "").strip().lower() == "virtual" for label in root.iterfind("The_3D/Label")),
        tuple(
            camera.findtext("Serial", "").strip() or camera.findtext("ID", "").strip() or str(row + 1)
            for row, camera in enumerate(root.iterfind("General/Camera"))
        ),
        {number: device for number, device in map(_device, root.iterfind("Analog/Device")) if number >= 0},
    )


def _device(element: ET.Element) -> tuple[int, AnalogDevice]:
    """An analog device and its number, -1 where it has none. Versions before 1.12 have labels without channels, and one unit for all."""
    number, rate = -1, float("nan")
    with suppress(ValueError):
        number = int(element.findtext("Device_ID", ""))
        rate = float(element.findtext("Frequency", "nan"))
    labels = tuple((label.text or "").strip() for label in element.findall("Channel/Label") or element.findall("Label"))
    units = tuple((unit.text or "").strip() for unit in element.findall("Channel/Unit"))
    name = element.findtext("Device_Name", "").strip() or f"device {number}"
    return number, AnalogDevice(name, rate, labels, units or len(labels) * (element.findtext("Unit", "").strip(),))


def _axis(text: str) -> Floats | None:
    """(3,) of "+Z"; some versions of the documentation write the minus as a dash."""
    row = "xyz".find(text.strip()[-1:].lower()) if text.strip() else -1
    return None if row < 0 else (-1.0 if text.strip()[0] in "-\u2013" else 1.0) * np.eye(3)[row]


def _components(data: bytes) -> Iterator[tuple[int, bytes]]:
    """The type and the content of each component behind the head of 16 bytes. Raises ValueError where one is longer than the packet."""
    at = 16
    for _ in range(struct.unpack_from("<I", data, 12)[0]):
        size, kind = struct.unpack_from("<II", data, at)
        # A size of 0 would be read again and again.
        if size < 8 or at + size > len(data):
            raise ValueError("a component is longer than its packet")
        yield kind, data[at + 8 : at + size]
        at += size


def points_of_packet(data: bytes, arrived: float, settings: QtmSettings | None = None) -> QtmPoints | None:
    """The points of a data packet (without its 8 bytes of size and type); None where it is damaged, or has neither 3D nor analog data.

    Virtual markers of the settings are left out, where there are as many labels as they say.
    Points with and without QTM's labels are joined, each once; missing ones are left out. mm become m.
    """
    settings = QtmSettings() if settings is None else settings
    try:
        stamp, number, _ = struct.unpack_from("<qII", data)
        with_label, without = np.empty((0, 3)), np.empty((0, 3))
        found, analog, computed = False, list[AnalogSamples](), settings.computed
        for kind, content in _components(data):
            size = _POINT_SIZES.get(kind)
            if kind == _ANALOG:
                analog += _samples(content, settings.devices)
            if size is None:
                continue
            found = True
            points = 1e-3 * _points(content, size)
            if kind in _WITH_LABELS:
                with_label = believable(points[~np.array(computed, dtype=bool)] if len(computed) == len(points) else points)
            else:
                without = believable(points)
    except (struct.error, ValueError):
        return None
    points = joined(with_label, without)
    if len(points) > MOST_POINTS or not (found or analog):
        return None
    frame = LiveFrame(number, 1e-6 * stamp, arrived, points) if found else None
    return QtmPoints(frame, len(with_label), tuple(analog))


def _samples(content: bytes, devices: Mapping[int, AnalogDevice]) -> Iterator[AnalogSamples]:
    """The samples of each device: its number, channels and samples, the number of the first one where there are some, and values."""
    at = 4
    for _ in range(struct.unpack_from("<I", content)[0]):
        number, channels, count = struct.unpack_from("<III", content, at)
        at += 12
        if not count:
            continue
        (first,) = struct.unpack_from("<I", content, at)
        at += 4
        if at + 4 * channels * count > len(content):
            raise ValueError("a device has fewer samples than it says")
        samples = np.frombuffer(content, dtype="<f4", count=channels * count, offset=at).reshape(channels, count)
        with np.errstate(invalid="ignore"):
            values = samples.T.astype(np.float64)
        at += 4 * channels * count
        known = devices.get(number)
        # Channels that are not streamed have a label, too.
        if known is None or len(known.channels) != channels:
            name, rate = (f"device {number}", float("nan")) if known is None else (known.name, known.rate)
            known = AnalogDevice(name, rate, tuple(f"channel {n + 1}" for n in range(channels)), channels * ("",))
        yield AnalogSamples(known, first, values)


def _points(content: bytes, size: int) -> Floats:
    """(n, 3) of a component: how many there are, two rates of the network, and the points."""
    count = struct.unpack_from("<I", content)[0]
    if count > MOST_POINTS or 8 + count * size > len(content):
        raise ValueError("a component has fewer points than it says")
    rows = np.frombuffer(content, dtype=np.uint8, count=count * size, offset=8).reshape(count, size)
    with np.errstate(invalid="ignore"):
        return rows[:, :12].copy().view("<f4").astype(np.float64)


def blobs_of_packet(data: bytes, arrived: float, cameras: tuple[str, ...]) -> list[LiveBlobs] | None:
    """The blobs of each camera in a data packet; None where it is damaged, or has no 2D data.

    cameras  names; one that has none is called by its place, from 1
    Coordinates and diameters are sub-pixels, 64 a pixel, in the sensor's axes; they become pixels. A size is the mean of both diameters.
    """
    try:
        stamp, number, _ = struct.unpack_from("<qII", data)
        content = next((content for kind, content in _components(data) if kind == _BLOBS), None)
        if content is None:
            return None
        found = list[LiveBlobs]()
        at = 8
        for row in range(struct.unpack_from("<I", content)[0]):
            count = struct.unpack_from("<I", content, at)[0]
            # One byte of flags: whether too much light enters.
            at += 5
            if count > MOST_POINTS or at + 12 * count > len(content):
                return None
            blobs = np.frombuffer(content, dtype="<i4, <i4, <u2, <u2", count=count, offset=at)
            at += 12 * count
            xy = np.column_stack([blobs["f0"], blobs["f1"]]) / SUBPIXELS
            sizes = (blobs["f2"] + blobs["f3"].astype(np.float64)) / (2 * SUBPIXELS)
            name = cameras[row] if row < len(cameras) else str(row + 1)
            found.append(LiveBlobs(name, number, 1e-6 * stamp, arrived, xy, sizes))
    except (struct.error, ValueError):
        return None
    return found
