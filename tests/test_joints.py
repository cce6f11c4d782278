"""Joints and angles against known ones; formulas against SciPy; anatomical frames on real gait."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import asterism
from asterism import AsterismError
from asterism.motion.analysis import MotionRules, analyse_motion
from asterism.motion.joints import cardan_angles, find_skeleton, fit_joint, functional_flexion, grood_suntay, joint_rotation, leg_frames
from asterism.motion.joints.angles import SEQUENCES
from asterism.simulation.soft_tissue import SoftTissueTrial, TrialPlan, simulate_soft_tissue

SEEDS = st.integers(0, 2**32 - 1)


@dataclass(frozen=True)
class Known:
    """A motion that is known."""

    rotations: np.ndarray
    translations: np.ndarray


def joined(kind: str, noise: float, seed: int = 0, frames: int = 80) -> tuple[Known, Known, np.ndarray, np.ndarray]:
    """Two limbs that turn about a common point: parent, child, the centre in the parent, the axis in the parent."""
    rng = np.random.default_rng(seed)
    parent = Rotation.from_rotvec(0.3 * np.cumsum(rng.normal(0, 0.1, (frames, 3)), axis=0)).as_matrix()
    axis = np.array([0.0, 0.8, 0.6])
    turn = 1.2 * np.sin(np.linspace(0, 9, frames))[:, None] * axis
    if kind == "ball":
        turn = turn + 0.7 * np.stack([np.cos(np.linspace(0, 7, frames)), 0 * turn[:, 0], np.sin(np.linspace(0, 5, frames))], axis=1)
    child = parent @ Rotation.from_rotvec(turn).as_matrix()
    shift = rng.normal(0, 0.5, (frames, 3))
    in_parent, in_child = np.array([0.1, -0.2, 0.3]), np.array([-0.3, 0.1, 0.2])
    centre = parent @ in_parent + shift
    one = Known(parent, shift + rng.normal(0, noise, shift.shape))
    return one, Known(child, centre - child @ in_child + rng.normal(0, noise, shift.shape)), in_parent, axis


def test_a_ball_joint_is_found_exactly_and_its_covariance_holds_what_noise_does() -> None:
    parent, child, centre, _ = joined("ball", 0.0)
    joint = fit_joint(parent, child)
    assert joint.kind == "ball"
    np.testing.assert_allclose(joint.in_parent, centre, atol=1e-6)
    np.testing.assert_allclose(joint.centres(parent, child), parent.rotations @ centre + parent.translations, atol=1e-6)
    inside = []
    for seed in range(60):
        parent, child, centre, _ = joined("ball", 0.003, seed)
        joint = fit_joint(parent, child)
        miss = joint.in_parent - centre
        inside.append(float(miss @ np.linalg.solve(joint.covariance, miss)))
    assert 1.5 < np.mean(inside) < 6.0, "the mean squared miss in units of the covariance is 3 for three coordinates"


def test_a_hinge_has_its_axis_and_a_centre_where_the_hint_is_along_it() -> None:
    parent, child, centre, axis = joined("hinge", 0.0005)
    hint = parent.rotations @ (centre + 0.05 * axis) + parent.translations
    joint = fit_joint(parent, child, near=hint)
    assert joint.kind == "hinge"
    np.testing.assert_allclose(joint.axis_in_parent, axis, atol=0.01)
    miss = joint.in_parent - centre
    assert np.linalg.norm(miss - (miss @ axis) * axis) < 0.002 and miss @ axis == pytest.approx(0.05, abs=0.005)
    sigma = np.sqrt(np.diag(joint.covariance))
    along = np.sqrt(axis @ joint.covariance @ axis)
    assert along > 0.02 and sigma.min() < along, "the covariance says that the place along the axis is open"


def test_spheres_have_the_same_centre_as_score_without_noise() -> None:
    parent, child, centre, _ = joined("ball", 0.0)
    points = np.einsum("tij,nj->tni", child.rotations, np.random.default_rng(0).normal(0, 0.2, (5, 3))) + child.translations[:, None]
    joint = fit_joint(parent, child, points=points, method="sphere")
    np.testing.assert_allclose(joint.in_parent, centre, atol=1e-4)


def test_limbs_that_hardly_turn_have_a_fixed_joint() -> None:
    parent, _, _, _ = joined("ball", 0.0)
    assert fit_joint(parent, parent).kind == "fixed"


def test_careless_joints_are_refused() -> None:
    parent, child, _, _ = joined("ball", 0.0)
    gone = Known(child.rotations, np.full_like(child.translations, np.nan))
    cases = [
        (parent, gone, {}, "0 frames"),
        (parent, Known(child.rotations[:9], child.translations[:9]), {}, "80 and 9 frames"),
        (parent, child, {"method": "guess"}, "no method"),
        (parent, child, {"method": "sphere"}, "points"),
        (parent, child, {"near": np.zeros(3)}, "expected"),
    ]
    for one, other, options, sentence in cases:
        with pytest.raises(AsterismError, match=sentence):
            fit_joint(one, other, **options)
    with pytest.raises(AsterismError, match="limbs"):
        find_skeleton([], [])


def limbs_of(trial: SoftTissueTrial) -> dict[str, list[str]]:
    return {f"bone {k}": [trial.recording.labels[n] for n in np.nonzero(trial.limb_of == k)[0]] for k in range(len(trial.rotations))}


@pytest.mark.parametrize("joint", ["shoulder", "knee", "hip"])
def test_angle_and_centre_of_a_simulated_joint(joint: str) -> None:
    trial = simulate_soft_tissue(TrialPlan(joint, subject=4, motion=1, points=300), seed=1)
    analysis = analyse_motion(trial.recording, limbs_of(trial))
    error = np.degrees(np.abs(analysis.angles[0].angle - trial.angles[0]))
    assert error.mean() < 0.5, f"{error.mean():.2f} degrees"
    assert np.linalg.norm(analysis.centres[0] - trial.centres[0], axis=1).mean() < 0.005


def test_the_skeleton_of_a_leg_is_a_chain_from_its_largest_limb() -> None:
    trial = simulate_soft_tissue(TrialPlan("leg", points=240), seed=3)
    for limbs in (limbs_of(trial), None):
        analysis = analyse_motion(trial.recording, limbs)
        shin = int(np.bincount(analysis.limb_of[trial.limb_of == 2]).argmax())
        thigh = int(np.bincount(analysis.limb_of[trial.limb_of == 1]).argmax())
        assert (thigh, shin) in analysis.skeleton.pairs and len(analysis.skeleton.pairs) == 2
    assert analysis.recording.log[-1].action == "motion estimated"


def test_what_is_doubtful_is_said() -> None:
    trial = simulate_soft_tissue(TrialPlan("knee", points=40), seed=3)
    positions = trial.recording.positions.copy()
    positions[:70, 0] = np.nan
    recording = asterism.Recording(positions[:, :], trial.recording.labels, 10.0)
    codes = {finding.code for finding in analyse_motion(recording, {"thigh": limbs_of(trial)["bone 0"]}).findings}
    assert codes == {"motion-points-missing", "motion-points-unused"}
    still = asterism.Recording(np.tile(positions[80], (10, 1, 1)), trial.recording.labels, 10.0)
    assert {f.code for f in analyse_motion(still, limbs_of(trial)).findings} == {"motion-joint-still"}


@pytest.mark.parametrize(
    ("limbs", "sentence"),
    [({"a": ["P1", "X"]}, "no marker X"), ({"a": ["P1"], "b": ["P1"]}, "two limbs"), ({}, "no limb"), ({"a": ["P1", "P2"]}, "three")],
)
def test_careless_lists_of_limbs_are_refused(limbs: dict[str, list[str]], sentence: str) -> None:
    with pytest.raises(AsterismError, match=sentence):
        analyse_motion(simulate_soft_tissue(TrialPlan(points=10), seed=0).recording, limbs)


@given(SEEDS, st.sampled_from(SEQUENCES))
def test_cardan_angles_are_scipys(seed: int, sequence: str) -> None:
    rotations = Rotation.random(5, random_state=seed)
    with np.errstate(all="ignore"):
        np.testing.assert_allclose(cardan_angles(rotations.as_matrix(), sequence), rotations.as_euler(sequence.upper()), atol=1e-7)


@given(SEEDS)
def test_grood_and_suntays_angles_are_the_cardan_angles_zxy(seed: int) -> None:
    rng = np.random.default_rng(seed)
    parent = Rotation.random(6, random_state=seed).as_matrix()
    turned = Rotation.from_euler("ZXY", rng.uniform(-1.4, 1.4, (6, 3))).as_matrix()
    np.testing.assert_allclose(grood_suntay(parent, parent @ turned), cardan_angles(turned, "zxy"), atol=1e-9)


def test_a_locked_cardan_sequence_keeps_the_rotation() -> None:
    rotation = Rotation.from_euler("ZXY", [[0.4, np.pi / 2, 0.0]]).as_matrix()
    angles = cardan_angles(rotation, "zxy")
    np.testing.assert_allclose(Rotation.from_euler("ZXY", angles).as_matrix(), rotation, atol=1e-7)
    with pytest.raises(AsterismError, match="no Cardan sequence"):
        cardan_angles(rotation, "zxz")


def test_functional_flexion_leaves_out_turns_about_other_axes() -> None:
    time = np.linspace(0, 12, 200)
    turned = Rotation.from_euler("YX", np.stack([0.8 * np.sin(time), 0.05 * np.cos(3 * time)], axis=1)).as_matrix()
    flexion, axis = functional_flexion(turned)
    np.testing.assert_allclose(np.abs(axis), [0, 1, 0], atol=0.03)
    assert np.abs(flexion - (0.8 * np.sin(time) - np.mean(0.8 * np.sin(time)))).max() < 0.05
    with pytest.raises(AsterismError, match="no frame"):
        functional_flexion(np.full((3, 3, 3), np.nan))
    with pytest.raises(AsterismError, match="frame 1"):
        joint_rotation(np.full((3, 3, 3), np.nan), turned[:3], zero=1)


def test_methods_for_joints_can_be_chosen() -> None:
    trial = simulate_soft_tissue(TrialPlan("knee", points=100), seed=1)
    analysis = analyse_motion(trial.recording, limbs_of(trial), rules=MotionRules(joint_method="sphere"))
    assert np.linalg.norm(analysis.centres[0] - trial.centres[0], axis=1).mean() < 0.01


def test_knee_flexion_of_a_real_walk_is_that_of_plug_in_gait(data: Path) -> None:
    recording = asterism.read(data / "gait" / "HC002" / "straight.c3d")
    for side in "LR":
        frames = leg_frames(recording, side)
        flexion = -np.degrees(grood_suntay(frames.thigh, frames.shank)[:, 0])
        computed = recording.source.coordinates[:, list(recording.source.labels).index(f"{side}KneeAngles"), 0]
        known = np.isfinite(flexion) & np.isfinite(computed) & (computed != 0)
        difference = (flexion - computed)[known]
        assert known.sum() > 100 and difference.std() < 3.0
    with pytest.raises(AsterismError, match="no side"):
        leg_frames(recording, "left")
    with pytest.raises(AsterismError, match="no marker"):
        leg_frames(recording.select(["LASI", "RASI", "SACR"]), "L")
