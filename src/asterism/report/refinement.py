"""A refinement in; out comes a page that says which camera was moved, and by how much."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from asterism.report.page import NOTHING, Cell, Page, Section, Table, decimal, percent, write_page
from asterism.report.space import rig_in_space

if TYPE_CHECKING:
    from asterism.calibration import Refinement

_TINTS = {"good": 0.0, "moved": 0.6, "out of step": 0.6, "lost": 1.0, "unknown": 0.3}


def refinement_report(path: str | Path, refinement: Refinement, *, settings: Mapping[str, Any] | None = None) -> None:
    """Write an HTML page on a refinement; `settings` are named at its foot. Raises AsterismError where the file cannot be written."""
    # By state, not by size: a camera out of step moves little and is wrong all the same.
    states = [check.state for check in refinement.cameras]
    rows: list[list[str | Cell]] = [
        [
            check.name,
            Cell(check.state, _TINTS[check.state], "bad" if check.state == "lost" else "warn"),
            decimal(check.moved_px, 2),
            decimal(check.rms_px, 2),
            decimal(math.degrees(check.turned), 3),
            decimal(1000 * check.shifted, 1),
            decimal(100 * check.zoomed, 2),
            percent(check.shown) if math.isfinite(check.shown) else NOTHING,
        ]
        for check in refinement.cameras
    ]
    head = ["camera", "state", "view moved by, px", "error now, px", "turned, degrees", "shifted, mm", "zoomed, %"]
    head += ["of the others' points shown"]
    lead = " ".join(f"{sentence[0].upper()}{sentence[1:]}" for sentence in map(str, refinement.findings)) or "No camera was moved."
    merits = [
        (str(states.count("moved")), "cameras moved, with new poses", "warn" if "moved" in states else "good"),
        (str(states.count("lost")), "cameras lost", "bad" if "lost" in states else ""),
        (f"{refinement.noise:.2f} px", "noise of the blobs", ""),
        (str(refinement.frames), "frames used", ""),
    ]
    sections = [
        Section(
            "Each camera",
            "By how much its view of what the others see has moved, and what is left with the refined rig. Markers hidden from a camera "
            "are not shown by it; that is no fault.",
            table=Table(head, rows, left=2),
        ),
        Section("The refined rig", figure=rig_in_space(refinement.rig)),
    ]
    write_page(path, Page("Was a camera moved?", lead, settings or {}, merits, sections))
