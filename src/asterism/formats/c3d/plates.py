"""A C3D file in; its force plates out, as forces on the person in the axes of the points.

Source: the public C3D format specification, "The FORCE_PLATFORM group": types 1 to 4, corners, origins, channels, calibration matrices.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from asterism.findings import Finding, Severity
from asterism.formats.c3d._file import C3DFile
from asterism.recording import Floats, Recording
from asterism.recording.force_plate import LOADED, ForcePlate

_CHANNELS = {1: 6, 2: 6, 3: 8, 4: 6}
"""Channels by type: 1 force, centre of pressure and free moment; 2 force and moment; 3 eight sensors; 4 force and moment, uncalibrated."""
_SOMEBODY = 50.0
"""N, five kilograms: from this load on somebody stands on a plate, and it is no baseline. At half, the drift of old plates would stay; at
double, a small child who stands there at first would be subtracted."""
_VOLTS = {"V", "MV", "VOLT", "VOLTS"}
_DRIFT = 15.0
"""N: a plate whose unloaded force is nearer to zero than this has drifted, and is brought back to zero. Below the 20 N of a step."""


def force_plates(recording: Recording) -> tuple[tuple[ForcePlate, ...], tuple[Finding, ...]]:
    """The force plates of the C3D file that a recording was read from, and what was found out about them.

    None for a recording without its file, and for plates whose corners or channels the file does not give; a finding names these.
    Samples and their baseline (FORCE_PLATFORM:ZERO) are those of the file. O(samples).
    """
    file = recording.source
    if not isinstance(file, C3DFile) or not file.analog_channels:
        return (), ()
    used = int(file.parameters.number("FORCE_PLATFORM", "USED") or 0)
    scale = float(recording.metadata.get("metres_per_unit", 0.001) or 0.001)
    samples, turned_over = _without_overflow(file.analog)
    rate = recording.rate * len(samples) / max(len(recording), 1)
    plates, found = [], []
    for number in range(used):
        try:
            plates.append(_plate(file, number, samples, rate, scale, recording.vertical))
        except _Unusable as problem:
            path = str(recording.metadata.get("file", "the file"))
            found.append(
                Finding(
                    "format-force-plate",
                    Severity.WARNING,
                    f"plate {number + 1}",
                    f"{path}: force plate {number + 1} cannot be used: {problem}.",
                    "Export the trial again with its force plates.",
                )
            )
    of_plates = {column for number in range(used) for column in _columns(file, number)}
    if of_plates.intersection(turned_over):
        path = str(recording.metadata.get("file", "the file"))
        channels = ", ".join(str(column + 1) for column in turned_over if column in of_plates)
        sentence = f"{path}: analog channels {channels} of force plates ran over the range of 16 bits, from one end to the other."
        mend = "They were continued beyond it; export the trial with a larger ANALOG:SCALE or as real numbers."
        found.append(Finding("format-analog-overflow", Severity.WARNING, "force plates", sentence, mend))
    return tuple(plates), tuple(found)


_RANGE = 65536.0
"""Numbers that 16 bits tell apart."""


def _without_overflow(samples: Floats) -> tuple[Floats, list[int]]:
    """Samples (n, channels) with those channels continued that left the range of 16 bits at one end and came in at the other, and which.

    They are whole numbers within that range, jump by more than half of it and, continued, end where they end: a load that goes has left
    nothing behind.
    """
    jumped = np.flatnonzero((np.abs(np.diff(samples, axis=0)) > 0.75 * _RANGE).any(axis=0))
    out, turned_over = samples, list[int]()
    for column in jumped.tolist():
        raw = samples[:, column]
        if not np.isfinite(raw).all() or np.abs(raw).max() > _RANGE / 2 or (raw != np.round(raw)).any():
            continue
        continued = np.unwrap(raw, period=_RANGE)
        if continued[-1] == raw[-1]:
            out = samples.copy() if out is samples else out
            out[:, column] = continued
            turned_over.append(column)
    return out, turned_over


def _columns(file: C3DFile, number: int) -> list[int]:
    """The channels of a plate; none where the file does not say."""
    kinds = file.parameters.values("FORCE_PLATFORM", "TYPE")
    try:
        return _channels(file, number, int(kinds[number])) if number < len(kinds) and int(kinds[number]) in _CHANNELS else []
    except _Unusable:
        return []


class _Unusable(Exception):
    """Why a plate tells no forces."""


def _plate(file: C3DFile, number: int, samples: Floats, rate: float, scale: float, vertical: Floats) -> ForcePlate:
    kinds = file.parameters.values("FORCE_PLATFORM", "TYPE")
    kind = int(kinds[number]) if number < len(kinds) else 0
    if kind not in _CHANNELS:
        raise _Unusable(f"it is of type {kind}, and types 1 to 4 are known")
    corners = _of_plate(file, "CORNERS", number, 12).reshape(4, 3) * scale
    if not np.isfinite(corners).all() or np.ptp(corners, axis=0).max() < 0.05:
        raise _Unusable("the file does not say where its corners are")
    origin = _of_plate(file, "ORIGIN", number, 3) * scale
    columns = _channels(file, number, kind)
    values = _without_baseline(file, samples[:, columns], kind)
    if kind == 1:
        # places have no baseline
        values[:, 3:5] = samples[:, columns[3:5]]
    units = [unit.strip().upper().replace("-", "").replace("*", "") for unit in file.parameters.strings("ANALOG", "UNITS")]
    volts = _VOLTS.intersection(units[column] for column in columns if column < len(units))
    # Volts without a matrix are no forces, however much they look like them.
    if kind != 4 and volts:
        raise _Unusable(f"its channels are in {min(volts)}, not in N")
    of_moments = {"NM": 1.0, "NMM": 0.001, "NTMM": 0.001}
    factor = of_moments.get(units[columns[-1]] if columns[-1] < len(units) else "", scale)
    matrix = _matrix(file, number) if kind == 4 else np.eye(6)
    # Axes of the plate, by its corners: x from the second and third to the first and fourth, z into the floor.
    x = corners[0] + corners[3] - corners[1] - corners[2]
    y = corners[0] + corners[1] - corners[2] - corners[3]
    axes = np.stack([x / np.linalg.norm(x), y / np.linalg.norm(y), np.zeros(3)], axis=1)
    axes[:, 2] = np.cross(axes[:, 0], axes[:, 1])
    # ramps and stairs are less steep than 60 degrees; at 30 ramps are lost, beyond 80 the place on an upright plate is nowhere
    if abs(float(axes[:, 2] @ vertical)) < 0.5:
        raise _Unusable("its surface stands upright, as its corners and the vertical have it; look which way is up")
    # The surface is above the sensors. Some programs write the vector the other way round, or moments in another unit than they name.
    below = -origin if origin[2] > 0 else origin

    def put(origin: Floats, factor: float) -> ForcePlate:
        return ForcePlate(number + 1, corners, *_in_the_room(kind, values, origin, factor, matrix, axes, vertical), rate, vertical)

    # The specification's way. Another one counts only where this takes people off the plate.
    usual = put(below, factor)
    if _share_inside(usual) > 0.5:
        return usual
    plates = [usual, put(-below, factor), put(below, 0.001 * factor), put(below, 1000.0 * factor)]
    shares = [_share_inside(plate) for plate in plates]
    if max(shares) <= 0.5 and (usual.load > 5 * LOADED).any():
        raise _Unusable(f"{100 * (1 - max(shares)):.0f} % of its centres of pressure lie outside its corners")
    return plates[int(np.argmax(shares))]


def _in_the_room(
    kind: int, values: Floats, origin: Floats, factor: float, matrix: Floats, axes: Floats, vertical: Floats
) -> tuple[Floats, Floats]:
    """Force and moment on the person about the middle of the surface, in the recording's axes."""
    force, moment = (part @ axes.T for part in _READERS[kind](values, origin, factor, matrix))
    loads = force @ vertical
    # Some programs write the force on the plate, others that on the person. Only the latter lifts.
    if np.nanmax(-loads, initial=0.0) > np.nanmax(loads, initial=0.0):
        force, moment = -force, -moment
    return _brought_to_zero(force, moment, vertical)


def _share_inside(plate: ForcePlate) -> float:
    """Of the samples with more than 100 N, those whose centre of pressure is on the plate."""
    heavy = plate.load > 5 * LOADED
    if not heavy.any():
        return 0.0
    arm = plate.pressure[heavy] - plate.centre
    sides = [plate.corners[0] - plate.corners[1], plate.corners[0] - plate.corners[3]]
    return float(np.all([np.abs(arm @ side) <= 0.5 * (side @ side) for side in sides], axis=0).mean())


def _of_plate(file: C3DFile, name: str, number: int, count: int) -> Floats:
    values = np.asarray(file.parameters.values("FORCE_PLATFORM", name), dtype=np.float64)[number * count : (number + 1) * count]
    if len(values) < count:
        raise _Unusable(f"the file has no FORCE_PLATFORM:{name} for it")
    return values


def _channels(file: C3DFile, number: int, kind: int) -> list[int]:
    record = file.parameters.find("FORCE_PLATFORM", "CHANNEL")
    # A list of plates of several types is as wide as the widest.
    width = record.dimensions[0] if record is not None and record.dimensions else _CHANNELS[kind]
    listed = file.parameters.values("FORCE_PLATFORM", "CHANNEL")[number * width : number * width + _CHANNELS[kind]]
    columns = [int(channel) - 1 for channel in listed]
    if len(columns) < _CHANNELS[kind] or min(columns) < 0 or max(columns) >= file.analog_channels:
        raise _Unusable("the file does not say which analog channels are its own")
    return columns


def _matrix(file: C3DFile, number: int) -> Floats:
    """(6, 6) from channels to N and N m."""
    matrix = _of_plate(file, "CAL_MATRIX", number, 36).reshape(6, 6).T
    return matrix if np.abs(matrix).max() > 0 else np.eye(6)


def _without_baseline(file: C3DFile, values: Floats, kind: int) -> Floats:
    """Less the mean over the frames that FORCE_PLATFORM:ZERO calls unloaded; 0 stands for none. A standing trial has a person there."""
    zero = [int(frame) - file.first_frame for frame in file.parameters.values("FORCE_PLATFORM", "ZERO")[:2]]
    if len(zero) < 2 or not 0 <= zero[0] < zero[1] < file.layout.frames:
        return values.copy()
    each = len(values) // file.layout.frames
    unloaded = values[zero[0] * each : (zero[1] + 1) * each]
    unloaded = unloaded[np.isfinite(unloaded).all(axis=1)]
    if not len(unloaded):
        return values.copy()
    level = unloaded.mean(axis=0)
    upwards = level[4:8].sum() if kind == 3 else level[2]
    # What a matrix has still to calibrate has no unit: there the largest of all samples is the measure.
    most = 0.1 * np.nanmax(np.abs(values[:, 2])) if kind == 4 else _SOMEBODY
    return values.copy() if abs(upwards) > most else np.asarray(values - level)


def _brought_to_zero(force: Floats, moment: Floats, vertical: Floats) -> tuple[Floats, Floats]:
    """Less what the plate shows while nobody stands on it, where that is a drift."""
    loads = force @ vertical
    unloaded = np.abs(loads) < LOADED  # false where a sample is missing
    if unloaded.mean() < 0.05 or abs(np.median(loads[unloaded])) > _DRIFT:
        return force, moment
    return force - np.median(force[unloaded], axis=0), moment - np.median(moment[unloaded], axis=0)


def _to_surface(force: Floats, moment: Floats, origin: Floats) -> Floats:
    """The moment about the middle of the surface, from that about the sensors' origin, from which `origin` leads to it."""
    return np.asarray(moment - np.cross(origin, force))


def _given_pressure(values: Floats, origin: Floats, factor: float, matrix: Floats) -> tuple[Floats, Floats]:
    """Type 1: force, centre of pressure on the surface, free moment."""
    force, at = values[:, :3], np.zeros((len(values), 3))
    at[:, :2] = values[:, 3:5] * 0.001
    moment = np.cross(at, force)
    moment[:, 2] += values[:, 5] * factor
    return force, moment


def _force_and_moment(values: Floats, origin: Floats, factor: float, matrix: Floats) -> tuple[Floats, Floats]:
    """Types 2 and 4: force and moment about the sensors' origin, for type 4 after the matrix."""
    given = values @ matrix.T
    return given[:, :3], _to_surface(given[:, :3], given[:, 3:] * factor, origin)


def _eight_sensors(values: Floats, origin: Floats, factor: float, matrix: Floats) -> tuple[Floats, Floats]:
    """Type 3: x of sensors 1 and 2, 3 and 4; y of 1 and 4, 2 and 3; z of each. Origin: how far the sensors are from the middle."""
    x12, x34, y14, y23, z1, z2, z3, z4 = values.T
    a, b = abs(origin[0]), abs(origin[1])
    force = np.stack([x12 + x34, y14 + y23, z1 + z2 + z3 + z4], axis=1)
    moment = np.stack([b * (z1 + z2 - z3 - z4), a * (-z1 + z2 + z3 - z4), b * (-x12 + x34) + a * (y14 - y23)], axis=1)
    return force, _to_surface(force, moment, np.array([0.0, 0.0, origin[2]]))


_READERS: dict[int, Callable[[Floats, Floats, float, Floats], tuple[Floats, Floats]]] = {
    1: _given_pressure,
    2: _force_and_moment,
    3: _eight_sensors,
    4: _force_and_moment,
}
