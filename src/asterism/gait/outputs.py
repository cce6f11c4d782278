"""An analysed walk in; a copy of its C3D file with angles, moments, powers, events and parameters, as gait programs read them, out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from asterism.gait.analysis import GaitAnalysis
from asterism.gait.cycles import midstances
from asterism.gait.events import SIDE_NAMES
from asterism.gait.parameters import Parameter, summarise
from asterism.geometry import z_up_rotation
from asterism.motion.clinical.plug_in_gait import walking_axes
from asterism.recording import Floats, ProcessingStep, Recording, filled_samples
from asterism.recording.display import significant

if TYPE_CHECKING:
    from asterism.formats import AnalysisValue, ModelPoint
    from asterism.motion.clinical import SubjectMeasures

ANALYSIS = {
    "cadence": ("Cadence", "steps/min"),
    "walking speed": ("Walking Speed", "m/s"),
    "stride time": ("Stride Time", "s"),
    "step time": ("Step Time", "s"),
    "opposite foot off": ("Opposite Foot Off", "%"),
    "opposite foot contact": ("Opposite Foot Contact", "%"),
    "stance": ("Foot Off", "%"),
    "single support": ("Single Support", "s"),
    "double support": ("Double Support", "s"),
    "stride length": ("Stride Length", "m"),
    "step length": ("Step Length", "m"),
    "step width": ("Step Width", "m"),
    "limp index": ("Limp Index", ""),
}
"""Gait parameters by the names and units of the group ANALYSIS, in its order."""
_SHARES = ("single support", "double support")
"""Of the cycle here, in seconds there."""
_ACTION = "modelled"
_PELVIS = ("LASI", "RASI", "SACR", "LPSI", "RPSI")
_TRUNK = ("CLAV", "C7", "STRN", "T10")


def write_gait_c3d(path: str | Path, analysis: GaitAnalysis) -> list[str]:
    """Write a copy of the recording with what was found, whole or not at all; a file at `path` is replaced.

    Points by Plug-in-Gait's names are in the lists ANGLES, MOMENTS, POWERS, FORCES and MODELED_MARKERS of the group POINT; strikes, offs
    and midstances in the group EVENT; parameters, the mean over the cycles of each side, in the group ANALYSIS. What the file had under the
    same name is replaced; everything else stays. Written again from its own output, the file is the same. O(T).

    Returns what a reader of the file must know. Raises AsterismError where the file cannot be written.
    """
    from asterism.formats import write_model_outputs

    return write_model_outputs(Path(path), recorded(analysis), model_points(analysis), analysis_values(analysis))


def recorded(analysis: GaitAnalysis) -> Recording:
    """The recording with the events that were found, and with a step in its log that says with which measures its outputs were computed.

    Events of the same name and side are replaced, see `Recording.with_found`.
    """
    recording = analysis.recording
    walking = analysis.walking
    found = replace(walking, events=(*walking.events, *midstances(walking))).to_events(recording)
    log = tuple(step for step in recording.log if step.action != _ACTION)
    if analysis.clinical is not None:
        log = (*log, ProcessingStep(_ACTION, "Asterism", _settings(analysis.clinical.subject)))
    return replace(recording.with_found(found), log=log)


def _settings(measures: SubjectMeasures) -> Mapping[str, object]:
    """The measures that count, mm and degrees."""
    settings: dict[str, object] = {"marker_radius_mm": round(1000 * measures.marker_radius, 3)}
    if measures.mass is not None:
        settings["mass_kg"] = round(measures.mass, 3)
    for side in SIDE_NAMES:
        leg = measures.of(side)
        for name in ("leg_length", "knee_width", "ankle_width"):
            if (length := getattr(leg, name)) is not None:
                settings[f"{side}_{name}_mm"] = round(1000 * length, 2)
        for name in ("thigh_rotation", "shank_rotation", "tibial_torsion", "foot_flexion", "foot_rotation"):
            settings[f"{side}_{name}_deg"] = round(float(np.degrees(getattr(leg, name))), 3)
    return settings


def model_points(analysis: GaitAnalysis) -> list[ModelPoint]:
    """Angles, joint centres, and where the person's mass is known moments, powers and the ground's force, of a recording.

    Powers are the third number, as Plug-in-Gait has them; the ground's force is in the axes of the recording, and on the foot.
    """
    from asterism.formats import ModelPoint

    if analysis.clinical is None:
        return []
    recording = analysis.recording
    body = analysis.clinical.model.body(recording)
    # From axes with z up, in which everything here is, to those of the file.
    to_file = np.eye(3) if recording.vertical[2] == 1.0 else z_up_rotation(recording.vertical)
    filled = filled_samples(recording)

    def point(name: str, kind: str, values: Floats) -> ModelPoint:
        behind = [label in (*_PELVIS, *_TRUNK) or label.startswith(name[0]) for label in recording.labels]
        return ModelPoint(name, kind, values, np.fmax.reduce(filled[:, behind], axis=1, initial=np.nan))

    points = [point(name, "ANGLES", values) for name, values in analysis.clinical.outputs.items()]
    kinetics = analysis.kinetics
    # Gait programs take these for values per kg, which they are not without the mass.
    if kinetics is not None and kinetics.per_kg:
        room = walking_axes(body)
        points += [point(name, "FORCES", values @ room.T @ to_file) for name, values in kinetics.ground.items()]
        points += [point(name, "MOMENTS", values) for name, values in kinetics.moments.items()]
        for name, power in kinetics.powers.items():
            points.append(point(name, "POWERS", power[:, None] * np.array([0.0, 0.0, 1.0])))
    for side, leg in body.legs.items():
        for joint, centre in (("HJC", leg.hip), ("KJC", leg.knee), ("AJC", leg.ankle)):
            # A column of the recording with this name is somebody's marker.
            if side + joint not in recording.labels:
                points.append(point(side + joint, "MODELED_MARKERS", centre @ to_file))
    return points


def analysis_values(analysis: GaitAnalysis) -> list[AnalysisValue]:
    """The parameters of each side, mean over its cycles, as the group ANALYSIS has them; how certain they are is in their descriptions."""
    from asterism.formats import AnalysisValue

    summaries = {(one.name, one.side): one for one in summarise(_in_seconds(analysis.parameters))}
    found = []
    for side, context in SIDE_NAMES.items():
        for parameter, (name, unit) in ANALYSIS.items():
            if (one := summaries.get((parameter, side))) is None:
                continue
            spread = f", SD {significant(one.deviation, 3)}" if np.isfinite(one.deviation) else ""
            cycles = f"{one.count} cycle{'s' if one.count > 1 else ''}"
            found.append(AnalysisValue(name, context, one.mean, unit, f"+- {significant(one.sigma, 2)}, mean of {cycles}{spread}"))
    return found


def _in_seconds(parameters: Sequence[Parameter]) -> list[Parameter]:
    """Single and double support as times."""
    times = {(one.side, one.begins): one.value for one in parameters if one.name == "stride time"}
    shares = {one: times[one.side, one.begins] / 100 for one in parameters if one.name in _SHARES}
    return [replace(one, value=one.value * shares[one], sigma=one.sigma * shares[one]) if one in shares else one for one in parameters]
