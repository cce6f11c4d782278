"""The force plates of a recording in; OpenSim's table of ground reaction forces, and which of them acts on which foot, out.

The table (MOT) has for each plate the force `1_ground_force_vx` ... in N, the centre of pressure `1_ground_force_px` ... in m and the
free moment `1_ground_torque_x` ... in N m, y up. The loads (XML, `ExternalLoads`) name the body on which each acts. Nothing is smoothed
unless asked. Where nobody stands on a plate, forces and moments are zero, and the centre of pressure is the plate's middle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from xml.sax.saxutils import escape, quoteattr

import numpy as np

from asterism.files.atomic import utf8, write_atomically
from asterism.formats.storage import TimeSeriesTable, write_table
from asterism.recording import Floats, ForcePlate, Recording
from asterism.recording.plate_feet import BOTH, NOBODY, foot_on
from asterism.recording.sides import marker_sides

_BODIES = {"left": "calcn_l", "right": "calcn_r"}
"""What OpenSim's models call the two feet."""
_UNKNOWN = {BOTH: "both feet at once", NOBODY: "no foot whose markers are known"}


def companions(target: Path) -> tuple[Path, Path]:
    """The table of forces and the loads that are written beside a TRC file: walk_grf.mot and walk_grf.xml."""
    return target.with_name(f"{target.stem}_grf.mot"), target.with_name(f"{target.stem}_grf.xml")


def write_opensim_forces(
    target: Path, recording: Recording, plates: Sequence[ForcePlate], turn: Floats, cut_off: float | None = None
) -> list[str]:
    """Write both files beside `target`; returns phrases on the contacts that act on no foot, because it is not known which.

    recording  that the plates are of, its markers named, by which feet are told
    turn       (3, 3) rotation from these axes to OpenSim's
    cut_off    Hz, of the low-pass filter of each contact's force and moment; by default nothing is filtered
    """
    table_path, loads_path = companions(target)
    sides = np.array(marker_sides(recording.labels))
    markers = {side: recording.positions[:, sides == side] for side in _BODIES}
    times = recording.times[0] + np.arange(max(len(plate.force) for plate in plates)) / plates[0].rate
    columns, names, loads, unknown = list[Floats](), list[str](), list[str](), list[str]()
    for plate in plates:
        number = plate.number
        contacts = plate.contacts
        feet = [foot_on(plate, contact, markers, recording.rate) for contact in contacts]
        for contact, foot in zip(contacts, feet, strict=True):
            if foot not in _BODIES:
                begin, end = times[contact][[0, -1]]
                unknown.append(f"the load on force plate {number} from {begin:.2f} to {end:.2f} s, which is on {_UNKNOWN[foot]}")
        groups = {side: [contact for contact, foot in zip(contacts, feet, strict=True) if foot == side] for side in _BODIES}
        groups["other"] = [contact for contact, foot in zip(contacts, feet, strict=True) if foot not in _BODIES]
        groups = {who: own for who, own in groups.items() if own} or {"other": []}
        # a plate that one foot uses has its number as name, one that several do also whose the columns are
        for who, own in groups.items():
            name = f"{number}_{who + '_' if len(groups) > 1 else ''}ground"
            columns.append(_load(plate, own, turn) if cut_off is None else _load(*_smoothed(plate, own, cut_off), turn))
            names += [f"{name}_{part}{axis}" for part in ("force_v", "force_p", "torque_") for axis in "xyz"]
            loads += [_external_force(name, _BODIES[who], table_path.name)] if who in _BODIES else []
    values = np.concatenate(columns, axis=1)
    times = np.round(times, 9)
    write_table(table_path, TimeSeriesTable(tuple(names), values, times, table_path.stem, in_degrees=True, format="MOT"))
    write_atomically(loads_path, utf8(_external_loads(target.stem, table_path.name, loads)))
    return unknown


def _load(plate: ForcePlate, contacts: Sequence[slice], turn: Floats) -> Floats:
    """(S, 9) force, centre of pressure and free moment in OpenSim's axes, during some contacts."""
    values = np.zeros((len(plate.force), 9))
    parts = (plate.force, plate.pressure, plate.free_moment[:, None] * plate.vertical)
    values[:, 3:6] = plate.centre @ turn.T
    for contact in contacts:
        # Within a contact the load may be too small for a moment to tell where it acts.
        loaded = np.arange(contact.start, contact.stop)[plate.loaded[contact]]
        values[loaded] = np.concatenate([part[loaded] @ turn.T for part in parts], axis=1)
    # Digits below a millinewton and a micrometre are noise of the arithmetic.
    return np.round(values, 6) + 0.0


def _smoothed(plate: ForcePlate, contacts: Sequence[slice], cut_off: float) -> tuple[ForcePlate, list[slice]]:
    """The plate as it would be with these contacts alone, force and moment filtered as OpenSim filters coordinates; all of its samples.

    Butterworth's filter of third order, forwards and backwards. The centre of pressure is that of the filtered force and moment.
    """
    # Loading scipy.signal takes half a second, which every command that reads files would wait for.
    from scipy.signal import butter, sosfiltfilt

    inside = np.zeros(len(plate.force), dtype=bool)
    for contact in contacts:
        inside[contact] = True
    sections = butter(3, min(cut_off, 0.49 * plate.rate), fs=plate.rate, output="sos")
    kept = (np.where(inside[:, None] & np.isfinite(part), part, 0.0) for part in (plate.force, plate.moment))
    padding = min(3 * (2 * len(sections) + 1), len(inside) - 1)
    force, moment = (np.asarray(sosfiltfilt(sections, part, axis=0, padlen=padding), dtype=np.float64) for part in kept)
    return replace(plate, force=force, moment=moment), [slice(0, len(inside))]


def _external_force(name: str, body: str, table: str) -> str:
    """One load of the XML."""
    parts = {
        "applied_to_body": body,
        "force_expressed_in_body": "ground",
        "point_expressed_in_body": "ground",
        "force_identifier": f"{name}_force_v",
        "point_identifier": f"{name}_force_p",
        "torque_identifier": f"{name}_torque_",
        "data_source_name": table,
    }
    lines = "".join(f"\t\t\t\t<{part}>{escape(value)}</{part}>\n" for part, value in parts.items())
    return f"\t\t\t<ExternalForce name={quoteattr(name)}>\n{lines}\t\t\t</ExternalForce>\n"


def _external_loads(title: str, table: str, loads: Sequence[str]) -> str:
    body = f"\t\t<objects>\n{''.join(loads)}\t\t</objects>\n\t\t<datafile>{escape(table)}</datafile>\n"
    head = '<?xml version="1.0" encoding="UTF-8" ?>\n<OpenSimDocument Version="40000">\n'
    return f"{head}\t<ExternalLoads name={quoteattr(title)}>\n{body}\t</ExternalLoads>\n</OpenSimDocument>\n"
