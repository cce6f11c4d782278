"""The sequences of several cameras in; the names of the cameras, their frame numbers and clock out."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from asterism.cameras import Rig
from asterism.detection.sources import Source
from asterism.detection.times import FrameTimes
from asterism.errors import AsterismError
from asterism.findings import Finding, Severity
from asterism.recording import Blobs, Floats, Ints
from asterism.synchronization import to_common_clock
from asterism.synchronization.rates import rates_apart

_DEFAULT_RATE = 100.0
"""Frames per second where nothing says the rate."""
_LINKED = 0.8
"""Share of the blobs that interpolation to a common clock must keep."""


def camera_names(sources: Sequence[Source], rig: Rig | None) -> list[str]:
    """The cameras' names: of their files or folders, of the folders these are in where that is not unique, or those of the rig."""
    paths = [source.path.resolve() for source in sources]
    twice = next((source.path for i, source in enumerate(sources) if paths[i] in paths[:i]), None)
    if twice is not None:
        raise AsterismError(f"{twice} is given twice; give each camera its own images.")
    names = [source.name for source in sources]
    if len(set(names)) < len(names):
        # Many systems write cam1/video.avi, cam2/video.avi, whose folders are the names.
        names = [path.parent.name for path in paths]
    if len(set(names)) < len(names):
        twice_named = next(name for i, name in enumerate(names) if name in names[:i])
        raise AsterismError(f"two cameras would be called {twice_named}; give each its own file or folder name.")
    if rig is None or set(names) <= set(rig.names):
        return names
    # A rig's c3 and a folder's cam_03 are the same camera where the numbers pair up one to one.
    by_number = {_number(name): name for name in rig.names}
    numbers = [_number(name) for name in names]
    if len(by_number) == len(rig) and len(set(numbers)) == len(numbers) and set(numbers) <= set(by_number) - {None}:
        return [by_number[number] for number in numbers]
    if len(names) != len(rig):
        raise AsterismError(
            f"the rig has no camera {next(n for n in names if n not in rig.names)}, only {', '.join(rig.names)}; rename it."
        )
    return list(rig.names)


def _number(name: str) -> int | None:
    digits = re.findall(r"\d+", name)
    return int(digits[-1]) if digits else None


def align_frames(
    sources: Sequence[Source], read: Sequence[NDArray[np.int64]], names: Sequence[str], stamps: FrameTimes | None, findings: list[Finding]
) -> tuple[list[NDArray[np.int64]], Floats | None, int]:
    """The common frames of several cameras.

    read     for each camera the places in its sequence of the images that were read
    findings what is wrong is added to it

    Returns for each camera the frame of each place in its sequence, -1 where it belongs to none; times (T, C) s or None; and the number
    of the first frame.
    """
    lengths = [max(len(source), int(places.max(initial=-1)) + 1) for source, places in zip(sources, read, strict=True)]
    rows = _counted(sources, lengths)
    # Without times, equal frame numbers are the only thing that cameras share.
    if stamps is None:
        first = min(int(frames[0]) for frames in rows)
        findings += _mismatches(rows, lengths, names)
        return [frames - first for frames in rows], None, first
    taken = [_timed_places(stamps, stamped, rows[c], lengths[c], names[c]) for c, stamped in enumerate(stamps.of(names))]
    common = [rows[c][places] if stamps.sync is None else stamps.sync[stamped] for c, (stamped, places) in enumerate(taken)]
    first = min(int(frames.min()) for frames in common)
    when = np.full((max(int(frames.max()) for frames in common) - first + 1, len(names)), np.nan)
    numbers = []
    for c, ((stamped, places), frames) in enumerate(zip(taken, common, strict=True)):
        known = np.isin(places, read[c])
        when[frames[known] - first, c] = stamps.time[stamped[known]]
        number = np.full(lengths[c], -1)
        number[places] = frames - first
        numbers.append(number)
        if len(places) < lengths[c]:
            findings.append(
                Finding(
                    "detect-images-without-time",
                    Severity.WARNING,
                    names[c],
                    f"{stamps.path} has no time of {lengths[c] - len(places)} images of camera {names[c]}; they are left out.",
                    "Add their times to the file.",
                )
            )
    return numbers, when, first


def _mismatches(rows: Sequence[NDArray[np.int64]], lengths: Sequence[int], names: Sequence[str]) -> Iterator[Finding]:
    """Cameras whose frame numbers (rows) end at different frames, or are as many but numbered otherwise."""
    last = [int(frames[-1]) for frames in rows]
    early, late = int(np.argmin(last)), int(np.argmax(last))
    if max(last) - min(last) > 2:
        yield Finding(
            "detect-ends-early",
            Severity.WARNING,
            names[early],
            f"camera {names[early]} ends {last[late] - last[early]} frames before {names[late]}.",
            "Cut them alike or give --times.",
        )
    if len(set(lengths)) == 1 and 0 < rows[late][0] - rows[early][0] == last[late] - last[early] <= 2:
        theirs = f"{names[late]} {rows[late][0]} to {last[late]}"
        yield Finding(
            "detect-numbered-otherwise",
            Severity.WARNING,
            names[early],
            f"camera {names[early]} has images {rows[early][0]} to {last[early]}, {theirs}: as many, but numbered otherwise.",
            "Number them alike if they were taken together.",
        )


def _timed_places(stamps: FrameTimes, rows: Ints, numbers: NDArray[np.int64], length: int, name: str) -> tuple[Ints, Ints]:
    """Which rows of a file of times are a camera's, and the place of each in its sequence.

    numbers  the frame numbers of the camera's `length` images

    Raises AsterismError where the times are of other images.
    """
    frame = stamps.frame[rows]
    if len(rows) == length:
        return rows, np.arange(length)
    if frame.min() >= numbers[0] and frame.max() <= numbers[-1] and np.isin(frame, numbers).all():
        return rows, np.searchsorted(numbers, frame)
    raise AsterismError(
        f"{stamps.path} has {len(rows)} times of camera {name}, frames {frame.min()} to {frame.max()}, and it has {length} images; "
        "give the times of these images."
    )


def _counted(sources: Sequence[Source], lengths: Sequence[int]) -> list[NDArray[np.int64]]:
    """Each camera's frame numbers: its files', where all cameras' have such, in the largest steps that fit all of them; else those of
    files, begun at 0, beside mere counts."""
    if not all(source.numbered for source in sources):
        return [source.numbers - source.numbers[0] if source.numbered else np.arange(n) for source, n in zip(sources, lengths, strict=True)]
    every = np.concatenate([source.numbers for source in sources])
    # Cameras that number every second or tenth image count in steps; the largest that fits all is one frame.
    step = max(int(np.gcd.reduce(every - every[0])), 1)
    return [source.numbers // step for source in sources]


def common_rate(
    sources: Sequence[Source], given: float | None, when: Floats | None, names: Sequence[str], findings: list[Finding]
) -> float:
    """Frames per second: as given, by the times (T, C) s, by the videos, or 100; videos that differ are added to `findings`."""
    if given is not None:
        return given
    if when is not None:
        steps = np.concatenate([np.diff(column[np.isfinite(column)]) for column in when.T])
        return float(f"{1 / np.median(steps):.6g}") if len(steps) and np.median(steps) > 0 else _DEFAULT_RATE
    rates = np.array([source.rate for source in sources])
    apart = rates_apart(names, rates.tolist(), [len(source) for source in sources])
    if apart is not None:
        findings.append(Finding("detect-rates-differ", Severity.WARNING, *apart, "Give --times."))
    return float(np.median(rates)) if np.isfinite(rates).all() else _DEFAULT_RATE


def on_common_clock(blobs: Blobs, findings: list[Finding]) -> tuple[Blobs, float]:
    """The blobs at common instants where most of them can be followed from frame to frame; else as they are, which is added to `findings`.

    Returns the share of blobs that this leaves out, too.
    """
    common = to_common_clock(blobs)
    before, after = blobs.counts.sum(axis=0) / np.maximum(len(blobs), 1), common.counts.sum(axis=0) / np.maximum(len(common), 1)
    images = np.ones(before.shape) if blobs.times is None else np.isfinite(blobs.times).mean(axis=0)
    before /= np.maximum(images, 1e-9)
    lost = after < _LINKED * before
    if not lost.any():
        return common, max(0.0, 1.0 - float(after.sum() / max(before.sum(), 1e-9)))
    which = ", ".join(name for name, gone in zip(blobs.cameras, lost, strict=True) if gone)
    findings.append(
        Finding(
            "detect-not-followed",
            Severity.WARNING,
            which,
            f"camera {which}: fewer than {100 * _LINKED:.0f} % of the blobs can be followed from frame to frame, so none are interpolated "
            "to a common clock; each keeps its time.",
            "Trigger the cameras together, or record at a higher frame rate.",
        )
    )
    return blobs, 0.0
