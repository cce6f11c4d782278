"""A recording in; the same recording as the next program takes it out: the axis that is up, the unit, and which points come along."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from asterism.errors import AsterismError
from asterism.formats._dispatch import write
from asterism.formats.c3d._file import C3DFile
from asterism.formats.c3d.plates import force_plates
from asterism.formats.opensim_forces import write_opensim_forces
from asterism.recording import Floats, Recording, as_vertical, is_unnamed


@dataclass(frozen=True)
class ProgramInput:
    """What a program reads.

    suffix  of the file
    up      the axis that it takes as vertical
    named   whether points without a name, computed points and analog data are in its way and stay behind
    """

    suffix: str
    up: str
    named: bool


PROGRAMS = {
    "opensim": ProgramInput(".trc", "y", named=True),
    "visual3d": ProgramInput(".c3d", "z", named=False),
    "blender": ProgramInput(".c3d", "z", named=True),
}
"""OpenSim's models stand along Y, and its inverse kinematics reads TRC. Visual3D and Blender stand along Z. All are written in mm."""


def for_program(recording: Recording, program: str, target: str | Path) -> tuple[Recording, list[str]]:
    """The recording as a program of `PROGRAMS` takes it, and a phrase for each thing that it leaves behind.

    A C3D file whose vertical and points suit the program stays as it is, with everything in it. Raises AsterismError where the program is
    not known or reads no file like `target`.

    >>> from asterism.simulation import simulate_walks
    >>> walk = simulate_walks(1, frames=20, seed=0)[0]
    >>> ready, lost = for_program(walk, "opensim", "walk.trc")
    >>> ready.vertical.round(6) + 0.0
    array([0., 1., 0.])
    """
    if program not in PROGRAMS:
        raise AsterismError(f"{program!r} is no program that files are written for; take one of {', '.join(PROGRAMS)}.")
    wanted, target = PROGRAMS[program], Path(target)
    if target.suffix.casefold() != wanted.suffix:
        raise AsterismError(f"{target}: files for {program} are written as {wanted.suffix}; name it {target.stem}{wanted.suffix}.")
    up, left = as_vertical(wanted.up), list[str]()
    turned = not np.allclose(recording.vertical, up, atol=1e-6)
    # A file that suits the program already is not touched.
    if not turned and not wanted.named:
        return recording, left
    # Turned points no longer fit the analog data and axes of their file.
    if isinstance(recording.source, C3DFile):
        also = " and forces" if program == "opensim" else ""
        why = f"which {program} does not need" if wanted.named else "whose axes are those of the file"
        left.append(f"what {recording.metadata.get('file', 'the source')} holds besides markers, events{also}, {why}")
    elif recording.source is not None and len(recording.source.labels) > len(recording.taken):
        left.append(f"{len(recording.source.labels) - len(recording.taken)} computed points")
    positions = recording.positions @ rotation_between(recording.vertical, up).T if turned else recording.positions
    metadata = {**recording.metadata, "units": "mm"}
    # Without its source, the file is written anew in the program's axes.
    prepared = replace(recording, positions=positions, vertical=up, metadata=metadata, source=None, origin=None, taken=())
    if not wanted.named:
        return prepared, left
    named = [label for label in prepared.labels if not is_unnamed(label)]
    if not named:
        raise AsterismError(f"{recording.metadata.get('file', 'the recording')} has no point with a name for {program}; label it first.")
    if len(named) < len(prepared.labels):
        left.append(f"{len(prepared.labels) - len(named)} points without a name")
    return prepared.select(named), left


def write_for_program(recording: Recording, program: str, target: str | Path, **marks: Any) -> list[str]:
    """Write the recording as a program of `PROGRAMS` takes it; returns a phrase for each thing that is left behind.

    For opensim the forces of a C3D file's force plates are written beside it, see `opensim_forces`. marks: `labelling` and `clouds`, as
    `write` takes them. Raises AsterismError as `for_program` and `write` do.
    """
    prepared, left = for_program(recording, program, target)
    left += write(target, prepared, **marks)
    if program == "opensim" and isinstance(recording.source, C3DFile) and len(recording):
        plates, findings = force_plates(recording)
        for finding in findings:
            what, _, why = finding.sentence.rpartition(f"{recording.source.path}: ")[2].rstrip(".").partition(" cannot be used: ")
            left.append(f"{what} ({why})")
        if plates:
            turn = rotation_between(recording.vertical, as_vertical(PROGRAMS[program].up))
            left += write_opensim_forces(Path(target), recording, plates, turn)
    return left


def rotation_between(vertical: Floats, up: Floats) -> Floats:
    """The smallest rotation (3, 3) that brings one unit vector to another; about X where they are opposite."""
    axis, cosine = np.cross(vertical, up), float(vertical @ up)
    # Opposite vectors have no single smallest rotation: any axis across them will do.
    if cosine < -1 + 1e-9:
        about = np.array([1.0, 0.0, 0.0]) if abs(vertical[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
        about = about - (about @ vertical) * vertical
        about /= np.linalg.norm(about)
        return 2 * np.outer(about, about) - np.eye(3)
    cross = np.array([[0.0, -axis[2], axis[1]], [axis[2], 0.0, -axis[0]], [-axis[1], axis[0], 0.0]])
    return np.eye(3) + cross + cross @ cross / (1 + cosine)
