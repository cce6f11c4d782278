"""The files of a run in; for each of them the trial in which its person stands, by which the model is narrowed to the person, out."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from asterism.errors import AsterismError

if TYPE_CHECKING:
    from asterism.recording import Recording

_STANDING = re.compile(
    r"(?i)(?<![a-z])(static|stand(?:ing)?|anat(?:omical)?[ _-]?pose|anatomical|neutral|[tna][ _-]?pose|cal(?:ib(?:ration)?)?)(?![a-z])"
)
"""What laboratories call the trial in which a person stands. A word of its own: "scale" and "instance" hold none of them."""
_NOT_STANDING = re.compile(r"(?i)wand|floor|l-?frame|func|dynamic|hip[ _-]?(?:joint|cent)|knee|star")
"""What is calibrated otherwise than by standing: cameras, and joints by movements of their own."""


@dataclass(frozen=True)
class StandingRules:
    """What a standing person's recording shows. Chosen on the 9 standing trials and 22 walks of the gait subjects, and 9 others' ones.

    max_speed  m/s: a marker that is slower rests. A standing person's markers sway with up to 0.02 m/s, a walker's stance foot rests, too
    step       s over which the speed is taken, so that the cameras' noise does not count
    resting    share of the markers that rest in a frame of standing
    frames     share of the frames that are such
    duration   s that a standing trial lasts at least
    """

    max_speed: float = 0.06
    step: float = 0.1
    resting: float = 0.9
    frames: float = 0.8
    duration: float = 0.2


def is_standing_name(path: Path) -> bool:
    """Whether a file's name says that a person stands in it."""
    return _STANDING.search(path.stem.replace("_", " ")) is not None and _NOT_STANDING.search(path.stem) is None


def stands(recording: Recording, rules: StandingRules | None = None) -> bool:
    """Whether most markers hardly move for most of a recording."""
    rules = rules or StandingRules()
    step = max(1, round(rules.step * recording.rate))
    # too short to say: a walker who pauses would pass
    if len(recording) <= step or len(recording) < rules.duration * recording.rate:
        return False
    moved = np.linalg.norm(recording.positions[step:] - recording.positions[:-step], axis=2)
    known = ~np.isnan(moved)
    # a marker that is not seen twice rests nowhere
    speed = np.where(known, moved, np.inf) * recording.rate / step
    resting = (speed < rules.max_speed).sum(axis=1) >= rules.resting * np.maximum(known.sum(axis=1), 1)
    enough = known.sum(axis=1) >= 4
    return bool((resting & enough).mean() >= rules.frames)


@dataclass
class StandingTrials:
    """Chooses the standing trial of each file's person.

    files      the files of the run
    given      trials named by a person: one is for all files; of several, each file takes that in the nearest folder
    automatic  whether files of the run are taken where none was named: first by their names, then by what they show
    """

    files: Sequence[Path]
    given: Sequence[Path] = ()
    automatic: bool = True
    axis: ArrayLike | str | None = None
    _by_posture: dict[Path, list[Path]] = field(default_factory=dict)

    def of(self, path: Path) -> Path | None:
        """The standing trial of the person in a file; None where none is known, or where the file is that trial."""
        if self.given:
            return self.given[0] if len(self.given) == 1 else max(self.given, key=lambda trial: _shared_depth(trial, path))
        # one file alone has no other that could be its standing trial
        if not self.automatic or len(self.files) < 2:
            return None
        # names first: they cost no reading
        if path in self._named:
            return None
        usable = [trial for trial in self._named if self._near(trial, path) and _same_person(trial, path)]
        if not usable:
            # no name says so: the files of the folder are read, each once
            usable = self._standing_beside(path)
            if path in usable:
                return None
        return max(usable, key=lambda trial: (_shared_depth(trial, path), len(person_prefix(trial))), default=None)

    def _near(self, trial: Path, path: Path) -> bool:
        """Whether two files lie in one folder, or in one below that which all files share."""
        # a trial above all files could be anybody's; one in a folder below belongs to that folder's person
        return trial.parent == path.parent or _shared_depth(trial, path) > self._shared

    @cached_property
    def _named(self) -> list[Path]:
        """The files whose names say that somebody stands."""
        return [trial for trial in self.files if is_standing_name(trial)]

    @cached_property
    def _shared(self) -> int:
        """How many folders deep the innermost folder lies that holds all files."""
        return len(Path(os.path.commonpath({os.path.abspath(file.parent) for file in self.files})).parts)

    def _standing_beside(self, path: Path) -> list[Path]:
        """The files of the same folder in which a person stands; each is read once."""
        from asterism import formats

        if path.parent not in self._by_posture:
            found = []
            for file in (file for file in self.files if file.parent == path.parent):
                try:
                    if stands(formats.read(file, vertical=self.axis)):
                        found.append(file)
                except (AsterismError, OSError):  # named when it is labelled itself
                    continue
            self._by_posture[path.parent] = found
        return self._by_posture[path.parent]


def _shared_depth(one: Path, other: Path) -> int:
    """How many folders deep the innermost folder lies that holds both files."""
    return len(Path(os.path.commonpath([os.path.abspath(one.parent), os.path.abspath(other.parent)])).parts)


def person_prefix(trial: Path) -> str:
    """What precedes the word for standing in a trial's name: "ann" of ann-static.c3d."""
    match = _STANDING.search(trial.stem.replace("_", " "))
    return re.sub(r"[\W_]+$", "", trial.stem[: match.start()] if match else "").casefold()


def _same_person(trial: Path, path: Path) -> bool:
    """Whether what precedes "static" in a trial's name begins the other file's name, too: ann-static.c3d and ann-walk.c3d."""
    return path.stem.casefold().startswith(person_prefix(trial))
