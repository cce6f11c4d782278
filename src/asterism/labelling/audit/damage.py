"""The audit: labelled recordings in; their mislabelled frames out.

Two witnesses are heard. Markers' own paths (`paths`): where two labels change places, both columns leap, and the leaps vanish if the points
are exchanged. And other people's bodies: a body model learned without this person (without this recording, where there is one person only)
says by how many nats an exchange would explain each frame better. Both go into one chain per pair of markers with two states, as labelled
and exchanged, whose most likely path is exact; a change of state costs what an honest recording never gains by chance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from asterism.errors import AsterismError
from asterism.geometry import rotate_z_up
from asterism.labelling.audit._kernels import exchange_gains
from asterism.labelling.audit.errors import ALWAYS, EXCHANGED, MISPLACED, LabelError, Run, joined, sentence
from asterism.labelling.audit.paths import exchanges, jumps, pairs_of
from asterism.labelling.body._workspace_kernels import BodyArrays
from asterism.labelling.body.labeller import FrameLabellingSettings
from asterism.labelling.body.model import BodyRules, fit_body, names_of, subsample
from asterism.labelling.partial.solver import subject_of
from asterism.labelling.training.learning import renumbered
from asterism.progress import Progress
from asterism.recording import Floats, Ints, Recording

FARTHEST = 1000.0
"""Nats beyond which all is the same."""


@dataclass(frozen=True)
class AuditRules:
    """When labels are called damaged. Chosen on the gait subjects as they are and with exchanges put in; see docs/labelling.md.

    switch       nats that each beginning and each end of an exchange costs
    least        nats by which an exchange must explain the recording better
    say          nats at most that the body may say of one frame
    memory       seconds for which frames say the same of the body
    always       nats per frame from which other people's bodies call a whole recording exchanged
    odd          nats per frame below which a marker sits oddly throughout
    far          m that a leap takes at least
    fast         m/s that a leap changes the speed by at least, within a frame
    times        usual misses that a leap is at least
    longest      seconds that a marker may be off its path
    frames       frames of a recording at most that the body is asked about, evenly spread
    per_person   frames of a person at most that the bodies are learned from
    fewest       frames that a body is learned from, at least
    folds        groups of people left out in turn
    """

    switch: float = 12.0
    least: float = 10.0
    say: float = 15.0
    memory: float = 0.2
    always: float = 5.0
    odd: float = -8.0
    far: float = 0.03
    fast: float = 4.0
    times: float = 12.0
    longest: float = 1.0
    frames: int = 600
    per_person: int = 300
    fewest: int = 40
    folds: int = 12


@dataclass(frozen=True)
class _Witness:
    """A body model learned from others, and the markers that it knows."""

    body: BodyArrays
    worn: Ints
    rules: AuditRules

    def ask(self, positions: Floats) -> _Opinion:
        """What it says of some frames of a recording (T, M, 3) m, evenly spread."""
        frames, markers = positions.shape[:2]
        at = np.unique(np.linspace(0, frames - 1, min(frames, self.rules.frames)).round().astype(np.int64))
        pairs = pairs_of(markers)
        mine = np.nonzero(np.isin(pairs, self.worn).all(axis=1))[0]
        known, said, own = (
            np.searchsorted(self.worn, pairs[mine]).astype(np.int64),
            np.zeros((len(mine), len(at))),
            np.full((len(at), len(self.worn)), np.nan),
        )
        settings = replace(FrameLabellingSettings(), outlier_score=-1e3).with_usual_score(0.0)
        some = np.ascontiguousarray(positions[np.ix_(at, self.worn)])
        exchange_gains(some, self.body, settings, known, 2.0 * self.rules.say, FARTHEST, said, own)
        gains, places = np.zeros((len(pairs), len(at))), np.full((len(at), markers), np.nan)
        gains[mine], places[:, self.worn] = said, np.maximum(own, -FARTHEST)
        return _Opinion(at, gains, places)


@dataclass(frozen=True)
class _Opinion:
    """What others' bodies say of a recording.

    at     (N,) frames asked about
    gains  (P, N) nats by which each frame is explained better with a pair exchanged, 0 where nothing is known
    own    (N, M) score of each point as its own marker, NaN where nothing is known
    """

    at: Ints
    gains: Floats
    own: Floats

    def usual_gains(self) -> Floats:
        """(P,) the median of those that are known, 0 where there are few."""
        return _medians(np.where(self.gains == 0.0, np.nan, self.gains.astype(np.float64)).T)

    def usual_own(self) -> Floats:
        """(M,) the median of each marker's score, 0 where few are known."""
        return _medians(self.own, 10)


def audit(
    recordings: Sequence[Recording],
    *,
    subjects: Sequence[str] | None = None,
    seed: int = 0,
    rules: AuditRules | None = None,
    progress: Progress | None = None,
) -> list[LabelError]:
    """Find mislabelled frames in labelled recordings.

    recordings may differ in their labels: equal labels are the same marker. subjects: whose each is, by default as its metadata says, else
    its folder; more than one person lets bodies speak besides paths. Errors come in the order of the recordings and frames.
    Raises AsterismError where there is no recording, or not one subject for each. O(T M^2) for the paths.
    """
    if not recordings:
        raise AsterismError("there is no recording to look through; give at least one labelled file.")
    given = [subject_of(recording) for recording in recordings] if subjects is None else list(subjects)
    if len(given) != len(recordings):
        raise AsterismError(f"{len(given)} subjects for {len(recordings)} recordings; give one name per recording.")
    rules, report = rules or AuditRules(), progress or (lambda fraction, what: None)
    labels = tuple(dict.fromkeys(label for recording in recordings for label in recording.labels))
    frames = [_columns(recording, labels) for recording in recordings]
    people = names_of(given)[1]
    several = people.max() > 0
    groups = people % rules.folds if several else np.arange(len(frames))
    runs: dict[int, list[Run]] = {}
    for number in np.unique(groups).tolist():
        own = np.nonzero(groups == number)[0].tolist()
        others = np.nonzero(groups != number)[0].tolist()
        report(len(runs) / len(frames), "comparing bodies")
        witness = _witness([frames[i] for i in others], people[others], rules, seed)
        opinions = {i: witness.ask(frames[i]) for i in own if len(frames[i])} if witness else {}
        usual = {i: opinion.usual_gains() for i, opinion in opinions.items()}
        for i in own:
            report(len(runs) / len(frames), "following the paths")
            siblings = [usual[j] for j in usual if j != i and people[j] == people[i] and several]
            runs[i] = _look_through(frames[i], recordings[i].rate, witness, opinions.get(i), siblings, rules)
    report(1.0, "done")
    return [_error(run, i, recording, given[i], labels) for i, recording in enumerate(recordings) for run in runs[i]]


def without(recordings: Sequence[Recording], errors: Sequence[LabelError]) -> list[Recording]:
    """The recordings without the damaged samples: NaN in the frames and markers of each error. Hints leave all in."""
    kept = []
    for i, recording in enumerate(recordings):
        positions = recording.positions.copy()
        for error in errors:
            if error.recording == i and error.damage:
                columns = [column for column, label in enumerate(recording.labels) if label in error.markers]
                positions[error.first_frame : error.last_frame + 1, columns] = np.nan
        kept.append(replace(recording, positions=positions))
    return kept


def _columns(recording: Recording, labels: tuple[str, ...]) -> Floats:
    """A recording's positions (T, M, 3) m, z up, in the order of `labels`, NaN where it has no such marker or the label twice."""
    positions = np.full((len(recording), len(labels), 3), np.nan)
    own = rotate_z_up(recording.positions, recording.vertical)
    for m, label in enumerate(labels):
        if recording.labels.count(label) == 1:
            positions[:, m] = own[:, recording.labels.index(label)]
    return positions


def _witness(frames: Sequence[Floats], people: Ints, rules: AuditRules, seed: int) -> _Witness | None:
    """A body model of the markers that a third of these frames show, at least; None where there is too little."""
    if sum(len(f) for f in frames) < rules.fewest:
        return None
    whose = np.repeat(people, [len(f) for f in frames])
    rows = subsample(whose, rules.per_person)
    together, whose = np.concatenate(frames)[rows], whose[rows]
    shown = ~np.isnan(together[:, :, 0])
    worn = np.nonzero(shown.mean(axis=0) > 1.0 / 3.0)[0]
    usable = shown[:, worn].sum(axis=1) >= max(4, 0.5 * len(worn))
    if len(worn) < 4 or usable.sum() < rules.fewest or not shown[usable][:, worn].any(axis=0).all():
        return None
    # it has to accuse, not to be fair to bodies that it never saw: what it says is compared with what it usually says of the recording
    rules_of_body = BodyRules(few_std=0.0)
    body = fit_body(np.ascontiguousarray(together[np.ix_(usable, worn)]), renumbered(whose[usable]), rules_of_body, seed)
    return _Witness(body.arrays(), worn, rules)


def _medians(values: Floats, fewest: int = 3) -> Floats:
    """(N, K) to (K,): each column's median without its NaN, 0 where fewer than `fewest` are left."""
    enough = (~np.isnan(values)).sum(axis=0) >= fewest
    out = np.zeros(values.shape[1])
    out[enough] = np.nanmedian(values[:, enough], axis=0)
    return out


def _look_through(
    positions: Floats, rate: float, witness: _Witness | None, opinion: _Opinion | None, siblings: Sequence[Floats], rules: AuditRules
) -> list[Run]:
    """All that is wrong with one recording; siblings: what the bodies usually say of this person's other recordings, (P,) each."""
    runs: list[Run] = []
    emission = np.full((len(pairs_of(positions.shape[1])), len(positions)), -1e-3)
    if witness is not None and opinion is not None:
        runs, positions, opinion = _exchanged_throughout(positions, rate, witness, opinion, siblings, rules)
        usual = opinion.usual_gains()
        # a body that is built a little differently is no exchange: then only what differs from the rest of the recording counts
        unlike = (usual > 0.0) & (usual < rules.always)
        if siblings:
            unlike &= np.mean(siblings, axis=0) >= 0.0
        weight = min(1.0, len(positions) / len(opinion.at) / (rules.memory * rate))
        said = np.clip(opinion.gains, -rules.say, rules.say)
        emission[:, opinion.at] += weight * np.where(unlike, -1.0, 1.0)[:, None] * said
    swapped, mended = exchanges(positions, emission, rules.switch, rules.least)
    runs += swapped
    runs += jumps(mended, rate, rules.far, rules.fast, rules.times, rules.longest)
    if witness is not None and opinion is not None:
        level = (witness.ask(mended) if swapped else opinion).usual_own()
        runs += [Run(0, len(positions) - 1, (int(m),), MISPLACED, -float(level[m])) for m in np.nonzero(level < rules.odd)[0]]
    return sorted(joined(runs), key=lambda run: (run.first, run.last, run.markers))


def _exchanged_throughout(
    positions: Floats, rate: float, witness: _Witness, opinion: _Opinion, siblings: Sequence[Floats], rules: AuditRules
) -> tuple[list[Run], Floats, _Opinion]:
    """Pairs that nearly every frame calls exchanged, the plainest first; the positions with that mended, and what is said of them then."""
    runs: list[Run] = []
    pairs = pairs_of(positions.shape[1])
    for _ in range(positions.shape[1]):
        usual = opinion.usual_gains()
        most = np.where(opinion.gains == 0.0, True, opinion.gains > 0.0).mean(axis=1) > 0.95
        best = int(np.argmax(np.where(most, usual, 0.0)))
        if not most[best] or usual[best] < rules.always:
            break
        a, b = pairs[best].tolist()
        everywhere = all(level[best] > 0.0 for level in siblings)
        gain = float(usual[best]) * max(1.0, len(positions) / rate / rules.memory)
        runs.append(Run(0, len(positions) - 1, (a, b), ALWAYS if everywhere else EXCHANGED, gain))
        positions = positions.copy()
        positions[:, [a, b]] = positions[:, [b, a]]
        opinion = witness.ask(positions)
    return runs, positions, opinion


def _error(run: Run, number: int, recording: Recording, subject: str, labels: Sequence[str]) -> LabelError:
    names = tuple(labels[m] for m in run.markers)
    count = run.last - run.first + 1
    words = sentence(run.kind, names, count / recording.rate, count, count == len(recording), subject)
    file = str(recording.metadata.get("file", f"recording {number + 1}"))
    return LabelError(number, file, subject, run.first, run.last, names, run.kind, run.gain, words)
