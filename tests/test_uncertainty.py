"""The uncertainty of angles: intervals by hand, the law of propagation against Monte Carlo, sources against what they say, coverage."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from asterism import AsterismError
from asterism.cameras.accuracy import covariance
from asterism.cameras.bundle import free_parameters
from asterism.motion.analysis import MotionAnalysis, analyse_motion
from asterism.motion.uncertainty import (
    CalibrationErrors,
    ErrorSources,
    MeasurementNoise,
    MonteCarloRules,
    SoftTissueErrors,
    estimate_uncertainty,
    first_order_angles,
    noise_from_rig,
    run_monte_carlo,
    shortest_interval,
)
from asterism.motion.uncertainty.monte_carlo import numerical_tolerance
from asterism.simulation.cameras import ring_rig
from asterism.simulation.soft_tissue import TrialPlan, simulate_soft_tissue

NOTHING = ErrorSources(noise=MeasurementNoise(0.0), soft_tissue=None)


def analysed(points: int = 60, **options: object) -> MotionAnalysis:
    trial = simulate_soft_tissue(TrialPlan("knee", points=points, frames=40, **options), seed=4)
    labels = trial.recording.labels
    return analyse_motion(trial.recording, {f"b{k}": [labels[n] for n in np.nonzero(trial.limb_of == k)[0]] for k in (0, 1)})


@given(st.lists(st.integers(0, 50), min_size=5, max_size=30), st.sampled_from([0.5, 0.65, 0.95]))
def test_the_shortest_interval_is_that_of_trying_all(values: list[int], probability: float) -> None:
    low, high = shortest_interval(np.array(values, dtype=float)[:, None], probability)
    ordered, span = sorted(values), min(int(probability * len(values) + 0.5), len(values) - 1)
    assert high[0] - low[0] == min(ordered[i + span] - ordered[i] for i in range(len(values) - span))
    assert sum(low[0] <= value <= high[0] for value in values) >= span + 1


def test_the_interval_of_a_skewed_distribution_is_shorter_than_the_symmetric_one() -> None:
    values = np.random.default_rng(0).exponential(1.0, (20000, 1))
    low, high = shortest_interval(values, 0.95)
    assert low[0] < 0.02 and high[0] == pytest.approx(3.0, abs=0.15)


def test_a_normal_output_has_the_known_mean_uncertainty_and_intervals_whatever_the_workers() -> None:
    rules = MonteCarloRules(block=500, most=6000)
    one, two = (run_monte_carlo(lambda rng: rng.normal([1.0, -2.0], 0.3), seed=3, workers=w, rules=rules) for w in (1, 3))
    assert (one.values == two.values).all()
    np.testing.assert_allclose(one.estimate, [1.0, -2.0], atol=0.02)
    np.testing.assert_allclose(one.standard, 0.3, atol=0.02)
    for probability, factor in ((0.65, 0.9346), (0.95, 1.96)):
        low, high = one.intervals[probability]
        np.testing.assert_allclose((high - low) / 2, factor * 0.3, rtol=0.1)


def test_trials_end_when_a_digit_is_certain_and_not_before() -> None:
    def model(rng: np.random.Generator) -> np.ndarray:
        return rng.normal(0, [0.3])

    quick = run_monte_carlo(model, rules=MonteCarloRules(block=2000, most=40000))
    careful = run_monte_carlo(model, rules=MonteCarloRules(block=2000, most=8000, digits=3))
    assert quick.converged and quick.trials < 40000
    assert not careful.converged and careful.trials == 8000
    assert numerical_tolerance(0.43) == pytest.approx(0.05) and numerical_tolerance(0.43, 2) == pytest.approx(0.005)
    assert numerical_tolerance(0.0) == np.inf


@pytest.mark.parametrize("rules", [{"block": 1}, {"most": 1}, {"digits": 0}, {"coverage": (1.0,)}])
def test_rules_that_make_no_sense_are_refused(rules: dict[str, object]) -> None:
    with pytest.raises(AsterismError):
        run_monte_carlo(lambda rng: rng.normal(size=1), rules=MonteCarloRules(**rules))


def test_nothing_uncertain_gives_no_width() -> None:
    result = estimate_uncertainty(analysed(), NOTHING, rules=MonteCarloRules(block=2, most=2), budget_trials=2)
    assert np.nanmax(result.joints[0].angle_standard) < 1e-9 and np.nanmax(result.joints[0].flexion_standard) < 1e-9


def test_first_order_is_what_many_trials_give_for_noise_and_says_where_it_does_not_hold() -> None:
    analysis = analysed()
    noise = replace(NOTHING, noise=MeasurementNoise(0.001))
    result = estimate_uncertainty(analysis, noise, rules=MonteCarloRules(block=2, most=2), budget_trials=300, reassign=False)
    joint = result.joints[0]
    late = slice(5, None)
    ratio = joint.first_order.standard[late] / joint.angle_budget["cameras"][late]
    assert 0.85 < np.median(ratio) < 1.15
    assert joint.first_order.holds is not None and joint.first_order.holds.mean() > 0.8
    wild = estimate_uncertainty(
        analysis, replace(NOTHING, noise=MeasurementNoise(0.2)), rules=MonteCarloRules(block=2, most=2), budget_trials=60, reassign=False
    )
    assert wild.joints[0].first_order.holds is not None and wild.joints[0].first_order.holds.mean() < 0.6
    assert "motion-not-linear" in {finding.code for finding in wild.findings}


def test_twice_the_noise_is_twice_the_uncertainty_to_first_order() -> None:
    analysis = analysed()
    joint, (one, other) = analysis.angles[0], analysis.motions
    np.testing.assert_allclose(
        first_order_angles(joint, one, other, 0.002).standard, 2 * first_order_angles(joint, one, other, 0.001).standard
    )


def test_each_source_adds_to_its_part_of_the_budget_only() -> None:
    soft = replace(NOTHING, soft_tissue=SoftTissueErrors())
    joint = estimate_uncertainty(analysed(), soft, rules=MonteCarloRules(block=2, most=2), budget_trials=100).joints[0]
    assert np.nanmax(joint.budget["cameras"]) < 1e-9
    bent = joint.joint.angle > 0.7 * joint.joint.angle.max()
    assert joint.angle_budget["soft tissue"][bent].mean() > 3 * joint.angle_budget["soft tissue"][joint.joint.angle < 0.1].mean()


@pytest.mark.parametrize(("freedoms", "variance"), [(6.0, 1.5), (np.inf, 1.0)])
def test_skin_whose_size_is_little_known_moves_further_now_and_then(freedoms: float, variance: float) -> None:
    """The variance of a t distribution is its freedoms over themselves less 2."""
    rng, errors = np.random.default_rng(1), SoftTissueErrors(freedoms=freedoms)
    limb, course = rng.uniform(-0.1, 0.1, (30, 3)), np.ones(1)
    drawn, plain = (
        np.array([source.draw(limb, np.full(30, 0.01), [course], np.random.default_rng([2, k])) for k in range(1500)])
        for source in (errors, replace(errors, freedoms=np.inf))
    )
    assert (drawn**2).mean() == pytest.approx(variance * (plain**2).mean(), rel=0.15)


def test_the_noise_is_found_in_the_points_themselves() -> None:
    result = estimate_uncertainty(analysed(300, noise_m=0.002), rules=MonteCarloRules(block=2, most=2), budget_trials=2)
    assert result.noise == pytest.approx(0.002, rel=0.25)
    assert {"motion-no-calibration", "motion-few-trials"} <= {finding.code for finding in result.findings}


def test_intervals_cover_the_bones_angle() -> None:
    """People of other seeds than those the model of the skin was chosen on. Angles of one trial err together, so bounds are wide."""
    inside: dict[float, list[float]] = {0.65: [], 0.95: []}
    for subject in range(8):
        trial = simulate_soft_tissue(TrialPlan(("knee", "hip")[subject % 2], subject=subject, points=80, frames=30), seed=11)
        labels = trial.recording.labels
        analysis = analyse_motion(trial.recording, {f"b{k}": [labels[n] for n in np.nonzero(trial.limb_of == k)[0]] for k in (0, 1)})
        joint = estimate_uncertainty(analysis, rules=MonteCarloRules(block=40, most=80), budget_trials=2).joints[0]
        for probability, (low, high) in joint.angle_intervals.items():
            inside[probability].append(float(((trial.angles[0] >= low) & (trial.angles[0] <= high))[1:].mean()))
    assert 0.4 < np.mean(inside[0.65]) < 0.9 and 0.8 < np.mean(inside[0.95]) <= 1.0, inside


def test_a_rigs_noise_is_the_covariance_of_its_triangulation() -> None:
    rig = ring_rig(5, radius=3.0, height=2.0, size=(2048, 1536), rng=np.random.default_rng(0))
    positions = np.random.default_rng(1).uniform([-0.3, -0.3, 0.5], [0.3, 0.3, 1.2], (2, 6, 3))
    positions[1, 2] = np.nan
    noise = noise_from_rig(rig, positions, 0.5)
    assert noise.root is not None
    np.testing.assert_allclose(noise.root[0] @ noise.root[0].swapaxes(1, 2), covariance(rig, positions[0], 0.5), atol=1e-12)
    assert noise.draw(positions.shape, np.random.default_rng(2)).shape == positions.shape


def test_errors_of_a_calibration_move_points_as_the_drawn_rig_does() -> None:
    rig = ring_rig(5, radius=3.0, height=2.0, size=(2048, 1536), rng=np.random.default_rng(0))
    free = free_parameters(5, "pose", "focal")
    spread = np.diag(np.tile([1e-4, 1e-4, 1e-4, 5e-4, 5e-4, 5e-4, 0.5], 5) ** 2)
    analysis = analysed(30)
    centred = analysis.recording.positions - np.nanmean(analysis.recording.positions, axis=(0, 1)) + [0, 0, 0.9]
    field = CalibrationErrors(rig, free, spread).field(centred)
    one, again = (field.draw(np.random.default_rng(3)) for _ in range(2))
    assert (one == again).all() and 1e-5 < np.abs(one).mean() < 5e-3
    turned = CalibrationErrors(rig, free, np.zeros_like(spread)).field(centred).draw(np.random.default_rng(3))
    assert np.abs(turned).max() < 1e-9, "no errors, no shift"
    steps = np.abs(np.diff(one, axis=0)).max()
    assert steps < 0.2 * np.abs(one).max(), "the shift is smooth over the volume"
    with pytest.raises(AsterismError, match="does not fit"):
        CalibrationErrors(rig, free, spread[:5, :5])
    with pytest.raises(AsterismError, match="not finite"):
        CalibrationErrors(rig, free, spread * np.nan)
    moved = replace(analysis, recording=replace(analysis.recording, positions=centred))
    result = estimate_uncertainty(
        moved, replace(NOTHING, calibration=CalibrationErrors(rig, free, spread)), rules=MonteCarloRules(block=5, most=10), budget_trials=20
    )
    assert np.nanmax(result.joints[0].angle_budget["cameras"]) > 1e-6
    assert "motion-no-calibration" not in {finding.code for finding in result.findings}
