"""A recording with gaps in; the same with filled samples, and what could not be filled, out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from asterism.errors import AsterismError
from asterism.findings import Finding, Severity
from asterism.motion.gaps.predict import RULES, GapRules, GapTrial, predict_gap
from asterism.motion.gaps.trials import trials_of_person
from asterism.progress import Progress
from asterism.recording import Floats, Ints, Recording, is_unnamed
from asterism.recording.filled import GapFill, filled_samples, logged_fills

_NORMAL_95 = 1.959964
_ENOUGH = 4
"""Markers that are there throughout a gap: three make axes, and one more tells the pose."""
_FEW = 6
"""Gaps that a sentence names."""


@dataclass(frozen=True)
class Filled:
    """A recording whose gaps are filled, as far as that is certain enough.

    recording  with the filled samples; its processing log names them (`asterism.recording.filled_samples`)
    filled     (T, M) whether a sample was filled
    deviation  (T, M) m, the standard deviation of each coordinate of a filled sample; NaN for others
    gaps       how many were filled
    findings   gaps that were not filled, and markers that are never seen, predicted from other trials or not
    trials     how many other trials of the person told of them
    """

    recording: Recording
    filled: NDArray[np.bool_]
    deviation: Floats
    gaps: int
    findings: tuple[Finding, ...]
    trials: int = 0

    @property
    def reach(self) -> float:
        """m, how far the widest 95 % interval of a coordinate reaches to either side; 0 where nothing was filled."""
        return _NORMAL_95 * float(np.nanmax(self.deviation, initial=0.0))

    def by_marker(self) -> dict[str, tuple[int, float]]:
        """For each marker of which something was filled, how many samples, and their largest standard deviation in m."""
        columns = [column for column in range(self.filled.shape[1]) if self.filled[:, column].any()]
        labels = self.recording.labels
        return {labels[c]: (int(self.filled[:, c].sum()), float(np.nanmax(self.deviation[:, c]))) for c in columns}


def fill_gaps(
    recording: Recording,
    *,
    limit: float = 0.010,
    others: Sequence[Recording] = (),
    rules: GapRules = RULES,
    wanted: NDArray[np.bool_] | None = None,
    by: str = "",
    progress: Progress | None = None,
) -> Filled:
    """Fill the gaps of named markers from the markers around them and from the path before and behind.

    limit   m: a gap is left where the 95 % interval of a coordinate reaches further than this to either side in one of its frames
    others  further recordings of the same person with the same markers, which show poses that the recording does not. A marker that the
            recording never shows is predicted from them. Those of other people are not asked (`trials_of_person`)
    wanted  (T, M) whether a sample may be filled, by default every one: a gap of which one may not is left, and not said
    by      what goes into the processing log, such as the program and its version

    Only measured samples tell others. Columns without a name (*1, *2) are neither filled nor used. A gap at either end is filled where
    the other markers show it. Samples that were measured stay as they are.
    A gap takes O(kernels x frames^3), 10 to 20 ms. Method: `asterism.motion.gaps.predict`.
    Raises AsterismError where the limit is no positive number, or no marker has a name.

    >>> from asterism.simulation import simulate_walks
    >>> [walk] = simulate_walks(subjects=1, frames=120)
    >>> positions = walk.positions.copy()
    >>> positions[40:60, 3] = np.nan
    >>> fill = fill_gaps(replace(walk, positions=positions))
    >>> fill.gaps, bool(fill.filled[40:60, 3].all()), fill.findings
    (1, True, ())
    """
    if not (np.isfinite(limit) and limit > 0.0):
        raise AsterismError(f"the limit of a fill's uncertainty is {limit} m; give a positive length, such as 0.010.")
    named = [column for column, label in enumerate(recording.labels) if not is_unnamed(label)]
    if not named:
        file = recording.metadata.get("file", "the recording")
        raise AsterismError(f"{file} has no named markers, whose gaps could be filled; label it first with `asterism label`.")
    told = trials_of_person(recording, others)
    trials = [_trial(one, [recording.labels[column] for column in named]) for one in (recording, *told)]
    positions, deviation = recording.positions.copy(), np.full(recording.positions.shape[:2], np.nan)
    fills, findings = list[GapFill](), list[Finding]()
    missing = [[piece for run in _runs(~recording.visible[:, c]) for piece in _pieces(run, trials[0].shown)] for c in named]
    total, done = max(sum(map(len, missing)), 1), 0
    if wanted is not None:
        missing = [[gap for gap in gaps if wanted[gap, column].all()] for column, gaps in zip(named, missing, strict=True)]
    for place, column in enumerate(named):
        label, left = recording.labels[column], list[tuple[Ints, float]]()
        unseen = not recording.visible[:, column].any()
        if unseen and not any(trial.seen[:, place].any() for trial in trials):
            findings += [_never_seen(recording, label)] if len(recording) else []
            continue
        for gap in missing[place]:
            if progress is not None:
                progress(done / total, f"filling {label}")
            done += 1
            answer = predict_gap(trials, place, gap, rules)
            reach = np.inf if answer is None else float(_NORMAL_95 * answer[1].max()) / 1000.0
            if answer is None or not reach <= limit:
                left.append((gap, reach))
                continue
            positions[gap, column], deviation[gap, column] = answer[0] / 1000.0, answer[1] / 1000.0
            times = recording.times[gap[[0, -1]]]
            fills.append(GapFill(label, float(times[0]), float(times[1]), float(answer[1].max()) / 1000.0))
        if unseen and np.isfinite(deviation[:, column]).any():
            findings.append(_predicted(recording, label, deviation[:, column], len(told)))
        if left:
            findings.append(_not_filled(recording, label, left, limit))
    filled = np.isfinite(deviation)
    result = replace(recording, positions=positions, origin=None if recording.origin is None else np.where(filled, -1, recording.origin))
    # Nothing was done to a recording without gaps.
    if fills:
        result = logged_fills(result, fills, by, limit, [str(one.metadata.get("file", "")) for one in told])
    return Filled(result, filled, deviation, len(fills), tuple(findings), len(told))


def _trial(recording: Recording, labels: Sequence[str]) -> GapTrial:
    """The measured samples of a recording in mm; NaN for others, also for what the processing log calls filled."""
    points = np.full((len(recording), len(labels), 3), np.nan)
    there = [place for place, label in enumerate(labels) if label in recording.labels]
    columns = [recording.labels.index(labels[place]) for place in there]
    points[:, there] = 1000.0 * np.where(np.isfinite(filled_samples(recording))[:, columns, None], np.nan, recording.positions[:, columns])
    return GapTrial.of(points, recording.rate)


def _runs(missing: NDArray[np.bool_]) -> list[Ints]:
    """Runs of consecutive frames in which something is missing."""
    frames = np.nonzero(missing)[0]
    return [run for run in np.split(frames, np.nonzero(np.diff(frames) > 1)[0] + 1) if len(run)]


def _pieces(gap: Ints, shown: NDArray[np.bool_]) -> list[Ints]:
    """A gap, halved for as long as too few markers are there throughout, and more in a half: shown (T, M)."""
    many = shown[gap].all(axis=0).sum()
    if many >= _ENOUGH or len(gap) < 2:
        return [gap]
    halves = [gap[: len(gap) // 2], gap[len(gap) // 2 :]]
    if max(shown[half].all(axis=0).sum() for half in halves) == many:
        return [gap]
    return [piece for half in halves for piece in _pieces(half, shown)]


def _never_seen(recording: Recording, label: str) -> Finding:
    where = recording.metadata.get("file", "the recording")
    return Finding(
        "gap-never-seen",
        Severity.WARNING,
        label,
        f"{where}: {label} is never seen, so that nothing shows where it sits; it was not filled.",
        "Look whether it was worn and labelled.",
    )


def _predicted(recording: Recording, label: str, deviation: Floats, trials: int) -> Finding:
    where, reach = recording.metadata.get("file", "the recording"), _NORMAL_95 * 1000.0 * float(np.nanmax(deviation))
    told = "one other trial" if trials == 1 else f"{trials} other trials"
    return Finding(
        "gap-predicted",
        Severity.WARNING,
        label,
        f"{where}: {label} is never seen; {int(np.isfinite(deviation).sum())} samples were predicted from {told} of the person, "
        f"within {reach:.0f} mm (95 %).",
        "Look whether it was worn in the same place; use its samples where nothing better is there.",
    )


def _not_filled(recording: Recording, label: str, left: Sequence[tuple[Ints, float]], limit: float) -> Finding:
    where = recording.metadata.get("file", "the recording")
    few = [_gap_text(recording, gap, reach) for gap, reach in left[:_FEW]] + (["..."] if len(left) > _FEW else [])
    what = "1 gap was" if len(left) == 1 else f"{len(left)} gaps were"
    return Finding(
        "gap-not-filled",
        Severity.WARNING,
        label,
        f"{where}: {what} not filled in {label}, being uncertain by more than {1000.0 * limit:g} mm (95 %): {', '.join(few)}.",
        "Look whether the markers around it are labelled there, or allow more.",
    )


def _gap_text(recording: Recording, gap: Ints, reach: float) -> str:
    first, last = recording.first_frame + int(gap[0]), recording.first_frame + int(gap[-1])
    frames = f"frame {first}" if first == last else f"frames {first} to {last}"
    return f"{frames} ({f'{1000.0 * reach:.0f} mm' if np.isfinite(reach) else 'too few samples around'})"
