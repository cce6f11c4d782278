"""A recording of somebody who walks in; events, cycles, parameters and clinical angles over the cycles out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from asterism.errors import AsterismError
from asterism.findings import Finding, Severity
from asterism.gait.cycles import POINTS, Cycle, cycles_of, over_cycle
from asterism.gait.emg import EmgChannel, emg_of
from asterism.gait.events import SIDE_NAMES, Walking, find_events, plate_contacts
from asterism.gait.fills import angles_with_fills, drawn_fills, events_with_fills
from asterism.gait.intervals import AngleBand, angle_bands
from asterism.gait.parameters import Parameter, parameters_of
from asterism.gait.plausibility import rate_finding
from asterism.gait.said import walking_as_said
from asterism.motion.clinical import (
    ClinicalAngles,
    Kinetics,
    SubjectMeasures,
    clinical_angles,
    exchanged_finding,
    inverse_dynamics,
)
from asterism.motion.clinical.kinetics import GRAVITY
from asterism.recording import Floats, ForcePlate, Recording, filled_samples

CURVES = ("Pelvis", "Hip", "Knee", "Ankle", "FootProgress", "Thorax", "Spine", "Head", "Neck", "Shoulder", "Elbow", "Wrist")
"""Quantities whose angles are drawn over the cycle, by Plug-in-Gait's names."""


@dataclass(frozen=True)
class GaitAnalysis:
    """What is known of one recording.

    walking     its events; cycles, whole ones; parameters of each cycle
    clinical    angles over time; None where no leg has its markers
    curves      name such as "LKneeAngles" -> (cycles of that side, 101, 3) rad
    findings    what to know before using it
    kinetics    moments and powers over time; None where no foot is alone on a plate
    loads       name such as "LKneeMoment" or "LKneePower" -> (cycles of that side whose forces are known, 101, 3 or 1)
    loaded      the same names -> these cycles
    fill_sigmas as `curves`, rad: the standard deviation that filled samples add; 0 where none takes part, empty where nothing was filled
    emg         the muscles that the file holds, with their envelopes over the cycles
    plates      the force plates that were given
    """

    recording: Recording
    walking: Walking
    cycles: tuple[Cycle, ...]
    parameters: tuple[Parameter, ...]
    clinical: ClinicalAngles | None
    curves: Mapping[str, Floats]
    findings: tuple[Finding, ...]
    kinetics: Kinetics | None = None
    loads: Mapping[str, Floats] = field(default_factory=dict)
    loaded: Mapping[str, tuple[Cycle, ...]] = field(default_factory=dict)
    fill_sigmas: Mapping[str, Floats] = field(default_factory=dict)
    emg: tuple[EmgChannel, ...] = ()
    plates: tuple[ForcePlate, ...] = ()

    @cached_property
    def load_sigmas(self) -> Mapping[str, Floats]:
        """As `loads`, of moments and powers: the standard uncertainty of each cycle's curve (`KineticErrors`). Cycles share most of it."""
        if self.kinetics is None:
            return {}
        rate, sigmas = self.recording.rate, self.kinetics.sigmas
        known = {name: values.reshape(len(values), -1) for name, values in sigmas.items() if name in self.loaded}
        return {name: np.stack([over_cycle(values, rate, cycle) for cycle in self.loaded[name]]) for name, values in known.items()}

    @cached_property
    def bands(self) -> Mapping[str, AngleBand]:
        """95 % bands of the angles, see `angle_bands`, of the cycles that count; computed when they are first asked for."""
        return angle_bands(analyses_without_turns([self])[0])

    @cached_property
    def straight(self) -> GaitAnalysis:
        """The same with the cycles alone in which the person does not turn."""
        if not any(cycle.turns for cycle in self.cycles):
            return self
        kept = {side: np.array([not cycle.turns for cycle in self.cycles if cycle.side == side], dtype=bool) for side in "LR"}

        def some(curves: Mapping[str, Floats]) -> dict[str, Floats]:
            return {name: values[kept[name[0]]] for name, values in curves.items() if kept[name[0]].any()}

        steps = {name: [not cycle.turns for cycle in cycles] for name, cycles in self.loaded.items()}
        return replace(
            self,
            cycles=tuple(cycle for cycle in self.cycles if not cycle.turns),
            parameters=tuple(one for one in self.parameters if not one.turns),
            curves=some(self.curves),
            fill_sigmas=some(self.fill_sigmas),
            loads={name: values[np.array(steps[name])] for name, values in self.loads.items() if any(steps[name])},
            loaded={name: tuple(one for one in cycles if not one.turns) for name, cycles in self.loaded.items() if any(steps[name])},
            emg=tuple(replace(channel, cycles=some(channel.cycles)) for channel in self.emg),
        )


def analyses_without_turns(analyses: Sequence[GaitAnalysis]) -> list[GaitAnalysis]:
    """Walks that go into one mean, each with the cycles that count in it (`without_turns`)."""
    if not any(not cycle.turns for one in analyses for cycle in one.cycles):
        return list(analyses)
    return [one.straight for one in analyses]


def analyse_gait(
    recording: Recording,
    plates: Sequence[ForcePlate] = (),
    measures: SubjectMeasures | None = None,
    *,
    static: Recording | None = None,
    model: str | None = None,
) -> GaitAnalysis:
    """Events, cycles, parameters and clinical angles of a recording.

    plates    of the recording (`asterism.formats.force_plates`): they tell events to milliseconds, and moments and powers of the joints
    measures  of the person, such as `gathered_measures` gives; by default those of the recording's file
    static    a standing trial, and model of the lower body, see `clinical_angles`

    Strikes and offs that a person set, as the recording's log says, are taken in place of those that are found.
    Samples that the recording's log calls filled make events and angles less certain, as far as these depend on them.
    What can be computed is: without the markers of a body's model there are parameters and no angles, without a whole cycle events alone.
    Raises AsterismError where feet or pelvis have no markers. O(T).

    >>> from asterism.simulation import simulate_walks
    >>> walk = simulate_walks(1, frames=300, markers="helen-hayes", seed=0)[0]
    >>> analyse_gait(walk).curves["LKneeAngles"].shape[1:]
    (101, 3)
    """
    walking = find_events(recording, plates)
    deviation = filled_samples(recording)
    draws = list(drawn_fills(recording, deviation)) if np.isfinite(deviation).any() else []
    if draws:
        walking = events_with_fills(walking, draws, lambda draw: find_events(draw, plates))
    walking = walking_as_said(recording, walking)
    cycles = tuple(cycles_of(walking))
    file, found = str(recording.metadata.get("file", "the recording")), exchanged_finding(recording)
    if walking.backwards and not walking.events:
        sentence = f"{file}: the person goes where the heels point, so that no events are given; they are told of people who walk forwards."
        mend = "Look whether heels and toes carry each other's names, or the time runs backwards; a walk backwards has no events here."
        found.append(Finding("gait-backwards", Severity.WARNING, file, sentence, mend))
    elif not cycles:
        found.append(
            Finding(
                "gait-no-cycle",
                Severity.WARNING,
                file,
                f"{file} shows no whole gait cycle: {len(walking.events)} strikes and offs, but no strike, off and strike of one foot.",
                "Record more steps, or give a longer part of the recording.",
            )
        )
    if walking.feet.ankles and walking.events:
        sides = " and ".join(SIDE_NAMES[side].lower() for side in sorted(walking.feet.ankles))
        sentence = f"{file} has no marker of the {sides} heel: strikes are told by the ankle, and less certain."
        found.append(Finding("gait-no-heel", Severity.NOTE, file, sentence, "Put a marker on the heel, or name it (LHEE, RHEE)."))
    if turning := [cycle for cycle in cycles if cycle.turns]:
        some = len(turning) < len(cycles)
        found.append(
            Finding(
                "gait-turning",
                Severity.NOTE,
                file,
                f"{file}: in {len(turning)} of {len(cycles)} cycles the person turns: pelvic rotation, foot progression, and the "
                "width and length of steps are not those of a walk straight ahead. "
                + (
                    "These cycles are shown, and are in no mean or score."
                    if some
                    else "No other cycle is there: means and scores are of turns."
                ),
                "Nothing, where the others are enough." if some else "Leave the recording out of a report on walking straight ahead.",
            )
        )
    parameters = tuple(parameters_of(walking, cycles))
    if doubt := rate_finding(file, recording.rate, walking, parameters):
        found.append(doubt)
    clinical = None
    try:
        clinical = clinical_angles(recording, measures=measures, static=static, model=model)
        found += clinical.findings
    except AsterismError as problem:
        found.append(
            Finding(
                "gait-no-angles",
                Severity.NOTE,
                file,
                f"There are parameters and no angles: {problem}",
                "Label the recording with a set that has THI, KNE, TIB and ANK, or both sides of knee and ankle.",
            )
        )
    outputs = {} if clinical is None else clinical.outputs
    # An angle near half a turn must not jump by a whole one within a cycle.
    curves = {name: np.unwrap(curve, axis=1) for name, curve in _curves(outputs, recording.rate, cycles).items()}
    fill_sigmas: dict[str, Floats] = {}
    if clinical is not None and draws:
        spread = angles_with_fills(outputs, draws, clinical.model.outputs)
        fill_sigmas = _curves(spread, recording.rate, cycles)
    kinetics = None
    if clinical is not None and clinical.joints and plates:
        try:
            kinetics = _kinetics(recording, walking, plates, clinical)
        except AsterismError as problem:
            found.append(
                Finding("kinetics-plates", Severity.WARNING, file, f"{file}: no moments and powers: {problem}", "Export it again.")
            )
    loads, loaded = ({}, {}) if kinetics is None else _loads(recording, cycles, kinetics)
    found += () if kinetics is None else kinetics.findings
    if kinetics is not None and kinetics.per_kg and clinical is not None:
        found += _other_mass(file, loads, clinical.subject.mass or 0.0)
    muscles, told = emg_of(recording, cycles)
    found += told
    return GaitAnalysis(
        recording, walking, cycles, parameters, clinical, curves, tuple(found), kinetics, loads, loaded, fill_sigmas, muscles, tuple(plates)
    )


def _curves(values: Mapping[str, Floats], rate: float, cycles: Sequence[Cycle]) -> dict[str, Floats]:
    """Of what is drawn over the cycle: (cycles of that side, 101, 3)."""
    found = {}
    for name, angles in values.items():
        own = [over_cycle(angles, rate, cycle) for cycle in cycles if cycle.side == name[0]]
        if own and name[1:].removesuffix("Angles") in CURVES:
            found[name] = np.stack(own)
    return found


_KNOWN = 0.9
"""Of a stance, points at which moments are known: strike and off are told to a hundredth. At half, half a stance passes for one."""
_SAME_MASS = 0.15
"""Of the mass: the nearest cycle is within 0.07 on 40 walks of 22 people, and 0.18 and 0.19 off on both of one whose mass is wrong. At
half, a turn on the plate is told; at double, a mass that is a quarter wrong is not."""


def _kinetics(recording: Recording, walking: Walking, plates: Sequence[ForcePlate], clinical: ClinicalAngles) -> Kinetics | None:
    """Moments and powers of the legs that have angles; None where nobody is on a plate."""
    contacts = plate_contacts(recording, walking.feet, plates)
    if not contacts:
        return None
    sides = "".join(side[0].upper() for side in clinical.measures)
    body = clinical.model.body(recording)
    body = replace(body, legs={side: body.legs[side] for side in sides})
    swings = {side: walking.swings(side) for side in sides}
    return inverse_dynamics(clinical.model.with_feet_named(recording), body, plates, contacts, swings, clinical.subject)


def _other_mass(file: str, loads: Mapping[str, Floats], mass: float) -> list[Finding]:
    """Where the plates carry another weight than the given one.

    Over a cycle of even walking or running the ground bears the whole weight, half of it under each foot. The cycle that comes nearest
    decides, since who turns or brakes puts more on one foot; the median is named.
    """
    borne = [
        2.0 * np.nanmean(curve[:, 2]) / -GRAVITY[2]
        for name, curves in loads.items()
        if name.endswith("GroundReactionForce")
        for curve in curves
        if np.isfinite(curve[:, 2]).mean() >= _KNOWN
    ]
    if not borne:
        return []
    nearest = min(borne, key=lambda share: abs(float(np.log(share))) if share > 0.0 else np.inf)
    if abs(nearest - 1.0) <= _SAME_MASS:
        return []
    sentence = f"{file}: the person's mass is given as {mass:.0f} kg, and the force plates carry about {np.median(borne) * mass:.0f} kg; "
    sentence += "moments and powers are divided by the mass that is given."
    mend = "Weigh the person, or look for an error in the scale of the plates; give --measure BodyMass=KG."
    return [Finding("kinetics-mass-differs", Severity.WARNING, file, sentence, mend)]


def _loads(recording: Recording, cycles: Sequence[Cycle], kinetics: Kinetics) -> tuple[dict[str, Floats], dict[str, tuple[Cycle, ...]]]:
    """Over the cycles of whose stance the forces are known, and which these are."""
    loads, loaded = {}, {}
    powers = {name: power[:, None] for name, power in kinetics.powers.items()}
    for name, values in {**kinetics.moments, **powers, **kinetics.ground}.items():
        known = []
        for cycle in cycles:
            if cycle.side != name[0]:
                continue
            curve = over_cycle(values, recording.rate, cycle)
            if np.isfinite(curve[: max(int(POINTS * cycle.off_share), 1)]).all(axis=1).mean() >= _KNOWN:
                known.append((cycle, curve))
        if known:
            loads[name], loaded[name] = np.stack([curve for _, curve in known]), tuple(cycle for cycle, _ in known)
    return loads, loaded
