"""Files of a person's measures in: tables, Vicon's .mp and .vsk; values by Plug-in-Gait's names, in mm, degrees and kg, out."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from pathlib import Path, PurePath

import numpy as np

from asterism.errors import AsterismError
from asterism.files.text import cells_of, decoded, delimiter_of, lines_of, number_of, read_bytes, some_of
from asterism.motion.clinical.measures import SubjectMeasures, measure_names
from asterism.recording import Recording, subject_of

_FACTORS = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "deg": 1.0, "°": 1.0, "rad": float(np.degrees(1.0)), "kg": 1.0, "g": 0.001}
"""To mm, degrees and kg, from a unit that a table's head may give in brackets."""
_WITHOUT = ("WRISTWIDTH", "ROTATION", "TORSION", "PLANTFLEX", "ROTOFF", "ABADD", "HEADOFFSET")
"""Ends of names whose nought is a measure; of all others it says that nobody measured."""


def measures_by_name(pairs: Sequence[str]) -> dict[str, float]:
    """Measures from words such as "LKneeWidth=102". Raises AsterismError where a word is none.

    >>> measures_by_name(["LKneeWidth=102", "BodyMass=50.5"])
    {'LKneeWidth': 102.0, 'BodyMass': 50.5}
    """
    found = {}
    for pair in pairs:
        name, _, text = pair.partition("=")
        value = number_of(text)
        if value is None or not np.isfinite(value):
            raise AsterismError(f"--measure {pair} is no name and number; write for example LKneeWidth=102, in mm and degrees.")
        found[name.strip()] = value
    return found


def read_measures(path: str | Path) -> dict[str, dict[str, float]]:
    """Measures by person, by Plug-in-Gait's names: mm, degrees, kg. A file of one person calls them "".

    .mp        lines such as `$LKneeWidth = 102`, of Vicon's Workstation and Nexus; angles are in degrees
    .vsk       XML, `StaticParameter` with NAME and VALUE, such as LeftKneeWidth; angles are in radians
    any other  a table with commas, semicolons or tabs: two columns, name and value; or one row per person, whose head names the measures
               and whose first column names the people. A head may have a unit: `LKneeWidth (cm)`

    Other names than those of measures are passed over. Raises AsterismError where a file holds no measure or is damaged.
    """
    path = Path(path)
    data = read_bytes(path)
    if path.suffix.lower() == ".vsk":
        people = {"": _of_skeleton(path, data)}
    else:
        text = decoded(path, data)
        people = {"": dict(_pairs(path, text))} if path.suffix.lower() == ".mp" else _of_table(path, text)
    if not any(people.values()):
        raise AsterismError(f"{path} holds no measure by a name of Plug-in-Gait, such as LKneeWidth.")
    return people


def measures_of_person(path: str | Path, recording: Recording) -> dict[str, float]:
    """Those of a file (`read_measures`) that are of the recording's person, who is told by subject, folder or the start of the file's name.

    Raises AsterismError where the file has several people, and none or more than one of them is the recording's, and for a value that no
    person has.
    """
    people = read_measures(path)
    if len(people) == 1:
        return _believed(path, next(iter(people.values())))
    file = PurePath(str(recording.metadata.get("file", "")))
    known = {name.lower() for name in (subject_of(recording), PurePath(subject_of(recording)).name, file.parent.name, file.stem)}
    fitting = [name for name in people if name.lower() in known] or [name for name in people if file.stem.lower().startswith(name.lower())]
    if len(fitting) != 1:
        raise AsterismError(
            f"{path} has measures of {len(people)} people ({some_of(list(people))}), and {file or 'the recording'} is of none of them by "
            "subject, folder or name; give a file of this person."
        )
    return _believed(path, people[fitting[0]])


def _believed(path: str | Path, measures: dict[str, float]) -> dict[str, float]:
    """The measures, where a person can have them."""
    try:
        SubjectMeasures().with_values(measures)
    except AsterismError as problem:
        raise AsterismError(f"{path}: {problem}") from None
    return measures


def _named(name: str) -> str:
    """The name as Plug-in-Gait has it: LeftKneeWidth and $LKneeWidth are LKneeWidth; "" for one that is no measure."""
    plain = re.sub("^(left|right)", lambda side: side[0][0], re.sub(r"[$_\s]", "", name), flags=re.IGNORECASE)
    return plain if plain.upper() in measure_names() else ""


def _value(path: Path, name: str, text: str, factor: float = 1.0) -> Iterator[tuple[str, float]]:
    """The measure, where the name is one and somebody measured it."""
    known = _named(name)
    if not known or not text.strip():
        return
    value = number_of(text)
    if value is None:
        raise AsterismError(f"{path}: {name.strip()} is {text.strip()!r}, which is no number.")
    if np.isfinite(value) and (value != 0.0 or known.upper().endswith(_WITHOUT)):
        yield known, value * factor


def _pairs(path: Path, text: str) -> Iterator[tuple[str, float]]:
    for line in lines_of(text):
        name, equals, value = line.partition("=")
        if equals:
            yield from _value(path, name, value)


def _of_skeleton(path: Path, data: bytes) -> dict[str, float]:
    try:
        root = ET.fromstring(data)
    except (ET.ParseError, LookupError, ValueError) as problem:
        raise AsterismError(f"{path} is damaged: it is no whole XML ({problem}); export it again.") from problem
    found: dict[str, float] = {}
    for element in root.iter("StaticParameter"):
        factor = _FACTORS["rad"] if element.get("QUANTITY") == "angle" else 1.0
        # a PRIOR is an adult's usual value, not the person's
        found |= dict(_value(path, element.get("NAME", ""), element.get("VALUE", ""), factor))
    return found


def _of_table(path: Path, text: str) -> dict[str, dict[str, float]]:
    lines = [line for line in lines_of(text) if line.strip() and not line.startswith("#")]
    if not lines:
        return {}
    rows = [cells_of(line, delimiter_of(lines[0])) for line in lines]
    split = [re.fullmatch(r"(.*?)\s*[(\[](.+)[)\]]", cell) for cell in rows[0]]
    heads = [(found[1], found[2]) if found else (cell, "") for found, cell in zip(split, rows[0], strict=True)]
    if not any(_named(name) for name, _ in heads[1:]):
        return {"": {name: value for row in rows if len(row) > 1 for name, value in _value(path, row[0], row[1])}}
    people: dict[str, dict[str, float]] = {}
    for row in rows[1:]:
        own: dict[str, float] = {}
        for (name, unit), cell in zip(heads, row, strict=False):
            if unit and _named(name) and unit not in _FACTORS:
                raise AsterismError(f"{path}: {name} is in {unit}; units are {', '.join(_FACTORS)}.")
            own |= dict(_value(path, name, cell, _FACTORS.get(unit, 1.0)))
        person = "" if _named(heads[0][0]) else row[0]
        if person in people:
            raise AsterismError(f"{path} has {person or 'a person without a name'} twice; leave one row.")
        people[person] = own
    return people
