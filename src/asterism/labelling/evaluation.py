"""How well a model labels: recordings with known labels in; the thesis' rates, calibration and speed out (sections 5.2 and 5.3)."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from asterism.errors import AsterismError
from asterism.labelling.ensemble import SolverEnsemble
from asterism.labelling.partial.solver import subject_of
from asterism.labelling.simulated_occlusions import simulate_occlusions
from asterism.progress import Progress
from asterism.recording import Clouds, Floats, Ints, Recording

BINS = 20
"""Bins of equal width in which confidence is compared with the share that was right. Not tuned."""


@dataclass(frozen=True)
class Condition:
    """What came of labelling with so many markers hidden and so many ghosts added per frame. Rates are shares, 0 to 1.

    frames, visible, given  counts: frames, markers that could be seen, labels given
    right                   right labels among the visible markers
    fa                      false assignments: wrong among the labels given (thesis, section 5.3)
    fo                      false occlusions: nulls for visible markers among all nulls (thesis, section 5.3)
    missed                  visible markers that got no label
    perfect                 frames in which every visible marker is right and nothing else is given
    ece                     expected calibration error of the confidence of the labels given
    reliability             (mean confidence, share right, count) of each bin of confidence that has labels
    per_marker              name -> fa, fo, missed, assignments, nulls
    frames_per_second       one core, this machine
    evaluations_per_frame   feature evaluations
    """

    occlusions: int
    ghosts: int
    frames: int
    visible: int
    given: int
    right: float
    fa: float
    fo: float
    missed: float
    perfect: float
    ece: float
    reliability: list[tuple[float, float, int]]
    per_marker: dict[str, dict[str, float]]
    frames_per_second: float
    evaluations_per_frame: float


@dataclass(frozen=True)
class Evaluation:
    """Conditions tried on the same recordings; `subjects` says whose, `seen` whether the model had learned from them."""

    markers: tuple[str, ...]
    conditions: list[Condition]
    subjects: list[str]
    rules: str

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return asdict(self)


@dataclass
class _Tally:
    """Labels beside the truth, collected over recordings: (T, M) each."""

    truth: list[Ints]
    given: list[Ints]
    confidence: list[Floats]
    seconds: float = 0.0
    evaluations: int = 0


def evaluate(
    ensemble: SolverEnsemble,
    recordings: Sequence[Recording],
    *,
    occlusions: Sequence[int] = (0, 1, 2, 3, 4, 5),
    ghosts: Sequence[int] = (0,),
    seed: int = 0,
    rules: str = "whole-body",
    progress: Progress | None = None,
) -> Evaluation:
    """Hide labels, some markers and add ghosts; label; compare with the truth.

    recordings: labelled, with the ensemble's markers as columns. In every frame exactly so many visible markers are hidden, and so many
    ghosts put within 0.15 m of a marker; which, `seed` decides. Raises AsterismError where a recording's columns are not the ensemble's
    markers, or more markers should be hidden than there are.
    """
    tallies = _run_conditions(ensemble, recordings, occlusions, ghosts, seed, rules, progress)
    return _evaluation(tallies, ensemble.marker_set.names, _subjects(recordings, None), rules)


def leave_one_subject_out(
    recordings: Sequence[Recording],
    *,
    subjects: Sequence[str] | None = None,
    occlusions: Sequence[int] = (0, 1, 2, 3, 4, 5),
    ghosts: Sequence[int] = (0,),
    seed: int = 0,
    rules: str = "whole-body",
    progress: Progress | None = None,
    **fit_options: Any,
) -> Evaluation:
    """Train on all people but one, label that one, for each in turn: how well people are labelled whom nobody trained on.

    `fit_options` go to `SolverEnsemble.fit`; `miner` is "bottom-up" where the rules need partial solvers and no miner is named.
    Raises AsterismError where there are fewer than two people, or more markers should be hidden than there are.
    """
    whose = _subjects(recordings, subjects)
    people = list(dict.fromkeys(whose))
    if len(people) < 2:
        raise AsterismError("leaving one subject out needs recordings of at least two; name them with `subjects`, or put each in a folder.")
    _check_occlusions(occlusions, len(recordings[0].labels))
    if rules != "whole-body" and fit_options.get("miner") is None:
        fit_options["miner"] = "bottom-up"
    total: dict[tuple[int, int], _Tally] = {}
    names: tuple[str, ...] = ()
    for i, out in enumerate(people):
        report = _sub_progress(progress, i, len(people), f"without {out}")
        kept = [j for j, name in enumerate(whose) if name != out]
        ensemble = SolverEnsemble.fit(
            [recordings[j] for j in kept],
            subjects=[whose[j] for j in kept],
            seed=seed,
            progress=_sub_progress(report, 0, 2, "training"),
            **fit_options,
        )
        own = [recordings[j] for j, name in enumerate(whose) if name == out]
        report_labelling = _sub_progress(report, 1, 2, "labelling")
        for condition, tally in _run_conditions(ensemble, own, occlusions, ghosts, seed, rules, report_labelling).items():
            if condition not in total:
                total[condition] = tally
                continue
            known = total[condition]
            known.truth += tally.truth
            known.given += tally.given
            known.confidence += tally.confidence
            known.seconds += tally.seconds
            known.evaluations += tally.evaluations
        names = ensemble.marker_set.names
    return _evaluation(total, names, people, rules)


def expected_calibration_error(confidence: Floats, right: Any) -> tuple[float, list[tuple[float, float, int]]]:
    """Mean distance between confidence and the share that was right, over `BINS` bins weighted by their labels; and the bins."""
    bin_of = np.minimum((confidence * BINS).astype(int), BINS - 1)
    bins, error = [], 0.0
    for b in range(BINS):
        own = bin_of == b
        if own.any():
            stated, measured = float(confidence[own].mean()), float(right[own].mean())
            bins.append((stated, measured, int(own.sum())))
            error += abs(stated - measured) * own.mean()
    return float(error), bins


def _subjects(recordings: Sequence[Recording], subjects: Sequence[str] | None) -> list[str]:
    return list(subjects) if subjects is not None else [subject_of(recording) for recording in recordings]


def _check_occlusions(occlusions: Sequence[int], markers: int) -> None:
    for k in occlusions:
        if not 0 <= k <= markers:
            raise AsterismError(f"cannot hide {k} of {markers} markers; ask for 0 to {markers} occlusions.")


def _sub_progress(progress: Progress | None, index: int, count: int, what: str) -> Progress | None:
    """A progress that fills one of `count` equal parts of another."""
    if progress is None:
        return None
    outer: Progress = progress
    return lambda fraction, _: outer((index + fraction) / count, what)


def _run_conditions(
    ensemble: SolverEnsemble,
    recordings: Sequence[Recording],
    occlusions: Sequence[int],
    ghosts: Sequence[int],
    seed: int,
    rules: str,
    progress: Progress | None,
) -> dict[tuple[int, int], _Tally]:
    names = ensemble.marker_set.names
    for recording in recordings:
        if recording.labels != names:
            raise AsterismError(
                f"{recording.metadata.get('file', 'a recording')} has other columns than the model's {len(names)} markers; "
                "read it with the model's marker set."
            )
    _check_occlusions(occlusions, len(names))
    _warm_up(ensemble, recordings, rules)
    tallies = {(k, g): _Tally([], [], []) for g in ghosts for k in occlusions}
    done = 0
    for (k, g), tally in tallies.items():
        for r, recording in enumerate(recordings):
            clouds, truth = simulate_occlusions(recording, k, g, np.random.default_rng([seed, r, k, g]))
            start = time.perf_counter()
            labelling, evaluations = ensemble.label_counted(clouds, rules=rules)
            tally.seconds += time.perf_counter() - start
            tally.evaluations += int(evaluations.sum())
            tally.truth.append(truth)
            tally.given.append(labelling.indices)
            tally.confidence.append(labelling.confidence)
            done += 1
            if progress:
                progress(done / (len(tallies) * len(recordings)), "labelling")
    return tallies


def _warm_up(ensemble: SolverEnsemble, recordings: Sequence[Recording], rules: str) -> None:
    """Label two frames, so that compiling is not counted as labelling."""
    if recordings and len(recordings[0]):
        clouds: Clouds = recordings[0].frames(slice(0, 2)).clouds()
        ensemble.label(clouds, rules=rules)


def _evaluation(tallies: dict[tuple[int, int], _Tally], names: tuple[str, ...], subjects: list[str], rules: str) -> Evaluation:
    conditions = [_condition(k, g, tally, names) for (k, g), tally in tallies.items()]
    return Evaluation(names, conditions, list(dict.fromkeys(subjects)), rules)


def _condition(occlusions: int, ghosts: int, tally: _Tally, names: tuple[str, ...]) -> Condition:
    truth, given = np.concatenate(tally.truth), np.concatenate(tally.given)
    confidence = np.concatenate(tally.confidence)
    label, visible = given >= 0, truth >= 0
    right = label & (given == truth)
    ece, reliability = expected_calibration_error(confidence[label], right[label])

    def rates(which: Any) -> dict[str, float]:
        assignments, nulls, seen = label[:, which].sum(), (~label[:, which]).sum(), visible[:, which].sum()
        missed = (visible & ~label)[:, which].sum()
        return {
            "fa": float((label & ~right)[:, which].sum() / max(1, assignments)),
            "fo": float(missed / max(1, nulls)),
            "missed": float(missed / max(1, seen)),
            "assignments": int(assignments),
            "nulls": int(nulls),
        }

    everyone = rates(slice(None))
    return Condition(
        occlusions=occlusions,
        ghosts=ghosts,
        frames=len(truth),
        visible=int(visible.sum()),
        given=int(label.sum()),
        right=float(right.sum() / max(1, visible.sum())),
        fa=everyone["fa"],
        fo=everyone["fo"],
        missed=everyone["missed"],
        perfect=float((given == truth).all(axis=1).mean()) if len(truth) else 0.0,
        ece=ece,
        reliability=reliability,
        per_marker={name: rates([m]) for m, name in enumerate(names)},
        frames_per_second=len(truth) / max(tally.seconds, 1e-9),
        evaluations_per_frame=tally.evaluations / max(1, len(truth)),
    )
