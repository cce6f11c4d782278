"""How files are labelled: what a person chooses for a run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from numpy.typing import ArrayLike

from asterism.labelling.recording_labeller import LabellingSettings
from asterism.recording import MarkerSet

KEEP, CHECK, IGNORE = "keep", "check", "ignore"
"""What becomes of the names that points of a file have already: they stay; they stay where nothing contradicts them; they play no part."""


@dataclass(frozen=True)
class LabellingOptions:
    """What a person chooses for the files of a run.

    settings        how recordings are labelled
    file_names      `KEEP`, `CHECK` or `IGNORE` the names that points have already; None checks them where a file has points with names of
                    the model and points without a name, and else ignores them
    standing        trials in which the person stands: one is for all files; of several, each file takes that in the nearest folder
    find_standing   whether a standing trial is looked for among the files of the run, where none was given
    vertical        what points up, as `asterism.read` takes it
    by              what labels the files, for their logs, such as the model's file
    in_memory       whether whole recordings are needed, and not only what is written: for a page, or to correct them
    keep_tracklets  whether to keep what labelling again begins with
    markers         where no model is given: the marker sets that are worn, one for each body: shipped ones by name, files, or sets. Without
                    any, each file's is found among the shipped ones
    """

    settings: LabellingSettings = field(default_factory=LabellingSettings)
    file_names: str | None = None
    standing: Sequence[Path] = ()
    find_standing: bool = True
    vertical: ArrayLike | str | None = None
    by: str = ""
    in_memory: bool = False
    keep_tracklets: bool = False
    markers: Sequence[str | Path | MarkerSet] = ()
