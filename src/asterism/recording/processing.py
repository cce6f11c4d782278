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
