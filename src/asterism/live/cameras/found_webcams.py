"""The webcams of this machine: their addresses, and what they are called."""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from asterism.live.cameras.camera import CameraAbout

_SYSTEM = Path("/sys/class/video4linux")
_BY_ID = Path("/dev/v4l/by-id")
_MOST = 10
"""Numbers that are tried where the system does not list its cameras; so many webcams share no bus. Half of them miss a camera that was
plugged in anew; twice as many take twice as long to try."""


def found_webcams(system: Path = _SYSTEM, by_id: Path = _BY_ID) -> list[CameraAbout]:
    """The webcams that are plugged in; under Linux none is opened.

    by_id: names that stay when a camera is plugged in elsewhere
    """
    if not sys.platform.startswith("linux"):
        return _opened()
    stable = {link.resolve().name: link for link in sorted(by_id.glob("*"))} if by_id.is_dir() else {}
    found = list[CameraAbout]()
    nodes = sorted(system.glob("video*"), key=lambda node: (len(node.name), node.name)) if system.is_dir() else []
    for node in nodes:
        # The second node of a webcam holds what it says of its images.
        if _line(node / "index") not in ("", "0"):
            continue
        where = stable.get(node.name, Path("/dev") / node.name)
        model, serial = webcam_model(Path("/dev") / node.name, system)
        found.append(CameraAbout(node.name, f"camera://{where}", model, serial))
    return found


def webcam_model(device: Path, system: Path = _SYSTEM) -> tuple[str, str]:
    """The name and the serial number of a webcam by Linux's files of its device; "" each where they do not say."""
    node = system / device.resolve().name
    # The interface of a USB device lies in the device, which has its serial number.
    return _line(node / "name"), _line(node / "device" / ".." / "serial")


def _line(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return ""


def _opened() -> list[CameraAbout]:
    """Webcams that can be opened by their numbers."""
    import cv2

    found = list[CameraAbout]()
    for number in range(_MOST):
        capture = quietly(partial(cv2.VideoCapture, number))
        if capture.isOpened():
            size = (int(capture.get(cv2.CAP_PROP_FRAME_WIDTH)), int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT)))
            found.append(CameraAbout(f"camera{number}", f"camera://{number}", size=size, rate=float(capture.get(cv2.CAP_PROP_FPS))))
        capture.release()
    return found


def quietly(open_: Callable[[], Any]) -> Any:
    """Open a capture of OpenCV without its own lines on standard error, which say less than what is said then."""
    import cv2

    before = cv2.utils.logging.getLogLevel()
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        return open_()
    finally:
        cv2.utils.logging.setLogLevel(before)
