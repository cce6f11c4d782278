"""The clinical angles of `asterism motion`: whether to compute them, as a table, as JSON."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from asterism.cli import _console

if TYPE_CHECKING:
    from asterism.motion.clinical import ClinicalAngles
    from asterism.recording import Recording


def find(recording: Recording, wanted: bool | None) -> ClinicalAngles | None:
    """The clinical angles; where they are not asked for (None), only those of legs with all markers.

    Raises AsterismError where they are asked for and neither leg has all markers.
    """
    from asterism.motion.clinical import clinical_angles, complete_legs

    if wanted is False or (wanted is None and not complete_legs(recording)):
        return None
    return clinical_angles(recording)


def show(path: Path, clinical: ClinicalAngles | None) -> None:
    """Print a table of the joints: the least and the largest of each angle."""
    import numpy as np

    from asterism.motion.clinical import CLINICAL

    if clinical is None:
        return

    def span(values: Any) -> str:
        known = np.degrees(values[np.isfinite(values)])
        return f"{known.min():.1f} to {known.max():.1f}" if len(known) else "–"

    rows = [[joint.name, *(span(joint.angles[:, k]) for k in range(3))] for joint in clinical.joints]
    _console.table(f"{path}: clinical angles", ["joint", *(f"{name} (°)" for name in CLINICAL)], rows)
    if assumed := [side for side, measures in clinical.measures.items() if not measures.from_file]:
        sides = " and ".join(assumed)
        _console.result(f"The file has no measures of the {sides} leg; an adult's widths of knee and ankle were taken.")


def as_dict(clinical: ClinicalAngles | None) -> dict[str, Any]:
    """The angles as JSON has them, degrees; nothing where there are none."""
    import dataclasses

    import numpy as np

    from asterism.motion.clinical import CLINICAL

    if clinical is None:
        return {}
    joints = [
        {"joint": joint.joint, "side": joint.side, **{f"{name}_deg": np.degrees(joint.angles[:, k]) for k, name in enumerate(CLINICAL)}}
        for joint in clinical.joints
    ]
    return {"clinical": {"joints": joints, "measures": {side: dataclasses.asdict(one) for side, one in clinical.measures.items()}}}
