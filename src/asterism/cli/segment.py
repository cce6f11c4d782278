"""`asterism segment`: recordings of points in; which points move together as one limb, out."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from asterism.cli import _console
from asterism.cli._command import takes
from asterism.cli._options import Files, Json, Overwrite, Report, Vertical
from asterism.errors import AsterismError

if TYPE_CHECKING:
    from asterism.motion.segmentation import Segmentation
    from asterism.recording import Recording


class SegmentMethod(StrEnum):
    """How limbs are found."""

    RIGIDITY = "lsa+rigidity"
    LSA = "lsa"


LimbCount = Annotated[
    int | None, typer.Option("--limbs", metavar="N", min=1, help="How many limbs there are. Else found out.", show_default=False)
]


@dataclass(frozen=True)
class SegmentOptions:
    """What `asterism segment` is asked to do."""

    files: Files
    limbs: LimbCount = None
    method: Annotated[
        SegmentMethod, typer.Option("--method", help="Local subspace affinity refined by rigidity, or alone as GaMoCap has it.")
    ] = SegmentMethod.RIGIDITY
    vertical: Vertical = None
    overwrite: Overwrite = False
    report: Report = None
    json: Json = None


@takes(SegmentOptions)
def segment(options: SegmentOptions) -> None:
    """Find the limbs that points move with.

    From the points' trajectories alone: no marker set, no body model. Points with gaps count where they are seen. The same file always
    gives the same limbs. Physical points are used, with or without a name.
    """
    from asterism.cli._folders import recordings_of
    from asterism.motion.segmentation import segment_limbs

    _console.check_outputs([options.report, options.json], options.files, options.overwrite)
    batch = _console.Batch("segmented")
    results: list[tuple[Path, Recording, Segmentation]] = []
    for path in recordings_of(options.files, batch):
        with batch.file(path):
            recording = read_points(path, options.vertical, batch)
            with _console.progress("segmenting") as progress:
                # by motion alone: labels may be missing or wrong
                found = segment_limbs(recording.positions, options.limbs, method=options.method.value, progress=progress)
            for fewer in found.fewer_than(options.limbs, str(path)):
                batch.found(fewer)
            results.append((path, recording, found))
            if options.json != "-":
                show(path, recording, found)
    if not results:
        raise typer.Exit(batch.close())
    if options.report is not None:
        from asterism.recording.display import short_names
        from asterism.report.motion import segmentation_report

        names = short_names([path for path, _, _ in results])
        segmentation_report(options.report, [(name, recording, found) for name, (_, recording, found) in zip(names, results, strict=True)])
    _console.write_json(
        options.json,
        {
            "command": "segment",
            "files": [{"file": path, **as_dict(recording, found)} for path, recording, found in results],
            "failed": batch.failed,
            "findings": [finding.to_dict() for finding in batch.findings],
        },
    )
    raise typer.Exit(batch.close())


def read_points(path: Path, vertical: str | None, batch: _console.Batch) -> Recording:
    """A file's physical points; its warnings are told. Raises AsterismError where it has none."""
    from asterism import formats
    from asterism.cli._options import vertical_axis
    from asterism.cli._recordings import report_warnings

    recording = formats.read(path, vertical=vertical_axis(vertical))
    report_warnings(recording, batch)
    # a column that is named and never seen says nothing of a limb
    if not recording.visible.any():
        raise AsterismError(f"{path} has no point that is ever seen; check what it holds with `asterism info`.")
    return recording


def as_dict(recording: Recording, found: Segmentation) -> dict[str, Any]:
    """The limbs as JSON has them."""
    return {
        "frames": len(recording),
        "limbs": [{"name": f"limb {k + 1}", "points": [recording.labels[n] for n in found.points(k)]} for k in range(found.limbs)],
        "unseen": [recording.labels[n] for n in found.points(-1)],
        "method": found.method,
    }


def show(path: Path, recording: Recording, found: Segmentation) -> None:
    """Print a table of the limbs of one file."""
    import numpy as np

    from asterism.recording.display import counted

    rows = []
    for limb in range(found.limbs):
        points = found.points(limb)
        stray = found.stray[points, limb]
        # a point that never shows beside its limb has no distance to stray from
        known = stray[np.isfinite(stray)]
        names = ", ".join(recording.labels[n] for n in points[:8]) + (", ..." if len(points) > 8 else "")
        typical = f"{1000 * float(np.median(known)):.1f}" if len(known) else "–"
        rows.append([f"limb {limb + 1}", names, str(len(points)), typical])
    _console.table(f"{path}: {counted(found.limbs, 'limb')}", ["", "points", "number", "stray (mm)"], rows, left=2)
