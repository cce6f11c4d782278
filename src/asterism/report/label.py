"""Labelled recordings in; a page on how much was labelled, with which confidence, and how it looks, out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from asterism.findings import Finding
from asterism.recording import Clouds, Floats, Ints, Labelling, LabelStates, MarkerSet, label_states
from asterism.recording.display import short_names
from asterism.recording.shares import SURE
from asterism.recording.verdict import FITS, OTHER_BODY
from asterism.report.page import NOTHING, Cell, Page, Section, Table, count, findings_table, percent, tinted, write_page
from asterism.report.player import WRONG, ShownRecording, pack_recordings


@dataclass(frozen=True)
class LabelledRecording:
    """A labelled recording that a page shows.

    labelling    T frames, M markers
    clouds       the clouds that were labelled
    marker_set   for pairs and segments; by default the shipped set that has these markers
    truth        (T, M) int, for each marker its place in its frame's cloud, -1 where it is hidden; None where it is not known
    first_frame  the number that the file gives its first frame

    """

    labelling: Labelling
    clouds: Clouds
    marker_set: MarkerSet | None = None
    truth: Ints | None = None
    first_frame: int = 1

    @cached_property
    def states(self) -> LabelStates:
        """What became of each marker in each frame."""
        return label_states(self.labelling, self.clouds)

    @cached_property
    def given(self) -> NDArray[np.bool_]:
        """(T, M) whether a marker got a label."""
        return np.asarray(self.labelling.indices >= 0)

    @cached_property
    def likely(self) -> NDArray[np.bool_]:
        """(T, M) whether a marker got a label with a confidence below 99 %."""
        return self.states.likely

    @cached_property
    def unsure(self) -> NDArray[np.bool_]:
        """(T, M) whether a marker got no label though a point without one may be it."""
        return self.states.unsure

    @cached_property
    def hidden(self) -> NDArray[np.bool_]:
        """(T, M) whether a marker got no label and no point is left that may be it."""
        return self.states.hidden

    @cached_property
    def wrong(self) -> NDArray[np.bool_] | None:
        """(T, M) whether a label is wrong; None where the truth is not known."""
        return None if self.truth is None else self.given & (self.labelling.indices != self.truth)


def label_report(
    path: str | Path,
    shown: LabelledRecording | Sequence[LabelledRecording],
    *,
    title: str,
    files: Sequence[Mapping[str, Any]] = (),
    model_info: Mapping[str, Any] | None = None,
    findings: Sequence[Finding] = (),
) -> None:
    """Write an HTML page on labelled files, with each of them in 3D and over time.

    shown       the recordings, in the order of `files`; their truth, where it is known, adds right, wrong and missed
    files       a mapping per file: file, frames, labelled, likely, unsure, hidden (shares 0..1), verdict, readiness, use,
                why, frames_per_second; what is absent is counted in the recording, or shows as a dash
    model_info  facts for the foot of the page: model, seed, rules, ...
    findings    on the files

    A page of many files shows some of them with fewer frames per second, so that it stays small. Raises AsterismError where the file cannot
    be written.
    """
    recordings = [shown] if isinstance(shown, LabelledRecording) else list(shown)
    unnamed = ["the recording"] if len(recordings) == 1 else [f"recording {i + 1}" for i in range(len(recordings))]
    # A recording without a row still gets one: the page counts it itself.
    given_rows = [*files, *({"file": name} for name in unnamed[len(files) :])]
    rows = [{**_counted(recordings, i, row), **row} for i, row in enumerate(given_rows)]
    names = short_names([str(row.get("file", "")) or "the recording" for row in rows])
    sections = [
        Section("Files", table=_files(rows, names), note=_note(rows, names)),
        *([Section("What to know before using it", table=findings_table(findings))] if findings else []),
        *([_against_truth(recordings)] if any(one.truth is not None for one in recordings) else []),
        *_pictures(recordings, rows, names),
        *([Section(f"Markers of {names[0]}" if len(recordings) == 1 else "Markers of all files", table=_markers(recordings, names))]),
    ]
    write_page(path, Page(title, _lead(recordings), model_info or {}, _merits(recordings, rows), sections))


def _counted(recordings: Sequence[LabelledRecording], number: int, row: Mapping[str, Any]) -> dict[str, Any]:
    """What a row says of its recording where the row does not say it itself."""
    if number >= len(recordings):
        return {}
    one = recordings[number]
    # What the caller counted is not counted again; both must not differ on one page.
    if "labelled" in row:
        return {"frames": len(one.clouds)}
    return {
        "frames": len(one.clouds),
        "labelled": _mean(one.given & ~one.likely),
        "likely": _mean(one.likely),
        "unsure": _mean(one.unsure),
        "hidden": _mean(one.hidden),
    }


def _lead(recordings: Sequence[LabelledRecording]) -> str:
    if not recordings:
        return "No recording was labelled."
    sets = sorted({len(one.labelling.names) for one in recordings})
    # files of a run may be of different marker sets
    markers, frames = str(sets[0]) if len(sets) == 1 else f"{sets[0]} to {sets[-1]}", sum(len(one.clouds) for one in recordings)
    seconds = sum(len(one.clouds) / one.clouds.rate for one in recordings)
    if len(recordings) == 1:
        return f"{markers} markers in {frames:,} frames at {recordings[0].clouds.rate:g} frames per second ({seconds:.1f} s)."
    return f"{markers} markers in {len(recordings)} recordings, {frames:,} frames ({seconds:.1f} s) in all."


def _pictures(recordings: Sequence[LabelledRecording], rows: Sequence[Mapping[str, Any]], names: Sequence[str]) -> list[Section]:
    """The recordings in 3D and over time, those that have frames and points or markers."""
    if not any(one.given.size for one in recordings):
        return []
    text = "Drag to turn, shift-drag to move, Ctrl and the wheel to zoom; with the picture in focus, space plays and the arrow keys step. "
    text += "Opacity: confidence of the label. Faint: a hidden marker where it was expected. The arrow is the walking direction. "
    text += "Below, each row is a marker: the darker, the higher the confidence; amber: unsure; grey: hidden"
    # The legend names a colour only where it is shown.
    text += "; red: a wrong label." if any(one.wrong is not None and one.wrong.any() for one in recordings) else "."
    packed = pack_recordings([_shown(one, row, name) for one, row, name in zip(recordings, rows, names, strict=False)])
    heading = f"{names[0]} in 3D and over time" if len(recordings) == 1 else "Each file in 3D and over time"
    return [Section(heading, text, player=packed)]


def _shown(one: LabelledRecording, row: Mapping[str, Any], name: str) -> ShownRecording:
    marks = None
    if one.wrong is not None:
        marks = np.zeros(len(one.clouds.xyz), dtype=np.int64)
        frames, markers = np.nonzero(one.wrong)
        marks[one.clouds.offsets[frames] + one.labelling.indices[frames, markers]] = WRONG
    # Begin where something is labelled, not in the empty room before.
    first = np.nonzero(one.given.any(axis=1))[0]
    return ShownRecording(
        name,
        one.labelling,
        one.clouds,
        one.first_frame,
        unsure=one.unsure,
        marks=marks,
        marker_set=one.marker_set,
        note=_row_text(row),
        start=int(first[0]) if len(first) else 0,
    )


def _row_text(row: Mapping[str, Any]) -> str:
    """A file's row as a line above its picture."""
    shares = [f"{percent(float(row[key]), 2)} {key}" for key in ("labelled", "likely", "unsure", "hidden") if key in row]
    verdict = row.get("verdict")
    return ", ".join([*([str(verdict)] if verdict else []), *shares])


def _merits(recordings: Sequence[LabelledRecording], rows: Sequence[Mapping[str, Any]]) -> list[tuple[str, str, str]]:
    """The figures at the head of the page."""
    merits = [
        (count(_total(rows, "frames")), "frames" if len(rows) < 2 else f"frames in {len(rows)} files", ""),
        (percent(_share(rows, "labelled"), 2), "of the markers labelled", ""),
        *([(percent(_share(rows, "likely"), 2), "likely", "")] if any("likely" in row for row in rows) else []),
        (percent(_share(rows, "unsure"), 2), "unsure", "warn" if _share(rows, "unsure") > _MANY_UNSURE else ""),
        (percent(_share(rows, "hidden"), 2), "hidden", ""),
    ]
    # The truth is known of simulated files only.
    checked = [one.wrong[one.given] for one in recordings if one.wrong is not None]
    if checked:
        share = _mean(np.concatenate(checked))
        merits.append((percent(share, 3), "of the labels wrong", "good" if share <= _FEW_WRONG else "bad"))
    timed = [row for row in rows if row.get("frames_per_second", 0) > 0]
    if timed:
        # Frames over seconds of all files: the mean of speeds would favour short ones.
        seconds = sum(row["frames"] / row["frames_per_second"] for row in timed)
        merits.append((count(_total(timed, "frames") / seconds if seconds else float("nan")), "frames per second", ""))
    return merits


_MANY_UNSURE = 0.02
"""Share of unsure markers from which the page marks it."""
_FEW_WRONG = 0.001
"""Share of wrong labels up to which the page marks it as good: the target hit rate of a model by default."""
_NAMED = 5
"""Files that are named with a reason; a line has room for so many."""
_NOTE = (
    "Labelled: a label with a confidence of 99 % or more. Likely: a label with less. "
    "Unsure: a marker without a label, where one of the unlabelled points may be it. "
    "Hidden: a marker without a label, where none is left that may be it: all points have a label, or the others are ghosts."
)


def _files(rows: Sequence[Mapping[str, Any]], names: Sequence[str]) -> Table:
    nan = float("nan")
    judged, likely = any(row.get("verdict") or row.get("use") for row in rows), any("likely" in row for row in rows)
    head = ["file", *(["verdict"] if judged else []), "frames", "labelled", *(["likely"] if likely else []), "unsure", "hidden", "frames/s"]
    return Table(
        head,
        [
            [
                name,
                *([_verdict(row)] if judged else []),
                count(row.get("frames", nan)),
                percent(row.get("labelled", nan), 2),
                *([percent(row.get("likely", nan), 2)] if likely else []),
                tinted(float(row.get("unsure", nan)), 2, 0.5),
                percent(row.get("hidden", nan), 2),
                count(row.get("frames_per_second", nan)),
            ]
            for row, name in zip(rows, names, strict=True)
        ],
        left=2 if judged else 1,
        opens=True,
    )


def _note(rows: Sequence[Mapping[str, Any]], names: Sequence[str]) -> str:
    """What the columns mean, and why files need a look; each reason once, with its first files."""
    of_reason: dict[str, list[str]] = {}
    for row, name in zip(rows, names, strict=True):
        if row.get("why"):
            of_reason.setdefault(f"{row['use']}: {row['why']}", []).append(name)
    reasons = [f"{', '.join(files[:_NAMED])}{', ...' if len(files) > _NAMED else ''}: {reason}." for reason, files in of_reason.items()]
    return " ".join([_NOTE, *reasons])


def _verdict(row: Mapping[str, Any]) -> Cell:
    """Whether a file can be used, and what it shows where that is not what the model knows."""
    kind, use = row.get("verdict"), row.get("use")
    verdict = ", ".join([*([str(use)] if use else []), *([str(kind)] if kind and not (use and kind == FITS) else [])]) or NOTHING
    fine = kind in (None, FITS) and row.get("readiness") in (None, "ready")
    return Cell(verdict, 0.0 if fine else 1.0, "bad" if kind == OTHER_BODY or row.get("readiness") == "do-not-use" else "warn")


def _against_truth(recordings: Sequence[LabelledRecording]) -> Section:
    known = [(one, one.truth) for one in recordings if one.truth is not None]
    hits, frames_right, frames = np.zeros(5, dtype=np.int64), 0, 0
    visible_markers, hidden_markers = 0, 0
    for one, truth in known:
        given, visible = one.given, truth >= 0
        right = given & (one.labelling.indices == truth)
        false_labels = given & ~visible
        # Every marker of every frame is in exactly one of five outcomes.
        hits += [int(part.sum()) for part in (right, given & visible & ~right, ~given & visible, false_labels, ~given & ~visible)]
        visible_markers, hidden_markers = visible_markers + int(visible.sum()), hidden_markers + int((~visible).sum())
        # A frame counts as right only with every visible marker right and no hidden one labelled.
        frames_right += int(((right == visible).all(axis=1) & ~false_labels.any(axis=1)).sum())
        frames += len(truth)
    outcomes = [
        ("right label", visible_markers, "of the visible markers"),
        ("wrong label: the marker is at another point", visible_markers, "of the visible markers"),
        ("missed: visible, but no label", visible_markers, "of the visible markers"),
        ("wrong label: the marker was hidden", hidden_markers, "of the hidden markers"),
        ("hidden, and no label: right", hidden_markers, "of the hidden markers"),
    ]
    rows: list[list[str | Cell]] = [
        [name, count(int(hit)), f"{percent(hit / of if of else float('nan'), 3)} {what}"]
        for (name, of, what), hit in zip(outcomes, hits, strict=True)
    ]
    nan = float("nan")
    perfect = percent(frames_right / frames if frames else nan, 2)
    rows.append(["frames with every marker right", count(frames_right if frames else nan), f"{perfect} of the frames"])
    return Section("Against the truth", "The true place of every marker is known here.", table=Table(["", "number", "share"], rows))


def _markers(recordings: Sequence[LabelledRecording], files: Sequence[str]) -> Table:
    """A row per marker, over all recordings that have it; of several, the last column names the file with its lowest confidence."""
    known = any(one.truth is not None for one in recordings)
    head = ["marker", "labelled", "likely", "unsure", "hidden", "mean confidence", "lowest confidence"]
    head += ["right", "wrong", "missed"] if known else []
    head += ["lowest in"] if len(recordings) > 1 else []
    names = dict.fromkeys(name for one in recordings for name in one.labelling.names)
    return Table(head, [_marker_row(name, recordings, files, known) for name in names])


def _marker_row(name: str, recordings: Sequence[LabelledRecording], files: Sequence[str], known: bool) -> list[str | Cell]:
    # A marker may be absent in some of the files.
    having = [
        (one, one.labelling.names.index(name), file) for one, file in zip(recordings, files, strict=False) if name in one.labelling.names
    ]

    def column(part: str) -> NDArray[np.bool_]:
        return np.concatenate([getattr(one, part)[:, m] for one, m, _ in having])

    given = [one.labelling.confidence[one.given[:, m], m] for one, m, _ in having]
    confidence = np.concatenate(given)
    # Which file to look at first.
    lowest = [float(part.min()) if len(part) else float("inf") for part in given]
    row: list[str | Cell] = [
        name,
        percent(_mean(column("given") & ~column("likely")), 2),
        percent(_mean(column("likely")), 2),
        tinted(_mean(column("unsure")), 2, 0.5),
        percent(_mean(column("hidden")), 2),
        percent(_mean(confidence), 2),
        percent(float(confidence.min()) if len(confidence) else float("nan"), 2),
    ]
    if known:
        counts = np.zeros(3, dtype=np.int64)
        for one, m, _ in having:
            if one.truth is not None:
                right, visible = one.given[:, m] & (one.labelling.indices[:, m] == one.truth[:, m]), one.truth[:, m] >= 0
                counts += [int(part.sum()) for part in (right, one.given[:, m] & ~right, visible & ~one.given[:, m])]
        row += [count(int(counts[0])), Cell(count(int(counts[1])), min(counts[1] / 10, 1.0), "bad"), count(int(counts[2]))]
    if len(recordings) > 1:
        row.append(having[int(np.argmin(lowest))][2] if min(lowest) < SURE else NOTHING)
    return row


def _mean(values: NDArray[np.bool_] | Floats) -> float:
    return float(values.mean()) if values.size else float("nan")


def _total(rows: Sequence[Mapping[str, Any]], key: str) -> float:
    return float(sum(row.get(key, 0) for row in rows))


def _share(rows: Sequence[Mapping[str, Any]], key: str) -> float:
    """The mean of a share over the frames of all files that give it."""
    # Weighted by frames: a short file must not count as much as a long one.
    known = [(row[key], row["frames"]) for row in rows if key in row and row.get("frames", 0) > 0 and not np.isnan(row[key])]
    frames = sum(number for _, number in known)
    return sum(share * number for share, number in known) / frames if frames else float("nan")
