"""Videos that were taken together in; cameras that play them, by the names of their rig, out."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from asterism.cameras import Rig
from asterism.detection.alignment import camera_names
from asterism.detection.sources import open_source
from asterism.errors import AsterismError
from asterism.live.cameras import CameraSpec


def videos_together(paths: Sequence[Path], rig: Rig, speed: float = 1.0, loop: bool = False) -> list[CameraSpec]:
    """One camera for each video or folder of images, named as `detect` names them. Each image is waited for until it is searched.

    speed  times their own rate, inf for as fast as they are searched
    loop   whether they begin again at the end
    Raises AsterismError where a file is none, or the rig has no camera for it.
    """
    if not speed > 0:
        raise AsterismError(f"a speed of {speed:g} plays nothing; give one above 0, as in --speed 2.")
    names = camera_names([open_source(path) for path in paths], rig)
    words = f"?wait=1&speed={speed if speed < float('inf') else 0:g}&loop={int(loop)}"
    return [CameraSpec(name, f"{path}{words}") for name, path in zip(names, paths, strict=True)]
