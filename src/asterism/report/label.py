"""Labelled recordings in; out comes a page on how much was labelled, how surely, and how it looks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from asterism.recording import Clouds, Floats, Ints, Labelling, MarkerSet, Recording
from asterism.report import figures
from asterism.report.page import NOTHING, Cell, Page, Section, Table, count, percent, tinted, write_page
from asterism.report.scene import scene


def label_report(
    path: str | Path,
    *,
    title: str,
    files: Sequence[Mapping[str, Any]],
    recording: Recording,
    labelling: Labelling,
    clouds: Clouds,
    model_info: Mapping[str, Any],
    truth: Ints | None = None,
    marker_set: MarkerSet | None = None,
) -> None:
    """Write an HTML page on labelled files, with one of them in full.

    files       a mapping per file: file, frames, labelled, unsure, hidden (shares 0..1), frames_per_second; what is absent shows as a
                dash. The first is the one shown in full
    recording, labelling, clouds  what is shown in full
    model_info  facts for the foot of the page: model, seed, rules, ...
    truth       (T, M) int, for each marker its place in its frame's cloud, -1 where it is hidden: adds right, wrong and missed
    marker_set  for pairs and segments; by default the shipped set that has these markers

    A marker without a label counts as unsure where its frame has points left over, as hidden where none is left; where the truth is
    given it decides. Raises AsterismError where the file cannot be written.
    """
    given = labelling.indices >= 0
    unsure = ~given & ((clouds.counts > given.sum(axis=1))[:, None] if truth is None else truth >= 0)
    hidden = ~given & ~unsure
    wrong = None if truth is None else given & (labelling.indices != truth)
    first = files[0].get("file", "") if files else recording.metadata.get("file", "")
    shown = Path(str(first)).name or "the recording"
    own = {"frames": len(clouds), "labelled": _mean(given), "unsure": _mean(unsure), "hidden": _mean(hidden)}
    rows = [{**(own if i == 0 else {}), **file} for i, file in enumerate(files or [{"file": shown}])]

    sections = [Section("Files", table=_files(rows), note=_NOTE if truth is None else _NOTE_WITH_TRUTH)]
    if truth is not None:
        sections.append(_against_truth(given, labelling, truth))
    view = scene(labelling, clouds, marker_set, wrong)
    if view is not None:
        sections.append(
            Section(
                f"{shown} in 3D",
                "Drag to turn it; the slider moves in time. The view goes along with the body; grey points got no label.",
                scene=view,
            )
        )
    if given.size:
        sections.append(
            Section(
                f"{shown} over time",
                "Each row is a marker: the darker, the surer the label. Amber: unsure. Grey: hidden."
                + (f" Each column stands for {block} frames." if (block := figures.frames_per_column(len(clouds))) > 1 else "")
                + (" Red crosses: wrong labels." if wrong is not None and wrong.any() else ""),
                figure=figures.timeline(labelling.names, labelling.confidence, given, unsure, wrong, clouds.rate),
            )
        )
    sections.append(Section(f"Markers of {shown}", table=_markers(labelling, given, unsure, hidden, truth)))
    merits = [
        (count(_total(rows, "frames")), "frames" if len(rows) < 2 else f"frames in {len(rows)} files", ""),
        (percent(_share(rows, "labelled"), 2), "of the markers labelled", ""),
        (percent(_share(rows, "unsure"), 2), "unsure", "warn" if _share(rows, "unsure") > 0.02 else ""),
        (percent(_share(rows, "hidden"), 2), "hidden", ""),
        (percent(_mean(labelling.confidence[given] >= 0.99), 2), "of the labels are 99 % sure or more", ""),
    ]
    if wrong is not None:
        share = _mean(wrong[given])
        merits.append((percent(share, 3), "of the labels wrong", "good" if share <= 0.001 else "bad"))
    timed = [row for row in rows if row.get("frames_per_second", 0) > 0]
    if timed:
        seconds = sum(row["frames"] / row["frames_per_second"] for row in timed)
        merits.append((count(_total(timed, "frames") / seconds if seconds else float("nan")), "frames per second", ""))
    lead = f"{len(labelling.names)} markers in {len(clouds):,} frames at {clouds.rate:g} frames per second"
    lead += f" ({len(clouds) / clouds.rate:.1f} s)." if len(rows) < 2 else f" in {shown}, which is shown in full."
    write_page(path, Page(title, lead, model_info, merits, sections))


_NOTE = (
    "Unsure: a marker without a label while the frame had points left over (it may be hidden, and the points may be ghosts). "
    "Hidden: a marker without a label because every point of the frame had found its marker."
)
_NOTE_WITH_TRUTH = "Unsure: a marker in view that got no label. Hidden: a marker out of view that got none, as it should."


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


def _against_truth(given: NDArray[np.bool_], labelling: Labelling, truth: Ints) -> Section:
    visible = truth >= 0
    right = given & (labelling.indices == truth)
    haunted = given & ~visible
    outcomes = [
        ("right label", right, visible, "of the visible markers"),
        ("wrong label: another point than its own", given & visible & ~right, visible, "of the visible markers"),
        ("missed: visible, but no label", ~given & visible, visible, "of the visible markers"),
        ("wrong label: the marker was hidden", haunted, ~visible, "of the hidden markers"),
        ("rightly without a label", ~given & ~visible, ~visible, "of the hidden markers"),
    ]
    rows: list[list[str | Cell]] = [
        [name, count(int(hit.sum())), f"{percent(hit.sum() / of.sum() if of.any() else float('nan'), 3)} {what}"]
        for name, hit, of, what in outcomes
    ]
    perfect = _mean((right == visible).all(axis=1) & ~haunted.any(axis=1))
    rows.append(["frames with every marker right", count(perfect * len(truth)), f"{percent(perfect, 2)} of the frames"])
    return Section("Against the truth", "The true place of every marker is known here.", table=Table(["", "number", "share"], rows))


def _markers(
    labelling: Labelling, given: NDArray[np.bool_], unsure: NDArray[np.bool_], hidden: NDArray[np.bool_], truth: Ints | None
) -> Table:
    head = ["marker", "labelled", "unsure", "hidden", "mean confidence", "least confidence"]
    head += [] if truth is None else ["right", "wrong", "missed"]
    rows: list[list[str | Cell]] = []
    for m, name in enumerate(labelling.names):
        sure = labelling.confidence[given[:, m], m]
        row: list[str | Cell] = [
            name,
            percent(_mean(given[:, m]), 2),
            tinted(_mean(unsure[:, m]), 2, 0.5),
            percent(_mean(hidden[:, m]), 2),
            percent(_mean(sure), 2),
            percent(float(sure.min()) if len(sure) else float("nan"), 2),
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
    """The mean of a share over the frames of all files that tell it."""
    told = [(row[key], row["frames"]) for row in rows if key in row and row.get("frames", 0) > 0 and not np.isnan(row[key])]
    frames = sum(number for _, number in told)
    return sum(share * number for share, number in told) / frames if frames else float("nan")
