"""`asterism events`: labelled movements and rules in; events, phases, extremes and sequences, as tables and in C3D copies, out."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from asterism.cli import _console
from asterism.cli._command import takes
from asterism.cli._options import Files, Json, Overwrite, Vertical
from asterism.errors import AsterismError

if TYPE_CHECKING:
    from asterism.motion.events import FoundMovement


@dataclass(frozen=True)
class EventsOptions:
    """What `asterism events` is asked to do."""

    files: Files
    rules: Annotated[
        str, typer.Option("--rules", "-r", metavar="MOVEMENT", help="golf-swing, lifting, pedalling, squat, or a TOML file of your own.")
    ]
    marker: Annotated[
        list[str],
        typer.Option("--marker", metavar="NAME=LABEL", help="Which label is a marker of the rules: club_head=M12. Several times."),
    ] = field(default_factory=list)
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="FOLDER", help="Write copies of the recordings as C3D with the events.", show_default=False),
    ] = None
    table: Annotated[
        Path | None,
        typer.Option("--table", metavar="FILE", help="Write all numbers with their uncertainty; CSV or .parquet.", show_default=False),
    ] = None
    vertical: Vertical = None
    overwrite: Overwrite = False
    json: Json = None


@takes(EventsOptions)
def events(options: EventsOptions) -> None:
    """Find events of a movement by rules.

    Rules say when something happens: where a height, an angle or a speed is largest or smallest, or crosses a level, and in which order.
    Between events are phases; each has its duration, the range and the extremes of each signal, and, where the rules ask for it, which
    segment is fastest first. Times have an uncertainty. What noise or the choice of the filter could have made is left out, and told.
    """
    from asterism.cli._folders import check_output, copies_of, trials
    from asterism.cli._recordings import report_warnings
    from asterism.files.tables import check_table
    from asterism.formats import read, write
    from asterism.motion.events import MovementRules, find_movement, movement_table

    _console.check_outputs([options.table, options.json], options.files, options.overwrite)
    if options.table is not None:
        check_table(options.table)
    rules, markers = MovementRules.load(options.rules), _markers(options.marker)
    batch = _console.Batch("searched")
    found = trials(options.files, batch, without=options.output)
    copies = {} if options.output is None else copies_of(found, options.output, [])
    results: dict[Path, FoundMovement] = {}
    for path in (trial.path for trial in found):
        with batch.file(path):
            if path in copies:
                check_output(path, copies[path], options.overwrite)
            recording = read(path, vertical=options.vertical)
            report_warnings(recording, batch)
            movement = find_movement(recording, rules, markers)
            for finding in movement.findings:
                batch.found(finding)
            if path in copies:
                copies[path].parent.mkdir(parents=True, exist_ok=True)
                for lost in write(copies[path], recording.with_found(movement.to_events())):
                    _console.notice(f"{copies[path]} does not hold {lost}.")
            results[path] = movement
            if options.json != "-":
                show(path, movement)
    if results and options.table is not None:
        movement_table({str(path): movement for path, movement in results.items()}).write(options.table)
    if results:
        content = {
            "command": "events",
            "movement": rules.title,
            "files": [{"file": path, "copy": copies.get(path), **as_dict(movement)} for path, movement in results.items()],
            "failed": batch.failed,
            "findings": [finding.to_dict() for finding in batch.findings],
        }
        _console.write_json(options.json, content)
    raise typer.Exit(batch.close())


def _markers(words: list[str]) -> dict[str, str]:
    found = {}
    for word in words:
        name, equals, label = (part.strip() for part in word.partition("="))
        if not (name and equals and label):
            raise AsterismError(f"--marker {word} is no name and label; write for example club_head=M12.")
        found[name] = label
    return found


_SIDES = {"L": "left", "R": "right", "": ""}


def show(path: Path, movement: FoundMovement) -> None:
    """Print events, phases and sequences of one recording."""
    start = float(movement.recording.times[0])
    rows = [
        [
            event.name,
            _SIDES[event.side],
            f"{start + event.time:.3f}",
            f"{1000 * event.sigma:.0f}",
            f"{event.time * movement.recording.rate:.1f}",
        ]
        for event in movement.events
    ]
    _console.table(f"{path}: events of {movement.rules.title}", ["event", "side", "s", "± ms", "frames from the first"], rows)
    rows = []
    for name, side in dict.fromkeys((phase.name, phase.side) for phase in movement.phases):
        own = [phase for phase in movement.phases if (phase.name, phase.side) == (name, side)]
        mean = sum(phase.duration for phase in own) / len(own)
        sigma = math.hypot(*(phase.sigma for phase in own)) / len(own)
        rows.append([f"{name} {_SIDES[side]}".strip(), str(len(own)), f"{mean:.3f} ± {sigma:.3f} s", "", ""])
        extremes = [one for phase in own for one in phase.extremes]
        for signal in dict.fromkeys(one.signal for one in extremes):
            low = min((one for one in extremes if one.signal == signal), key=lambda one: one.value)
            high = max((one for one in extremes if one.signal == signal), key=lambda one: one.value)
            digits = _DIGITS[low.unit]
            ends = [f"{one.value:.{digits}f} ± {one.sigma:.{digits}f} at {start + one.time:.2f} s" for one in (low, high)]
            rows.append(["", "", f"{signal}, {low.unit}", *ends])
    if rows:
        _console.table(f"{path}: phases", ["phase", "times", "mean duration, signal", "least", "most"], rows)
    peaks = [
        [peak.sequence, str(peak.number), f"{peak.place}. {peak.signal}", f"{start + peak.time:.3f}", f"{1000 * peak.sigma:.0f}",
         f"{peak.value:.{_DIGITS[peak.unit]}f} {peak.unit}", _console.percent(peak.same, 0)]
        for peak in movement.peaks
    ]  # fmt: skip
    if peaks:
        _console.table(f"{path}: sequences", ["sequence", "number", "signal", "s", "± ms", "most", "sure of its place"], peaks)


_DIGITS = {"m": 3, "m/s": 2, "deg": 1, "deg/s": 0}


def as_dict(movement: FoundMovement) -> dict[str, Any]:
    """The movement as JSON has it: seconds from the first frame, the rules' units."""
    return {
        "events": [dataclasses.asdict(event) for event in movement.events],
        "phases": [
            {
                "name": phase.name,
                "side": phase.side,
                "number": phase.number,
                "begin": phase.begin.time,
                "end": phase.end.time,
                "duration": phase.duration,
                "sigma": phase.sigma,
                "extremes": [dataclasses.asdict(one) for one in phase.extremes],
            }
            for phase in movement.phases
        ],
        "peaks": [dataclasses.asdict(peak) for peak in movement.peaks],
    }
