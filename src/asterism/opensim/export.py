"""Walks, a standing trial and the file of a generic model in; a folder from which OpenSim scales the model and moves it, out."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations, pairwise
from pathlib import Path, PurePath

import numpy as np
from numpy.typing import NDArray

from asterism.errors import AsterismError
from asterism.files.atomic import utf8, write_atomically
from asterism.files.tables import NumberTable
from asterism.findings import Finding, Severity
from asterism.formats import force_plates, write
from asterism.formats.opensim_forces import companions, write_opensim_forces
from asterism.formats.opensim_model import OsimModel
from asterism.gait import analyse_gait
from asterism.geometry import z_up_rotation
from asterism.motion.clinical import ClinicalModel
from asterism.motion.clinical.static import with_knee_markers
from asterism.opensim.documents import MotionTask, ScaleTask, dynamics_setup, kinematics_setup, marker_set, scale_setup
from asterism.opensim.person import CENTRES, SIDES, PersonInTrial, bodies_of, has_leg, person_of, ridden
from asterism.opensim.scaling import BodyScale, PlacedMarker, generic_model, lumbar_share, moved, placed_markers, scale_factors
from asterism.recording import Floats, Recording, is_unnamed, subject_of
from asterism.recording.force_plate import ForcePlate
from asterism.recording.marker_set import without_subject

CUT_OFF = 6.0
"""Hz, of the low-pass filter of coordinates and forces in inverse dynamics, as gait laboratories take it: above it is noise of markers.
Both have the same: forces that are not filtered beside coordinates that are make a hip's peak at heel strike three times as high. At
half, moments of stance are lower by a tenth; at double, noise of accelerations is four times as large."""
_UNKNOWN = 2.0
"""How many times more a marker without a known name moves on every other segment. At 1 any marker sits somewhere, those at a joint by
chance; at 4 markers on a soft thigh sit nowhere."""
_CENTRES = 10.0
"""The weight of joint centres in the standing pose, where a marker has 1: the model's joints shall be the person's, and the markers are
then moved onto it. At half or double the pose stays, because all of them agree to millimetres."""
_APART = 0.05
"""m, between two markers that tell a factor: a marker put down again is 1 mm off, a fiftieth. At half, twice as much; at double, no child's
foot has such a pair."""

GRAVITY = 9.81
"""m/s^2."""
_BOTH_FEET = 0.25
"""Of the way from one ankle to the other, how far the centre of pressure of both is from either, where a person stands on both feet: with a
foot beside the plates it is under the other. At half, a foot that bears an eighth counts; at double, only people who stand evenly."""
_ELSEWHERE = 0.05
"""m RMS, from its place on its segment: skin of a thigh slides by 0.03 m at most. At half, thighs of a run are told; at double, exchanged
names within a cluster are not."""


@dataclass(frozen=True)
class OpenSimTrial:
    """One trial: the recording, and the clinical model by which its legs are known; None where its markers tell no legs."""

    recording: Recording
    clinical: ClinicalModel | None = None


@dataclass(frozen=True)
class OpenSimExport:
    """What was written.

    files     kind -> file: "model", "markers", "scale", "factors"; of the trials, by their names, "walk: markers", "walk: forces", ...
    commands  what to run in the folder, in this order
    scales    of the model's bodies; markers  on the generic model; weights  trial -> marker -> weight in inverse kinematics
    known     trial -> "left" or "right" -> from and to s, where it is known what acts on that foot, so that moments are the person's
    mass      kg; None where nothing tells it
    findings  what is missing, and what was assumed instead
    """

    files: Mapping[str, Path]
    commands: tuple[str, ...] = ()
    scales: Mapping[str, BodyScale] = field(default_factory=dict)
    markers: tuple[PlacedMarker, ...] = ()
    weights: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    known: Mapping[str, Mapping[str, Sequence[tuple[float, float]]]] = field(default_factory=dict)
    mass: float | None = None
    findings: tuple[Finding, ...] = ()


@dataclass(frozen=True)
class _Prepared:
    """A trial with the names that OpenSim takes, under the name of its files. findings: on its names and plates."""

    name: str
    recording: Recording
    clinical: ClinicalModel | None
    plates: tuple[ForcePlate, ...]
    findings: tuple[Finding, ...]


def write_opensim(
    folder: str | Path,
    walks: Sequence[OpenSimTrial],
    model: str | Path | None = None,
    *,
    static: Recording | None = None,
    cut_off: float = CUT_OFF,
    overwrite: bool = False,
) -> OpenSimExport:
    """Write a folder with which OpenSim's scale tool, inverse kinematics and inverse dynamics run at once.

    walks   of one person; model  the user's own copy of a generic model (.osim), to which the documents point; without it, or without
            legs that are known, only markers and forces are written
    static  a standing trial with the same markers; without it the model is scaled by the first walk, and its markers stay where the
            walk shows them
    cut_off  Hz, of the low-pass filter of coordinates and forces in inverse dynamics

    Nothing is written where a file is there already, unless `overwrite`. Raises AsterismError where that is so, where the folder cannot be
    written to, or the model lacks a body that legs need.
    """
    folder = Path(folder)
    if not 0.0 < cut_off < np.inf:
        raise AsterismError(f"a cut-off of {cut_off:g} Hz filters nothing; give one in Hz, such as {CUT_OFF:g}.")
    if not walks:
        raise AsterismError("there is no walk to write for OpenSim; name one.")
    generic = None if model is None else generic_model(model)
    trials = _prepared(walks, static)
    still, moving = (trials[0], trials[1:]) if static is not None else (None, trials)
    files = _targets(folder, trials, generic is not None, len(trials) - len(moving))
    there = [path for path in files.values() if path.exists()]
    if there and not overwrite:
        raise AsterismError(f"{there[0]} exists; choose another folder with -o, or replace it with --overwrite.")
    found = [finding for trial in trials for finding in trial.findings]
    share = np.array([-0.2, 0.9, 0.0]) if generic is None else lumbar_share(generic)
    known = {trial.name: person_of(trial.recording, trial.clinical, share) for trial in trials if trial.clinical is not None}
    persons = {name: person for name, person in known.items() if has_leg(person)}
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as problem:
        raise AsterismError(f"{folder} cannot be made ({problem.strerror or problem}); name another folder with -o.") from problem
    for trial in trials:
        person = persons.get(trial.name)
        turn = person.turn if person is not None else _turn(trial.recording)
        own = dict(person.centres) if person is not None and trial is (still or moving[0]) else {}
        write(files[f"{trial.name}: markers"], _turned(trial.recording, turn, own))
        if f"{trial.name}: forces" in files:
            unknown = write_opensim_forces(files[f"{trial.name}: markers"], trial.recording, trial.plates, turn)
            if f"{trial.name}: filtered forces" in files and trial.name in persons:
                write_opensim_forces(_filtered(folder, trial), trial.recording, trial.plates, turn, cut_off)
            found += [_load(trial, phrase) for phrase in unknown]
        elif trial is not still:
            found.append(_no_forces(trial))
    scaled_by = still or moving[0]
    if generic is None or model is None or scaled_by.name not in persons:
        found += [_no_model(folder)] if generic is None else [_no_legs(scaled_by)]
        kept = {kind: path for kind, path in files.items() if kind.endswith((": markers", ": forces", ": loads"))}
        return OpenSimExport(kept, findings=tuple(found))
    session = _Session(folder, files, generic, Path(model), scaled_by, still is not None, moving, persons, cut_off)
    return _documents(session, found)


@dataclass(frozen=True)
class _Session:
    """What the documents are made of: `model` is the file of `generic`; `standing` whether `scaled_by` is a standing trial."""

    folder: Path
    files: Mapping[str, Path]
    generic: OsimModel
    model: Path
    scaled_by: _Prepared
    standing: bool
    moving: Sequence[_Prepared]
    persons: Mapping[str, PersonInTrial]
    cut_off: float


def _documents(session: _Session, found: list[Finding]) -> OpenSimExport:
    """Scale factors, marker set and the tools' documents."""
    files, generic, scaled_by = session.files, session.generic, session.scaled_by
    person, name = session.persons[scaled_by.name], _subject(scaled_by.recording)
    scales = scale_factors(generic, person, scaled_by.recording)
    bodies = bodies_of(list(person.markers))
    strange = [label for label in person.markers if label not in bodies]
    rides = dict[str, str]()
    for trial in session.moving:
        if trial.name in session.persons:
            rides = ridden(session.persons[trial.name], [one for one in strange if one in trial.recording.labels], _UNKNOWN) | rides
    placed, left = placed_markers(generic, person, scales, bodies | rides)
    left |= {label: "no marker set says where it sits, and it moves with no segment alone" for label in strange if label not in rides}
    for trial in session.moving:
        left |= {label: f"{scaled_by.name} does not show it" for label in trial.recording.labels if label not in person.markers}
    found += _assumed(scaled_by, session.standing, scales, left, rides)
    mass, said = _mass(scaled_by, person, session.standing)
    # shoulders move on the trunk, as no model does
    weights = {one.name: _CENTRES if one.centre and one.name[1:] in ("HJC", "KJC", "AJC") else 1.0 for one in placed}
    scaled, (run, whole) = f"{name}_scaled.osim", _without_gaps(placed, person)
    times = scaled_by.recording.times[run]
    task = ScaleTask(
        model=_beside(session.model, session.folder),
        markers=files["markers"].name,
        trial=files[f"{scaled_by.name}: markers"].name,
        times=(float(times[0]), float(times[-1])),
        mass=mass,
        scales=scales,
        pairs=_pairs(whole, scales),
        weights=weights,
        held=_held(generic, placed, weights),
        placing=session.standing,
        output=scaled,
    )
    write_atomically(files["markers"], utf8(marker_set(name, placed)))
    write_atomically(files["scale"], utf8(scale_setup(name, task)))
    _factors(scales).write(files["factors"])
    documents, weighed = [files["scale"]], dict[str, Mapping[str, float]]()
    known = dict[str, dict[str, list[tuple[float, float]]]]()
    for trial in session.moving:
        if trial.name in session.persons:
            own = _motion(session, trial, placed, scaled)
            found += _untold(trial, own.held) + _elsewhere(trial, moved(session.persons[trial.name], placed))
            weighed[trial.name] = own.weights
            write_atomically(files[f"{trial.name}: kinematics"], utf8(kinematics_setup(trial.name, own)))
            documents.append(files[f"{trial.name}: kinematics"])
            if f"{trial.name}: dynamics" in files:
                known[trial.name] = _known(trial)
                found.append(_where_known(trial, known[trial.name]))
                write_atomically(files[f"{trial.name}: dynamics"], utf8(dynamics_setup(trial.name, own)))
                documents.append(files[f"{trial.name}: dynamics"])
        else:
            found.append(_no_legs(trial))
    moved_by = ("kinematics", "dynamics", "filtered forces", "filtered loads")
    without = {f"{trial.name}: {kind}" for trial in session.moving if trial.name not in session.persons for kind in moved_by}
    written = {kind: path for kind, path in files.items() if kind not in without}
    commands = tuple(f"opensim-cmd run-tool {path.name}" for path in documents)
    return OpenSimExport(written, commands, scales, tuple(placed), weighed, known, mass, (*found, *said))


def _motion(session: _Session, trial: _Prepared, placed: Sequence[PlacedMarker], scaled: str) -> MotionTask:
    """Of one walk; a marker's weight is one over the square of what it is off, in centimetres."""
    moves = moved(session.persons[trial.name], placed)
    weights = {one.name: (0.01 / float(np.hypot(one.sigma, moves[one.name]))) ** 2 for one in placed if one.name in moves}
    loads = session.files.get(f"{trial.name}: filtered loads")
    return MotionTask(
        model=scaled,
        trial=session.files[f"{trial.name}: markers"].name,
        times=_span(trial.recording),
        coordinates=f"{trial.name}_ik.mot",
        weights=weights,
        held=_held(session.generic, placed, weights),
        loads="" if loads is None else loads.name,
        cut_off=session.cut_off,
    )


def _prepared(walks: Sequence[OpenSimTrial], static: Recording | None) -> list[_Prepared]:
    """The standing trial first, then the walks, under names that differ."""
    clinical = next((walk.clinical for walk in walks if walk.clinical is not None), None)
    given = [OpenSimTrial(static, None if clinical is None else replace(clinical, static=static))] if static is not None else []
    found, taken = list[_Prepared](), dict[str, str]()
    for trial in [*given, *walks]:
        file = str(trial.recording.metadata.get("file", "recording"))
        name = _plain(PurePath(file).stem)
        if name.casefold() in taken:
            raise AsterismError(f"{taken[name.casefold()]} and {file} would both become {name}.trc; give them one after the other.")
        taken[name.casefold()] = file
        # where a knee alignment device stands in for the knee's marker, that is computed
        recording, said = _with_plain_names(with_knee_markers(trial.recording) if trial in given else trial.recording)
        plates, told = force_plates(trial.recording)
        found.append(_Prepared(name, recording, trial.clinical, plates, (*said, *told)))
    return found


def _plain(name: str) -> str:
    """A name as OpenSim takes it: its own part of paths and lists has no blanks, slashes, stars, plus signs or backslashes."""
    return re.sub(r"[\s/\\*+,;:\"'<>&|?]+", "_", name).strip("_") or "trial"


def _with_plain_names(recording: Recording) -> tuple[Recording, list[Finding]]:
    """The named markers that are seen, without the subject's name, by names that OpenSim takes; and a finding where these are others."""
    seen = np.asarray(recording.visible.any(axis=0))
    labels = [label for label, shown in zip(recording.labels, seen, strict=True) if shown and not is_unnamed(label)]
    if not labels:
        raise AsterismError(
            f"{recording.metadata.get('file', 'the recording')} never shows a point with a name, which OpenSim needs; label it first."
        )
    names, found = list[str](), list[Finding]()
    for label in labels:
        name = _plain(without_subject(label))
        # joint centres are added under their names
        name = (
            name
            if name not in (*names, *CENTRES)
            else next(f"{name}_{k}" for k in range(2, len(labels) + 2) if f"{name}_{k}" not in labels and f"{name}_{k}" not in names)
        )
        names.append(name)
    changed = {label: name for label, name in zip(labels, names, strict=True) if without_subject(label) != name}
    if changed:
        file = str(recording.metadata.get("file", "the recording"))
        listed = ", ".join(f"{label} is {name}" for label, name in list(changed.items())[:5])
        more = "" if len(changed) <= 5 else f", and {len(changed) - 5} more"
        sentence = f"{file}: names that OpenSim does not take, or that are alike, were changed: {listed}{more}."
        found.append(Finding("opensim-names", Severity.NOTE, file, sentence, "Use names without blanks."))
    return replace(recording.select(labels), labels=tuple(names)), found


def _filtered(folder: Path, trial: _Prepared) -> Path:
    """Beside which the filtered forces are written."""
    return folder / f"{trial.name}_filtered.trc"


def _targets(folder: Path, trials: Sequence[_Prepared], documents: bool, standing: int) -> dict[str, Path]:
    """All files that may be written; standing  how many of the trials, the first, are no walks."""
    files: dict[str, Path] = {}
    for number, trial in enumerate(trials):
        path = folder / f"{trial.name}.trc"
        files[f"{trial.name}: markers"] = path
        # who stands is not moved by forces in OpenSim
        if trial.plates and number >= standing:
            files[f"{trial.name}: forces"], files[f"{trial.name}: loads"] = companions(path)
        if documents and number >= standing:
            files[f"{trial.name}: kinematics"] = folder / f"{trial.name}_ik.xml"
            if trial.plates:
                files[f"{trial.name}: dynamics"] = folder / f"{trial.name}_id.xml"
                files[f"{trial.name}: filtered forces"], files[f"{trial.name}: filtered loads"] = companions(_filtered(folder, trial))
    if documents:
        files |= {"markers": folder / "markers.xml", "scale": folder / "scale.xml", "factors": folder / "scale_factors.csv"}
    return files


def _turned(recording: Recording, turn: Floats, centres: Mapping[str, Floats]) -> Recording:
    """The recording in OpenSim's room, in mm, with joint centres as further markers."""
    positions = np.concatenate([recording.positions @ turn.T, *(points[:, None] for points in centres.values())], axis=1)
    metadata = {**recording.metadata, "units": "mm"}
    labels = (*recording.labels, *centres)
    vertical = np.array([0.0, 1.0, 0.0])
    return replace(recording, positions=positions, labels=labels, vertical=vertical, metadata=metadata, source=None, origin=None, taken=())


def _turn(recording: Recording) -> Floats:
    """(3, 3) to OpenSim's room, x along the axis of the room along which the markers move: for a trial whose legs are not known."""
    up = z_up_rotation(recording.vertical)
    middle = np.nanmean(np.where(recording.visible[:, :, None], recording.positions, np.nan), axis=1) @ up.T
    seen = middle[np.isfinite(middle).all(axis=1)]
    way = (seen[-1] - seen[0])[:2] if len(seen) else np.zeros(2)
    axis = int(abs(way[1]) > abs(way[0]))
    ahead = np.zeros(3)
    ahead[axis] = 1.0 if way[axis] >= 0 else -1.0
    return np.stack([ahead, [0.0, 0.0, 1.0], np.cross(ahead, [0.0, 0.0, 1.0])]) @ up


def _span(recording: Recording) -> tuple[float, float]:
    """s, the first and last frame in which three markers are seen: fewer tell no pose."""
    seen = np.nonzero(np.asarray(recording.visible.sum(axis=1)) >= 3)[0]
    first, last = (seen[0], seen[-1]) if len(seen) else (0, max(len(recording) - 1, 0))
    return float(recording.times[first]), float(recording.times[last])


def _subject(recording: Recording) -> str:
    return _plain(PurePath(str(recording.metadata.get("subject") or subject_of(recording))).name)


def _beside(model: Path, folder: Path) -> str:
    """The model's file as seen from the folder, links followed: the tools put their own folder before what they read."""
    try:
        return Path(os.path.relpath(os.path.realpath(model), os.path.realpath(folder))).as_posix()
    except ValueError:  # another drive
        return str(model.absolute())


_BETWEEN = {"femur": "HK", "tibia": "KA", "humerus": "SE", "ulna": "EW", "radius": "EW"}
"""The joint centres at the ends of a body, by their first letters."""


def _without_gaps(placed: Sequence[PlacedMarker], person: PersonInTrial) -> tuple[slice, list[PlacedMarker]]:
    """The longest run of frames in which fewest points are missing, and the points that are seen in all of it.

    The scale tool leaves a body as it is, and a point out of the pose, for a single sample that is missing.
    """
    points = {**person.markers, **person.centres}
    seen: NDArray[np.bool_] = np.asarray(np.isfinite(np.stack([points[marker.name] for marker in placed])).all(axis=2))
    missing = (~seen).sum(axis=0)
    edges = np.concatenate([[0], np.nonzero((seen[:, 1:] != seen[:, :-1]).any(axis=0))[0] + 1, [seen.shape[1]]])
    runs = [slice(int(begin), int(end)) for begin, end in pairwise(edges)]
    best = max(runs, key=lambda run: (-int(missing[run.start]), run.stop - run.start))
    return best, [marker for marker, there in zip(placed, seen[:, best.start], strict=True) if there]


def _pairs(whole: Sequence[PlacedMarker], scales: Mapping[str, BodyScale]) -> dict[str, tuple[str, str]]:
    """Body -> two points whose distance tells its factor; bodies of a foot share one."""
    centres, found = {marker.name for marker in whole if marker.centre}, dict[str, tuple[str, str]]()
    pairs = {
        f"{body}_{letter}": (f"{side}{ends[0]}JC", f"{side}{ends[1]}JC")
        for side, letter in SIDES.items()
        for body, ends in _BETWEEN.items()
    }
    for body, pair in {"pelvis": ("RHJC", "LHJC"), **pairs}.items():
        if set(pair) <= centres and body in scales and scales[body].measured is not None:
            found[body] = pair
    for body, others in (
        ("torso", ["torso"]),
        *((f"calcn_{side}", [f"{one}_{side}" for one in ("talus", "calcn", "toes")]) for side in "rl"),
    ):
        own = [marker for marker in whole if marker.body == body]
        apart = {(a.name, b.name): float(np.linalg.norm(a.location - b.location)) * scales[body].factor for a, b in combinations(own, 2)}
        widest = max(apart, key=apart.__getitem__, default=None)
        if widest is not None and apart[widest] > _APART:
            found |= {other: widest for other in others if other in scales}
    return found


def _held(model: OsimModel, placed: Sequence[PlacedMarker], weights: Mapping[str, float]) -> list[str]:
    """Coordinates that no marker tells: none is below the joint, or a single one below two joints in a row."""
    on = [marker.body for marker in placed if marker.name in weights]
    held, coupled = list[str](), {coupler.dependent for coupler in model.couplers}
    for body, joint in model.joints.items():
        below = set(model.below(body))
        needed = 1 + (joint.parent not in on)
        if joint.parent != "ground" and sum(one in below for one in on) < needed:
            held += [one for one in joint.coordinates if one not in coupled]
    return held


def _mass(scaled_by: _Prepared, person: PersonInTrial, standing: bool) -> tuple[float | None, list[Finding]]:
    """kg: that which was given or the file holds; else what the plates bear in the standing trial, where both feet stand on them."""
    clinical = scaled_by.clinical
    if clinical is not None and clinical.measures.mass is not None:
        return clinical.measures.mass, []
    file, mend = str(scaled_by.recording.metadata.get("file", "the recording")), "Give --measure BodyMass=KG."
    standing_on = [plate for plate in scaled_by.plates if standing and plate.loaded.mean() > 0.5]
    beside = ""
    if standing_on:
        bears = [float(np.median(plate.load[plate.loaded])) for plate in standing_on]
        weight = sum(bears) / GRAVITY
        beside = f" (its plates bear {weight:.1f} kg, not under both feet)"
        if {"RAJC", "LAJC"} <= person.centres.keys():
            under = np.average([np.nanmedian(plate.pressure, axis=0) for plate in standing_on], axis=0, weights=bears) @ person.turn.T
            right, left = (np.nanmedian(person.centres[name], axis=0) for name in ("RAJC", "LAJC"))
            share = float((under - right) @ (left - right) / ((left - right) @ (left - right)))
            if min(share, 1 - share) > _BOTH_FEET:
                sentence = f"{file}: nobody gave the person's mass; the plates bear {weight:.1f} kg in this trial."
                return weight, [Finding("opensim-mass", Severity.NOTE, file, sentence, mend)]
    sentence = f"{file}: nobody gave the person's mass{beside}, so that the scaled model keeps the generic one's."
    return None, [Finding("opensim-mass", Severity.WARNING, file, sentence, mend)]


def _factors(scales: Mapping[str, BodyScale]) -> NumberTable:
    columns = {"kind": str, "body": str, "factor": float, "measured_m": float, "model_m": float, "by": str}
    rows = tuple(("scale", scale.body, scale.factor, scale.measured, scale.model, scale.by) for scale in scales.values())
    return NumberTable(columns, rows)


def _assumed(
    trial: _Prepared, standing: bool, scales: Mapping[str, BodyScale], left: Mapping[str, str], rides: Mapping[str, str]
) -> list[Finding]:
    """What the set lacks, and what is assumed instead."""
    file, found = str(trial.recording.metadata.get("file", "the recording")), list[Finding]()
    if not standing:
        sentence = f"{file}: without a standing trial the model is scaled by this walk, and its markers sit where the walk shows them."
        found.append(Finding("opensim-no-static", Severity.NOTE, file, sentence, "Give a standing trial with --static."))
    guessed = [scale for scale in scales.values() if scale.measured is None and scale.by == "as the legs"]
    guessed += [scale for scale in scales.values() if scale.measured is None and scale.body[:5] in ("femur", "tibia", "talus")]
    if guessed:
        listed = ", ".join(f"{scale.body} {scale.by}" for scale in guessed)
        sentence = f"{file}: its markers do not tell the size of all bodies, which are scaled: {listed}."
        found.append(Finding("opensim-scale", Severity.NOTE, file, sentence, "Use a marker set that shows both ends of each of them."))
    by_reason: dict[str, list[str]] = {}
    for name, why in left.items():
        by_reason.setdefault(why, []).append(name)
    for why, names in by_reason.items():
        sentence = f"{file}: {', '.join(names)} {'is' if len(names) == 1 else 'are'} in the TRC file and not on the model: {why}."
        found.append(
            Finding("opensim-marker", Severity.NOTE, file, sentence, "Name it as a marker set does, or use a model with that body.")
        )
    if rides:
        listed = ", ".join(f"{name} on {body}" for name, body in rides.items())
        sentence = f"{file}: by their names these markers sit nowhere; they were put on the segment with which they move: {listed}."
        found.append(Finding("opensim-ridden", Severity.NOTE, file, sentence, "Look whether that is so; markers.xml says where they sit."))
    return found


def _known(trial: _Prepared) -> dict[str, list[tuple[float, float]]]:
    """Side -> from and to s, where it is known what acts on the foot: it is alone on a plate, or in the air."""
    found: dict[str, list[tuple[float, float]]] = {"left": [], "right": []}
    if trial.clinical is None:
        return found
    try:
        static, measures = trial.clinical.static, trial.clinical.measures
        kinetics = analyse_gait(trial.recording, trial.plates, measures, static=static, model=trial.clinical.name).kinetics
    except AsterismError:
        return found
    for side in found:
        values = None if kinetics is None else kinetics.moments.get(f"{side[0].upper()}KneeMoment")
        if values is not None:
            edges = np.flatnonzero(np.diff(np.concatenate([[0], np.isfinite(values[:, 0]).astype(int), [0]])))
            times = trial.recording.times
            found[side] = [(float(times[begin]), float(times[end - 1])) for begin, end in edges.reshape(-1, 2)]
    return found


def _where_known(trial: _Prepared, known: Mapping[str, Sequence[tuple[float, float]]]) -> Finding:
    file = str(trial.recording.metadata.get("file", "the recording"))
    spans = {side: ", ".join(f"{begin:.2f} to {end:.2f} s" for begin, end in spans) for side, spans in known.items()}
    told = "; ".join(f"of the {side} leg {text}" for side, text in spans.items() if text)
    sentence = f"{file}: inverse dynamics are the person's only where it is known what acts on the foot: {told or 'at no time'}."
    mend = (
        "Elsewhere a foot stands beside the plates, or with the other on one." if told else "Record steps that hit a plate with one foot."
    )
    return Finding("opensim-known", Severity.NOTE if told else Severity.WARNING, file, sentence, mend)


def _untold(trial: _Prepared, held: Sequence[str]) -> list[Finding]:
    if not held:
        return []
    file = str(trial.recording.metadata.get("file", "the recording"))
    legs = [name for name in held if name.startswith(("hip", "knee", "ankle"))]
    sentence = f"{file}: no marker tells these coordinates, which keep zero in OpenSim: {', '.join(held)}."
    mend = "Moments of inverse dynamics at and above these joints are not the person's; name markers below them." if legs else ""
    return [Finding("opensim-held", Severity.WARNING if legs else Severity.NOTE, file, sentence, mend)]


def _elsewhere(trial: _Prepared, moves: Mapping[str, float]) -> list[Finding]:
    far = {name: apart for name, apart in moves.items() if apart > _ELSEWHERE}
    if not far:
        return []
    file = str(trial.recording.metadata.get("file", "the recording"))
    listed = ", ".join(f"{name} {1000 * apart:.0f} mm" for name, apart in sorted(far.items(), key=lambda one: -one[1]))
    sentence = f"{file}: markers are elsewhere on their bodies than where they were placed, and weigh little: {listed}."
    mend = "Look whether they were named right, whether they fell off, or whether the arms were raised in the standing trial."
    return [Finding("opensim-moved", Severity.NOTE, file, sentence, mend)]


def _load(trial: _Prepared, phrase: str) -> Finding:
    file = str(trial.recording.metadata.get("file", "the recording"))
    mend = "Leave that time out of inverse dynamics, or say in the _grf.xml on which body it acts."
    return Finding("opensim-load", Severity.WARNING, file, f"{file}: acts on no body in OpenSim: {phrase}.", mend)


def _no_forces(trial: _Prepared) -> Finding:
    file = str(trial.recording.metadata.get("file", "the recording"))
    sentence = f"{file} has no force plates that can be used, so that there are no forces and no inverse dynamics."
    return Finding("opensim-no-forces", Severity.NOTE, file, sentence, "Give the C3D file with its force plates.")


def _no_model(folder: Path) -> Finding:
    sentence = f"Without a generic model there are markers and forces in {folder}, and no marker set and no documents for OpenSim's tools."
    return Finding("opensim-no-model", Severity.NOTE, str(folder), sentence, "Give your copy of gait2392 or Rajagopal's with --model.")


def _no_legs(trial: _Prepared) -> Finding:
    file = str(trial.recording.metadata.get("file", "the recording"))
    sentence = f"{file}: its markers tell no hips, knees and ankles, so that no model is scaled or moved by it; its TRC file is there."
    mend = "Name them as a marker set does: pelvis, and of a leg Plug-in-Gait's markers or both sides of knee and ankle."
    return Finding("opensim-no-legs", Severity.WARNING, file, sentence, mend)
