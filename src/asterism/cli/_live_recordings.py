"""What a live session recorded in; the file that was asked for, and nothing left beside it, out."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING

from asterism.cli import _console
from asterism.cli._live_options import LiveOptions
from asterism.errors import AsterismError

if TYPE_CHECKING:
    from asterism.findings import Finding
    from asterism.live import LiveRecorder

_OF_FINISH = ("finish", "output", "rate", "overwrite", "json")
"""Options that say something of a session that is over."""


def unfinished_beside(options: LiveOptions) -> Path | None:
    """Where frames are kept until the session ends; None where nothing is recorded."""
    return None if options.output is None else options.output.with_name(options.output.name + ".live")


def analog_beside(output: Path) -> Path:
    """Where analog samples are written."""
    return output.with_suffix(".analog.npz")


def refuse_unfinished(options: LiveOptions) -> None:
    """Raise AsterismError where frames of an earlier session still have to be written, or one records to the same place now.

    What a session left that recorded no frame is removed: nobody misses it.
    """
    from asterism.live.recording import left_behind

    path = unfinished_beside(options)
    if path is None or not path.exists():
        return
    left = left_behind(path)
    if left.in_use:
        raise AsterismError(f"another session records to {options.output} now; name another output, or end that one.")
    if left.frames:
        raise AsterismError(
            f"{path} holds what a session recorded that was not finished; write it with `asterism live --finish {quote(str(path))} "
            "-o FILE.c3d`, which removes it, or remove it yourself."
        )
    path.unlink()


def finish(options: LiveOptions, kept: Path) -> list[Finding]:
    """Write a session that was not finished, and remove what it left. Raises AsterismError where options say more than that."""
    from asterism.formats import check_suffix
    from asterism.live.recording import remove_recorded

    other = next((each.name for each in dataclasses.fields(options) if each.name not in _OF_FINISH and _is_given(options, each)), None)
    if other is not None:
        what = "a source" if other == "source" else f"--{other.replace('_', '-')}"
        raise AsterismError(f"--finish writes what a session left behind, and begins none: leave {what} out.")
    if options.output is None:
        raise AsterismError("--finish needs the recording to write; add -o FILE.c3d.")
    check_suffix(options.output)
    _console.check_outputs([options.output, analog_beside(options.output), options.json], [kept], options.overwrite)
    frames = _write_kept(kept, options.output, options.rate)
    # Only now, when the recording has its name and is on the disk.
    found = remove_recorded(kept)
    findings = [] if found is None else [found]
    if options.json != "-":
        _console.result(f"{options.output} holds {_console.count(frames)} frames.")
    for finding in findings:
        _console.report(finding)
    content = {"command": "live", "source": kept, "output": options.output, "frames": frames}
    _console.write_json(options.json, {**content, "findings": [finding.to_dict() for finding in findings]})
    return findings


def write_recorded(recorder: LiveRecorder, output: Path, rate: float | None) -> None:
    """Write what was recorded while the session ran; where that fails it is left, and it is said how it is written."""
    if recorder.kept:
        try:
            _write_kept(recorder.path, output, rate)
        except BaseException:
            leave_recorded(recorder, output)
            raise
    _remove(recorder)


def leave_recorded(recorder: LiveRecorder, output: Path) -> None:
    """Say how it is written what was recorded, where something hinders it: nothing is lost. Where no frame was kept nothing is left."""
    if recorder.kept:
        kept, written = quote(str(recorder.path)), quote(str(output))
        _console.notice(f"{output} was not written; {recorder.path} has all: asterism live --finish {kept} -o {written} writes it.")
    else:
        _remove(recorder)


def _remove(recorder: LiveRecorder) -> None:
    """Remove the file, unless it was away meanwhile: whatever is at its place now, somebody put it there."""
    if not recorder.is_gone:
        recorder.path.unlink(missing_ok=True)


def _write_kept(kept: Path, output: Path, rate: float | None) -> int:
    """Write what was kept; how many frames it had."""
    from asterism.formats import write
    from asterism.live import recording_of
    from asterism.live.analog import channels_of_frames, write_analog

    session, is_c3d = recording_of(kept, rate), output.suffix.casefold() == ".c3d"
    recording = session.recording()
    found = channels_of_frames(session.analog, session.times, recording.rate)
    for lost in write(output, recording, analog=found.channels if is_c3d else ()):
        _console.notice(f"{output} does not hold {lost}.")
    if session.analog and (found.beside or not is_c3d):
        beside = analog_beside(output)
        write_analog(beside, session.analog, session.times)
        for why in found.beside if is_c3d else [f"{output} holds no analog channels"]:
            _console.notice(f"{why}; {beside} has all of it.")
    return len(session.times)


def _is_given(options: LiveOptions, field: dataclasses.Field[object]) -> bool:
    default = field.default_factory() if field.default_factory is not dataclasses.MISSING else field.default
    return bool(getattr(options, field.name) != default)
