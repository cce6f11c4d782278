"""How test files are shared among workers: those on labelling from one end, those on cameras from the other.

Where nothing is compiled yet, most of the time goes into Numba. Two workers that begin with the same room compile the same kernels twice;
begun at the two ends, each finds in the compile cache what the other has compiled when they meet. Files that need no kernels lie in the
middle and fill what is left.
"""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from xdist.scheduler import LoadFileScheduling
from xdist.workermanage import WorkerController

_CAMERAS = re.compile(r"asterism\.(?:cameras|calibration|detection|reconstruction|simulation\.(?:cameras|chain|session)|synchronization)\b")
_LABELLING = re.compile(r"asterism\.(?:cli|labelling|motion|tracking)\b|MarkerModel|models import")


def place(path: Path) -> tuple[int, str]:
    """Where a test file stands in the row: large ones on labelling first, large ones on cameras last."""
    text = path.read_text(encoding="utf-8")
    side = 1 if _CAMERAS.search(text) else -1 if _LABELLING.search(text) else 0
    return side * len(text), path.name


def in_row(items: list[pytest.Item]) -> list[pytest.Item]:
    """The tests in the order of their files in the row; in a file as they stand."""
    places = {path: place(path) for path in {item.path for item in items}}
    return sorted(items, key=lambda item: places[item.path])


class FromBothEnds(LoadFileScheduling):
    """Whole files go to the workers: every other worker takes from the end of the row."""

    def _assign_work_unit(self, node: WorkerController) -> None:
        if self.nodes.index(node) % 2:
            self.workqueue.move_to_end(next(reversed(self.workqueue)), last=False)
        super()._assign_work_unit(node)
