"""A recording in; a page that plays it, with what is missing on a timeline, out."""

from __future__ import annotations

import webbrowser
from dataclasses import dataclass
from html import escape
from pathlib import Path
from tempfile import mkdtemp

import numpy as np

from asterism.errors import AsterismError
from asterism.recording import NULL, Floats, Labelling, Recording
from asterism.recording.marker_set import is_unnamed
from asterism.report.page import Page, Section, count, percent, write_page
from asterism.report.player import ShownRecording, pack_recordings


@dataclass(frozen=True)
class RecordingPage:
    """A page that shows a recording, as `plot_recording` writes it."""

    path: Path

    def open(self) -> None:
        """Show the page in the default browser."""
        webbrowser.open(self.path.absolute().as_uri())

    def _repr_html_(self) -> str:
        return f'<iframe srcdoc="{escape(self.path.read_text(encoding="utf-8"))}" width="100%" height="640" style="border:0"></iframe>'


def plot_recording(recording: Recording, path: str | Path | None = None) -> RecordingPage:
    """A page that plays the recording, written to `path`, by default to a temporary file.

    In a notebook the page is shown; elsewhere `.open()` shows it in the browser. Raises AsterismError where there is nothing to plot,
    or the file cannot be written.

    >>> from asterism.simulation import simulate_walks
    >>> page = plot_recording(simulate_walks(1, frames=20)[0], "walk.html")
    >>> page.path.exists()
    True
    """
    target = Path(mkdtemp(prefix="asterism-")) / "recording.html" if path is None else Path(path)
    recording_report(target, recording)
    return RecordingPage(target)


def recording_report(path: str | Path, recording: Recording) -> None:
    """Write an HTML page that plays a recording under its own labels. `plot_recording` calls it.

    Columns without a name are drawn as points without a label. A recording that is too long for the page is shown with fewer frames per
    second. Raises AsterismError where the recording has no frames or no columns, or the file cannot be written.
    """
    if not len(recording) or not recording.labels:
        raise AsterismError("the recording has no frames or no columns, so there is nothing to plot.")
    named = named_columns(recording)
    shown = recording.visible[:, named]
    labelling = labelling_by_names(recording)
    file = str(recording.metadata.get("file", ""))
    name = Path(file).name if file else "recording"
    one = ShownRecording(name, labelling, recording.clouds(), recording.first_frame, unsure=np.zeros_like(shown))
    merits = [
        (count(len(recording)), f"frames at {recording.rate:g} Hz", ""),
        (count(len(named)), "named columns", ""),
        (count(len(recording.labels) - len(named)), "columns without a name", ""),
        (percent(1.0 - float(shown.mean()) if shown.size else float("nan"), 1), "of the samples of named columns are missing", ""),
    ]
    text = "Drag to turn; with the picture in focus, space plays and the arrow keys step."
    section = Section("In 3D", text, player=pack_recordings([one]))
    write_page(path, Page(name, "", {"file": file or None}, merits, [section]))


def named_columns(recording: Recording) -> list[int]:
    """The columns that have a name."""
    return [column for column, label in enumerate(recording.labels) if not is_unnamed(label)]


def label_confidence(recording: Recording) -> Floats | None:
    """(T, N) of the recording's own labels, as its file has it; None where the file has none, or is of other frames."""
    from asterism.formats import read_confidence

    file = str(recording.metadata.get("file", ""))
    if not file or not Path(file).is_file():
        return None
    try:
        known = read_confidence(file, opened=recording.source)
    except AsterismError:
        return None
    if known is None or len(known.values) != len(recording):
        return None
    found = np.ones(recording.visible.shape)
    for column, label in enumerate(recording.labels):
        if label in known.names:
            found[:, column] = known.values[:, known.names.index(label)]
    return found


def labelling_by_names(recording: Recording, confidence: Floats | None = None) -> Labelling:
    """The recording's own names as a labelling of its clouds, each certain where no confidence (T, N) is given."""
    visible, named = recording.visible, named_columns(recording)
    # A visible column is the point of its frame's cloud at this place.
    place = np.cumsum(visible, axis=1) - 1
    shown, names = visible[:, named], tuple(recording.labels[column] for column in named)
    certain = 1.0 if confidence is None else confidence[:, named]
    return Labelling(np.where(shown, place[:, named], NULL), np.where(shown, certain, 0.0), names)
