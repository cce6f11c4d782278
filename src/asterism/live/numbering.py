"""How many frames came, came late and jumped in; what is wrong with their numbers and times, out."""

from __future__ import annotations

from asterism.findings import Finding, Severity
from asterism.recording.display import counted

NUMBER_FRAMES = "number each frame one higher than the last, and let one sender send."
"""What a person can do whose frames have numbers that stand still."""


def wrong_numbers(where: str, frames: int, late: int, jumps: int) -> list[Finding]:
    """What is wrong with the numbers, or the times, of most frames: nothing that network or clock can have done.

    frames  that were used
    late    that came twice or after a later one
    jumps   of the times
    """
    found = list[Finding]()
    if late > frames:
        found.append(Finding("live-late", Severity.WARNING, where, late_frames(where, late), NUMBER_FRAMES.capitalize()))
    if 2 * jumps > frames:
        sentence = f"{where}: its times do not go as a clock does ({jumps} jumps in {frames} frames)."
        found.append(Finding("live-times", Severity.WARNING, where, sentence, "Send times in seconds, of when a frame is taken."))
    return found


def late_frames(where: str, late: int) -> str:
    """How many frames were not used, since they came late."""
    return f"{where}: {counted(late, 'frame')} came twice or after a later one: not used."
