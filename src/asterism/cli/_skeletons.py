"""A recording of markers, or a file of bones, in; the person's skeleton over time out."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from asterism.cli._options import marker_names

if TYPE_CHECKING:
    from asterism.findings import Finding
    from asterism.recording import Event, SkeletonMotion


@dataclass(frozen=True)
class PersonMotion:
    """The bones of a person over time; events in s from the first frame."""

    motion: SkeletonMotion
    events: tuple[Event, ...]
    findings: tuple[Finding, ...]


def person_motion(path: Path, static: Path | None, markers: str | None, vertical: Any, unit: str | None) -> PersonMotion:
    """The skeleton of a BVH or glTF file, or one that is fitted to the markers of a recording and a standing trial.

    Raises AsterismError where the file cannot be read, or shows too few markers of a known set.
    """
    from asterism import formats
    from asterism.recording import MarkerSet
    from asterism.skeleton import fit_person, solve_kinematics

    if formats.is_skeleton_file(path):
        found = formats.read_skeleton(path, unit=unit, vertical=vertical)
        return PersonMotion(found.motion, (), found.findings)
    names = marker_names(markers)
    recording = formats.read(path, names, vertical)
    standing = [] if static is None else [formats.read(static, names, vertical)]
    person = fit_person(standing, [recording], markers=None if names is None else MarkerSet.load(names))
    motion = solve_kinematics(person.tree, recording).motion()
    # the file's clock need not begin with its first frame
    begin = float(recording.times[0])
    events = tuple(replace(event, time=event.time - begin) for event in recording.events)
    return PersonMotion(motion, events, (*recording.warnings, *person.findings))
