"""Several cameras in; the same open and started together, one that fails costing itself, out."""

from __future__ import annotations

import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

from asterism.errors import AsterismError
from asterism.live.cameras.camera import LiveCamera
from asterism.live.cameras.opening import CameraSpec
from asterism.live.cameras.settings import SettingOutcome, SettingValue

_START = 0.2
"""s from the last camera's opening to the first image of files and simulated cameras, so that all begin together. Half of it a busy machine
misses; twice as much is waited for."""


class CameraGroup:
    """Cameras that are open in this process.

    cameras   that could be opened, in the order in which they were given
    failed    why others could not, by name

    Raises AsterismError where none could.
    """

    def __init__(self, specs: Sequence[CameraSpec]) -> None:
        self.failed: dict[str, str] = {}
        # A driver takes a second or two to open a camera.
        with ThreadPoolExecutor(max(1, len(specs))) as pool:
            opened = list(pool.map(self._open, specs))
        self.cameras = [camera for camera in opened if camera is not None]
        if not self.cameras:
            raise AsterismError(
                " ".join(f"camera {name}: {why}" for name, why in self.failed.items())
                or "there is no camera; name some in a file for --cameras."
            )

    def _open(self, spec: CameraSpec) -> LiveCamera | None:
        try:
            return spec.ready()
        except AsterismError as problem:
            self.failed[spec.name] = str(problem)
            return None

    @property
    def outcomes(self) -> list[SettingOutcome]:
        """What became of the settings with which they were opened."""
        return [outcome for camera in self.cameras for outcome in camera.outcomes]

    def said(self) -> dict[str, dict[str, SettingValue]]:
        """What each camera says of itself, by its name."""
        return {camera.name: camera.said() for camera in self.cameras}

    def start(self) -> None:
        """Begin with images, all together; one that cannot is closed and listed as failed."""
        at = time.monotonic() + _START
        for camera in list(self.cameras):
            try:
                camera.start(at)
            except AsterismError as problem:
                self.failed[camera.name] = str(problem)
                self.cameras.remove(camera)
                camera.close()

    def close(self) -> None:
        """Let go of all of them."""
        for camera in self.cameras:
            camera.close()
