"""What a person should know before they use a result: one record for all rooms, and the exit status that follows from it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import IntEnum

__all__ = ["Finding", "Severity", "exit_status", "worst"]


class Severity(IntEnum):
    """How much a finding speaks against a result."""

    NOTE = 0
    """Worth knowing. The result can be used as it is."""
    WARNING = 1
    """The result can be used, but part of it is missing, doubtful or needs a look."""
    ERROR = 2
    """The result should not be used."""


@dataclass(frozen=True)
class Finding:
    """One thing that was found out about a result or an input.

    code      a stable name such as "wand-few-frames"; docs/findings.md gives the cause and the mend of each
    severity  how much it speaks against the result
    where     the file, camera, marker or frames concerned; empty where it is the whole result
    sentence  what was found, for a person; it names what `where` names
    mend      what to do about it; empty where nothing can be done
    """

    code: str
    severity: Severity
    where: str
    sentence: str
    mend: str = ""

    def __str__(self) -> str:
        """The sentence, and the mend behind it."""
        return f"{self.sentence} {self.mend}".rstrip()

    def to_dict(self) -> dict[str, str]:
        """Plain values, as JSON keeps them; the severity by its name in small letters."""
        return {
            "code": self.code,
            "severity": self.severity.name.lower(),
            "where": self.where,
            "sentence": self.sentence,
            "mend": self.mend,
        }

    @classmethod
    def from_dict(cls, values: Mapping[str, str]) -> Finding:
        """The finding of which `to_dict` gave these values. Raises KeyError where one is missing or the severity is unknown."""
        severity = Severity[values["severity"].upper()]
        return cls(values["code"], severity, values["where"], values["sentence"], values["mend"])


def worst(findings: Iterable[Finding]) -> Severity:
    """The highest severity among findings; a note where there are none."""
    return max((finding.severity for finding in findings), default=Severity.NOTE)


def exit_status(findings: Iterable[Finding]) -> int:
    """The exit status of a command that has done its work: 1 where a warning or an error was found, else 0.

    >>> late = Finding("wand-few-frames", Severity.WARNING, "camera 3", "camera 3 saw the wand in 40 frames.", "Wave it there, too.")
    >>> exit_status([late]), exit_status([]), str(late)
    (1, 0, 'camera 3 saw the wand in 40 frames. Wave it there, too.')
    """
    return int(worst(findings) > Severity.NOTE)
