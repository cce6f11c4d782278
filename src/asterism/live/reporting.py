"""What was counted while a session ran in; what a person should know of it, out."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from asterism.findings import Finding, Severity
from asterism.live.numbering import late_frames, wrong_numbers
from asterism.recording.display import counted, how_often, significant

if TYPE_CHECKING:
    from asterism.live.recording import LiveRecorder
    from asterism.live.running import Health


@runtime_checkable
class WithFindings(Protocol):
    """A source or an output that has something to say: as it is opened, and with what it counted as it ends."""

    def findings(self) -> list[Finding]:
        """What a person should know of it so far."""


_NO_LABELS = (
    "live-no-points",
    "reconstruct-no-points",
    "reconstruct-no-fit",
    "live-no-set",
    "live-few-points",
    "live-other-markers",
    "live-unit",
)
_NO_POINTS_TOLD = ("reconstruct-no-points", "reconstruct-no-fit", "live-camera-silent", "live-camera-size")
_SILENT_TOLD = ("live-unconnected", "live-unknown-camera", "live-camera-silent", "live-camera-not-opened", "live-camera-stamps")
_DAMAGED_TOLD = ("live-format", "live-camera-size", "live-camera-damaged")
_OF_NUMBERS = ("live-late", "live-times")
_NOTE, _WARNING, _ERROR = Severity.NOTE, Severity.WARNING, Severity.ERROR


def own_findings(parts: Iterable[object]) -> list[Finding]:
    """What sources and outputs say themselves."""
    said = {(each.code, each.where): each for part in parts if isinstance(part, WithFindings) for each in part.findings()}
    return list(said.values())


def session_findings(health: Health, where: str, recorder: LiveRecorder | None = None, parts: Iterable[object] = ()) -> list[Finding]:
    """The findings of a session that has ended.

    where     the source's name
    recorder  None where nothing was recorded
    parts     the source and the outputs, for what they say themselves
    """
    # What a session said of its numbers while it ran is counted once more.
    found = [finding for finding in own_findings(parts) if finding.code not in _OF_NUMBERS]
    # Who knows why no point is made says more than that there is none.
    if any(finding.code in _NO_POINTS_TOLD for finding in found):
        found = [finding for finding in found if finding.code != "live-no-points"]
    # Where a wider set labels, what is worn is known.
    if any(finding.code == "label-wider-set" for finding in found):
        found = [finding for finding in found if finding.code != "live-other-markers"]
    if health.problem:
        found.append(Finding("live-ended", _ERROR, where, f"{where}: the session ended early.", health.problem))
    if not (health.frames or health.damaged or health.problem) and not any(finding.code in _SILENT_TOLD for finding in found):
        mend = "Look whether it sends, to this address and port, and whether a firewall is between."
        found.append(Finding("live-silent", _ERROR, where, f"{where}: no frame came.", mend))
    # Numbers that stand still, or two senders, and no network: of what was used by chance nothing follows.
    most = health.late > health.frames
    found += [] if most else _no_labels(health, where, found)
    if health.before:
        sentence = f"{where}: {counted(health.before, 'frame')} came while the labelling was made: no labels."
        found.append(Finding("live-before", _NOTE, where, sentence, "Begin the movement when the first labels are there."))
    if health.lost:
        share = significant(100 * health.lost / (health.lost + health.frames), 2)
        sentence = f"{where}: {counted(health.lost, 'frame')} never arrived ({share} %)."
        found.append(Finding("live-lost", _WARNING, where, sentence, "Use a cable instead of radio, or a lower rate."))
    found += wrong_numbers(where, health.frames, health.late, health.jumps)
    if health.late and not most:
        found.append(Finding("live-late", _NOTE, where, late_frames(where, health.late), "Look at the network."))
    if health.others:
        sentence = f"{where}: two programs send through one address: {counted(health.others, 'frame')} of the second not used."
        mend = "Stop one of them, or give each a port of its own."
        found.append(Finding("live-other-sender", _WARNING, where, sentence, mend))
    if health.dropped:
        sentence = f"{where}: {counted(health.dropped, 'frame')} went without labels, since newer ones waited."
        mend = "Close other programs, or lower the rate; a recording holds them all."
        found.append(Finding("live-dropped", _WARNING, where, sentence, mend))
    # Where somebody who knows has counted them with what is wrong, that is all.
    if health.damaged and not any(finding.code in _DAMAGED_TOLD for finding in found):
        sentence = f"{where}: {counted(health.damaged, 'packet')} could not be read."
        mend = "Look whether something else sends to this port, or in another format."
        found.append(Finding("live-damaged", _WARNING, where, sentence, mend))
    if (health.jumps or health.restarts) and not most and not any(finding.code == "live-times" for finding in found):
        sentence = f"{where}: its clock or its frame numbers began anew {how_often(max(health.jumps, health.restarts))}."
        found.append(Finding("live-restarted", _WARNING, where, sentence, "Times go on from there; nothing needs to be done."))
    for output, count in health.unsent.items():
        sentence = f"{output}: {counted(count, 'frame')} could not be passed on."
        found.append(Finding("live-unsent", _WARNING, output, sentence, "Look whether who receives them runs, and keeps up."))
    if recorder is not None and (recorder.problem or recorder.lost or recorder.unlabelled):
        lacking = [counted(recorder.lost, "frame")] if recorder.lost else []
        lacking += [f"the labels of {counted(recorder.unlabelled, 'frame')}"] if recorder.unlabelled else []
        sentence = recorder.problem or f"{recorder.path}: {' and '.join(lacking)} not recorded, since the disk was busy."
        found.append(Finding("live-not-recorded", _ERROR, where, sentence, recorder.mend))
    return found


def _no_labels(health: Health, where: str, said: Iterable[Finding]) -> list[Finding]:
    """That hardly a label was given, where nobody who looked at the points while they came has said why."""
    told = _NO_LABELS if health.shown else (*_NO_LABELS, *_NO_POINTS_TOLD)
    if any(finding.code in told for finding in said):
        return []
    if health.labelled and not health.markers:
        mend = "Name the set that is worn with --markers, or give a trained --model."
        return [Finding("live-no-labels", _WARNING, where, f"{where}: no marker set was found, and no label given.", mend)]
    # A person who is known has labels in most frames: that the middle one has none needs no tuned share.
    if 2 * health.bare <= health.shown and (health.shown or not health.labelled):
        return []
    sentence = f"{where}: {health.bare} of {health.shown} frames have the points of a person and no sure label."
    if not health.shown:
        sentence = f"{where}: no frame had a point."
    mend = "Look at the marker set (--markers), the axis that points up (--vertical), the unit and the rate."
    return [Finding("live-no-labels", _WARNING, where, sentence, mend)]


def axis_unknown(where: str, believed: str) -> Finding:
    """A source that does not say what is up."""
    sentence = f"{where}: it does not say which axis points up; {believed} is believed to."
    return Finding("live-axis-unknown", _NOTE, where, sentence, "Say it with --vertical where it is another one.")


def labels_given(where: str) -> Finding:
    """A source whose points have labels already."""
    return Finding(
        "live-labels-given", _NOTE, where, f"{where}: it gives labels itself, which are passed over.", "Nothing needs to be done."
    )


def reconnected(where: str, times: int, mend: str, *, is_back: bool = True) -> Finding:
    """A connection or a stream that was lost, and came back so many times."""
    sentence = f"{where}: the connection was lost {how_often(times)}, and {'made again' if is_back else 'is not back'}."
    return Finding("live-reconnected", _WARNING, where, sentence, mend)


def times_made(where: str) -> Finding:
    """A source without times, or with one for several frames."""
    sentence = f"{where}: its frames have no times of their own; they are taken from the frame numbers and the rate, or from their arrival."
    return Finding("live-no-times", _NOTE, where, sentence, "Give the rate with --rate where it is not told.")
