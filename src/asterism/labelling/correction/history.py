"""What a person says, one after the other, in; what counts, what can be taken back or again, and a log that follows it, out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Generic, Protocol, TypeVar

from asterism.errors import AsterismError
from asterism.labelling.correction.event_log import REDO, RELABELLED, SAVED, UNDO, CorrectionLog, damaged_line


class _Said(Protocol):
    def to_plain(self) -> Mapping[str, Any]:
        """As a log has it."""


Said = TypeVar("Said", bound=_Said)


class History(Generic[Said]):
    """What was said and not taken back, and what was taken back; `undo` and `redo` of whoever has it have no end."""

    def __init__(self) -> None:
        """Begin with nothing said, and without a log."""
        self._done: list[Said] = []
        self._undone: list[Said] = []
        self._log: CorrectionLog | None = None

    @property
    def touches(self) -> tuple[Said, ...]:
        """What was said and not taken back, in its order."""
        return tuple(self._done)

    @property
    def can_undo(self) -> bool:
        """Whether there is something to take back."""
        return bool(self._done)

    @property
    def can_redo(self) -> bool:
        """Whether something was taken back last."""
        return bool(self._undone)

    def close(self) -> None:
        """Close the log."""
        if self._log is not None:
            self._log.close()
            self._log = None

    def _last_done(self) -> Said:
        """What `undo` takes back. Raises AsterismError where there is nothing."""
        if not self._done:
            raise AsterismError("there is nothing to take back.")
        return self._done[-1]

    def _last_undone(self) -> Said:
        """What `redo` takes again. Raises AsterismError where there is nothing."""
        if not self._undone:
            raise AsterismError("there is nothing to take again.")
        return self._undone[-1]

    def _add(self, *said: Said) -> None:
        # Written before it counts: what is not in the log did not happen. A new answer ends what could be taken again.
        self._write(*(one.to_plain() for one in said))
        self._done += said
        self._undone.clear()

    def _take_back(self) -> None:
        self._write({"kind": UNDO})
        self._undone.append(self._done.pop())

    def _take_again(self) -> None:
        self._write({"kind": REDO})
        self._done.append(self._undone.pop())

    def _write(self, *entries: Mapping[str, Any]) -> None:
        if self._log is not None:
            self._log.append(*entries)

    @staticmethod
    def _replayed(log: CorrectionLog, read: Callable[[Mapping[str, Any]], Said]) -> tuple[list[Said], list[Said]]:
        """What a log leaves as said, and as taken back. Raises AsterismError, naming the line, where an entry cannot be read."""
        done, undone = list[Said](), list[Said]()
        for number, entry in zip(log.lines, log.entries, strict=True):
            try:
                if entry["kind"] == UNDO:
                    undone.append(done.pop())
                elif entry["kind"] == REDO:
                    done.append(undone.pop())
                # Saving, and which model labels, are kept for the record: neither is an answer.
                elif entry["kind"] not in (SAVED, RELABELLED):
                    done.append(read(entry))
                    undone.clear()
            except (KeyError, TypeError, ValueError, IndexError, OverflowError, AsterismError) as problem:
                raise damaged_line(log.path, number) from problem
        return done, undone
