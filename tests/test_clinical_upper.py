"""Angles of head, neck, shoulders, elbows and wrists of a person that is built of known angles, by rotations of SciPy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from asterism import Recording
from asterism.motion.clinical import ArmMeasures, StaticRules, SubjectMeasures, with_static_offsets
from asterism.motion.clinical.upper_body import arm_measures_needed, upper_body_angles

POINT = 1e-6
"""m: markers that are as good as points, whose joints are where they are."""
PLAIN = replace(SubjectMeasures(), marker_radius=POINT, **{f"{side}_arm": ArmMeasures(*[POINT] * 4) for side in ("left", "right")})
TRUNK = {"CLAV": (0.10, 0, 0.1), "C7": (-0.10, 0, 0.1), "STRN": (0.10, 0, -0.1), "T10": (-0.10, 0, -0.1)}
HEAD = {"LFHD": (0.1, 0.07, 0.3), "RFHD": (0.1, -0.07, 0.3), "LBHD": (-0.1, 0.07, 0.3), "RBHD": (-0.1, -0.07, 0.3)}


def person(neck: tuple = (0, 0, 0), shoulder: tuple = (0, 0, 0), elbow: float = 0, wrist: tuple = (0, 0, 0), **at: float) -> Recording:
    """Three frames; angles in degrees, both sides alike, of a trunk that stands upright and looks along x.

    neck      looking up, bent to the person's left, turned to the left; the head's alone
    shoulder  flexion, abduction, internal rotation; wrist flexion, bend to the little finger's side, turn of the hand
    at        tilt: degrees by which the whole person leans ahead; drop: m from the acromion down to the shoulder
    """
    up, left_ear, turn = neck
    skull = Rotation.from_euler("YXZ", [-up, -left_ear, turn], degrees=True)
    places = {name: np.array(place) for name, place in TRUNK.items()}
    places |= {name: skull.apply(place) for name, place in HEAD.items()}
    for side, out in (("L", 1.0), ("R", -1.0)):
        flexion, abduction, rotation = shoulder
        arm = Rotation.from_euler("YXZ", [-flexion, out * abduction, -out * rotation], degrees=True)
        # of the angles of three axes only one at a time is told the same whatever their order
        fore = arm * Rotation.from_euler("Y", -elbow, degrees=True)
        hand = fore * Rotation.from_euler("YXZ", [wrist[0] * -1.0, 0, 0], degrees=True)
        socket = np.array([0.10, out * 0.18, 0.10])
        places[f"{side}SHO"] = socket + np.array([0, 0, at.get("drop", 0.0)])
        places[f"{side}ELB"] = socket + arm.apply([0, 0, -0.3])
        joint = places[f"{side}ELB"] + fore.apply([0, 0, -0.25])
        # the thumb ahead, the palm towards the thigh
        places[f"{side}WRA"], places[f"{side}WRB"] = joint + fore.apply([0.03, 0, 0]), joint + fore.apply([-0.03, 0, 0])
        places[f"{side}FIN"] = joint + hand.apply([0, 0, -0.08])
    leaning = Rotation.from_euler("Y", at.get("tilt", 0.0), degrees=True)
    positions = leaning.apply(np.array(list(places.values()))) + np.array([0, 0, 1.2])
    return Recording(np.tile(positions, (3, 1, 1)), tuple(places), 100.0)


def angles(recording: Recording, measures: SubjectMeasures = PLAIN) -> dict[str, np.ndarray]:
    return {name: np.degrees(values[0]) for name, values in upper_body_angles(recording, measures, np.eye(3)).items()}


@pytest.mark.parametrize("flexion", [-40, 0, 35, 110])
def test_an_arm_bent_by_known_angles_has_them_on_both_sides(flexion: float) -> None:
    found = angles(person(shoulder=(flexion, 0, 0), elbow=50))
    for side in "LR":
        np.testing.assert_allclose(found[f"{side}ShoulderAngles"], [flexion, 0, 0], atol=1e-2)
        np.testing.assert_allclose(found[f"{side}ElbowAngles"], [50, 0, 0], atol=1e-2)


@pytest.mark.parametrize("bend", [-15, 25])
def test_each_angle_of_an_arm_and_head_is_told_alone(bend: float) -> None:
    """Head: down, to the side of the name, outwards, as the vendor counts; the neck the other way. The thumb points ahead."""
    to_side, turned = (angles(person(shoulder=shoulder, elbow=50)) for shoulder in ((0, bend, 0), (0, 0, bend)))
    bent = angles(person(elbow=50, wrist=(bend, 0, 0)))
    heads = [angles(person(neck=tuple(bend * np.eye(3)[k]))) for k in range(3)]
    for side, left in (("L", 1), ("R", -1)):
        assert to_side[f"{side}ShoulderAngles"][1] == pytest.approx(bend, abs=1e-2)
        assert turned[f"{side}ShoulderAngles"][2] == pytest.approx(bend, abs=1e-2)
        np.testing.assert_allclose(bent[f"{side}WristAngles"], [bend, 0, 90], atol=1e-2)
        for k, sign in enumerate((1, -left, -left)):
            assert heads[k][f"{side}HeadAngles"][k] == pytest.approx(sign * bend, abs=1e-6)
            assert heads[k][f"{side}NeckAngles"][k] == pytest.approx(-sign * bend, abs=1e-6)


def test_the_shoulder_is_its_offset_below_the_acromion() -> None:
    """The arm's line starts there: without the measure a hanging arm is bent sideways by the offset over its length."""
    known = replace(PLAIN, left_arm=replace(PLAIN.left_arm, shoulder_offset=0.05))
    assert angles(person(elbow=50, drop=0.05), known)["LShoulderAngles"][1] == pytest.approx(0.0, abs=2.0)
    hanging = angles(person(elbow=50), replace(PLAIN, left_arm=replace(PLAIN.left_arm, shoulder_offset=0.05)))
    assert abs(hanging["LShoulderAngles"][1]) > 2.0


def test_a_level_head_in_the_standing_trial_is_straight_ahead() -> None:
    legs = {"THI": (0, 0.2, -0.5), "KNE": (0, 0.1, -0.7), "TIB": (0, 0.2, -0.9), "ANK": (0, 0.1, -1.1)}
    pelvis = {"LASI": (0.1, 0.12, 0.0), "RASI": (0.1, -0.12, 0.0), "SACR": (-0.1, 0.0, 0.0)}
    upright = person(neck=(12, 0, 0), elbow=50)
    places = {**pelvis, **{s + name: np.multiply(at, (1, out, 1)) for s, out in (("L", 1), ("R", -1)) for name, at in legs.items()}}
    more = np.tile(np.array(list(places.values()), dtype=float) + np.array([0, 0, 1.2]), (3, 1, 1))
    static = replace(upright, positions=np.concatenate([upright.positions, more], axis=1), labels=(*upright.labels, *places))
    told = with_static_offsets(static, PLAIN, StaticRules(level_head=True))
    assert np.degrees(told.head_offset) == pytest.approx(12.0)
    assert with_static_offsets(static, PLAIN).head_offset == 0.0
    np.testing.assert_allclose(angles(upright, told)["LHeadAngles"], 0.0, atol=1e-6)


def test_what_has_its_markers_is_computed_and_the_rest_left_out() -> None:
    whole = person(elbow=50)
    assert set(angles(whole)) == {f"{s}{name}Angles" for s in "LR" for name in ("Head", "Neck", "Shoulder", "Elbow", "Wrist")}
    without = angles(whole.select([name for name in whole.labels if name not in ("LFIN", "RELB", "LFHD")]))
    assert set(without) == {"LShoulderAngles", "LElbowAngles"}
    assert arm_measures_needed(list(without), "L") == ["shoulder_offset", "elbow_width", "wrist_width"]
    assert arm_measures_needed(list(without), "R") == []
    positions = whole.positions.copy()
    positions[1, whole.labels.index("LWRB")] = np.nan
    gap = upper_body_angles(replace(whole, positions=positions), PLAIN, np.eye(3))
    assert (
        np.isnan(gap["LElbowAngles"][1]).any() and np.isfinite(gap["LElbowAngles"][[0, 2]]).all() and np.isfinite(gap["LHeadAngles"]).all()
    )


def test_angles_of_the_whole_body_know_how_far_a_fill_makes_them_uncertain() -> None:
    """A filled marker of the head counts in the head's angles, not in the arms'."""
    from asterism.gait import analyse_gait
    from asterism.motion.gaps import fill_gaps
    from asterism.simulation import simulate_walks

    [walk] = simulate_walks(1, frames=220, markers="plug-in-gait", seed=0)
    positions = walk.positions.copy()
    positions[60:90, walk.labels.index("LFHD")] = np.nan
    analysis = analyse_gait(fill_gaps(replace(walk, positions=positions), limit=1.0).recording)
    assert np.nanmax(analysis.fill_sigmas["LHeadAngles"]) > 0.0 == np.nanmax(analysis.fill_sigmas["LElbowAngles"])
