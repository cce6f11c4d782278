"""The force plates of a C3D file: channels, corners and origins in; forces, centres of pressure and free moments in metres and newtons out.

Plates of types 1 (forces and centre of pressure), 2 (forces and moments), 3 (eight sensors of force), 4 and 5 (2 and 3 behind a calibration
matrix). Source: the public C3D format specification, "The force platform group".
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from asterism.findings import Finding
from asterism.formats._columns import METRES_PER_UNIT
from asterism.formats._findings import located, plate_doubt
from asterism.formats.c3d._file import C3DFile, open_c3d
from asterism.recording import Floats
from asterism.recording.force_plate import SOMEBODY, UNLOADED, ForcePlate

_CHANNELS = {1: 6, 2: 6, 3: 8, 4: 6, 5: 8}
"""How many channels a plate of each type has."""
_NEWTONS = {"": 1.0, "n": 1.0, "nt": 1.0, "newton": 1.0, "newtons": 1.0, "kn": 1000.0, "lbf": 4.4482, "lb": 4.4482, "lbs": 4.4482}
_MOMENTS = (1.0, 0.01, 0.001)
"""N m in N m, N cm and N mm."""
_BEYOND = 0.02
"""m beyond its edges where a centre of pressure may lie: corners are measured with markers, whose radius is half as much."""


_Doubt = tuple[str, str]
"""What of a plate is left out, and why."""


class _Unreadable(Exception):
    """Why a plate cannot be read, as a phrase."""


@dataclass(frozen=True)
class _Load:
    """What the sensors of a plate measure, in its axes.

    forces     (S, 3) N
    moments    (S, 3) in the unit of moments; of a plate that gives centres of pressure, the free moment as z
    about      (3,) m, the parameter ORIGIN, see `_origins`
    unit       N m of the unit of moments; None where it is not known
    pressures  (S, 2) m, the centres of pressure, of a plate that gives them
    """

    forces: Floats
    moments: Floats
    about: Floats
    unit: float | None
    pressures: Floats | None = None


def read_force_plates(path: str | Path) -> tuple[list[ForcePlate], list[Finding]]:
    """The force plates of a C3D file in the axes of its points, and what is to be known of them; none where it has none.

    Raises AsterismError where the file cannot be read.
    """
    return force_plates(open_c3d(Path(path)))


def force_plates(file: C3DFile, metres: float | None = None) -> tuple[list[ForcePlate], list[Finding]]:
    """The same of a parsed file. metres: the length of its unit; by default that of POINT:UNITS, else a millimetre.

    A plate that cannot be read is left out, with a finding.
    """
    if metres is None:
        metres = METRES_PER_UNIT.get(file.parameters.text("POINT", "UNITS").strip().casefold(), 0.001)
    plates, findings = list[ForcePlate](), list[Finding]()
    for place in range(file.parameters.count("FORCE_PLATFORM", "USED") or 0):
        try:
            plate, doubts = _plate(file, place, metres)
        except _Unreadable as problem:
            findings.append(plate_doubt(f"force plate {place + 1} is left out: {problem}"))
            continue
        plates.append(plate)
        findings += [plate_doubt(f"{part} of force plate {place + 1} is left out: {why}") for part, why in doubts]
    return plates, list(located(file.path, findings))


def _plate(file: C3DFile, place: int, metres: float) -> tuple[ForcePlate, list[_Doubt]]:
    """One plate, and what of it is left out."""
    corners = metres * _row(file, "CORNERS", place, 12).reshape(4, 3)
    axes = _axes(corners)
    load, doubts = _measured(file, place, metres)
    # Programs store what the plate does to the body, or the opposite. The ground pushes, along -z, and never pulls.
    sign = -1.0 if load.forces[:, 2].sum() > 0 else 1.0
    forces, moments = sign * load.forces, sign * load.moments
    loaded = -forces[:, 2] >= UNLOADED
    nowhere = np.full((len(forces), 3), np.nan)
    empty = ForcePlate(corners, -axes[2], _rate(file), (file.first_frame - 1) / file.rate, forces @ axes, nowhere, nowhere)

    def placed(unit: float, about: Floats) -> tuple[Floats, Floats, float]:
        """Centres of pressure and free moments of the loaded samples, and the share of the former that lie on the plate."""
        force, moment = forces[loaded], unit * moments[loaded] + np.cross(about, forces[loaded])
        x, y = (-moment[:, 1] / force[:, 2], moment[:, 0] / force[:, 2]) if load.pressures is None else load.pressures[loaded].T
        free = moment[:, 2] - x * force[:, 1] + y * force[:, 0] if load.pressures is None else moment[:, 2]
        points = corners.mean(axis=0) + np.column_stack([x, y]) @ axes[:2]
        return points, free[:, None] * axes[2], float(empty.on_surface(points, _BEYOND).mean()) if len(points) else 1.0

    tried = [(unit, about) for unit in ([load.unit] if load.unit else _MOMENTS) for about in _origins(load.about)]
    found = [placed(unit, about) for unit, about in tried]
    # The unit that is largest of those by which most centres are on the plate: too small a one puts them all into its middle.
    best = next((one for one in found if one[2] > 0.5), None)
    if best is None:
        outside = 100 * (1 - max(one[2] for one in found))
        raise _Unreadable(f"{outside:.0f} % of its centres of pressure lie outside its corners; these, its origin or units are wrong")
    pressures, free = nowhere.copy(), nowhere.copy()
    pressures[loaded], free[loaded] = best[:2]
    return replace(empty, pressures=pressures, moments=free), doubts


def _measured(file: C3DFile, place: int, metres: float) -> tuple[_Load, list[_Doubt]]:
    """What the sensors measure, by the type of the plate, less its baseline; and what is left out."""
    types = file.parameters.values("FORCE_PLATFORM", "TYPE")
    kind = int(types[place]) if place < len(types) else 0
    if kind not in _CHANNELS:
        raise _Unreadable(f"its type {kind} is none of {', '.join(map(str, _CHANNELS))}")
    samples, units = _samples(file, place, _CHANNELS[kind])
    origin, unit = metres * _row(file, "ORIGIN", place, 3), _moment_unit(units[3])
    if kind in (4, 5):
        # As all matrices of a C3D file, by columns: the outputs vary first.
        samples = samples @ _row(file, "CAL_MATRIX", place, 6 * _CHANNELS[kind]).reshape(_CHANNELS[kind], 6)
    else:
        force_units = units[: 8 if kind == 3 else 3]
        strange = [each for each in force_units if each.casefold() not in _NEWTONS]
        if strange:
            raise _Unreadable(f"its channels are in {strange[0]}, not in N; calibrate them")
        scale = np.ones(samples.shape[1])
        scale[: len(force_units)] = [_NEWTONS[each.casefold()] for each in force_units]
        samples = samples * scale
    if kind == 3:
        samples, unit = _of_eight(samples, np.abs(origin[:2])), 1.0
    level, doubts = _baseline(file, samples)
    samples = samples - level
    forces, moments = samples[:, :3], samples[:, 3:]
    if kind == 1:
        # Its place in the unit of the points, and the moment about it; the baseline is that of the forces.
        pressures = metres * (moments[:, :2] + level[3:5])
        free = np.column_stack([np.zeros((len(moments), 2)), moments[:, 2]])
        return _Load(forces, free, np.zeros(3), unit or _moment_unit(units[5]) or metres, pressures), doubts
    return _Load(forces, moments, np.array([0.0, 0.0, np.abs(origin[2])]) if kind == 3 else origin, unit), doubts


def _of_eight(samples: Floats, apart: Floats) -> Floats:
    """(S, 6) forces in N and moments in N m about the middle between the sensors, of eight sensors in N; apart (2,): m from there."""
    fx12, fx34, fy14, fy23, fz1, fz2, fz3, fz4 = samples.T
    a, b = apart
    forces = [fx12 + fx34, fy14 + fy23, fz1 + fz2 + fz3 + fz4]
    moments = [b * (fz1 + fz2 - fz3 - fz4), a * (-fz1 + fz2 + fz3 - fz4), b * (-fx12 + fx34) + a * (fy14 - fy23)]
    return np.stack([*forces, *moments], axis=1)


def _origins(about: Floats) -> list[Floats]:
    """The point about which moments are, from the middle of the surface; it lies below, where z is positive.

    The parameter is the vector from this point to the middle. Programs that write the opposite give it a positive z. With a z of 0 both are
    possible, where the point is not the middle itself.
    """
    if about[2] or not about[:2].any():
        return [-about if about[2] < 0 else about]
    return [-about, about]


def _row(file: C3DFile, name: str, place: int, size: int) -> Floats:
    """The values of one plate in a parameter. Raises _Unreadable where it has too few."""
    record, values = file.parameters.find("FORCE_PLATFORM", name), file.parameters.values("FORCE_PLATFORM", name)
    # Plates with fewer channels have the room of those with most.
    width = size if record is None or len(record.dimensions) < 2 else int(np.prod(record.dimensions[:-1] or (1,)))
    width = size if name != "CAL_MATRIX" and width != size and len(values) % size == 0 else max(width, size)
    row = values[place * width : place * width + size]
    if len(row) < size or not np.isfinite(row).all():
        raise _Unreadable(f"FORCE_PLATFORM:{name} does not hold its {size} values")
    return row


def _axes(corners: Floats) -> Floats:
    """(3, 3) unit vectors x, y and z of the plate, in rows. Corner 1 is at +x +y, 2 at -x +y, 3 at -x -y, 4 at +x -y; z points down."""
    x = corners[0] + corners[3] - corners[1] - corners[2]
    y = corners[0] + corners[1] - corners[2] - corners[3]
    z = np.cross(x, y)
    if min(np.linalg.norm(x), np.linalg.norm(y)) < 0.01 or np.linalg.norm(z) < 0.01 * np.linalg.norm(x) * np.linalg.norm(y):
        raise _Unreadable("its corners span no surface")
    z, x = z / np.linalg.norm(z), x / np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z])


def _samples(file: C3DFile, place: int, count: int) -> tuple[Floats, list[str]]:
    """(S, count) the samples of its channels in the file's units, and these units. Raises _Unreadable where a channel is not there."""
    record, channels = file.parameters.find("FORCE_PLATFORM", "CHANNEL"), file.parameters.values("FORCE_PLATFORM", "CHANNEL")
    width = record.dimensions[0] if record is not None and len(record.dimensions) > 1 else count
    own = channels[place * width : place * width + count].astype(np.int64) - 1
    samples = file.analog
    if len(own) < count or (own < 0).any() or (own >= samples.shape[1]).any():
        raise _Unreadable("its channels are not among the analog channels")
    if not np.isfinite(samples[:, own]).all():
        raise _Unreadable("its channels hold values that are no numbers")
    units = file.parameters.strings("ANALOG", "UNITS")
    return samples[:, own], [units[channel].strip() if channel < len(units) else "" for channel in own]


def _baseline(file: C3DFile, samples: Floats) -> tuple[Floats, list[_Doubt]]:
    """(6,) the mean of forces and moments over the frames of FORCE_PLATFORM:ZERO; zeros without such, or where the plate was loaded."""
    zero = file.parameters.values("FORCE_PLATFORM", "ZERO")
    first, last = (int(value) - file.first_frame for value in zero[:2]) if len(zero) >= 2 and zero[0] > 0 else (0, -1)
    if not 0 <= first <= last < file.layout.frames:
        return np.zeros(6), []
    each = len(samples) // file.layout.frames
    level = np.asarray(samples[first * each : (last + 1) * each].mean(axis=0))
    # A standing trial begins with a person on the plate, whose weight is no baseline.
    if abs(level[2]) < SOMEBODY:
        return level, []
    frames = f"the frames {zero[0]:.0f} to {zero[1]:.0f} of FORCE_PLATFORM:ZERO"
    return np.zeros(6), [("the baseline", f"it bore {abs(level[2]):.0f} N in {frames}")]


def _moment_unit(text: str) -> float | None:
    """N m of a unit of moments such as Nmm or N.m; None where it is none."""
    plain = text.casefold().replace("nt", "n").translate(str.maketrans("", "", " .*-·"))
    return {"nm": 1.0, "ncm": 0.01, "nmm": 0.001, "newtonmetres": 1.0, "newtonmeters": 1.0}.get(plain)


def _rate(file: C3DFile) -> float:
    """Samples per second: so many in each frame."""
    return file.rate * (len(file.analog) / file.layout.frames)
