"""`asterism motion`: recordings of points in; limbs, joints and joint angles, with their uncertainty, out."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Annotated, Any

import typer

from asterism.cli import _clinical, _console
from asterism.cli._command import takes
from asterism.cli._options import Files, Hip, Json, LowerBodyChoice, Markers, Measure, Overwrite, Report, Seed, Static, Vertical, Workers
from asterism.cli.segment import LimbCount, read_points
from asterism.errors import AsterismError

if TYPE_CHECKING:
    from asterism.cameras import Rig
    from asterism.cli._clinical import MonteCarloOptions
    from asterism.motion.analysis import MotionAnalysis, MotionRules
    from asterism.motion.clinical import ClinicalAngles, ClinicalErrors, ClinicalUncertainty
    from asterism.motion.uncertainty import CalibrationErrors, ErrorSources, MeasurementNoise, UncertaintyResult
    from asterism.recording import Floats, Recording


class LimbMethod(StrEnum):
    """How the motion of a limb is estimated from its points."""

    ROBUST = "robust"
    SVD = "svd"
    PCT = "pct"
    PCT_HALF_MEAN = "pct-half-mean"
    INTERVAL_DEFORMATION = "interval-deformation"


class JointMethod(StrEnum):
    """How the centre of a joint is found."""

    SCORE = "score"
    SPHERE = "sphere"


@dataclass(frozen=True)
class MotionOptions:
    """What `asterism motion` is asked to do."""

    files: Files
    limbs: LimbCount = None
    markers: Markers = None
    method: Annotated[LimbMethod, typer.Option("--method", help="How points are weighed: see docs/motion.md.")] = LimbMethod.ROBUST
    joints: Annotated[JointMethod, typer.Option("--joints", help="How joint centres are found.")] = JointMethod.SCORE
    anatomy: Annotated[
        bool | None,
        typer.Option(
            "--anatomy/--no-anatomy",
            help="Clinical angles of hip, knee and ankle. By itself where Helen Hayes or Plug-in-Gait markers are there.",
            show_default=False,
        ),
    ] = None
    static: Static = None
    measure: Measure = field(default_factory=list)
    lower_body: LowerBodyChoice = None
    hip: Hip = None
    uncertainty: Annotated[bool, typer.Option("--uncertainty", help="Also say how uncertain each angle is, by Monte Carlo.")] = False
    trials: Annotated[int, typer.Option("--trials", metavar="N", min=10, help="Monte Carlo trials at most.")] = 1000
    rig: Annotated[
        Path | None,
        typer.Option("--rig", metavar="FILE", help="The rig that measured the points, for their noise.", show_default=False),
    ] = None
    covariance: Annotated[
        Path | None,
        typer.Option(
            "--covariance", metavar="NPZ", help="The rig's covariance, of asterism garment calibrate --covariance.", show_default=False
        ),
    ] = None
    soft_tissue: Annotated[
        float, typer.Option("--soft-tissue", metavar="FACTOR", min=0, help="Soft tissue by so much larger than usual; 0: none.")
    ] = 1.0
    placement: Annotated[
        float,
        typer.Option("--placement", metavar="MM", min=0, help="How far markers of clinical angles are misplaced, standard deviation."),
    ] = 10.0
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="FILE", help="Write the angles over time as CSV.", show_default=False)
    ] = None
    seed: Seed = 0
    workers: Workers = 1
    vertical: Vertical = None
    overwrite: Overwrite = False
    report: Report = None
    json: Json = None


@dataclass(frozen=True)
class MotionResult:
    """What was found in one file."""

    path: Path
    analysis: MotionAnalysis
    certain: UncertaintyResult | None
    clinical: ClinicalAngles | None
    legs: ClinicalUncertainty | None


@takes(MotionOptions)
def motion(options: MotionOptions) -> None:
    """Find joints and joint angles, and how certain they are.

    From the points' trajectories alone, or by the segments of a marker set (--markers). Angles count from the first frame in which both
    limbs are seen. With --uncertainty each angle gets nominal 65 and 95 % intervals, and a budget: what cameras and soft tissue add. They
    are those of a model of errors, tried on simulated skin only. Where the markers of Helen Hayes or Plug-in-Gait are seen, flexion,
    adduction and rotation of hip, knee and ankle are given too, of both sides; misplaced markers count in them. The CSV and the JSON file
    are written between the files, too: a run that is broken off leaves the files that were done.
    """
    from asterism.cli._folders import recordings_of
    from asterism.motion.analysis import MotionRules

    _console.check_outputs(
        [options.report, options.json, options.output],
        [*options.files, options.rig, options.static, *_clinical.measure_files(options.measure)],
        options.overwrite,
    )
    # a covariance belongs to the cameras of a rig, by their names
    if options.covariance is not None and options.rig is None:
        raise AsterismError("--covariance belongs to a rig; give its file with --rig.")
    batch = _console.Batch("analysed")
    results: list[MotionResult] = []
    # read once: the same cameras measured all files
    cameras = _cameras(options)
    _clinical.given_measures(options.measure)
    static = None if options.static is None else read_points(options.static, options.vertical, batch)
    rules = MotionRules(method=options.method.value, joint_method=options.joints.value)
    saving = _Saving(options, batch, results)
    try:
        for path in recordings_of(options.files, batch):
            with batch.file(path):
                results.append(_analysed(path, options, cameras, rules, static, batch))
            saving.once_in_a_while()
    except KeyboardInterrupt:
        # what was done is not lost with the rest
        saving.now(complete=False)
        raise
    if not results:
        raise typer.Exit(batch.close())
    saving.now(complete=True)
    raise typer.Exit(batch.close())


def _analysed(
    path: Path, options: MotionOptions, cameras: Cameras, rules: MotionRules, static: Recording | None, batch: _console.Batch
) -> MotionResult:
    """Analyse one file, and print what was found."""
    from asterism.cli._recordings import one_person
    from asterism.motion.analysis import analyse_motion
    from asterism.motion.clinical import exchanged_finding
    from asterism.motion.uncertainty import estimate_uncertainty

    # unlabelled points serve: limbs are what moves together
    recording = one_person(read_points(path, options.vertical, batch), batch)
    measures, doubtful = _clinical.measures_of(recording, static, options.measure, options.hip)
    limbs, clinical = _limbs(options, recording), _clinical.find(recording, options.anatomy, measures, static, options.lower_body)
    with _console.progress("motion") as progress:
        analysis = analyse_motion(recording, limbs, rules=rules, progress=progress)
        certain, legs = None, None
        if options.uncertainty:
            trials = _monte_carlo(options, progress)
            # only on demand: each trial finds the joints anew
            certain = estimate_uncertainty(analysis, _sources(options, cameras, analysis), seed=options.seed, **trials)
            legs = _clinical.certain(recording, clinical, _of_legs(options, cameras, recording, certain), options.seed, trials)
    # what is uncertain about the angles is said beside what is wrong with the points
    sides = exchanged_finding(recording) if clinical is not None else []
    lacking = clinical.findings if clinical is not None else ()
    for finding in [*analysis.findings, *sides, *doubtful, *lacking, *(certain.findings if certain else ())]:
        batch.found(finding)
    if options.json != "-":
        show(path, analysis, certain)
        _clinical.show(path, clinical, legs)
    return MotionResult(path, analysis, certain, clinical, legs)


_SHARE_OF_TIME = 10.0
"""Of the time that the files take, saving between them takes one part in so many at most: each saving writes all files' angles again."""


class _Saving:
    """Writes the angles of the files that are done, at the end and between: a run that is killed has written most of them."""

    def __init__(self, options: MotionOptions, batch: _console.Batch, results: list[MotionResult]) -> None:
        self._options, self._batch, self._results = options, batch, results
        self._last, self._took = monotonic(), 0.0

    def once_in_a_while(self) -> None:
        """Write the CSV and the JSON of what is done, where there is time for it."""
        if monotonic() - self._last >= _SHARE_OF_TIME * self._took:
            begun = monotonic()
            self._tables(complete=False)
            self._last = monotonic()
            self._took = self._last - begun

    def now(self, *, complete: bool) -> None:
        """Write all that was asked for."""
        if not self._results:
            return
        self._tables(complete)
        if self._options.report is not None:
            from asterism.recording.display import short_names
            from asterism.report.motion import motion_report

            names = short_names([one.path for one in self._results])
            shown = [(name, one.analysis, one.certain) for name, one in zip(names, self._results, strict=True)]
            motion_report(self._options.report, shown, clinical=[(one.clinical, one.legs) for one in self._results])
        if not complete and (self._options.json not in (None, "-") or self._options.output or self._options.report):
            from asterism.recording.display import counted

            _console.notice(
                f"{counted(len(self._results), 'file')} had been analysed and {'is' if len(self._results) == 1 else 'are'} written."
            )

    def _tables(self, complete: bool) -> None:
        options, results, batch = self._options, self._results, self._batch
        if not results:
            return
        if options.output is not None:
            _write_angles(options.output, results)
        # standard output has one JSON, at the end
        if options.json is None or (options.json == "-" and not complete):
            return
        content = {
            "command": "motion",
            "complete": complete,
            "seed": options.seed,
            "files": [
                {"file": one.path, **as_dict(one.analysis, one.certain), **_clinical.as_dict(one.clinical, one.legs)} for one in results
            ],
            "failed": batch.failed,
            "findings": [finding.to_dict() for finding in batch.findings],
        }
        _console.write_json(options.json, content)


def _limbs(options: MotionOptions, recording: Recording) -> dict[str, list[str]] | int | None:
    """The segments of the marker set that have three markers in the recording; else the number of limbs that was given."""
    # without a marker set, limbs are what moves together
    if options.markers is None:
        return options.limbs
    if options.limbs is not None:
        raise AsterismError("--limbs and --markers both say what the limbs are; give one of them.")
    from asterism.cli._recordings import marker_set_of

    marker_set = marker_set_of(options.markers)
    assert marker_set is not None
    # labels of the file may be other spellings of the set's names
    columns = dict(zip(marker_set.names, marker_set.columns_of(recording.labels), strict=True))
    limbs = {
        name: [recording.labels[columns[marker]] for marker in markers if columns[marker] >= 0]
        for name, markers in marker_set.segments.items()
    }
    # two markers tell no rotation
    kept = {name: markers for name, markers in limbs.items() if len(markers) >= 3}
    if not kept:
        raise AsterismError(
            f"{recording.metadata.get('file', 'recording')}: no segment of {options.markers} has three markers; let limbs be found instead."
        )
    return kept


@dataclass(frozen=True)
class Cameras:
    """The rig that measured the points, and the errors of its calibration; None where they are not given."""

    rig: Rig | None
    calibration: CalibrationErrors | None

    def noise(self, positions: Floats) -> MeasurementNoise | None:
        """The noise of points (T, N, 3) m, as far as the rig tells it."""
        from asterism.motion.uncertainty import noise_from_rig

        return None if self.rig is None else noise_from_rig(self.rig, positions)


def _cameras(options: MotionOptions) -> Cameras:
    """What `--rig` and `--covariance` name."""
    if options.rig is None:
        return Cameras(None, None)
    from asterism.cameras.files import read_rig
    from asterism.motion.uncertainty import CalibrationErrors

    rig = read_rig(options.rig)
    if options.covariance is None:
        return Cameras(rig, None)
    from asterism.garment.rig_covariance import RigCovariance

    # the errors of cameras belong together, and so the covariance is of all of them
    known = RigCovariance.load(options.covariance)
    return Cameras(rig, CalibrationErrors(rig.select(known.names), known.free, known.matrix))


def _sources(options: MotionOptions, cameras: Cameras, analysis: MotionAnalysis) -> ErrorSources:
    from dataclasses import replace

    from asterism.motion.uncertainty import ErrorSources, SoftTissueErrors

    # the factor scales what the literature measured, low and high alike
    usual = SoftTissueErrors()
    low, high = (options.soft_tissue * scale for scale in usual.scales)
    soft = replace(usual, scales=(low, high)) if options.soft_tissue > 0 else None
    return ErrorSources(noise=cameras.noise(analysis.recording.positions), calibration=cameras.calibration, soft_tissue=soft)


def _of_legs(options: MotionOptions, cameras: Cameras, recording: Recording, certain: UncertaintyResult) -> ClinicalErrors:
    """The errors of the clinical angles, by the sources of `certain`."""
    from asterism.motion.clinical import ClinicalErrors, SkinMotion
    from asterism.motion.uncertainty import MeasurementNoise

    return ClinicalErrors(
        noise=cameras.noise(recording.positions) or MeasurementNoise(certain.noise),
        calibration=cameras.calibration,
        skin=SkinMotion().times(options.soft_tissue) if options.soft_tissue > 0 else None,
        placement_m=options.placement / 1000 if options.placement > 0 else None,
    )


def _monte_carlo(options: MotionOptions, progress: Any) -> MonteCarloOptions:
    from asterism.motion.uncertainty import MonteCarloRules

    # two blocks at least: the second one says whether the first was enough
    rules = MonteCarloRules(most=options.trials, block=min(100, max(options.trials // 2, 2)))
    return {"rules": rules, "budget_trials": min(options.trials, 200), "workers": options.workers, "progress": progress}


def show(path: Path, analysis: MotionAnalysis, certain: UncertaintyResult | None) -> None:
    """Print a table of the joints of one file."""
    import numpy as np

    from asterism.motion.uncertainty.budget import SOURCES, TRIED_ON
    from asterism.recording.display import counted

    rows = []
    for number, joint in enumerate(analysis.angles):
        fitted = analysis.skeleton.joints[joint.child]
        assert fitted is not None
        row = [
            joint.name,
            fitted.kind,
            f"{np.degrees(np.nanmax(joint.angle)):.1f}",
            f"{np.degrees(np.ptp(joint.flexion[_known(joint.flexion)])):.1f}",
        ]
        # one number for a centre: the root of the sum of its variances
        row.append(f"{1000 * float(np.sqrt(np.trace(fitted.covariance))):.1f}")
        if certain is not None:
            one = certain.joints[number]
            row += [f"{np.degrees(np.nanmax(part)):.2f}" for part in (one.angle_standard, *one.budget.values())]
        rows.append(row)
    head = ["joint", "kind", "largest angle (°)", "range (°)", "centre ± (mm)"]
    head += ["angle ± (°)", *SOURCES, "flexion ± (°)"] if certain else []
    limbs = f"{counted(len(analysis.names), 'limb')}: " + ", ".join(
        f"{name} ({counted(int((analysis.limb_of == k).sum()), 'point')})" for k, name in enumerate(analysis.names)
    )
    _console.table(f"{path}: {limbs}", head, rows, left=2)
    if certain is not None:
        said = "± is the largest standard uncertainty over the frames"
        _console.result(f"{counted(certain.trials, 'trial')}; {said}; noise of a point {1000 * certain.noise:.2f} mm.")
        _console.result(TRIED_ON)


def _known(values: Any) -> Any:
    import numpy as np

    return np.isfinite(values)


def as_dict(analysis: MotionAnalysis, certain: UncertaintyResult | None) -> dict[str, Any]:
    """The limbs, joints and angles as JSON has them: degrees and metres."""
    import numpy as np

    from asterism.motion.uncertainty.budget import TRIED_ON

    joints = []
    for number, joint in enumerate(analysis.angles):
        fitted = analysis.skeleton.joints[joint.child]
        assert fitted is not None
        entry: dict[str, Any] = {
            "parent": analysis.names[joint.parent],
            "child": analysis.names[joint.child],
            "kind": fitted.kind,
            "centre_sigma_m": float(np.sqrt(np.trace(fitted.covariance))),
            "angle_deg": np.degrees(joint.angle),
            "flexion_deg": np.degrees(joint.flexion),
        }
        if certain is not None:
            one = certain.joints[number]
            entry["angle_standard_deg"] = np.degrees(one.angle_standard)
            entry["angle_intervals_deg"] = {f"{p:g}": [np.degrees(low), np.degrees(high)] for p, (low, high) in one.angle_intervals.items()}
            entry["flexion_intervals_deg"] = {
                f"{p:g}": [np.degrees(low), np.degrees(high)] for p, (low, high) in one.flexion_intervals.items()
            }
            entry["flexion_budget_deg"] = {name: np.degrees(part) for name, part in one.budget.items()}
        joints.append(entry)
    limbs = [
        {"name": name, "points": [analysis.recording.labels[n] for n in np.nonzero(analysis.limb_of == k)[0]]}
        for k, name in enumerate(analysis.names)
    ]
    log = [str(step) for step in analysis.recording.log]
    trials: dict[str, Any] = {}
    if certain is not None:
        trials = {"trials": certain.trials, "converged": certain.converged, "noise_m": certain.noise, "intervals_tried_on": TRIED_ON}
    return {"frames": len(analysis.recording), "limbs": limbs, "joints": joints, "log": log, **trials}


def _write_angles(target: Path, results: list[MotionResult]) -> None:
    """A CSV table, a row for each file, joint and frame; clinical angles have no angle since a frame, but adduction and rotation."""
    import numpy as np

    rows: list[list[str]] = []
    # one header for all files: columns that a file lacks stay empty
    wide = any(one.certain is not None for one in results)
    ends = ["angle_low95_deg", "angle_high95_deg", "flexion_low95_deg", "flexion_high95_deg"] if wide else []
    clinical = any(one.clinical is not None for one in results)
    more = _clinical.columns(wide) if clinical else []
    head = ["file", "joint", "time_s", "angle_deg", "flexion_deg", *ends, *more]
    for one in results:
        times = one.analysis.recording.times
        # clinical angles have no angle of the whole joint, and the others no adduction
        nothing = np.full(len(times), np.nan)
        blocks = [
            (joint.name, [joint.angle, joint.flexion, *_ends(one.certain, number), *[nothing] * len(more)])
            for number, joint in enumerate(one.analysis.angles)
        ]
        for number, leg in enumerate(one.clinical.joints if one.clinical is not None else ()):
            (flexion, *bounds), others = _clinical.values(leg, one.legs.joints[number] if one.legs is not None else None)
            blocks.append((leg.name, [nothing, flexion, *([nothing, nothing, *bounds] if wide else []), *others]))
        for name, columns in blocks:
            for time, *values in zip(times, *columns, strict=True):
                shown = ["" if np.isnan(value) else f"{np.degrees(value):.4f}" for value in values]
                rows.append([str(one.path), name, f"{time:.4f}", *shown])
    _console.write_csv(target, head, rows)


def _ends(certain: UncertaintyResult | None, number: int) -> list[Floats]:
    """The ends of the 95 % intervals of a joint's angle and flexion."""
    if certain is None:
        return []
    joint = certain.joints[number]
    return [*joint.angle_intervals[0.95], *joint.flexion_intervals[0.95]]
