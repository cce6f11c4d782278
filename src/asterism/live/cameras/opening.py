"""The address of a camera and what is to be set on it in; the open camera out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial

from asterism.errors import AsterismError
from asterism.live.cameras.camera import LiveCamera
from asterism.live.cameras.reopening import ReopeningCamera
from asterism.live.cameras.settings import SettingValue

SCHEMES = ("camera", "genicam", "simulated", "http", "https", "rtsp")
"""What a camera's address can begin with; else it is the path of a video or a folder of images."""


@dataclass(frozen=True)
class CameraSpec:
    """Which camera, and what is to be set on it: plain values, so that a camera can be opened in another process.

    name      in the rig
    address   such as camera://0, genicam://SERIAL, simulated://, http://HOST/video, or the path of a video or a folder of images
    settings  by name, in the units of `SETTINGS`
    """

    name: str
    address: str
    settings: Mapping[str, SettingValue] = field(default_factory=dict)

    def ready(self) -> LiveCamera:
        """The camera, open and set; one that disappears is opened again. Raises AsterismError where that fails the first time."""
        return ReopeningCamera(partial(open_camera, self)) if "://" in self.address else open_camera(self)

    def open(self, at: float | None = None) -> LiveCamera:
        """The camera, ready and started; at: see `LiveCamera.start`. Raises AsterismError where that fails."""
        camera = self.ready()
        try:
            camera.start(at)
        except BaseException:
            camera.close()
            raise
        return camera


def open_camera(spec: CameraSpec) -> LiveCamera:
    """Open a camera and set what is to be set; `outcomes` of the camera says what became of it.

    Raises AsterismError where there is no such camera, its package is not installed, or there is no such setting.
    """
    camera = _opened(spec)
    try:
        camera.outcomes = camera.set_all(spec.settings)
    except AsterismError:
        camera.close()
        raise
    return camera


def _opened(spec: CameraSpec) -> LiveCamera:
    # A module is imported only where its kind of camera is asked for: each needs packages of its own.
    scheme, found, _ = spec.address.partition("://")
    if not found:
        from asterism.live.cameras.played import PlayedCamera

        return PlayedCamera(spec.name, spec.address)
    if scheme.lower() not in SCHEMES:
        raise AsterismError(f"{spec.address} is no camera; give one of {', '.join(SCHEMES)}, or the path of a video or a folder.")
    if scheme.lower() == "genicam":
        from asterism.live.cameras.machine_vision import GenicamCamera

        return GenicamCamera(spec.name, spec.address)
    if scheme.lower() == "simulated":
        from asterism.live.cameras.simulated import SimulatedCamera

        return SimulatedCamera(spec.name, spec.address)
    from asterism.live.cameras.webcam import OpenCvCamera

    return OpenCvCamera(spec.name, spec.address)
