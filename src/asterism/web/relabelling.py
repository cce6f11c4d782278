"""A model and trials of a sitting in; each labelled again by it, what a person said held, and how far that is, out."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from asterism.errors import sentence_of
from asterism.recording.display import counted

if TYPE_CHECKING:
    from asterism.progress import Progress
    from asterism.session import FileLabeller


@dataclass(frozen=True)
class SittingModel:
    """What can label the trials of a sitting: its name, and the labeller."""

    name: str
    labeller: FileLabeller


@dataclass(frozen=True)
class Relabelled:
    """What labelling a trial again has changed.

    model     the model's name
    revision  of the labels that it gave
    samples   points that have another label
    """

    model: str
    revision: int
    samples: int


class LabelledAgain(Protocol):
    """A trial of a sitting, as far as labelling it again goes."""

    @property
    def path(self) -> Path:
        """Its file."""
        ...

    @property
    def relabelled(self) -> Relabelled | None:
        """What the last time has changed."""
        ...

    def relabel(self, model: SittingModel, progress: Progress) -> None:
        """Label it by a model, whole, or raise and change nothing."""
        ...


class _Stopped(Exception):
    """A person has stopped the run."""


@dataclass
class RelabelRun:
    """Trials that are labelled again, one after the other. A trial is changed when it is labelled whole, or not at all.

    busy     held while a trial is labelled
    done     trials that are labelled again
    present  the name of the trial that is being labelled; empty where none is
    share    of that trial, 0 to 1
    failed   a sentence for each trial that could not be
    samples  points that have another label
    """

    model: SittingModel
    trials: Sequence[LabelledAgain]
    busy: threading.Lock
    running: bool = True
    done: int = 0
    present: str = ""
    share: float = 0.0
    failed: list[str] = field(default_factory=list)
    samples: int = 0
    _stop: threading.Event = field(default_factory=threading.Event)

    def run(self) -> None:
        """Label them."""
        try:
            for trial in self.trials:
                with self.busy:
                    if self._stop.is_set():
                        break
                    self.present, self.share = trial.path.name, 0.0
                    self._label(trial)
        finally:
            self.running, self.present = False, ""

    def stop(self) -> None:
        """Leave out what is not labelled again yet, at the next step of the work."""
        self._stop.set()

    @property
    def sentence(self) -> str:
        """What has become of it."""
        kept = len(self.trials) - self.done - len(self.failed)
        parts = [f"{counted(self.done, 'recording')} labelled again with {self.model.name}: {counted(self.samples, 'sample')} changed."]
        if self._stop.is_set() and kept:
            parts.append(f"Stopped: {counted(kept, 'recording')} kept as {'it was' if kept == 1 else 'they were'}.")
        return " ".join([*parts, *self.failed])

    def _label(self, trial: LabelledAgain) -> None:
        try:
            trial.relabel(self.model, self._report)
        except _Stopped:
            return
        except Exception as problem:  # whatever a file raises costs that file only
            text = sentence_of(problem)
            self.failed.append(text if trial.path.name in text else f"{trial.path.name}: {text}")
            return
        self.done += 1
        self.samples += trial.relabelled.samples if trial.relabelled is not None else 0

    def _report(self, share: float, what: str) -> None:
        if self._stop.is_set():
            raise _Stopped
        self.share = share
