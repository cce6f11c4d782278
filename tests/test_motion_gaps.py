"""Gaps at each place of a recording, through each public function of `asterism.motion` and its commands: a number, NaN or a sentence.

No function may end in another exception than AsterismError, and none may warn (the suite turns warnings into errors).
"""

from __future__ import annotations

import importlib
import json
import pkgutil
import re
import warnings
from collections.abc import Callable
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_clinical import standing

import asterism.motion
from asterism import AsterismError, Recording, formats
from asterism.cli import main
from asterism.motion import analyse_motion, joint_angles, smooth_paths
from asterism.motion.analysis import MotionRules
from asterism.motion.clinical import (
    ClinicalErrors,
    SubjectMeasures,
    clinical_angles,
    clinical_uncertainty,
    complete_legs,
    exchanged_finding,
    exchanged_pairs,
    gathered_measures,
    inverse_dynamics,
    leg_measures,
    lower_body,
    subject_measures,
    with_static_offsets,
)
from asterism.motion.events import MovementRules, find_movement, movement_table, shipped_movements
from asterism.motion.gaps import fill_gaps, marker_difference, trials_of_person
from asterism.motion.joints import cardan_angles, find_skeleton, fit_joint, functional_flexion, grood_suntay, joint_rotation, leg_frames
from asterism.motion.rigid import (
    METHODS,
    angular_velocity,
    estimate_limb_motion,
    helical_axes,
    quaternions,
    relative_rotations,
    rotation_vectors,
)
from asterism.motion.segmentation import segment_limbs
from asterism.motion.uncertainty import (
    ErrorSources,
    MeasurementNoise,
    MonteCarloRules,
    estimate_uncertainty,
    first_order_angles,
    noise_from_rig,
    run_monte_carlo,
    shortest_interval,
)
from asterism.recording import Clouds
from asterism.simulation.cameras import ring_rig

FRAMES = 12
LIMBS = {"thigh": ["P1", "P2", "P3", "P4"], "shank": ["P5", "P6", "P7", "P8"], "foot": ["P9", "P10", "P11", "P12"]}
FEW = MonteCarloRules(block=6, most=6)


def walking() -> np.ndarray:
    """(12, 12, 3) m: three limbs of four points each, which turn against each other."""
    rng = np.random.default_rng(2)
    places = rng.normal(0, 0.08, (3, 4, 3)) - np.array([[[0, 0, 0.0]], [[0, 0, 0.4]], [[0, 0, 0.8]]])
    time = np.linspace(0, 3, FRAMES)
    thigh = Rotation.from_rotvec(np.stack([0.2 * np.sin(time), 0.4 * np.cos(time), 0.1 * time], axis=1))
    shank = thigh * Rotation.from_rotvec(np.stack([0.1 * time, 0.6 * np.sin(time), 0 * time], axis=1))
    foot = shank * Rotation.from_rotvec(np.stack([0 * time, 0.3 * time, 0.2 * np.sin(time)], axis=1))
    limbs = [turn.as_matrix() @ limb.T for turn, limb in zip((thigh, shank, foot), places, strict=True)]
    return np.concatenate([limb.swapaxes(1, 2) for limb in limbs], axis=1) + rng.normal(0, 0.0005, (FRAMES, 12, 3)) + [0, 0, 1.5]


def _hidden(frames: slice, points: slice) -> Callable[[np.ndarray], np.ndarray]:
    def hide(positions: np.ndarray) -> np.ndarray:
        positions[frames, points] = np.nan
        return positions

    return hide


def _line(positions: np.ndarray) -> np.ndarray:
    positions[:, 4:8] = positions[:, 4:5] + np.linspace(0, 0.3, 4)[None, :, None] * [1.0, 1.0, 0.0]
    return positions


def _nearly_a_line(positions: np.ndarray) -> np.ndarray:
    noise = np.random.default_rng(5).normal(0, 0.002, (FRAMES, 4, 3))
    return _line(positions) + np.concatenate([np.zeros((FRAMES, 4, 3)), noise, np.zeros((FRAMES, 4, 3))], axis=1)


def _coincident(positions: np.ndarray) -> np.ndarray:
    positions[:, 5:8] = positions[:, 4:5]
    return positions


def _alternating(positions: np.ndarray) -> np.ndarray:
    positions[: FRAMES // 2, 4:8] = np.nan
    positions[FRAMES // 2 :, 8:] = np.nan
    return positions


EVERY = slice(None)
GAPS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "none": lambda positions: positions,
    "a marker never seen": _hidden(EVERY, slice(4, 5)),
    "one frame without any": _hidden(slice(5, 6), EVERY),
    "a limb with three points": _hidden(EVERY, slice(7, 8)),
    "a limb with two points": _hidden(EVERY, slice(4, 6)),
    "a limb with one point": _hidden(EVERY, slice(4, 7)),
    "a limb with none": _hidden(EVERY, slice(4, 8)),
    "two points of a limb missing for a while": _hidden(slice(3, 7), slice(4, 6)),
    "the first frame": _hidden(slice(0, 1), slice(4, 8)),
    "the last frame": _hidden(slice(FRAMES - 1, FRAMES), slice(4, 8)),
    "a limb from half-way": _hidden(slice(0, FRAMES // 2), slice(4, 8)),
    "a limb in two frames": _hidden(slice(2, FRAMES), slice(4, 8)),
    "limbs in turn": _alternating,
    "a marker in the first frame only": lambda positions: _hidden(slice(1, FRAMES), slice(0, 1))(
        _hidden(slice(0, 1), slice(8, 12))(positions)
    ),
    "one frame": lambda positions: positions[:1],
    "two frames": lambda positions: positions[:2],
    "three frames": lambda positions: positions[:3],
    "no frame": lambda positions: positions[:0],
    "all missing": _hidden(EVERY, EVERY),
    "all in one place": lambda positions: np.zeros_like(positions),
    "points of a limb in one place": _coincident,
    "points of a limb in a line": _line,
    "points of a limb nearly in a line": _nearly_a_line,
    "nothing moves": lambda positions: np.repeat(positions[:1], FRAMES, axis=0),
}


@cache
def rig() -> object:
    return ring_rig(4, radius=4.0, height=2.0, size=(1280, 1024), rng=np.random.default_rng(0))


def attempt(call: Callable[[], object]) -> object:
    """What it gives; None where it refuses in a sentence. Whatever else happens fails the test."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            return call()
        except AsterismError as problem:
            sentence = str(problem)
            assert len(sentence) > 20 and "Error" not in sentence, sentence
            return None


@pytest.mark.parametrize("gap", GAPS)
def test_limbs_and_joints_of_points_with_gaps(gap: str) -> None:
    positions = GAPS[gap](walking())
    parts = [positions[:, 4 * k : 4 * k + 4] for k in range(3)]
    for method in METHODS:
        motions = [attempt(lambda part=part, method=method: estimate_limb_motion(part, method)) for part in parts]
        for motion, part in zip(motions, parts, strict=True):
            if motion is None:
                continue
            known = np.isfinite(motion.rotations[:, 0, 0])
            assert (known <= (np.isfinite(part[:, :, 0]).sum(axis=1) >= 3)).all() and known.any()
            assert (motion.weights[known].sum(axis=1) > 0).all(), "a rotation has points that it rests on"
    fitted = [(motion, part) for motion, part in zip(motions, parts, strict=True) if motion is not None]
    attempt(lambda: find_skeleton([motion for motion, _ in fitted], [part for _, part in fitted]))
    attempt(lambda: segment_limbs(positions))
    attempt(lambda: segment_limbs(positions, 3, method="lsa"))
    for (one, _), (other, points) in pairwise(fitted):
        attempt(lambda one=one, other=other: fit_joint(one, other))
        attempt(lambda one=one, other=other, points=points: fit_joint(one, other, near=points[:, 0], points=points, method="sphere"))
        angles = attempt(lambda one=one, other=other: joint_angles(one, other))
        if angles is not None:
            first = attempt(lambda one=one, other=other, angles=angles: first_order_angles(angles, one, other, 0.001))
            assert (np.isfinite(first.standard) == np.isfinite(angles.angle)).all()
    attempt(lambda: noise_from_rig(rig(), positions))


@pytest.mark.parametrize("gap", GAPS)
def test_rotations_with_gaps(gap: str) -> None:
    turns = np.repeat(np.eye(3)[None], FRAMES, axis=0)
    turns[:] = Rotation.from_rotvec(np.linspace(0, 1, FRAMES)[:, None] * [0.2, 0.4, 0.1]).as_matrix()
    hidden = np.isnan(GAPS[gap](walking())[:, 4:8]).any(axis=(1, 2))
    parent = turns[: len(hidden)].copy()
    child = parent.copy()
    child[hidden] = np.nan
    for call in (rotation_vectors, quaternions, cardan_angles, lambda given: angular_velocity(given, 50.0)):
        values = attempt(lambda call=call: call(child))
        assert np.isnan(values[hidden]).all()
    for call in (relative_rotations, joint_rotation, grood_suntay):
        assert (
            np.isnan(attempt(lambda call=call: call(parent, child))).all(axis=tuple(range(1, np.ndim(call(parent, child))))) == hidden
        ).all()
    attempt(lambda: helical_axes(child, np.zeros((len(child), 3))))
    attempt(lambda: functional_flexion(child))
    for frame in (0, len(child) - 1, FRAMES):
        attempt(lambda frame=frame: joint_rotation(parent, child, zero=frame))


def test_rotations_that_are_none_are_refused_in_a_sentence() -> None:
    mirrored, good = np.diag([1.0, 1.0, -1.0])[None], np.eye(3)[None]
    calls = [lambda: rotation_vectors(mirrored), lambda: quaternions(np.zeros((2, 3, 3))), lambda: relative_rotations(good, np.eye(3)),
             lambda: grood_suntay(good, np.tile(good, (2, 1, 1))), lambda: cardan_angles(np.eye(3)), lambda: functional_flexion(np.eye(3)),
             lambda: helical_axes(good, np.zeros(3))]  # fmt: skip
    for call in calls:
        with pytest.raises(AsterismError):
            call()


@pytest.mark.parametrize("given", [True, False], ids=["limbs given", "limbs found"])
@pytest.mark.parametrize("gap", GAPS)
def test_angles_of_a_recording_with_gaps_and_their_uncertainty(gap: str, given: bool) -> None:
    recording = Recording(GAPS[gap](walking()), tuple(f"P{i + 1}" for i in range(12)), 50.0)
    for rules in (MotionRules(), MotionRules("pct-half-mean", "sphere")):
        analysis = attempt(lambda rules=rules: analyse_motion(recording, LIMBS if given else 3, rules=rules))
        if analysis is None:
            continue
        assert {finding.code for finding in analysis.findings} <= {
            "motion-points-missing", "motion-points-unused", "motion-joint-still", "motion-limb-left-out", "motion-limb-alone",
            "motion-fewer-limbs",
        }  # fmt: skip
        for sources in (None, ErrorSources(noise=attempt(lambda: noise_from_rig(rig(), recording.positions)))):
            certain = estimate_uncertainty(analysis, sources, rules=FEW, budget_trials=4)
            for joint, angles in zip(certain.joints, analysis.angles, strict=True):
                known = np.isfinite(angles.angle)
                shown = [joint.angle_standard, joint.first_order.standard, *joint.angle_intervals[0.95]]
                shown += [joint.flexion_standard, *joint.budget.values(), *joint.angle_budget.values(), *joint.flexion_intervals[0.65]]
                assert all((np.isfinite(values) == known).all() for values in shown)


@pytest.mark.parametrize("gap", ["a limb with two points", "a limb in two frames"])
def test_limbs_that_can_be_told_are_told_in_spite_of_the_others(gap: str) -> None:
    recording = Recording(GAPS[gap](walking()), tuple(f"P{i + 1}" for i in range(12)), 50.0)
    analysis = analyse_motion(recording, LIMBS)
    assert [joint.name for joint in analysis.angles] == ["thigh / foot"]
    assert np.isfinite(analysis.angles[0].angle).all()
    warned = [finding.where for finding in analysis.findings if finding.code in ("motion-limb-left-out", "motion-limb-alone")]
    assert warned == ["shank"]


def test_a_joint_is_found_where_the_fullest_frame_lacks_one_of_its_limbs() -> None:
    rng = np.random.default_rng(3)
    turns = Rotation.from_rotvec(np.linspace(0, 1, FRAMES)[:, None] * [0.2, 0.7, 0.0]).as_matrix()
    trunk = np.tile(rng.normal(0, 0.1, (12, 3)), (FRAMES, 1, 1))
    thigh = np.einsum("tij,nj->tni", turns, rng.normal(0, 0.1, (4, 3)) - [0, 0, 0.3])
    trunk[1:, 3:], thigh[0] = np.nan, np.nan
    skeleton = find_skeleton([estimate_limb_motion(limb) for limb in (trunk, thigh)], [trunk, thigh])
    assert skeleton.pairs == ((0, 1),)


def test_limbs_that_are_seen_in_turn_are_joined_through_the_third() -> None:
    recording = Recording(_alternating(walking()), tuple(f"P{i + 1}" for i in range(12)), 50.0)
    analysis = analyse_motion(recording, LIMBS)
    assert sorted(joint.name for joint in analysis.angles) == ["thigh / foot", "thigh / shank"]
    for joint in analysis.angles:
        assert np.isfinite(joint.angle).sum() == FRAMES // 2


MARKERS = ("LASI", "RASI", "SACR", "LTHI", "LKNE", "LTIB", "LANK", "LTOE")


HEAVY = SubjectMeasures(mass=60.0)


@pytest.mark.parametrize("frames", ["all", "first", pytest.param("last", marks=pytest.mark.slow)])
@pytest.mark.parametrize("marker", MARKERS)
def test_clinical_angles_with_a_marker_missing(marker: str, frames: str) -> None:
    recording = standing((30, 5, -8), (60, -3, 6))
    positions = np.repeat(recording.positions[:1], 6, axis=0)
    where = {"all": slice(None), "first": slice(0, 1), "last": slice(5, 6)}[frames]
    for place in (np.nan, positions[:, recording.labels.index("LKNE" if marker != "LKNE" else "LTHI")][where]):
        changed = positions.copy()
        changed[where, recording.labels.index(marker)] = place
        holed = Recording(changed, recording.labels, 100.0)
        for side in "LR":
            attempt(lambda holed=holed, side=side: leg_frames(holed, side))
            attempt(lambda holed=holed, side=side: leg_measures(holed, side))
            body = attempt(lambda holed=holed, side=side: lower_body(holed, SubjectMeasures(), side))
            if body is not None:
                attempt(lambda holed=holed, body=body, side=side: inverse_dynamics(holed, body, (), (), {side: [(-1, 1)]}, HEAVY))
        # one that is told names a pair
        pairs, finding = attempt(lambda holed=holed: exchanged_pairs(holed)), attempt(lambda holed=holed: exchanged_finding(holed))
        assert bool(pairs) == bool(finding)
        told = attempt(lambda holed=holed: with_static_offsets(holed, subject_measures(holed)))
        assert attempt(lambda holed=holed: trials_of_person(holed, [recording])) in ([], [recording])
        attempt(lambda holed=holed: marker_difference(holed, recording))
        attempt(lambda holed=holed: gathered_measures(holed, recording, {"LLegLength": 850}))
        assert told is None or np.isfinite([told.left.shank_rotation, told.left.tibial_torsion, told.left.foot_flexion]).all()
        for sides in (complete_legs(holed), "L"):
            clinical = attempt(lambda holed=holed, sides=sides: clinical_angles(holed, sides))
            if clinical is None:
                continue
            errors = ClinicalErrors(noise=MeasurementNoise(0.001))
            certain = clinical_uncertainty(holed, clinical, errors, rules=FEW, budget_trials=4)
            for one, joint in zip(certain.joints, clinical.joints, strict=True):
                assert (np.isfinite(one.standard) == np.isfinite(joint.angles)).all()


@pytest.mark.parametrize("frames", [0, 1])
def test_clinical_angles_of_no_frame_and_of_one(frames: int) -> None:
    recording = standing((30, 5, -8), (60, -3, 6))
    short = Recording(recording.positions[:frames], recording.labels, 100.0)
    clinical = attempt(lambda: clinical_angles(short))
    assert (clinical is None) == (frames == 0)
    attempt(lambda: leg_frames(short, "R"))
    if clinical is not None:
        certain = clinical_uncertainty(short, clinical, rules=FEW, budget_trials=4)
        assert np.isfinite(certain.joints[0].standard).all()


def test_the_sacrum_is_that_of_the_iliac_spines_where_its_marker_is_never_seen() -> None:
    recording = standing((30, 5, -8), (60, -3, 6))
    back = recording.labels.index("SACR")
    spines = recording.positions[:, back, None] + np.array([[0, 0.04, 0], [0, -0.04, 0]])
    positions = np.concatenate([recording.positions, spines], axis=1)
    positions[:, back] = np.nan
    both = Recording(positions, (*recording.labels, "LPSI", "RPSI"), 100.0)
    assert complete_legs(both) == ("L", "R")
    expected = clinical_angles(recording)
    for one, other in zip(clinical_angles(both).joints, expected.joints, strict=True):
        np.testing.assert_allclose(one.angles, other.angles, atol=1e-9)


@pytest.mark.parametrize("shown", [[], [4], [0, 1, 2], [3] * 8, [2, 0, 2, 2, 0, 2]])
def test_paths_with_gaps_are_smoothed(shown: list[int]) -> None:
    rng = np.random.default_rng(0)
    clouds = Clouds.from_points([np.arange(count)[:, None] * np.ones(3) + rng.normal(0, 0.001, (count, 3)) for count in shown], 100.0)
    xyz = clouds.xyz
    smooth = attempt(lambda: smooth_paths(clouds, np.tile(1e-6 * np.eye(3), (len(xyz), 1, 1))))
    assert np.isfinite(smooth.clouds.xyz).all() and np.isfinite(smooth.covariance).all()
    attempt(lambda: smooth_paths(clouds, np.full((len(xyz), 3, 3), np.nan)))


def test_outputs_that_some_trials_do_not_know_count_where_they_are_known() -> None:
    def model(rng: np.random.Generator) -> np.ndarray:
        value = rng.normal(0, 2, 3)
        return np.array([value[0], value[1] if value[2] > 0 else np.nan, np.nan])

    result = attempt(lambda: run_monte_carlo(model, rules=MonteCarloRules(block=200, most=2000)))
    np.testing.assert_allclose(result.standard, [2.0, 2.0, np.nan], atol=0.2)
    low, high = result.intervals[0.95]
    np.testing.assert_allclose(high - low, [7.84, 7.84, np.nan], atol=0.8)
    assert result.converged
    nothing = attempt(lambda: run_monte_carlo(lambda _: np.full(2, np.nan), rules=FEW))
    assert nothing.converged and np.isnan(nothing.standard).all()
    assert attempt(lambda: run_monte_carlo(lambda _: np.empty(0), rules=FEW)).estimate.shape == (0,)
    assert attempt(lambda: shortest_interval(np.empty((0, 2)), 0.95)) is None


COMMANDED = ("a marker never seen", "one frame without any", "two points of a limb missing for a while", "a limb with none")
COMMANDED += ("a limb from half-way", "one frame", "all in one place", "nothing moves")


@pytest.mark.parametrize("gap", COMMANDED)
def test_commands_on_recordings_with_gaps(gap: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, page = tmp_path / "gaps.csv", tmp_path / "page.html"
    formats.write(path, Recording(GAPS[gap](walking()), tuple(f"P{i + 1}" for i in range(12)), 50.0))
    segments = "\n".join(f"{name} = {markers!r}" for name, markers in LIMBS.items())
    (tmp_path / "set.toml").write_text(f"markers = {[m for markers in LIMBS.values() for m in markers]!r}\n[segments]\n{segments}\n")
    motion = ["motion", str(path), "--vertical", "z", "--uncertainty", "--trials", "10", "--markers", str(tmp_path / "set.toml")]
    for words in (
        ["segment", str(path), "--vertical", "z"],
        [*motion, "--json", str(tmp_path / "out.json"), "-o", str(tmp_path / "a.csv")],
    ):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            status = main([*words, "--report", str(page), "--overwrite"])
        said = capsys.readouterr().err
        assert status in (0, 1, 2) and "fault of Asterism" not in said and "Warning" not in said, said
    if status != 2:
        for joint in json.loads((tmp_path / "out.json").read_text())["files"][0]["joints"]:
            angle, sigma = (np.array(joint[name], dtype=float) for name in ("angle_deg", "angle_standard_deg"))
            assert (np.isfinite(angle) == np.isfinite(sigma)).all()


def test_a_gap_that_cannot_be_filled_stays_and_is_said() -> None:
    """All three points of a limb are missing at once, and a marker is never seen; the shorter gap of one point alone is filled."""
    positions = np.repeat(walking(), 4, axis=0)
    positions[10:30, 4:8], positions[5:7, 0], positions[:, 11] = np.nan, np.nan, np.nan
    filled = attempt(lambda: fill_gaps(Recording(positions, tuple(f"P{i + 1}" for i in range(12)), 50.0)))
    assert filled is not None
    assert np.isnan(filled.recording.positions[15, 4:8]).all() or filled.filled[15, 4:8].all()
    assert np.isnan(filled.recording.positions[:, 11]).all() and filled.findings


@pytest.mark.parametrize("movement", shipped_movements())
def test_events_by_rule_with_a_marker_missing(movement: str) -> None:
    """A gap leaves out what falls into it, and no event is at no time."""
    rules, positions = MovementRules.load(movement), np.repeat(walking(), 8, axis=0)
    worn = dict.fromkeys(label for labels in rules.markers.values() for label in labels[0].split("+"))
    labels = [label.replace("{side}", side) for label in worn for side in ("LR" if "{side}" in label else "-")][: positions.shape[1]]
    for hidden in (slice(0, 3), slice(20, 30), slice(None)):
        holed = positions[:, : len(labels)].copy()
        holed[hidden, 0] = np.nan
        recording = Recording(holed, tuple(labels), 50.0)
        found = attempt(lambda recording=recording: find_movement(recording, rules))
        if found is not None:
            assert all(np.isfinite(event.time) for event in found.events)
            attempt(lambda found=found: movement_table({"walk": found}))


def test_every_public_function_of_the_room_is_tried_here() -> None:
    text = Path(__file__).read_text()
    for module in pkgutil.walk_packages(asterism.motion.__path__, "asterism.motion."):
        if module.ispkg:
            package = importlib.import_module(module.name)
            for name in package.__all__:
                if callable(getattr(package, name)) and not isinstance(getattr(package, name), type):
                    assert f"{name}(" in text.replace("(rotation_vectors, quaternions, cardan_angles,", ""), name


def test_a_method_that_cannot_tell_a_limb_does_not_cost_the_page(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    from asterism.motion import rigid
    from asterism.report.motion import motion_report

    whole = rigid.estimate_limb_motion

    def without_clusters(positions: np.ndarray, method: str = "robust") -> rigid.LimbMotion:
        if method == "pct":
            raise AsterismError("the limb's points lie in a line, which leaves its rotation open; add a point beside the line.")
        return whole(positions, method)

    analysis = analyse_motion(Recording(walking(), tuple(f"P{i + 1}" for i in range(12)), 50.0), LIMBS)
    monkeypatch.setattr(rigid, "estimate_limb_motion", without_clusters)
    motion_report(tmp_path / "page.html", [("walk", analysis, None)])
    rows = (tmp_path / "page.html").read_text()
    assert re.search(r">\s*svd\s*</t[dh]>", rows) and not re.search(r">\s*pct\s*</t[dh]>", rows)
