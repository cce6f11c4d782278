"""What a reader finds out about a file that a person should know: one function for each code of docs/findings.md.

The sentences name no file and have no full stop, because readers of a part of a file do not know its path. `located` completes them.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

from asterism.findings import Finding, Severity


def located(path: Path | str, findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """The findings with their file, as whole sentences."""
    return tuple(replace(finding, where=str(path), sentence=f"{path}: {finding.sentence}.") for finding in findings)


def units_assumed(sentence: str) -> Finding:
    """The file does not say its unit of length where it should; one was chosen."""
    return Finding("format-units-assumed", Severity.NOTE, "", sentence, "Compare a known length, such as the body's height.")


def units_doubtful(sentence: str) -> Finding:
    """A person would be far too small or too large in the file's unit of length."""
    mend = "Compare a known length, such as the body's height, and correct the unit of length in the file."
    return Finding("format-units-doubtful", Severity.WARNING, "", sentence, mend)


def units_unknown(sentence: str) -> Finding:
    """The file's unit of length is none that is known; the one that fits the size of a person was taken."""
    mend = "Compare a known length, such as the body's height, and correct the unit of length in the file."
    return Finding("format-units-unknown", Severity.WARNING, "", sentence, mend)


def vertical_conflict(sentence: str) -> Finding:
    """The file declares another vertical than its markers show."""
    mend = "Look which way is up, and give it with --vertical; correct it in the file."
    return Finding("format-vertical-conflict", Severity.WARNING, "", sentence, mend)


def vertical_assumed(sentence: str) -> Finding:
    """The file declares no vertical, and its points do not show one clearly."""
    return Finding("format-vertical-assumed", Severity.NOTE, "", sentence, "Give the vertical with --vertical where this is wrong.")


def rate_conflict(sentence: str) -> Finding:
    """Header and time column give different rates."""
    return Finding("format-rate-conflict", Severity.NOTE, "", sentence, "Correct the rate in the header.")


def header_conflict(sentence: str) -> Finding:
    """The header declares something else than the file holds."""
    return Finding("format-header-conflict", Severity.NOTE, "", sentence, "Export the file again where it should hold more.")


def header_doubt(sentence: str) -> Finding:
    """Parts of the file contradict each other, and the file does not show which is right."""
    return Finding("format-header-doubt", Severity.WARNING, "", sentence, "Look at the recording, and correct the file or export it again.")


def cut_off(sentence: str) -> Finding:
    """The file, or a line or section of it, ends too early."""
    return Finding("format-cut-off", Severity.WARNING, "", sentence, "Export or copy the file again.")


def short_rows(sentence: str) -> Finding:
    """Rows have fewer cells than the header has columns."""
    return Finding("format-short-rows", Severity.NOTE, "", sentence, "Check these lines.")


def moved_cells(sentence: str) -> Finding:
    """Cells of a row have moved into other columns, because a separator was lost or doubled."""
    return Finding("format-moved-cells", Severity.WARNING, "", sentence, "Correct these lines, or export the file again.")


def unread_events(line_numbers: Sequence[int]) -> list[Finding]:
    """A finding where lines that should hold events have no time; nothing where there are none."""
    if not line_numbers:
        return []
    sentence = f"{len(line_numbers)} events have no time that can be read and are left out, first in line {line_numbers[0]}"
    return [Finding("format-events-unread", Severity.WARNING, "", sentence, "Correct the times of these events in the file.")]


def values_left_out(sentence: str) -> Finding:
    """Columns of a table hold no positions, such as forces, and are not read."""
    return Finding("format-values-left-out", Severity.NOTE, "", sentence, "Name positions with x, y and z behind the marker's name.")


def missing_samples(sentence: str) -> Finding:
    """Samples that cannot be positions were taken as missing."""
    return Finding("format-missing-samples", Severity.NOTE, "", sentence, "Export the file again where they should be positions.")


def events_outside(sentence: str) -> Finding:
    """Events lie before the first frame or behind the last one."""
    return Finding("format-events-outside", Severity.NOTE, "", sentence, "Check the first frame's number where the file was cut.")


def frame_numbers(sentence: str) -> Finding:
    """The frame numbers leave frames out, or are not in order."""
    return Finding("format-frame-numbers", Severity.NOTE, "", sentence, "Check the frame column.")


def text_encoding(sentence: str) -> Finding:
    """Names are in another encoding than UTF-8 and the usual European ones."""
    return Finding("format-text-encoding", Severity.NOTE, "", sentence, "Export the file again with names in UTF-8 or in plain letters.")


def point_names(sentence: str) -> Finding:
    """Points have no name, or names were read otherwise than they are spelled."""
    return Finding("format-point-names", Severity.NOTE, "", sentence, "Name each point once.")


def repeated_name(sentence: str) -> Finding:
    """Several markers have one name."""
    return Finding("format-repeated-names", Severity.WARNING, "", sentence, "Name each marker once.")


def nothing_seen(sentence: str) -> Finding:
    """No marker has a sample in any frame."""
    return Finding("format-nothing-seen", Severity.WARNING, "", sentence, "Export the recording again with its trajectories.")


def bones_lost(sentence: str) -> Finding:
    """Bones of a skeleton move in a way that rigid bones on joints do not, or were joined with others."""
    return Finding("format-bones-rigid", Severity.NOTE, "", sentence, "Export the skeleton with rotations only where that matters.")
