"""The audit: labelled recordings in; their wrong labels out.

Three kinds of evidence are combined. A person's recordings are laid on each other (`stiff`): a part that keeps its shape fits as named, or
under other names. The markers' own paths (`paths`): where two labels are exchanged, both columns jump, and the jumps vanish when the points
are exchanged back. And other people's bodies: a body model that was learned without this person (without this recording, where all are of
one person) says by how many nats an exchange explains each frame better. The last two go into one chain per pair of markers with two
states, as labelled and exchanged. The most likely path through the chain is computed exactly. A change of state costs more than a correct
recording gains by chance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from asterism.errors import AsterismError
from asterism.geometry import rotate_z_up
from asterism.labelling.audit._kernels import exchange_gains
from asterism.labelling.audit.errors import ALWAYS, DIFFERENT, EXCHANGED, MISPLACED, ErrorRun, LabelError, joined, sentence
from asterism.labelling.audit.paths import exchanges, jumps, pairs_of
from asterism.labelling.audit.stiff import LaidOnEachOther, laid_on_each_other, stiff_pairs
from asterism.labelling.body._score_kernels import NO_TAIL
from asterism.labelling.body._workspace_kernels import BodyArrays
from asterism.labelling.body.labeller import FrameLabellingSettings
from asterism.labelling.body.model import BodyRules, fit_body, names_of, subsample
from asterism.labelling.training.learning import renumbered
from asterism.progress import Progress
from asterism.recording import Floats, Ints, Recording, subject_of

FARTHEST = 1000.0
"""nats beyond which evidence is cut off."""


@dataclass(frozen=True)
class AuditRules:
    """When labels count as wrong. Chosen on the gait subjects as they are and with exchanges put in; see docs/labelling.md.

    switch           nats that each beginning and each end of an exchange costs
    min_gain         nats by which an exchange must explain the recording better
    max_frame_nats   nats at most that the body counts in one frame
    correlation      seconds over which frames give the same evidence of the body
    always           nats per frame from which a whole recording counts as exchanged against other people's bodies
    misplaced        nats per frame; a marker whose usual score is below counts as misplaced
    jump_distance    m that a jump takes at least
    jump_speed       m/s by which a jump changes the speed at least, within a frame
    jump_errors      usual prediction errors of the marker that a jump takes at least
    longest_jump     seconds that a marker may be off its path
    max_frames       frames of a recording at most that are compared with the body, evenly spread
    max_per_person   frames of a person at most that a body is learned from
    min_frames       frames that a body is learned from, at least
    folds            groups of people left out in turn
    """

    switch: float = 12.0
    min_gain: float = 10.0
    max_frame_nats: float = 15.0
    correlation: float = 0.2
    always: float = 5.0
    misplaced: float = -8.0
    jump_distance: float = 0.03
    jump_speed: float = 4.0
    jump_errors: float = 12.0
    longest_jump: float = 1.0
    max_frames: int = 600
    max_per_person: int = 300
    min_frames: int = 40
    folds: int = 12


@dataclass(frozen=True)
class _ReferenceBody:
    """A body model learned from others, and the markers that it has (places in the list of all labels)."""

    body: BodyArrays
    markers: Ints
    rules: AuditRules

    def score(self, positions: Floats) -> _BodyEvidence:
        """The evidence for some frames of a recording (T, M, 3) m, evenly spread."""
        frames, markers = positions.shape[:2]
        at = np.unique(np.linspace(0, frames - 1, min(frames, self.rules.max_frames)).round().astype(np.int64))
        # Pairs with a marker that the others never wore get no evidence, which is 0 and not a loss.
        pairs = pairs_of(markers)
        known = np.nonzero(np.isin(pairs, self.markers).all(axis=1))[0]
        pairs_in_body = np.searchsorted(self.markers, pairs[known]).astype(np.int64)
        gains_in_body, scores_in_body = np.zeros((len(known), len(at))), np.full((len(at), len(self.markers)), np.nan)
        # No point may count as an outlier: a wrong label must show its full loss.
        settings = replace(FrameLabellingSettings(), outlier_score=-1e3, tail_freedom=NO_TAIL).with_usual_score(0.0)
        some = np.ascontiguousarray(positions[np.ix_(at, self.markers)])
        # Below twice the most that a frame counts, the exact value would be clipped anyway.
        least = 2.0 * self.rules.max_frame_nats
        exchange_gains(some, self.body, settings, pairs_in_body, least, FARTHEST, gains_in_body, scores_in_body)
        gains, scores = np.zeros((len(pairs), len(at))), np.full((len(at), markers), np.nan)
        gains[known], scores[:, self.markers] = gains_in_body, np.maximum(scores_in_body, -FARTHEST)
        return _BodyEvidence(at, gains, scores)


@dataclass(frozen=True)
class _BodyEvidence:
    """What a reference body says of a recording.

    frames  (N,) frames that were compared with the body
    gains   (P, N) nats by which each frame is explained better with a pair exchanged, 0 where it is not known
    scores  (N, M) nats, the score of each point as the marker that it is labelled, NaN where it is not known
    """

    frames: Ints
    gains: Floats
    scores: Floats

    def usual_gains(self) -> Floats:
        """(P,) nats, the median of each pair's known gains, 0 where few are known."""
        return _medians(np.where(self.gains == 0.0, np.nan, self.gains.astype(np.float64)).T)

    def gains_nearly_always(self) -> NDArray[np.bool_]:
        """(P,) pairs that gain in nearly all frames; one without evidence does not speak against an exchange of all the others."""
        return np.asarray(np.where(self.gains == 0.0, True, self.gains > 0.0).mean(axis=1) > 0.95)

    def usual_scores(self) -> Floats:
        """(M,) nats, the median of each marker's score, 0 where few are known."""
        return _medians(self.scores, 10)


def audit(
    recordings: Sequence[Recording],
    *,
    subjects: Sequence[str] | None = None,
    seed: int = 0,
    rules: AuditRules | None = None,
    progress: Progress | None = None,
) -> list[LabelError]:
    """Find wrong labels in labelled recordings.

    recordings  may differ in their labels; equal labels are the same marker
    subjects    the person of each recording, by default what its metadata says, else its folder

    With recordings of several people, each person's are compared with the others' bodies. Errors come in the order of recordings and
    frames. Raises AsterismError where there is no recording, or not one subject for each. O(T M^2) for the paths.

    >>> from asterism.simulation import simulate_walks
    >>> walk = simulate_walks(1, frames=100, seed=0)[0]
    >>> left, right = walk.labels.index("LKNE"), walk.labels.index("RKNE")
    >>> walk.positions[60:, [left, right]] = walk.positions[60:, [right, left]]
    >>> [error.description for error in audit([walk])]
    ['RKNE and LKNE exchanged for 40 frames (0.40 s)']
    """
    if not recordings:
        raise AsterismError("there is no recording to audit; give at least one labelled file.")
    given = [subject_of(recording) for recording in recordings] if subjects is None else list(subjects)
    if len(given) != len(recordings):
        raise AsterismError(f"{len(given)} subjects for {len(recordings)} recordings; give one name per recording.")
    rules, report = rules or AuditRules(), progress or (lambda fraction, what: None)
    labels = tuple(dict.fromkeys(label for recording in recordings for label in recording.labels))
    frames = [_columns(recording, labels) for recording in recordings]
    people = names_of(given)[1]
    # One person alone is compared with the rest of the recordings; several people with each other.
    several = people.max() > 0
    groups = people % rules.folds if several else np.arange(len(frames))
    runs: dict[int, list[ErrorRun]] = {}
    named, settled = _by_stiff_parts(frames, people)
    # A body that learned from wrong names would call the right ones wrong.
    frames = [_put_right(positions, own) for positions, own in zip(frames, named, strict=True)]
    for number in np.unique(groups).tolist():
        # The body must not have seen the person whom it judges.
        left_out = np.nonzero(groups == number)[0].tolist()
        others = np.nonzero(groups != number)[0].tolist()
        report(len(runs) / len(frames), "comparing bodies")
        reference = _reference_body([frames[i] for i in others], people[others], rules, seed)
        evidence = {i: reference.score(frames[i]) for i in left_out if len(frames[i])} if reference else {}
        usual = {i: found.usual_gains() for i, found in evidence.items()}
        for i in left_out:
            report(len(runs) / len(frames), "comparing paths")
            # Another recording of the same person tells an unusual body from an exchange.
            siblings = [usual[j] for j in usual if j != i and people[j] == people[i] and several]
            case = _Case(frames[i], recordings[i].rate, reference, evidence.get(i), siblings, named[i], settled[i], several, rules)
            runs[i] = _find_runs(case)
    _drop_decided(runs, people)
    report(1.0, "done")
    return [_error(run, i, recording, given[i], labels) for i, recording in enumerate(recordings) for run in runs[i]]


def remove_errors(recordings: Sequence[Recording], errors: Sequence[LabelError]) -> list[Recording]:
    """The recordings without the wrong labels: NaN in the frames and markers of each error. Hints remove nothing.

    >>> from asterism.simulation import simulate_walks
    >>> walk = simulate_walks(1, frames=100, seed=0)[0]
    >>> left, right = walk.labels.index("LKNE"), walk.labels.index("RKNE")
    >>> walk.positions[60:, [left, right]] = walk.positions[60:, [right, left]]
    >>> [clean] = remove_errors([walk], audit([walk]))
    >>> int(np.isnan(clean.positions[60:, [left, right]]).all(axis=2).sum())
    80
    """
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
    """A recording's positions (T, M, 3) m, z up, in the order of `labels`; NaN where it lacks the label or has it twice."""
    positions = np.full((len(recording), len(labels), 3), np.nan)
    upright = rotate_z_up(recording.positions, recording.vertical)
    for m, label in enumerate(labels):
        # A label that is there twice names no single path, so that neither column can be judged.
        if recording.labels.count(label) == 1:
            positions[:, m] = upright[:, recording.labels.index(label)]
    return positions


def _reference_body(frames: Sequence[Floats], people: Ints, rules: AuditRules, seed: int) -> _ReferenceBody | None:
    """A body model of the markers that at least a third of these frames show; None where there are too few frames or markers."""
    if sum(len(f) for f in frames) < rules.min_frames:
        return None
    person_of = np.repeat(people, [len(f) for f in frames])
    # Equal numbers of frames per person keep a long recording from making the body its own.
    rows = subsample(person_of, rules.max_per_person)
    positions, person_of = np.concatenate(frames)[rows], person_of[rows]
    shown = ~np.isnan(positions[:, :, 0])
    markers = np.nonzero(shown.mean(axis=0) > 1.0 / 3.0)[0]
    # Frames with few markers would make the body of those that happen to be shown.
    usable = shown[:, markers].sum(axis=1) >= max(4, 0.5 * len(markers))
    if len(markers) < 4 or usable.sum() < rules.min_frames or not shown[usable][:, markers].any(axis=0).all():
        return None
    # no allowance for the few people: the scores are compared with the usual score of the same recording
    rules_of_body = BodyRules(few_std=0.0)
    body = fit_body(np.ascontiguousarray(positions[np.ix_(usable, markers)]), renumbered(person_of[usable]), rules_of_body, seed)
    return _ReferenceBody(body.arrays(), markers, rules)


def _medians(values: Floats, fewest: int = 3) -> Floats:
    """(N, K) to (K,): each column's median without its NaN, 0 where fewer than `fewest` values are left."""
    enough = (~np.isnan(values)).sum(axis=0) >= fewest
    out = np.zeros(values.shape[1])
    out[enough] = np.nanmedian(values[:, enough], axis=0)
    return out


@dataclass(frozen=True)
class _Case:
    """One recording to audit, and what it is compared with.

    positions  (T, M, 3) m, z up, NaN where missing
    rate       frames per second
    reference  a body learned from others, or None where there is too little
    evidence   what it says of the recording, or None
    siblings   (P,) each: the usual gains of this person's other recordings
    named      what this person's other recordings say of its names, see `stiff`; the positions are put right accordingly
    settled    (P,) pairs of which they say enough
    several    whether the reference is other people; otherwise it is this person in other postures, which says nothing of a whole recording
    """

    positions: Floats
    rate: float
    reference: _ReferenceBody | None
    evidence: _BodyEvidence | None
    siblings: Sequence[Floats]
    named: Sequence[ErrorRun]
    settled: NDArray[np.bool_]
    several: bool
    rules: AuditRules


def _find_runs(case: _Case) -> list[ErrorRun]:
    """All that is wrong with one recording."""
    positions, rate, rules, reference, evidence = case.positions, case.rate, case.rules, case.reference, case.evidence
    runs = list(case.named)
    # Slightly against an exchange, where the body says nothing: ties go to the labels as they are.
    emission = np.full((len(pairs_of(positions.shape[1])), len(positions)), -1e-3)
    if reference is not None and evidence is not None:
        found, positions, evidence = _exchanged_throughout(case, positions, reference, evidence)
        runs += found
        usual = evidence.usual_gains()
        # a positive usual gain can be a body of other proportions: then only what differs from the rest of the recording counts
        other_proportions = (usual > 0.0) & (usual < rules.always)
        if not case.several:
            # The same person in other postures fits an exchange throughout as well as a posture.
            other_proportions |= evidence.gains_nearly_always()
        elif case.siblings:
            other_proportions &= np.mean(case.siblings, axis=0) >= 0.0
        # Neighbouring frames repeat the same evidence: they count together as one per `correlation`.
        weight = min(1.0, len(positions) / len(evidence.frames) / (rules.correlation * rate))
        gains = np.clip(evidence.gains, -rules.max_frame_nats, rules.max_frame_nats)
        emission[:, evidence.frames] += weight * np.where(other_proportions, -1.0, 1.0)[:, None] * gains
    # Whole-recording exchanges are undone first, so that the rest is judged on paths that are right.
    exchanged, corrected = exchanges(positions, emission, rules.switch, rules.min_gain)
    if not case.several:
        # Where nothing leaps, only the body says so, and it is this person's own in other postures.
        shown = ~np.isnan(positions[:, :, 0])
        exchanged = [run for run in exchanged if not _whole(run, shown)]
    runs += exchanged
    runs += jumps(corrected, rate, rules.jump_distance, rules.jump_speed, rules.jump_errors, rules.longest_jump)
    # Markers are judged where the exchanges put them, or every exchange would look misplaced, too.
    if reference is not None and evidence is not None and case.several:
        level = (reference.score(corrected) if exchanged else evidence).usual_scores()
        runs += _misplaced(corrected, level, rules.misplaced)
    return sorted(joined(runs), key=lambda run: (run.first, run.last, run.markers))


def _by_stiff_parts(frames: Sequence[Floats], people: Ints) -> tuple[list[list[ErrorRun]], list[NDArray[np.bool_]]]:
    """For each recording: markers that carry each other's names in all of it, as the person's other recordings show; and settled pairs."""
    pairs = pairs_of(frames[0].shape[1])
    named: list[list[ErrorRun]] = [[] for _ in frames]
    settled = [np.zeros(len(pairs), dtype=bool) for _ in frames]
    for person in np.unique(people).tolist():
        own = np.nonzero(people == person)[0].tolist()
        laid: LaidOnEachOther = laid_on_each_other([frames[i] for i in own])
        for place, i in enumerate(own):
            settled[i] = laid.settled(place, pairs)
        for one in laid.contradictions():
            kind = EXCHANGED if one.certain else DIFFERENT
            for i in (own[place] for place in one.recordings):
                named[i] += [ErrorRun(0, len(frames[i]) - 1, cycle, kind, one.names.gain) for cycle in one.names.cycles()]
    return named, settled


def _put_right(positions: Floats, runs: Sequence[ErrorRun]) -> Floats:
    """The positions with exchanged pairs exchanged back; of three and more that pass their names round, nothing is kept."""
    positions = positions.copy()
    for run in runs:
        if run.kind == EXCHANGED and len(run.markers) == 2:
            positions[:, run.markers] = positions[:, run.markers[::-1]]
        elif run.kind == EXCHANGED:
            positions[:, run.markers] = np.nan
    return positions


def _drop_decided(runs: dict[int, list[ErrorRun]], people: Ints) -> None:
    """Where a body has told which of two recordings is wrong, neither is told to differ from the other any more."""
    whole = {(int(people[i]), run.markers) for i, some in runs.items() for run in some if run.kind == EXCHANGED and run.first == 0}
    for i, some in runs.items():
        runs[i] = [run for run in some if run.kind != DIFFERENT or (int(people[i]), run.markers) not in whole]


def _whole(run: ErrorRun, shown: NDArray[np.bool_]) -> bool:
    """Whether a run holds all frames that show all of its markers, shown (T, M)."""
    frames = np.nonzero(shown[:, run.markers].all(axis=1))[0]
    return len(frames) > 0 and run.first <= frames[0] and run.last >= frames[-1]


def _misplaced(positions: Floats, level: Floats, least: float) -> list[ErrorRun]:
    """Markers whose usual score (M,) is below `least`, as one hint for each stiff part; one for all where they are a third of the body.

    A posture or a build that nobody else shows moves many markers at once, and says nothing of each.
    """
    low = np.nonzero(level < least)[0]
    parts = [low] if 3 * len(low) > np.count_nonzero(level) and len(low) > 2 else _parts(low, stiff_pairs([positions])[0])
    return [ErrorRun(0, len(positions) - 1, tuple(part.tolist()), MISPLACED, -float(level[part].min())) for part in parts if len(part)]


def _parts(markers: Ints, together: NDArray[np.bool_]) -> list[Ints]:
    """The markers in groups that hang together by pairs (M, M)."""
    _, number = connected_components(csr_array(together[np.ix_(markers, markers)]), directed=False)
    return [markers[number == part] for part in np.unique(number)]


def _exchanged_throughout(
    case: _Case, positions: Floats, reference: _ReferenceBody, evidence: _BodyEvidence
) -> tuple[list[ErrorRun], Floats, _BodyEvidence]:
    """Pairs that are exchanged in nearly every frame, the largest gain first; the corrected positions, and the evidence for these."""
    rules = case.rules
    runs: list[ErrorRun] = []
    if not case.several:
        return runs, positions, evidence
    pairs = pairs_of(positions.shape[1])
    for _ in range(positions.shape[1]):
        usual = evidence.usual_gains()
        nearly_all = evidence.gains_nearly_always()
        # Only where every recording of the person shows it, the body may differ instead of the labels.
        in_all = np.all(np.array([np.ones(len(pairs)), *case.siblings]) > 0.0, axis=0)
        # A pair that keeps its place in a stiff part of the person's other recordings is exchanged in all of them or in none.
        able = nearly_all & (in_all | ~case.settled)
        best = int(np.argmax(np.where(able, usual, 0.0)))
        if not able[best] or usual[best] < rules.always:
            break
        a, b = pairs[best].tolist()
        everywhere = bool(in_all[best])
        gain = float(usual[best]) * max(1.0, len(positions) / case.rate / rules.correlation)
        runs.append(ErrorRun(0, len(positions) - 1, (a, b), ALWAYS if everywhere else EXCHANGED, gain))
        positions = positions.copy()
        positions[:, [a, b]] = positions[:, [b, a]]
        # Exchanging one pair changes what all others gain.
        evidence = reference.score(positions)
    return runs, positions, evidence


def _error(run: ErrorRun, number: int, recording: Recording, subject: str, labels: Sequence[str]) -> LabelError:
    names = tuple(labels[m] for m in run.markers)
    count = run.last - run.first + 1
    words = sentence(run.kind, names, count / recording.rate, count, count == len(recording), subject)
    file = str(recording.metadata.get("file", f"recording {number + 1}"))
    return LabelError(number, file, subject, run.first, run.last, names, run.kind, run.gain, words)
