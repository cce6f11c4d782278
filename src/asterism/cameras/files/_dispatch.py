"""One front door for rig files: what a file holds chooses who reads it, its suffix who writes it."""

from __future__ import annotations

from pathlib import Path

from asterism.cameras.files import own
from asterism.cameras.files._toml import read_toml
from asterism.cameras.rig import Rig
from asterism.errors import AsterismError


def read_rig(path: str | Path) -> Rig:
    """The rig in a calibration file, in metres and pixels; `lacks` says what the file does not.

    Raises AsterismError, naming the file and the camera, where it is damaged or no rig file.
    """
    path = Path(path)
    table = read_toml(path)
    if table.get("format") == own.FORMAT:
        return own.rig_of_table(path, table)
    raise AsterismError(f"{path} is no rig file that Asterism knows; calibrate with asterism calibrate, or export it in another format.")


def write_rig(rig: Rig, path: str | Path) -> list[str]:
    """Write a rig as .toml. A file there is replaced at once or not at all.

    Returns what the format could not carry, one sentence each. Raises AsterismError where the suffix is unknown or the file cannot be
    written.
    """
    path = Path(path)
    if path.suffix.casefold() != ".toml":
        raise AsterismError(f"{path}: a rig is written as .toml; choose that suffix.")
    return own.write_own(path, rig)
