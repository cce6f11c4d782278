"""The force plates of a recording in; OpenSim's table of ground reaction forces, and which of them acts on which foot, out.

The table (MOT) has for each plate the force `1_ground_force_vx` ... in N, the centre of pressure `1_ground_force_px` ... in m and the free
moment `1_ground_torque_x` ... in N m, y up. The loads (XML, `ExternalLoads`) name the body on which each acts. Nothing is smoothed. Where
nobody stands on a plate, forces and moments are zero, and the centre of pressure is the plate's middle.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from xml.sax.saxutils import escape, quoteattr

import numpy as np
from numpy.typing import NDArray

from asterism.files.atomic import utf8, write_atomically
from asterism.formats.storage import TimeSeriesTable, write_table
from asterism.recording import Floats, ForcePlate, Recording
from asterism.recording.sides import marker_sides

_BODIES = {"left": "calcn_l", "right": "calcn_r"}
"""What OpenSim's models call the two feet."""
_FOOT = 0.3
"""m, how far a marker of the foot that stands may be from its centre of pressure: the length of a foot. At half, an ankle's marker is too
far at push-off; at double, the other foot's markers are near."""
_ONE_FOOT = 0.7
"""Share of the load to which one foot is nearest, where it stands alone. The other foot passes it, but bears nothing. At 0.5 any two feet
on one plate are one foot; at 0.9 many single steps are two feet."""
_STEP = 50.0
"""N, the load that a contact reaches, five kilograms: less is the drift of a plate. At half, old plates step; at double, no small child."""
_SHORTEST = 0.05
"""s, no foot stands or swings for less. At half, the shaking of a treadmill is a step; at double, quick steps of a child are none."""
_SAMPLES = 200
"""Samples of a contact that are looked at."""


def companions(target: Path) -> tuple[Path, Path]:
    """The table of forces and the loads that are written beside a TRC file: walk_grf.mot and walk_grf.xml."""
    return target.with_name(f"{target.stem}_grf.mot"), target.with_name(f"{target.stem}_grf.xml")


def write_opensim_forces(target: Path, recording: Recording, plates: Sequence[ForcePlate], turn: Floats) -> list[str]:
    """Write both files beside `target`; returns phrases on the contacts that act on no foot, because it is not known which.

    recording  that the plates are of, its markers named, by which feet are told
    turn       (3, 3) rotation from these axes to OpenSim's
    """
    table_path, loads_path = companions(target)
    sides = np.array(marker_sides(recording.labels))
    times = recording.times[0] + np.arange(max(len(plate.force) for plate in plates)) / plates[0].rate
    columns, names, loads, unknown = list[Floats](), list[str](), list[str](), list[str]()
    for plate in plates:
        number = plate.number
        contacts = contacts_on(plate)
        feet = [_foot(plate, times, contact, recording, sides) for contact in contacts]
        used = [side for side in _BODIES if side in feet]
        for contact, foot in zip(contacts, feet, strict=True):
            if foot not in _BODIES:
                begin, end = times[contact][[0, -1]]
                unknown.append(f"the load on force plate {number} from {begin:.2f} to {end:.2f} s, which is on {foot}")
        # A plate on which one foot stands at a time has its number as name, one on which both do also the foot.
        for side in used or [""]:
            own = [contact for contact, foot in zip(contacts, feet, strict=True) if foot == side or (len(used) < 2 and foot not in _BODIES)]
            name = f"{number}_{side + '_' if len(used) > 1 else ''}ground"
            columns.append(_load(plate, own, turn))
            names += [f"{name}_{part}{axis}" for part in ("force_v", "force_p", "torque_") for axis in "xyz"]
            loads += [_external_force(name, _BODIES[side], table_path.name)] if side else []
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


def contacts_on(plate: ForcePlate) -> list[slice]:
    """The runs of samples in which somebody stands on a plate, the next of which begins when the foot has left it."""
    edges, shortest = np.diff(np.concatenate([[0], plate.loaded.astype(np.int8), [0]])), _SHORTEST * plate.rate
    begins, ends = np.nonzero(edges > 0)[0], np.nonzero(edges < 0)[0]
    # A foot that comes back at once has not left.
    apart = begins[1:] - ends[:-1] >= shortest
    begins, ends = begins[np.concatenate([[True], apart])[: len(begins)]], ends[np.concatenate([apart, [True]])[: len(ends)]]
    runs = [slice(int(a), int(b)) for a, b in zip(begins, ends, strict=True) if b - a >= shortest]
    return [run for run in runs if plate.load[run].max() >= _STEP]


def _foot(plate: ForcePlate, times: Floats, contact: slice, recording: Recording, sides: NDArray[np.str_]) -> str:
    """Which foot stands on a plate: "left", "right", else what is there in words; by the markers nearest to the centre of pressure."""
    some = np.unique(np.linspace(contact.start, contact.stop - 1, _SAMPLES).round().astype(np.int64))
    some = some[plate.loaded[some]]
    frames = np.round((times[some] - recording.times[0]) * recording.rate).astype(np.int64) if len(recording) else some[:0]
    inside = (frames >= 0) & (frames < len(recording))
    some, frames = some[inside], frames[inside]
    apart = np.linalg.norm(recording.positions[frames] - plate.pressure[some][:, None], axis=2)
    apart[np.isnan(apart)] = np.inf
    near = {side: apart[:, sides == side].min(axis=1, initial=np.inf) for side in _BODIES}
    # By the load: the first and last samples of a contact say least, and their centre of pressure is the least exact.
    load = plate.load[some]
    known = np.minimum(near["left"], near["right"]) < _FOOT
    if load[known].sum() <= 0.5 * load.sum():
        return "no foot whose markers are known"
    left = float(load[known & (near["left"] < near["right"])].sum() / load[known].sum())
    return "left" if left >= _ONE_FOOT else "right" if left <= 1 - _ONE_FOOT else "both feet at once"


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
