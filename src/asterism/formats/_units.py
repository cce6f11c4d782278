"""Units of length: what a file says of them and the positions in, metres per unit out; and whether a person of that size can be."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from asterism.errors import AsterismError
from asterism.findings import Finding
from asterism.formats._findings import units_assumed, units_doubtful, units_unknown
from asterism.formats._vertical import level_of
from asterism.recording import Floats, is_unnamed, shipped_sets, worn_marker_sets
from asterism.recording.arrays import missing_codes, nan_median
from asterism.recording.display import metres

_SPELLINGS = {
    1.0: "m meter meters metre metres mtr",
    0.1: "dm decimeter decimeters decimetre decimetres",
    0.01: "cm cms centimeter centimeters centimetre centimetres",
    0.001: "mm mms millimeter millimeters millimetre millimetres",
    1e-6: "um \N{MICRO SIGN}m \N{GREEK SMALL LETTER MU}m micron microns micrometer micrometers micrometre micrometres",
    1000.0: "km kilometer kilometers kilometre kilometres",
    0.0254: "in inch inches",
    0.3048: "ft foot feet",
    0.9144: "yd yard yards",
}
METRES_PER_UNIT = {name: length for length, names in _SPELLINGS.items() for name in names.split()}
_SMALLEST_BODY, _LARGEST_BODY = 0.005, 60.0
_SMALLEST_PERSON, _LARGEST_PERSON = 0.3, 3.0
"""m: `body_size` of a person's markers. Real ones are 0.9 m (a child of 1.3 m, denser at the feet) to 2.4 m (arms and legs spread), so that
an error of ten is outside on either side; at half of the first or double the second, some would be inside."""
_FURTHEST_NEXT = 0.3
"""m: median distance of a point from the next one of its frame, beyond which many points are no markers on persons: these are at 0.04 to
0.2 m, ten times as far where the unit is off by ten. At half of it few markers on a large person are doubted, at double dense sets pass."""
_FEWEST = 8


def metres_per_unit(path: Path | str, declared: str | None, raw: Floats, others: Sequence[str] = ()) -> tuple[float, str, list[Finding]]:
    """Metres per unit of a file or a stream, that unit's name, and a finding where the unit is assumed.

    declared  what stands where the unit belongs, or None
    raw       (T, P, 3) positions in the file's unit
    others    further header values among which a misplaced unit may stand

    Raises AsterismError where the unit that the file names makes a body of less than 5 mm or more than 60 m, or where nobody knows it: its
    name is unknown, and no usual unit makes the points as large as a person.
    """
    size = body_size(raw)
    scale = METRES_PER_UNIT.get((declared or "").strip().casefold())
    if scale is not None:
        if np.isfinite(size) and not _SMALLEST_BODY <= size * scale <= _LARGEST_BODY:
            # An odd size may be real: the unit stands where the sizes of all units are odd.
            likely = _unit_by_size(size, raw)
            if METRES_PER_UNIT[likely] == scale:
                return scale, _short_unit(scale), [units_assumed(f"the points lie {metres(size * scale)} apart")]
            raise AsterismError(
                f"{path} gives its units as {declared}, which makes its points {metres(size * scale)} wide; "
                f"the units are probably {likely}: correct the units field."
            )
        return scale, _short_unit(scale), []
    # Exporters shift the header by a cell, so that the unit stands in its neighbour's place.
    misplaced = next((other.strip() for other in others if other.strip().casefold() in METRES_PER_UNIT), None)
    what = f"the units {declared.strip()!r} are not known" if declared and declared.strip() else "no units in the file"
    if misplaced is not None:
        found, name, _ = metres_per_unit(path, misplaced, raw)
        return found, name, [units_assumed(f"{what}; {name} stands in another field of the header")]
    name = _unit_by_size(size, raw)
    fits = _SMALLEST_PERSON <= size * METRES_PER_UNIT[name] <= _LARGEST_PERSON
    told = f"{what}; {name} {'fits the size of the body' if fits else 'was taken'}"
    if not (declared and declared.strip()):
        return METRES_PER_UNIT[name], name, [units_assumed(told)]
    if fits:
        return METRES_PER_UNIT[name], name, [units_unknown(told)]
    raise AsterismError(
        f"{path}: {what}, and with none of m, cm and mm its points are as large as a person; "
        "write one of them, or um, in or ft, into the units field."
    )


def _short_unit(scale: float) -> str:
    return _SPELLINGS[scale].split()[0]


def body_size(raw: Floats) -> float:
    """The size of what a frame shows, in the given unit: four times the median distance from the median point.

    About the height of a whole body. A few missing points do not matter. NaN with fewer than two points.
    """
    # Some fifty frames tell the size as well as an hour does: with half or double of them it differs by less than 1 %.
    some = raw[:: max(1, len(raw) // 50)]
    # Numbers from damage must not decide: infinite, or beyond what squares can hold.
    x, y, z = np.moveaxis(np.abs(some) < 1e100, 2, 0)
    usable = x & y & z & ~missing_codes(some)
    some = np.where(usable[:, :, None], some, np.nan)
    some = some[(~np.isnan(some[:, :, 0])).sum(axis=1) > 1]
    if not len(some):
        return float("nan")
    # Four times the median distance from the middle is about the height of a standing person.
    away = np.linalg.norm(some - nan_median(some, axis=1)[:, None], axis=2)
    size = 4.0 * float(nan_median(nan_median(away, axis=1), axis=0))
    return size if size > 0 else float("nan")


def unlike_a_person(positions: Floats) -> str:
    """What a person would ask of points (T, P, 3) m that are all together too small or too large for one; else nothing.

    >>> standing = np.array([[[0.0, 0.0, 0.0], [0.1, 0.0, 0.5], [0.0, 0.1, 1.0], [0.1, 0.1, 1.6]]])
    >>> unlike_a_person(standing), unlike_a_person(0.01 * standing)
    ('', 'together they are as large as a body of 0.0203 m: check the unit of length')
    """
    size = body_size(positions)
    if not np.isfinite(size) or _SMALLEST_PERSON <= size <= _LARGEST_PERSON:
        return ""
    return f"together they are as large as a body of {metres(size)}: check the unit of length"


def _unit_by_size(size: float, raw: Floats) -> str:
    """The unit in which that size is a person's; for a single point, the unit that fits its distance from the origin."""
    if np.isfinite(size):
        return "m" if size < 12 else "cm" if size < 300 else "mm" if size < 1000 * _LARGEST_BODY else "um"
    # A single point has no size: its distance from the origin is all there is.
    away = np.abs(raw[np.isfinite(raw)])
    return "m" if len(away) and float(nan_median(away, axis=0)) < 12 else "mm"


def size_findings(positions: Floats, labels: Sequence[str], captured: Sequence[int], units: str) -> list[Finding]:
    """A finding where a person would be smaller than 0.3 m or larger than 3 m.

    positions (T, P, 3) m and labels (P,) of all points; captured: the columns that were not computed; units of the file

    A person is who wears named markers on several levels of the body. Small ones must wear a shipped set, since animals and hands have such
    names as well. Without names, many points that are all far from each other are no persons.
    """
    size = _person_size(positions, labels, captured)
    if size is None:
        # Ten times too large, that is: all together, and from point to point.
        size = body_size(positions[:, captured]) if len(captured) >= _FEWEST else 0.0
        if not size > _LARGEST_PERSON:
            return []
        apart = _apart(positions[:, captured])
        if not apart > _FURTHEST_NEXT:
            return []
        said = f"its points are {metres(apart)} from each other, too far for markers on a person"
    else:
        said = f"its markers are worn by a person of {metres(size)}"
    scale = METRES_PER_UNIT.get(units.strip().casefold())
    # The power of ten that brings it nearest to a usual person.
    likely = next(
        (names.split()[0] for length, names in _SPELLINGS.items() if scale and abs(np.log10(size * length / scale / 1.5)) < 0.3), ""
    )
    if likely:
        said += f"; with {likely} instead of {units} it would be {metres(size * METRES_PER_UNIT[likely] / (scale or 1.0))}"
    return [units_doubtful(f"the unit of length is probably wrong: {said}")]


def _person_size(positions: Floats, labels: Sequence[str], captured: Sequence[int]) -> float | None:
    """`body_size` of the first person whose named markers are too small or too large for one; None where nobody's are."""
    people = defaultdict[str, list[int]](list)
    for column in captured:
        if not is_unnamed(labels[column]):
            people[labels[column].rpartition(":")[0]].append(column)
    for columns in people.values():
        levels = {level_of(labels[column]) for column in columns} - {-1}
        named = {labels[column].casefold() for column in columns}
        # Two people whose markers have the same names are not told apart.
        if len(levels) < 2 or len(named) < len(columns):
            continue
        size = body_size(positions[:, columns])
        if size > _LARGEST_PERSON or (size < _SMALLEST_PERSON and _wears_a_set([labels[column] for column in columns])):
            return size
    return None


def _wears_a_set(labels: Sequence[str]) -> bool:
    """Whether these are the markers of a shipped set of more than a foot or a hand."""
    sets = shipped_sets()
    return any(len({level_of(name) for name in sets[worn.name].names} - {-1}) > 1 for worn in worn_marker_sets(labels))


def _apart(positions: Floats) -> float:
    """m: the median distance of a point from the next one of its frame; 0 where no frame shows enough points."""
    nearest = list[Floats]()
    for frame in positions[:: max(1, len(positions) // 20)]:
        points = frame[~np.isnan(frame[:, 0])][:200]
        if len(points) >= _FEWEST:
            distances = np.linalg.norm(points[:, None] - points, axis=2)
            np.fill_diagonal(distances, np.inf)
            nearest.append(distances.min(axis=1))
    return float(nan_median(np.concatenate(nearest), axis=0)) if nearest else 0.0
