"""What was done to a recording since it was captured: one record per step, and its text in files."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class ProcessingStep:
    """One step in a recording's processing log.

    action    what was done, as a past participle: "labelled", "filled", "filtered", "cut"
    by        what did it: program and version, model file, or person
    settings  plain values (numbers, strings, lists of them) that repeat the step
    """

    action: str
    by: str = ""
    settings: Mapping[str, Any] = field(default_factory=dict)

    def __str__(self) -> str:
        """One line for a person: "labelled by gait.model (least_confidence 0.95)"."""
        settings = ", ".join(f"{name} {value}" for name, value in self.settings.items())
        return self.action + (f" by {self.by}" if self.by else "") + (f" ({settings})" if settings else "")


LABELLED_LIVE = ProcessingStep("labelled", "asterism live")
"""What is logged of a recording whose labels were given frame by frame, while it was captured. Its columns are these labels: of which track
a camera system took the points is not known any more. Its names are what was known at that moment, and no person's. The setting `markers`
names the set, or the model, that somebody chose; it is not there where the set was found."""


def labelled_live(log: Sequence[ProcessingStep]) -> ProcessingStep | None:
    """The step that gave a recording its present labels, where these were given live; None for labels given otherwise since, or none."""
    last = next((step for step in reversed(log) if step.action == LABELLED_LIVE.action), None)
    return last if last is not None and last.by == LABELLED_LIVE.by else None


def log_as_text(log: Sequence[ProcessingStep]) -> str:
    """A processing log as JSON of ASCII characters: a list of [action, by, settings]."""
    return json.dumps([[step.action, step.by, dict(step.settings)] for step in log], separators=(",", ":"))


def log_from_text(text: str) -> tuple[ProcessingStep, ...]:
    """The processing log that `log_as_text` wrote; empty for any other text: a damaged log makes no file unreadable."""
    try:
        steps = json.loads(text)
        # A log is a note: a damaged one must not make the file unreadable.
        return tuple(ProcessingStep(str(action), str(by), dict(settings)) for action, by, settings in steps)
    except (ValueError, TypeError, RecursionError):
        return ()
