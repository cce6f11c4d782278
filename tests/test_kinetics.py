"""Moments and powers: of rigid legs whose equations of motion are written here, by hand in standing, against a laboratory's own."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import asterism
from asterism import AsterismError, Recording
from asterism.cli.gait import as_dict
from asterism.formats import force_plates
from asterism.gait import analyse_gait
from asterism.gait.analysis import _other_mass
from asterism.motion.clinical import (
    ABOUT_CENTRE,
    KineticErrors,
    KineticRules,
    Kinetics,
    Leg,
    LowerBody,
    PlateContact,
    SubjectMeasures,
    inverse_dynamics,
    subject_measures,
)
from asterism.motion.clinical.measures import computed_by_the_file
from asterism.motion.splines import quintic_spline, second_derivative
from asterism.recording import ForcePlate
from asterism.report.gait import gait_report
from asterism.simulation import simulate_walks

RATE, FRAMES, MASS = 100.0, 300, 60.0
THIGH, SHANK, FOOT = 0.45, 0.40, 0.20
"""m, of the limbs: the foot's is four thirds of the way from ankle to toe marker."""
TIMES = np.arange(FRAMES) / RATE
UP = np.array([0.0, 0.0, 1.0])
SOLE = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
"""The foot's axes on a level floor, columns: z backwards."""


def leg(angle: np.ndarray, side: str = "L") -> tuple[Recording, LowerBody]:
    """A stiff leg that turns by an angle (T,) about an axis to the left through the hip, which stays."""
    c, s, one, none = np.cos(angle), np.sin(angle), np.ones_like(angle), np.zeros_like(angle)
    turned = np.stack([np.stack([c, none, s], 1), np.stack([none, one, none], 1), np.stack([-s, none, c], 1)], axis=1)
    aside = 0.1 if side == "L" else -0.1

    def at(ahead: float, down: float) -> np.ndarray:
        return np.array([0.0, aside, THIGH + SHANK + 0.08]) + turned @ np.array([ahead, 0.0, -down])

    hip, knee, ankle = at(0, 0), at(0, THIGH), at(0, THIGH + SHANK)
    points = {"TOE": at(0.75 * FOOT, THIGH + SHANK), "HEE": at(-0.05, THIGH + SHANK)}
    recording = Recording(np.stack(list(points.values()), 1), [side + name for name in points], RATE)
    pelvis = np.broadcast_to(np.eye(3), turned.shape)
    own = Leg(hip, knee, ankle, turned, turned, turned, turned @ SOLE)
    return recording, LowerBody(pelvis, hip, {side: own})


def plate(force: np.ndarray, at: np.ndarray, half: float = 0.3) -> ForcePlate:
    """A square plate in the floor about the world's origin with a steady force (3,) N at a place (3,) m."""
    corners = half * np.array([[1.0, 1.0, 0.0], [-1.0, 1.0, 0.0], [-1.0, -1.0, 0.0], [1.0, -1.0, 0.0]])
    return ForcePlate(1, corners, np.tile(force, (FRAMES * 10, 1)), np.tile(np.cross(at, force), (FRAMES * 10, 1)), 10 * RATE, UP)


def in_the_air(recording: Recording, body: LowerBody, rules: KineticRules) -> Kinetics:
    return inverse_dynamics(recording, body, [], [], {side: [(-1.0, 9.0)] for side in body.legs}, SubjectMeasures(mass=MASS), rules)


def standing(side: str = "L", *, measures: SubjectMeasures | None = None, half: float = 0.3, alone: bool = True) -> Kinetics:
    recording, body = leg(np.zeros(FRAMES), side)
    under = plate(np.array([0.0, 0.0, 500.0]), np.array([0.12, 0.1 if side == "L" else -0.1, 0.0]), half)
    contact = PlateContact(1, side if alone else None, 0.0, FRAMES / RATE)
    return inverse_dynamics(recording, body, [under], [contact], {}, measures or SubjectMeasures(mass=MASS))


def test_a_swinging_leg_has_the_moment_and_the_power_of_a_rigid_pendulum() -> None:
    swing, speed = 0.4, 8.0
    angle = swing * np.sin(speed * TIMES)
    rules = ABOUT_CENTRE
    found = in_the_air(*leg(angle), rules)
    inertia = weight_ahead = 0.0
    for segment, length, upper, direction in (
        (rules.thigh, THIGH, np.zeros(3), np.array([0.0, 0.0, -1.0])),
        (rules.shank, SHANK, np.array([0.0, 0.0, -THIGH]), np.array([0.0, 0.0, -1.0])),
        (rules.foot, FOOT, np.array([0.0, 0.0, -THIGH - SHANK]), np.array([1.0, 0.0, 0.0])),
    ):
        centre = upper + segment.centre * length * direction
        inertia += segment.mass * ((segment.radius * length) ** 2 + centre @ centre)
        weight_ahead = weight_ahead + segment.mass * (np.cos(angle) * centre[0] + np.sin(angle) * centre[2])
    extension = inertia * -(speed**2) * angle - 9.81 * weight_ahead
    power = extension * swing * speed * np.cos(speed * TIMES)
    inner = slice(20, -20)
    np.testing.assert_allclose(found.moments["LHipMoment"][inner, 0], extension[inner], atol=0.01)
    np.testing.assert_allclose(found.powers["LHipPower"][inner], power[inner], atol=0.03)
    assert np.ptp(extension) > 1.0 and np.ptp(power) > 1.0
    assert np.abs(found.moments["LHipMoment"][inner, 1:]).max() < 1e-9


def test_who_stands_has_the_moments_of_weight_and_lever() -> None:
    found = standing()
    foot = KineticRules().foot
    forward = (500.0 * 0.12 - foot.mass * MASS * 9.81 * foot.centre * FOOT) / MASS
    middle = FRAMES // 2
    # A force ahead of all joints: the calf holds the ankle, the back of the knee the knee, the buttock the hip.
    assert found.moments["LAnkleMoment"][middle] == pytest.approx([forward, 0, 0], abs=1e-6)
    assert found.moments["LKneeMoment"][middle] == pytest.approx([-forward, 0, 0], abs=1e-6)
    assert found.moments["LHipMoment"][middle] == pytest.approx([forward, 0, 0], abs=1e-6)
    assert found.powers["LHipPower"][middle] == pytest.approx(0, abs=1e-6)
    assert found.ground["LGroundReactionForce"][middle] == pytest.approx([0, 0, 500 / MASS])
    assert found.per_kg and not found.findings


@pytest.mark.parametrize("joint", ["Ankle", "Knee", "Hip"])
def test_a_mirrored_person_has_the_same_moments(joint: str) -> None:
    push = np.array([40.0, 30.0, 500.0])
    sides = {}
    for side, left in (("L", 1.0), ("R", -1.0)):
        recording, body = leg(0.1 * np.sin(3 * TIMES), side)
        under = plate(push * [1, left, 1], np.array([0.1, 0.13 * left, 0.0]))
        contact = PlateContact(1, side, 0.0, FRAMES / RATE)
        found = inverse_dynamics(recording, body, [under], [contact], {}, SubjectMeasures(mass=MASS))
        sides[side] = np.column_stack([found.moments[f"{side}{joint}Moment"], found.powers[f"{side}{joint}Power"]])
    assert np.isfinite(sides["L"][20:-20]).all() and np.abs(sides["L"][50, :3]).min() > 0.01
    np.testing.assert_allclose(sides["L"], sides["R"], atol=1e-9)


NOTHING = KineticErrors(0, 0, 0, 0, 0, 0, 0, 0, 0)


def pushed_leg(*, at: tuple[float, float] = (0.1, 0.13), gain: float = 1.0, hip: np.ndarray | None = None, mass: float = MASS,
               errors: KineticErrors = NOTHING) -> Kinetics:  # fmt: skip
    recording, body = leg(0.1 * np.sin(3 * TIMES))
    own = body.legs["L"]
    moved = body if hip is None else replace(body, legs={"L": replace(own, hip=own.hip + hip)})
    under = plate(gain * np.array([40.0, 30.0, 500.0]), np.array([*at, 0.0]))
    contact = PlateContact(1, "L", 0.0, FRAMES / RATE)
    return inverse_dynamics(recording, moved, [under], [contact], {}, SubjectMeasures(mass=mass), errors=errors)


def test_moments_are_as_uncertain_as_what_they_are_made_of() -> None:
    """Against the moments of plates, centres and weights that are moved by a standard uncertainty."""
    inner, usual = slice(20, -20), pushed_leg().moments
    moved = [pushed_leg(at=at) for at in ((0.105, 0.13), (0.1, 0.135))]
    told = pushed_leg(errors=replace(NOTHING, pressure=0.005)).sigmas
    for name in ("LAnkleMoment", "LKneeMoment", "LHipMoment"):
        by_hand = np.sqrt(sum((one.moments[name] - usual[name]) ** 2 for one in moved))
        np.testing.assert_allclose(told[name][inner], by_hand[inner], atol=1e-9)
    # Without weight a hip that is moved changes nothing but its lever.
    light = pushed_leg(mass=1e-6).moments["LHipMoment"]
    shifts = [pushed_leg(mass=1e-6, hip=0.01 * axis).moments["LHipMoment"] for axis in np.eye(3)]
    by_hand = np.sqrt(sum((one - light) ** 2 for one in shifts))
    centre = pushed_leg(mass=1e-6, errors=replace(NOTHING, hip=0.01)).sigmas
    np.testing.assert_allclose(centre["LHipMoment"][inner], by_hand[inner], rtol=0.15)
    assert not centre["LKneeMoment"][inner].any()
    # What the plate reads is in proportion; the rest is inertia and weight.
    gain = pushed_leg(errors=replace(NOTHING, plate=0.02)).sigmas["LKneeMoment"][inner]
    np.testing.assert_allclose(gain, np.abs(pushed_leg(gain=1.02).moments["LKneeMoment"] - usual["LKneeMoment"])[inner], atol=1e-9)
    rest = pushed_leg(errors=replace(NOTHING, inertia=1.0)).sigmas["LKneeMoment"][inner]
    by_ground = (pushed_leg(gain=2.0).moments["LKneeMoment"] - usual["LKneeMoment"])[inner]
    np.testing.assert_allclose(rest, np.abs(usual["LKneeMoment"][inner] - by_ground), atol=1e-9)


def test_accelerations_of_all_segments_below_a_joint_make_its_moment_uncertain() -> None:
    """A stiff leg that hardly turns: masses times their distances from the joint, each segment on its own."""
    found, rules = pushed_leg(errors=replace(NOTHING, acceleration=2.0)).sigmas, KineticRules()
    shank, foot = rules.shank.centre * SHANK, np.array([rules.foot.centre * FOOT, SHANK])
    knee = np.hypot(rules.shank.mass * shank, rules.foot.mass * np.linalg.norm(foot))
    hip = np.linalg.norm(
        [
            rules.thigh.mass * rules.thigh.centre * THIGH,
            rules.shank.mass * (THIGH + shank),
            rules.foot.mass * np.hypot(foot[0], THIGH + SHANK),
        ]
    )
    for name, per in (("LKneeMoment", knee), ("LHipMoment", hip)):
        np.testing.assert_allclose(found[name][20:-20, 0], 2.0 * per, rtol=1e-6)


def test_a_power_is_uncertain_by_its_moment_and_by_its_turning() -> None:
    found = pushed_leg(errors=replace(NOTHING, turning=0.2))
    size = np.linalg.norm(found.moments["LHipMoment"], axis=1)
    np.testing.assert_allclose(found.sigmas["LHipPower"][20:-20], 0.2 * size[20:-20], rtol=1e-9)
    usual = pushed_leg(errors=KineticErrors())
    assert (usual.sigmas["LHipPower"][20:-20] > found.sigmas["LHipPower"][20:-20]).all()
    assert set(usual.sigmas) == {*usual.moments, *usual.powers, *usual.ground}


def test_the_grounds_force_is_as_uncertain_as_the_plate_and_the_mass() -> None:
    found = pushed_leg(errors=replace(NOTHING, plate=0.02, mass=0.01)).sigmas["LGroundReactionForce"][20:-20]
    force = np.array([40.0, 30.0, 500.0])
    np.testing.assert_allclose(
        found, np.tile(np.hypot(0.02 * np.linalg.norm(force), 0.01 * np.abs(force)) / MASS, (len(found), 1)), rtol=1e-9
    )


def test_without_a_mass_moments_are_newton_metres_and_it_is_said() -> None:
    found = standing(measures=SubjectMeasures())
    assert not found.per_kg and [one.code for one in found.findings] == ["kinetics-mass"]
    assert "BodyMass" in found.findings[0].mend
    assert found.moments["LAnkleMoment"][FRAMES // 2] == pytest.approx([500.0 * 0.12, 0, 0], abs=1e-6)


def test_a_foot_half_on_a_plate_is_left_out_and_said() -> None:
    found = standing(half=0.11)
    assert [one.code for one in found.findings] == ["kinetics-step"] and "left foot" in found.findings[0].sentence
    assert np.isnan(found.moments["LKneeMoment"]).all() and np.isnan(found.ground["LGroundReactionForce"]).all()


def test_two_feet_on_a_plate_are_left_out_and_said() -> None:
    found = standing(alone=False)
    assert [one.code for one in found.findings] == ["kinetics-step"] and "not one foot" in found.findings[0].sentence
    assert np.isnan(found.moments["LKneeMoment"]).all()


def test_a_plate_shorter_than_the_recording_is_refused() -> None:
    recording, body = leg(np.zeros(FRAMES))
    under = plate(np.array([0.0, 0.0, 500.0]), np.zeros(3))
    short = replace(under, force=under.force[:500], moment=under.moment[:500])
    with pytest.raises(AsterismError, match="too few"):
        inverse_dynamics(recording, body, [short], [], {}, SubjectMeasures(mass=MASS))


def test_noise_is_smoothed_as_much_as_it_needs_and_no_more() -> None:
    clean = np.stack([np.sin(5 * TIMES), np.cos(3 * TIMES)], axis=1)
    noisy = clean + np.random.default_rng(1).normal(0, 0.001, clean.shape)
    wanted = -np.array([25.0, 9.0]) * clean
    rough = np.gradient(np.gradient(noisy, 1 / RATE, axis=0), 1 / RATE, axis=0)
    errors = [np.abs(found - wanted)[20:-20].max() for found in (second_derivative(noisy, RATE), rough)]
    assert errors[0] < 1.5 < 5 < errors[1]
    # without noise nothing is smoothed away
    assert np.abs(second_derivative(clean, RATE) - wanted)[5:-5].max() < 0.01


def test_a_gap_stays_a_gap_and_short_pieces_too() -> None:
    curve = np.sin(3 * TIMES)[:, None]
    curve[100:110] = curve[115:] = np.nan
    assert np.isfinite(second_derivative(curve, RATE)[:, 0]).tolist() == [True] * 100 + [False] * (FRAMES - 100)
    with pytest.raises(ValueError, match="finite"):
        quintic_spline(curve)


@pytest.mark.parametrize(("per_kg", "unit"), [(True, "W/kg"), (False, "W")])
def test_the_page_shows_moments_and_powers_with_their_unit(tmp_path: Path, per_kg: bool, unit: str) -> None:
    analysis = analyse_gait(simulate_walks(1, frames=300, markers="helen-hayes", seed=0)[0])
    curve = np.sin(np.linspace(0, 6, 101))[None, :, None]
    # the end of a cycle may be unknown
    curve[:, -1] = np.nan
    loads = {"LKneePower": curve, "LHipMoment": np.tile(curve, 3), "LGroundReactionForce": np.tile(curve, 3)}
    gait_report(tmp_path / "page.html", [("walk", replace(analysis, loads=loads, kinetics=Kinetics({}, {}, {}, per_kg)))])
    page = (tmp_path / "page.html").read_text()
    assert f"knee power <small>{unit}</small>" in page and "hip extension moment" in page and "1 left and 0 right cycles" in page
    assert ("Nobody gave the mass" in page) != per_kg
    gait_report(tmp_path / "page.html", [("walk", analysis)])
    assert "knee power" not in (tmp_path / "page.html").read_text()


@pytest.mark.parametrize(("given", "told"), [(70.0, ""), (63.0, ""), (154.0, "about 70 kg"), (50.0, "about 70 kg")])
def test_a_mass_that_the_plates_do_not_carry_is_told(given: float, told: str) -> None:
    """70 kg on two feet, each on the ground for 60 of 100 parts of the cycle; a foot that brakes bears more, and counts not."""
    stance = np.linspace(0.0, 1.0, 101) < 0.6
    force = np.where(stance, 70 * 9.81 / (2 * stance.mean()), 0.0)
    curves = np.zeros((2, 101, 3))
    curves[0, :, 2], curves[1, :, 2] = force / given, 1.4 * force / given
    found = _other_mass("walk.c3d", {"LGroundReactionForce": curves[:1], "RGroundReactionForce": curves, "LKneeMoment": curves}, given)
    assert [one.code for one in found] == ["kinetics-mass-differs"] * bool(told)
    assert all(told in one.sentence and f"{given:.0f} kg" in one.sentence for one in found)
    curves[:, 50:, 2] = np.nan
    assert not _other_mass("walk.c3d", {"LGroundReactionForce": curves}, given), "half a cycle tells no weight"


def test_real_walks_have_the_moments_and_powers_of_the_laboratory() -> None:
    folder = os.environ.get("ASTERISM_DATA")
    path = Path(folder or ".") / "gait-events/plates/NP1003/walk_1003a09.c3d"
    if not folder or not path.exists():
        pytest.skip("ASTERISM_DATA names no folder with gait-events/plates")
    recording = asterism.read(path)
    plates, _ = force_plates(recording)
    analysis = analyse_gait(recording, plates)
    assert analysis.kinetics is not None and analysis.loads["LKneeMoment"].shape[1:] == (101, 3)
    for name, moments in analysis.kinetics.moments.items():
        theirs = computed_by_the_file(recording, name)
        assert theirs is not None
        assert np.sqrt(np.nanmean((moments - theirs / 1000) ** 2, axis=0)).max() < 0.03, name
        known = np.isfinite(moments + theirs).all(axis=1)
        assert (np.abs(moments - theirs / 1000)[known] < 1.96 * analysis.kinetics.sigmas[name][known]).mean() > 0.93, name
    for name, power in analysis.kinetics.powers.items():
        theirs = computed_by_the_file(recording, name)
        assert theirs is not None and np.sqrt(np.nanmean((power - theirs[:, 2]) ** 2)) < 0.1, name
    assert "kinetics-mass-differs" not in [one.code for one in analysis.findings]
    content = as_dict(analysis)
    for name, places in content["load_cycles"].items():
        assert len(places) == len(content["loads"][name]) and {content["cycles"][place]["side"] for place in places} == {name[0]}
    # without a mass the stances are shown, and that they are not per kg is said
    heavy = analyse_gait(recording, plates, replace(subject_measures(recording), mass=None))
    assert heavy.kinetics is not None and not heavy.kinetics.per_kg and "kinetics-mass" in [one.code for one in heavy.findings]
    assert np.nanmax(heavy.loads["LAnkleMoment"][:, :, 0]) > 40
