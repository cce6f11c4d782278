"""The clinical angles of `asterism motion`: whether to compute them, how certain they are, as tables, as columns, as JSON."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypedDict

from asterism.cli import _console
from asterism.errors import AsterismError

if TYPE_CHECKING:
    from asterism.findings import Finding
    from asterism.motion.clinical import (
        ClinicalAngles,
        ClinicalErrors,
        ClinicalJoint,
        ClinicalUncertainty,
        JointUncertainty,
        StaticRules,
        SubjectMeasures,
    )
    from asterism.motion.uncertainty import MonteCarloRules
    from asterism.recording import Floats, Recording


def measure_files(words: list[str]) -> list[Path]:
    """The words of --measure that are files."""
    return [Path(word) for word in words if "=" not in word or Path(word).is_file()]


def given_measures(words: list[str]) -> tuple[dict[str, float], list[Path]]:
    """The measures that --measure names, and the files of measures that it gives.

    Raises AsterismError where a word is neither, or a file holds none.
    """
    from asterism.motion.clinical import SubjectMeasures
    from asterism.motion.clinical.measure_files import measures_by_name, read_measures

    files = measure_files(words)
    for file in files:
        if not file.suffix:
            raise AsterismError(f"--measure {file} is neither a name with its value, such as LKneeWidth=102, nor a file of measures.")
        read_measures(file)
    named = measures_by_name([word for word in words if Path(word) not in files])
    SubjectMeasures().with_values(named)
    return named, files


def measures_of(
    recording: Recording, static: Recording | None, words: list[str], hip: str | None = None, rules: StaticRules | None = None
) -> tuple[SubjectMeasures | None, tuple[Finding, ...]]:
    """The measures of the recording's person, by the words of --measure and the standing trial; None where neither is given."""
    from asterism.motion.clinical import gathered_measures
    from asterism.motion.clinical.measure_files import measures_of_person

    if static is None and not words and hip is None:
        return None, ()
    named, files = given_measures(words)
    given: dict[str, float] = {}
    for file in files:
        given |= measures_of_person(file, recording)
    measures, found = gathered_measures(recording, static, given | named, rules)
    return replace(measures, hip_regression=None if hip is None else str(hip)), found


def find(
    recording: Recording,
    wanted: bool | None,
    measures: SubjectMeasures | None = None,
    static: Recording | None = None,
    model: str | None = None,
) -> ClinicalAngles | None:
    """The clinical angles; where they are not asked for (None), None for a recording without a joint of theirs.

    Raises AsterismError where they are asked for and there is none.
    """
    from asterism.motion.clinical import clinical_angles, complete_legs

    # asked for, a missing marker is an error; not asked for, it is no leg
    try:
        clinical = None if wanted is False else clinical_angles(recording, measures=measures, static=static, model=model)
    except AsterismError:
        if wanted or model is not None:
            raise
        return None
    if clinical is None or wanted or (clinical.joints and (clinical.model.name == "landmarks" or complete_legs(recording))):
        return clinical
    return None


class MonteCarloOptions(TypedDict):
    """How both estimates of uncertainty draw their trials."""

    rules: MonteCarloRules
    budget_trials: int
    workers: int
    progress: Any


def certain(
    recording: Recording, clinical: ClinicalAngles | None, errors: ClinicalErrors, seed: int, trials: MonteCarloOptions
) -> ClinicalUncertainty | None:
    """How certain the angles are."""
    from asterism.motion.clinical import clinical_uncertainty

    if clinical is None or not clinical.joints:
        return None
    if clinical.model.carries(recording):
        file = recording.metadata.get("file", "the recording")
        _console.notice(
            f"{file}: no intervals of angles whose landmarks a standing trial carries; `asterism gait` has those of its cycles."
        )
        return None
    return clinical_uncertainty(recording, clinical, errors, seed=seed, **trials)


def show(path: Path, clinical: ClinicalAngles | None, known: ClinicalUncertainty | None) -> None:
    """Print a table of the joints: the least and the largest of each angle; and one of how uncertain they are."""
    import numpy as np

    from asterism.motion.clinical import CLINICAL
    from asterism.motion.clinical.uncertainty import TRIED_ON

    if clinical is None:
        return

    def span(values: Any) -> str:
        seen = np.degrees(values[np.isfinite(values)])
        return f"{seen.min():.1f} to {seen.max():.1f}" if len(seen) else "–"

    def largest(values: Any) -> str:
        seen = np.degrees(values[np.isfinite(values)])
        return f"{seen.max():.1f}" if len(seen) else "–"

    rows = [[joint.name, *(span(joint.angles[:, k]) for k in range(3))] for joint in clinical.joints]
    _console.table(f"{path}: clinical angles", ["joint", *(f"{name} (°)" for name in CLINICAL)], rows)
    if known is not None:
        # all joints have the same sources
        sources = [source for source in known.joints[0].budget if source != "all"]
        head = ["joint", *(f"{name} ± (°)" for name in CLINICAL), *(f"flexion: {source}" for source in sources)]
        rows = [
            [one.joint.name, *(largest(one.standard[:, k]) for k in range(3)), *(largest(one.budget[source][:, 0]) for source in sources)]
            for one in known.joints
        ]
        _console.table(f"{path}: largest standard uncertainties", head, rows)
        _console.result(TRIED_ON)


def columns(wide: bool) -> list[str]:
    """Names of the columns that a table of angles has for these angles beside flexion, with the ends of 95 % intervals or without."""
    ends = [f"{name}_{end}95_deg" for name in ("adduction", "rotation") for end in ("low", "high")] if wide else []
    return ["adduction_deg", "rotation_deg", *ends]


def values(joint: ClinicalJoint, known: JointUncertainty | None) -> tuple[list[Floats], list[Floats]]:
    """Flexion and, with uncertainty, the ends of its 95 % interval; and what stands in `columns`. All (T,) rad."""
    flexion, *others = joint.angles.T
    if known is None:
        return [flexion], others
    # in the order of the angles, as above
    low, high = (end.T for end in known.intervals[0.95])
    return [flexion, low[0], high[0]], [*others, low[1], high[1], low[2], high[2]]


def as_dict(clinical: ClinicalAngles | None, known: ClinicalUncertainty | None) -> dict[str, Any]:
    """The angles as JSON has them, degrees; nothing where there are none."""
    import dataclasses

    import numpy as np

    from asterism.motion.clinical import CLINICAL
    from asterism.motion.clinical.uncertainty import TRIED_ON

    if clinical is None:
        return {}
    joints = [
        {
            "joint": joint.joint,
            "side": joint.side,
            **{f"{name}_deg": np.degrees(joint.angles[:, k]) for k, name in enumerate(CLINICAL)},
            **(_certain_dict(known.joints[number]) if known is not None else {}),
        }
        for number, joint in enumerate(clinical.joints)
    ]
    trials: dict[str, Any] = {}
    if known is not None:
        trials = {"trials": known.trials, "converged": known.converged, "intervals_tried_on": TRIED_ON}
    measures = {side: dataclasses.asdict(one) for side, one in clinical.measures.items()}
    return {"clinical": {"model": clinical.model.name, "hip": clinical.model.hip, "joints": joints, "measures": measures, **trials}}


def _certain_dict(one: JointUncertainty) -> dict[str, Any]:
    import numpy as np

    from asterism.motion.clinical import CLINICAL

    content: dict[str, Any] = {}
    for k, name in enumerate(CLINICAL):
        content[f"{name}_standard_deg"] = np.degrees(one.standard[:, k])
        content[f"{name}_intervals_deg"] = {
            f"{p:g}": [np.degrees(low[:, k]), np.degrees(high[:, k])] for p, (low, high) in one.intervals.items()
        }
        content[f"{name}_budget_deg"] = {source: np.degrees(part[:, k]) for source, part in one.budget.items()}
    return content
