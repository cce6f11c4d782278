"""Labelled recordings in; a page on how much was labelled, with which confidence, and how it looks, out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from asterism.recording import Clouds, Floats, Ints, Labelling, MarkerSet
from asterism.report import figures
from asterism.report.page import NOTHING, Cell, Page, Section, Table, count, percent, tinted, write_page
from asterism.report.scene import scene


@dataclass(frozen=True)
class LabelledRecording:
    """A labelled recording that a page shows in full.

    labelling   T frames, M markers
    clouds      the clouds that were labelled
    marker_set  for pairs and segments; by default the shipped set that has these markers
    truth       (T, M) int, for each marker its place in its frame's cloud, -1 where it is hidden; None where it is not known

    A marker without a label counts as unsure where its frame has points left over, as hidden where none is left. Where the truth is
    given, it decides.
    """

    labelling: Labelling
    clouds: Clouds
    marker_set: MarkerSet | None = None
    truth: Ints | None = None

    @cached_property
    def given(self) -> NDArray[np.bool_]:
        """(T, M) whether a marker got a label."""
        return np.asarray(self.labelling.indices >= 0)

    @cached_property
    def unsure(self) -> NDArray[np.bool_]:
        """(T, M) whether a marker got no label though it may be in view."""
        possible = (self.clouds.counts > self.given.sum(axis=1))[:, None] if self.truth is None else self.truth >= 0
        return np.asarray(~self.given & possible)

    @cached_property
    def hidden(self) -> NDArray[np.bool_]:
        """(T, M) whether a marker got no label and is out of view."""
        return ~self.given & ~self.unsure

    @cached_property
    def wrong(self) -> NDArray[np.bool_] | None:
        """(T, M) whether a label is wrong; None where the truth is not known."""
        return None if self.truth is None else self.given & (self.labelling.indices != self.truth)


def label_report(
    path: str | Path,
    shown: LabelledRecording,
    *,
    title: str,
    files: Sequence[Mapping[str, Any]] = (),
    model_info: Mapping[str, Any] | None = None,
) -> None:
    """Write an HTML page on labelled files, with one of them in full.

    shown       the recording that is shown in full; its truth, where it is known, adds right, wrong and missed
    files       a mapping per file: file, frames, labelled, unsure, hidden (shares 0..1), frames_per_second; what is absent shows as a
                dash. The first is the one shown in full
    model_info  facts for the foot of the page: model, seed, rules, ...

    Raises AsterismError where the file cannot be written.
    """
    name = Path(str(files[0].get("file", ""))).name if files else ""
    name = name or "the recording"
    counted = {
        "frames": len(shown.clouds),
        "labelled": _mean(shown.given),
        "unsure": _mean(shown.unsure),
        "hidden": _mean(shown.hidden),
    }
    rows = [{**(counted if i == 0 else {}), **file} for i, file in enumerate(files or [{"file": name}])]
    clouds = shown.clouds
    lead = f"{len(shown.labelling.names)} markers in {len(clouds):,} frames at {clouds.rate:g} frames per second"
    lead += f" ({len(clouds) / clouds.rate:.1f} s)." if len(rows) < 2 else f" in {name}, which is shown in full."
    sections = [
        Section("Files", table=_files(rows), note=_NOTE if shown.truth is None else _NOTE_WITH_TRUTH),
        *([] if shown.truth is None else [_against_truth(shown, shown.truth)]),
        *_pictures(shown, name),
        Section(f"Markers of {name}", table=_markers(shown)),
    ]
    write_page(path, Page(title, lead, model_info or {}, _merits(shown, rows), sections))


def _pictures(shown: LabelledRecording, name: str) -> list[Section]:
    """The recording in 3D and over time, where it has labels and frames."""
    labelling, clouds, wrong = shown.labelling, shown.clouds, shown.wrong
    sections = []
    view = scene(labelling, clouds, shown.marker_set, wrong)
    if view is not None:
        text = "Drag to turn the view; the slider moves in time. The view follows the body. Grey points have no label."
        sections.append(Section(f"{name} in 3D", text, scene=view))
    if shown.given.size:
        block = figures.frames_per_column(len(clouds))
        text = "Each row is a marker. The darker the colour, the higher the confidence. Amber: unsure. Grey: hidden."
        text += f" Each column stands for {block} frames." if block > 1 else ""
        text += " Red crosses: wrong labels." if wrong is not None and wrong.any() else ""
        picture = figures.timeline(labelling.names, np.nan_to_num(labelling.confidence), shown.given, shown.unsure, wrong, clouds.rate)
        sections.append(Section(f"{name} over time", text, figure=picture))
    return sections


def _merits(shown: LabelledRecording, rows: Sequence[Mapping[str, Any]]) -> list[tuple[str, str, str]]:
    """The figures at the head of the page."""
    merits = [
        (count(_total(rows, "frames")), "frames" if len(rows) < 2 else f"frames in {len(rows)} files", ""),
        (percent(_share(rows, "labelled"), 2), "of the markers labelled", ""),
        (percent(_share(rows, "unsure"), 2), "unsure", "warn" if _share(rows, "unsure") > _MANY_UNSURE else ""),
        (percent(_share(rows, "hidden"), 2), "hidden", ""),
        (percent(_mean(shown.labelling.confidence[shown.given] >= 0.99), 2), "of the labels have a confidence of 99 % or more", ""),
    ]
    if shown.wrong is not None:
        share = _mean(shown.wrong[shown.given])
        merits.append((percent(share, 3), "of the labels wrong", "good" if share <= _FEW_WRONG else "bad"))
    timed = [row for row in rows if row.get("frames_per_second", 0) > 0]
    if timed:
        seconds = sum(row["frames"] / row["frames_per_second"] for row in timed)
        merits.append((count(_total(timed, "frames") / seconds if seconds else float("nan")), "frames per second", ""))
    return merits


_MANY_UNSURE = 0.02
"""Share of unsure markers from which the page marks it."""
_FEW_WRONG = 0.001
"""Share of wrong labels up to which the page marks it as good: the target hit rate of a model by default."""
_NOTE = (
    "Unsure: a marker without a label in a frame with unlabelled points (the marker may be hidden, and the points may be ghosts). "
    "Hidden: a marker without a label in a frame in which every point has a label."
)
_NOTE_WITH_TRUTH = "Unsure: a marker in view without a label. Hidden: a marker out of view without a label, which is right."


def _files(rows: Sequence[Mapping[str, Any]]) -> Table:
    head = ["file", "frames", "labelled", "unsure", "hidden", "frames/s"]
    nan = float("nan")
    return Table(
        head,
        [
            [
                Path(str(row.get("file", NOTHING))).name,
                count(row.get("frames", nan)),
                percent(row.get("labelled", nan), 2),
                tinted(float(row.get("unsure", nan)), 2, 0.5),
                percent(row.get("hidden", nan), 2),
                count(row.get("frames_per_second", nan)),
            ]
            for row in rows
        ],
    )


def _against_truth(shown: LabelledRecording, truth: Ints) -> Section:
    given, visible = shown.given, truth >= 0
    right = given & (shown.labelling.indices == truth)
    false_labels = given & ~visible
    outcomes = [
        ("right label", right, visible, "of the visible markers"),
        ("wrong label: the marker is at another point", given & visible & ~right, visible, "of the visible markers"),
        ("missed: visible, but no label", ~given & visible, visible, "of the visible markers"),
        ("wrong label: the marker was hidden", false_labels, ~visible, "of the hidden markers"),
        ("hidden, and no label: right", ~given & ~visible, ~visible, "of the hidden markers"),
    ]
    rows: list[list[str | Cell]] = [
        [name, count(int(hit.sum())), f"{percent(hit.sum() / of.sum() if of.any() else float('nan'), 3)} {what}"]
        for name, hit, of, what in outcomes
    ]
    perfect = _mean((right == visible).all(axis=1) & ~false_labels.any(axis=1))
    rows.append(["frames with every marker right", count(perfect * len(truth)), f"{percent(perfect, 2)} of the frames"])
    return Section("Against the truth", "The true place of every marker is known here.", table=Table(["", "number", "share"], rows))


def _markers(shown: LabelledRecording) -> Table:
    labelling, given, truth = shown.labelling, shown.given, shown.truth
    head = ["marker", "labelled", "unsure", "hidden", "mean confidence", "lowest confidence"]
    head += [] if truth is None else ["right", "wrong", "missed"]
    rows: list[list[str | Cell]] = []
    for m, name in enumerate(labelling.names):
        confidence = labelling.confidence[given[:, m], m]
        row: list[str | Cell] = [
            name,
            percent(_mean(given[:, m]), 2),
            tinted(_mean(shown.unsure[:, m]), 2, 0.5),
            percent(_mean(shown.hidden[:, m]), 2),
            percent(_mean(confidence), 2),
            percent(float(confidence.min()) if len(confidence) else float("nan"), 2),
        ]
        if truth is not None:
            right, visible = given[:, m] & (labelling.indices[:, m] == truth[:, m]), truth[:, m] >= 0
            wrong = int((given[:, m] & ~right).sum())
            row += [count(int(right.sum())), Cell(count(wrong), min(wrong / 10, 1.0), "bad"), count(int((visible & ~given[:, m]).sum()))]
        rows.append(row)
    return Table(head, rows)


def _mean(values: NDArray[np.bool_] | Floats) -> float:
    return float(values.mean()) if values.size else float("nan")


def _total(rows: Sequence[Mapping[str, Any]], key: str) -> float:
    return float(sum(row.get(key, 0) for row in rows))


def _share(rows: Sequence[Mapping[str, Any]], key: str) -> float:
    """The mean of a share over the frames of all files that give it."""
    known = [(row[key], row["frames"]) for row in rows if key in row and row.get("frames", 0) > 0 and not np.isnan(row[key])]
    frames = sum(number for _, number in known)
    return sum(share * number for share, number in known) / frames if frames else float("nan")
